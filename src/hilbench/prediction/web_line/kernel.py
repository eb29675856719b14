"""Futures of a web line: the plant's kernel with the tension controllers around it, compiled.

The closed loop of plant, drives and controllers at one coarse step: the drives' loops sample and the controllers act
once per step, the mechanics are integrated by the plant's own kernel, with every effect of the model. The error of a
coarse step is small against the uncertainty: docs/prediction.md has the figures.

Vectors as in `hilbench.plant.web_line.layout`. B futures, T steps, N axes, K spans, L load motors; the watched
quantities, Q = K + N + L + N, in this order: tensions (N), torques of the axes' motors and of the load motors (N·m),
speeds of the axes at the web (m/s).
"""

from __future__ import annotations

from math import exp, isnan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    COUNT,
    INDICES,
    MATRIX,
    REAL,
    TABLE,
    VECTOR,
    compiled,
    entry_point,
    inlined,
    merged,
    noinline,
)
from hilbench.plant import drive_loops as loops
from hilbench.plant.web_line import kernel, laws, places
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.prediction.judging import TallyVectors, keep, of_table, see

Matrix = NDArray[np.float64]
Indices = NDArray[np.int64]

# Columns of a controller's gains at one E.
G_KP: Final = 0  #: m/s per N; 0: the span has no controller
G_POLE_LENGTH_M: Final = 1
G_LEAST_PER_S: Final = 2  #: of the integral: inverse of the longest integral time
G_LIMIT_M_S: Final = 3
G_RATE: Final = 4  #: of the damping
G_ELONGATION_PER_S: Final = 5
G_FADES: Final = 6  #: remaining share of the elongation after a step
G_SENT: Final = 7  #: of the damping's last command
G_DAMPING_LIMIT_M_S: Final = 8
G_TRAJECTORY_PER_S: Final = 9  #: rate of the poles of a set point's trajectory (feed-forward); 0: none
G_LENGTH_M: Final = 10  #: of the span
_G_TRAJECTORY_LEFT: Final = 11  # remaining share of the trajectory after a step
G_SIZE: Final = 12

# State of a span's controller, from C_SIZE times its number (from 0) on; after those of all spans the force that each
# driven roller's drive has taken up, N (NaN: unknown yet).
C_INTEGRAL_M_S: Final = 0
C_ELONGATION_M: Final = 1
C_STRAIN: Final = 2  #: in the last step
C_DAMPING_M_S: Final = 3  #: last command of the damping
C_TRAJECTORY_STRAIN: Final = 4  #: on the set point's trajectory, with its first and second derivative
C_TRAJECTORY_PER_S: Final = 5
C_TRAJECTORY_PER_S2: Final = 6
C_SHOWN_M_S: Final = 7  #: intended growth rate of the span in the last step
C_SIZE: Final = 8

# Columns of a roller's feed-forward (N, `LEAD_SIZE`): at the web.
LEAD_MASS_KG: Final = 0
LEAD_KP_N_S_PER_M: Final = 1  #: 0: none
LEAD_SHARE: Final = 2  #: share of the force not yet taken up that a step takes up
LEAD_LIMIT_N: Final = 3
LEAD_PULLED: Final = 4  #: 1: the web loads the roller
LEAD_SIZE: Final = 5


@inlined
def _strain(p: Vector, w: Vector, n: int, m: int, k: int, j: int) -> float:
    """Strain of span j, from the present quantities."""
    scale = laws.length_factor(p, places.first_span(n, m) + j * lay.SP_SIZE)
    return w[4 * n + k + j] * scale / w[4 * n + j] - 1.0


@inlined
def _follow_trajectory(c: Vector, at: int, rate_per_s: float, left: float, goal: float, h: float) -> None:
    """Advance the wanted strain of a span by a step on its trajectory to `goal`: three equal poles, with `left`
    remaining after it."""
    off = c[at + C_TRAJECTORY_STRAIN] - goal
    slope = c[at + C_TRAJECTORY_PER_S] + rate_per_s * off
    bend = 0.5 * (
        c[at + C_TRAJECTORY_PER_S2] + 2.0 * rate_per_s * c[at + C_TRAJECTORY_PER_S] + rate_per_s * rate_per_s * off
    )
    off = (off + (slope + bend * h) * h) * left
    sloping = (slope + 2.0 * bend * h) * left
    c[at + C_TRAJECTORY_STRAIN] = goal + off
    c[at + C_TRAJECTORY_PER_S] = sloping - rate_per_s * off
    c[at + C_TRAJECTORY_PER_S2] = 2.0 * bend * left - 2.0 * rate_per_s * sloping + rate_per_s * rate_per_s * off


