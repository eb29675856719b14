"""The model kernel: a line of driven rollers with the web between them, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torque of the
current loops known in closed form. Standstill under dry friction and the flanks of gear play are events: located
in time, then the roller sticks or slides, the gear touches or not; nothing is smoothed, nothing chatters.

Vectors as in `hilbench.web.layout`. Compiled functions pass whole vectors and places in them, not views: a view
costs numba a reference count, and they would be most of the time of a step. Nothing is allocated while time goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hilbench.compiled import compiled, entry_point, number_of_sources
from hilbench.drives import motor as loops
from hilbench.web import laws
from hilbench.web import layout as lay
from hilbench.web.layout import Vector

#: Events within one integration step before the rest of it is taken as it comes.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Size of a violation that is none: shares of 1 mm/s, 1 N, 1 µm.
_EVENT_TOLERANCE = 1e-9


@compiled
def _axis(i: int) -> int:
    """Where axis row i begins in the parameters."""
    return lay.W_SIZE + i * lay.A_SIZE


@compiled
def _motor(n: int, j: int) -> int:
    """Where motor row j begins in the parameters."""
    return lay.W_SIZE + n * lay.A_SIZE + j * lay.M_SIZE


@compiled
def _axis_state(n: int, k: int, i: int) -> int:
    """Where the direction and contact of axis i stand in the state."""
    return lay.S_Y + 4 * n + 2 * k + i * lay.SA_SIZE


@compiled
def _motor_state(n: int, k: int, j: int) -> int:
    """Where the state of motor j begins."""
    return lay.S_Y + 4 * n + 2 * k + n * lay.SA_SIZE + j * lay.SM_SIZE


@compiled
def _past(n: int, m: int, k: int, j: int) -> int:
    """Where the past torques of motor j begin in the state."""
    return _motor_state(n, k, m) + j * lay.RING


@compiled
def _block(n: int, k: int, b: int) -> int:
    """Where block b of integrated quantities begins in the scratch space."""
    return b * (4 * n + 2 * k)


@compiled
def _part(n: int, m: int, k: int, part: int) -> int:
    """Where a part behind the blocks begins in the scratch space."""
    return _block(n, k, lay.BLOCKS) + part * (2 * n + m + k)


@compiled
def _rates(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, y: int, dy: int) -> None:
    """Derivatives, at place `dy` of the scratch space, of the quantities at `y`, at time t and the torques there.

    Also the tensions, and in the part "net" what decides events: per axis the force that would move a roller that
    sticks, then per axis the force across the gear.
    """
    tension, speed, rate = _part(n, m, k, lay.TENSION), _part(n, m, k, lay.SPEED), _part(n, m, k, lay.LENGTH_RATE)
    strain_prev = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    if k > 0:
        for i in range(n):
            w[speed + i] = laws.web_speed_m_s(p, _axis(i), w[y + i], w[y + n + i])
        stiffness = laws.stiffness_N(p, t, w[_part(n, m, k, lay.STEPS)])
        f_next = u[lay.U_F_NEXT_N]
        laws.span_rates(p, k, stiffness, strain_prev, f_next, w, speed, y + 4 * n, rate, tension, dy + 4 * n)
        for j in range(k):
            w[dy + 4 * n + k + j] = w[rate + j]
    _driving_forces(p, w, n, m, k, y)
    for i in range(n):
        force = 0.0
        if p[_axis(i) + lay.A_WEB_LOAD] != 0.0:
            before = w[tension + i - 1] if i > 0 else strain_prev * p[lay.W_UPSTREAM_STIFFNESS_N]
            force = (w[tension + i] if i < k else u[lay.U_F_NEXT_N]) - before
        _axis_rates(p, s, w, n, m, k, i, force, y, dy)


@compiled
def _driving_forces(p: Vector, w: Vector, n: int, m: int, k: int, y: int) -> None:
    """Sum the motors' forces at the web on each side of each axis' gear."""
    torque, drive = _part(n, m, k, lay.TORQUE), _part(n, m, k, lay.DRIVE)
    for i in range(2 * n):
        w[drive + i] = 0.0
    for j in range(m):
        motor = _motor(n, j)
        axis, ratio = int(p[motor + lay.M_AXIS]), p[motor + lay.M_RAD_PER_M]
        if p[motor + lay.M_ROLLER_SIDE] == 0.0:
            x = w[y + 2 * n + axis]
            w[drive + axis] += ratio * laws.shaft_torque_Nm(p, motor, w[torque + j], x * ratio)
        else:
            x = w[y + axis]
            w[drive + n + axis] += ratio * laws.shaft_torque_Nm(p, motor, w[torque + j], x * ratio)


@compiled
def _axis_rates(
    p: Vector, s: Vector, w: Vector, n: int, m: int, k: int, i: int, web_force: float, y: int, dy: int
) -> None:
    """Derivatives of one axis: roller and motor move as one, or apart within the gear play; the roller may stick."""
    axis, mode = _axis(i), _axis_state(n, k, i)
    drive, net = _part(n, m, k, lay.DRIVE) + i, _part(n, m, k, lay.NET) + i
    v = w[y + n + i]
    factor = laws.inertia_factor(p, axis)
    motor_mass, roller_mass = p[axis + lay.A_MOTOR_MASS_KG] * factor, p[axis + lay.A_ROLLER_MASS_KG] * factor
    force, mass = w[drive + n] + web_force - laws.smooth_resistance_N(p, axis, v), roller_mass
    apart = laws.has_gap(p, axis) and s[mode + lay.SA_CONTACT] == 0.0
    if not apart:
        force += w[drive]
        mass += motor_mass
    w[net] = force
    if laws.breakaway_N(p, axis) == 0.0:
        acceleration = force / mass
    elif s[mode + lay.SA_DIRECTION] == 0.0:
        acceleration = 0.0
    else:
        acceleration = (force - s[mode + lay.SA_DIRECTION] * laws.dry_friction_N(p, axis, v)) / mass
    w[dy + i] = v
    w[dy + n + i] = acceleration
    w[dy + 2 * n + i] = w[y + 3 * n + i] if apart else v
    w[dy + 3 * n + i] = w[drive] / motor_mass if apart else acceleration
    w[net + n] = w[drive] - motor_mass * acceleration


@compiled
def _torques(s: Vector, w: Vector, n: int, m: int, k: int, decay: int) -> None:
    """Torques after the time that belongs to the decays at `decay`, exact for the held commands."""
    torque = _part(n, m, k, lay.TORQUE)
    for j in range(m):
        at = _motor_state(n, k, j)
        w[torque + j] = loops.torque_after(s[at + lay.SM_TORQUE_NM], s[at + lay.SM_COMMAND_NM], w[decay + j])


@compiled
def _decays(p: Vector, w: Vector, n: int, m: int, k: int, h: float) -> None:
    """Decay of each current loop in half a step and in a step of length h."""
    half, full = _part(n, m, k, lay.DECAY_HALF), _part(n, m, k, lay.DECAY_FULL)
    for j in range(m):
        time_constant = p[_motor(n, j) + lay.M_CURRENT_S]
        w[half + j] = loops.current_decay(0.5 * h, time_constant)
        w[full + j] = loops.current_decay(h, time_constant)


@compiled
def _integrate(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, h: float) -> None:
    """One classical Runge-Kutta step of the quantities in block 0 and of the motors' torques; `_decays` fit h."""
    size, torque = _block(n, k, 1), _part(n, m, k, lay.TORQUE)
    stage, k1, k2, k3, k4 = size, 2 * size, 3 * size, 4 * size, 5 * size
    for j in range(m):
        w[torque + j] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
    _rates(p, s, u, w, n, m, k, t, 0, k1)
    _torques(s, w, n, m, k, _part(n, m, k, lay.DECAY_HALF))
    for j in range(size):
        w[stage + j] = w[j] + 0.5 * h * w[k1 + j]
    _rates(p, s, u, w, n, m, k, t + 0.5 * h, stage, k2)
    for j in range(size):
        w[stage + j] = w[j] + 0.5 * h * w[k2 + j]
    _rates(p, s, u, w, n, m, k, t + 0.5 * h, stage, k3)
    _torques(s, w, n, m, k, _part(n, m, k, lay.DECAY_FULL))
    for j in range(size):
        w[stage + j] = w[j] + h * w[k3 + j]
    _rates(p, s, u, w, n, m, k, t + h, stage, k4)
    for j in range(size):
        w[j] += h / 6.0 * (w[k1 + j] + 2.0 * (w[k2 + j] + w[k3 + j]) + w[k4 + j])
    for j in range(m):
        s[_motor_state(n, k, j) + lay.SM_TORQUE_NM] = w[torque + j]


