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
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Record,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    load,
    merged,
    record_type,
    records,
    rows_of,
    table_of,
)
from hilbench.cycle_program import CompiledStage
from hilbench.estimation.bank import Places
from hilbench.estimation.web_line import balance, rollers, torque_shift
from hilbench.estimation.web_line import span_estimator_cycle as cycle
from hilbench.estimation.web_line.rollers import RollerArrays, Rollers
from hilbench.estimation.web_line.span_estimator import SpanEstimator
from hilbench.estimation.web_line.span_estimator_cycle import SpanEstimatorArrays, run_arrays
from hilbench.estimation.web_line.splices import SUMS
from hilbench.estimation.web_line.synchronizers import filters
from hilbench.plant import sample_coherence
from hilbench.plant.sample_coherence import IncrementCheck, SampleCoherence, coherent, increments_steadily
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_vectors, rig_cycle
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_vectors import LineVectors
from hilbench.plant.web_line.simulated import LineStep
from hilbench.twin.machines import web_splice_tracker
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, MachineVectors
from hilbench.twin.machines.web_section import WebSection
from hilbench.twin.machines.web_splice_tracker import TRACKER, SpliceTracker
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED, TRANSFER_REFUSED

#: Stages to resume at after an interpreted part: next span; end of the cycle with compared measurements, or without.
#: `run` returns an interpreted stage of `span_estimator_cycle`, or one of these.
_NEXT_SPAN, _FINISH, _FINISH_WITHOUT, _UNPAIRED, PASSAGE, _DONE, _LOOK, _WITHOUT = range(cycle.DONE + 1, cycle.DONE + 9)
#: Machine result of each final code.
_ENDS = {_DONE: WENT_ON, _LOOK: LOOK, _WITHOUT: MISSED}

#: Least travel of the coherence check, drive samples of a cycle, cycle time; upstream-strain correction of an
#: interpreted method; flags: torques are corrected for their ripple, splices are tracked. Span of an interpreted part,
#: from 0, and the status of the last SYNC.
_FIGURES: Final = record_type(
    *("least_travel_m", "samples", "cycle_s", "input_strain", "ripples", "tracks_splices"), *("at_span", "status")
)
#: Of each span: deviation up to which E counts as known; separable flag of an interpreted method; strain of the
#: entering web; torque residual; last reported torque shift and undecided flag.
_SPAN: Final = record_type("known_pct", "separable", "strain_before", "residual_Nm", "shift_Nm", "undecided")
#: Places in the values of stated strain upstream and tension downstream; in the integers of SYNC number and status.
_AT: Final = record_type("strain_prev", "F_next_N", "number", "status", of=np.int64)
#: Places in the values of the outputs of a span.
_PUBLISHED: Final = record_type(
    *("F_sim_N", "E_sim_Pa", "E_deviation_Pa", "torque_sim_Nm", "torque_residual_Nm"), of=np.int64
)
#: Size of an axis's measurement, and offset of the torque in it and in a motor's feedback.
_MEASURED_SIZE, _TORQUE = 4, 2
_NUMBERS = 0x10000


class _LineArrays(NamedTuple):
    """A line with its rollers and spans; `measured` to `shown` and `values`, `whole` as of `MachineVectors`. In its
    table the arrays of the span estimators follow."""

    travels: Reals  #: state of the coherence check
    steady: Reals  #: state of `increments_steadily`
    figures: Annotated[Any, _FIGURES]
    spans: Annotated[Any, records(_SPAN)]
    rad_per_m: Reals  #: of the motors, at the web
    positions_m: Reals
    torques_Nm: Reals
    measured: Reals
    asked: Reals
    shown: Reals
    motors: Wholes
    sensors: Reals
    silence: Reals
    values: Reals
    whole: Wholes
    at: Annotated[Any, _AT]
    published: Annotated[Any, records(_PUBLISHED)]
    rollers: RollerArrays
    tracker: Annotated[Any, TRACKER]
    sums: Annotated[Any, SUMS]
    line: LineVectors


_OWN: Final = rows_of(_LineArrays)


@merged
def _of_span(table: Places, k: int) -> SpanEstimatorArrays:
    """Arrays of a span's estimator, from 0."""
    return arrays_in(table[_OWN + k * cycle.ROWS :], SpanEstimatorArrays)


@compiled
def _torque_of_motors_Nm(shown: Vector, rad_per_m: Vector, span: int) -> float:
    """Compiled `WebSection.torque_Nm`."""
    total_Nm = 0.0
    for axis in range(span + 1, len(rad_per_m)):
        total_Nm += shown[rig_cycle.SHOWN * axis + _TORQUE] * (rad_per_m[axis] / rad_per_m[span + 1])
    return total_Nm


