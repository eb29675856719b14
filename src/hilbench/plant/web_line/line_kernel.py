"""Lines on the measured motion of their driven rollers, compiled: one of them, or several in one call.

See `line_follower`. Arguments as in the kernel, of a line that is held to its driven rollers; `rows` (N,): their rows
among its axes, in order. `memory` (`FIRST` + 3 N,): motion history: whether they have been followed at all, over which
time s, the line's sample time s, and the longest integration step s; then, of each driven roller, its mean speed in
that time m/s, its acceleration m/s² (0 where all rollers are driven), and room for a speed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import INDICES, MATRIX, REAL, TABLE, VECTOR, compiled, entry_point, floats, inlined, integers
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import kernel, laws, line_vectors, motion, places, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line_vectors import LineVectors

Rows = NDArray[np.int64]
Matrix = NDArray[np.float64]
Table = NDArray[np.int64]

#: Longest integration step unless a roller needs a shorter one; the error of a step is of order (v·h/L)^5/120, below
#: rounding on the demonstrator.
LONGEST_STEP_S: Final = 0.001
#: Averaging time of the driven rollers' acceleration: positions are quantized, and load motors must not amplify their
#: own oscillation by it. Less acceleration counts as none, m/s².
ACCELERATION_S: Final = 0.05
LEAST_M_S2: Final = 0.02

# Offsets in the memory.
KNOWN, DURATION_S, SAMPLE_S, STEP_S, FIRST = range(5)
# Rows of the table of lines that are followed together. Common: positions (N,) m, rows (N,) of the driven rollers; of
# each of F lines its position offsets (F, N) m, its tensions (F, K) N and integrated quantities (F, Y); radii of the
# driven rollers (N,) over those at the start, of the first line. Then of each line:
X, ROWS, OFFSETS, TENSIONS, MOTIONS, RATIOS, SHARED = range(7)
P, STATE, INPUTS, WORK, OUT, MEMORY, EACH = range(7)
# Rows of the table of load motors, after a line's own six: rows of the driven rollers; of each load motor that driven
# roller, from 0, rad per m at its shaft, web load flag (L, 3); speeds of the driven rollers (N,) m/s; room for a state,
# and for its outputs; torques (L,) N·m.
LINE_ROWS, LOADS, SPEEDS, GUESS, AHEAD, TORQUES = range(EACH, EACH + 6)

# Rows of the table of a state transfer to a closed line: source state, indices in the integrated quantities, and the
# line's own five.
FROM, PLACES, TO = range(3)


@inlined
def gained_m_s(a_m_s2: float, duration_s: float) -> float:
    """Speed that a driven roller gains at this acceleration."""
    return 0.0 if abs(a_m_s2) < LEAST_M_S2 else a_m_s2 * duration_s


@inlined
def set_speed(p: Vector, s: Vector, row: int, v_m_s: float) -> None:
    """Set the speed of a driven roller; it never sticks."""
    n, _, k = places.counts(p)
    s[lay.S_Y + n + row] = v_m_s
    s[lay.S_Y + 3 * n + row] = v_m_s
    s[places.axis_state(n, k, row) + lay.SA_DIRECTION] = -1.0 if v_m_s < 0.0 else 1.0


@inlined
def set_position(p: Vector, s: Vector, row: int, x_m: float) -> None:
    """Set the position of a driven roller with its motor."""
    s[lay.S_Y + row] = x_m
    s[lay.S_Y + 2 * int(p[lay.W_AXES]) + row] = x_m


@compiled
def roll_on(p: Vector, s: Vector, u: Vector, w: Vector, duration_s: float, sample_s: float, step_s: float) -> None:
    """Advance a line at the present speeds of its driven rollers.

    `sample_s`: sample time of the line's clock; samples of the drives, which are off, are adapted to any duration.
    `step_s`: longest integration step.
    """
    n, _, k = places.counts(p)
    samples = max(round(duration_s / sample_s), 1)
    time_s = s[lay.S_COUNT] * sample_s
    p[lay.W_SAMPLE_TIME_S] = duration_s / samples
    p[lay.W_SUBSTEPS] = np.ceil(duration_s / samples / step_s - 1e-9)
    s[lay.S_COUNT] = time_s / p[lay.W_SAMPLE_TIME_S]
    kernel.enter(p, s, u, w)
    kernel.go_on(p, s, u, w, samples)
    kernel.leave(s, w, places.block(n, k, 1))
    s[lay.S_COUNT] = (time_s + duration_s) / sample_s
    p[lay.W_SAMPLE_TIME_S] = sample_s


@compiled
def turn(
    p: Vector, s: Vector, u: Vector, w: Vector, rows: Rows, v: Vector, a: Vector, duration_s: float, sample_s: float,
    step_s: float,
) -> None:  # fmt: skip
    """`roll_on` with driven rollers that start at speeds `v` (N,) m/s and accelerate by `a` (N,) m/s², in as many steps
    as their drives have samples, to their final speeds."""
    n, gains = int(p[lay.W_AXES]), False
    for i in range(len(rows)):
        gains |= gained_m_s(a[i], duration_s) != 0.0
    steps = max(round(duration_s / sample_s), 1) if gains else 1
    for step in range(steps):
        for i in range(len(rows)):
            set_speed(p, s, rows[i], v[i] + (step + 0.5) / steps * gained_m_s(a[i], duration_s))
        roll_on(p, s, u, w, duration_s / steps, sample_s, step_s)
    for i in range(len(rows)):
        speed = v[i] + gained_m_s(a[i], duration_s)
        s[lay.S_Y + n + rows[i]] = speed
        s[lay.S_Y + 3 * n + rows[i]] = speed


@compiled
def follow_to(
    p: Vector, s: Vector, u: Vector, w: Vector, memory: Vector, rows: Rows, x: Vector, further: Vector,
    duration_s: float,
) -> None:  # fmt: skip
    """Move the driven rollers to `x` + `further` (N,), m, `duration_s` after the last call."""
    n, count = int(p[lay.W_AXES]), len(rows)
    mean, a, v = memory[FIRST : FIRST + count], memory[FIRST + count : FIRST + 2 * count], memory[FIRST + 2 * count :]
    apart_s, share = 0.5 * (duration_s + memory[DURATION_S]), duration_s / (duration_s + ACCELERATION_S)
    for i in range(count):
        gone = (x[i] + further[i] - s[lay.S_Y + rows[i]]) / duration_s
        if memory[KNOWN] != 0.0 and count < n:
            a[i] += share * ((gone - mean[i]) / apart_s - a[i])
        mean[i] = gone
        v[i] = gone - 0.5 * gained_m_s(a[i], duration_s)
    memory[KNOWN], memory[DURATION_S] = 1.0, duration_s
    turn(p, s, u, w, rows, v, a, duration_s, memory[SAMPLE_S], memory[STEP_S])
    for i in range(count):  # exactly: no drift from adding up
        set_position(p, s, rows[i], x[i] + further[i])


@inlined
def ratio(p: Vector, s: Vector, row: int) -> float:
    """Radius of a reel over that at the start; 1 of another roller."""
    axis = places.axis(row)
    return float(reels.radius_ratio(p, axis, s[lay.S_Y + row]) if reels.is_reel(p, axis) else 1.0)


@compiled
def web_force_N(p: Vector, s: Vector, u: Vector, seen: Vector, row: int) -> float:
    """Force of the web on a driven roller, N forward, at its nominal radius, by the tensions in `seen`."""
    _, m, k = places.counts(p)
    reel, before, behind = reels.is_reel(p, places.axis(row)), 0.0, 0.0
    if row > 0:
        before = seen[3 * m + row - 1]
    elif not reel:
        upstream = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S])
        before = upstream * p[lay.W_UPSTREAM_STIFFNESS_N]
    if row < k:
        behind = seen[3 * m + row]
    elif not reel:
        behind = u[lay.U_F_NEXT_N]
    return float((behind - before) * ratio(p, s, row))


@compiled
def web_torque_Nm(
    p: Vector, s: Vector, u: Vector, seen: Vector, row: int, loaded: bool, rad_per_m: float, v_m_s: float
) -> float:
    """Torque at the motor of a driven roller at speed `v_m_s`, by the web (if it is `loaded`) and its resistance."""
    force = web_force_N(p, s, u, seen, row) if loaded else 0.0
    direction = measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    force -= laws.measured_resistance_N(p, places.axis(row), s[lay.S_Y + row], v_m_s, direction)
    return float(force / rad_per_m)


@compiled
def put_moduli(p: Vector, s: Vector, u: Vector, out: Vector, at: int) -> None:
    """E of each span (K,), Pa, with effects and pieces of other web, into `out` from offset `at` on."""
    n, m, k = places.counts(p)
    t, pieces, begin_m = s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S], places.pieces(n, m, k), 0.0
    for j in range(k):
        row = places.first_span(n, m) + j * lay.SP_SIZE
        factor = laws.step_factor(p, row, t, p[lay.W_SAMPLE_TIME_S])
        out[at + j] = p[row + lay.SP_MODULUS_PA] * laws.elasticity_factor(p, row, t, factor)
    if s[pieces + lay.PIECES_COUNT] > 0.0:
        travel_m = motion.web_travel_m(p, s[lay.S_Y])
        stretch = 1.0 + laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
        for j in range(k):
            unstretched_m = s[lay.S_Y + 4 * n + j]
            out[at + j] *= splice_laws.series_factor(s, pieces, travel_m, begin_m, unstretched_m, stretch)
            begin_m += unstretched_m


@compiled
def observe(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector) -> None:
    """Write measured and true values now to `out`."""
    kernel.enter(p, s, u, w)
    kernel.report(p, s, u, w, out, 0)


@compiled
def _gather(table: Table, line: int) -> None:
    """Copy a line's outputs and integrated quantities to the common arrays."""
    first = SHARED + line * EACH
    p, s = floats(table, first + P, (1,)), floats(table, first + STATE, (1,))
    out, tensions = floats(table, first + OUT, (1,)), floats(table, TENSIONS, (1, 2))
    motions, m = floats(table, MOTIONS, (1, 2)), int(p[lay.W_MOTORS])
    for j in range(tensions.shape[1]):
        tensions[line, j] = out[3 * m + j]
    for j in range(motions.shape[1]):
        motions[line, j] = s[lay.S_Y + j]
    if line == 0:
        rows, ratios = integers(table, ROWS, (1,)), floats(table, RATIOS, (1,))
        for i in range(len(rows)):
            ratios[i] = ratio(p, s, rows[i])