@compiled
def _rates_now(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float) -> None:
    """Tensions and event forces of the present state."""
    torque = _part(n, m, k, lay.TORQUE)
    for j in range(m):
        w[torque + j] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
    _rates(p, s, u, w, n, m, k, t, 0, _block(n, k, 1))


@compiled
def _half_gap_m(p: Vector, n: int, m: int, i: int) -> float:
    """Half the gear play of an axis, at the web."""
    for j in range(m):
        motor = _motor(n, j)
        if int(p[motor + lay.M_AXIS]) == i and p[motor + lay.M_ROLLER_SIDE] == 0.0:
            return laws.half_gap_m(p, _axis(i), p[motor + lay.M_RAD_PER_M])
    return 0.0


@compiled
def _gear_violation(p: Vector, s: Vector, w: Vector, n: int, m: int, k: int, i: int) -> float:
    """How far the gear of an axis has left its mode: a flank passed, or a flank that would have to pull."""
    contact = s[_axis_state(n, k, i) + lay.SA_CONTACT]
    if not laws.has_gap(p, _axis(i)):
        return -1.0
    if contact == 0.0:
        return (abs(w[2 * n + i] - w[i]) - _half_gap_m(p, n, m, i)) * 1e6
    return -w[_part(n, m, k, lay.NET) + n + i] * contact


