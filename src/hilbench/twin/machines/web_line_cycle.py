"""Compiled cycle of the twin of a web line: the comparison with the measurements; in vectors also `listen`, the step of
its line and `published`, with the `TwinApplication` status for the next SYNC.

It runs in stages as `span_estimator_cycle` does: it returns the stage of a rare event, the interpreter does its part,
and calls it again from the following stage. All state is in vectors, addressed by a table: those of the line, then
those of each span with its rollers, one span after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isnan, nan
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    interpreted,
    merged,
    record_in,
    record_type,
    rows_of,
    table_of,
)
from hilbench.compiled import records as array_of
from hilbench.cycle_program import CompiledStage, never
from hilbench.estimation.bank import Places
from hilbench.estimation.web_line import balance, rollers, torque_shift
from hilbench.estimation.web_line import span_estimator_cycle as cycle
from hilbench.estimation.web_line.rollers import RollerArrays, Rollers
from hilbench.estimation.web_line.span_estimator import SpanEstimator
from hilbench.estimation.web_line.span_estimator_cycle import SpanEstimatorArrays, run_arrays
from hilbench.estimation.web_line.splices import SUMS
from hilbench.estimation.web_line.synchronizers import filters
from hilbench.plant.motor_port import FEEDBACK_SIZE, TORQUE
from hilbench.plant.sample_coherence import COHERENCE, SampleCoherence, coherent
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_vectors, records, rig_cycle
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_vectors import LineVectors
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig_cycle import RigArrays
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.twin.machines import web_splice_tracker
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, MachineVectors
from hilbench.twin.machines.web_other_spans import OtherSpans
from hilbench.twin.machines.web_splice_tracker import TRACKER, SpliceTracker
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED, TRANSFER_REFUSED

#: Stages to resume at after an interpreted part: the same span, or the next one; end of the cycle with compared
#: measurements, or without. Stages for the interpreter, beside those of `span_estimator_cycle`: positions of different
#: instants; spans without an estimator; a span whose web is not placed yet; a splice. Then the final codes.
_SAME_SPAN, _NEXT_SPAN, _FINISH, _FINISH_WITHOUT = range(cycle.DONE + 1, cycle.DONE + 5)
_UNPAIRED, _OTHERS, _PLACE, PASSAGE = range(_FINISH_WITHOUT + 1, _FINISH_WITHOUT + 5)
_COMPARED, _DONE, _LOOK, _WITHOUT = range(PASSAGE + 1, PASSAGE + 5)
#: Machine result of each final code.
_ENDS = {_COMPARED: WENT_ON, _DONE: WENT_ON, _LOOK: LOOK, _WITHOUT: MISSED}

#: Least travel of the coherence check, drive samples of a cycle, cycle time; upstream-strain correction of an
#: interpreted method; flags: torques are corrected for their ripple, splices are tracked, there are spans without an
#: estimator, the line is stepped by its object. Estimator of an interpreted part, from 0, and the status of the last
#: SYNC.
_FIGURES: Final = record_type(
    *("least_travel_m", "samples", "cycle_s", "input_strain", "ripples", "tracks_splices", "has_others", "by_object"),
    *("at_span", "status"),
)
#: Of each span with an estimator: its index, from 0; strain of the web before and after it, and creep ratio there,
#: where its neighbour has none (NaN: it has); deviation up to which E counts as known; separable flag of an interpreted
#: method; strain of the entering web; torque residual; last reported torque shift and undecided flag.
_SPAN: Final = record_type(
    *("place", "before_strain", "before_creep", "behind_strain", "known_pct", "separable", "strain_before"),
    *("residual_Nm", "shift_Nm", "undecided"),
)
#: Places in the values of stated strain upstream and tension downstream; in the integers of SYNC number and status.
_AT: Final = record_type("strain_prev", "F_next_N", "number", "status", of=np.int64)
#: Places in the values of the outputs of a span.
_PUBLISHED: Final = record_type(
    *("F_sim_N", "E_sim_Pa", "E_deviation_Pa", "torque_sim_Nm", "torque_residual_Nm"), of=np.int64
)
#: Size of an axis's measurement, in which the torque has the place that it has in a motor's feedback.
_MEASURED_SIZE = 4
_NUMBERS = 0x10000


class _LineArrays(NamedTuple):
    """A line with its rollers and spans; `measured` to `shown` and `values`, `whole` as of `MachineVectors`. In its
    table the arrays of the span estimators follow."""

    travels: Reals  #: state of the coherence check
    figures: Annotated[Any, _FIGURES]
    spans: Annotated[Any, array_of(_SPAN)]
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
    published: Annotated[Any, array_of(_PUBLISHED)]
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
def _measured(a: _LineArrays) -> bool:
    """Read positions and torques; True if the positions are coherent (of one instant)."""
    x_m, measured, rad_per_m, figures = a.positions_m, a.measured, a.rad_per_m, a.figures
    for axis in range(len(x_m)):
        x_m[axis] = measured[_MEASURED_SIZE * axis] * (1.0 / rad_per_m[axis])
    if not coherent(a.travels, x_m, figures.least_travel_m) or record_in(a.travels, 0, COHERENCE).is_steady == 0.0:
        return False
    torques_Nm = a.torques_Nm
    if figures.ripples != 0.0:
        line_vectors.torque_ripples(a.line.p, a.line.s, a.motors, int(figures.samples), torques_Nm)
    for axis in range(len(x_m)):
        torque_Nm = measured[_MEASURED_SIZE * axis + TORQUE]
        torques_Nm[axis] = torque_Nm + torques_Nm[axis] if figures.ripples != 0.0 else torque_Nm
    if len(x_m) > 2:
        rollers.take(a.rollers, x_m, torques_Nm, figures.cycle_s)
    return True


@compiled
def _compare(a: _LineArrays, table: Places, first: int, strain_prev: float, F_next_N: float) -> int:
    """Compare the spans with estimators from this one on (from 0); returns the stage that needs the interpreter, or
    _FINISH."""
    spans, rad_per_m, shown, x_m = a.spans, a.rad_per_m, a.shown, a.positions_m
    for k in range(first, len(spans)):
        span, v = spans[k], _of_span(table, k)
        place, t, strain_before, creep_ratio = int(span.place), v.t, span.before_strain, span.before_creep
        if place == 0:
            strain_before, creep_ratio = strain_prev, 0.0
        elif isnan(strain_before):
            before = _of_span(table, k - 1)
            # All pieces carry the same tension: the web leaves with the strain of the last one.
            strain_before = balance.strain(before.balance) * before.t.series_factor / before.t.end_factor
            creep_ratio = before.t.creep_ratio
            strain_before = cycle.equivalent_strain(strain_before, creep_ratio)
        if k > 0 and _of_span(table, k - 1).t.moved != 0.0:
            _show(a)
        span.strain_before = strain_before
        if v.balance.s.started == balance.NOT_STARTED:
            a.figures.at_span = k
            return _PLACE
        at = FEEDBACK_SIZE * (place + 1) + TORQUE
        span.residual_Nm = a.measured[_MEASURED_SIZE * (place + 1) + TORQUE] - t.shift_Nm - shown[at]
        torque_Nm, centre_m, strain_behind = a.torques_Nm[place + 1], nan, span.behind_strain
        if len(x_m) > 2:
            behind_N = 0.0  # of the motors behind, less their rollers' resistance
            for axis in range(place + 1, len(a.rollers.forces_N)):
                behind_N += a.rollers.forces_N[axis]
            torque_Nm += behind_N / rad_per_m[place + 1]
            centre_m = rollers.centre_m(a.rollers, place + 2)
        torque_sim_Nm = 0.0  # of all motors after the span, referred to the first of them
        for axis in range(place + 1, len(rad_per_m)):
            torque_sim_Nm += shown[FEEDBACK_SIZE * axis + TORQUE] * (rad_per_m[axis] / rad_per_m[place + 1])
        if isnan(strain_behind) and k + 1 < len(spans):
            behind = _of_span(table, k + 1)
            strain_behind = balance.strain(behind.balance) * behind.t.series_factor
        around = strain_before, F_next_N, centre_m, strain_behind, creep_ratio
        compared = x_m[place], x_m[place + 1], torque_Nm, torque_sim_Nm, *around
        stage = run_arrays(cycle.COMPARE, compared, table[_OWN + k * cycle.ROWS :])
        if stage != cycle.DONE:
            a.figures.at_span = k
            return stage
    if a.figures.tracks_splices != 0.0:
        v = _of_span(table, 0)
        before_m = x_m[int(spans[0].place)]
        if not web_splice_tracker.passes(a.tracker, a.sums, v.t, balance.strain(v.balance), before_m):
            return PASSAGE
    return _FINISH


@compiled
def _show(a: _LineArrays) -> None:
    """Update the motors' feedback after a change of state."""
    rig_cycle.show(RigArrays(a.line, a.motors, a.asked, a.sensors, a.shown), a.silence)


