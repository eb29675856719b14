"""Model kernel: a line of rollers, carriages and reels with the web between them, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torque of the current
loops known in closed form. Standstill under dry friction and the flanks of gear play are events: located in time, then
the roller sticks or slides, the gear touches or not; nothing is smoothed, nothing chatters.

Vectors as in `hilbench.plant.web_line.layout`. Compiled functions pass whole vectors and take records from them; during
a step nothing is allocated or reference-counted (`hilbench.compiled`). A step without events is compiled once for the
one-span line, with the counts of axes, motors and spans as constants: every offset is one, and quantities stay in
registers. Events, and laws with a wave or an iteration in them, stay calls. A step without events costs four
evaluations of the rates; an event shows in the speeds at its end, unless a roller sticks or a gear has play.

Arguments that mean the same everywhere, float64 and SI: `line` of `n` axes, `m` motors and `k` spans, with `p` (P,)
parameters, `s` (S,) state, `u` (U,) inputs, `w` (W,) scratch space; `i` an axis and `j` a motor, from 0; `y` the offset
in `w` of a block of integrated quantities (now, stage, …); `t` the time since the start and `h` the length of a step,
both s. Positions, speeds, masses and forces are those at the web. Stepping functions change `s` and `w` in place.
"""

from __future__ import annotations

from math import inf

from hilbench.compiled import COUNT, VECTOR, Vector, compiled, entry_point, inlined, merged, noinline
from hilbench.plant import drive_loops as loops
from hilbench.plant import motor_laws as motors
from hilbench.plant.web_line import events, laws, motion, records, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.records import LineArrays


@inlined
def _sample_drive(line: LineArrays, j: int, x_rad: float, v_rad_s: float) -> None:
    """Sample the loops of motor j once, on its measured shaft motion; its mean torque till the next."""
    drive, part, sample_s = records.drive(line, j), records.part(line, j), records.web(line).sample_time_s
    motor, given = records.motor(line, j), records.given(line, j)
    loops.drive_sample(motor, drive, given, sample_s, x_rad, v_rad_s, part.kp, part.ki, part.current_s)
    command = drive.command_Nm
    drive.mean_Nm += command + (drive.torque_Nm - command) * part.lag_share


@compiled
def _sample_erring_drives(line: LineArrays) -> None:
    """Sample all drives, with encoder errors; steps of inertia come in, and feed-forward is left out of the means."""
    noinline()
    motion.set_masses(line, time_s(line))
    for j in range(line.m):
        at, motor = motion.shaft_of_motor(line, j), records.motor(line, j)
        x_rad, v_rad_s = line.w[at] * motor.rad_per_m, line.w[at + line.n] * motor.rad_per_m
        error = motor.encoder_error
        x_rad, v_rad_s = motors.measured_motion(error.amplitude_rad, error.phase_rad, x_rad, v_rad_s)
        _sample_drive(line, j, x_rad, v_rad_s)
    _leave_out(line, False)


@inlined
def time_s(line: LineArrays) -> float:
    """Time since the start."""
    return line.s[lay.S_COUNT] * records.web(line).sample_time_s


@merged
def advance_line(line: LineArrays, samples: int, counted: bool) -> None:
    """`go_on` of a line with these counts; `counted`: they are compile-time constants, and the rates are compiled with
    them."""
    call, period, m = records.call(line), records.web(line).sample_time_s, line.m
    substeps, integration, reports = int(call.substeps), call.integration, call.reports != 0.0
    h = period / substeps
    spliced = line.k > 0 and splice_laws.has_splice(records.web(line), records.pieces(line))
    for j in range(m):
        records.drive(line, j).mean_Nm = 0.0
    for _ in range(samples):
        if integration == lay.HELD:
            pass
        elif reports:
            _sample_erring_drives(line)
        else:
            for j in range(m):
                at, ratio = motion.shaft_of_motor(line, j), records.motor(line, j).rad_per_m
                _sample_drive(line, j, line.w[at] * ratio, line.w[at + line.n] * ratio)
        for substep in range(substeps):
            t = line.s[lay.S_COUNT] * period + substep * h
            laws.put_step_factors(line, t, h)
            if spliced:
                _follow_pieces(line, t, h)
            if integration == lay.HELD:
                motion.integrate(line, t, h, False, True)
                motion.accept(line)
                continue
            # Without gear play and a sticking roller an event shows in the speeds at the step's end.
            may_step = integration != lay.WITH_PLAY
            for i in range(line.n):
                may_step &= not (motion.sticks(line, i) or motion.is_at_stop(line, i))
            if may_step and integration == lay.USUAL and counted:
                motion.integrate(line, t, h, True, False)
            elif may_step and integration == lay.USUAL:
                motion.integrate_usual(line, t, h)
            elif may_step:
                motion.integrate_any(line, t, h)
            if may_step and events.still_slides(line):
                motion.accept(line)
            else:
                events.step_with_events(line, t, h)
        line.s[lay.S_COUNT] += 1.0
        if integration == lay.HELD:
            continue
        for j in range(m):
            line.s[records.past(line, j) + int(line.s[lay.S_COUNT]) % lay.RING] = records.drive(line, j).torque_Nm
        if reports:
            _leave_out(line, True)
    for j in range(m):
        records.drive(line, j).mean_Nm /= samples


