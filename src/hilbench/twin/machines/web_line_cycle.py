"""Compiled cycle of the twin of a web line: `WebLineTwin.compare`, `listen`, the step of its line and `published`, with
the `TwinApplication` status for the next SYNC.

It runs in stages as `span_estimator_cycle.run` does: it returns the stage of a rare event, the interpreter does its
part, and calls it again from the following stage. All state is in vectors, addressed by a table: those of the line,
then those of each span with its rollers, one span after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, compiled, entry_point, floats, integers, table_of
from hilbench.cycle_program import CompiledStage
from hilbench.estimation.web_line import rollers, torque_shift
from hilbench.estimation.web_line import span_estimator_cycle as cycle
from hilbench.estimation.web_line.rollers import Rollers
from hilbench.estimation.web_line.span_estimator import SpanEstimator
from hilbench.estimation.web_line.span_estimator_cycle import run_vectors
from hilbench.estimation.web_line.synchronizers import changepoint
from hilbench.plant import sample_coherence
from hilbench.plant.sample_coherence import IncrementCheck, SampleCoherence, coherent, increments_steadily
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_vectors, rig_cycle
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.simulated import LineStep
from hilbench.twin.machines import web_splice_tracker
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, MachineVectors
from hilbench.twin.machines.web_section import WebSection
from hilbench.twin.machines.web_splice_tracker import SpliceTracker
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED, TRANSFER_REFUSED

Places = NDArray[np.int64]
Matrix = NDArray[np.float64]

#: Stages to resume at after an interpreted part: next span; end of the cycle with compared measurements, or without.
#: `run` returns an interpreted stage of `span_estimator_cycle`, or one of these.
_NEXT_SPAN, _FINISH, _FINISH_WITHOUT, _UNPAIRED, PASSAGE, _DONE, _LOOK, _WITHOUT = range(cycle.DONE + 1, cycle.DONE + 9)
#: Machine result of each final code.
_ENDS = {_DONE: WENT_ON, _LOOK: LOOK, _WITHOUT: MISSED}

# Rows of the table; after them those of the span estimators.
(
    _TRAVELS,
    _STEADY,
    _FIGURES,
    _SPANS,
    _RAD_PER_M,
    _OUTPUTS,
    _POSITIONS,
    _TORQUES,
    _MEASURED,
    _ASKED,
    _SHOWN,
    _MOTORS,
    _SENSORS,
    _SILENCE,
    _VALUES,
    _WHOLE,
    _AT,
    _ROLLERS,
    _MASSES,
    _OF_ROLLERS,
    _OF_PASSAGE,
    _OF_BLOCK,
    _OWN,
) = range(23)
#: Parameters, state, inputs, scratch space and outputs of the line, among those of the first estimator.
_LINE = _OWN + cycle.LINE_ROW
#: Figures: least travel of the coherence check, drive samples of a cycle, cycle time; upstream-strain correction of an
#: interpreted method; torque ripple correction flag.
_LEAST_TRAVEL_M, _SAMPLES, _CYCLE_S, _INPUT_STRAIN, _RIPPLES = range(5)
#: Of each span (K, 6): deviation up to which E counts as known; separable flag of an interpreted method; strain of the
#: entering web; torque residual; last reported torque shift and undecided flag.
_KNOWN_PCT, _SEPARABLE, _STRAIN_BEFORE, _RESIDUAL_NM, _SHIFT_NM, _UNDECIDED = range(6)
#: Outputs: the span of an interpreted part, from 0, and the status of the last SYNC.
_AT_SPAN, _STATUS = range(2)
#: Offsets in the values: stated strain upstream and tension downstream, then the outputs of each span; in the integers:
#: SYNC number and status.
_STRAIN_PREV, _F_NEXT_N, _NUMBER, _STATUS_AT, _PUBLISHED = range(5)
_F_SIM_N, _E_SIM_PA, _E_DEVIATION_PA, _TORQUE_SIM_NM, _TORQUE_RESIDUAL_NM, _COUNT_PUBLISHED = range(6)
#: Size of an axis's measurement, and offset of the torque in it and in a motor's feedback.
_MEASURED_SIZE, _TORQUE = 4, 2
_NUMBERS = 0x10000


@compiled
def _torque_of_motors_Nm(shown: Vector, rad_per_m: Vector, span: int) -> float:
    """Compiled `WebSection.torque_Nm`."""
    total_Nm = 0.0
    for axis in range(span + 1, len(rad_per_m)):
        total_Nm += shown[rig_cycle.SHOWN * axis + _TORQUE] * (rad_per_m[axis] / rad_per_m[span + 1])
    return total_Nm


@compiled
def _measured(table: Places) -> bool:
    """Read positions and torques; True if the positions are coherent (of one instant)."""
    x_m, measured, rad_per_m = (
        floats(table, _POSITIONS, (1,)),
        floats(table, _MEASURED, (1,)),
        floats(table, _RAD_PER_M, (1,)),
    )
    steady, figures = floats(table, _STEADY, (1,)), floats(table, _FIGURES, (1,))
    for axis in range(len(x_m)):
        x_m[axis] = measured[_MEASURED_SIZE * axis] * (1.0 / rad_per_m[axis])
    if not coherent(floats(table, _TRAVELS, (1,)), x_m, figures[_LEAST_TRAVEL_M]):
        steady[sample_coherence.STEADY_MISSED] += 1.0
        return False
    if not increments_steadily(steady, x_m[1]):
        return False
    if figures[_RIPPLES] != 0.0:  # as `WebLineTwin.compare`
        torques_Nm, p, s = floats(table, _TORQUES, (1,)), floats(table, _LINE, (1,)), floats(table, _LINE + 1, (1,))
        line_vectors.put_torque_ripples(p, s, integers(table, _MOTORS, (1,)), int(figures[_SAMPLES]), torques_Nm)
        for axis in range(len(x_m)):
            torques_Nm[axis] += measured[_MEASURED_SIZE * axis + _TORQUE]
        if len(x_m) > 2:
            of_rollers = floats(table, _OF_ROLLERS, (1,))
            rollers.take(floats(table, _ROLLERS, (1, 2)), of_rollers, x_m, torques_Nm, figures[_CYCLE_S])
    return True


@compiled
def _compare(table: Places, first: int, strain_prev: float, F_next_N: float) -> int:
    """Compare the spans from this one on (from 0); returns the stage that needs the interpreter, or _FINISH."""
    spans, rad_per_m = floats(table, _SPANS, (1, 2)), floats(table, _RAD_PER_M, (1,))
    shown, x_m = floats(table, _SHOWN, (1,)), floats(table, _POSITIONS, (1,))
    measured, torques_Nm = floats(table, _MEASURED, (1,)), floats(table, _TORQUES, (1,))
    masses_kg, of_rollers = floats(table, _MASSES, (1,)), floats(table, _OF_ROLLERS, (1,))
    for k in range(first, len(spans)):
        of_span, strain_before, creep_ratio = table[_OWN + k * cycle.ROWS :], strain_prev, 0.0
        t, at = floats(of_span, cycle.STATE_ROW, (1,)), rig_cycle.SHOWN * (k + 1) + _TORQUE
        if k > 0:
            before = table[_OWN + (k - 1) * cycle.ROWS :]
            t_before = floats(before, cycle.STATE_ROW, (1,))
            strain_before = cycle.outlet_strain(t_before, cycle.measured_strain(before))
            creep_ratio = t_before[cycle.CREEP_RATIO]
            if t_before[cycle.MOVED] != 0.0:
                _show(table)
        torque_Nm, centre_m = measured[_MEASURED_SIZE * (k + 1) + _TORQUE], nan
        spans[k, _RESIDUAL_NM] = torque_Nm - t[cycle.SHIFT_NM] - shown[at]
        if floats(table, _FIGURES, (1,))[_RIPPLES] != 0.0:
            torque_Nm = torques_Nm[k + 1]
        if len(spans) > 1:
            torque_Nm += rollers.force_behind_N(masses_kg, of_rollers, k + 2) / rad_per_m[k + 1]
            centre_m = rollers.centre_m(masses_kg, of_rollers, k + 2)
        torque_sim_Nm = _torque_of_motors_Nm(shown, rad_per_m, k)
        strain_behind = nan
        if k + 1 < len(spans):
            behind = table[_OWN + (k + 1) * cycle.ROWS :]
            t_behind = floats(behind, cycle.STATE_ROW, (1,))
            strain_behind = cycle.reverse_outlet_strain(t_behind, cycle.measured_strain(behind))
        around = strain_before, F_next_N, centre_m, strain_behind, creep_ratio
        compared = x_m[k], x_m[k + 1], torque_Nm, torque_sim_Nm, *around
        stage = run_vectors(cycle.COMPARE, compared, of_span)
        if stage != cycle.DONE:
            floats(table, _OUTPUTS, (1,))[_AT_SPAN], spans[k, _STRAIN_BEFORE] = k, strain_before
            return stage
    of_passage = floats(table, _OF_PASSAGE, (1,))
    if len(of_passage) > 0:
        block, t = floats(table, _OF_BLOCK, (1,)), floats(table, _OWN + cycle.STATE_ROW, (1,))
        if not web_splice_tracker.passes(of_passage, block, t, cycle.measured_strain(table[_OWN:]), x_m[0]):
            return PASSAGE
    return _FINISH


@compiled
def _show(table: Places) -> None:
    """Update the motors' feedback after a change of state."""
    p, s, out = floats(table, _LINE, (1,)), floats(table, _LINE + 1, (1,)), floats(table, _LINE + 4, (1,))
    motors, sensors, silence = (
        integers(table, _MOTORS, (1,)),
        floats(table, _SENSORS, (1,)),
        floats(table, _SILENCE, (1,)),
    )
    rig_cycle.show(p, s, out, motors, sensors, silence, floats(table, _SHOWN, (1,)))


