"""Model kernel: a line of rollers, carriages and reels with the web between them, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torque of the current
loops known in closed form. Standstill under dry friction and the flanks of gear play are events: located in time, then
the roller sticks or slides, the gear touches or not; nothing is smoothed, nothing chatters.

Vectors as in `hilbench.plant.web_line.layout`. Compiled functions pass whole vectors and offsets; during a step nothing
is allocated or reference-counted (`hilbench.compiled`). A step without events is compiled once for the one-span line,
with the counts of axes, motors and spans as constants: every offset is one, and quantities stay in registers. Events,
and laws with a wave or an iteration in them, stay calls. A step without events costs four evaluations of the rates; an
event shows in the speeds at its end, unless a roller sticks or a gear has play.

Arguments that mean the same everywhere, float64 and SI: `p` (P,) parameters, `s` (S,) state, `u` (U,) inputs, `w` (W,)
scratch space, all of one line of `n` axes, `m` motors and `k` spans; `i` an axis and `j` a motor, from 0; `y` the
offset in `w` of a block of integrated quantities (now, stage, …); `t` the time since the start and `h` the length of a
step, both s. Positions, speeds, masses and forces are those at the web. Stepping functions change `s` and `w` in place.
"""

from __future__ import annotations

from collections.abc import Callable

from hilbench.compiled import (
    COUNT,
    CUBE,
    MATRIX,
    VECTOR,
    compiled,
    entry_point,
    inlined,
    merged,
    noinline,
)
from hilbench.plant import drive_loops as loops
from hilbench.plant.web_line import events, laws, motion, places, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def _sample_drive(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, j: int, position: float, velocity: float
) -> None:
    """Sample the loops of motor j once, on its measured shaft motion, rad and rad/s; its mean torque till the next."""
    gains, state, inputs = places.motor(n, j) + lay.M_LOOPS, places.motor_state(n, k, j), lay.U_MOTORS + j * lay.UM_SIZE
    kp, ki = w[places.part(n, m, k, lay.LOOP_KP) + j], w[places.part(n, m, k, lay.LOOP_KI) + j]
    current_s = w[places.part(n, m, k, lay.LOOP_CURRENT_S) + j]
    loops.drive_sample(p, s, u, gains, state, inputs, p[lay.W_SAMPLE_TIME_S], position, velocity, kp, ki, current_s)
    command, lag_share = s[state + lay.SM_COMMAND_NM], w[places.part(n, m, k, lay.LAG_SHARE) + j]
    s[state + lay.SM_MEAN_NM] += command + (s[state + lay.SM_TORQUE_NM] - command) * lag_share


@inlined
def _sample_drives(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int) -> None:
    for j in range(m):
        at, ratio = motion.shaft_of_motor(p, n, j), p[places.motor(n, j) + lay.M_RAD_PER_M]
        _sample_drive(p, s, u, w, n, m, k, j, w[at] * ratio, w[at + n] * ratio)