@compiled
def acceleration_m_s2(line: LineArrays, t: float, j: int) -> float:
    """Acceleration of the motor of axis j now; 0 where it sticks. Between `enter` and `leave`."""
    noinline()
    motion.torques_now(line)
    events.web_at(line, t, 0)
    drive = motion.motor_force_N(line, j, line.w[motion.shaft_of_motor(line, j)], False)
    if motion.is_apart(line, j):
        return drive * records.part(line, j).per_motor_kg
    if motion.sticks(line, j):
        return 0.0
    web = motion.web_force_N(line, j, 0, motion.strain_prev(line, t), False)
    force = motion.own_force_N(line, j, 0, False) + drive
    per_kg = motion.per_kg(line, j, 0)
    return motion.acceleration_m_s2(line, j, line.w[line.n + j], per_kg, force, web, drive, False)


@compiled
def _fed_forward_Nm(line: LineArrays, j: int) -> float:
    """Torque of motor j now that its record excludes."""
    axis, motor, t = records.axis(line, j), records.motor(line, j), time_s(line)
    acceleration, direction = acceleration_m_s2(line, t, j), records.mode(line, j).direction
    speed = line.w[line.n + motion.shaft_of_motor(line, j)]
    mass = laws.mass_kg(axis, t, records.web(line).sample_time_s)
    return laws.fed_forward_N(axis, motor, mass, speed, acceleration, direction) / motor.rad_per_m


@compiled
def _follow_pieces(line: LineArrays, t: float, h: float) -> None:
    """Update pieces of other web for a step from t on: a pending one may come in, passed ones are dropped."""
    noinline()
    n, w, pieces, strain_prev = line.n, line.w, records.pieces(line), motion.strain_prev(line, t)
    travel = reels.web_travel_m(records.axis(line, 0), w[0])
    splice_laws.let_splice_in(records.web(line), pieces, t, h, travel, w[n], strain_prev)
    web_m = 0.0
    for j in range(line.k):
        web_m += w[4 * n + j]
    splice_laws.forget_passed(pieces, travel, strain_prev, web_m)
    records.call(line).blur_m = max(abs(w[n]) * h, lay.LEAST_BLUR_M)


@compiled
def _leave_out(line: LineArrays, recorded: bool) -> None:
    """Subtract the excluded feed-forward now, at the start or end of a sample time: half of it from the mean torques,
    and from the torques just `recorded`."""
    noinline()
    for j in range(line.m):
        if laws.has_feed_forward(records.motor(line, j)):
            fed = _fed_forward_Nm(line, j)
            if recorded:
                line.s[records.past(line, j) + int(line.s[lay.S_COUNT]) % lay.RING] -= fed
            records.drive(line, j).mean_Nm -= 0.5 * fed


