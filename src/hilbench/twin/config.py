"""The `twin:` block of a bench config."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat


class PidConfig(BaseModel):
    """Gains of the tracking simulation: dE/dt = Kp·e + Ki·∫e dt + Kd·de/dt, e in N·m of motor torque.

    The defaults reproduce the published behaviour on the demonstrator (about 20 s to 1 %): the velocity loop of
    axis 2 gives way to a change of tension and takes it up with some seconds' lag, which Kd/Kp makes up for.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["pid"] = "pid"
    kp_Pa_per_Nm_s: float = Field(default=4.2e8, ge=0)
    ki_Pa_per_Nm_s2: float = Field(default=2.0e7, ge=0)
    kd_Pa_per_Nm: float = Field(default=2.0e9, ge=0)
    integral_limit_Nm_s: PositiveFloat = 0.05
    error_filter_s: float = Field(default=0.2, ge=0, description="first-order filter of the error")
    lower_limit_Pa: PositiveFloat = 1.0e8
    upper_limit_Pa: PositiveFloat = 1.0e11


class TwinConfig(BaseModel):
    """The twin: what it assumes and how it keeps in step with the bench."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    synchronizer: PidConfig = PidConfig()
    youngs_modulus_Pa: PositiveFloat | None = Field(
        default=None, description="what the twin assumes at the start; the model's value if not given"
    )
    virtual_tpdo_every: int = Field(
        default=0, ge=0, le=240, description="the virtual axes send their TPDOs every n-th SYNC; 0: never"
    )
