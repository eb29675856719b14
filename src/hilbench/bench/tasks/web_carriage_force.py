"""Feed-forward force on the carriage of a dancer or accumulator, for the valve that sets its pressure."""

from __future__ import annotations

from math import inf

from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import Outputs, SensedLoop
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.bench.tasks.web_roller_motion import RollerMotion
from hilbench.bench.tasks.web_winding_control import CarriageForce
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import LineCarriage
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import CarriageForceConfig
from hilbench.topology.web_line_quantities import FORCE_SET_POINT, position_path


class CarriageForceTask(SensedLoop):
    """Force on a carriage that keeps the tension after it, plus the force that carriage and rollers need as the driven
    rollers around them change their speeds, by the model; a cylinder pushes, and never pulls.

    The set-point, N of tension, is settable. `before`, `behind`: the driven axes on both sides of the carriage, as
    their drives follow their commands; `axis`: number of the one before.
    """

    def __init__(
        self,
        control: CarriageForceConfig,
        model: ModelParameters,
        carriage: LineCarriage,
        axis: int,
        before: AxisTask,
        behind: AxisTask,
        state: BenchState,
    ) -> None:
        station = carriage.station
        self._state = state
        self._force = CarriageForce(model, carriage, behind_takes=control.behind_takes)
        self._limit_N = inf if control.limit_N is None else control.limit_N
        self._ends = before, behind
        self._motions = [RollerMotion(model, number, state.cycle_s) for number in (axis, axis + 1)]
        self._signal, self._measured = f"f_{station.name}_cmd_N", f"x_{station.name}_meas_m"
        values = {position_path(station.name, FORCE_SET_POINT): control.tension_N(station)}
        super().__init__(values, "", {self._signal: self._signal})
        self._starts_m = station.position_m

    def _control(self, sample: CycleSample) -> None:
        """Command the force, N, from this SYNC on."""
        share, motions = self._state.speed_share, self._motions
        before_m_s2, behind_m_s2 = (
            motion.acceleration_m_s2(share * end.speed_m_s) for motion, end in zip(motions, self._ends, strict=True)
        )
        before_m_s, behind_m_s = (motion.speed_m_s for motion in motions)
        position_m = getattr(sample, self._measured) if self._reported else self._starts_m
        moving = before_m_s, behind_m_s, before_m_s2, behind_m_s2, position_m
        self._command(sample, self._force.force_N(self._set_point, *moving))

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Command the force that holds the carriage at its start position, for the drives being enabled again."""
        super().rest(sample, outputs)
        for motion in self._motions:
            motion.reset()
        standing = 0.0, 0.0, 0.0, 0.0, self._starts_m
        outputs[self._signal] = self._command(sample, self._force.force_N(self._set_point, *standing))

    def _command(self, sample: CycleSample, force_N: float) -> float:
        commanded_N = min(max(force_N, 0.0), self._limit_N)
        setattr(sample, self._signal, commanded_N)
        return commanded_N
