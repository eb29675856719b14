"""Block `twin:` of a bench config."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, model_validator

from hilbench.block import Block
from hilbench.plant.web_line.parameters import Modulus


class AlsoEstimated(Block):
    """Nuisance parameters estimated in addition to E: standard deviation of the prior around 0; 0: not estimated."""

    torque_offset_Nm: float = Field(default=0.0, ge=0, description="of axis 2's torque measurement, motor side")
    viscous_friction_N_s_per_m: float = Field(default=0.0, ge=0, description="of roller 2 beyond the model's")
    dry_friction_N: float = Field(default=0.0, ge=0, description="of roller 2 beyond the model's")
    inertia_share: float = Field(
        default=0.005,
        ge=0,
        description="of the moving mass of axis 2, relative; also covers that torque is sampled, not averaged",
    )


class ModelErrorsConfig(Block):
    """Priors of the twin's model errors on axis 2: standard deviations, as shares of the machine's sizes.

    They are estimated in addition to E; what the data can't separate from E is part of E's stated deviation.
    """

    friction_pct: PositiveFloat = Field(
        default=10.0, description="dry friction beyond the model's, and viscous at `at_speed_m_s`, of the tension"
    )
    at_speed_m_s: PositiveFloat = Field(default=3.0, description="usual line speed, for viscous friction")
    torque_offset_pct: PositiveFloat = Field(
        default=0.6, description="of the torque's measurement, of the drive's limit"
    )
    torque_scale_pct: PositiveFloat = Field(default=7.0, description="error of the torque's scale")
    inertia_pct: PositiveFloat = Field(default=10.0, description="of the moving mass")
    strain_pct: PositiveFloat = Field(default=2.0, description="lasting error of the strain, of the usual strain")
    creep_pct: PositiveFloat = Field(
        default=60.0,
        description="slip by creep: strain that is lost per difference of the tensions at the roller, both relative",
    )
    eccentricity_um: PositiveFloat = Field(default=20.0, description="of either roller, micrometres")
    unbalance_pct: PositiveFloat = Field(default=4.0, description="of roller 2, as a force at the web, of the tension")


class Prior(Block):
    """Prior of an effect that the model lacks on an axis: mean and standard deviation."""

    quantity: Literal[
        "torque_offset_Nm",
        "dry_friction_N",
        "viscous_friction_N_s_per_m",
        "torque_scale",
        "inertia_share",
        "creep_per_N",
    ] = Field(
        description="offset of the measured torque at the motor; friction of the roller at the web; relative error of "
        "the torque's scale; relative change of the moving mass; strain lost by creep per newton of tension difference"
    )
    axis: int = Field(ge=1, description="number of the axis, in the direction of the web")
    value: float = Field(description="mean, in the unit of the quantity; 0: the model is right")
    deviation: PositiveFloat = Field(description="standard deviation, in the unit of the quantity")
    measured_at: datetime | None = Field(default=None, description="when it was measured; null: it was not measured")


class EstimateConfig(Block):
    """Estimated quantity, and the span whose measurement shows it."""

    quantity: Literal["youngs_modulus_Pa"] = Field(default="youngs_modulus_Pa", description="what is estimated: E")
    span: int | None = Field(
        default=None,
        ge=1,
        description="number of the span whose tension shows E, in the torques of what is behind it; not given: every "
        "span, each by itself",
    )


class PidConfig(EstimateConfig):
    """Gains of the tracking simulation: dE/dt = Kp·e + Ki·∫e dt + Kd·de/dt, e in N·m of motor torque.

    The defaults reproduce the published behaviour on the demonstrator (about 20 s to 1 %): the velocity loop of axis 2
    follows a change of tension with some seconds' lag, which Kd/Kp compensates.
    """

    method: Literal["pid"] = "pid"
    kp_Pa_per_Nm_s: float = Field(default=4.2e8, ge=0, description="Kp")
    ki_Pa_per_Nm_s2: float = Field(default=2.0e7, ge=0, description="Ki")
    kd_Pa_per_Nm: float = Field(default=2.0e9, ge=0, description="Kd")
    integral_limit_Nm_s: PositiveFloat = Field(default=0.05, description="largest size of the integral")
    error_filter_s: float = Field(default=0.2, ge=0, description="first-order filter of the error")
    lower_limit_Pa: Modulus = Field(default=1.0e8, description="least E it gives")
    upper_limit_Pa: Modulus = Field(default=1.0e11, description="largest E it gives")


class Measured(EstimateConfig):
    """Common settings of the methods with a deviation of E."""

    torque_noise_Nm: PositiveFloat = Field(default=0.05, description="believed until it is measured (0.1 s)")
    initial_deviation_pct: PositiveFloat = Field(default=20.0, description="of E at the start")
    hold_growth_pct_per_s: PositiveFloat = Field(
        default=2.0, description="growth of the deviation, as a random walk, while there is no usable sample"
    )


class OnBalance(Measured):
    """Common settings of the methods on the measured momentum balance of axis 2."""

    also: AlsoEstimated = AlsoEstimated()


class RlsConfig(OnBalance):
    """Recursive least squares with exponential forgetting."""

    method: Literal["rls"] = "rls"
    memory_s: PositiveFloat = Field(default=0.05, description="time constant of forgetting")


class EkfConfig(OnBalance):
    """Extended Kalman filter of motion and parameters; the process noise of E follows the innovations."""

    method: Literal["ekf"] = "ekf"
    drift_pct_per_sqrt_s: PositiveFloat = Field(default=0.1, description="random walk of E while innovations are white")
    jump_pct_per_sqrt_s: PositiveFloat = Field(default=100.0, description="the same when the innovations are far off")


class LmConfig(OnBalance):
    """Levenberg–Marquardt on a moving window."""

    method: Literal["lm"] = "lm"
    window_s: PositiveFloat = Field(default=0.15, description="how far back a solution looks")
    every_cycles: int = Field(default=10, ge=1, description="cycles between two solutions")


class GlobalConfig(OnBalance):
    """Differential evolution on a window, outside the cyclic path; its result acts `latency_cycles` later."""

    method: Literal["global"] = "global"
    window_s: PositiveFloat = Field(default=0.4, description="how far back a solution looks")
    latency_cycles: int = Field(default=100, ge=10, description="cycles from a window's end to its result")
    lower_limit_Pa: Modulus = Field(default=1.0e8, description="least E that is looked for")
    upper_limit_Pa: Modulus = Field(default=1.0e11, description="largest E that is looked for")
    seed: int = Field(default=1, ge=0, le=2**32 - 1, description="of the search's random numbers")


class ChangepointConfig(OnBalance):
    """Change-point estimator: bank of Kalman filters, one per hypothesis of E's last jump or drift onset."""

    method: Literal["changepoint"] = "changepoint"
    jumps_per_s: PositiveFloat = Field(default=1e-3, description="how often E is believed to jump")
    jump_pct: PositiveFloat = Field(default=20.0, description="standard deviation of a jump")
    drift_onsets_per_s: PositiveFloat = Field(default=1e-3, description="how often a drift is believed to begin")
    drift_pct_per_s: PositiveFloat = Field(default=2.0, description="standard deviation of a drift's rate")
    cautious_pct: PositiveFloat = Field(
        default=0.09, description="deviation of the mixture above which E is followed only in part, against overshoot"
    )
    wander_pct_per_sqrt_s: float = Field(default=0.02, ge=0, description="random walk of E at all times")


