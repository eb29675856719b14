"""The model kernel: a line of driven rollers with the web between them, compiled.

Per drive sample time: the drives' loops once, then Runge-Kutta steps of fourth order with the torque of the
current loops known in closed form. Standstill under dry friction and the flanks of gear play are events: located
in time, then the roller sticks or slides, the gear touches or not; nothing is smoothed, nothing chatters.

Vectors as in `hilbench.plant.web_line.layout`. Compiled functions pass whole vectors and places in them; nothing is
allocated while time goes on, and nothing is reference-counted (`hilbench.compiled`). A step without events is compiled
once for the one-span line, with the counts of axes, motors and spans as constants: every place is one, and quantities
stay in registers. Events, and laws with a wave or an iteration in them, stay calls. A step without events costs four
evaluations of the rates; whether there was one shows in the speeds at its end, unless a roller sticks or a gear has
play.

Arguments that mean the same everywhere, float64 and SI: `p` (P,) parameters, `s` (S,) state, `u` (U,) inputs, `w` (W,)
scratch space, all of one line of `n` axes, `m` motors and `k` spans; `i` an axis and `j` a motor, from 0; `y` the place
in `w` of a block of integrated quantities (now, stage, …); `t` the time since the start and `h` the length of a step,
both s. Positions, speeds, masses and forces are those at the web. What goes on changes `s` and `w` in place.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hilbench import compiled as decorators
from hilbench.compiled import compiled, entry_point, inlined, merged, noinline, number_of_sources
from hilbench.plant import drive_loops as loops
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector

#: Events within one integration step before the rest of it is taken as it comes.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Size of a violation that is none: shares of 1 mm/s, 1 N, 1 µm.
_EVENT_TOLERANCE = 1e-9
#: Of a difference of two positions, per position: four units in the last place.
_POSITION_ROUNDING = 1e-15


@inlined
def _axis(i: int) -> int:
    """Where axis row i begins in the parameters."""
    return lay.W_SIZE + i * lay.A_SIZE


@inlined
def _motor(n: int, j: int) -> int:
    """Where motor row j begins in the parameters."""
    return lay.W_SIZE + n * lay.A_SIZE + j * lay.M_SIZE


@inlined
def _first_span(n: int, m: int) -> int:
    """Where the span rows begin in the parameters."""
    return lay.W_SIZE + n * lay.A_SIZE + m * lay.M_SIZE


@inlined
def _axis_state(n: int, k: int, i: int) -> int:
    """Where the direction and contact of axis i stand in the state."""
    return lay.S_Y + 4 * n + 2 * k + i * lay.SA_SIZE


@inlined
def _motor_state(n: int, k: int, j: int) -> int:
    """Where the state of motor j begins."""
    return lay.S_Y + 4 * n + 2 * k + n * lay.SA_SIZE + j * lay.SM_SIZE


@inlined
def _past(n: int, m: int, k: int, j: int) -> int:
    """Where the past torques of motor j begin in the state."""
    return _motor_state(n, k, m) + j * lay.RING


@inlined
def _pieces(n: int, m: int, k: int) -> int:
    """Where the pieces of other web stand in the state."""
    return _past(n, m, k, m)


@inlined
def _block(n: int, k: int, b: int) -> int:
    """Where block b of integrated quantities begins in the scratch space."""
    return b * (4 * n + 2 * k)


@inlined
def _part(n: int, m: int, k: int, part: int) -> int:
    """Where a part behind the blocks begins in the scratch space."""
    return _block(n, k, lay.BLOCKS) + part * m


@inlined
def _counts(p: Vector) -> tuple[int, int, int]:
    """Axes, motors and spans of the line."""
    return int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(p[lay.W_SPANS])


@inlined
def _is_one_span(p: Vector) -> bool:
    """Whether it is the line most often simulated, for which the path of a step is compiled with constant places."""
    return p[lay.W_AXES] == 2.0 and p[lay.W_MOTORS] == 2.0 and p[lay.W_SPANS] == 1.0


@inlined
def _web(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    n: int,
    m: int,
    k: int,
    t: float,
    strain_prev: float,
    y: int,
    slides: bool,
) -> None:
    """Tensions (N), and rates of the unstretched lengths (m/s), for the quantities at `y`, into their parts of `w`.

    `strain_prev`: strain of the web that enters, with the disturbance. `slides` as in `_go_axis`.
    """
    speed, tension, rate = _part(n, m, k, lay.SPEED), _part(n, m, k, lay.TENSION), _part(n, m, k, lay.RATE)
    if k > 0:
        for i in range(n):
            w[speed + i] = laws.web_speed_m_s(p, _axis(i), w[y + i], w[y + n + i])
        first, steps, pieces = _first_span(n, m), _part(n, m, k, lay.STEPS), _pieces(n, m, k)
        length_rate = _part(n, m, k, lay.LENGTH_RATE)
        f_next, material = u[lay.U_F_NEXT_N], y + 4 * n
        if not slides and laws.has_splice(p, s, pieces):
            blur = w[_part(n, m, k, lay.SPLICE_BLUR)]
            laws.spliced_span_rates(
                p, s, pieces, first, k, t, strain_prev, f_next, w, steps, speed, material, length_rate, tension, rate,
                w[y], blur,
            )  # fmt: skip
        else:
            laws.span_rates(p, first, k, t, strain_prev, f_next, w, steps, speed, material, length_rate, tension, rate)


@inlined
def _web_force_N(p: Vector, u: Vector, w: Vector, n: int, m: int, k: int, i: int, strain_prev: float) -> float:
    """Pull of the web on roller i, N forward: the tension behind it less the one before it, as last put into `w`."""
    if p[_axis(i) + lay.A_WEB_LOAD] == 0.0:
        return 0.0
    tension = _part(n, m, k, lay.TENSION)
    before = w[tension + i - 1] if i > 0 else strain_prev * p[lay.W_UPSTREAM_STIFFNESS_N]
    return (w[tension + i] if i < k else u[lay.U_F_NEXT_N]) - before


@inlined
def _motor_force_N(p: Vector, w: Vector, n: int, m: int, k: int, j: int, x_m: float, slides: bool) -> float:
    """Force of motor j at the web, N, from the torque in `w`; its shaft is at `x_m`. `slides` as in `_go_axis`."""
    motor = _motor(n, j)
    ratio, torque = p[motor + lay.M_RAD_PER_M], w[_part(n, m, k, lay.TORQUE) + j]
    if slides:
        return ratio * laws.usual_shaft_torque_Nm(p, motor, torque, x_m * ratio)
    return ratio * laws.shaft_torque_Nm(p, motor, torque, x_m * ratio)


@inlined
def _own_force_N(p: Vector, w: Vector, n: int, m: int, k: int, i: int, y: int, slides: bool) -> float:
    """Force on the roller's side of gear i without web and dry friction: load motors, resistance, unbalance."""
    force = -laws.smooth_resistance_N(p, _axis(i), w[y + n + i])
    if not slides:
        force -= laws.drag_N(p, _axis(i), w[y + n + i])
        if laws.has_unbalance(p, _axis(i)):
            force += laws.unbalance_N(p, _axis(i), w[y + i])
    for j in range(n, m):  # load motors; of a line without any, the loop is not compiled
        if p[_motor(n, j) + lay.M_AXIS] == i:
            force += _motor_force_N(p, w, n, m, k, j, w[y + i], slides)
    return force