@compiled
def _measured(a: _LineArrays) -> bool:
    """Read positions and torques; True if the positions are coherent (of one instant)."""
    x_m, measured, rad_per_m, figures = a.positions_m, a.measured, a.rad_per_m, a.figures
    for axis in range(len(x_m)):
        x_m[axis] = measured[_MEASURED_SIZE * axis] * (1.0 / rad_per_m[axis])
    if not coherent(a.travels, x_m, figures.least_travel_m):
        a.steady[sample_coherence.STEADY_MISSED] += 1.0
        return False
    if not increments_steadily(a.steady, x_m[1]):
        return False
    if figures.ripples != 0.0:  # as `WebLineTwin.compare`
        torques_Nm = a.torques_Nm
        line_vectors.put_torque_ripples(a.line.p, a.line.s, a.motors, int(figures.samples), torques_Nm)
        for axis in range(len(x_m)):
            torques_Nm[axis] += measured[_MEASURED_SIZE * axis + _TORQUE]
        if len(x_m) > 2:
            rollers.take(a.rollers, x_m, torques_Nm, figures.cycle_s)
    return True


@compiled
def _compare(a: _LineArrays, table: Places, first: int, strain_prev: float, F_next_N: float) -> int:
    """Compare the spans from this one on (from 0); returns the stage that needs the interpreter, or _FINISH."""
    spans, rad_per_m, shown, x_m = a.spans, a.rad_per_m, a.shown, a.positions_m
    for k in range(first, len(spans)):
        of_span, strain_before, creep_ratio = table[_OWN + k * cycle.ROWS :], strain_prev, 0.0
        t, at = _of_span(table, k).t, rig_cycle.SHOWN * (k + 1) + _TORQUE
        if k > 0:
            before = _of_span(table, k - 1)
            strain_before = cycle.outlet_strain(before.t, balance.strain(before.balance))
            creep_ratio = before.t.creep_ratio
            if before.t.moved != 0.0:
                _show(a)
        torque_Nm, centre_m = a.measured[_MEASURED_SIZE * (k + 1) + _TORQUE], nan
        spans[k].residual_Nm = torque_Nm - t.shift_Nm - shown[at]
        if a.figures.ripples != 0.0:
            torque_Nm = a.torques_Nm[k + 1]
        if len(spans) > 1:
            torque_Nm += rollers.force_behind_N(a.rollers, k + 2) / rad_per_m[k + 1]
            centre_m = rollers.centre_m(a.rollers, k + 2)
        torque_sim_Nm = _torque_of_motors_Nm(shown, rad_per_m, k)
        strain_behind = nan
        if k + 1 < len(spans):
            behind = _of_span(table, k + 1)
            strain_behind = cycle.reverse_outlet_strain(behind.t, balance.strain(behind.balance))
        around = strain_before, F_next_N, centre_m, strain_behind, creep_ratio
        compared = x_m[k], x_m[k + 1], torque_Nm, torque_sim_Nm, *around
        stage = run_arrays(cycle.COMPARE, compared, of_span)
        if stage != cycle.DONE:
            a.figures.at_span, spans[k].strain_before = k, strain_before
            return stage
    if a.figures.tracks_splices != 0.0:
        v = _of_span(table, 0)
        if not web_splice_tracker.passes(a.tracker, a.sums, v.t, balance.strain(v.balance), x_m[0]):
            return PASSAGE
    return _FINISH


@compiled
def _show(a: _LineArrays) -> None:
    """Update the motors' feedback after a change of state."""
    rig_cycle.show(a.line.p, a.line.s, a.line.out, a.motors, a.sensors, a.silence, a.shown)


@compiled
def _go_on(a: _LineArrays, strain_prev: float, F_next_N: float) -> None:
    """Step the line."""
    p, s, u, work, out = a.line
    u[lay.U_STRAIN_PREV], u[lay.U_F_NEXT_N] = strain_prev + a.figures.input_strain, F_next_N
    samples = int(a.figures.samples)
    rig_cycle.step(p, s, u, work, out, a.motors, a.asked, samples, a.sensors, a.silence, a.shown)


@compiled
def _publish(a: _LineArrays, t: Record, k: int) -> None:
    """Compiled `WebLineTwin.published` of a span, from 0, of a line without effects on E."""
    at, values, factor = a.published[k], a.values, t.series_factor
    values[at.F_sim_N] = a.line.out[3 * int(a.line.p[lay.W_MOTORS]) + k]
    values[at.E_sim_Pa] = factor * t.modulus_Pa
    values[at.E_deviation_Pa] = factor * t.deviation_Pa
    values[at.torque_sim_Nm] = a.shown[rig_cycle.SHOWN * (k + 1) + _TORQUE]
    values[at.torque_residual_Nm] = a.spans[k].residual_Nm


