"""Lines on the measured motion of their driven rollers, compiled: one of them, or several in one call.

See `line_follower`. Arguments as in the kernel, of a line that is held to its driven rollers.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.arrays import Matrix
from hilbench.compiled import (
    COUNT,
    MATRIX,
    REAL,
    TABLE,
    VECTOR,
    Reals,
    Reals2,
    Record,
    Table,
    Vector,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    inlined,
    record_type,
    rows_of,
)
from hilbench.compiled import records as array_of
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import kernel, laws, line_vectors, motion, records, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_vectors import LineVectors
from hilbench.plant.web_line.records import LineArrays

#: Longest integration step unless a free roller needs a shorter one, as a share of the time L/v in which the strain of
#: a span follows: the error of a step, of order share^5/120 of the change of strain, is below rounding.
STEP_SHARE: Final = 0.0061
#: Most steps for that in a sample time: speeds beyond, of hundreds of m/s, are those of a model that runs away.
MOST_STEPS: Final = 100.0
#: Averaging time of the driven rollers' acceleration: positions are quantized, and load motors must not amplify their
#: own oscillation by it. Less acceleration counts as none, m/s².
ACCELERATION_S: Final = 0.05
LEAST_M_S2: Final = 0.02

#: Motion history: whether the rollers have been followed at all, over which time; the line's sample time, and the
#: longest integration step that its free rollers allow.
HISTORY: Final = record_type("known", "duration_s", "sample_s", "step_s")
#: A driven roller: its mean speed in that time, its acceleration (0 where all rollers are driven), the speed at which
#: it starts.
ROLLER: Final = record_type("mean_m_s", "a_m_s2", "v_m_s")


class FollowedLine(NamedTuple):
    """Line on measured motion: its rows of the driven rollers (N,), in order, and their motion."""

    line: LineVectors
    history: Annotated[Any, HISTORY]
    rollers: Annotated[Any, array_of(ROLLER)]
    rows: Wholes


class Copies(NamedTuple):
    """Lines (F,) that are followed together: positions (N,) m; of each line its position offsets (F, N) m, its tensions
    (F, K) N and integrated quantities (F, Y); radii of the driven rollers (N,) over those at the start, of the first.
    A `FollowedLine` each is behind it."""

    x: Reals
    offsets: Reals2
    tensions: Reals2
    motions: Reals2
    ratios: Reals


_SHARED: Final = rows_of(Copies)
_EACH: Final = rows_of(FollowedLine)


@inlined
def gained_m_s(a_m_s2: float, duration_s: float) -> float:
    """Speed that a driven roller gains at this acceleration."""
    return 0.0 if abs(a_m_s2) < LEAST_M_S2 else a_m_s2 * duration_s


@inlined
def set_speed(line: LineArrays, row: int, v_m_s: float) -> None:
    """Set the speed of a driven roller; it never sticks."""
    line.s[lay.S_Y + line.n + row] = line.s[lay.S_Y + 3 * line.n + row] = v_m_s
    records.mode(line, row).direction = -1.0 if v_m_s < 0.0 else 1.0


@inlined
def set_position(line: LineArrays, row: int, x_m: float) -> None:
    """Set the position of a driven roller with its motor."""
    line.s[lay.S_Y + row] = line.s[lay.S_Y + 2 * line.n + row] = x_m


@compiled
def roll_on(line: LineArrays, duration_s: float, sample_s: float, step_s: float) -> None:
    """Advance a line at the present speeds of its driven rollers.

    `sample_s`: sample time of the line's clock; samples of the drives, which are off, are adapted to any duration.
    `step_s`: longest integration step that free rollers allow; infinite without any, where no drive need be sampled.
    """
    web, s, samples = records.web(line), line.s, 1 if step_s == np.inf else max(round(duration_s / sample_s), 1)
    time_s = s[lay.S_COUNT] * sample_s
    web.sample_time_s = duration_s / samples
    for j in range(line.k):
        v_m_s, length_m = s[lay.S_Y + line.n + j + 1], s[lay.S_Y + 4 * line.n + line.k + j]
        step_s = min(step_s, STEP_SHARE * length_m / max(abs(v_m_s), 1e-9))
    if splice_laws.has_splice(web, records.pieces(line)):  # it comes in over a step
        step_s = min(step_s, sample_s)
    web.substeps, needed = 1.0, np.ceil(web.sample_time_s / step_s - 1e-9)
    if needed > 1.0:
        web.substeps = min(needed, MOST_STEPS)
    s[lay.S_COUNT] = time_s / web.sample_time_s
    kernel.advance(line.p, line.s, line.u, line.w, samples)
    s[lay.S_COUNT] = (time_s + duration_s) / sample_s
    web.sample_time_s = sample_s


@compiled
def turn(line: LineArrays, rows: Wholes, rollers: Any, history: Record, duration_s: float) -> None:
    """`roll_on` with driven rollers that start at their speeds and accelerate, in as many steps as their drives have
    samples, to their final speeds."""
    gains = False
    for i in range(len(rows)):
        gains |= gained_m_s(rollers[i].a_m_s2, duration_s) != 0.0
    steps = max(round(duration_s / history.sample_s), 1) if gains else 1
    for step in range(steps):
        for i in range(len(rows)):
            gained = (step + 0.5) / steps * gained_m_s(rollers[i].a_m_s2, duration_s)
            set_speed(line, rows[i], rollers[i].v_m_s + gained)
        roll_on(line, duration_s / steps, history.sample_s, history.step_s)
    for i in range(len(rows)):
        speed = rollers[i].v_m_s + gained_m_s(rollers[i].a_m_s2, duration_s)
        line.s[lay.S_Y + line.n + rows[i]] = line.s[lay.S_Y + 3 * line.n + rows[i]] = speed


@compiled
def follow_to(line: LineArrays, of: FollowedLine, x: Vector, further: Vector, duration_s: float) -> None:
    """Move the driven rollers to `x` + `further` (N,), m, `duration_s` after the last call."""
    history, count = of.history, len(of.rows)
    apart_s, share = 0.5 * (duration_s + history.duration_s), duration_s / (duration_s + ACCELERATION_S)
    for i in range(count):
        roller, gone = of.rollers[i], (x[i] + further[i] - line.s[lay.S_Y + of.rows[i]]) / duration_s
        if history.known != 0.0 and count < line.n:
            roller.a_m_s2 += share * ((gone - roller.mean_m_s) / apart_s - roller.a_m_s2)
        roller.mean_m_s = gone
        roller.v_m_s = gone - 0.5 * gained_m_s(roller.a_m_s2, duration_s)
    history.known, history.duration_s = 1.0, duration_s
    turn(line, of.rows, of.rollers, history, duration_s)
    for i in range(count):  # exactly: no drift from adding up
        set_position(line, of.rows[i], x[i] + further[i])


@inlined
def predict(line: LineArrays, guess: LineArrays, of: FollowedLine, lead_s: float, late_s: float) -> None:
    """Copy the state of a line into a `guess`, without past torques, and advance it by `lead_s` with its driven
    rollers' present motion; its clock is `late_s` behind that of the line at first."""
    for j in range(records.past(line, 0)):
        guess.s[j] = line.s[j]
    for j in range(records.past(line, line.m), len(guess.s)):
        guess.s[j] = line.s[j]
    guess.s[lay.S_COUNT] -= late_s / of.history.sample_s
    if lead_s > 0.0:
        for i in range(len(of.rows)):
            of.rollers[i].v_m_s = line.s[lay.S_Y + line.n + of.rows[i]]
        turn(guess, of.rows, of.rollers, of.history, lead_s)


