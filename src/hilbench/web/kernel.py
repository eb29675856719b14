"""The model kernel: a line of driven rollers with the web between them, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torque of the
current loops known in closed form. Standstill under dry friction and the flanks of gear play are events: located
in time, then the roller sticks or slides, the gear touches or not; nothing is smoothed, nothing chatters.
Vectors as in `hilbench.web.layout`. No function here allocates while time advances.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
from numba import njit

from hilbench.drives import motor as loops
from hilbench.web import laws
from hilbench.web import layout as lay
from hilbench.web.layout import Vector

#: Events within one integration step before the rest of it is taken as it comes.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Size of a violation that is none: shares of 1 mm/s, 1 N, 1 µm.
_EVENT_TOLERANCE = 1e-9


@njit
def _views(p: Vector, s: Vector, u: Vector) -> tuple[Vector, ...]:
    """Axis rows, motor rows, y, axis states, motor states, past torques, motor inputs, rates of length."""
    n, m, k = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(p[lay.W_SPANS])
    at = lay.W_SIZE + n * lay.A_SIZE
    axes = p[lay.W_SIZE : at].reshape(n, lay.A_SIZE)
    motors = p[at : at + m * lay.M_SIZE].reshape(m, lay.M_SIZE)
    at = lay.S_Y + 4 * n + 2 * k
    y = s[lay.S_Y : at]
    modes = s[at : at + n * lay.SA_SIZE].reshape(n, lay.SA_SIZE)
    at += n * lay.SA_SIZE
    drives = s[at : at + m * lay.SM_SIZE].reshape(m, lay.SM_SIZE)
    at += m * lay.SM_SIZE
    past = s[at : at + m * lay.RING].reshape(m, lay.RING)
    at = lay.U_MOTORS + m * lay.UM_SIZE
    return axes, motors, y, modes, drives, past, u[lay.U_MOTORS : at].reshape(m, lay.UM_SIZE), u[at : at + k]


@njit
def _rates(
    p: Vector,
    axes: Vector,
    motors: Vector,
    u: Vector,
    length_rate: Vector,
    modes: Vector,
    t: float,
    steps: float,
    torque: Vector,
    y: Vector,
    dy: Vector,
    tension: Vector,
    speed: Vector,
    net: Vector,
) -> None:
    """Derivatives of y at time t; also the tensions and, in `net`, what decides events of each axis.

    `net`: while a roller sticks the force that would move it; otherwise, while the gear touches, the force across it.
    """
    n, k = axes.shape[0], length_rate.size
    material, length = y[4 * n : 4 * n + k], y[4 * n + k :]
    strain_prev = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    if k > 0:
        for i in range(n):
            speed[i] = laws.web_speed_m_s(axes[i], y[i], y[n + i])
        stiffness = laws.stiffness_N(p, t, steps)
        rate = dy[4 * n : 4 * n + k]
        laws.span_rates(
            p, stiffness, strain_prev, u[lay.U_F_NEXT_N], speed, material, length, length_rate, tension, rate
        )
        for j in range(k):
            dy[4 * n + k + j] = length_rate[j]
    for i in range(n):
        _axis_rates(p, axes[i], motors, u, modes[i], i, n, k, strain_prev, torque, y, dy, tension, net)


@njit
def _axis_rates(
    p: Vector,
    axis: Vector,
    motors: Vector,
    u: Vector,
    mode: Vector,
    i: int,
    n: int,
    k: int,
    strain_prev: float,
    torque: Vector,
    y: Vector,
    dy: Vector,
    tension: Vector,
    net: Vector,
) -> None:
    motor_side, roller_side = 0.0, 0.0
    for m in range(motors.shape[0]):
        motor = motors[m]
        if int(motor[lay.M_AXIS]) == i:
            ratio = motor[lay.M_RAD_PER_M]
            if motor[lay.M_ROLLER_SIDE] == 0.0:
                motor_side += ratio * laws.shaft_torque_Nm(motor, torque[m], y[2 * n + i] * ratio)
            else:
                roller_side += ratio * laws.shaft_torque_Nm(motor, torque[m], y[i] * ratio)
    if axis[lay.A_WEB_LOAD] != 0.0:
        before = tension[i - 1] if i > 0 else strain_prev * p[lay.W_UPSTREAM_STIFFNESS_N]
        behind = tension[i] if i < k else u[lay.U_F_NEXT_N]
        roller_side += behind - before
    v = y[n + i]
    roller_side -= laws.smooth_resistance_N(axis, v)
    factor = laws.inertia_factor(axis)
    motor_mass, roller_mass = axis[lay.A_MOTOR_MASS_KG] * factor, axis[lay.A_ROLLER_MASS_KG] * factor
    apart = laws.has_gap(axis) and mode[lay.SA_CONTACT] == 0.0
    force = roller_side if apart else motor_side + roller_side
    dry = laws.breakaway_N(axis) != 0.0
    if dry and mode[lay.SA_DIRECTION] == 0.0:
        acceleration = 0.0
        net[i] = force
    else:
        if dry:
            force -= mode[lay.SA_DIRECTION] * laws.dry_friction_N(axis, v)
        acceleration = force / (roller_mass if apart else motor_mass + roller_mass)
    dy[i] = v
    dy[n + i] = acceleration
    if apart:
        dy[2 * n + i] = y[3 * n + i]
        dy[3 * n + i] = motor_side / motor_mass
    else:
        dy[2 * n + i] = v
        dy[3 * n + i] = acceleration
    net[n + i] = motor_side - motor_mass * acceleration


@njit
def _integrate(
    p: Vector,
    axes: Vector,
    motors: Vector,
    u: Vector,
    length_rate: Vector,
    modes: Vector,
    drives: Vector,
    t: float,
    h: float,
    steps: float,
    y: Vector,
    work: Vector,
) -> None:
    """One classical Runge-Kutta step of y and of the motors' torques."""
    size, m = y.size, motors.shape[0]
    k1, k2, k3, k4, stage = work[0, :size], work[1, :size], work[2, :size], work[3, :size], work[4, :size]
    torque, tension, speed, net = work[5, :m], work[6], work[7], work[8]
    for j in range(m):
        torque[j] = drives[j, lay.SM_TORQUE_NM]
    _rates(p, axes, motors, u, length_rate, modes, t, steps, torque, y, k1, tension, speed, net)
    _torques(motors, drives, 0.5 * h, torque)
    for j in range(size):
        stage[j] = y[j] + 0.5 * h * k1[j]
    _rates(p, axes, motors, u, length_rate, modes, t + 0.5 * h, steps, torque, stage, k2, tension, speed, net)
    for j in range(size):
        stage[j] = y[j] + 0.5 * h * k2[j]
    _rates(p, axes, motors, u, length_rate, modes, t + 0.5 * h, steps, torque, stage, k3, tension, speed, net)
    _torques(motors, drives, h, torque)
    for j in range(size):
        stage[j] = y[j] + h * k3[j]
    _rates(p, axes, motors, u, length_rate, modes, t + h, steps, torque, stage, k4, tension, speed, net)
    for j in range(size):
        y[j] += h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j])
    for j in range(m):
        drives[j, lay.SM_TORQUE_NM] = torque[j]


