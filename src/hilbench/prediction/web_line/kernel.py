"""Futures of a web line: the plant's kernel with the tension controllers around it, compiled.

The closed loop of plant, drives and the bench's controllers at one coarse step: the drives' loops sample and the
controllers act once per step, the mechanics are integrated by the plant's own kernel, with every effect of the model.
The error of a coarse step is small against the uncertainty: docs/prediction.md has the figures.

Vectors as in `hilbench.plant.web_line.layout`. B futures, T steps, N axes, K spans, L load motors; the watched
quantities, Q = K + N + L + N, in this order: tensions (N), torques of the axes' motors and of the load motors (N·m),
speeds of the axes at the web (m/s).
"""

from __future__ import annotations

from math import nan
from typing import Any, NamedTuple

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
    floats,
    inlined,
    merged,
    noinline,
    viewed,
)
from hilbench.control.web_line.feed_forward import ROLLER, plan_leads
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, advance, velocity_before
from hilbench.control.web_line.swing_damping import DAMPING, damp, follow_modulus
from hilbench.control.web_line.tension import CONTROLLER, control
from hilbench.plant.web_line import kernel, laws, places
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.prediction.judging import TallyVectors, keep, of_table, see

Matrix = NDArray[np.float64]
Indices = NDArray[np.int64]


class LineControl(NamedTuple):
    """Controllers of a line, as of `hilbench.control.web_line`, zero where there is none."""

    tensions: Any  #: (K,) `CONTROLLER`
    dampings: Matrix  #: (K, …): a `DAMPING` each, and the pairs behind it
    trajectories: Any  #: (K,) `TRAJECTORY`
    rollers: Any  #: (N,) `ROLLER`


@merged
def _control_of(table: Indices) -> LineControl:
    return LineControl(
        viewed(floats(table, 0, (1,)), CONTROLLER),
        floats(table, 1, (1, 2)),
        viewed(floats(table, 2, (1,)), TRAJECTORY),
        viewed(floats(table, 3, (1,)), ROLLER),
    )


class Look(NamedTuple):
    """Vectors and figures that all futures of a prediction share; p, s, u, w: of the plant's kernel."""

    p: Vector
    s: Vector
    u: Vector
    w: Vector
    control: LineControl
    q: Vector  #: (Q,): present quantities
    moduli: Vector  #: (K,): E of the spans by the twin, Pa
    lead: Vector  #: (T,): line speed, m/s
    set_point: Matrix  #: (T, K)
    factor: Matrix  #: (T, K): of E
    known: Matrix  #: (T, K): E·S by the twin, N
    stated_Pa: Vector  #: (T,): E that the controllers use
    before: float  #: line speed until now, m/s
    ahead: Vector  #: (N,): leads of the rollers, m/s
    load_axes: Indices
    tally: TallyVectors
    samples: float
    every: int


@inlined
def _strain(p: Vector, w: Vector, n: int, m: int, k: int, j: int) -> float:
    """Strain of span j, from the present quantities."""
    scale = laws.length_factor(p, places.first_span(n, m) + j * lay.SP_SIZE)
    return w[4 * n + k + j] * scale / w[4 * n + j] - 1.0


@merged
def _set_points(n: int, m: int, k: int, look: Look, i: int) -> None:
    """Set velocities of all axes for step i, from the last one on."""
    p, u, w, of, known, stated_Pa = look.p, look.u, look.w, look.control, look.known, look.stated_Pa[i]
    h = p[lay.W_SAMPLE_TIME_S]
    for j in range(k):
        if of.trajectories[j].per_s > 0.0:
            advance(of.trajectories[j], look.set_point[i, j], known[i, j] / of.trajectories[j].section_m2)
    acceleration = (look.lead[i] - (look.lead[i - 1] if i else look.before)) / h
    plan_leads(of.rollers, of.trajectories, acceleration, look.ahead)
    speed = command = look.lead[i]
    for j in range(k, -1, -1):
        if j < k and of.tensions[j].bandwidth_rad_per_s > 0.0:
            trajectory, damping = of.trajectories[j], of.dampings[j]
            strain, around, goal_N = _strain(p, w, n, m, k, j), nan, look.set_point[i, j]
            if trajectory.per_s > 0.0:
                if command >= 0.0:
                    entering = _strain(p, w, n, m, k, j - 1) if j > 0 else u[lay.U_STRAIN_PREV]
                else:
                    entering = laws.downstream_strain(p, u[lay.U_F_NEXT_N])
                    if j + 1 < k:
                        entering = _strain(p, w, n, m, k, j + 1)
                around, goal_N = velocity_before(trajectory, command, entering), trajectory.tension_N
            speed = control(of.tensions[j], True, speed, goal_N, known[i, j] * strain, stated_Pa, h, around)
            follow_modulus(damping, stated_Pa)
            # The strain is known here; the bench has its rate from the encoders.
            state = viewed(damping, DAMPING)[0]
            rate = w[4 * n + k + j] * (strain - state.strain) / h - trajectory.shown_m_s
            state.strain = strain
            command = speed + damp(damping, rate, 1.0)
        ratio = p[places.motor(n, j) + lay.M_RAD_PER_M]
        u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = (command + look.ahead[j]) * ratio