@inlined
def _lead(leads: Matrix, i: int, c: Vector, held: int, acceleration: float, pull_N: float) -> float:
    """Feed-forward of roller i's command over its planned speed, m/s; c[held]: force taken up by its drive, N."""
    kp = leads[i, LEAD_KP_N_S_PER_M]
    if kp <= 0.0:
        return 0.0
    wanted_N = leads[i, LEAD_MASS_KG] * acceleration + leads[i, LEAD_PULLED] * pull_N
    held_N = wanted_N if isnan(c[held]) else c[held]
    ahead_N = loops.clip(wanted_N - held_N, leads[i, LEAD_LIMIT_N])
    c[held] = held_N + leads[i, LEAD_SHARE] * (wanted_N - held_N)
    return ahead_N / kp


@merged
def _plan(
    k: int,
    c: Vector,
    g: Matrix,
    row: int,
    acceleration: float,
    set_point: Matrix,
    i: int,
    known: Matrix,
    leads: Matrix,
    h: float,
    ahead: Vector,
) -> None:
    """Advance the set points' trajectories in step i, and write each roller's feed-forward to `ahead` (K + 1,), m/s.

    `acceleration`: of the line, m/s². As `hilbench.bench.tasks.tension_feed_forward`.
    """
    pull_N = 0.0  # of the web after a roller
    for j in range(k, -1, -1):
        here_N = 0.0  # of the web before it
        if j < k and g[row * k + j, G_TRAJECTORY_PER_S] > 0.0:
            acceleration -= g[row * k + j, G_LENGTH_M] * c[C_SIZE * j + C_TRAJECTORY_PER_S2]
        if j > 0 and g[row * k + j - 1, G_TRAJECTORY_PER_S] > 0.0:
            at = C_SIZE * (j - 1)
            rate_per_s, left = g[row * k + j - 1, G_TRAJECTORY_PER_S], g[row * k + j - 1, _G_TRAJECTORY_LEFT]
            _follow_trajectory(c, at, rate_per_s, left, set_point[i, j - 1] / known[i, j - 1], h)
            here_N = c[at + C_TRAJECTORY_STRAIN] * known[i, j - 1]
        ahead[j] = _lead(leads, j, c, C_SIZE * k + j, acceleration, here_N - pull_N)
        pull_N = here_N
    for j in range(k + 1):
        ahead[j] -= ahead[k] if j < k else 0.0
    ahead[k] = 0.0


@inlined
def _command(
    c: Vector,
    at: int,
    g: Matrix,
    row: int,
    lead: float,
    around: float,
    error_N: float,
    strain: float,
    length_m: float,
    h: float,
) -> tuple[float, float]:
    """Speed of the axis before a span, m/s, without and with the damping.

    c: controller state from `at` on; `lead`: speed of the axis after the span, `around`: speed to be corrected.
    """
    kp = g[row, G_KP]
    ki = kp * max(abs(lead) / g[row, G_POLE_LENGTH_M], g[row, G_LEAST_PER_S])
    integral = c[at] + ki * error_N * h
    correction, limit = kp * error_N + integral, g[row, G_LIMIT_M_S]
    if abs(correction) <= limit:
        c[at] = integral
    correction = loops.clip(correction, limit)
    rate = length_m * (strain - c[at + C_STRAIN]) / h - c[at + C_SHOWN_M_S]
    elongation_m = c[at + C_ELONGATION_M] * g[row, G_FADES] + rate * h
    c[at + C_ELONGATION_M] = elongation_m
    damping = g[row, G_RATE] * rate + g[row, G_ELONGATION_PER_S] * elongation_m + g[row, G_SENT] * c[at + C_DAMPING_M_S]
    damping = loops.clip(damping, g[row, G_DAMPING_LIMIT_M_S])
    c[at + C_STRAIN], c[at + C_DAMPING_M_S] = strain, damping
    return around - correction, around - correction + damping