@njit
def _torques(motors: Vector, drives: Vector, h: float, torque: Vector) -> None:
    """Torques a time h after the ones in the state, exact for the held commands."""
    for j in range(motors.shape[0]):
        decay = loops.current_decay(h, motors[j, lay.M_CURRENT_S])
        torque[j] = loops.torque_after(drives[j, lay.SM_TORQUE_NM], drives[j, lay.SM_COMMAND_NM], decay)


@njit
def _violation(axis: Vector, ratio: float, mode: Vector, i: int, n: int, y: Vector, net: Vector) -> float:
    """How far an axis has left its mode (scaled; not positive: it has not)."""
    worst = -1.0
    level = laws.breakaway_N(axis)
    if level != 0.0:
        if mode[lay.SA_DIRECTION] == 0.0:
            worst = abs(net[i]) - level
        else:
            worst = -y[n + i] * mode[lay.SA_DIRECTION] * 1e3
    if laws.has_gap(axis):
        if mode[lay.SA_CONTACT] == 0.0:
            play = y[2 * n + i] - y[i]
            worst = max(worst, (abs(play) - laws.half_gap_m(axis, ratio)) * 1e6)
        else:
            worst = max(worst, -net[n + i] * mode[lay.SA_CONTACT])
    return worst


@njit
def _settle(axis: Vector, ratio: float, mode: Vector, i: int, n: int, y: Vector, net: Vector) -> bool:
    """Change the mode of an axis that has left it; True if it changed. `net` must be that of y."""
    if _violation(axis, ratio, mode, i, n, y, net) <= _EVENT_TOLERANCE:
        return False
    if laws.has_gap(axis):
        contact = mode[lay.SA_CONTACT]
        play, half = y[2 * n + i] - y[i], laws.half_gap_m(axis, ratio)
        if contact != 0.0 and -net[n + i] * contact > _EVENT_TOLERANCE:
            mode[lay.SA_CONTACT] = 0.0
            return True
        if contact == 0.0 and (abs(play) - half) * 1e6 > _EVENT_TOLERANCE:
            _touch(axis, mode, i, n, y, 1.0 if play > 0.0 else -1.0, half)
            return True
    if mode[lay.SA_DIRECTION] == 0.0:
        mode[lay.SA_DIRECTION] = 1.0 if net[i] > 0.0 else -1.0
    else:
        mode[lay.SA_DIRECTION] = 0.0
        y[n + i] = 0.0
        if not laws.has_gap(axis) or mode[lay.SA_CONTACT] != 0.0:
            y[3 * n + i] = 0.0
    return True