@compiled
def _sample_erring_drives(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Sample all drives, with encoder errors; steps of inertia come in, and feed-forward is left out of the means."""
    noinline()
    n, m, k = places.counts(p)
    motion.set_masses(p, w, s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S])
    for j in range(m):
        at, motor = motion.shaft_of_motor(p, n, j), places.motor(n, j)
        ratio = p[motor + lay.M_RAD_PER_M]
        position, velocity = laws.measured_motion(p, motor, w[at] * ratio, w[at + n] * ratio)
        _sample_drive(p, s, u, w, n, m, k, j, position, velocity)
    _leave_out_of_means(p, s, u, w)


@merged
def _simple_step(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    n: int,
    m: int,
    k: int,
    t: float,
    h: float,
    pace: float,
    counted: bool,
) -> bool:
    """Take one step unless there is an event in it; True if taken.

    `pace`: integration mode of the line; without gear play and a sticking roller an event shows in the speeds at the
    step's end. `counted`: compile-time constant, as are the counts then; the rates are compiled with them.
    """
    if pace == lay.PLAY or events.any_sticks(p, s, n, k):
        return False
    if counted and pace == lay.PLAIN:
        motion.integrate(p, s, u, w, n, m, k, t, h, True)
    elif pace == lay.PLAIN:
        motion.integrate_plain(p, s, u, w, t, h)
    else:
        motion.integrate_any(p, s, u, w, t, h)
    if not events.still_slides(p, s, w, n, k):
        return False
    motion.accept(s, w, n, m, k)
    return True


@merged
def advance_line(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, samples: int, counted: bool
) -> None:
    """`go_on` of a line with these counts; `counted`: the counts are compile-time constants."""
    substeps = int(w[places.part(n, m, k, lay.SUBSTEPS)])
    period = p[lay.W_SAMPLE_TIME_S]
    h = period / substeps
    pace, reports = w[places.part(n, m, k, lay.PACE)], w[places.part(n, m, k, lay.REPORTS)] != 0.0
    spliced = k > 0 and splice_laws.has_splice(p, s, places.pieces(n, m, k))
    for j in range(m):
        s[places.motor_state(n, k, j) + lay.SM_MEAN_NM] = 0.0
    for _ in range(samples):
        if reports:
            _sample_erring_drives(p, s, u, w)
        else:
            _sample_drives(p, s, u, w, n, m, k)
        for substep in range(substeps):
            t = s[lay.S_COUNT] * period + substep * h
            laws.put_step_factors(p, places.first_span(n, m), k, t, h, w, places.part(n, m, k, lay.STEPS))
            if spliced:
                _follow_pieces(p, s, u, w, t, h)
            if not _simple_step(p, s, u, w, n, m, k, t, h, pace, counted):
                events.step_with_events(p, s, u, w, t, h)
        s[lay.S_COUNT] += 1.0
        for j in range(m):
            place = places.past(n, m, k, j) + int(s[lay.S_COUNT]) % lay.RING
            s[place] = s[places.motor_state(n, k, j) + lay.SM_TORQUE_NM]
        if reports:
            _leave_out(p, s, u, w)
    for j in range(m):
        s[places.motor_state(n, k, j) + lay.SM_MEAN_NM] /= samples


@compiled
def acceleration_m_s2(p: Vector, s: Vector, u: Vector, w: Vector, t: float, j: int) -> float:
    """Acceleration of the motor of axis j now; 0 where it sticks. Between `enter` and `leave`."""
    noinline()
    n, m, k = places.counts(p)
    motion.torques_now(s, w, n, m, k)
    events.web_at(p, s, u, w, t, 0)
    drive = motion.motor_force_N(p, w, n, m, k, j, w[motion.shaft_of_motor(p, n, j)], False)
    if motion.is_apart(p, s, n, k, j):
        return drive * w[places.part(n, m, k, lay.PER_MOTOR_MASS) + j]
    if motion.sticks(p, s, n, k, j):
        return 0.0
    strain_prev = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    web = motion.web_force_N(p, u, w, n, m, k, j, 0, strain_prev, False)
    force = motion.own_force_N(p, w, n, m, k, j, 0, False) + drive
    per_mass = motion.per_mass(p, w, n, m, k, j, 0)
    return motion.acceleration_m_s2(p, s, n, k, j, w[n + j], per_mass, force, web, drive, False)


@compiled
def _fed_forward_Nm(p: Vector, s: Vector, u: Vector, w: Vector, t: float, j: int) -> float:
    """Torque of motor j now that its record excludes."""
    n, _, k = places.counts(p)
    axis, motor = places.axis(j), places.motor(n, j)
    acceleration, direction = acceleration_m_s2(p, s, u, w, t, j), s[places.axis_state(n, k, j) + lay.SA_DIRECTION]
    speed = w[n + motion.shaft_of_motor(p, n, j)]
    fed = laws.fed_forward_N(p, axis, motor, laws.mass_kg(p, axis, t), speed, acceleration, direction)
    return fed / p[motor + lay.M_RAD_PER_M]


@inlined
def _set_blur(w: Vector, n: int, m: int, k: int, h: float) -> None:
    """Set the blur length of pieces' ends in a step of length h."""
    w[places.part(n, m, k, lay.SPLICE_BLUR)] = max(abs(w[n]) * h, lay.LEAST_BLUR_M)


@compiled
def _follow_pieces(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """Update pieces of other web for a step from t on: a pending one may come in, passed ones are dropped."""
    noinline()
    n, m, k = places.counts(p)
    pieces, strain_prev = places.pieces(n, m, k), laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    travel = motion.web_travel_m(p, w[0])
    splice_laws.let_splice_in(p, s, pieces, t, h, travel, w[n], strain_prev)
    web_m = 0.0
    for j in range(k):
        web_m += w[4 * n + j]
    splice_laws.forget_passed(s, pieces, travel, strain_prev, web_m)
    _set_blur(w, n, m, k, h)


@compiled
def _leave_out(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Subtract the excluded feed-forward from the torques just recorded."""
    noinline()
    n, m, k = places.counts(p)
    for j in range(m):
        if laws.has_feed_forward(p, places.motor(n, j)):
            fed = _fed_forward_Nm(p, s, u, w, s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S], j)
            s[places.past(n, m, k, j) + int(s[lay.S_COUNT]) % lay.RING] -= fed
    _leave_out_of_means(p, s, u, w)


@compiled
def _leave_out_of_means(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Subtract half of the excluded feed-forward now, at the start or end of a sample time, from the mean torques."""
    noinline()
    n, m, k = places.counts(p)
    for j in range(m):
        if laws.has_feed_forward(p, places.motor(n, j)):
            fed = _fed_forward_Nm(p, s, u, w, s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S], j)
            s[places.motor_state(n, k, j) + lay.SM_MEAN_NM] -= 0.5 * fed


@compiled
def _advance_one_span(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    advance_line(p, s, u, w, 2, 2, 1, samples, True)


@compiled
def _advance_rig(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    if places.has_counts(p, 1, 2, 0):
        advance_line(p, s, u, w, 1, 2, 0, samples, True)
    else:
        advance_line(p, s, u, w, 2, 3, 0, samples, True)


@compiled
def _advance_any(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    n, m, k = places.counts(p)
    advance_line(p, s, u, w, n, m, k, samples, False)


@merged
def go_on(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    """Advance by `samples` drive samples, between `enter` and `leave`; counts are constants for one span and rigs."""
    if places.has_counts(p, 2, 2, 1):
        _advance_one_span(p, s, u, w, samples)
    elif places.has_counts(p, 1, 2, 0) or places.has_counts(p, 2, 3, 0):
        _advance_rig(p, s, u, w, samples)
    else:
        _advance_any(p, s, u, w, samples)


@compiled
def enter(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Load the integrated quantities and the constants of a call into the scratch space.

    Masses and effects may have changed between two calls, and the scratch space may have served another line.
    """
    n, m, k = places.counts(p)
    for j in range(places.block(n, k, 1)):
        w[j] = s[lay.S_Y + j]
    for j in range(k):
        w[places.part(n, m, k, lay.LENGTH_RATE) + j] = u[lay.U_MOTORS + m * lay.UM_SIZE + j]
    period, substeps = p[lay.W_SAMPLE_TIME_S], p[lay.W_SUBSTEPS]
    motion.set_masses(p, w, s[lay.S_COUNT] * period)
    pace, reports = lay.PLAIN, False
    for i in range(n):
        axis = places.axis(i)
        reports |= laws.has_inertia_step(p, axis)
        if laws.twists(p, axis):
            substeps = max(substeps, laws.swing_steps(p, axis, period))
        if laws.has_gap(p, axis):
            pace = lay.PLAY
        elif laws.has_rare_force(p, axis, places.motor(n, i)):
            pace = max(pace, lay.RARE)
    if k > 0 and (n > k + 1 or reels.is_reel(p, places.axis(0)) or reels.is_reel(p, places.axis(k))):
        pace = max(pace, lay.RARE)
    if k > 0 and splice_laws.has_splice(p, s, places.pieces(n, m, k)):
        pace = max(pace, lay.RARE)
        _set_blur(w, n, m, k, period / substeps)
    w[places.part(n, m, k, lay.PACE)], w[places.part(n, m, k, lay.SUBSTEPS)] = pace, substeps
    for j in range(m):
        motor = places.motor(n, j)
        reports |= laws.has_feed_forward(p, motor) or laws.has_encoder_error(p, motor)
        w[places.part(n, m, k, lay.LOOP_KP) + j] = laws.velocity_kp(p, motor)
        w[places.part(n, m, k, lay.LOOP_KI) + j] = laws.velocity_ki(p, motor)
        current_s = laws.current_loop_s(p, motor)
        w[places.part(n, m, k, lay.LOOP_CURRENT_S) + j] = current_s
        decay = loops.current_decay(period, current_s)
        w[places.part(n, m, k, lay.LAG_SHARE) + j] = current_s * (1.0 - decay) / period
    w[places.part(n, m, k, lay.REPORTS)] = 1.0 if reports else 0.0
    motion.set_decays(p, w, period / substeps)


@compiled
def leave(s: Vector, w: Vector, size: int) -> None:
    """Copy the integrated quantities back into the state."""
    for j in range(size):
        s[lay.S_Y + j] = w[j]


@merged
def _report_line(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, out: Vector, at: int) -> None:
    period = p[lay.W_SAMPLE_TIME_S]
    t = s[lay.S_COUNT] * period
    step = period / w[places.part(n, m, k, lay.SUBSTEPS)]
    laws.put_step_factors(p, places.first_span(n, m), k, t, step, w, places.part(n, m, k, lay.STEPS))
    motion.web(p, s, u, w, n, m, k, t, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t), 0, False)
    reports = w[places.part(n, m, k, lay.REPORTS)] != 0.0
    for j in range(m):
        shaft, state = motion.shaft_of_motor(p, n, j), places.motor_state(n, k, j)
        motor, torque = places.motor(n, j), s[state + lay.SM_TORQUE_NM]
        out[at + j] = w[shaft]
        out[at + m + j] = w[shaft + n]
        if reports and laws.has_encoder_error(p, motor):
            ratio = p[motor + lay.M_RAD_PER_M]
            position, velocity = laws.measured_motion(p, motor, w[shaft] * ratio, w[shaft + n] * ratio)
            out[at + j] = position / ratio
            out[at + m + j] = velocity / ratio
        if reports and laws.has_feed_forward(p, motor):
            torque -= _fed_forward_Nm(p, s, u, w, t, j)
        out[at + 2 * m + j] = laws.measured_torque_Nm(p, motor, torque, s, places.past(n, m, k, j), int(s[lay.S_COUNT]))
        out[at + 3 * m + 2 * k + j] = s[state + lay.SM_MEAN_NM] + laws.reported_offset_Nm(p, motor)
    for j in range(k):
        out[at + 3 * m + j] = w[places.part(n, m, k, lay.TENSION) + j]
        scale = laws.length_factor(p, places.first_span(n, m) + j * lay.SP_SIZE)
        out[at + 3 * m + k + j] = w[4 * n + k + j] * scale / w[4 * n + j] - 1.0


@compiled
def _report_any(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, at: int) -> None:
    noinline()
    n, m, k = places.counts(p)
    _report_line(p, s, u, w, n, m, k, out, at)


@merged
def report(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, at: int) -> None:
    """Write measured and true values now to `out` from offset `at` on; between `enter` and `leave`."""
    if places.has_counts(p, 2, 2, 1):
        _report_line(p, s, u, w, 2, 2, 1, out, at)
    else:
        _report_any(p, s, u, w, out, at)


@compiled
def _rows(
    p: Vector, s: Vector, u: Vector, w: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector, at: int
) -> None:
    """Observe and advance, row by row, to `out` from offset `at` on; between `enter` and `leave`.

    `commands` (n, M) set points, motor side, and `boundary` (n, 2), upstream strain and downstream tension (N), each
    held for `samples` drive samples.
    """
    _, m, k = places.counts(p)
    for row in range(commands.shape[0]):
        u[lay.U_STRAIN_PREV] = boundary[row, 0]
        u[lay.U_F_NEXT_N] = boundary[row, 1]
        for j in range(commands.shape[1]):
            u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, j]
        report(p, s, u, w, out, at + row * (4 * m + 2 * k))
        go_on(p, s, u, w, samples)


Observe = Callable[[Vector, Vector, Vector, Vector, Vector], None]


#: advance(parameters, state, inputs, work, samples): `samples` drive sample times onwards, state changed in place.
#: observe(parameters, state, inputs, work, out): measured motion and torque, tension, strain (`Layout.columns`).
#: simulate(parameters (B, P), states (B, S), inputs, work, commands (n, M), boundary (n, 2), samples, out (B, n, C)):
#: for each row observe, then advance `samples` with the row's set points, upstream strain and downstream tension.
@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, COUNT)
def advance(p: Vector, s: Vector, u: Vector, work: Vector, samples: int) -> None:
    enter(p, s, u, work)
    go_on(p, s, u, work, samples)
    leave(s, work, places.block(int(p[lay.W_AXES]), int(p[lay.W_SPANS]), 1))


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def observe(p: Vector, s: Vector, u: Vector, work: Vector, out: Vector) -> None:
    enter(p, s, u, work)
    report(p, s, u, work, out, 0)


@entry_point(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, COUNT, CUBE)
def simulate(
    p: Vector, s: Vector, u: Vector, work: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector
) -> None:
    flat, rows, columns = out.reshape(-1), out.shape[1], out.shape[2]
    for b in range(p.shape[0]):
        parameters, state = p[b], s[b]
        enter(parameters, state, u, work)
        _rows(parameters, state, u, work, commands, boundary, samples, flat, b * rows * columns)
        leave(state, work, places.block(int(parameters[lay.W_AXES]), int(parameters[lay.W_SPANS]), 1))