@compiled
def _advance_one_span(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    advance_line(LineArrays(p, s, u, w, 2, 2, 1), samples, True)


@compiled
def _advance_rig(line: LineArrays, samples: int) -> None:
    noinline()
    p, s, u, w = line.p, line.s, line.u, line.w
    if line.n == 1:
        advance_line(LineArrays(p, s, u, w, 1, 2, 0), samples, True)
    else:
        advance_line(LineArrays(p, s, u, w, 2, 3, 0), samples, True)


@compiled
def _advance_any(line: LineArrays, samples: int) -> None:
    noinline()
    advance_line(line, samples, False)


@merged
def go_on(line: LineArrays, samples: int) -> None:
    """Advance by `samples` drive samples, between `enter` and `leave`; counts are constants for one span and rigs."""
    if line.n == 2 and line.m == 2 and line.k == 1:
        _advance_one_span(line.p, line.s, line.u, line.w, samples)
    elif line.k == 0 and ((line.n == 1 and line.m == 2) or (line.n == 2 and line.m == 3)):
        _advance_rig(line, samples)
    else:
        _advance_any(line, samples)


@compiled
def enter(line: LineArrays) -> None:
    """Load the integrated quantities and the constants of a call into the scratch space.

    Masses and effects may have changed between two calls, and the scratch space may have served another line.
    """
    n, m, k, call, web = line.n, line.m, line.k, records.call(line), records.web(line)
    for j in range(records.block(line, 1)):
        line.w[j] = line.s[lay.S_Y + j]
    for j in range(k):
        records.part(line, j).length_rate_m_s = line.u[lay.U_MOTORS + m * lay.UM_SIZE + j]
    period, substeps, held = web.sample_time_s, web.substeps, True
    for i in range(n):
        held &= records.axis(line, i).roller_mass_kg == inf
    integration, reports = lay.HELD if held else lay.USUAL, False
    if not held:
        motion.set_masses(line, time_s(line))
    for i in range(0 if held else n):
        axis = records.axis(line, i)
        reports |= motors.is_any(axis.inertia_step, 1)
        if axis.resonance.inertia_share != 0.0:
            substeps = max(substeps, laws.resonance_steps(axis, period))
        if axis.backlash.gap_rad > 0.0:
            integration = lay.WITH_PLAY
        general = axis.unbalance.amplitude_Nm != 0.0 or axis.unbalance_Nm != 0.0 or axis.resonance.inertia_share != 0.0
        general |= axis.quadratic_drag.coefficient_N_s2_per_m2 != 0.0
        ripples = motors.is_any(records.motor(line, i).torque_ripple_load, 0)
        general |= axis.load_dependent_friction.share != 0.0 or axis.reel_slope_per_m != 0.0 or n > k + 1 > 1
        if general or ripples:
            integration = max(integration, lay.GENERAL)
    if k > 0 and splice_laws.has_splice(web, records.pieces(line)):
        integration = max(integration, lay.GENERAL)
        call.blur_m = max(abs(line.w[n]) * (period / substeps), lay.LEAST_BLUR_M)
    call.integration, call.substeps = integration, substeps
    for j in range(m):
        motor, part = records.motor(line, j), records.part(line, j)
        reports |= laws.has_feed_forward(motor) or motor.encoder_error.amplitude_rad != 0.0
        if held:
            continue
        part.kp = motor.kp * (1.0 + motor.drive_gain.kp_relative_change)
        part.ki = motor.ki * (1.0 + motor.drive_gain.ki_relative_change)
        part.current_s = laws.current_loop_s(motor)
        part.lag_share = part.current_s * (1.0 - loops.current_decay(period, part.current_s)) / period
    call.reports = 1.0 if reports else 0.0
    if not held:
        motion.set_decays(line, period / substeps)


@compiled
def leave(line: LineArrays) -> None:
    """Copy the integrated quantities back into the state."""
    for j in range(records.block(line, 1)):
        line.s[lay.S_Y + j] = line.w[j]


@compiled
def set_modes(line: LineArrays) -> None:
    """Set friction direction and gear contact by the motion, after a change of it."""
    for i in range(line.n):
        speed, mode, axis = line.s[lay.S_Y + line.n + i], records.mode(line, i), records.axis(line, i)
        mode.direction = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else speed)
        if not (axis.backlash.gap_rad > 0.0 or axis.resonance.inertia_share != 0.0):
            mode.contact = 0.0
            line.s[lay.S_Y + 3 * line.n + i] = speed


@merged
def _report_line(line: LineArrays, out: Vector, at: int) -> None:
    n, m, k, web, w = line.n, line.m, line.k, records.web(line), line.w
    t, call = time_s(line), records.call(line)
    laws.put_step_factors(line, t, web.sample_time_s / call.substeps)
    motion.web(line, t, motion.strain_prev(line, t), 0, False)
    for j in range(m):
        shaft, motor, drive = motion.shaft_of_motor(line, j), records.motor(line, j), records.drive(line, j)
        torque, ratio = drive.torque_Nm, motor.rad_per_m
        out[at + j], out[at + m + j] = w[shaft], w[shaft + n]
        error = motor.encoder_error
        if call.reports != 0.0 and error.amplitude_rad != 0.0:
            turned = w[shaft] * ratio, w[shaft + n] * ratio
            x_rad, v_rad_s = motors.measured_motion(error.amplitude_rad, error.phase_rad, *turned)
            out[at + j], out[at + m + j] = x_rad / ratio, v_rad_s / ratio
        if call.reports != 0.0 and laws.has_feed_forward(motor):
            torque -= _fed_forward_Nm(line, j)
        delay = motor.torque_delay.delay_s / web.sample_time_s
        if delay > 0.0:
            count = int(line.s[lay.S_COUNT])
            torque = motors.past_torque_Nm(line.s, records.past(line, j), lay.RING, count, delay)
        out[at + 2 * m + j] = torque + motor.torque_offset.offset_Nm
        out[at + 3 * m + 2 * k + j] = drive.mean_Nm + motor.torque_offset.offset_Nm
    for j in range(k):
        out[at + 3 * m + j] = records.part(line, j).tension_N
        out[at + 3 * m + k + j] = laws.stretch(line, 4 * n, j) - 1.0


@compiled
def _report_any(line: LineArrays, out: Vector, at: int) -> None:
    noinline()
    _report_line(line, out, at)


@merged
def report(line: LineArrays, out: Vector, at: int) -> None:
    """Write measured and true values now to `out` from offset `at` on; between `enter` and `leave`."""
    if line.n == 2 and line.m == 2 and line.k == 1:
        _report_line(LineArrays(line.p, line.s, line.u, line.w, 2, 2, 1), out, at)
    else:
        _report_any(line, out, at)


@inlined
def columns(line: LineArrays) -> int:
    """Columns of a row of `report`."""
    return 4 * line.m + 2 * line.k


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, COUNT, allocates=False)
def advance(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    """Advance a line by `samples` drive samples."""
    line = records.line_of(p, s, u, w)
    enter(line)
    go_on(line, samples)
    leave(line)


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, allocates=False)
def observe(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector) -> None:
    """Write measured motion and torque, tension and strain now to `out` (`Layout.columns`)."""
    line = records.line_of(p, s, u, w)
    enter(line)
    report(line, out, 0)