@compiled
def follow_alone(table: Table, x: Vector, further: Vector, duration_s: float) -> None:
    """Move the line of a load-motor table to its driven rollers' positions, and update its outputs."""
    p, s, u = floats(table, P, (1,)), floats(table, STATE, (1,)), floats(table, INPUTS, (1,))
    w, memory, rows = floats(table, WORK, (1,)), floats(table, MEMORY, (1,)), integers(table, LINE_ROWS, (1,))
    follow_to(p, s, u, w, memory, rows, x, further, duration_s)
    observe(p, s, u, w, floats(table, OUT, (1,)))


@compiled
def pull_alone(table: Table, lead_s: float) -> None:
    """Torques of a load-motor table, by the line predicted `lead_s` ahead at its driven rollers' present motion."""
    p, s, u = floats(table, P, (1,)), floats(table, STATE, (1,)), floats(table, INPUTS, (1,))
    w, memory, ahead = floats(table, WORK, (1,)), floats(table, MEMORY, (1,)), floats(table, AHEAD, (1,))
    rows, loads = integers(table, LINE_ROWS, (1,)), floats(table, LOADS, (1, 2))
    speeds, guess, torques = floats(table, SPEEDS, (1,)), floats(table, GUESS, (1,)), floats(table, TORQUES, (1,))
    n, count = int(p[lay.W_AXES]), len(rows)
    for j in range(len(s)):
        guess[j] = s[j]
    if lead_s > 0.0:
        a, v = memory[FIRST + count : FIRST + 2 * count], memory[FIRST + 2 * count :]
        for i in range(count):
            v[i] = s[lay.S_Y + n + rows[i]]
        turn(p, guess, u, w, rows, v, a, lead_s, memory[SAMPLE_S], memory[STEP_S])
    observe(p, guess, u, w, ahead)
    for j in range(len(torques)):
        axis = int(loads[j, 0])
        loaded, rad_per_m = loads[j, 2] != 0.0, loads[j, 1]
        torques[j] = web_torque_Nm(p, s, u, ahead, rows[axis], loaded, rad_per_m, speeds[axis])


