"""Web on measured motion, compiled: driven rollers at constant speed within a cycle, the spans between them.

Vectors as in `hilbench.plant.web_line.layout`; N rollers, K spans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, MATRIX, REAL, VECTOR, compiled, entry_point, inlined
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import laws, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector

Matrix = NDArray[np.float64]

#: Longest integration step; the error of a step is of order (v·h/L)^5/120, below rounding on the demonstrator.
LONGEST_STEP_S = 0.001

#: Offset of the positions in the state of `roll_on`: after the time.
POSITIONS = 1


@inlined
def _first_span(p: Vector) -> int:
    """Offset of the span rows in the parameters."""
    return lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE + int(p[lay.W_MOTORS]) * lay.M_SIZE


@compiled
def _span_rates(
    p: Vector,
    s: Vector,
    w: Vector,
    n: int,
    k: int,
    at: int,
    rate: int,
    t: float,
    steps: int,
    strain_prev: float,
    f_next: float,
    strain_next: float,
    blur_m: float,
) -> None:
    """Rates (2·K,), m/s, at offset `rate` of `w`, of the unstretched and then the nominal lengths (2·K,), m, at `at`.

    p (P,): parameters of the line. s: state of `roll_on`, for the pieces of other web. w: positions (n,), m, and speeds
    (n,), m/s, at its start; after them room for the web's speeds (n,), then rates of the nominal lengths (k,), and the
    tensions (k,), N, that are returned; factors (k,) of the steps of E at `steps`. t: s since the start. strain_prev:
    of the web before the line; f_next, strain_next: tension, N, and strain after it; blur_m: travel in a step (see
    `spliced_span_rates`).
    """
    speed, length_rate, tension = 2 * n, 3 * n, 3 * n + k
    first, pieces = _first_span(p), POSITIONS + n + 2 * k
    for i in range(n):
        axis = lay.W_SIZE + i * lay.A_SIZE
        w[speed + i] = laws.web_speed_m_s(p, axis, w[i], w[n + i])
    strain = laws.upstream_strain(p, strain_prev, t)
    if splice_laws.has_splice(p, s, pieces):
        splice_laws.spliced_span_rates(
            p, s, pieces, first, k, t, strain, f_next, strain_next, w, steps, speed, at, length_rate, tension, rate,
            w[0], blur_m,
        )  # fmt: skip
    else:
        laws.span_rates(p, first, k, t, strain, f_next, strain_next, w, steps, speed, at, length_rate, tension, rate)
    for j in range(k):
        w[rate + k + j] = w[length_rate + j]


@compiled
def roll_on(
    p: Vector,
    s: Vector,
    w: Vector,
    v: Vector,
    strain_prev: float,
    f_next: float,
    strain_next: float,
    duration: float,
    spread_s: float,
    out: Vector,
) -> None:
    """Advance s = [t, positions (N,), unstretched lengths (K,), lengths (K,), pieces], s and m, at constant speeds.

    p (P,): parameters of the line; w: scratch space of `new_follower_work`; v (N,): speeds, m/s; strain_prev: of the
    web before the line; f_next, strain_next: tension, N, and strain after it; duration: s, 0 for the tensions alone.
    Tensions into `out` (K,), N, with steps of E spread over the next `spread_s` (`laws.step_factor`).
    """
    n, k = int(p[lay.W_AXES]), int(p[lay.W_SPANS])
    count = max(int(np.ceil(duration / LONGEST_STEP_S - 1e-9)), 1)
    h, size = duration / count, 2 * k
    now = 3 * n + 2 * k
    stage, slopes = now + size, now + 2 * size
    for i in range(n):
        w[n + i] = v[i]
    for j in range(size):
        w[now + j] = s[1 + n + j]
    t0, pieces, first, steps = s[0], POSITIONS + n + size, _first_span(p), now + 6 * size
    blur = max(abs(v[0]) * (h if duration > 0.0 else LONGEST_STEP_S), lay.LEAST_BLUR_M)
    if splice_laws.has_splice(p, s, pieces):
        strain = laws.upstream_strain(p, strain_prev, t0)
        splice_laws.let_splice_in(p, s, pieces, t0, duration, s[1], v[0], strain)
        web_m = 0.0
        for j in range(k):
            web_m += s[1 + n + j]
        splice_laws.forget_passed(s, pieces, s[1], strain, web_m)
    for step in range(count if duration > 0.0 else 0):
        t = t0 + step * h
        laws.put_step_factors(p, first, k, t, h, w, steps)
        for part in range(4):
            ahead = 0.0 if part == 0 else (h if part == 3 else 0.5 * h)
            for i in range(n):
                w[i] = s[1 + i] + v[i] * (step * h + ahead)
            for j in range(size):
                slope = w[slopes + (part - 1) * size + j] if part > 0 else 0.0
                w[stage + j] = w[now + j] + ahead * slope
            _span_rates(
                p, s, w, n, k, stage, slopes + part * size, t + ahead, steps, strain_prev, f_next, strain_next, blur
            )
        for j in range(size):
            total = w[slopes + j] + 2.0 * (w[slopes + size + j] + w[slopes + 2 * size + j]) + w[slopes + 3 * size + j]
            w[now + j] += h / 6.0 * total
    s[0] = t0 + duration
    for i in range(n):
        s[1 + i] += v[i] * duration
        w[i] = s[1 + i]
    for j in range(size):
        s[1 + n + j] = w[now + j]
    laws.put_step_factors(p, first, k, s[0], spread_s, w, steps)
    _span_rates(p, s, w, n, k, now, slopes, s[0], steps, strain_prev, f_next, strain_next, blur)
    for j in range(k):
        out[j] = w[3 * n + k + j]


@inlined
def _tension_around_N(p: Vector, t: float, boundary: Vector, tension: Vector, span: int) -> float:
    """Tension of a span, from 0; before the first the upstream, after the last the downstream one."""
    if span < 0:
        return float(laws.upstream_strain(p, boundary[0], t) * p[lay.W_UPSTREAM_STIFFNESS_N])
    return float(tension[span] if span < len(tension) else boundary[1])


@compiled
def _web_torque_Nm(p: Vector, s: Vector, boundary: Vector, tension: Vector, load: Vector, v: float) -> float:
    """Compiled `SpanFollower.web_torque_Nm`; `load`: roller from 0, rad per m at its motor, web load flag."""
    roller, force = int(load[0]), 0.0
    if load[2] != 0.0:
        behind = _tension_around_N(p, s[0], boundary, tension, roller)
        force = behind - _tension_around_N(p, s[0], boundary, tension, roller - 1)
    direction = measured_direction(v, laws.FRICTION_WIDTH_M_S)
    force -= laws.measured_resistance_N(p, lay.W_SIZE + roller * lay.A_SIZE, s[POSITIONS + roller], v, direction)
    return float(force / load[1])


@inlined
def _modulus_Pa(p: Vector, span: int, t: float) -> float:
    row = _first_span(p) + span * lay.SP_SIZE
    factor = laws.step_factor(p, row, t, LONGEST_STEP_S)
    return float(laws.stiffness_N(p, row, t, factor) / p[row + lay.SP_SECTION_M2])


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR)
def follow(
    p: Vector, s: Vector, w: Vector, v: Vector, boundary: Vector, x: Vector, duration: float, out: Vector
) -> None:
    """Move the rollers to x (N,), m, in `duration`; for 0 the tensions alone."""
    n = len(x) if duration > 0.0 else 0
    for i in range(n):
        v[i] = (x[i] - s[POSITIONS + i]) / duration
    roll_on(p, s, w, v, boundary[0], boundary[1], boundary[2], duration, LONGEST_STEP_S, out)
    for i in range(n):
        s[POSITIONS + i] = x[i]  # exactly: no drift from adding up


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR, MATRIX, VECTOR, VECTOR)
def pull(
    p: Vector,
    s: Vector,
    ahead: Vector,
    w: Vector,
    v: Vector,
    boundary: Vector,
    lead: float,
    tension: Vector,
    loads: Matrix,
    speeds: Vector,
    torques: Vector,
) -> None:
    """Torques, N·m, at the motors of `loads` (L, 3; rows as in `_web_torque_Nm`) by the web predicted `lead` s ahead.

    `ahead` returns the state and `tension` (K,) the tensions; unchanged where `lead` is negative.
    """
    if lead >= 0.0:
        for i in range(len(s)):
            ahead[i] = s[i]
        roll_on(p, ahead, w, v, boundary[0], boundary[1], boundary[2], lead, LONGEST_STEP_S, tension)
    for k in range(len(loads)):
        torques[k] = _web_torque_Nm(p, s, boundary, tension, loads[k], speeds[int(loads[k, 0])])


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def show(p: Vector, s: Vector, v: Vector, tension: Vector, out: Vector) -> None:
    """Write positions, speeds, tensions, strains and E into `out`."""
    n, k = len(v), len(tension)
    first = _first_span(p)
    for i in range(n):
        out[i] = s[POSITIONS + i]
        out[n + i] = v[i]
    for j in range(k):
        unstretched, length = s[POSITIONS + n + j], s[POSITIONS + n + k + j]
        out[2 * n + j] = tension[j]
        out[2 * n + k + j] = length * laws.length_factor(p, first + j * lay.SP_SIZE) / unstretched - 1.0
        out[2 * n + 2 * k + j] = _modulus_Pa(p, j, s[0])


@entry_point(VECTOR, VECTOR, VECTOR, MATRIX, MATRIX, REAL, VECTOR, MATRIX)
def follow_rows(
    p: Vector, s: Vector, w: Vector, x: Matrix, boundary: Matrix, dt: float, v: Vector, out: Matrix
) -> None:
    """Follow the rows of x (n, N); tensions into `out` (n, K)."""
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            v[i] = (x[row, i] - s[1 + i]) / dt if row > 0 else 0.0
        before = max(row - 1, 0)
        duration = dt if row > 0 else 0.0
        f_next = boundary[before, 1]
        strain_next = laws.downstream_strain(p, f_next)
        roll_on(p, s, w, v, boundary[before, 0], f_next, strain_next, duration, LONGEST_STEP_S, out[row])


@entry_point(VECTOR, COUNT, REAL, REAL, REAL)
def resistance_N(p: Vector, row: int, x_m: float, v_m_s: float, width_m_s: float) -> float:
    """Resistance of a roller from 0, N."""
    direction = measured_direction(v_m_s, width_m_s)
    return laws.measured_resistance_N(p, lay.W_SIZE + row * lay.A_SIZE, x_m, v_m_s, direction)


@entry_point(VECTOR, COUNT, REAL)
def modulus_Pa(p: Vector, span: int, t: float) -> float:
    """E of a span from 0, Pa."""
    return _modulus_Pa(p, span, t)


class SpanVectors(NamedTuple):
    """Vectors of a `SpanFollower`, for compiled callers."""

    p: Vector  #: parameters of the line
    s: Vector  #: state, as of `roll_on`
    w: Vector  #: scratch space
    v: Vector  #: speeds of the rollers over the last cycle (N,), m/s
    boundary: Vector  #: strain of the web before the line; tension, N, and strain behind it; see `put_boundary`
    tension: Vector  #: of each span (K,), N


@compiled
def follow_to(web: SpanVectors, x1_m: float, x2_m: float, duration_s: float) -> None:
    """Move two rollers with web between to these positions, `duration_s` after the last call."""
    web.v[0] = (x1_m - web.s[POSITIONS]) / duration_s
    web.v[1] = (x2_m - web.s[POSITIONS + 1]) / duration_s
    _roll_between(web, duration_s)
    web.s[POSITIONS] = x1_m  # exactly: no drift from adding up
    web.s[POSITIONS + 1] = x2_m


@compiled
def put_boundary(
    web: SpanVectors, strain_prev: float, f_next_N: float, strain_next: float, creep_ratio_prev: float
) -> None:
    """Set inlet strain, outlet tension and strain, and creep ratio at roller 1; recomputes the tensions.

    `creep_ratio_prev`: share by which the web before the line pulls the web back over the first roller. What enters has
    that in its strain; in reverse so much more leaves than the roller turns.
    """
    web.boundary[2], web.boundary[3] = strain_next, creep_ratio_prev
    if web.boundary[0] != strain_prev or web.boundary[1] != f_next_N:
        web.boundary[0] = strain_prev
        web.boundary[1] = f_next_N
        _roll_between(web, 0.0)


@compiled
def _roll_between(web: SpanVectors, duration_s: float) -> None:
    """`roll_on` with these boundary inputs, at the web's speed over the first roller."""
    turns_m_s, (strain_prev, f_next_N) = web.v[0], (web.boundary[0], web.boundary[1])
    if turns_m_s < 0.0:
        web.v[0] = turns_m_s * (1.0 + web.boundary[3])
    roll_on(web.p, web.s, web.w, web.v, strain_prev, f_next_N, web.boundary[2], duration_s, LONGEST_STEP_S, web.tension)
    web.v[0] = turns_m_s