@compiled
def _status(a: _LineArrays, table: Places) -> int:
    """Compiled `TwinApplication._status` of a released machine with its configured model."""
    synchronized, status = SYNCHRONIZED, RUNNING
    for k in range(len(a.spans)):
        v = _of_span(table, k)
        t = v.t
        if not cycle.is_synchronized(t, a.spans[k].known_pct):
            synchronized = 0
        if t.problem != 0.0:
            status |= HOLDING
        if t.refused != 0.0:
            status |= TRANSFER_REFUSED
        separable = filters.separable(v.filters) if t.bank != 0.0 else a.spans[k].separable != 0.0
        if not separable:
            status |= NOT_SEPARABLE
    return status | synchronized


@compiled
def _is_published(a: _LineArrays, table: Places) -> bool:
    """True if the last torque report is still valid."""
    spans, boundary = a.spans, True
    for k in range(len(spans)):
        v = _of_span(table, k)
        shift_Nm = v.t.shift_Nm
        undecided = 1.0 if torque_shift.undecided(v.shift) else 0.0
        boundary = boundary and spans[k].shift_Nm == shift_Nm and spans[k].undecided == undecided
        spans[k].shift_Nm, spans[k].undecided = shift_Nm, undecided
    return boundary


@entry_point(COUNT, TABLE)
def _run(stage: int, table: Places) -> int:
    a = arrays_in(table, _LineArrays)
    at, whole = a.at, a.whole
    strain_prev, F_next_N = a.values[at.strain_prev], a.values[at.F_next_N]
    if stage == cycle.COMPARE and not _measured(a):
        return _UNPAIRED
    if stage == cycle.COMPARE or stage == _NEXT_SPAN:
        first = 0 if stage == cycle.COMPARE else int(a.figures.at_span) + 1
        stage = _compare(a, table, first, strain_prev, F_next_N)
        if stage != _FINISH:
            return stage
    _go_on(a, strain_prev, F_next_N)
    for k in range(len(a.spans)):
        _publish(a, _of_span(table, k).t, k)
    status = _status(a, table)
    a.figures.status, whole[at.status] = whole[at.status], status
    whole[at.number] = (whole[at.number] + 1) % _NUMBERS
    if stage == _FINISH_WITHOUT:
        return _WITHOUT
    return _DONE if _is_published(a, table) and not status & (HOLDING | TRANSFER_REFUSED) else _LOOK


def warm_up() -> None:
    """Compile, or load, the cycle in advance."""
    load(_run)


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
        figures = least_travel_m, line.samples, cycle_s, 0.0, ripples, passage is not None, 0.0, 0.0
        self._figures = np.array([figures], _FIGURES)
        known = [(each.tracking.config.synchronized_pct, each.residual_Nm) for each in estimated]
        self._spans = np.array([(pct, 1.0, 0.0, residual_Nm, nan, nan) for pct, residual_Nm in known], _SPAN)
        boundary = vectors.boundary_places["strain_prev"], vectors.boundary_places["F_next_N"]
        tracker, sums = (np.zeros(1, TRACKER), np.zeros(1, SUMS)) if passage is None else passage.arrays
        self._own = _LineArrays(
            *(travels, steady.state, self._figures, self._spans, np.array(rad_per_m)),
            *(positions_m, np.zeros(len(rad_per_m)), vectors.measured, vectors.asked, vectors.shown),
            *(line.motors, line.sensors, line.silence, vectors.values, vectors.whole),
            np.array([(*boundary, vectors.number, vectors.status)], _AT),
            np.array(vectors.published, np.int64).view(_PUBLISHED),
            of_rollers.arrays,
            tracker,
            sums,
            estimated[0].section.vectors,
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
        self._figures["input_strain"] = self._estimated[0].tracking.input_strain
        self._spans["separable"] = [each.tracking.separable for each in self._estimated]

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
            span = int(self._figures["at_span"][0])
            strain_before = float(self._spans["strain_before"][span])
            self._estimated[span].tracking.go_on_from(stage, strain_before)
            behind = _NEXT_SPAN
        self._take_method()
        return _run(behind, self._table)

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        for each, residual_Nm in zip(self._estimated, self._spans["residual_Nm"].tolist(), strict=True):
            each.tracking.has_advanced()
            each.residual_Nm = residual_Nm
        return int(self._figures["status"][0])
