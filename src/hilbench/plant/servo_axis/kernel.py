"""Kernel of the servo axis: one shaft with one or two motors, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torques of the current
loops known in closed form. Standstill under dry friction is an event: it is located in time, then the shaft sticks or
turns back; nothing is smoothed, nothing chatters.

    J·v' = τ_m + τ_load + τ_outside + A_u·sin(x/i + φ_u) − b·v − d·|v| − c·v·|v|
           − (Tc + Ts·e^{−(v/vs)²} + k·|τ_m|)·sign(v),   τ_m = (1 + s)·τ·(1 + Σ B·sin(n·x + φ)) + Σ A·sin(n·x + φ)

With a resonance a share μ of J is behind a shaft that is twisted by q, and oscillates at ω with the motor held: μ·J·a₂
is taken off the torques, (1 − μ)·J is left at the motor, a₂ = −ω²·q − 2ζω·q', q'' = a₂ − v'.

Vectors as in `hilbench.plant.servo_axis.layout`.
"""

from __future__ import annotations

from hilbench.compiled import (
    COUNT,
    CUBE,
    MATRIX,
    REAL,
    VECTOR,
    compiled,
    entry_point,
    inlined,
    noinline,
)
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import laws
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import Vector

#: Most events within one integration step; then the rest of it is integrated without event location.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Tolerance of a violation: rad/s against the direction of motion, N·m beyond the breakaway torque.
_EVENT_TOLERANCE = 1e-10


@inlined
def _torques_Nm(p: Vector, s: Vector, u: Vector, ahead_s: float) -> tuple[float, float]:
    """Torques `ahead_s` from now, while the commands are held: the drive's own; all others."""
    own, others = 0.0, u[lay.U_TORQUE_NM]
    for j in range(int(p[lay.P_MOTORS])):
        at = lay.S_MOTORS + j * loops.STATE_SIZE
        decay = loops.current_decay(ahead_s, laws.current_loop_s(p, j))
        of_motor = loops.torque_after(s[at + loops.TORQUE_NM], s[at + loops.COMMAND_NM], decay)
        if j == 0:
            own = of_motor
        else:
            others += of_motor
    return own, others


@inlined
def _net_Nm(p: Vector, motor_Nm: float, others_Nm: float, x: float, v: float) -> float:
    """Sum of all torques on the shaft but dry friction; `motor_Nm`: the motor's shaft torque."""
    return motor_Nm + others_Nm + laws.unbalance_Nm(p, x) - laws.smooth_friction_Nm(p, v)


@inlined
def _acceleration(
    p: Vector, time_s: float, torques_Nm: tuple[float, float], x: float, v: float, direction: float, behind: float
) -> float:
    """Acceleration of a shaft that turns in `direction`, rad/s², at a time; torques as of `_torques_Nm`.

    behind: acceleration of the load behind a twisting shaft; unused without one.
    """
    motor = laws.shaft_torque_Nm(p, torques_Nm[0], x)
    net = _net_Nm(p, motor, torques_Nm[1], x, v)
    if laws.is_dry(p):
        net -= direction * (laws.dry_friction_Nm(p, v) + laws.load_friction_Nm(p, motor))
    if laws.twists(p):
        share = laws.share_behind(p)
        return (net / laws.inertia_kg_m2(p, time_s) - share * behind) / (1.0 - share)
    return net / laws.inertia_kg_m2(p, time_s)


@inlined
def _held_Nm(p: Vector, time_s: float, torques_Nm: tuple[float, float], x: float, behind: float) -> tuple[float, float]:
    """Torques on a shaft at rest: the sum without dry friction, and the breakaway torque.

    behind: as in `_acceleration`.
    """
    motor = laws.shaft_torque_Nm(p, torques_Nm[0], x)
    net = _net_Nm(p, motor, torques_Nm[1], x, 0.0)
    if laws.twists(p):
        net -= laws.share_behind(p) * laws.inertia_kg_m2(p, time_s) * behind
    return net, laws.breakaway_Nm(p) + laws.load_friction_Nm(p, motor)


@inlined
def _behind(p: Vector, s: Vector) -> float:
    """Acceleration of the load behind a twisting shaft, now; 0 without one."""
    return laws.acceleration_behind(p, s[lay.S_TWIST], s[lay.S_TWIST_RATE]) if laws.twists(p) else 0.0