@inlined
def _is_apart(p: Vector, s: Vector, n: int, k: int, i: int) -> bool:
    """Whether the motor of axis i moves within its gear play."""
    return laws.has_gap(p, _axis(i)) and s[_axis_state(n, k, i) + lay.SA_CONTACT] == 0.0


@inlined
def _acceleration(
    p: Vector,
    s: Vector,
    n: int,
    k: int,
    i: int,
    v: float,
    per_mass: float,
    force_N: float,
    web_N: float,
    load_N: float,
    slides: bool,
) -> float:
    """m/s² of a roller that does not stick, at speed `v` (m/s).

    `per_mass`: 1/kg of all that turns with it; `force_N`: motors and smooth resistance on that, `web_N`: pull of the
    web, `load_N`: what its own motor pushes with through the gear. `slides` as in `_go_axis`.
    """
    axis = _axis(i)
    if slides:
        if laws.breakaway_N(p, axis) != 0.0:
            force_N -= s[_axis_state(n, k, i) + lay.SA_DIRECTION] * laws.dry_friction_N(p, axis, v)
    elif laws.is_dry(p, axis):
        friction = laws.dry_friction_N(p, axis, v) + laws.load_friction_N(p, axis, load_N)
        force_N -= s[_axis_state(n, k, i) + lay.SA_DIRECTION] * friction
    return (force_N + web_N) * per_mass


@inlined
def _go(w: Vector, size: int, j: int, rate: float, weight: float, ahead: float) -> None:
    """Quantity j of `size`: its rate into the weighted sum of the step, and on to the next stage, `ahead` s of now."""
    w[lay.SUM * size + j] += weight * rate
    w[lay.STAGE * size + j] = w[lay.NOW * size + j] + ahead * rate