@inlined
def modulus_place(p: Vector) -> int:
    """Parameter index of E of the first span."""
    return _first_span(p) + lay.SP_MODULUS_PA


@inlined
def first_strain(web: SpanVectors) -> float:
    """Strain of the first span, of two rollers."""
    return first_strain_of(web.p, web.s)


@inlined
def first_strain_of(p: Vector, s: Vector) -> float:
    """Strain of the first span by parameters and state of `SpanVectors`."""
    unstretched_m, length_m = s[POSITIONS + 2], s[POSITIONS + 3]
    return float(length_m * laws.length_factor(p, _first_span(p)) / unstretched_m - 1.0)


@compiled
def first_spliced(web: SpanVectors) -> tuple[bool, float, float]:
    """True if there are pieces of other web; their effect on the first span, of two rollers (`SplicedSpan`)."""
    pieces = len(web.s) - lay.PIECES_SIZE
    if not web.s[pieces + lay.PIECES_COUNT] > 0.0:
        return False, 1.0, 1.0
    stretch = 1.0 + laws.upstream_strain(web.p, web.boundary[0], web.s[0])
    travel_m, unstretched_m = web.s[POSITIONS], web.s[POSITIONS + 2]
    factor = splice_laws.series_factor(web.s, pieces, travel_m, 0.0, unstretched_m, stretch)
    at_end = 1.0 + splice_laws.change_at(web.s, pieces, travel_m, unstretched_m, stretch, lay.LEAST_BLUR_M)
    return True, factor, at_end


def new_follower_work(layout: Layout) -> Vector:
    """Scratch space of `roll_on`."""
    return np.zeros(3 * layout.axes + 15 * layout.spans)


def follower_size(layout: Layout) -> int:
    """Length of the state of `roll_on`."""
    return POSITIONS + layout.axes + 2 * layout.spans + lay.PIECES_SIZE