@compiled
def web_force_N(line: LineArrays, seen: Vector, row: int) -> float:
    """Force of the web on a driven roller, N forward, at its nominal radius, by the tensions in `seen`."""
    axis, first, before, behind = records.axis(line, row), 3 * line.m, 0.0, 0.0
    reel = axis.reel_slope_per_m != 0.0
    if row > 0:
        before = seen[first + row - 1]
    elif not reel:
        before = motion.strain_prev(line, kernel.time_s(line)) * records.web(line).upstream_stiffness_N
    if row < line.k:
        behind = seen[first + row]
    elif not reel:
        behind = records.boundary(line).F_next_N
    return float((behind - before) * reels.radius_ratio(axis, line.s[lay.S_Y + row]))


@compiled
def web_torque_Nm(line: LineArrays, seen: Vector, row: int, loaded: bool, rad_per_m: float, v_m_s: float) -> float:
    """Torque at the motor of a driven roller at speed `v_m_s`, by the web (if it is `loaded`) and its resistance."""
    force = web_force_N(line, seen, row) if loaded else 0.0
    direction = measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    force -= laws.measured_resistance_N(records.axis(line, row), line.s[lay.S_Y + row], v_m_s, direction)
    return float(force / rad_per_m)


@compiled
def put_moduli(line: LineArrays, out: Vector, at: int) -> None:
    """E of each span (K,), Pa, with effects and pieces of other web, into `out` from offset `at` on."""
    t, pieces, s, begin_m = kernel.time_s(line), records.pieces(line), line.s, 0.0
    for j in range(line.k):
        span = records.span(line, j)
        factor = laws.step_factor(span, t, records.web(line).sample_time_s)
        out[at + j] = span.modulus_Pa * laws.elasticity_factor(span, t, factor)
    if pieces.count > 0.0:
        travel_m = reels.web_travel_m(records.axis(line, 0), s[lay.S_Y])
        stretch = 1.0 + motion.strain_prev(line, t)
        for j in range(line.k):
            unstretched_m = s[lay.S_Y + 4 * line.n + j]
            out[at + j] *= splice_laws.series_factor(pieces, travel_m, begin_m, unstretched_m, stretch)
            begin_m += unstretched_m


