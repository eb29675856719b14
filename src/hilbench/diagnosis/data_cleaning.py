"""Data cleaning: faults in a recording's rows that are no reason to refuse it are repaired, left out, and reported.

Rows out of order are sorted, repeated ones dropped, missing ones filled in and left out of every comparison, counters
that wrap are unwrapped, samples that are no number, frozen or saturated at the end of a sensor's range are left out.
What can't be repaired without guessing is refused, in one line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array, Rows, runs
from hilbench.diagnosis.noise import floor, rms
from hilbench.errors import UnusableInputError
from hilbench.results.recording import LEAST_SAMPLES, Recording
from hilbench.topology.signal_kinds import TIME

#: Share of the rows that may be left out, repeated or without a time; what is more is no recording to judge by.
_MOST_LEFT_OUT: Final = 0.2
#: Share of the period by which rows may be off an even grid, and periods between two rows from which some are missing
#: where rows are not even.
_UNEVEN: Final = 0.01
_MISSING: Final = 2.5
#: Share of the steps of time that may be less than this share of the period, before rows are those of two recordings.
_CROWDED, _CLOSE = 0.01, 0.6
#: Steps back in time, as a share of the rows, up to which the rows between them are parts that belong together.
_PARTS: Final = 0.1
#: Rows on either side with which a step of a counter is compared, and how many times as large a wrap is.
_BESIDE, _WRAP, _LARGEST_STEP = 5, 4.0, 3.0
#: Rows over which the speed is taken with which a repeated row is compared, and share of a step to spare.
_AROUND, _SHARE = 10, 0.6
#: Share of a position's range that is no step of it but what was lost in calculating it (another unit, another grid).
_ROUNDED: Final = 1e-9
#: Encoder steps that a position moves by at least while a row repeats.
_QUANTA: Final = 3.0
#: Rows at one extreme value in a row, from which a torque is taken for cut off, and how many times as many are at it as
#: in the next share of its range.
_FLAT, _PILED, _NEXT = 5, 3.0, 0.002
#: Share of a limit within which a torque is at it.
_AT_LIMIT: Final = 0.01
#: Rows from which a value that stays is looked at, and the chance up to which it stays by itself.
_STUCK, _BY_CHANCE = 20, 1e-9
#: Share of its usual step that the noise of a torque is at least.
_ROUGH: Final = 0.1
#: Share of the usual speed up to which an axis creeps.
_CREEPS: Final = 0.01
#: Share of its rows in which a torque with noise is at most what it was in the row before.
_HARDLY_EVER: Final = 0.1
#: What a diagnosis reads; other channels may hold what they like.
_READ: Final = re.compile(r"(x|v|tau)\d+(_cmd)?_(m|m_s|rad|rad_s|Nm)|strain_prev|F_next_N|F\d*_meas_N")
_MEASURED: Final = re.compile(r"(x|v|tau)\d+_(m|m_s|rad|rad_s|Nm)")
_POSITION: Final = re.compile(r"x\d+_(m|rad)")
_TORQUE: Final = re.compile(r"tau\d+_Nm")


@dataclass(frozen=True)
class Repair:
    """One thing that was mended or left out."""

    what: str  #: order, repeated, gap, uneven, wrap, not_finite, stuck, saturated, stretch or unit
    channel: str
    rows: int  #: how many it concerns
    text: str  #: for a person, one line


@dataclass(frozen=True)
class Mended:
    """A recording while it is mended, at even times in the end; `left_out` (n,) are rows that nothing is to be compared
    on."""

    recording: Recording  #: of float64
    left_out: Rows
    repairs: list[Repair] = field(default_factory=list)

    @property
    def t_s(self) -> Array:
        """Times of the rows (n,)."""
        return self.recording.time_s

    @property
    def channels(self) -> Mapping[str, Array]:
        """Values (n,) by channel."""
        return self.recording.channels

    def _made(
        self, t_s: Array, channel: Callable[[Array], Array], left_out: Rows, repairs: Sequence[Repair] = ()
    ) -> Mended:
        """At other times, `channel` made of each channel."""
        channels = {name: channel(values) for name, values in self.channels.items() if name != TIME}
        recording = replace(self.recording, channels={TIME: t_s, **channels})
        return Mended(recording, left_out, [*self.repairs, *repairs])

    def _rows(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice, repair: Repair) -> Mended:
        return self._made(self.t_s[chosen], lambda values: values[chosen], self.left_out[chosen], [repair])

    def _with_channel(self, name: str, values: Array, repair: Repair, left_out: Rows | None = None) -> Mended:
        recording = replace(self.recording, channels={**self.channels, name: values})
        out = self.left_out if left_out is None else self.left_out | left_out
        return Mended(recording, out, [*self.repairs, repair])

    def _named(self, pattern: re.Pattern[str]) -> list[str]:
        return [name for name in self.channels if pattern.fullmatch(name)]


def mended(
    recording: Recording,
    place: str | Path,
    *,
    longest_gap_s: float = float("inf"),
    limits_Nm: Mapping[str, float] | None = None,
) -> Mended:
    """The recording with what can be mended mended, as it came where nothing is wrong.

    longest_gap_s: where more than that is missing the longest stretch without such a gap is taken. limits_Nm: of torque
    channels, at which a prediction cuts off as well; standing there is no fault of the recording.
    Raises UnusableInputError, one line, for what would have to be guessed.
    """
    channels = {name: np.asarray(v, np.float64) for name, v in recording.channels.items()}
    table = Mended(replace(recording, channels=channels), np.zeros(len(recording), bool))
    read = {name: channels[name] for name in table._named(_READ)}
    recording.require([n for n, v in read.items() if len(v) and np.mean(~np.isfinite(v)) > _MOST_LEFT_OUT], place)
    table = _in_order(_timed(table, place), place)
    table = _finite(_unwrapped(_without_stuck_values(_without_frozen_rows(table))))
    table = _longest_stretch(_even(_unsaturated(table, limits_Nm or {})), longest_gap_s)
    if not table.repairs:
        return replace(table, recording=recording)
    share = float(np.mean(table.left_out))
    if share > _MOST_LEFT_OUT:
        worst = max(table.repairs, key=lambda repair: repair.rows)
        raise UnusableInputError(
            place,
            f"{100.0 * share:.0f} % of the rows can't be used ({worst.text}), expected at most "
            f"{100.0 * _MOST_LEFT_OUT:.0f} %",
        )
    return table


def _timed(table: Mended, place: str | Path) -> Mended:
    """Without rows whose time is no number."""
    bad = ~np.isfinite(table.t_s)
    count = int(np.count_nonzero(bad))
    if count == 0:
        return table
    if count > _MOST_LEFT_OUT * len(bad) or len(bad) - count < LEAST_SAMPLES:
        raise UnusableInputError(
            place, f"{count} row(s) of {len(bad)} without a time, expected {TIME} in s in every row"
        )
    return table._rows(~bad, Repair("not_finite", TIME, count, f"{count} row(s) without a time dropped"))


def _in_order(table: Mended, place: str | Path) -> Mended:
    """Sorted by time, each time once."""
    t = table.t_s
    backward = np.flatnonzero(np.diff(t) < 0.0)
    # In a file of a few parts the rows of each are as far apart as they were taken.
    forward = np.diff(t) if len(backward) < _PARTS * len(t) else np.diff(np.sort(t))
    period_s = float(np.median(forward[forward > 0.0])) if np.any(forward > 0.0) else 0.0
    if len(backward):
        at = int(backward[0])
        text = f"{len(backward)} step(s) back in time, the first from {t[at]:g} to {t[at + 1]:g} s: rows sorted"
        table = table._rows(np.argsort(t, kind="stable"), Repair("order", TIME, len(backward), text))
    steps = np.diff(table.t_s)
    again = np.concatenate([[False], steps == 0.0])
    crowded = int(np.count_nonzero((steps > 0.0) & (steps < _CLOSE * period_s)))
    other = _differs_from_the_row_before(table, again)
    if len(backward) and crowded + other > _CROWDED * len(steps):
        at = int(backward[0])
        raise UnusableInputError(
            place,
            f"{TIME} starts over in sample {at + 2} (from {t[at]:g} to {t[at + 1]:g} s) with other rows for the same "
            "time, as of two recordings in one file; expected one",
        )
    if other > _CROWDED * len(steps):
        raise UnusableInputError(
            place, f"{other} row(s) have the time of the row before and other values, expected one row for each time"
        )
    count = int(np.count_nonzero(again))
    if count == 0:
        return table
    text = f"{count} row(s) with the time of another one dropped" + (
        f", {other} of them differ from it" if other else ""
    )
    return table._rows(~again, Repair("repeated", TIME, count, text))


def _differs_from_the_row_before(table: Mended, again: Rows) -> int:
    """Number of rows that repeat the time of the one before with another value."""
    at = np.flatnonzero(again)
    differs = np.zeros(len(at), bool)
    for name in table._named(_READ):
        values = table.channels[name]
        differs |= ~((values[at] == values[at - 1]) | (np.isnan(values[at]) & np.isnan(values[at - 1])))
    return int(np.count_nonzero(differs))


def _without_frozen_rows(table: Mended) -> Mended:
    """Without rows in which every measured channel repeats the row before while the axis moves on."""
    measured, positions = table._named(_MEASURED), table._named(_POSITION)
    if not positions or len(table.t_s) < 4 * _AROUND:
        return table
    same = np.ones(len(table.t_s) - 1, bool)
    for name in measured:
        same &= np.diff(table.channels[name]) == 0.0
    again = np.concatenate([[False], same])
    frozen = np.zeros(len(again), bool)
    moving = [(table.channels[name], _quantum(table.channels[name])) for name in positions]
    for start, end in runs(again).tolist():
        if end < len(again) and any(_moved_on(x, start, end, quantum) for x, quantum in moving):
            frozen[start:end] = True
    count = int(np.count_nonzero(frozen))
    if count == 0:
        return table
    at = table.t_s[np.argmax(frozen)]
    text = f"{count} row(s) repeat the row before while the axis moves, the first at t = {at:g} s: dropped"
    return table._rows(~frozen, Repair("repeated", "", count, text))


def _without_stuck_values(table: Mended) -> Mended:
    """Positions and torques that stay what they are for a while, as of a bus that lost them: rows left out.

    A position does that where it has caught up by the end of it; a torque where it hardly ever is the same twice.
    """
    positions = table._named(_POSITION)
    for name in [*positions, *table._named(_TORQUE)]:
        values, stuck = table.channels[name], np.zeros(len(table.t_s), bool)
        again = np.concatenate([[False], np.diff(values) == 0.0])
        long = [(start, end) for start, end in runs(again).tolist() if end - start >= _STUCK]
        if not long or float(np.ptp(values)) == 0.0:
            continue
        quantum = _quantum(values)
        for start, end in long:
            if name in positions:
                stuck[start:end] = end < len(values) and _moved_on(values, start, end, quantum)
            elif np.min(values) < values[start] < np.max(values):  # at an end of its range it may be cut off
                elsewhere = (np.count_nonzero(again) - (end - start)) / len(values)
                stuck[start:end] = (
                    _is_noisy(values, elsewhere, quantum)
                    and len(values) * max(elsewhere, 1e-3) ** (end - start) < _BY_CHANCE
                    and any(_moves(table.channels[x], start, end) for x in positions)
                )
        if np.any(stuck):
            filled = values.copy()
            filled[stuck] = np.interp(table.t_s[stuck], table.t_s[~stuck], values[~stuck])
            count, at = int(np.count_nonzero(stuck)), table.t_s[np.argmax(stuck)]
            text = f"channel {name} stays at one value in {count} row(s), the first at t = {at:g} s: rows left out"
            table = table._with_channel(name, filled, Repair("stuck", name, count, text), left_out=stuck)
    return table


def _is_noisy(values: Array, repeated: float, quantum: float) -> bool:
    """True if a torque changes by more than its counts nearly always, and not smoothly: without noise a constant
    one is normal. `repeated`: share of the rows, but for those in question, in which it repeats the value before."""
    steps = np.abs(np.diff(values))
    usual = float(np.median(steps[steps > 0.0]))
    return repeated < _HARDLY_EVER and usual > _QUANTA * quantum and floor(values) > _ROUGH * usual


def _moves(x: Array, start: int, end: int) -> bool:
    """True if a position moves in rows start to end - 1 by more than counts, and than an axis creeps that friction
    holds: there a torque may well be constant."""
    usual = float(np.mean(np.abs(np.diff(x)))) * (end - start)
    return float(np.ptp(x[start:end])) > max(_QUANTA * _quantum(x), _CREEPS * usual)


def _moved_on(x: Array, start: int, end: int, quantum: float) -> bool:
    """True if a position that was constant in rows start to end - 1 has moved meanwhile, by more than counts."""
    low, high = max(start - _AROUND, 0), min(end + _AROUND, len(x) - 1)
    moved = float(np.abs(x[end] - x[start - 1]))
    speed = abs(float(x[high] - x[low])) / (high - low)
    return moved > _QUANTA * quantum and moved >= (end - start + _SHARE) * speed > 0.0


def _quantum(x: Array) -> float:
    """The smallest step of a position, that of its encoder where it has one: more than numbers are rounded by."""
    steps = np.abs(np.diff(x))
    return float(np.min(steps[steps > _ROUNDED * float(np.ptp(x))], initial=np.inf))


def _unwrapped(table: Mended) -> Mended:
    """Positions without the jumps of a counter that wraps or is set anew."""
    for name in table._named(_POSITION):
        values = table.channels[name]
        known = np.isfinite(values)
        if np.count_nonzero(known) < 4 * _BESIDE:
            continue
        t, x = table.t_s[known], values[known]
        jumps, sizes = _jumps(t, x)
        if len(jumps) == 0:
            continue
        size = float(np.median(np.abs(sizes)))
        regular = bool(np.all(np.abs(np.abs(sizes) - size) <= 0.05 * size))
        moved = np.zeros(len(x))
        moved[jumps + 1] = -np.sign(sizes) * size if regular else -sizes
        whole = values.copy()
        whole[known] = x + np.cumsum(moved)
        what = f"jumps by {size:g}" if regular else "jumps"
        text = (
            f"channel {name} {what} {len(jumps)} time(s), the first at t = {t[jumps[0] + 1]:g} s, as a counter that"
            " wraps or is set anew: taken out"
        )
        table = table._with_channel(name, whole, Repair("wrap", name, len(jumps), text))
    return table


def _jumps(t_s: Array, x: Array) -> tuple[NDArray[np.intp], Array]:
    """Steps of a position that are no motion: the row before each, and by how much more it moves than beside it."""
    steps = np.diff(x)
    period_s = float(np.median(np.diff(t_s)))
    rate = steps / np.maximum(np.round(np.diff(t_s) / period_s), 1.0)
    size = np.abs(rate)
    near = np.full((2 * _BESIDE, len(size)), np.nan)
    for shift in range(1, _BESIDE + 1):
        near[shift - 1, shift:] = size[:-shift]
        near[-shift, :-shift] = size[shift:]
    # Not the largest of them: an axis that turns round at a wrap passes it twice.
    sudden = size > _WRAP * np.nanmedian(near, axis=0)
    if not np.any(sudden):
        return np.empty(0, np.intp), np.empty(0)
    sudden &= size > _LARGEST_STEP * float(np.max(size[~sudden], initial=0.0))
    at = np.flatnonzero(sudden)
    usual = [np.median(np.delete(rate[max(k - 3, 0) : k + 4], min(k, 3))) for k in map(int, at)]
    return at, steps[at] - np.array(usual)


def _finite(table: Mended) -> Mended:
    """Without values that are no number: filled in, and the rows left out."""
    for name in table._named(_READ):
        values = table.channels[name]
        bad = ~np.isfinite(values)
        count = int(np.count_nonzero(bad))
        if count == 0:
            continue
        filled = values.copy()
        filled[bad] = np.interp(table.t_s[bad], table.t_s[~bad], values[~bad])
        at = table.t_s[np.argmax(bad)]
        text = (
            f"channel {name} has {count} value(s) that are no finite number, the first at t = {at:g} s: rows left out"
        )
        table = table._with_channel(name, filled, Repair("not_finite", name, count, text), left_out=bad)
    return table


def _unsaturated(table: Mended, limits_Nm: Mapping[str, float]) -> Mended:
    """Leave out rows in which a torque is saturated at the end of its range."""
    for name in table._named(_TORQUE):
        values = table.channels[name]
        cut = np.zeros(len(values), bool)
        for sign in (1.0, -1.0):
            top = float(np.max(sign * values, initial=0.0))
            limit = limits_Nm.get(name, float("inf"))
            if top <= 0.0 or abs(top - limit) <= _AT_LIMIT * limit < float("inf"):
                continue
            at = sign * values == top
            below = sign * values[~at]
            next_level = float(np.max(below, initial=-np.inf)) - _NEXT * float(np.ptp(values))
            near = below >= next_level
            is_flat = np.max(np.diff(runs(at)), initial=0) >= _FLAT
            if is_flat and np.count_nonzero(at) >= _PILED * np.count_nonzero(near):
                cut |= at
        count = int(np.count_nonzero(cut))
        if count and float(np.ptp(values)) > 0.0:
            largest = float(np.max(np.abs(values[cut])))
            text = f"channel {name} is at {largest:g} N·m, the end of its range, in {count} row(s): left out"
            table = table._with_channel(name, values, Repair("saturated", name, count, text), left_out=cut)
    return table


def _even(table: Mended) -> Mended:
    """Table at even times: rows that are missing are filled in and left out, uneven ones put onto a grid."""
    t = table.t_s
    if len(t) < LEAST_SAMPLES + 1:
        return table
    period_s = float(np.median(np.diff(t)))
    if np.max(np.abs(np.diff(t) - period_s)) <= _UNEVEN * period_s:
        return table
    number, slope, first = _numbered(t, period_s)
    off = np.abs(t - first - slope * number)
    if np.max(off) <= _UNEVEN * period_s:
        if number[-1] == len(t) - 1:
            return table
        return _filled(table, number, float(t[-1] - t[0]) / float(number[-1]))
    uneven = float(np.max(np.abs(np.diff(t)[np.diff(t) < _MISSING * period_s] - period_s), initial=0.0))
    at_times, by_number = _at_times(table, period_s), None
    if np.max(off) < period_s:
        by_number = _filled(
            table._made(first + slope * number, lambda values: values, table.left_out), number, float(slope)
        )
    if by_number is not None and _roughness(by_number) < _roughness(at_times):
        text = (
            f"times up to {1e3 * uneven:.3g} ms off an even {1e3 * slope:.4g} ms, where the motion is even: made even"
        )
        return replace(by_number, repairs=[*by_number.repairs, Repair("uneven", TIME, len(t), text)])
    text = f"rows up to {1e3 * uneven:.3g} ms off an even {1e3 * period_s:.4g} ms: put onto an even grid"
    return replace(at_times, repairs=[*at_times.repairs, Repair("uneven", TIME, len(t), text)])


def _numbered(t_s: Array, period_s: float) -> tuple[Array, float, float]:
    """Number of each row in an even recording, were it one; its period, s, and the time of row 0."""
    number = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(np.diff(t_s) / period_s), 1.0))])
    slope, first = np.polyfit(number, t_s, 1)
    if np.max(np.abs(t_s - first - slope * number)) > _UNEVEN * period_s:
        # Times that are off by much round to the wrong row: where none is missing, one after the other.
        one_by_one = np.arange(len(t_s), dtype=np.float64)
        even, start = np.polyfit(one_by_one, t_s, 1)
        if np.max(np.abs(t_s - start - even * one_by_one)) < period_s:
            return one_by_one, float(even), float(start)
    return number, float(slope), float(first)


def _filled(table: Mended, number: Array, period_s: float) -> Mended:
    """Insert rows where the row numbers leave some out."""
    period_s = round(period_s, 9)
    everything = np.arange(int(number[-1]) + 1)
    missing = np.ones(len(everything), bool)
    missing[number.astype(int)] = False
    left_out = missing.copy()
    left_out[number.astype(int)] = table.left_out
    repairs_made = [_gap(table.t_s, np.diff(number) > 1.0, int(np.count_nonzero(missing)))] if np.any(missing) else []
    t_s = table.t_s[0] + period_s * everything
    return table._made(t_s, lambda values: np.interp(everything, number, values), left_out, repairs_made)


def _at_times(table: Mended, period_s: float) -> Mended:
    """Interpolated where the grid's times lie between those of the rows."""
    t = table.t_s
    grid = t[0] + period_s * np.arange(int((t[-1] - t[0]) / period_s) + 1)
    before = np.clip(np.searchsorted(t, grid, side="right") - 1, 0, len(t) - 2)
    wide = np.diff(t) > _MISSING * period_s
    left_out = np.interp(grid, t, table.left_out.astype(float)) > 0.0
    missing = wide[before] & (np.abs(grid - t[before]) > _UNEVEN * period_s)
    repairs_made = [_gap(t, wide, int(np.count_nonzero(missing)))] if np.any(missing) else []
    return table._made(grid, lambda values: np.interp(grid, t, values), left_out | missing, repairs_made)