@compiled
def _friction_violation(p: Vector, s: Vector, w: Vector, n: int, m: int, k: int, i: int) -> float:
    """How far the dry friction of an axis has left its mode: a speed against its direction, or a force too great."""
    level, direction = laws.breakaway_N(p, _axis(i)), s[_axis_state(n, k, i) + lay.SA_DIRECTION]
    if level == 0.0:
        return -1.0
    if direction == 0.0:
        return abs(w[_part(n, m, k, lay.NET) + i]) - level
    return -w[n + i] * direction * 1e3


@compiled
def _worst(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float) -> float:
    """Greatest violation of any axis in the present state."""
    _rates_now(p, s, u, w, n, m, k, t)
    worst = -1.0
    for i in range(n):
        worst = max(worst, _gear_violation(p, s, w, n, m, k, i), _friction_violation(p, s, w, n, m, k, i))
    return worst


@compiled
def _settle(p: Vector, s: Vector, w: Vector, n: int, m: int, k: int, i: int) -> bool:
    """Change the mode of an axis that has left it; True if it changed. The event forces must be up to date."""
    mode = _axis_state(n, k, i)
    if _gear_violation(p, s, w, n, m, k, i) > _EVENT_TOLERANCE:
        if s[mode + lay.SA_CONTACT] != 0.0:
            s[mode + lay.SA_CONTACT] = 0.0
        else:
            _touch(p, s, w, n, k, i, _half_gap_m(p, n, m, i))
        return True
    if _friction_violation(p, s, w, n, m, k, i) > _EVENT_TOLERANCE:
        if s[mode + lay.SA_DIRECTION] == 0.0:
            s[mode + lay.SA_DIRECTION] = 1.0 if w[_part(n, m, k, lay.NET) + i] > 0.0 else -1.0
        else:
            s[mode + lay.SA_DIRECTION] = 0.0
            w[n + i] = 0.0
            if not laws.has_gap(p, _axis(i)) or s[mode + lay.SA_CONTACT] != 0.0:
                w[3 * n + i] = 0.0
        return True
    return False