@compiled
def _go_on(table: Places, strain_prev: float, F_next_N: float) -> None:
    """Step the line."""
    p, s, u = floats(table, _LINE, (1,)), floats(table, _LINE + 1, (1,)), floats(table, _LINE + 2, (1,))
    work, out, figures = floats(table, _LINE + 3, (1,)), floats(table, _LINE + 4, (1,)), floats(table, _FIGURES, (1,))
    u[lay.U_STRAIN_PREV], u[lay.U_F_NEXT_N] = strain_prev + figures[_INPUT_STRAIN], F_next_N
    motors, asked, shown = integers(table, _MOTORS, (1,)), floats(table, _ASKED, (1,)), floats(table, _SHOWN, (1,))
    sensors, silence = floats(table, _SENSORS, (1,)), floats(table, _SILENCE, (1,))
    rig_cycle.step(p, s, u, work, out, motors, asked, int(figures[_SAMPLES]), sensors, silence, shown)


@compiled
def _publish(table: Places, k: int) -> None:
    """Compiled `WebLineTwin.published` of a span, from 0, of a line without effects on E."""
    t = floats(table, _OWN + k * cycle.ROWS + cycle.STATE_ROW, (1,))
    at, values, first = integers(table, _AT, (1,)), floats(table, _VALUES, (1,)), _PUBLISHED + k * _COUNT_PUBLISHED
    tension, factor = 3 * int(floats(table, _LINE, (1,))[lay.W_MOTORS]) + k, t[cycle.SERIES_FACTOR]
    values[at[first + _F_SIM_N]] = floats(table, _LINE + 4, (1,))[tension]
    values[at[first + _E_SIM_PA]] = factor * t[cycle.MODULUS_PA]
    values[at[first + _E_DEVIATION_PA]] = factor * t[cycle.DEVIATION_PA]
    values[at[first + _TORQUE_SIM_NM]] = floats(table, _SHOWN, (1,))[rig_cycle.SHOWN * (k + 1) + _TORQUE]
    values[at[first + _TORQUE_RESIDUAL_NM]] = floats(table, _SPANS, (1, 2))[k, _RESIDUAL_NM]


