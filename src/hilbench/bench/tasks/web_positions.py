"""Carriages of dancers and accumulators: the driven roller or reel before one keeps its position; its force is fed
forward, for the valve that sets its pressure."""

from __future__ import annotations

from functools import partial
from math import inf

from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CompiledStages, Outputs, SensedLoop, StagedTask
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.bench.tasks.web_winding_control import CarriageForce, DancerPosition, RollerMotion, eased
from hilbench.cycle_program import python_stage
from hilbench.errors import BenchFaultError
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import LineCarriage
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import CarriageForceConfig, PositionControlConfig
from hilbench.topology.web_line_quantities import FEED, FORCE_SET_POINT, SET_POINT, position_path

#: So near to a stop a carriage is at it.
_AT_STOP_M = 5e-4


class PositionTask(SensedLoop, AxisTask):
    """Velocity of the axis before a carriage from the position that its sensor reports, around the speed of the axis
    after it.

    Settable are the set-point, m, and whether the axis feeds: with 0 it stops within the control's
    `feed_ramp_s`, and the carriage moves by what is missing; with 1 it runs again, and the carriage returns
    by no more than the loop's correction. `set_point_m`: the first.
    """

    def __init__(
        self,
        drive: str,
        axis: int,
        control: PositionControlConfig,
        loop: DancerPosition,
        leader: AxisTask,
        set_point_m: float,
        cycle_s: float,
    ) -> None:
        station = control.station
        self._loop = loop
        self._leader = leader
        self._cycle_s = cycle_s
        self._ramp_s = control.feed_ramp_s
        self._command = f"v{axis}_cmd_m_s"
        self._measured, self._feed = f"x_{station}_meas_m", position_path(station, FEED)
        values = {position_path(station, SET_POINT): set_point_m, self._feed: 1.0}
        super().__init__(values, f"x_{station}_ref_m", {drive: self._command})
        self._ramped = 1.0  # share of the ramp from standstill to feeding

    def _control(self, sample: CycleSample) -> None:
        """Command the velocity of the axis, m/s at the web."""
        behind_m_s, share = self._leader.speed_m_s, self._share()
        if share < 1.0 or not self._reported:
            velocity_m_s = self._loop.let_go(behind_m_s, self._cycle_s)
        else:
            wanted_m, position_m = self._set_point, getattr(sample, self._measured)
            velocity_m_s = self._loop.velocity(behind_m_s, wanted_m, 0.0, position_m, self._cycle_s)
        speed_m_s = share * velocity_m_s
        self.speeds[0] = speed_m_s, speed_m_s  # nothing is damped through a carriage
        setattr(sample, self._command, speed_m_s)

    def _share(self) -> float:
        """Share of its speed at which the axis feeds now: from one end to the other with a bounded jerk."""
        step = self._cycle_s / self._ramp_s
        self._ramped += min(max(self._values[self._feed] - self._ramped, -step), step)
        return eased(self._ramped)[0]

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The carriage is as at the start when the drives are enabled again."""
        super().rest(sample, outputs)
        self._loop.reset()


class CarriageStops(StagedTask):
    """Fault on a carriage that reaches its stop, where it keeps no tension, as by the limit switches of a
    dancer. Where it is pushed in the direction that lengthens the web, at the upper stop no web holds it."""

    def __init__(self, carriage: LineCarriage) -> None:
        station = carriage.station
        self._measured = f"x_{station.name}_meas_m"
        spans = f"spans {carriage.first_span} to {carriage.last_span}"
        self._about = f"the carriage of {station.name} is at its stop"
        self._stops = [
            (stop_m, f"{why} in {spans}")
            for stop_m, why in (
                (station.lower_stop_m, "there is no web left for it"),
                (station.upper_stop_m, "the web has torn, or more comes in than goes out,"),
            )
            if stop_m is not None
        ]
        self._was_away = False

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Python's stage that checks the position."""
        return CompiledStages(after=[python_stage(partial(self._check, sample))])

    def _check(self, sample: CycleSample) -> None:
        """Raise BenchFaultError when it has come to a stop."""
        position_m = getattr(sample, self._measured)
        at = [(stop_m, why) for stop_m, why in self._stops if abs(position_m - stop_m) < _AT_STOP_M]
        if at and self._was_away:
            stop_m, why = at[0]
            raise BenchFaultError(f"t = {sample.t_s:.3f} s: {self._about}, {stop_m:g} m: {why}")
        self._was_away = not at


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
