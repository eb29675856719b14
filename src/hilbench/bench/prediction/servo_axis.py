"""Prediction of a servo axis: its model with the set points to come, from the bench's signals."""

from __future__ import annotations

from functools import partial

from hilbench.arrays import Array
from hilbench.bench.prediction.task import Look
from hilbench.bench.prediction.window import Hindsight, Reading, Window
from hilbench.bench.tasks.limits import is_synchronized
from hilbench.bench.tasks.shaft_limits import limited
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.futures import Offsets, Prepared
from hilbench.prediction.plan import Asked
from hilbench.prediction.servo_axis.futures import ShaftCourses, ShaftFutures, ShaftPresent
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import SHAFT_COULOMB_FRICTION, SHAFT_INERTIA, SPEED
from hilbench.topology.sample import CycleSample

_COMMAND = "v1_cmd_rad_s"
#: So many of its stated deviations away an inertia is another one.
_ANOTHER = 3.0
#: What the twin has found of the shaft, each with its deviation.
_FOUND = (
    *("J_sim_kg_m2", "J_sd_kg_m2"),
    *("coulomb_sim_Nm", "coulomb_sd_Nm"),
    *("viscous_sim_Nm_s_per_rad", "viscous_sd_Nm_s_per_rad"),
)
#: The quantities whose courses futures follow. When the twin finds another inertia plays no part: no controller goes by
#: it.
FORESEEN = {SPEED: _COMMAND, SHAFT_INERTIA: "J_true_kg_m2", SHAFT_COULOMB_FRICTION: "coulomb_true_Nm"}


class ShaftLook(Look):
    """Looks ahead from the samples of one run."""

    futures: ShaftFutures
    unready = "the twin is not synchronized"

    def __init__(self, config: BenchConfig, prediction: PredictionConfig) -> None:
        (motor,) = config.load_motors
        super().__init__(limited(config.safety.limits, motor))
        self._quantities = tuple(each.signal for each in self.watched)
        self.signals = (*self._quantities, "x1_rad", _COMMAND, *_FOUND)
        self._believed = 0.0, 0.0  # inertia and its deviation
        self._found = _FoundInertia()
        drives = config.servo_axis.drives
        self._looks = drives.sample_time_s / config.cycle_time_s if drives else 0.0  # of the drive's loop, in cycles
        self.futures = ShaftFutures(
            config.servo_axis,
            config.servo_rig_parameters(effects=()),
            self.watched,
            cycle_s=config.cycle_time_s,
            horizon_s=prediction.horizon_s,
            futures=prediction.futures,
        )

    def ready(self, sample: CycleSample) -> bool:
        """True if the present state is known: the twin is synchronized."""
        return is_synchronized(sample) and sample.J_sim_kg_m2 > 0.0

    def prepare(self, now_s: float, window: Window, hindsight: Hindsight, asked: Asked, *key: int) -> Prepared:
        """Prepare `ShaftFutures` from the last samples and the planned moves."""
        reading = window.read()
        present = self._present(now_s, reading, window.fit_noise)
        if abs(present.inertia_kg_m2 - self._believed[0]) > _ANOTHER * self._believed[1]:
            # Predictions with an inertia that has proved wrong have no lasting residual.
            hindsight.clear()
            self._believed = present.inertia_kg_m2, present.inertia_sd_kg_m2
        to_find = self._found.share_to_find(present.inertia_kg_m2, asked.present.get(SHAFT_INERTIA))
        hindsight.compare(now_s, self._measured(reading), self._compared)
        offsets = Offsets(hindsight.lasting.copy(), hindsight.deviation, reading.noise(*self._quantities))
        asked_now = float(reading.last(_COMMAND)[0])
        return self.futures.prepare(present, partial(_courses, asked_now, to_find, present, asked), offsets, *key)

    def _present(self, now_s: float, reading: Reading, fit_noise: float) -> ShaftPresent:
        inertia, deviation, dry, dry_sd, viscous, viscous_sd = reading.last(*_FOUND).tolist()
        position, speed, torque = reading.fitted("x1_rad", "v1_rad_s", "tau1_Nm").tolist()
        # A set point acts a cycle after the request; the drive has sampled a sample time ago.
        (command,), (followed,) = reading.ago(1, _COMMAND).tolist(), reading.ago(2, _COMMAND).tolist()
        since_then = (speed - float(reading.before("v1_rad_s")[0])) * self._looks
        return ShaftPresent(
            now_s=now_s,
            position_rad=position,
            speed_rad_s=speed,
            speed_sd_rad_s=float(reading.noise("v1_rad_s")[0]) * fit_noise,
            torque_Nm=torque,
            command_rad_s=command,
            error_rad_s=followed - (speed - since_then),
            inertia_kg_m2=inertia,
            inertia_sd_kg_m2=deviation,
            dry_friction_Nm=dry,
            dry_friction_sd_Nm=dry_sd,
            viscous_friction_Nm_s_per_rad=viscous,
            viscous_friction_sd_Nm_s_per_rad=viscous_sd,
        )


class _FoundInertia:
    """Emulated inertia that the estimate belongs to: at constant speed the twin can't identify a change of it."""

    def __init__(self) -> None:
        self._estimate_kg_m2 = self._of_kg_m2 = 0.0

    def share_to_find(self, estimate_kg_m2: float, emulated_kg_m2: float | None) -> float:
        """Ratio of the inertia that the load motor emulates now to the estimate; 1 where it is not known (None)."""
        if emulated_kg_m2 is None:
            return 1.0
        share = emulated_kg_m2 / self._of_kg_m2 if self._of_kg_m2 else 1.0
        changed_kg_m2 = self._estimate_kg_m2 * share
        if abs(estimate_kg_m2 - changed_kg_m2) <= abs(estimate_kg_m2 - self._estimate_kg_m2):
            self._estimate_kg_m2, self._of_kg_m2 = estimate_kg_m2, emulated_kg_m2
            return 1.0
        return share


def _courses(speed_rad_s: float, to_find: float, present: ShaftPresent, asked: Asked, times_s: Array) -> ShaftCourses:
    """Trajectories at times; `speed_rad_s`: the present command; `to_find`: see `_FoundInertia`."""
    course = partial(asked.course, now_s=present.now_s, times_s=times_s)
    inertia = course(SHAFT_INERTIA, present.inertia_kg_m2)
    dry = course(SHAFT_COULOMB_FRICTION, present.dry_friction_Nm)
    return ShaftCourses(
        course(SPEED, speed_rad_s),
        to_find * inertia / asked.present.get(SHAFT_INERTIA, present.inertia_kg_m2),
        dry - asked.present.get(SHAFT_COULOMB_FRICTION, present.dry_friction_Nm),
    )


look = ShaftLook


def foreseen(config: BenchConfig) -> dict[str, str]:
    """The quantities whose courses futures follow, by path, each with the signal that shows it."""
    return FORESEEN
