"""Reel in torque mode: its torque from the load cell next to it, plus feed-forward of pull and acceleration."""

from __future__ import annotations

from functools import partial

from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CompiledStages, Outputs, SensedLoop, StagedTask
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.bench.tasks.web_roller_motion import RollerMotion
from hilbench.bench.tasks.web_winding_control import ReelMechanics, ReelTension
from hilbench.cycle_program import python_stage
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import ReelControlConfig, span_beside_reel
from hilbench.topology.web_line_quantities import tension_set_point


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
