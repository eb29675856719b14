"""Segments of a running bench for a diagnosis: begun during the run, at a moment when little happens."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.measured import Before, Measured, measured_from
from hilbench.diagnosis.predictor import choice, deviations_of
from hilbench.diagnosis.web_line.free_run import remembered_m
from hilbench.errors import UnusableInputError
from hilbench.live.web_line_gap import exchanged_m
from hilbench.live.window import Window
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters

#: For how long before a start a candidate follows the web at least, and for how long before that the model, s; and
#: for how many lengths of the longest span the candidate.
_SHOWN_S, _KNOWN_S, _SHOWN_LENGTHS = 3.0, 5.0, 2.0
#: Rows by which the last position before it is smoothed.
_SMOOTHED = 40
#: For how long before it nothing much happens, s; how far the speed may change meanwhile.
_QUIET_S, _QUIET_M_S = 0.5, 0.01
#: Speed from which a line runs, m/s.
_MOVES_M_S = 0.05
#: The same of a mean tension, from that time to the one before, as a share of it.
_QUIET_SHARE = 0.006
#: Signals that show how far the web is stretched.
_AWAY = re.compile(r"x\d+_m - x\d+_m")
#: Rows over which a travel bends that is left at once, and behind a late one within which it does; how far, in
#: deviations of what a right model leaves.
_PUSH, _PUSH_AFTER, _PUSHED = 10, 60, 3.0


def line(model: Machine) -> ModelParameters:
    """Narrow a machine's type to a web line."""
    assert isinstance(model, ModelParameters), "a line is diagnosed as one"
    return model


def numbered(model: ModelParameters, span: int) -> str:
    """Number of a span in names of signals: empty where there is only one."""
    return str(span) if model.span_count > 1 else ""


def quiet_cycle(window: Window, model: ModelParameters, first: int, end: int, cycle_s: float) -> int | None:
    """The first cycle of a range before which, for a while, neither speeds nor tensions change; None where there is
    none yet."""
    before = round(_QUIET_S / cycle_s)
    rows = window.rows(first - 2 * before, end)
    if len(rows) <= 2 * before:
        return None
    axes, spans = range(1, model.axis_count + 1), range(1, model.span_count + 1)
    speeds = np.column_stack([window.column(rows, f"v{axis}_cmd_m_s") for axis in axes])[before:]
    moved = np.abs(speeds[before:] - speeds[:-before]).max(axis=1)
    tensions = [window.column(rows, f"F{numbered(model, span)}_sim_N") for span in spans]
    total = np.cumsum(np.column_stack(tensions), axis=0)
    pulls = (total[before:] - total[:-before]) / before
    steady = np.all(np.abs(pulls[before:] - pulls[:-before]) < _QUIET_SHARE * np.abs(pulls[:-before]), axis=1)
    quiet = np.flatnonzero((moved < _QUIET_M_S) & (np.abs(speeds[before:, -1]) > _MOVES_M_S) & steady)
    return None if len(quiet) == 0 else end - len(moved) + int(quiet[0])


def data_of(
    window: Window, model: ModelParameters, emulation: Emulation | None, cycles: tuple[int, int, int], cycle_s: float
) -> Measured:
    """Measured data of cycles: that in which the effect began, the first one and the one after the last one used.
    Raises UnusableInputError for what can't be diagnosed."""
    begun, first, end = cycles
    data = measured_from(window.recording(first, end), model, "the running bench")
    measured, known = window.measured(first, end), window.known(first, end)
    if len(known) != len(data.t_s):
        raise UnusableInputError("the running bench", "rows could not be placed in time, expected one each cycle")
    data = replace(
        data,
        before=_before(window, model, begun, first, cycle_s),
        left_out=~known | data.left_out,
        put_off_m=_put_off_m(data.commands_m_s, measured, cycle_s),
    )
    if np.all(measured):
        return data
    pushed = _pushed(data, model, emulation, measured)
    left_out = data.left_out.copy()
    left_out[list(pushed)] = True
    return replace(data, pushed=pushed, left_out=left_out)