@inlined
def _go_axis(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    n: int,
    m: int,
    k: int,
    i: int,
    strain_prev: float,
    weight: float,
    ahead: float,
    slides: bool,
) -> None:
    """Rates of axis i in the stage block: roller and motor as one, or apart within the gear play; it may stick.

    `weight`, `ahead` (s): of this stage of the Runge-Kutta step. `slides`: known beforehand that no gear has play, no
    roller sticks and no rare force acts, a constant where it is compiled for, so that none is asked for.
    """
    size, y = _block(n, k, 1), _block(n, k, lay.STAGE)
    v, per_mass = w[y + n + i], w[_part(n, m, k, lay.PER_MASS) + i]
    drive = _motor_force_N(p, w, n, m, k, i, w[y + 2 * n + i], slides)
    own, web = _own_force_N(p, w, n, m, k, i, y, slides), _web_force_N(p, u, w, n, m, k, i, strain_prev)
    apart = not slides and _is_apart(p, s, n, k, i)
    if apart:
        per_mass = w[_part(n, m, k, lay.PER_ROLLER_MASS) + i]
    if not slides and _sticks(p, s, n, k, i):
        acceleration = 0.0
    else:
        force, load = own if apart else own + drive, 0.0 if apart else drive
        acceleration = _acceleration(p, s, n, k, i, v, per_mass, force, web, load, slides)
    motor_acceleration = drive * w[_part(n, m, k, lay.PER_MOTOR_MASS) + i] if apart else acceleration
    _go(w, size, i, v, weight, ahead)
    _go(w, size, n + i, acceleration, weight, ahead)
    _go(w, size, 2 * n + i, w[y + 3 * n + i] if apart else v, weight, ahead)
    _go(w, size, 3 * n + i, motor_acceleration, weight, ahead)


@inlined
def _sticks(p: Vector, s: Vector, n: int, k: int, i: int) -> bool:
    """Whether dry friction holds roller i."""
    return s[_axis_state(n, k, i) + lay.SA_DIRECTION] == 0.0 and laws.is_dry(p, _axis(i))


@merged
def _stage(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    n: int,
    m: int,
    k: int,
    t: float,
    weight: float,
    ahead: float,
    slides: bool,
) -> None:
    """Rates at time t of what is in the stage block and the torques there, and the next stage `ahead` (s) of now.

    `weight` of these rates in the step's sum; `slides` as in `_go_axis`.
    """
    size, y = _block(n, k, 1), _block(n, k, lay.STAGE)
    strain_prev = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    _web(p, s, u, w, n, m, k, t, strain_prev, y, slides)
    for i in range(n):
        _go_axis(p, s, u, w, n, m, k, i, strain_prev, weight, ahead, slides)
    for j in range(k):
        _go(w, size, 4 * n + j, w[_part(n, m, k, lay.RATE) + j], weight, ahead)
        _go(w, size, 4 * n + k + j, w[_part(n, m, k, lay.LENGTH_RATE) + j], weight, ahead)


@inlined
def _torques(s: Vector, w: Vector, n: int, m: int, k: int, decay: int) -> None:
    """Torques after the time that belongs to the decays at `decay`, exact for the held commands."""
    torque = _part(n, m, k, lay.TORQUE)
    for j in range(m):
        at = _motor_state(n, k, j)
        w[torque + j] = loops.torque_after(s[at + lay.SM_TORQUE_NM], s[at + lay.SM_COMMAND_NM], w[decay + j])


@inlined
def _torques_now(s: Vector, w: Vector, n: int, m: int, k: int) -> None:
    for j in range(m):
        w[_part(n, m, k, lay.TORQUE) + j] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]


@compiled
def _set_decays(p: Vector, w: Vector, h: float) -> None:
    """Decays of the current loops for steps of length h."""
    noinline()
    n, m, k = _counts(p)
    half, full = _part(n, m, k, lay.DECAY_HALF), _part(n, m, k, lay.DECAY_FULL)
    for j in range(m):
        time_constant = w[_part(n, m, k, lay.LOOP_CURRENT_S) + j]
        w[half + j] = loops.current_decay(0.5 * h, time_constant)
        w[full + j] = loops.current_decay(h, time_constant)
    w[_part(n, m, k, lay.DECAY_STEP_S)] = h


@merged
def _integrate(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, h: float, slides: bool
) -> None:
    """One classical Runge-Kutta step: quantities at its end in the stage block, torques there; none taken over yet.

    That they are not taken over is what lets a step with an event in it be tried again, shorter. `slides` as in
    `_go_axis`.
    """
    size = _block(n, k, 1)
    if w[_part(n, m, k, lay.DECAY_STEP_S)] != h:
        _set_decays(p, w, h)
    for j in range(size):
        w[lay.STAGE * size + j] = w[lay.NOW * size + j]
        w[lay.SUM * size + j] = 0.0
    _torques_now(s, w, n, m, k)
    _stage(p, s, u, w, n, m, k, t, 1.0, 0.5 * h, slides)
    _torques(s, w, n, m, k, _part(n, m, k, lay.DECAY_HALF))
    _stage(p, s, u, w, n, m, k, t + 0.5 * h, 2.0, 0.5 * h, slides)
    _stage(p, s, u, w, n, m, k, t + 0.5 * h, 2.0, h, slides)
    _torques(s, w, n, m, k, _part(n, m, k, lay.DECAY_FULL))
    _stage(p, s, u, w, n, m, k, t + h, 1.0, h, slides)
    for j in range(size):
        w[lay.STAGE * size + j] = w[lay.NOW * size + j] + h / 6.0 * w[lay.SUM * size + j]


