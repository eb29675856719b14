"""Laws of other web passing through a line: compiled functions as in `hilbench.plant.web_line.laws`.

Pieces are in a ring in the state, the oldest first, from offset `pieces` on (`layout.PIECES_COUNT` and following).
"""

from __future__ import annotations

from hilbench.compiled import compiled, inlined, noinline
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector, place

_SPLICE_S = place("splice", "time_s")
_SPLICE = place("splice", "relative_change")
_SPLICE_M = place("splice", "length_m")
_DAMPING_S = place("web_damping", "time_constant_s")
_CREEP = place("web_slip", "creep_per_N")
_STRAIN_OFFSET = place("strain_offset", "strain")


@inlined
def has_splice(p: Vector, s: Vector, pieces: int) -> bool:
    """True if a piece of other web is pending or in the line; `pieces`: offset of the pieces in `s`."""
    return p[_SPLICE] != 0.0 or s[pieces + lay.PIECES_COUNT] > 0.0


@compiled
def let_splice_in(
    p: Vector, s: Vector, pieces: int, t_s: float, duration_s: float, x_m: float, v_m_s: float, strain_prev: float
) -> None:
    """Admit the splice, if its time is in [t, t + duration], or has passed.

    `x_m`, `v_m_s`: travel and speed of the web at roller 1 at t. Earlier pieces stay; where the new piece comes in
    before the last one is all in, it replaces the rest. Of more than `layout.PIECES` in the line the oldest is
    forgotten.
    """
    noinline()
    if p[_SPLICE] == 0.0 or s[pieces + lay.PIECES_CAME] != 0.0 or t_s + duration_s <= p[_SPLICE_S]:
        return
    front = x_m + v_m_s * max(p[_SPLICE_S] - t_s, 0.0)
    count = int(s[pieces + lay.PIECES_COUNT])
    if count > 0:
        last = _piece(pieces, count - 1)
        rest = (front - s[last + lay.PIECE_FRONT_M]) / (1.0 + strain_prev)
        s[last + lay.PIECE_LENGTH_M] = min(s[last + lay.PIECE_LENGTH_M], max(rest, 0.0))
    at = _piece(pieces, count)
    s[at + lay.PIECE_FRONT_M] = front
    s[at + lay.PIECE_LENGTH_M] = p[_SPLICE_M]
    s[at + lay.PIECE_CHANGE] = p[_SPLICE]
    s[pieces + lay.PIECES_COUNT] = count + 1.0
    s[pieces + lay.PIECES_CAME] = 1.0


@inlined
def _piece(pieces: int, number: int) -> int:
    """Offset of the piece that came in as `number` (from 0) in the ring."""
    return pieces + lay.PIECES_FIRST + number % lay.PIECES * lay.PIECE_SIZE


@inlined
def _oldest(s: Vector, pieces: int) -> int:
    """Number of the oldest kept piece."""
    return max(int(s[pieces + lay.PIECES_COUNT]) - lay.PIECES, 0)


@compiled
def forget_passed(s: Vector, pieces: int, x_m: float, strain_prev: float, web_m: float) -> None:
    """Forget all pieces when the last of them has left the line, which holds `web_m` of web, unstretched."""
    noinline()
    for number in range(_oldest(s, pieces), int(s[pieces + lay.PIECES_COUNT])):
        at = _piece(pieces, number)
        tail = (x_m - s[at + lay.PIECE_FRONT_M]) / (1.0 + strain_prev) - s[at + lay.PIECE_LENGTH_M]
        if tail <= web_m + lay.FORGOTTEN_BEHIND_M:
            return
    s[pieces + lay.PIECES_COUNT] = 0.0


@inlined
def change_at(s: Vector, pieces: int, x_m: float, at_m: float, stretch: float, blur_m: float) -> float:
    """Relative change of E·S of the web `at_m` after roller 1: that of the piece there, with blurred ends.

    Arguments as in `series_factor` and `spliced_span_rates`.
    """
    change = 0.0
    for number in range(_oldest(s, pieces), int(s[pieces + lay.PIECES_COUNT])):
        piece = _piece(pieces, number)
        beyond = (x_m - s[piece + lay.PIECE_FRONT_M]) / stretch - at_m
        share = min(max(beyond / blur_m + 0.5, 0.0), 1.0)
        share -= min(max((beyond - s[piece + lay.PIECE_LENGTH_M]) / blur_m + 0.5, 0.0), 1.0)
        change += share * s[piece + lay.PIECE_CHANGE]
    return change