@merged
def _set_points(
    n: int,
    m: int,
    k: int,
    p: Vector,
    u: Vector,
    w: Vector,
    c: Vector,
    g: Matrix,
    row: int,
    lead: float,
    set_point: Matrix,
    i: int,
    known: Matrix,
    ahead: Vector,
) -> None:
    """Set velocities of all axes for step i, from the last one on; `known` (T, K): E·S by the twin, N; `ahead` (K +
    1,): feed-forward of each roller, m/s."""
    h = p[lay.W_SAMPLE_TIME_S]
    speed = command = lead
    for j in range(k, -1, -1):
        if j < k and g[row * k + j, G_KP] != 0.0:
            at = C_SIZE * j
            strain, around, goal_N = _strain(p, w, n, m, k, j), speed, set_point[i, j]
            if g[row * k + j, G_TRAJECTORY_PER_S] > 0.0:
                wanted, goal_N = 1.0 + c[at + C_TRAJECTORY_STRAIN], c[at + C_TRAJECTORY_STRAIN] * known[i, j]
                lengthening = g[row * k + j, G_LENGTH_M] * c[at + C_TRAJECTORY_PER_S]
                if command >= 0.0:
                    entering = _strain(p, w, n, m, k, j - 1) if j > 0 else u[lay.U_STRAIN_PREV]
                    around = (command - lengthening / wanted) * (1.0 + entering) / wanted
                else:
                    entering = laws.downstream_strain(p, u[lay.U_F_NEXT_N])
                    if j + 1 < k:
                        entering = _strain(p, w, n, m, k, j + 1)
                    around = command * wanted / (1.0 + entering) - lengthening / wanted
            error_N = goal_N - known[i, j] * strain
            speed, command = _command(c, at, g, row * k + j, speed, around, error_N, strain, w[4 * n + k + j], h)
            if g[row * k + j, G_TRAJECTORY_PER_S] > 0.0:
                c[at + C_SHOWN_M_S] = g[row * k + j, G_LENGTH_M] * c[at + C_TRAJECTORY_PER_S]
        ratio = p[places.motor(n, j) + lay.M_RAD_PER_M]
        u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = (command + ahead[j]) * ratio


@inlined
def _watched(n: int, m: int, k: int, p: Vector, s: Vector, u: Vector, w: Vector, load_axes: Indices, q: Vector) -> None:
    """Write the present quantities to q (Q,)."""
    loads, now_s = load_axes.shape[0], s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S]
    for j in range(k):
        span = places.first_span(n, m) + j * lay.SP_SIZE
        factor = laws.step_factor(p, span, now_s, p[lay.W_SAMPLE_TIME_S])
        q[j] = laws.stiffness_N(p, span, now_s, factor) * _strain(p, w, n, m, k, j)
    for i in range(n):
        q[k + i] = s[places.motor_state(n, k, i) + lay.SM_TORQUE_NM]
        q[k + n + loads + i] = w[n + i]
    for load in range(loads):
        i = load_axes[load]
        behind = q[i] if i < k else u[lay.U_F_NEXT_N]
        before = q[i - 1] if i > 0 else u[lay.U_STRAIN_PREV] * p[lay.W_UPSTREAM_STIFFNESS_N]
        pulls = p[places.axis(i) + lay.A_WEB_LOAD]
        q[k + n + load] = pulls * (behind - before) / p[places.motor(n, i) + lay.M_RAD_PER_M]


@inlined
def _change_moduli(n: int, m: int, k: int, p: Vector, moduli: Vector, scale: float, factor: Matrix, i: int) -> bool:
    """Set E of all spans in step i; True if it has changed."""
    changed = False
    for j in range(k):
        at = places.first_span(n, m) + j * lay.SP_SIZE + lay.SP_MODULUS_PA
        modulus = moduli[j] * scale * factor[i, j]
        changed |= modulus != p[at]
        p[at] = modulus
    return changed