@compiled
def _publish(a: _LineArrays, table: Places, compared: bool) -> tuple[int, bool]:
    """Compiled `WebLineTwin.published`, of a line without effects on E, and `TwinApplication._status`, of a released
    machine with its configured model; also true if the last torque report is still valid, where it was `compared`."""
    spans, values, synchronized, status, valid = a.spans, a.values, SYNCHRONIZED, RUNNING, True
    for k in range(len(spans)):
        v, at = _of_span(table, k), a.published[k]
        t, factor = v.t, v.t.series_factor
        values[at.F_sim_N] = line_vectors.tension_N(a.line, k)
        values[at.E_sim_Pa] = factor * t.modulus_Pa
        values[at.E_deviation_Pa] = factor * t.deviation_Pa
        values[at.torque_sim_Nm] = a.shown[FEEDBACK_SIZE * (k + 1) + TORQUE]
        values[at.torque_residual_Nm] = spans[k].residual_Nm
        if not cycle.is_synchronized(t, spans[k].known_pct):
            synchronized = 0
        if t.problem != 0.0:
            status |= HOLDING
        if t.refused != 0.0 or t.missed_s > cycle.DIVERGED_S:
            status |= TRANSFER_REFUSED
        separable = filters.separable(v.filters) if t.bank != 0.0 else spans[k].separable != 0.0
        if not separable:
            status |= NOT_SEPARABLE
        if compared:
            undecided = 1.0 if torque_shift.undecided(v.shift) else 0.0
            valid = valid and spans[k].shift_Nm == t.shift_Nm and spans[k].undecided == undecided
            spans[k].shift_Nm, spans[k].undecided = t.shift_Nm, undecided
    return status | synchronized, valid