@njit
def _touch(axis: Vector, mode: Vector, i: int, n: int, y: Vector, side: float, half_m: float) -> None:
    """The gear's flanks meet: plastic impact, momentum kept."""
    motor_mass, roller_mass = axis[lay.A_MOTOR_MASS_KG], axis[lay.A_ROLLER_MASS_KG]
    v = (motor_mass * y[3 * n + i] + roller_mass * y[n + i]) / (motor_mass + roller_mass)
    mode[lay.SA_CONTACT] = side
    y[2 * n + i] = y[i] + side * half_m
    y[n + i] = v
    y[3 * n + i] = v
    if laws.breakaway_N(axis) != 0.0 and v != 0.0:
        mode[lay.SA_DIRECTION] = 1.0 if v > 0.0 else -1.0


@njit
def _has_events(axes: Vector) -> bool:
    for i in range(axes.shape[0]):
        if laws.has_gap(axes[i]) or laws.breakaway_N(axes[i]) != 0.0:
            return True
    return False


@njit
def _ratio(motors: Vector, i: int) -> float:
    """i/r of the motor on the motor side of an axis."""
    for m in range(motors.shape[0]):
        if int(motors[m, lay.M_AXIS]) == i and motors[m, lay.M_ROLLER_SIDE] == 0.0:
            return float(motors[m, lay.M_RAD_PER_M])
    return 1.0


@njit
def _worst(
    p: Vector,
    axes: Vector,
    motors: Vector,
    u: Vector,
    length_rate: Vector,
    modes: Vector,
    drives: Vector,
    t: float,
    steps: float,
    y: Vector,
    work: Vector,
) -> float:
    """Greatest violation of any axis at the present state; leaves the forces that decide in work[8]."""
    n, m = axes.shape[0], motors.shape[0]
    torque, net = work[5, :m], work[8]
    for j in range(m):
        torque[j] = drives[j, lay.SM_TORQUE_NM]
    _rates(p, axes, motors, u, length_rate, modes, t, steps, torque, y, work[0, : y.size], work[6], work[7], net)
    worst = -1.0
    for i in range(n):
        worst = max(worst, _violation(axes[i], _ratio(motors, i), modes[i], i, n, y, net))
    return worst


@njit
def _settle_all(
    p: Vector,
    axes: Vector,
    motors: Vector,
    u: Vector,
    length_rate: Vector,
    modes: Vector,
    drives: Vector,
    t: float,
    steps: float,
    y: Vector,
    work: Vector,
) -> None:
    """Change modes until every axis fits its own (a roller that stops may stick at once, or slide back)."""
    n = axes.shape[0]
    for i in range(n):
        if modes[i, lay.SA_DIRECTION] == 0.0 and y[n + i] != 0.0:
            modes[i, lay.SA_DIRECTION] = 1.0 if y[n + i] > 0.0 else -1.0
    for _ in range(2 * _MOST_EVENTS):
        if _worst(p, axes, motors, u, length_rate, modes, drives, t, steps, y, work) <= _EVENT_TOLERANCE:
            return
        for i in range(n):
            if _settle(axes[i], _ratio(motors, i), modes[i], i, n, y, work[8]):
                break