def _pushed(data: Measured, model: ModelParameters, emulation: Emulation | None, measured: Rows) -> tuple[int, ...]:
    """Rows at which rollers are pushed off their trajectory at once, after rows that were not `measured` in time
    (n,): a load motor holds its torque as long as it receives nothing from the bench, and that pushes the rollers."""
    predictor = choice(model, data, emulation).predictor
    away = [place for place, name in enumerate(predictor.names) if _AWAY.fullmatch(name)]
    if not away:  # on measured motion: whatever made the rollers move so
        return ()
    residual = predictor.measured[away] - predictor.predict(lay.pack(model)[None])[0, away]
    bend = np.abs(residual[:, 2 * _PUSH :] - 2.0 * residual[:, _PUSH:-_PUSH] + residual[:, : -2 * _PUSH])
    late = np.convolve(~measured, np.ones(_PUSH_AFTER), "full")[: residual.shape[1]] > 0.5
    usual = deviations_of(predictor)[away, None]
    odd = np.flatnonzero(np.any(bend > _PUSHED * usual, axis=0) & late[_PUSH:-_PUSH])
    if not len(odd):
        return ()
    begins = np.concatenate([[True], np.diff(odd) > _PUSH_AFTER])
    return tuple(int(row) + _PUSH for row in odd[begins])


def _put_off_m(commands_m_s: Array, measured: Rows, cycle_s: float) -> float:
    """Largest displacement error of a line that takes commands (n, axes) a cycle late whose rows were not
    `measured` in time (n,), or follow one: where drives answer late, the next commands leave late."""
    doubted = ~measured[1:] | ~measured[:-1]
    changes_m_s = np.abs(np.diff(commands_m_s, axis=0))[doubted]
    return cycle_s * float(np.max(np.sum(changes_m_s, axis=0)))


def _before(window: Window, model: ModelParameters, begun: int, cycle: int, cycle_s: float) -> Before:
    """How the rollers turned until a cycle, at the earliest from that in which it began. The strain at the beginning of
    that is the model's, on what was before."""
    shown = max(rows_of_travel(window, model, cycle, remembered_m(model, _SHOWN_LENGTHS)), round(_SHOWN_S / cycle_s))
    shown = max(min(shown, cycle - begun), 1)
    exchanged = rows_of_travel(window, model, cycle - shown, exchanged_m(model))
    rows = window.rows(cycle - shown - max(exchanged, round(_KNOWN_S / cycle_s)), cycle + 1)
    x = np.column_stack([window.column(rows, f"x{axis}_m") for axis in range(1, model.axis_count + 1)])
    boundary = np.column_stack([window.column(rows, name) for name in ("strain_prev", "F_next_N")])
    x[-1] = _smooth_end(x)
    split = max(len(rows) - shown, 0)
    strain = np.full(model.span_count, model.upstream_strain)
    if split > 1:
        _, strain = LineFollower(model).follow_on(lay.pack(model), x[:split], boundary[:split], cycle_s, strain)
    return Before(x[max(split - 1, 0) :], boundary[max(split - 1, 0) :], strain)


def rows_of_travel(window: Window, model: ModelParameters, end: int, travel_m: float) -> int:
    """Rows until a cycle, as far as they are kept, in which the web has gone so far."""
    x = window.column(window.rows(window.first, end), f"x{model.axis_count}_m")
    if not len(x):
        return 0
    nearer = np.abs(x - x[-1]) < travel_m
    return len(x) if np.all(nearer) else int(np.argmin(nearer[::-1]))


def _smooth_end(x: Array) -> Array:
    """(N,): the last of positions (n, N), without the noise of a single one."""
    rows = x[-min(_SMOOTHED, len(x)) :]
    at = np.arange(len(rows)) - (len(rows) - 1.0)
    return np.array([np.polyfit(at, column - column[-1], 2)[-1] + column[-1] for column in rows.T])
