"""Reels: speeds that follow a measured radius; in torque mode the torque from a load cell, with feed-forward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CompiledStages, Outputs, SensedLoop, StagedTask
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.bench.tasks.web_winding_control import ReelMechanics, ReelTension, RollerMotion
from hilbench.cycle_program import python_stage
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import ReelControlConfig, span_beside_reel
from hilbench.topology.web_line_quantities import tension_set_point


@dataclass(frozen=True, slots=True)
class MeasuredReel:
    """A reel with a sensor of its radius: its drive, its axis, the sensor's signal, and the radius in m by which its
    position and speed are counted, that at the start."""

    drive: str
    axis: int
    signal: str
    counted_m: float

    def ratio(self, sample: CycleSample) -> float:
        """Radius over that by which it is counted; 1 while the sensor has reported nothing."""
        radius_m: float = getattr(sample, self.signal)
        return radius_m / self.counted_m if radius_m > 0.0 else 1.0


class ReelSpeeds(StagedTask):
    """Scales the reels' speeds so that the web on them has the speed that was commanded.

    `line_speed`: signal of the speed of the leading axis at the web, "" where only its command is needed.
    """

    def __init__(self, reels: Sequence[MeasuredReel], leader: AxisTask, line_speed: str) -> None:
        self._reels = [(reel, f"v{reel.axis}_cmd_m_s") for reel in reels]
        self._leader = leader
        self._line_speed = line_speed

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Python's stage that commands the reels."""
        shown = {reel.drive: command for reel, command in self._reels}
        return CompiledStages(before=[python_stage(partial(self._command, sample))], shown=shown)

    def _command(self, sample: CycleSample) -> None:
        """Command the reels, m/s at the radius that they had at the start."""
        if self._line_speed:
            setattr(sample, self._line_speed, self._leader.speed_m_s)
        for reel, command in self._reels:
            setattr(sample, command, getattr(sample, command) / reel.ratio(sample))


class ReelTravel:
    """Travel of the web at a reel, m, from cycle to cycle by its radius."""

    def __init__(self, reel: MeasuredReel) -> None:
        self._reel = reel
        self._position = f"x{reel.axis}_m"
        self._at_m: float | None = None
        self._travel_m = 0.0

    def __call__(self, sample: CycleSample) -> float:
        """Travel up to the last sample."""
        position_m: float = getattr(sample, self._position)
        if self._at_m is not None:
            self._travel_m += (position_m - self._at_m) * self._reel.ratio(sample)
        self._at_m = position_m
        return self._travel_m


class ReelTorqueTask(SensedLoop):
    """Torque of a reel's drive from the tension that the load cell next to it reports.

    The set-point, N, is settable. With the twin's feed-forward the pull acts at the twin's radius, and the
    torque for the acceleration of the leading axis, as its drive follows the line's speed, is added. A
    bench's reel turns a flywheel of the web that is on it at the start. `leading`: number of the axis that leads.
    """

    def __init__(
        self,
        control: ReelControlConfig,
        drive: str,
        axis: int,
        leader: AxisTask,
        leading: int,
        model: ModelParameters,
        shape: Shape,
        state: BenchState,
    ) -> None:
        loops, number = model.drives, shape.numbered(span_beside_reel(model, axis))
        assert loops is not None, "a bench's model has drives"
        self._leader, self._state = leader, state
        self._reel = ReelMechanics.of_model(model, axis)
        limit_Nm = per_item(loops.torque_limit_Nm, axis)
        self._loop = ReelTension(self._reel, control.gain, control.rate_per_s, limit_Nm, control.derivative_s)
        self._ahead = RollerMotion(model, leading, state.cycle_s) if control.feed_forward == "twin" else None
        self._counted_m = model.radius_m(axis)
        self._radius, self._torque = f"r_{control.reel}_sim_m", f"tau{axis}_cmd_Nm"
        values, shown = {tension_set_point(number): control.set_point_N}, {drive: self._torque}
        super().__init__(values, f"F{number}_ref_N", shown)
        self._cell, self._closed = f"F_{control.load_cell}_meas_N", f"loop{number}_closed"
        self._position, self._speed = f"x{axis}_m", f"v{axis}_cmd_m_s"
        self._at_m: float | None = None

    def _control(self, sample: CycleSample) -> None:
        """Command the torque, N·m at the motor, from the last sample. No speed is commanded: recorded in the place of
        that is the measured one, so that the axis has no position error."""
        speed_m_s = self._leader.damped_m_s * self._state.speed_share
        radius_m, acceleration_m_s2 = self._counted_m, 0.0
        if self._ahead is not None:
            radius_m = self._radius_m(sample)
            acceleration_m_s2 = self._ahead.acceleration_m_s2(speed_m_s)
        tension_N = getattr(sample, self._cell) if self._reported else self._set_point
        now = self._set_point, tension_N, acceleration_m_s2, radius_m, self._state.cycle_s, self._counted_m
        setattr(sample, self._torque, self._loop.torque_Nm(*now))
        position_m: float = getattr(sample, self._position)
        went_m = 0.0 if self._at_m is None else position_m - self._at_m
        setattr(sample, self._speed, went_m / self._state.cycle_s)
        self._at_m = position_m
        setattr(sample, self._closed, int(self._reported))

    def _radius_m(self, sample: CycleSample) -> float:
        """Last radius by the twin; before that the one at the start."""
        radius_m: float = getattr(sample, self._radius)
        return radius_m if radius_m > 0.0 else self._counted_m

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Command zero torque, and reset: nothing is known of the line."""
        super().rest(sample, outputs)
        self._at_m = None
        self._loop.reset()
        if self._ahead is not None:
            self._ahead.reset()


class LoadCells(StagedTask):
    """Readings of the load cells of the emulated line: the mean of the tensions on both sides of their idlers."""

    def __init__(self, model: ModelParameters, shape: Shape) -> None:
        rows = {roller.name: row for row, roller in enumerate(model.line_rollers)}
        beside = {cell: (shape.numbered(rows[cell]), shape.numbered(rows[cell] + 1)) for cell in shape.cells}
        self._cells = [(f"F_{cell}_meas_N", f"F{a}_true_N", f"F{b}_true_N") for cell, (a, b) in beside.items()]

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Python's stage that writes the readings."""
        return CompiledStages(after=[python_stage(partial(self._write, sample))])

    def _write(self, sample: CycleSample) -> None:
        for cell, before, behind in self._cells:
            setattr(sample, cell, 0.5 * (getattr(sample, before) + getattr(sample, behind)))