class InputConfig(Measured):
    """Method for a black-box model: the strain of the web that enters it is corrected; its parameters stay.

    Measured states are not transferred into it either.
    """

    method: Literal["input"] = "input"
    observer_s: PositiveFloat = Field(default=0.1, description="time constant with which the correction is found")
    agreement_per_s: PositiveFloat = Field(
        default=20.0, description="rate with which the simulated tension is brought to the measured one"
    )
    limit_share: float = Field(
        default=0.9, gt=0, lt=1, description="largest correction that acts, as a share of the upstream strain"
    )


SynchronizerConfig = Annotated[
    PidConfig | RlsConfig | EkfConfig | LmConfig | GlobalConfig | ChangepointConfig | InputConfig,
    Field(discriminator="method"),
]
#: Methods by their names in configs and on the command line.
METHODS: dict[str, type[SynchronizerConfig]] = {
    "pid": PidConfig,
    "lm": LmConfig,
    "global": GlobalConfig,
    "rls": RlsConfig,
    "ekf": EkfConfig,
    "changepoint": ChangepointConfig,
    "input": InputConfig,
}


class TransferConfig(Block):
    """Direct transfer of measured states into the simulation, each cycle, while they are plausible."""

    strain: bool = Field(default=True, description="the span's strain, as the real axes' encoders show it")
    axes: bool = Field(default=False, description="position and velocity of the real axes")
    strain_limit: PositiveFloat = Field(default=2.0e-4, description="largest plausible difference of strain")
    position_limit_m: PositiveFloat = Field(default=0.05, description="largest plausible difference of position")
    velocity_limit_m_s: PositiveFloat = Field(default=0.2, description="largest plausible difference of velocity")


