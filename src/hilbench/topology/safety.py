"""Limits of a run, and how the safe state is reached."""

from __future__ import annotations

from math import inf
from typing import Annotated, Final, Literal

from pydantic import Field, PositiveFloat, model_validator

from hilbench.block import Block

TimeOut = Annotated[float, Field(gt=0.0, le=3600.0)]

#: What an estimate may be off the model's by where the config sets no limit.
LARGEST_RATIO: Final = 1e3


class Limit(Block):
    """Two levels of one quantity's magnitude; a level that is not given (null) does not exist."""

    warning: PositiveFloat | None = Field(
        default=None, description="noted once until the quantity has fallen below 95 % of it"
    )
    trip: PositiveFloat | None = Field(default=None, description="the bench goes to the safe state")

    @property
    def highest(self) -> float:
        """Value up to which nothing is noted; inf without a level."""
        return self.warning or self.trip or inf

    @model_validator(mode="after")
    def _warning_comes_first(self) -> Limit:
        if self.warning is not None and self.trip is not None and self.warning > self.trip:
            raise ValueError(f"a warning level that is not above the trip level {self.trip:g}")
        return self


class LimitsConfig(Block):
    """Levels of warning (noted in the result) and trip (the bench goes to the safe state)."""

    tension_N: Limit = Field(default=Limit(warning=300.0, trip=400.0), description="of the emulated web")
    torque_Nm: Limit = Field(default=Limit(warning=10.0, trip=15.0), description="of any drive, motor side")
    speed_m_s: Limit = Field(default=Limit(warning=8.0, trip=10.0), description="of either axis, at the web")
    speed_rad_s: Limit = Field(default=Limit(warning=80.0, trip=100.0), description="of a servo axis, motor side")
    position_difference_m: Limit = Field(
        default=Limit(warning=0.05, trip=0.2),
        description="of axis 1 from axis 2, beyond what their set points add up to since the drives were enabled",
    )
    estimate_ratio: Limit = Field(
        default=Limit(warning=3.0, trip=10.0),
        description="of the twin's E or inertia, while it is synchronized, to the model's, or its inverse",
    )


class SafetyConfig(Block):
    """Limits of a run and how the safe state is reached: all drives at rest by quick stop, then without power."""

    cycle_timeout_s: TimeOut = Field(
        default=5.0, description="lockstep: wall time to wait for a drive; for the twin 2 s at most"
    )
    missing_cycles: int = Field(default=25, ge=1, description="realtime: cycles in a row a PDO may be missing")
    drive_timeout_s: TimeOut = Field(default=2.0, description="for a drive to reach a requested state")
    quick_stop_m_s2: float = Field(
        default=3.0,
        ge=0.01,
        le=1000.0,
        description="deceleration of a quick stop, at the web; on a line of several spans that of all rollers, less "
        "where the drive of one has not the torque for it",
    )
    quick_stop_rad_s2: float = Field(
        default=50.0, ge=0.01, le=1e5, description="deceleration of a quick stop of a servo axis, motor side"
    )
    limits: LimitsConfig = LimitsConfig()
    loop_open_s: PositiveFloat = Field(
        default=5.0,
        description="a loop open for so long while the machine moves, or its set-point was changed: a warning, "
        "and criteria on what it controls are not judged",
    )
    on_web_break: Literal["stop", "warn"] = Field(default="stop", description="when the twin reports a web break")
    on_predicted_limit: Literal["warn", "stop", "slow_down"] = Field(
        default="warn",
        description="when a trip level will be crossed, as the twin's prediction says: note it; stop, as when it is "
        "crossed; or slow the machine down until it is not expected any more",
    )
    on_foreign_frames: Literal["stop", "warn"] = Field(
        default="warn",
        description="when another station sends what only the bench or its nodes send, or writes to the nodes by SDO",
    )
    supervisor_timeout_s: TimeOut = Field(
        default=0.5,
        description="realtime: silence of the bench's heartbeat after which the supervisor stops the drives; "
        "lockstep: so much longer than cycle_timeout_s",
    )