#: follow(duration in s, table): all lines of a table of lines go on to the positions in it.
#: show(0, table): what was changed in them is gathered. put(0, table): they go on from what is integrated there.
#: hand_on(0, table of a closed line): it goes on with what another one has at some places.
#: pull(lead in s, table of load motors): torques of the line so much later, if its driven rollers go on as until now.
#: moduli(p, s, u, out (K,)): E of each span. follow_rows(p, s, u, w, out, memory, rows, positions (n, N), boundary
#: (n, 2), cycle in s, tensions (n, K)): the line goes on from the first row, which is where it is, to each next one.
@entry_point(REAL, TABLE)
def follow(duration_s: float, table: Table) -> int:
    x, rows, offsets = floats(table, X, (1,)), integers(table, ROWS, (1,)), floats(table, OFFSETS, (1, 2))
    for line in range(offsets.shape[0]):
        first = SHARED + line * EACH
        p, s, u = (
            floats(table, first + P, (1,)),
            floats(table, first + STATE, (1,)),
            floats(table, first + INPUTS, (1,)),
        )
        w, memory = floats(table, first + WORK, (1,)), floats(table, first + MEMORY, (1,))
        follow_to(p, s, u, w, memory, rows, x, offsets[line], duration_s)
        observe(p, s, u, w, floats(table, first + OUT, (1,)))
        _gather(table, line)
    return 0