@compiled
def _touch(p: Vector, s: Vector, w: Vector, n: int, k: int, i: int, half_m: float) -> None:
    """The gear's flanks meet: plastic impact, momentum kept."""
    axis, mode = _axis(i), _axis_state(n, k, i)
    motor_mass, roller_mass = p[axis + lay.A_MOTOR_MASS_KG], p[axis + lay.A_ROLLER_MASS_KG]
    v = (motor_mass * w[3 * n + i] + roller_mass * w[n + i]) / (motor_mass + roller_mass)
    side = 1.0 if w[2 * n + i] > w[i] else -1.0
    s[mode + lay.SA_CONTACT] = side
    w[2 * n + i] = w[i] + side * half_m
    w[n + i] = v
    w[3 * n + i] = v
    if v != 0.0:
        s[mode + lay.SA_DIRECTION] = 1.0 if v > 0.0 else -1.0


@compiled
def _settle_all(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float) -> None:
    """Change modes until every axis fits its own (a roller that stops may stick at once, or slide back)."""
    for i in range(n):
        direction = _axis_state(n, k, i) + lay.SA_DIRECTION
        if s[direction] == 0.0 and w[n + i] != 0.0:
            s[direction] = 1.0 if w[n + i] > 0.0 else -1.0
    for _ in range(2 * _MOST_EVENTS):
        if _worst(p, s, u, w, n, m, k, t) <= _EVENT_TOLERANCE:
            return
        for i in range(n):
            if _settle(p, s, w, n, m, k, i):
                break


@compiled
def _save(s: Vector, w: Vector, n: int, m: int, k: int) -> None:
    """Keep the present quantities and torques to come back to."""
    size, saved = _block(n, k, 1), _part(n, m, k, lay.SAVED_TORQUE)
    for j in range(size):
        w[6 * size + j] = w[j]
    for j in range(m):
        w[saved + j] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]


@compiled
def _from_saved(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, h: float) -> float:
    """One step of length h from the saved state; the greatest violation at its end."""
    size, saved = _block(n, k, 1), _part(n, m, k, lay.SAVED_TORQUE)
    for j in range(size):
        w[j] = w[6 * size + j]
    for j in range(m):
        s[_motor_state(n, k, j) + lay.SM_TORQUE_NM] = w[saved + j]
    _decays(p, w, n, m, k, h)
    _integrate(p, s, u, w, n, m, k, t, h)
    return _worst(p, s, u, w, n, m, k, t + h)


@compiled
def _integrate_with_events(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, h: float
) -> None:
    """One step, cut at every event; the event's time is found by the Illinois form of regula falsi."""
    left = h
    for _ in range(_MOST_EVENTS):
        _settle_all(p, s, u, w, n, m, k, t)
        _save(s, w, n, m, k)
        beyond = _from_saved(p, s, u, w, n, m, k, t, left)
        if beyond <= _EVENT_TOLERANCE:
            return
        low, high, within, last = 0.0, left, -_EVENT_TOLERANCE, 0
        for _ in range(_EVENT_ITERATIONS):
            if high - low <= 1e-9 * h:
                break
            share = within / (within - beyond)
            cut = low + (high - low) * min(max(share, 1e-3), 0.999)
            violation = _from_saved(p, s, u, w, n, m, k, t, cut)
            if violation > _EVENT_TOLERANCE:
                within = 0.5 * within if last == 1 else within
                high, beyond, last = cut, violation, 1
            else:
                beyond = 0.5 * beyond if last == -1 else beyond
                low, within, last = cut, min(violation, -_EVENT_TOLERANCE), -1
        _from_saved(p, s, u, w, n, m, k, t, high)
        t += high
        left -= high
        if left <= 1e-12 * h:
            return
    _from_saved(p, s, u, w, n, m, k, t, left)