@compiled
def _integrate_any(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """The same for any line in any mode."""
    noinline()
    n, m, k = _counts(p)
    _integrate(p, s, u, w, n, m, k, t, h, False)


@inlined
def _accept(s: Vector, w: Vector, n: int, m: int, k: int) -> None:
    """Take the end of the step over."""
    size = _block(n, k, 1)
    for j in range(size):
        w[lay.NOW * size + j] = w[lay.STAGE * size + j]
    for j in range(m):
        s[_motor_state(n, k, j) + lay.SM_TORQUE_NM] = w[_part(n, m, k, lay.TORQUE) + j]


@inlined
def _any_sticks(p: Vector, s: Vector, n: int, k: int) -> bool:
    """Whether dry friction holds a roller."""
    sticks = False
    for i in range(n):
        sticks |= _sticks(p, s, n, k, i)
    return sticks


@inlined
def _still_slides(p: Vector, s: Vector, w: Vector, n: int, k: int) -> bool:
    """Whether at the end of the step every roller with dry friction still turns as it did."""
    for i in range(n):
        v, direction = w[_block(n, k, lay.STAGE) + n + i], s[_axis_state(n, k, i) + lay.SA_DIRECTION]
        if _reversal(v, direction) > _EVENT_TOLERANCE and laws.is_dry(p, _axis(i)):
            return False
    return True


@inlined
def _reversal(v: float, direction: float) -> float:
    """How far a speed is on the other side of standstill, mm/s."""
    return -v * direction * 1e3


@compiled
def _violations(p: Vector, s: Vector, u: Vector, w: Vector, t: float, i: int, y: int) -> tuple[float, float, float]:
    """How far axis i has left its mode at place `y`, tensions and torques there: gear, friction; the force on it.

    Gear: a flank passed (µm), or a flank that would have to pull (N). Friction: a speed against its direction (mm/s),
    or a force too great for it to stick (N). In these units one tolerance does for all, as the search needs one number.
    """
    n, m, k = _counts(p)
    axis, mode = _axis(i), _axis_state(n, k, i)
    v, gear, friction = w[y + n + i], -1.0, -1.0
    drive = _motor_force_N(p, w, n, m, k, i, w[y + 2 * n + i], False)
    web = _web_force_N(p, u, w, n, m, k, i, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t))
    apart, sticks = _is_apart(p, s, n, k, i), _sticks(p, s, n, k, i)
    own = _own_force_N(p, w, n, m, k, i, y, False) + (0.0 if apart else drive)
    if apart:
        # Positions grow: flanks that part must not count as passed because of the rounding of their distance.
        rounding_m = _POSITION_ROUNDING * abs(w[y + i])
        gear = (abs(w[y + 2 * n + i] - w[y + i]) - _half_gap_m(p, n, i) - rounding_m) * 1e6
    elif laws.has_gap(p, axis):
        per_mass = w[_part(n, m, k, lay.PER_MASS) + i]
        acceleration = 0.0 if sticks else _acceleration(p, s, n, k, i, v, per_mass, own, web, drive, False)
        motor_mass = p[axis + lay.A_MOTOR_MASS_KG] * laws.inertia_factor(p, axis)
        gear = (motor_mass * acceleration - drive) * s[mode + lay.SA_CONTACT]
    net = own + web
    if laws.is_dry(p, axis):
        breakaway = laws.breakaway_N(p, axis) + laws.load_friction_N(p, axis, 0.0 if apart else drive)
        friction = abs(net) - breakaway if sticks else _reversal(v, s[mode + lay.SA_DIRECTION])
    return gear, friction, net


@inlined
def _half_gap_m(p: Vector, n: int, i: int) -> float:
    """Half the gear play of an axis, at the web."""
    return laws.half_gap_m(p, _axis(i), p[_motor(n, i) + lay.M_RAD_PER_M])


@compiled
def _web_at(p: Vector, s: Vector, u: Vector, w: Vector, t: float, y: int) -> None:
    """Tensions for the quantities at `y`."""
    n, m, k = _counts(p)
    _web(p, s, u, w, n, m, k, t, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t), y, False)