@njit
def _integrate_with_events(
    p: Vector,
    axes: Vector,
    motors: Vector,
    u: Vector,
    length_rate: Vector,
    modes: Vector,
    drives: Vector,
    t: float,
    h: float,
    steps: float,
    y: Vector,
    work: Vector,
) -> None:
    """One step, cut at every event; the event's time is found by the Illinois form of regula falsi."""
    y0, torque0 = work[9, : y.size], work[10, : motors.shape[0]]
    left = h
    for _ in range(_MOST_EVENTS):
        _settle_all(p, axes, motors, u, length_rate, modes, drives, t, steps, y, work)
        y0[:] = y
        torque0[:] = drives[:, lay.SM_TORQUE_NM]
        low, high, g_low, kept = 0.0, left, -_EVENT_TOLERANCE, 0
        _integrate(p, axes, motors, u, length_rate, modes, drives, t, left, steps, y, work)
        g_high = _worst(p, axes, motors, u, length_rate, modes, drives, t + left, steps, y, work)
        if g_high <= _EVENT_TOLERANCE:
            return
        at = left
        for _ in range(_EVENT_ITERATIONS):
            if high - low <= 1e-9 * h:
                break
            share = g_low / (g_low - g_high)
            cut = low + (high - low) * min(max(share, 1e-3), 0.999)
            y[:] = y0
            drives[:, lay.SM_TORQUE_NM] = torque0
            _integrate(p, axes, motors, u, length_rate, modes, drives, t, cut, steps, y, work)
            g = _worst(p, axes, motors, u, length_rate, modes, drives, t + cut, steps, y, work)
            at = cut
            if g > _EVENT_TOLERANCE:
                high, g_high = cut, g
                g_low = 0.5 * g_low if kept == 1 else g_low
                kept = 1
            else:
                low, g_low = cut, min(g, -_EVENT_TOLERANCE)
                g_high = 0.5 * g_high if kept == -1 else g_high
                kept = -1
        if at != high:
            y[:] = y0
            drives[:, lay.SM_TORQUE_NM] = torque0
            _integrate(p, axes, motors, u, length_rate, modes, drives, t, high, steps, y, work)
        t += high
        left -= high
        if left <= 1e-12 * h:
            return
    _integrate(p, axes, motors, u, length_rate, modes, drives, t, left, steps, y, work)


@njit
def _drive_sample(motor: Vector, state: Vector, inputs: Vector, x_m: float, v_m_s: float, sample_time_s: float) -> None:
    """What a drive does at a sample instant: new torque command from set point and motion."""
    mode, limit = inputs[lay.UM_MODE], min(inputs[lay.UM_LIMIT_NM], motor[lay.M_LIMIT_NM])
    position, velocity = x_m * motor[lay.M_RAD_PER_M], v_m_s * motor[lay.M_RAD_PER_M]
    torque = state[lay.SM_TORQUE_NM]
    if state[lay.SM_MODE] != mode:
        state[lay.SM_MODE] = mode
        state[lay.SM_REFERENCE] = loops.bumpless_reference(mode, position, velocity, torque)
        state[lay.SM_INTEGRAL_NM] = torque
    if mode == loops.OFF:
        state[lay.SM_REFERENCE] = 0.0
        state[lay.SM_COMMAND_NM] = 0.0
        state[lay.SM_TORQUE_NM] = 0.0
        state[lay.SM_INTEGRAL_NM] = 0.0
        return
    before = state[lay.SM_REFERENCE]
    reference = loops.ramp(before, inputs[lay.UM_SETPOINT], inputs[lay.UM_SLOPE], sample_time_s)
    state[lay.SM_REFERENCE] = reference
    if mode == loops.TORQUE:
        command = loops.clip(reference, limit)
        limited = command != reference
    else:
        wanted = loops.velocity_reference(
            mode, before, reference, position, motor[lay.M_POSITION_KP], inputs[lay.UM_SLOPE], sample_time_s
        )
        command, integral, limited = loops.velocity_loop(
            wanted - velocity,
            state[lay.SM_INTEGRAL_NM],
            motor[lay.M_KP],
            motor[lay.M_KI],
            limit,
            sample_time_s,
        )
        state[lay.SM_INTEGRAL_NM] = integral
    state[lay.SM_COMMAND_NM] = command
    if limited:
        state[lay.SM_LIMITED] = 1.0