class KnownChangeConfig(Block):
    """E from known changes of the strain, as probes of the bench make them."""

    loop_gain_deviation_pct: PositiveFloat | None = Field(
        default=None,
        description="what the gains of axis 2's velocity loop may be off the model's: changes of its torque are then "
        "taken from the loop's error of speed, without noise of the measured torque; not given: measured ones alone",
    )


class EstimationConfig(Block):
    """Settings of the twin's estimation: assumptions, methods and transfer."""

    estimate: list[SynchronizerConfig] = Field(
        default=[ChangepointConfig()],
        min_length=1,
        description="what is found from the torques, and how: an entry for a span, or one without a span for all of "
        "them; E of a span without an entry goes with that of the nearest that has one",
    )
    transfer: TransferConfig = TransferConfig()
    web_at_rest: Literal["as_upstream", "unknown"] = Field(
        default="as_upstream",
        description="strain of the web that is in the line when the drives are enabled at rest: that of the web "
        "upstream, as a load model begins with, or unknown; it is unknown anyway to a twin that is started beside "
        "enabled drives",
    )
    youngs_modulus_Pa: Modulus | None = Field(
        default=None, description="what the twin assumes at the start; the model's value if not given"
    )
    torque_delay: Literal["estimate", "model"] = Field(
        default="model", description="delay of the measured torque: found from the data, or as in the model's effects"
    )
    model_errors: ModelErrorsConfig = ModelErrorsConfig()
    priors: list[Prior] = Field(
        default=[], description="what is known of effects that the model lacks, beyond the model, by axis"
    )
    unmodelled_torque_Nm: float | None = Field(
        default=None,
        ge=0,
        description="the torque of axis 2 is known to be lastingly off the model's by no more (standard deviation), "
        "and nothing else: `model_errors` are not looked for then; null: they are",
    )
    torque_shift: Literal["compensate", "ignore"] = Field(
        default="compensate",
        description="a shift of friction or of the torque's offset that is told from a change of E: taken out of the "
        "measured torque, or booked as E",
    )
    splices: bool | None = Field(
        default=None,
        description="look for other web that comes in, follow it and expect it in the next span; while there may be "
        "some the model's errors are not learned; null: on a line of several spans",
    )
    known_change: KnownChangeConfig | None = Field(
        default=None,
        description="E from changes of the tension at steady speed, from which friction and offsets cancel; not given: "
        "where the bench makes probes, with a loop gain deviation of 0.2 % for a simulated drive",
    )
    synchronized_pct: PositiveFloat = Field(
        default=1.0,
        description="deviation of E up to which the twin calls itself synchronized; without the unmodelled torque",
    )
    behind: Literal["catch_up", "hold"] = Field(
        default="catch_up",
        description="a late twin simulates the cycles it missed, or holds its state and goes on with the newest",
    )
    virtual_tpdo_every: int = Field(
        default=0, ge=0, le=240, description="the virtual axes send their TPDOs every n-th SYNC; 0: never"
    )

    @model_validator(mode="before")
    @classmethod
    def _estimate_is_a_list(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "synchronizer" in data:
            raise ValueError("'estimate: [{method: …}]' in place of 'synchronizer:'")
        return data

    @property
    def synchronizer(self) -> SynchronizerConfig:
        """Method of the first span."""
        return self.estimate[0]

    def by_span(self, spans: int) -> dict[int, SynchronizerConfig]:
        """Methods by span number from 1, in order, of a line with so many spans."""
        everywhere = [entry for entry in self.estimate if entry.span is None]
        found = {span: entry for entry in everywhere for span in range(1, spans + 1)}
        found |= {entry.span: entry for entry in self.estimate if entry.span is not None}
        return dict(sorted(found.items()))

    def of_span(self, method: SynchronizerConfig, priors: list[Prior]) -> EstimationConfig:
        """Copy with this method alone, and with the priors of the rollers after the span."""
        return self.model_copy(update={"estimate": [method], "priors": priors})