@entry_point(COUNT, TABLE)
def run(stage: int, table: Places) -> int:
    a = arrays_in(table, _LineArrays)
    at, whole = a.at, a.whole
    strain_prev, F_next_N = a.values[at.strain_prev], a.values[at.F_next_N]
    if stage == cycle.COMPARE and not _measured(a):
        return _UNPAIRED
    if stage == cycle.COMPARE:
        a.figures.at_span, stage = 0.0, _SAME_SPAN
        if a.figures.has_others != 0.0:
            return _OTHERS
    if stage in (_SAME_SPAN, _NEXT_SPAN):
        first = int(a.figures.at_span) + (1 if stage == _NEXT_SPAN else 0)
        stage = _compare(a, table, first, strain_prev, F_next_N)
        if stage != _FINISH:
            return stage
    if a.figures.by_object != 0.0:
        return _COMPARED if stage == _FINISH else _WITHOUT
    around = records.boundary(line_vectors.arrays(a.line))
    around.strain_prev, around.F_next_N = strain_prev + a.figures.input_strain, F_next_N
    rig_cycle.step(RigArrays(a.line, a.motors, a.asked, a.sensors, a.shown), int(a.figures.samples), a.silence)
    status, valid = _publish(a, table, stage == _FINISH)
    a.figures.status, whole[at.status] = whole[at.status], status
    whole[at.number] = (whole[at.number] + 1) % _NUMBERS
    if stage == _FINISH_WITHOUT:
        return _WITHOUT
    return _DONE if valid and not status & (HOLDING | TRANSFER_REFUSED) else _LOOK