@entry_point(REAL, TABLE)
def show(unused: float, table: Table) -> int:
    for line in range(floats(table, OFFSETS, (1, 2)).shape[0]):
        _gather(table, line)
    return 0


@entry_point(REAL, TABLE)
def put(unused: float, table: Table) -> int:
    motions = floats(table, MOTIONS, (1, 2))
    for line in range(motions.shape[0]):
        first = SHARED + line * EACH
        p, s, u = (
            floats(table, first + P, (1,)),
            floats(table, first + STATE, (1,)),
            floats(table, first + INPUTS, (1,)),
        )
        for j in range(motions.shape[1]):
            s[lay.S_Y + j] = motions[line, j]
        w, out = floats(table, first + WORK, (1,)), floats(table, first + OUT, (1,))
        line_vectors.show(LineVectors(p, s, u, w, out))
        _gather(table, line)
    return 0


@entry_point(REAL, TABLE)
def pull(lead_s: float, table: Table) -> int:
    pull_alone(table, lead_s)
    return 0


@entry_point(REAL, TABLE)
def hand_on(unused: float, table: Table) -> int:
    has, at = floats(table, FROM, (1,)), integers(table, PLACES, (1,))
    p, s, u = floats(table, TO + P, (1,)), floats(table, TO + STATE, (1,)), floats(table, TO + INPUTS, (1,))
    for j in range(len(at)):
        s[lay.S_Y + at[j]] = has[lay.S_Y + at[j]]
    line_vectors.show(LineVectors(p, s, u, floats(table, TO + WORK, (1,)), floats(table, TO + OUT, (1,))))
    return 0


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR)
def moduli(p: Vector, s: Vector, u: Vector, out: Vector) -> None:
    put_moduli(p, s, u, out, 0)


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, INDICES, MATRIX, MATRIX, REAL, MATRIX)
def follow_rows(
    p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, memory: Vector, rows: Rows, x: Matrix, boundary: Matrix,
    cycle_s: float, tensions: Matrix,
) -> None:  # fmt: skip
    m, further = int(p[lay.W_MOTORS]), np.zeros(len(rows))
    for row in range(x.shape[0]):
        before = max(row - 1, 0)
        u[lay.U_STRAIN_PREV], u[lay.U_F_NEXT_N] = boundary[before, 0], boundary[before, 1]
        if row > 0:
            follow_to(p, s, u, w, memory, rows, x[row], further, cycle_s)
        observe(p, s, u, w, out)
        for j in range(tensions.shape[1]):
            tensions[row, j] = out[3 * m + j]