@compiled
def _settle_one(p: Vector, s: Vector, u: Vector, w: Vector, t: float) -> bool:
    """Change the mode of the first axis that has left it, if there is one."""
    n, _, k = _counts(p)
    _web_at(p, s, u, w, t, 0)
    for i in range(n):
        mode = _axis_state(n, k, i)
        gear, friction, net = _violations(p, s, u, w, t, i, 0)
        if gear > _EVENT_TOLERANCE:
            if s[mode + lay.SA_CONTACT] != 0.0:
                s[mode + lay.SA_CONTACT] = 0.0
            else:
                _touch(p, s, w, n, k, i, _half_gap_m(p, n, i))
            return True
        if friction > _EVENT_TOLERANCE:
            if s[mode + lay.SA_DIRECTION] == 0.0:
                s[mode + lay.SA_DIRECTION] = 1.0 if net > 0.0 else -1.0
            else:
                _stick(p, s, w, n, k, i)
            return True
    return False


@compiled
def _stick(p: Vector, s: Vector, w: Vector, n: int, k: int, i: int) -> None:
    """The roller stands."""
    s[_axis_state(n, k, i) + lay.SA_DIRECTION] = 0.0
    w[n + i] = 0.0
    if not _is_apart(p, s, n, k, i):
        w[3 * n + i] = 0.0


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
def _settle(p: Vector, s: Vector, u: Vector, w: Vector, t: float) -> None:
    """Change modes until every axis fits its own (a roller that stops may stick at once, or slide back).

    One at a time: a change of one axis' mode may move the forces that another's was judged by.
    """
    n, m, k = _counts(p)
    for i in range(n):
        direction = _axis_state(n, k, i) + lay.SA_DIRECTION
        if s[direction] == 0.0 and w[n + i] != 0.0:
            s[direction] = 1.0 if w[n + i] > 0.0 else -1.0
    _torques_now(s, w, n, m, k)
    for _ in range(2 * _MOST_EVENTS):
        if not _settle_one(p, s, u, w, t):
            return