@inlined
def _time_s(p: Vector, s: Vector) -> float:
    """Time since the start, at the last sample of the drive."""
    return s[lay.S_COUNT] * p[lay.P_SAMPLE_TIME_S]


@compiled
def _attempt(p: Vector, s: Vector, u: Vector, h: float) -> tuple[float, float, float, float, float]:
    """Position and speed after h in the present mode, its violation then (0 or less: none), twist and its rate.

    A turning shaft leaves its mode by a speed against its direction, a sticking one by a torque beyond breakaway.
    """
    if laws.twists(p):
        return _attempt_twisted(p, s, u, h)
    x, v, direction = s[lay.S_X], s[lay.S_V], s[lay.S_DIRECTION]
    last, dry, time_s = _torques_Nm(p, s, u, h), laws.is_dry(p), _time_s(p, s)
    if direction == 0.0 and dry:
        net, breakaway = _held_Nm(p, time_s, last, x, 0.0)
        return x, 0.0, abs(net) - breakaway, 0.0, 0.0
    middle = _torques_Nm(p, s, u, 0.5 * h)
    a1 = _acceleration(p, time_s, _torques_Nm(p, s, u, 0.0), x, v, direction, 0.0)
    v2 = v + 0.5 * h * a1
    a2 = _acceleration(p, time_s, middle, x + 0.5 * h * v, v2, direction, 0.0)
    v3 = v + 0.5 * h * a2
    a3 = _acceleration(p, time_s, middle, x + 0.5 * h * v2, v3, direction, 0.0)
    v4 = v + h * a3
    a4 = _acceleration(p, time_s, last, x + h * v3, v4, direction, 0.0)
    x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
    v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return x, v, -v * direction if dry else 0.0, 0.0, 0.0


@compiled
def _attempt_twisted(p: Vector, s: Vector, u: Vector, h: float) -> tuple[float, float, float, float, float]:
    """`_attempt` of a shaft with a resonance; the load behind it oscillates on while the motor sticks."""
    noinline()
    x, v, q, w = s[lay.S_X], s[lay.S_V], s[lay.S_TWIST], s[lay.S_TWIST_RATE]
    last, dry, direction = _torques_Nm(p, s, u, h), laws.is_dry(p), s[lay.S_DIRECTION]
    first, middle = _torques_Nm(p, s, u, 0.0), _torques_Nm(p, s, u, 0.5 * h)
    sticks, half = direction == 0.0 and dry, 0.5 * h
    a1, b1 = _slopes(p, s, first, x, v, q, w, sticks)
    v2, w2 = v + half * a1, w + half * b1
    a2, b2 = _slopes(p, s, middle, x + half * v, v2, q + half * w, w2, sticks)
    v3, w3 = v + half * a2, w + half * b2
    a3, b3 = _slopes(p, s, middle, x + half * v2, v3, q + half * w2, w3, sticks)
    v4, w4 = v + h * a3, w + h * b3
    a4, b4 = _slopes(p, s, last, x + h * v3, v4, q + h * w3, w4, sticks)
    x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
    v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    q += h / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4)
    w += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    if sticks:
        net, breakaway = _held_Nm(p, _time_s(p, s), last, x, laws.acceleration_behind(p, q, w))
        return x, 0.0, abs(net) - breakaway, q, w
    return x, v, -v * direction if dry else 0.0, q, w


@inlined
def _slopes(
    p: Vector, s: Vector, torques_Nm: tuple[float, float], x: float, v: float, q: float, w: float, sticks: bool
) -> tuple[float, float]:
    """Accelerations of a twisting shaft, and of its twist, rad/s²."""
    behind = laws.acceleration_behind(p, q, w)
    a = 0.0 if sticks else _acceleration(p, _time_s(p, s), torques_Nm, x, v, s[lay.S_DIRECTION], behind)
    return a, behind - a