def _gap(t_s: Array, wide: Rows, count: int) -> Repair:
    places = np.flatnonzero(wide)
    text = f"{count} row(s) missing in {len(places)} place(s), the first after t = {t_s[places[0]]:g} s: left out"
    return Repair("gap", TIME, count, text)


def _roughness(table: Mended) -> float:
    """Roughness of the positions from row to row (rms of 4th differences): wrong row times make motion rough."""
    kept = ~table.left_out[4:]
    found = 0.0
    for name in table._named(_POSITION):
        found = max(found, rms(np.diff(table.channels[name], 4)[kept]))
    return found


def _longest_stretch(table: Mended, longest_gap_s: float) -> Mended:
    """Longest part without a gap that is too long."""
    if not np.any(table.left_out) or not np.isfinite(longest_gap_s):
        return table
    period_s = float(np.median(np.diff(table.t_s)))
    gaps = [(a, b) for a, b in runs(table.left_out) if (b - a) * period_s > longest_gap_s]
    if not gaps:
        return table
    starts, ends = [0, *(b for _, b in gaps)], [*(a for a, _ in gaps), len(table.t_s)]
    start, end = max(zip(starts, ends, strict=True), key=lambda part: part[1] - part[0])
    text = (
        f"more than {longest_gap_s:g} s missing at once {len(gaps)} time(s): t = {table.t_s[start]:g} to"
        f" {table.t_s[end - 1]:g} s, the longest stretch without that, is used"
    )
    return table._rows(slice(int(start), int(end)), Repair("stretch", TIME, len(table.t_s) - int(end - start), text))