@inlined
def _watch(n: int, m: int, k: int, look: Look, samples: float, b: int, step: int) -> None:
    """Note the present quantities of future b after a step, with so many samples."""
    p, s, u, w, load_axes, q = look.p, look.s, look.u, look.w, look.load_axes, look.q
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
    see(look.tally, q, samples, b, step)


@inlined
def _change_moduli(n: int, m: int, k: int, look: Look, scale: float, i: int) -> bool:
    """Set E of all spans in step i; True if it has changed."""
    p = look.p
    changed = False
    for j in range(k):
        at = places.first_span(n, m) + j * lay.SP_SIZE + lay.SP_MODULUS_PA
        modulus = look.moduli[j] * scale * look.factor[i, j]
        changed |= modulus != p[at]
        p[at] = modulus
    return changed


@compiled
def _go_on_two_spans(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Step `kernel.go_on` for three rollers with their own motors alone, the counts as constants."""
    noinline()
    kernel.advance_line(p, s, u, w, 3, 3, 2, 1, True)


@merged
def _run(n: int, m: int, k: int, look: Look, scale: float, b: int) -> None:
    """Run future b to its end, with E by `scale` of the twin's."""
    p, s, u, w = look.p, look.s, look.u, look.w
    _change_moduli(n, m, k, look, scale, 0)
    kernel.enter(p, s, u, w)
    row, until_row = 0, look.every
    for i in range(look.lead.shape[0]):
        changed = i > 0 and _change_moduli(n, m, k, look, scale, i)
        _set_points(n, m, k, look, i)
        if changed:  # the tension jumps with E, and the rollers yield within a step
            _watch(n, m, k, look, 1.0, b, i - 1)
        if k == 2 and m == 3 and n == 3:
            _go_on_two_spans(p, s, u, w)
        else:
            kernel.go_on(p, s, u, w, 1)
        _watch(n, m, k, look, look.samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(look.tally, look.q, b, row)
            row, until_row = row + 1, look.every


@compiled
def _run_counted(look: Look, scale: float, b: int) -> None:
    """`_run` with the counts of a line of one or two spans as constants, or with any."""
    n, m, k = places.counts(look.p)
    if (n, m, k) == (2, 2, 1):
        _run(2, 2, 1, look, scale, b)
    elif (n, m, k) == (3, 3, 2):
        _run(3, 3, 2, look, scale, b)
    else:
        _run(n, m, k, look, scale, b)


@entry_point(
    VECTOR,
    MATRIX,
    *[VECTOR] * 7,
    TABLE,
    *[VECTOR] * 2,
    *[MATRIX] * 3,
    VECTOR,
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
    control_start: Vector,
    control_state: Vector,
    control_table: Indices,
    q: Vector,
    lead: Vector,
    set_point: Matrix,
    factor: Matrix,
    known: Matrix,
    stated_Pa: Vector,
    before: float,
    ahead: Vector,
    load_axes: Indices,
    table: Indices,
    samples: float,
    every: int,
) -> None:
    look = Look(
        p, s, u, w, _control_of(control_table), q, moduli, lead, set_point, factor, known, stated_Pa, before, ahead,
        load_axes, of_table(table), samples, every,
    )  # fmt: skip
    for b in range(start.shape[0]):
        s[:] = start[b]
        control_state[:] = control_start
        _run_counted(look, scale[b], b)
