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
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Reals2,
    Vector,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    inlined,
    merged,
    noinline,
    record_type,
    viewed,
)
from hilbench.compiled import records as array_of
from hilbench.control.web_line.feed_forward import ROLLER, plan_leads
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, advance, velocity_before
from hilbench.control.web_line.swing_damping import DAMPING, damp, follow_modulus
from hilbench.control.web_line.tension import CONTROLLER, control
from hilbench.plant.web_line import kernel, laws, records
from hilbench.plant.web_line.records import LineArrays
from hilbench.prediction.judging import TallyVectors, keep, see

Indices = NDArray[np.int64]


class LineControl(NamedTuple):
    """Controllers of a line, as of `hilbench.control.web_line`, zero where there is none."""

    tensions: Annotated[Any, array_of(CONTROLLER)]  #: (K,)
    dampings: Reals2  #: (K, …): a `DAMPING` each, and the pairs behind it
    trajectories: Annotated[Any, array_of(TRAJECTORY)]  #: (K,)
    rollers: Annotated[Any, array_of(ROLLER)]  #: (N,)


#: Line speed until now, m/s; measurements in a step, steps in a row.
FIGURES: Final = record_type("before_m_s", "samples", "every")


class Look(NamedTuple):
    """Vectors and figures of a prediction; p, u, w: of the plant's kernel, s: room for a state."""

    p: Reals
    s: Reals
    u: Reals
    w: Reals
    start: Reals2  #: (B, S)
    scale: Reals  #: (B,): of E
    control: LineControl
    control_start: Reals
    control_state: Reals  #: all of the controllers
    q: Reals  #: (Q,): present quantities
    moduli: Reals  #: (K,): E of the spans by the twin, Pa
    lead: Reals  #: (T,): line speed, m/s
    set_point: Reals2  #: (T, K)
    factor: Reals2  #: (T, K): of E
    known: Reals2  #: (T, K): E·S by the twin, N
    stated_Pa: Reals  #: (T,): E that the controllers use
    ahead: Reals  #: (N,): leads of the rollers, m/s
    load_axes: Wholes
    tally: TallyVectors
    figures: Annotated[Any, FIGURES]


@inlined
def _strain(line: LineArrays, j: int) -> float:
    """Strain of span j, from the present quantities."""
    return laws.stretch(line, 4 * line.n, j) - 1.0


@merged
def _set_points(line: LineArrays, look: Look, i: int) -> None:
    """Set velocities of all axes for step i, from the last one on."""
    n, k, of, known, stated_Pa = line.n, line.k, look.control, look.known, look.stated_Pa[i]
    web, around, h = records.web(line), records.boundary(line), records.web(line).sample_time_s
    for j in range(k):
        if of.trajectories[j].per_s > 0.0:
            advance(of.trajectories[j], look.set_point[i, j], known[i, j] / of.trajectories[j].section_m2)
    acceleration = (look.lead[i] - (look.lead[i - 1] if i else look.figures.before_m_s)) / h
    plan_leads(of.rollers, of.trajectories, acceleration, look.ahead)
    speed = command = look.lead[i]
    for j in range(k, -1, -1):
        if j < k and of.tensions[j].bandwidth_rad_per_s > 0.0:
            trajectory, damping = of.trajectories[j], of.dampings[j]
            strain, planned_m_s, goal_N = _strain(line, j), nan, look.set_point[i, j]
            if trajectory.per_s > 0.0:
                if command >= 0.0:
                    entering = _strain(line, j - 1) if j > 0 else around.strain_prev
                else:
                    entering = laws.downstream_strain(web, around.F_next_N)
                    if j + 1 < k:
                        entering = _strain(line, j + 1)
                planned_m_s, goal_N = velocity_before(trajectory, command, entering), trajectory.tension_N
            speed = control(of.tensions[j], True, speed, goal_N, known[i, j] * strain, stated_Pa, h, planned_m_s)
            follow_modulus(damping, stated_Pa)
            # The strain is known here; the bench has its rate from the encoders.
            state = viewed(damping, DAMPING)[0]
            rate = line.w[4 * n + k + j] * (strain - state.strain) / h - trajectory.shown_m_s
            state.strain = strain
            command = speed + damp(damping, rate, 1.0)
        records.given(line, j).setpoint = (command + look.ahead[j]) * records.motor(line, j).rad_per_m