@compiled
def _settle(p: Vector, s: Vector, u: Vector) -> None:
    """Change the mode until it fits: a shaft that has stopped sticks, or turns back at once."""
    v = s[lay.S_V]
    if s[lay.S_DIRECTION] == 0.0 and v != 0.0:
        s[lay.S_DIRECTION] = 1.0 if v > 0.0 else -1.0
    if not laws.is_dry(p):  # kept up to date, for friction that begins in motion
        s[lay.S_DIRECTION] = 1.0 if v > 0.0 else -1.0 if v < 0.0 else 0.0
        return
    if -v * s[lay.S_DIRECTION] > _EVENT_TOLERANCE:
        s[lay.S_DIRECTION] = 0.0
        s[lay.S_V] = 0.0
    if s[lay.S_DIRECTION] == 0.0:
        net, breakaway = _held_Nm(p, _time_s(p, s), _torques_Nm(p, s, u, 0.0), s[lay.S_X], _behind(p, s))
        if abs(net) > breakaway + _EVENT_TOLERANCE:
            s[lay.S_DIRECTION] = 1.0 if net > 0.0 else -1.0


@compiled
def _until_event(p: Vector, s: Vector, u: Vector, h: float) -> float:
    """Length of a step up to h until an event in it.

    The event's time is found by the Illinois form of regula falsi.
    """
    low, high, within, last = 0.0, h, -_EVENT_TOLERANCE, 0
    beyond = _attempt(p, s, u, h)[2]
    if beyond <= _EVENT_TOLERANCE:
        return h
    for _ in range(_EVENT_ITERATIONS):
        if high - low <= 1e-9 * h:
            break
        share = within / (within - beyond)
        cut = low + (high - low) * min(max(share, 1e-3), 0.999)
        violation = _attempt(p, s, u, cut)[2]
        if violation > _EVENT_TOLERANCE:
            within = 0.5 * within if last == 1 else within
            high, beyond, last = cut, violation, 1
        else:
            beyond = 0.5 * beyond if last == -1 else beyond
            low, within, last = cut, min(violation, -_EVENT_TOLERANCE), -1
    return high


@inlined
def _accept(p: Vector, s: Vector, x: float, v: float, h: float) -> None:
    """Accept the end of a step of length h; the torques have followed their commands."""
    s[lay.S_X] = x
    s[lay.S_V] = v
    for j in range(int(p[lay.P_MOTORS])):
        at = lay.S_MOTORS + j * loops.STATE_SIZE
        time_constant = laws.current_loop_s(p, j)
        decay = loops.current_decay(h, time_constant)
        if j == 0:
            command = s[at + loops.COMMAND_NM]
            s[lay.S_MEAN] += command * h + (s[at + loops.TORQUE_NM] - command) * time_constant * (1.0 - decay)
        s[at + loops.TORQUE_NM] = loops.torque_after(s[at + loops.TORQUE_NM], s[at + loops.COMMAND_NM], decay)


@compiled
def _step(p: Vector, s: Vector, u: Vector, h: float) -> None:
    """Integrate one step, cut at every event."""
    left = h
    for event in range(_MOST_EVENTS + 1):
        _settle(p, s, u)
        x, v, violation, twist, twist_rate = _attempt(p, s, u, left)
        done = left
        if violation > _EVENT_TOLERANCE and event < _MOST_EVENTS:
            done = _until_event(p, s, u, left)
            x, v, violation, twist, twist_rate = _attempt(p, s, u, done)
        s[lay.S_TWIST], s[lay.S_TWIST_RATE] = twist, twist_rate
        _accept(p, s, x, v, done)
        left -= done
        if left <= 1e-12 * h:
            return


@compiled
def acceleration_rad_s2(p: Vector, s: Vector, u: Vector) -> float:
    """Acceleration of the shaft now; 0 where it sticks."""
    noinline()
    direction = s[lay.S_DIRECTION]
    if direction == 0.0 and laws.is_dry(p):
        return 0.0
    torques = _torques_Nm(p, s, u, 0.0)
    return _acceleration(p, _time_s(p, s), torques, s[lay.S_X], s[lay.S_V], direction, _behind(p, s))


@inlined
def _fed_forward_Nm(p: Vector, s: Vector, u: Vector) -> float:
    """Feed-forward torque of the drive now, excluded from its record."""
    return laws.fed_forward_Nm(p, _time_s(p, s), s[lay.S_V], acceleration_rad_s2(p, s, u), s[lay.S_DIRECTION])