@njit
def _advance(p: Vector, s: Vector, u: Vector, work: Vector, samples: int) -> None:
    axes, motors, y, modes, drives, past, inputs, length_rate = _views(p, s, u)
    n = axes.shape[0]
    period, substeps = p[lay.W_SAMPLE_TIME_S], int(p[lay.W_SUBSTEPS])
    h = period / substeps
    events = _has_events(axes)
    for _ in range(samples):
        for m in range(motors.shape[0]):
            at = int(motors[m, lay.M_AXIS]) + (0 if motors[m, lay.M_ROLLER_SIDE] != 0.0 else 2 * n)
            _drive_sample(motors[m], drives[m], inputs[m], y[at], y[n + at], period)
        for substep in range(substeps):
            t = s[lay.S_COUNT] * period + substep * h
            steps = laws.step_factor(p, t, h)
            if events:
                _integrate_with_events(
                    p, axes, motors, u, length_rate, modes, drives, t, h, steps, y, work
                )
            else:
                _integrate(p, axes, motors, u, length_rate, modes, drives, t, h, steps, y, work)
        s[lay.S_COUNT] += 1.0
        for m in range(motors.shape[0]):
            past[m, int(s[lay.S_COUNT]) % lay.RING] = drives[m, lay.SM_TORQUE_NM]


@njit
def _observe(p: Vector, s: Vector, u: Vector, work: Vector, out: Vector) -> None:
    axes, motors, y, modes, drives, past, _, length_rate = _views(p, s, u)
    n, m, k = axes.shape[0], motors.shape[0], length_rate.size
    period = p[lay.W_SAMPLE_TIME_S]
    t = s[lay.S_COUNT] * period
    steps = laws.step_factor(p, t, period / p[lay.W_SUBSTEPS])
    _worst(p, axes, motors, u, length_rate, modes, drives, t, steps, y, work)
    for j in range(m):
        at = int(motors[j, lay.M_AXIS]) + (0 if motors[j, lay.M_ROLLER_SIDE] != 0.0 else 2 * n)
        out[j] = y[at]
        out[m + j] = y[n + at]
        torque = drives[j, lay.SM_TORQUE_NM]
        out[2 * m + j] = laws.measured_torque_Nm(motors[j], torque, past[j], int(s[lay.S_COUNT]), period)
    scale = laws.length_factor(p)
    for j in range(k):
        out[3 * m + j] = work[6, j]
        out[3 * m + k + j] = y[4 * n + k + j] * scale / y[4 * n + j] - 1.0


Advance = Callable[[Vector, Vector, Vector, Vector, int], None]
Observe = Callable[[Vector, Vector, Vector, Vector, Vector], None]
Simulate = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, int, Vector], None]


def _sources() -> int:
    """A number that changes with the source of anything that is compiled here."""
    names = (loops.__file__, laws.__file__, lay.__file__, __file__, str(Path(__file__).with_name("effects.py")))
    text = b"".join(Path(name).read_bytes() for name in names)
    return int.from_bytes(sha256(text).digest()[:7], "big")


def _entry_points(sources: int) -> tuple[Advance, Observe, Simulate]:
    """The compiled functions others call.

    numba keeps machine code by the file of the function alone, and would run old code after a change of a law;
    what a closure holds is part of its key, so `sources` is held.
    """

    @njit(cache=True, nogil=True)
    def advance(p: Vector, s: Vector, u: Vector, work: Vector, samples: int) -> None:
        if sources >= 0:
            _advance(p, s, u, work, samples)

    @njit(cache=True, nogil=True)
    def observe(p: Vector, s: Vector, u: Vector, work: Vector, out: Vector) -> None:
        if sources >= 0:
            _observe(p, s, u, work, out)

    @njit(cache=True, nogil=True)
    def simulate(
        p: Vector, s: Vector, u: Vector, work: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector
    ) -> None:
        inputs = _views(p[0], s[0], u)[6]
        for b in range(p.shape[0] if sources >= 0 else 0):
            for row in range(commands.shape[0]):
                u[lay.U_STRAIN_PREV] = boundary[row, 0]
                u[lay.U_F_NEXT_N] = boundary[row, 1]
                for m in range(commands.shape[1]):
                    inputs[m, lay.UM_SETPOINT] = commands[row, m]
                _observe(p[b], s[b], u, work, out[b, row])
                _advance(p[b], s[b], u, work, samples)

    return advance, observe, simulate


#: advance(parameters, state, inputs, work, samples): `samples` drive sample times onwards, state changed in place.
#: observe(parameters, state, inputs, work, out): measured motion and torque, tension, strain (`Layout.columns`).
#: simulate(parameters (B, P), states (B, S), inputs, work, commands (n, M), boundary (n, 2), samples, out (B, n, C)):
#: for each row observe, then advance `samples` with the row's set points, upstream strain and downstream tension.
advance, observe, simulate = _entry_points(_sources())