@compiled
def _has_events(p: Vector, n: int) -> bool:
    found = False
    for i in range(n):
        found |= laws.has_gap(p, _axis(i)) or laws.breakaway_N(p, _axis(i)) != 0.0
    return found


@compiled
def _drive_sample(p: Vector, s: Vector, u: Vector, motor: int, state: int, inputs: int, x_m: float, v: float) -> None:
    """What a drive does at a sample instant: new torque command from set point and motion."""
    mode, slope, period = u[inputs + lay.UM_MODE], u[inputs + lay.UM_SLOPE], p[lay.W_SAMPLE_TIME_S]
    limit = min(u[inputs + lay.UM_LIMIT_NM], p[motor + lay.M_LIMIT_NM])
    position, velocity = x_m * p[motor + lay.M_RAD_PER_M], v * p[motor + lay.M_RAD_PER_M]
    torque = s[state + lay.SM_TORQUE_NM]
    if s[state + lay.SM_MODE] != mode:
        s[state + lay.SM_MODE] = mode
        s[state + lay.SM_REFERENCE] = loops.bumpless_reference(mode, position, velocity, torque)
        s[state + lay.SM_INTEGRAL_NM] = torque
    if mode == loops.OFF:
        s[state + lay.SM_REFERENCE] = 0.0
        s[state + lay.SM_COMMAND_NM] = 0.0
        s[state + lay.SM_TORQUE_NM] = 0.0
        s[state + lay.SM_INTEGRAL_NM] = 0.0
        return
    before = s[state + lay.SM_REFERENCE]
    reference = loops.ramp(before, u[inputs + lay.UM_SETPOINT], slope, period)
    s[state + lay.SM_REFERENCE] = reference
    if mode == loops.TORQUE:
        command = loops.clip(reference, limit)
        limited = command != reference
    else:
        kp_position = p[motor + lay.M_POSITION_KP]
        wanted = loops.velocity_reference(mode, before, reference, position, kp_position, slope, period)
        kp, ki = p[motor + lay.M_KP], p[motor + lay.M_KI]
        command, s[state + lay.SM_INTEGRAL_NM], limited = loops.velocity_loop(
            wanted - velocity, s[state + lay.SM_INTEGRAL_NM], kp, ki, limit, period
        )
    s[state + lay.SM_COMMAND_NM] = command
    if p[motor + lay.M_CURRENT_S] == 0.0:
        s[state + lay.SM_TORQUE_NM] = command
    if limited:
        s[state + lay.SM_LIMITED] = 1.0


@compiled
def _motor_motion(p: Vector, n: int, j: int) -> int:
    """Where the position of the shaft that motor j sits on stands among the integrated quantities."""
    motor = _motor(n, j)
    return int(p[motor + lay.M_AXIS]) + (0 if p[motor + lay.M_ROLLER_SIDE] != 0.0 else 2 * n)