@compiled
def _separable(of_span: Places) -> bool:
    """True if the bank separates all nuisance parameters."""
    inputs, mixture = floats(of_span, cycle.BANK_INPUTS_ROW, (1,)), floats(of_span, cycle.BANK_OUT_ROW, (1, 2))
    return changepoint.separable(inputs, integers(of_span, cycle.BANK_PLACES_ROW, (1,)), mixture)


@compiled
def _status(table: Places) -> int:
    """Compiled `TwinApplication._status` of a released machine with its configured model."""
    spans, synchronized, status = floats(table, _SPANS, (1, 2)), SYNCHRONIZED, RUNNING
    for k in range(len(spans)):
        of_span = table[_OWN + k * cycle.ROWS :]
        t = floats(of_span, cycle.STATE_ROW, (1,))
        if not cycle.is_synchronized(t, spans[k, _KNOWN_PCT]):
            synchronized = 0
        if t[cycle.PROBLEM] != 0.0:
            status |= HOLDING
        if t[cycle.REFUSED] != 0.0:
            status |= TRANSFER_REFUSED
        separable = _separable(of_span) if t[cycle.BANK] != 0.0 else spans[k, _SEPARABLE] != 0.0
        if not separable:
            status |= NOT_SEPARABLE
    return status | synchronized