@compiled
def _go_on_two_spans(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Step `kernel.go_on` for three rollers with their own motors alone, the counts as constants."""
    noinline()
    kernel.advance_line(p, s, u, w, 3, 3, 2, 1, True)


@merged
def _run(
    n: int,
    m: int,
    k: int,
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    c: Vector,
    q: Vector,
    moduli: Vector,
    scale: float,
    lead: Vector,
    set_point: Matrix,
    factor: Matrix,
    known: Matrix,
    g: Matrix,
    row_of: Indices,
    leads: Matrix,
    before: float,
    ahead: Vector,
    load_axes: Indices,
    tally: TallyVectors,
    samples: float,
    every: int,
    b: int,
) -> None:
    """Run future b to its end; `before`: the line speed until now, m/s."""
    leading, h = leads[0, LEAD_KP_N_S_PER_M] > 0.0, p[lay.W_SAMPLE_TIME_S]
    _change_moduli(n, m, k, p, moduli, scale, factor, 0)
    kernel.enter(p, s, u, w)
    row, until_row = 0, every
    for i in range(lead.shape[0]):
        changed = i > 0 and _change_moduli(n, m, k, p, moduli, scale, factor, i)
        if leading:
            acceleration = (lead[i] - (lead[i - 1] if i else before)) / h
            _plan(k, c, g, row_of[i], acceleration, set_point, i, known, leads, h, ahead)
        _set_points(n, m, k, p, u, w, c, g, row_of[i], lead[i], set_point, i, known, ahead)
        if changed:  # the tension jumps with E, and the rollers yield within a step
            _watched(n, m, k, p, s, u, w, load_axes, q)
            see(tally, q, 1.0, b, i - 1)
        if k == 2 and m == 3 and n == 3:
            _go_on_two_spans(p, s, u, w)
        else:
            kernel.go_on(p, s, u, w, 1)
        _watched(n, m, k, p, s, u, w, load_axes, q)
        see(tally, q, samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(tally, q, b, row)
            row, until_row = row + 1, every


@compiled
def _run_counted(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    c: Vector,
    q: Vector,
    moduli: Vector,
    scale: float,
    lead: Vector,
    set_point: Matrix,
    factor: Matrix,
    known: Matrix,
    g: Matrix,
    row_of: Indices,
    leads: Matrix,
    before: float,
    ahead: Vector,
    load_axes: Indices,
    tally: TallyVectors,
    samples: float,
    every: int,
    b: int,
) -> None:
    """`_run` with the counts of a line of one or two spans as constants, or with any."""
    n, m, k = places.counts(p)
    if (n, m, k) == (2, 2, 1):
        _run(
            2, 2, 1, p, s, u, w, c, q, moduli, scale, lead, set_point, factor, known, g, row_of, leads, before, ahead,
            load_axes, tally, samples, every, b,
        )  # fmt: skip
    elif (n, m, k) == (3, 3, 2):
        _run(
            3, 3, 2, p, s, u, w, c, q, moduli, scale, lead, set_point, factor, known, g, row_of, leads, before, ahead,
            load_axes, tally, samples, every, b,
        )  # fmt: skip
    else:
        _run(
            n, m, k, p, s, u, w, c, q, moduli, scale, lead, set_point, factor, known, g, row_of, leads, before, ahead,
            load_axes, tally, samples, every, b,
        )  # fmt: skip


@entry_point(
    VECTOR,
    MATRIX,
    *[VECTOR] * 5,
    MATRIX,
    *[VECTOR] * 3,
    *[MATRIX] * 4,
    INDICES,
    MATRIX,
    REAL,
    VECTOR,
    INDICES,
    TABLE,
    REAL,
    COUNT,
)
def run_futures(
    p: Vector,
    start: Matrix,
    moduli: Vector,
    scale: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    integrals: Matrix,
    c: Vector,
    q: Vector,
    lead: Vector,
    set_point: Matrix,
    factor: Matrix,
    known: Matrix,
    g: Matrix,
    row_of: Indices,
    leads: Matrix,
    before: float,
    ahead: Vector,
    load_axes: Indices,
    table: Indices,
    samples: float,
    every: int,
) -> None:
    tally = of_table(table)
    for row in range(g.shape[0]):
        g[row, _G_TRAJECTORY_LEFT] = exp(-g[row, G_TRAJECTORY_PER_S] * p[lay.W_SAMPLE_TIME_S])
    for b in range(start.shape[0]):
        s[:] = start[b]
        c[:] = integrals[b]
        _run_counted(
            p, s, u, w, c, q, moduli, scale[b], lead, set_point, factor, known, g, row_of, leads, before, ahead,
            load_axes, tally, samples, every, b,
        )  # fmt: skip