@compiled
def _try(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> float:
    """One step of length h; the greatest violation of any axis at its end."""
    n, _, k = _counts(p)
    _integrate_any(p, s, u, w, t, h)
    end = _block(n, k, lay.STAGE)
    _web_at(p, s, u, w, t + h, end)
    worst = -1.0
    for i in range(n):
        gear, friction, _ = _violations(p, s, u, w, t + h, i, end)
        worst = max(worst, gear, friction)
    return worst


@compiled
def _until_event(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float, search: bool) -> float:
    """A step of length h or, if there is an event in it and `search`, up to it; how long it was, s.

    The event's time is found by the Illinois form of regula falsi: the violation is nearly linear in the time within a
    step, and halving the value at the end that stays keeps the bracket from shrinking from one side only. Each trial
    starts from the same quantities, so that the step that is taken is a whole Runge-Kutta step.
    """
    low, high, within, beyond, last = 0.0, h, -_EVENT_TOLERANCE, 0.0, 0  # at the start of the step all is well
    cut, found = h, not search
    for iteration in range(_EVENT_ITERATIONS):
        violation = _try(p, s, u, w, t, cut)
        if found or (iteration == 0 and violation <= _EVENT_TOLERANCE):
            break
        if violation > _EVENT_TOLERANCE:
            within = 0.5 * within if last == 1 else within
            high, beyond, last = cut, violation, 1
        else:
            beyond = 0.5 * beyond if last == -1 else beyond
            low, within, last = cut, min(violation, -_EVENT_TOLERANCE), -1
        found = high - low <= 1e-9 * h or iteration == _EVENT_ITERATIONS - 2
        share = within / (within - beyond)
        # The end beyond the event: from there the new mode begins, and does not find itself in the old one again.
        cut = high if found else low + (high - low) * min(max(share, 1e-3), 0.999)
    return cut


@compiled
def _step_with_events(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """One step, cut at every event; after too many of them the rest is taken as it comes, so that time goes on."""
    noinline()
    n, m, k = _counts(p)
    left = h
    for event in range(_MOST_EVENTS + 1):
        search = event < _MOST_EVENTS
        if search:
            _settle(p, s, u, w, t)
        done = _until_event(p, s, u, w, t, left, search)
        _accept(s, w, n, m, k)
        t += done
        left -= done
        if left <= 1e-12 * h:
            return


@inlined
def _motor_motion(p: Vector, n: int, j: int) -> int:
    """Where the position of the shaft that motor j sits on stands among the integrated quantities.

    An axis' own motor is on the motor's side of the gear play, a load motor on the roller's.
    """
    return 2 * n + j if j < n else int(p[_motor(n, j) + lay.M_AXIS])


@inlined
def _sample_drive(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, j: int, position: float, velocity: float
) -> None:
    """The loops of motor j once, on a motion of its shaft as it is measured, rad and rad/s."""
    gains, state, inputs = _motor(n, j) + lay.M_LOOPS, _motor_state(n, k, j), lay.U_MOTORS + j * lay.UM_SIZE
    kp, ki = w[_part(n, m, k, lay.LOOP_KP) + j], w[_part(n, m, k, lay.LOOP_KI) + j]
    current_s = w[_part(n, m, k, lay.LOOP_CURRENT_S) + j]
    loops.drive_sample(p, s, u, gains, state, inputs, p[lay.W_SAMPLE_TIME_S], position, velocity, kp, ki, current_s)


@inlined
def _sample_drives(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int) -> None:
    for j in range(m):
        at, ratio = _motor_motion(p, n, j), p[_motor(n, j) + lay.M_RAD_PER_M]
        _sample_drive(p, s, u, w, n, m, k, j, w[at] * ratio, w[at + n] * ratio)


@compiled
def _sample_erring_drives(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """The same where encoders may err."""
    noinline()
    n, m, k = _counts(p)
    for j in range(m):
        at, motor = _motor_motion(p, n, j), _motor(n, j)
        ratio = p[motor + lay.M_RAD_PER_M]
        position, velocity = laws.measured_motion(p, motor, w[at] * ratio, w[at + n] * ratio)
        _sample_drive(p, s, u, w, n, m, k, j, position, velocity)


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
    one_span: bool,
) -> bool:
    """One step, taken only if there is no event in it; whether it was.

    `pace`: of the line; without gear play and a roller that sticks an event shows in the speeds at the step's end.
    `one_span`: the counts are those of one span, as constants, and so is this; the rates are then compiled with them.
    """
    if pace == lay.PLAY or _any_sticks(p, s, n, k):
        return False
    if one_span and pace == lay.PLAIN:
        _integrate(p, s, u, w, 2, 2, 1, t, h, True)
    else:
        _integrate_any(p, s, u, w, t, h)
    if not _still_slides(p, s, w, n, k):
        return False
    _accept(s, w, n, m, k)
    return True


@merged
def _advance_line(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, samples: int, one_span: bool
) -> None:
    substeps = int(p[lay.W_SUBSTEPS])
    period = p[lay.W_SAMPLE_TIME_S]
    h = period / substeps
    pace, reports = w[_part(n, m, k, lay.PACE)], w[_part(n, m, k, lay.REPORTS)] != 0.0
    spliced = k > 0 and laws.has_splice(p, s, _pieces(n, m, k))
    for _ in range(samples):
        if reports:
            _sample_erring_drives(p, s, u, w)
        else:
            _sample_drives(p, s, u, w, n, m, k)
        for substep in range(substeps):
            t = s[lay.S_COUNT] * period + substep * h
            laws.put_step_factors(p, _first_span(n, m), k, t, h, w, _part(n, m, k, lay.STEPS))
            if spliced:
                _follow_pieces(p, s, u, w, t, h)
            if not _simple_step(p, s, u, w, n, m, k, t, h, pace, one_span):
                _step_with_events(p, s, u, w, t, h)
        s[lay.S_COUNT] += 1.0
        for j in range(m):
            place = _past(n, m, k, j) + int(s[lay.S_COUNT]) % lay.RING
            s[place] = s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
        if reports:
            _leave_out(p, s, u, w)


@compiled
def _fed_forward_Nm(p: Vector, s: Vector, u: Vector, w: Vector, t: float, j: int) -> float:
    """Torque of motor j now that its record leaves out."""
    noinline()
    n, m, k = _counts(p)
    axis, motor = _axis(j), _motor(n, j)
    _torques_now(s, w, n, m, k)
    _web_at(p, s, u, w, t, 0)
    drive = _motor_force_N(p, w, n, m, k, j, w[2 * n + j], False)
    acceleration, direction = 0.0, s[_axis_state(n, k, j) + lay.SA_DIRECTION]
    if _is_apart(p, s, n, k, j):
        acceleration = drive * w[_part(n, m, k, lay.PER_MOTOR_MASS) + j]
    elif not _sticks(p, s, n, k, j):
        web = _web_force_N(p, u, w, n, m, k, j, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t))
        force = _own_force_N(p, w, n, m, k, j, 0, False) + drive
        per_mass = w[_part(n, m, k, lay.PER_MASS) + j]
        acceleration = _acceleration(p, s, n, k, j, w[n + j], per_mass, force, web, drive, False)
    mass = (p[axis + lay.A_MOTOR_MASS_KG] + p[axis + lay.A_ROLLER_MASS_KG]) * laws.inertia_factor(p, axis)
    fed = laws.fed_forward_N(p, axis, motor, mass, w[3 * n + j], acceleration, direction)
    return fed / p[motor + lay.M_RAD_PER_M]


@inlined
def _set_blur(w: Vector, n: int, m: int, k: int, h: float) -> None:
    """Over which way the ends of pieces are not sharp in a step of length h."""
    w[_part(n, m, k, lay.SPLICE_BLUR)] = max(abs(w[n]) * h, lay.LEAST_BLUR_M)


@compiled
def _follow_pieces(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """Pieces of other web during a step from t on: one that is yet to come may come in, those that are out go."""
    noinline()
    n, m, k = _counts(p)
    pieces, strain_prev = _pieces(n, m, k), laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    laws.let_splice_in(p, s, pieces, t, h, w[0], w[n], strain_prev)
    web_m = 0.0
    for j in range(k):
        web_m += w[4 * n + j]
    laws.forget_passed(s, pieces, w[0], strain_prev, web_m)
    _set_blur(w, n, m, k, h)


@compiled
def _leave_out(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Take off the torques just kept what their records leave out."""
    noinline()
    n, m, k = _counts(p)
    for j in range(m):
        if laws.has_feed_forward(p, _motor(n, j)):
            fed = _fed_forward_Nm(p, s, u, w, s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S], j)
            s[_past(n, m, k, j) + int(s[lay.S_COUNT]) % lay.RING] -= fed


@compiled
def _advance_one_span(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    _advance_line(p, s, u, w, 2, 2, 1, samples, True)


@compiled
def _advance_any(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    noinline()
    n, m, k = _counts(p)
    _advance_line(p, s, u, w, n, m, k, samples, False)


@merged
def go_on(p: Vector, s: Vector, u: Vector, w: Vector, samples: int) -> None:
    """Between `enter` and `leave`. The one-span line with its counts as constants, every other line without."""
    if _is_one_span(p):
        _advance_one_span(p, s, u, w, samples)
    else:
        _advance_any(p, s, u, w, samples)


@compiled
def enter(p: Vector, s: Vector, u: Vector, w: Vector) -> None:
    """Bring into the scratch space what is integrated, and what stays the same during a call.

    Masses and effects may have changed between two calls, and the scratch space may have served another line.
    """
    n, m, k = _counts(p)
    for j in range(_block(n, k, 1)):
        w[j] = s[lay.S_Y + j]
    for j in range(k):
        w[_part(n, m, k, lay.LENGTH_RATE) + j] = u[lay.U_MOTORS + m * lay.UM_SIZE + j]
    pace = lay.PLAIN
    for i in range(n):
        axis = _axis(i)
        factor = laws.inertia_factor(p, axis)
        motor_mass, roller_mass = p[axis + lay.A_MOTOR_MASS_KG] * factor, p[axis + lay.A_ROLLER_MASS_KG] * factor
        w[_part(n, m, k, lay.PER_MASS) + i] = 1.0 / (motor_mass + roller_mass)
        w[_part(n, m, k, lay.PER_ROLLER_MASS) + i] = 1.0 / roller_mass
        w[_part(n, m, k, lay.PER_MOTOR_MASS) + i] = 1.0 / motor_mass
        if laws.has_gap(p, axis):
            pace = lay.PLAY
        elif laws.has_rare_force(p, axis, _motor(n, i)):
            pace = max(pace, lay.RARE)
    if k > 0 and laws.has_splice(p, s, _pieces(n, m, k)):
        pace = max(pace, lay.RARE)
        _set_blur(w, n, m, k, p[lay.W_SAMPLE_TIME_S] / p[lay.W_SUBSTEPS])
    w[_part(n, m, k, lay.PACE)] = pace
    reports = False
    for j in range(m):
        motor = _motor(n, j)
        reports |= laws.has_feed_forward(p, motor) or laws.has_encoder_error(p, motor)
        w[_part(n, m, k, lay.LOOP_KP) + j] = laws.velocity_kp(p, motor)
        w[_part(n, m, k, lay.LOOP_KI) + j] = laws.velocity_ki(p, motor)
        w[_part(n, m, k, lay.LOOP_CURRENT_S) + j] = laws.current_loop_s(p, motor)
    w[_part(n, m, k, lay.REPORTS)] = 1.0 if reports else 0.0
    _set_decays(p, w, p[lay.W_SAMPLE_TIME_S] / p[lay.W_SUBSTEPS])


@compiled
def leave(s: Vector, w: Vector, size: int) -> None:
    """Bring what is integrated back into the state."""
    for j in range(size):
        s[lay.S_Y + j] = w[j]


@merged
def _report_line(p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, out: Vector, at: int) -> None:
    period = p[lay.W_SAMPLE_TIME_S]
    t = s[lay.S_COUNT] * period
    step = period / p[lay.W_SUBSTEPS]
    laws.put_step_factors(p, _first_span(n, m), k, t, step, w, _part(n, m, k, lay.STEPS))
    _web(p, s, u, w, n, m, k, t, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t), 0, False)
    reports = w[_part(n, m, k, lay.REPORTS)] != 0.0
    for j in range(m):
        motion = _motor_motion(p, n, j)
        motor, torque = _motor(n, j), s[_motor_state(n, k, j) + lay.SM_TORQUE_NM]
        out[at + j] = w[motion]
        out[at + m + j] = w[motion + n]
        if reports and laws.has_encoder_error(p, motor):
            ratio = p[motor + lay.M_RAD_PER_M]
            position, velocity = laws.measured_motion(p, motor, w[motion] * ratio, w[motion + n] * ratio)
            out[at + j] = position / ratio
            out[at + m + j] = velocity / ratio
        if reports and laws.has_feed_forward(p, motor):
            torque -= _fed_forward_Nm(p, s, u, w, t, j)
        out[at + 2 * m + j] = laws.measured_torque_Nm(p, motor, torque, s, _past(n, m, k, j), int(s[lay.S_COUNT]))
    for j in range(k):
        out[at + 3 * m + j] = w[_part(n, m, k, lay.TENSION) + j]
        scale = laws.length_factor(p, _first_span(n, m) + j * lay.SP_SIZE)
        out[at + 3 * m + k + j] = w[4 * n + k + j] * scale / w[4 * n + j] - 1.0


@merged
def _report_one_span(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, at: int) -> None:
    _report_line(p, s, u, w, 2, 2, 1, out, at)


@compiled
def _report_any(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, at: int) -> None:
    noinline()
    n, m, k = _counts(p)
    _report_line(p, s, u, w, n, m, k, out, at)


@merged
def report(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, at: int) -> None:
    """What is measured and true now, from place `at` of `out` on; between `enter` and `leave`."""
    if _is_one_span(p):
        _report_one_span(p, s, u, w, out, at)
    else:
        _report_any(p, s, u, w, out, at)


@compiled
def _rows(
    p: Vector, s: Vector, u: Vector, w: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector, at: int
) -> None:
    """Observe and advance, row by row, from place `at` of `out` on; between `enter` and `leave`.

    `commands` (n, M) set points, motor side, and `boundary` (n, 2), upstream strain and downstream tension (N), each
    held for `samples` drive samples.
    """
    _, m, k = _counts(p)
    for row in range(commands.shape[0]):
        u[lay.U_STRAIN_PREV] = boundary[row, 0]
        u[lay.U_F_NEXT_N] = boundary[row, 1]
        for j in range(commands.shape[1]):
            u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, j]
        report(p, s, u, w, out, at + row * (3 * m + 2 * k))
        go_on(p, s, u, w, samples)


Advance = Callable[[Vector, Vector, Vector, Vector, int], None]
Observe = Callable[[Vector, Vector, Vector, Vector, Vector], None]
Simulate = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, int, Vector], None]


def source_number(*further: str) -> int:
    """A number that changes with the source of what is compiled here, and with `further` files."""
    effects = str(Path(__file__).parents[1] / "effects.py")
    names = (decorators.__file__, loops.__file__, laws.__file__, lay.__file__, __file__, effects, *further)
    return number_of_sources(*names)


def _entry_points(sources: int) -> tuple[Advance, Observe, Simulate]:
    """The compiled functions others call; `sources` as in `number_of_sources`."""

    @entry_point
    def advance(p: Vector, s: Vector, u: Vector, work: Vector, samples: int) -> None:
        if sources >= 0:
            enter(p, s, u, work)
            go_on(p, s, u, work, samples)
            leave(s, work, _block(int(p[lay.W_AXES]), int(p[lay.W_SPANS]), 1))

    @entry_point
    def observe(p: Vector, s: Vector, u: Vector, work: Vector, out: Vector) -> None:
        if sources >= 0:
            enter(p, s, u, work)
            report(p, s, u, work, out, 0)

    @entry_point
    def simulate(
        p: Vector, s: Vector, u: Vector, work: Vector, commands: Vector, boundary: Vector, samples: int, out: Vector
    ) -> None:
        flat, rows, columns = out.reshape(-1), out.shape[1], out.shape[2]
        for b in range(p.shape[0] if sources >= 0 else 0):
            parameters, state = p[b], s[b]
            enter(parameters, state, u, work)
            _rows(parameters, state, u, work, commands, boundary, samples, flat, b * rows * columns)
            leave(state, work, _block(int(parameters[lay.W_AXES]), int(parameters[lay.W_SPANS]), 1))

    return advance, observe, simulate


#: advance(parameters, state, inputs, work, samples): `samples` drive sample times onwards, state changed in place.
#: observe(parameters, state, inputs, work, out): measured motion and torque, tension, strain (`Layout.columns`).
#: simulate(parameters (B, P), states (B, S), inputs, work, commands (n, M), boundary (n, 2), samples, out (B, n, C)):
#: for each row observe, then advance `samples` with the row's set points, upstream strain and downstream tension.
advance, observe, simulate = _entry_points(source_number())