@compiled
def _is_published(table: Places) -> bool:
    """True if the last torque report is still valid."""
    spans, boundary = floats(table, _SPANS, (1, 2)), True
    for k in range(len(spans)):
        of_span = table[_OWN + k * cycle.ROWS :]
        shift_Nm = floats(of_span, cycle.STATE_ROW, (1,))[cycle.SHIFT_NM]
        undecided = 1.0 if torque_shift.undecided(floats(of_span, cycle.SHIFT_ROW, (1,))) else 0.0
        boundary = boundary and spans[k, _SHIFT_NM] == shift_Nm and spans[k, _UNDECIDED] == undecided
        spans[k, _SHIFT_NM], spans[k, _UNDECIDED] = shift_Nm, undecided
    return boundary


@entry_point(COUNT, TABLE)
def _run(stage: int, table: Places) -> int:
    if stage < 0:
        return stage
    outputs, whole, at = floats(table, _OUTPUTS, (1,)), integers(table, _WHOLE, (1,)), integers(table, _AT, (1,))
    values = floats(table, _VALUES, (1,))
    strain_prev, F_next_N = values[at[_STRAIN_PREV]], values[at[_F_NEXT_N]]
    if stage == cycle.COMPARE and not _measured(table):
        return _UNPAIRED
    if stage == cycle.COMPARE or stage == _NEXT_SPAN:
        stage = _compare(table, 0 if stage == cycle.COMPARE else int(outputs[_AT_SPAN]) + 1, strain_prev, F_next_N)
        if stage != _FINISH:
            return stage
    _go_on(table, strain_prev, F_next_N)
    for k in range(len(floats(table, _SPANS, (1, 2)))):
        _publish(table, k)
    status = _status(table)
    outputs[_STATUS], whole[at[_STATUS_AT]] = whole[at[_STATUS_AT]], status
    whole[at[_NUMBER]] = (whole[at[_NUMBER]] + 1) % _NUMBERS
    if stage == _FINISH_WITHOUT:
        return _WITHOUT
    return _DONE if _is_published(table) and not status & (HOLDING | TRANSFER_REFUSED) else _LOOK


def warm_up() -> None:
    """Compile, or load, the cycle in advance."""
    _run(-1, np.zeros((1, 1), np.int64))


@dataclass(slots=True)
class EstimatedSpan:
    """Span with an estimator of E."""

    span: int
    section: WebSection
    tracking: SpanEstimator
    residual_Nm: float = 0.0  #: torque of the axis after it, measured less simulated