class LineCycle:
    """Comparison of a `WebLineTwin` with the measurements of a cycle, and, in vectors, all of its cycle; see
    `machine.InVectors`.

    `estimated` (K,): estimators of spans; `others`: those without, if any; `passage`: None without splice tracking;
    `ripples`: torques are corrected for their ripple.
    """

    def __init__(
        self,
        estimated: Sequence[SpanEstimator],
        model: ModelParameters,
        plant: Line,
        cycle_s: float,
        pairing_of_axes: SampleCoherence,
        of_rollers: Rollers,
        passage: SpliceTracker | None,
        others: OtherSpans | None,
        *,
        ripples: bool,
    ) -> None:
        self._estimated, self._splice_tracker, self._others = estimated, passage, others
        self._plant, self._cycle_s, axes = plant, cycle_s, model.axis_count
        step, least_m = plant.step_in_vectors(plant.vectors.p.item(lay.W_SAMPLE_TIME_S)), least_travel_m(model, cycle_s)
        travels, self._positions_m = pairing_of_axes.vectors(axes)
        flags = ripples, passage is not None, others is not None, True
        self._figures = np.array([(least_m, 0.0, cycle_s, 0.0, *flags, 0.0, 0.0)], _FIGURES)
        known = [(each.span - 1, each.config.synchronized_pct) for each in estimated]
        rows = [(place, nan, nan, nan, pct, 1.0, 0.0, 0.0, nan, nan) for place, pct in known]
        self.spans = np.array(rows, _SPAN)  #: of each estimator
        tracker, sums = (np.zeros(1, TRACKER), np.zeros(1, SUMS)) if passage is None else passage.arrays
        rad_per_m = np.array([model.motor_rad_per_m(axis) for axis in range(1, axes + 1)])
        own = np.zeros(_MEASURED_SIZE * axes), np.zeros(axes), np.zeros(FEEDBACK_SIZE * axes)
        self._by_object = _LineArrays(
            *(travels, self._figures, self.spans, rad_per_m, self._positions_m, np.zeros(axes)),
            *own,
            step.motors,
            *(step.sensors, step.silence, np.zeros(2)),
            np.zeros(2, np.int64),
            np.array([(0, 1, 0, 1)], _AT),
            np.zeros(len(estimated), _PUBLISHED),
            of_rollers.arrays,
            tracker,
            sums,
            plant.vectors,
        )
        self._own, self._of = self._by_object, list[Places]()
        self._fallback: Callable[[int], bool] = never

    def compare(
        self,
        positions_rad: Sequence[float],
        torques_Nm: Sequence[float],
        simulated_Nm: Sequence[float],
        strain_prev: float,
        F_next_N: float,
    ) -> Sequence[float] | None:
        """Compare measured positions and torques (N,), and simulated torques, of the motors; returns the positions at
        the web, None if they are not coherent (of one instant)."""
        own = self._own
        own.measured[::_MEASURED_SIZE], own.measured[TORQUE::_MEASURED_SIZE] = positions_rad, torques_Nm
        own.shown[TORQUE::FEEDBACK_SIZE] = simulated_Nm
        own.values[:] = strain_prev, F_next_N
        if self._figures["ripples"][0] and not self._figures["samples"][0]:
            self._figures["samples"] = self._plant.step_in_vectors(self._cycle_s).samples
        self._take_method()
        code = self.go_on_from(run(cycle.COMPARE, self._table))
        if code == MISSED:
            return None
        for each in self._estimated:
            each.has_advanced()
        positions_m: list[float] = self._positions_m.tolist()
        return positions_m

    def begin(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> None:
        """Go on in these vectors, with the line, until `give`. `fallback`: of its stage."""
        self._fallback, boundary = fallback, vectors.boundary_places
        self._figures["samples"] = self._plant.step_in_vectors(self._cycle_s).samples
        self._figures["by_object"] = 0.0
        self.spans["shift_Nm"] = self.spans["undecided"] = nan
        self._own = self._by_object._replace(
            measured=vectors.measured,
            asked=vectors.asked,
            shown=vectors.shown,
            values=vectors.values,
            whole=vectors.whole,
            at=np.array([(boundary["strain_prev"], boundary["F_next_N"], vectors.number, vectors.status)], _AT),
            published=np.array(vectors.published, np.int64).view(_PUBLISHED),
        )
        self._of = []
        self._take_method()

    def _take_method(self) -> None:
        """Update the table after a change of methods or their arrays."""
        tables = [each.table for each in self._estimated]
        if not self._of or any(now is not then for now, then in zip(tables, self._of, strict=True)):
            self._of = tables
            self._table = np.concatenate([table_of(self._own), *tables])
            self.piece = CompiledStage(
                run, cycle.COMPARE, self._own, continues=_DONE, fallback=self._fallback, table=self._table
            )
        self._figures["input_strain"] = self._estimated[0].input_strain
        self.spans["separable"] = [each.separable for each in self._estimated]

    def go_on_from(self, code: int) -> int:
        """Run the rest of a cycle; see `machine.InVectors`."""
        while code not in _ENDS:
            code = self._go_on_by_objects(code)
        return _ENDS[code]

    def _go_on_by_objects(self, stage: int) -> int:
        """Run an interpreted stage, then the compiled ones after it."""
        for each in self._estimated:
            each.has_advanced()
        place, behind = int(self._figures["at_span"][0]), _SAME_SPAN
        each, x_m = self._estimated[place], self._positions_m.tolist()
        strain_before = float(self.spans["strain_before"][place])
        if stage == _UNPAIRED:
            for each in self._estimated:
                each.miss()
            behind = _FINISH_WITHOUT
        elif stage == _OTHERS:
            self._follow_others(x_m)
        elif stage == _PLACE:
            each.place(x_m[each.span - 1], x_m[each.span], strain_before)
        elif stage == PASSAGE:
            assert self._splice_tracker is not None, "it said so"
            self._splice_tracker.update(x_m[self._estimated[0].span - 1 :])
            behind = _FINISH
        else:
            each.go_on_from(stage, strain_before)
            behind = _NEXT_SPAN
        self._take_method()
        return run(behind, self._table)

    def _follow_others(self, x_m: Sequence[float]) -> None:
        """Follow the spans without an estimator; their strains are those around the spans with one."""
        others, values, at = self._others, self._own.values, self._own.at[0]
        known = [each.span for each in self._estimated]
        assert others is not None, "they were asked for"
        others.follow(x_m, float(values[at["strain_prev"]]), float(values[at["F_next_N"]]), self._cycle_s)
        for row, span in zip(self.spans, known, strict=True):
            if span > 1 and span - 1 not in known:
                creep_ratio = others.creep_ratio(span - 1)
                strain = interpreted(cycle.equivalent_strain)(others.strain(span - 1), creep_ratio)
                row["before_strain"], row["before_creep"] = strain, creep_ratio
            if span + 1 < len(x_m) and span + 1 not in known:
                row["behind_strain"] = others.strain(span + 1)

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        for each in self._estimated:
            each.has_advanced()
        self._own, self._of, self._figures["by_object"] = self._by_object, [], 1.0
        return int(self._figures["status"][0])