@inlined
def _watch(line: LineArrays, look: Look, samples: float, b: int, step: int) -> None:
    """Note the present quantities of future b after a step, with so many samples."""
    n, k, load_axes, q, web = line.n, line.k, look.load_axes, look.q, records.web(line)
    loads, now_s, around = load_axes.shape[0], kernel.time_s(line), records.boundary(line)
    for j in range(k):
        span = records.span(line, j)
        factor = laws.step_factor(span, now_s, web.sample_time_s)
        q[j] = laws.stiffness_N(span, now_s, factor) * _strain(line, j)
    for i in range(n):
        q[k + i] = records.drive(line, i).torque_Nm
        q[k + n + loads + i] = line.w[n + i]
    for load in range(loads):
        i = load_axes[load]
        behind = q[i] if i < k else around.F_next_N
        before = q[i - 1] if i > 0 else around.strain_prev * web.upstream_stiffness_N
        pulls = records.axis(line, i).web_load
        q[k + n + load] = pulls * (behind - before) / records.motor(line, i).rad_per_m
    see(look.tally, q, samples, b, step)


@inlined
def _change_moduli(line: LineArrays, look: Look, scale: float, i: int) -> bool:
    """Set E of all spans in step i; True if it has changed."""
    changed = False
    for j in range(line.k):
        span, modulus = records.span(line, j), look.moduli[j] * scale * look.factor[i, j]
        changed |= modulus != span.modulus_Pa
        span.modulus_Pa = modulus
    return changed


@compiled
def _go_on_two_spans(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Step `kernel.go_on` for three rollers with their own motors alone, the counts as constants."""
    noinline()
    kernel.advance_line(LineArrays(p, s, u, w, 3, 3, 2), 1, True)


@merged
def _run(line: LineArrays, look: Look, scale: float, b: int) -> None:
    """Run future b to its end, with E by `scale` of the twin's."""
    _change_moduli(line, look, scale, 0)
    kernel.enter(line)
    row, every = 0, int(look.figures.every)
    until_row = every
    for i in range(look.lead.shape[0]):
        changed = i > 0 and _change_moduli(line, look, scale, i)
        _set_points(line, look, i)
        if changed:  # the tension jumps with E, and the rollers yield within a step
            _watch(line, look, 1.0, b, i - 1)
        if line.k == 2 and line.m == 3 and line.n == 3:
            _go_on_two_spans(line.p, line.s, line.u, line.w)
        else:
            kernel.go_on(line, 1)
        _watch(line, look, look.figures.samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(look.tally, look.q, b, row)
            row, until_row = row + 1, every


#: run_futures(0, table of a `Look`).
@entry_point(COUNT, TABLE, allocates=False)
def run_futures(unused: int, table: Indices) -> int:
    look = arrays_in(table, Look)
    p, s, u, w = look.p, look.s, look.u, look.w
    line = records.line_of(p, s, u, w)
    for b in range(len(look.start)):
        for j in range(len(s)):
            s[j] = look.start[b, j]
        for j in range(len(look.control_state)):
            look.control_state[j] = look.control_start[j]
        # With the counts of a line of one or two spans as constants, or with any.
        if line.n == 2 and line.m == 2 and line.k == 1:
            _run(LineArrays(p, s, u, w, 2, 2, 1), look, look.scale[b], b)
        elif line.n == 3 and line.m == 3 and line.k == 2:
            _run(LineArrays(p, s, u, w, 3, 3, 2), look, look.scale[b], b)
        else:
            _run(line, look, look.scale[b], b)
    return 0