@compiled
def go_on(p: Vector, s: Vector, u: Vector, samples: int) -> None:
    """Advance by `samples` drive sample times, the state changed in place."""
    period, substeps = p[lay.P_SAMPLE_TIME_S], int(p[lay.P_SUBSTEPS])
    if laws.twists(p):
        substeps = max(substeps, laws.swing_steps(p, period))
    fed, first_x, first_v = laws.has_feed_forward(p), s[lay.S_X], s[lay.S_V]
    s[lay.S_MEAN] = 0.0
    for _ in range(samples):
        for j in range(int(p[lay.P_MOTORS])):
            x, v = s[lay.S_X], s[lay.S_V]
            if j == 0 and laws.has_encoder_error(p):
                x, v = laws.measured_motion(p, x, v)
            loops.drive_sample(
                p,
                s,
                u,
                lay.P_LOOPS + j * loops.LOOPS_SIZE,
                lay.S_MOTORS + j * loops.STATE_SIZE,
                lay.U_MOTORS + j * loops.IN_SIZE,
                period,
                x,
                v,
                laws.velocity_kp(p, j),
                laws.velocity_ki(p, j),
                laws.current_loop_s(p, j),
            )
        for _ in range(substeps):
            _step(p, s, u, period / substeps)
        s[lay.S_COUNT] += 1.0
        torque = s[lay.S_MOTORS + loops.TORQUE_NM]
        s[lay.S_PAST + int(s[lay.S_COUNT]) % lay.RING] = torque - _fed_forward_Nm(p, s, u) if fed else torque
    s[lay.S_MEAN] /= samples * period
    if fed:
        v, a = (s[lay.S_X] - first_x) / (samples * period), (s[lay.S_V] - first_v) / (samples * period)
        time_s = s[lay.S_COUNT] * period
        s[lay.S_MEAN] -= laws.fed_forward_Nm(p, time_s, v, a, s[lay.S_DIRECTION])


@compiled
def report(p: Vector, s: Vector, out: Vector, at: int) -> None:
    """Write the observed values to `out` from offset `at` on."""
    out[at + lay.O_X] = s[lay.S_X]
    out[at + lay.O_V] = s[lay.S_V]
    if laws.has_encoder_error(p):
        out[at + lay.O_X], out[at + lay.O_V] = laws.measured_motion(p, s[lay.S_X], s[lay.S_V])
    out[at + lay.O_MEAN] = s[lay.S_MEAN] + laws.reported_offset_Nm(p)
    for j in range(int(p[lay.P_MOTORS])):
        torque = s[lay.S_MOTORS + j * loops.STATE_SIZE + loops.TORQUE_NM]
        out[at + lay.O_TORQUE + j] = laws.reported_torque_Nm(p, torque, s) if j == 0 else torque


#: advance(parameters, state, inputs, samples): `samples` drive sample times onwards, state changed in place.
#: observe(parameters, state, out): position, speed, and the torques as the drives report them.
#: simulate(parameters (B, P), states (B, S), inputs, commands (n, M), torques (n,), samples, out (B, n, C)): for each
#: row observe, then advance `samples` with the row's set points and the row's torque from outside.
#: look(parameters, time_s): factor on the inertia then, dry friction at standstill, and offset of the reported torque,
#: N·m.
@entry_point(VECTOR, VECTOR, VECTOR, COUNT)
def advance(p: Vector, s: Vector, u: Vector, samples: int) -> None:
    go_on(p, s, u, samples)


@entry_point(VECTOR, VECTOR, VECTOR)
def observe(p: Vector, s: Vector, out: Vector) -> None:
    report(p, s, out, 0)


@entry_point(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR, COUNT, CUBE)
def simulate(p: Vector, s: Vector, u: Vector, commands: Vector, torques: Vector, samples: int, out: Vector) -> None:
    flat, rows, columns = out.reshape(-1), out.shape[1], out.shape[2]
    for b in range(p.shape[0]):
        for row in range(rows):
            for j in range(commands.shape[1]):
                u[lay.U_MOTORS + j * loops.IN_SIZE + loops.IN_SETPOINT] = commands[row, j]
            u[lay.U_TORQUE_NM] = torques[row]
            report(p[b], s[b], flat, (b * rows + row) * columns)
            go_on(p[b], s[b], u, samples)


@entry_point(VECTOR, REAL)
def look(p: Vector, time_s: float) -> tuple[float, float, float]:
    return laws.inertia_factor(p, time_s), laws.breakaway_Nm(p), laws.reported_offset_Nm(p)
    return 1.0, 0.0, 0.0
