"""Laws of other web passing through a line: compiled functions as in `hilbench.plant.web_line.laws`.

Pieces are in the ring of `layout.WEB_PIECES`, the oldest first.
"""

from __future__ import annotations

from typing import Final

from hilbench.compiled import Record, compiled, inlined, noinline
from hilbench.plant.web_line import laws, records
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.records import LineArrays

# Columns of the ring.
_FRONT_M: Final = 0
_LENGTH_M: Final = 1
_CHANGE: Final = 2


@inlined
def has_splice(web: Record, pieces: Record) -> bool:
    """True if a piece of other web is pending or in the line."""
    return web.splice.relative_change != 0.0 or pieces.count > 0.0


@compiled
def let_splice_in(
    web: Record, pieces: Record, t_s: float, duration_s: float, x_m: float, v_m_s: float, strain_prev: float
) -> None:
    """Admit the splice, if its time is in [t, t + duration], or has passed.

    `x_m`, `v_m_s`: travel and speed of the web at roller 1 at t. Earlier pieces stay; where the new piece comes in
    before the last one is all in, it replaces the rest. Of more than `layout.PIECES` in the line the oldest is
    forgotten.
    """
    noinline()
    splice, ring, count = web.splice, pieces.ring, int(pieces.count)
    if splice.relative_change == 0.0 or pieces.came != 0.0 or t_s + duration_s <= splice.time_s:
        return
    front = x_m + v_m_s * max(splice.time_s - t_s, 0.0)
    if count > 0:
        last = (count - 1) % lay.PIECES
        rest = (front - ring[last, _FRONT_M]) / (1.0 + strain_prev)
        ring[last, _LENGTH_M] = min(ring[last, _LENGTH_M], max(rest, 0.0))
    at = count % lay.PIECES
    ring[at, _FRONT_M], ring[at, _LENGTH_M], ring[at, _CHANGE] = front, splice.length_m, splice.relative_change
    pieces.count, pieces.came = count + 1.0, 1.0


@inlined
def _oldest(pieces: Record) -> int:
    """Number of the oldest kept piece."""
    return max(int(pieces.count) - lay.PIECES, 0)


@compiled
def forget_passed(pieces: Record, x_m: float, strain_prev: float, web_m: float) -> None:
    """Forget all pieces when the last of them has left the line, which holds `web_m` of web, unstretched."""
    noinline()
    for number in range(_oldest(pieces), int(pieces.count)):
        at = number % lay.PIECES
        tail = (x_m - pieces.ring[at, _FRONT_M]) / (1.0 + strain_prev) - pieces.ring[at, _LENGTH_M]
        if tail <= web_m + lay.FORGOTTEN_BEHIND_M:
            return
    pieces.count = 0.0


@inlined
def change_at(pieces: Record, x_m: float, at_m: float, stretch: float, blur_m: float) -> float:
    """Relative change of E·S of the web `at_m` after roller 1: that of the piece there, with blurred ends.

    Arguments as in `series_factor` and `spliced_span_rates`.
    """
    change, ring = 0.0, pieces.ring
    for number in range(_oldest(pieces), int(pieces.count)):
        at = number % lay.PIECES
        beyond = (x_m - ring[at, _FRONT_M]) / stretch - at_m
        share = min(max(beyond / blur_m + 0.5, 0.0), 1.0)
        share -= min(max((beyond - ring[at, _LENGTH_M]) / blur_m + 0.5, 0.0), 1.0)
        change += share * ring[at, _CHANGE]
    return change


@inlined
def series_factor(pieces: Record, x_m: float, first_m: float, length_m: float, stretch: float) -> float:
    """Factor on E·S of a span that begins at `first_m` and holds `length_m` of web: springs in series.

    Lengths unstretched, from roller 1, whose web travel is `x_m` at the `stretch` of the entering web: L/(E·S) = sum of
    l_j/(E_j·S_j) over the pieces in the span.
    """
    compliance, ring = 1.0, pieces.ring
    for number in range(_oldest(pieces), int(pieces.count)):
        at = number % lay.PIECES
        front = (x_m - ring[at, _FRONT_M]) / stretch
        inside = min(front, first_m + length_m) - max(front - ring[at, _LENGTH_M], first_m)
        compliance += max(inside, 0.0) / length_m * (1.0 / (1.0 + ring[at, _CHANGE]) - 1.0)
    return 1.0 / compliance


@compiled
def spliced_span_rates(line: LineArrays, t_s: float, strain_prev: float, material: int, x_m: float) -> None:
    """Tensions and rates as `laws.span_rates`, with pieces of other web.

    In every span one tension, F = (L - m)/sum of m_j/(E_j·S_j), and where web leaves it the strain of the piece that is
    there. What comes in has the strain of the web that enters, as when E of the span steps; a piece that comes back in
    reverse that of its own E·S at the tension after the line. Positions of pieces are unstretched from roller 1, whose
    web travel is `x_m`. The ends of a piece are blurred where it leaves a span, so that rates do not jump within a
    step. Damping with creep takes the rates at the tension without it.
    """
    noinline()
    pieces, w, blur_m, stretch_prev = records.pieces(line), line.w, records.call(line).blur_m, 1.0 + strain_prev
    begin = 0.0
    for j in range(line.k):
        span, part, length = records.span(line, j), records.part(line, j), w[material + j]
        factor = series_factor(pieces, x_m, begin, length, stretch_prev)
        strain = laws.stretch(line, material, j) - 1.0 - span.strain_offset.strain
        part.tension_N = max(laws.stiffness_N(span, t_s, part.step_factor) * factor * strain, 0.0)
        begin += length
    v = records.part(line, 0).speed_m_s
    inflow = v / stretch_prev
    if v < 0.0:
        factor = series_factor(pieces, x_m, 0.0, w[material], stretch_prev)
        at_roller = 1.0 + change_at(pieces, x_m, 0.0, stretch_prev, blur_m)
        inflow = v / (1.0 + (laws.stretch(line, material, 0) - 1.0) * factor / at_roller)
    begin = 0.0
    for j in range(line.k):
        span, part, length = records.span(line, j), records.part(line, j), w[material + j]
        factor, v = series_factor(pieces, x_m, begin, length, stretch_prev), records.part(line, j + 1).speed_m_s
        stretch = laws.stretch(line, material, j)
        begin += length
        at_roller = 1.0 + change_at(pieces, x_m, begin, stretch_prev, blur_m)
        strain = (stretch - 1.0) * factor
        if v < 0.0:
            strain = laws.downstream_strain(records.web(line), records.boundary(line).F_next_N)
            if j + 1 < line.k:
                strain = laws.stretch(line, material, j + 1) - 1.0
                strain *= series_factor(pieces, x_m, begin, w[material + j + 1], stretch_prev)
        outflow = v / (1.0 + strain / at_roller)
        if span.web_slip.creep_per_N != 0.0:
            outflow *= laws.creep_factor(line, j, v)
        part.rate_m_s = inflow - outflow
        inflow = outflow
        damping_s = span.web_damping.time_constant_s
        if damping_s > 0.0:
            growth = (part.length_rate_m_s * laws.length_factor(span) - stretch * part.rate_m_s) / length
            strain = stretch - 1.0 - span.strain_offset.strain + damping_s * growth
            part.tension_N = max(laws.stiffness_N(span, t_s, part.step_factor) * factor * strain, 0.0)