@compiled
def _advance(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    n, m, k = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(p[lay.W_SPANS])
    period, substeps = p[lay.W_SAMPLE_TIME_S], int(p[lay.W_SUBSTEPS])
    h, size, steps = period / substeps, _block(n, k, 1), _part(n, m, k, lay.STEPS)
    events = _has_events(p, n)
    _load(s, u, w, n, m, k)
    _decays(p, w, n, m, k, h)
    for _ in range(samples):
        for j in range(m):
            at = _motor_motion(p, n, j)
            inputs = lay.U_MOTORS + j * lay.UM_SIZE
            _drive_sample(p, s, u, _motor(n, j), _motor_state(n, k, j), inputs, w[at], w[at + n])
        for substep in range(substeps):
            t = s[lay.S_COUNT] * period + substep * h
            w[steps] = laws.step_factor(p, t, h)
            if events:
                _integrate_with_events(p, s, u, w, n, m, k, t, h)
            else:
                _integrate(p, s, u, w, n, m, k, t, h)
        s[lay.S_COUNT] += 1.0
        for j in range(m):
            place = _past(n, m, k, j) + int(s[lay.S_COUNT]) % lay.RING
            s[place] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
    for j in range(size):
        s[lay.S_Y + j] = w[j]


@compiled
def _load(s: Vector, u: Vector, w: Vector, n: int, m: int, k: int) -> None:
    """Bring the integrated quantities and the rates of length into the scratch space."""
    for j in range(_block(n, k, 1)):
        w[j] = s[lay.S_Y + j]
    for j in range(k):
        w[_part(n, m, k, lay.LENGTH_RATE) + j] = u[lay.U_MOTORS + m * lay.UM_SIZE + j]


@compiled
def _observe(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector) -> None:
    n, m, k = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(p[lay.W_SPANS])
    period = p[lay.W_SAMPLE_TIME_S]
    t = s[lay.S_COUNT] * period
    _load(s, u, w, n, m, k)
    w[_part(n, m, k, lay.STEPS)] = laws.step_factor(p, t, period / p[lay.W_SUBSTEPS])
    _rates_now(p, s, u, w, n, m, k, t)
    for j in range(m):
        at = _motor_motion(p, n, j)
        torque = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
        out[j] = w[at]
        out[m + j] = w[at + n]
        out[2 * m + j] = laws.measured_torque_Nm(p, _motor(n, j), torque, s, _past(n, m, k, j), int(s[lay.S_COUNT]))
    for j in range(k):
        out[3 * m + j] = w[_part(n, m, k, lay.TENSION) + j]
        out[3 * m + k + j] = w[4 * n + k + j] * laws.length_factor(p) / w[4 * n + j] - 1.0


Advance = Callable[[Vector, Vector, Vector, Vector, int], None]
Observe = Callable[[Vector, Vector, Vector, Vector, Vector], None]
Simulate = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, int, Vector], None]


def source_number(*further: str) -> int:
    """A number that changes with the source of what is compiled here, and with `further` files."""
    effects = str(Path(__file__).with_name("effects.py"))
    names = (loops.__file__, laws.__file__, lay.__file__, __file__, effects, *further)
    return number_of_sources(*names)


def _entry_points(sources: int) -> tuple[Advance, Observe, Simulate]:
    """The compiled functions others call; `sources` as in `number_of_sources`."""

    @entry_point
    def advance(p: Vector, s: Vector, u: Vector, work: Vector, samples: int) -> None:
        if sources >= 0:
            _advance(p, s, u, work, samples)

    @entry_point
    def observe(p: Vector, s: Vector, u: Vector, work: Vector, out: Vector) -> None:
        if sources >= 0:
            _observe(p, s, u, work, out)

    @entry_point
    def simulate(
        p: Vector, s: Vector, u: Vector, work: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector
    ) -> None:
        for b in range(p.shape[0] if sources >= 0 else 0):
            for row in range(commands.shape[0]):
                u[lay.U_STRAIN_PREV] = boundary[row, 0]
                u[lay.U_F_NEXT_N] = boundary[row, 1]
                for m in range(commands.shape[1]):
                    u[lay.U_MOTORS + m * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, m]
                _observe(p[b], s[b], u, work, out[b, row])
                _advance(p[b], s[b], u, work, samples)

    return advance, observe, simulate


#: advance(parameters, state, inputs, work, samples): `samples` drive sample times onwards, state changed in place.
#: observe(parameters, state, inputs, work, out): measured motion and torque, tension, strain (`Layout.columns`).
#: simulate(parameters (B, P), states (B, S), inputs, work, commands (n, M), boundary (n, 2), samples, out (B, n, C)):
#: for each row observe, then advance `samples` with the row's set points, upstream strain and downstream tension.
advance, observe, simulate = _entry_points(source_number())