#: follow(duration in s, restores, number of lines, table of `Copies`): they go on from what is integrated there if it
#: `restores`, to the positions there if the duration is above 0, and what is there is updated.
@entry_point(REAL, COUNT, COUNT, TABLE, allocates=False)
def follow(duration_s: float, restores: int, lines: int, table: Table) -> int:
    copies = arrays_in(table, Copies)
    motions = copies.motions
    for f in range(lines):
        of = arrays_in(table[_SHARED + f * _EACH :], FollowedLine)
        line, out = line_vectors.arrays(of.line), of.line.out
        if restores:
            for j in range(motions.shape[1]):
                line.s[lay.S_Y + j] = motions[f, j]
            kernel.set_modes(line)
        if duration_s > 0.0:
            follow_to(line, of, copies.x, copies.offsets[f], duration_s)
        kernel.observe(*of.line)
        for j in range(line.k):
            copies.tensions[f, j] = out[3 * line.m + j]
        for j in range(motions.shape[1]):
            motions[f, j] = line.s[lay.S_Y + j]
        if f == 0:
            for i in range(len(of.rows)):
                axis, x = records.axis(line, of.rows[i]), line.s[lay.S_Y + of.rows[i]]
                copies.ratios[i] = reels.radius_ratio(axis, x)
    return 0


#: follow_rows(table of a `FollowedLine`, positions (n, N), offsets of these (N,), boundary (n, 2), cycle in s, tensions
#: (n, K)): the line goes on from the first row, which is where it is, to each next one.
@entry_point(TABLE, MATRIX, VECTOR, MATRIX, REAL, MATRIX, allocates=False)
def follow_rows(table: Table, x: Matrix, further: Vector, boundary: Matrix, cycle_s: float, tensions: Matrix) -> None:
    of = arrays_in(table, FollowedLine)
    line = line_vectors.arrays(of.line)
    around = records.boundary(line)
    for row in range(x.shape[0]):
        before = max(row - 1, 0)
        around.strain_prev, around.F_next_N = boundary[before, 0], boundary[before, 1]
        if row > 0:
            follow_to(line, of, x[row], further, cycle_s)
        kernel.observe(*of.line)
        for j in range(tensions.shape[1]):
            tensions[row, j] = of.line.out[3 * line.m + j]