class LineInVectors:
    """Runner of a `WebLineTwin` in vectors; see `machine.InVectors`.

    `estimated` (K,): all spans; `rad_per_m` (N,): of the motors, at the web; `ripples`: torques are corrected for their
    ripple; `passage`: None without splice tracking.
    """

    def __init__(
        self,
        estimated: Sequence[EstimatedSpan],
        pairing_of_axes: SampleCoherence,
        steady: IncrementCheck,
        line: LineStep,
        rad_per_m: Sequence[float],
        least_travel_m: float,
        cycle_s: float,
        ripples: bool,
        of_rollers: Rollers,
        passage: SpliceTracker | None,
        vectors: MachineVectors,
        fallback: Callable[[int], bool],
    ) -> None:
        self._fallback = fallback
        self._estimated, self._splice_tracker, self._values = estimated, passage, vectors.values
        travels, positions_m = pairing_of_axes.vectors(len(rad_per_m))
        self._positions_m = positions_m
        self._figures = np.array([least_travel_m, float(line.samples), cycle_s, 0.0, float(ripples)])
        known = [(each.tracking.config.synchronized_pct, each.residual_Nm) for each in estimated]
        self._spans = np.array([(pct, 1.0, 0.0, residual_Nm, nan, nan) for pct, residual_Nm in known])
        self._outputs = np.zeros(_STATUS + 1)
        boundary = vectors.boundary_places["strain_prev"], vectors.boundary_places["F_next_N"]
        self._at = np.array([*boundary, vectors.number, vectors.status, *vectors.published], np.int64)
        nothing = np.zeros(0)
        self._own = (
            *(travels, steady.state, self._figures, self._spans, np.array(rad_per_m), self._outputs),
            *(positions_m, np.zeros(len(rad_per_m)), vectors.measured, vectors.asked, vectors.shown),
            *(line.motors, line.sensors, line.silence, vectors.values, vectors.whole, self._at),
            *(of_rollers.p, of_rollers.masses_kg, of_rollers.state),
            *((nothing, nothing) if passage is None else passage.vectors),
        )
        self._of, self._table = [each.tracking.table for each in estimated], np.zeros((0, 0), np.int64)
        self._take_method()

    def _take_method(self) -> None:
        """Update the table after a change of methods or their vectors."""
        tables = [each.tracking.table for each in self._estimated]
        if not len(self._table) or any(now is not then for now, then in zip(tables, self._of, strict=True)):
            self._of = tables
            self._table = np.concatenate([table_of(self._own), *tables])
            self.piece = CompiledStage(
                _run, cycle.COMPARE, self._own, continues=_DONE, fallback=self._fallback, table=self._table
            )
        self._figures[_INPUT_STRAIN] = self._estimated[0].tracking.input_strain
        self._spans[:, _SEPARABLE] = [each.tracking.separable for each in self._estimated]

    def has_ended(self, code: int) -> bool:
        """True if the cycle was completed; see `machine.InVectors`."""
        return code in _ENDS

    def go_on_from(self, code: int) -> int:
        """Run the rest of a cycle; see `machine.InVectors`."""
        while code not in _ENDS:
            code = self._go_on_by_objects(code)
        return _ENDS[code]

    def _go_on_by_objects(self, stage: int) -> int:
        """Run an interpreted stage, then the compiled ones after it."""
        for each in self._estimated:
            each.tracking.has_advanced()
        if stage == _UNPAIRED:
            for each in self._estimated:
                each.tracking.miss()
            behind = _FINISH_WITHOUT
        elif stage == PASSAGE:
            assert self._splice_tracker is not None, "it said so"
            self._splice_tracker.update(self._positions_m.tolist())
            behind = _FINISH
        else:
            span = int(self._outputs.item(_AT_SPAN))
            strain_before = self._spans.item(span, _STRAIN_BEFORE)
            self._estimated[span].tracking.go_on_from(stage, strain_before)
            behind = _NEXT_SPAN
        self._take_method()
        return _run(behind, self._table)

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        for each, residual_Nm in zip(self._estimated, self._spans[:, _RESIDUAL_NM].tolist(), strict=True):
            each.tracking.has_advanced()
            each.residual_Nm = residual_Nm
        return int(self._outputs.item(_STATUS))