@inlined
def series_factor(s: Vector, pieces: int, x_m: float, first_m: float, length_m: float, stretch: float) -> float:
    """Factor on E·S of a span that begins at `first_m` and holds `length_m` of web: springs in series.

    Lengths unstretched, from roller 1, whose web travel is `x_m` at the `stretch` of the entering web: L/(E·S) = sum of
    l_j/(E_j·S_j) over the pieces in the span.
    """
    compliance = 1.0
    for number in range(_oldest(s, pieces), int(s[pieces + lay.PIECES_COUNT])):
        piece = _piece(pieces, number)
        front = (x_m - s[piece + lay.PIECE_FRONT_M]) / stretch
        inside = min(front, first_m + length_m) - max(front - s[piece + lay.PIECE_LENGTH_M], first_m)
        compliance += max(inside, 0.0) / length_m * (1.0 / (1.0 + s[piece + lay.PIECE_CHANGE]) - 1.0)
    return 1.0 / compliance


@compiled
def spliced_span_rates(
    p: Vector,
    s: Vector,
    pieces: int,
    first: int,
    spans: int,
    t_s: float,
    strain_prev: float,
    f_next_N: float,
    strain_next: float,
    w: Vector,
    steps: int,
    speed: int,
    material: int,
    length_rate: int,
    tension: int,
    rate: int,
    x_m: float,
    blur_m: float,
) -> None:
    """Tensions and rates as `laws.span_rates`, with pieces of other web, from offset `pieces` of the state `s` on.

    In every span one tension, F = (L - m)/sum of m_j/(E_j·S_j), and where web leaves it the strain of the piece that is
    there. What comes in has the strain of the web that enters, as when E of the span steps; a piece that comes back in
    reverse that of its own E·S at the tension after the line. Positions of pieces are unstretched from roller 1, whose
    web travel is `x_m`. `blur_m`: travel over which the ends of a piece are blurred where it leaves a span, so that
    rates do not jump within a step. Damping with creep takes the rates at the tension without it.
    """
    noinline()
    stretch_prev = 1.0 + strain_prev
    begin = 0.0
    for k in range(spans):
        row, length = first + k * lay.SP_SIZE, w[material + k]
        factor = series_factor(s, pieces, x_m, begin, length, stretch_prev)
        strain = w[material + spans + k] * laws.length_factor(p, row) / length - 1.0 - p[row + _STRAIN_OFFSET]
        w[tension + k] = max(laws.stiffness_N(p, row, t_s, w[steps + k]) * factor * strain, 0.0)
        begin += length
    inflow = w[speed] / stretch_prev
    if w[speed] < 0.0:
        factor = series_factor(s, pieces, x_m, 0.0, w[material], stretch_prev)
        at_roller = 1.0 + change_at(s, pieces, x_m, 0.0, stretch_prev, blur_m)
        stretch = w[material + spans] * laws.length_factor(p, first) / w[material]
        inflow = w[speed] / (1.0 + (stretch - 1.0) * factor / at_roller)
    begin = 0.0
    for k in range(spans):
        row, length = first + k * lay.SP_SIZE, w[material + k]
        factor = series_factor(s, pieces, x_m, begin, length, stretch_prev)
        stretch = w[material + spans + k] * laws.length_factor(p, row) / length
        begin += length
        at_roller = 1.0 + change_at(s, pieces, x_m, begin, stretch_prev, blur_m)
        strain = (stretch - 1.0) * factor
        if w[speed + k + 1] < 0.0:
            strain = strain_next
            if k + 1 < spans:
                behind = w[material + spans + k + 1] * laws.length_factor(p, row + lay.SP_SIZE) / w[material + k + 1]
                strain = behind - 1.0
                strain *= series_factor(s, pieces, x_m, begin, w[material + k + 1], stretch_prev)
        outflow = w[speed + k + 1] / (1.0 + strain / at_roller)
        if p[row + _CREEP] != 0.0:
            behind_N = w[tension + k + 1] if k + 1 < spans else f_next_N
            outflow *= laws.creep_factor(p, row, w[speed + k + 1], w[tension + k] - behind_N)
        w[rate + k] = inflow - outflow
        inflow = outflow
        if p[row + _DAMPING_S] > 0.0:
            growth = (w[length_rate + k] * laws.length_factor(p, row) - stretch * w[rate + k]) / length
            strain = stretch - 1.0 - p[row + _STRAIN_OFFSET] + p[row + _DAMPING_S] * growth
            w[tension + k] = max(laws.stiffness_N(p, row, t_s, w[steps + k]) * factor * strain, 0.0)
