"""Equations of motion of a line, compiled: tensions, forces and rates of all parts, and a Runge-Kutta step over them.

Arguments as in `hilbench.plant.web_line.kernel`.
"""

from __future__ import annotations

from hilbench.compiled import compiled, inlined, merged, noinline
from hilbench.plant import drive_loops as loops
from hilbench.plant.web_line import carriages, laws, places, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def web(
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
    speed, tension, rate = (
        places.part(n, m, k, lay.SPEED),
        places.part(n, m, k, lay.TENSION),
        places.part(n, m, k, lay.RATE),
    )
    if k > 0:
        for i in range(n):
            w[speed + i] = laws.web_speed_m_s(p, places.axis(i), w[y + i], w[y + n + i])
        first, steps, pieces = places.first_span(n, m), places.part(n, m, k, lay.STEPS), places.pieces(n, m, k)
        length_rate = places.part(n, m, k, lay.LENGTH_RATE)
        if not slides:
            _put_rates_of_stations(p, u, w, n, m, k, y)
        f_next, material = u[lay.U_F_NEXT_N], y + 4 * n
        strain_next = laws.downstream_strain(p, f_next)
        if not slides and splice_laws.has_splice(p, s, pieces):
            blur = w[places.part(n, m, k, lay.SPLICE_BLUR)]
            splice_laws.spliced_span_rates(
                p, s, pieces, first, k, t, strain_prev, f_next, strain_next, w, steps, speed, material, length_rate,
                tension, rate, web_travel_m(p, w[y]), blur,
            )  # fmt: skip
        else:
            laws.span_rates(
                p, first, k, t, strain_prev, f_next, strain_next, w, steps, speed, material, length_rate, tension, rate
            )


@inlined
def web_travel_m(p: Vector, x_m: float) -> float:
    """Travel of the web at the first roller, whose position is x."""
    return reels.web_travel_m(p, places.axis(0), x_m) if reels.is_reel(p, places.axis(0)) else x_m


@inlined
def _put_rates_of_stations(p: Vector, u: Vector, w: Vector, n: int, m: int, k: int, y: int) -> None:
    """Apply reels to the web's speeds, and carriages to the rates of the lengths."""
    speed, length_rate = places.part(n, m, k, lay.SPEED), places.part(n, m, k, lay.LENGTH_RATE)
    if reels.is_reel(p, places.axis(0)):
        w[speed] *= reels.radius_ratio(p, places.axis(0), w[y])
    if reels.is_reel(p, places.axis(k)):
        w[speed + k] *= reels.radius_ratio(p, places.axis(k), w[y + k])
    if n > k + 1:
        for j in range(k):
            w[length_rate + j] = u[lay.U_MOTORS + m * lay.UM_SIZE + j]
        for i in range(k + 1, n):
            carriages.add_length_rates(p, w, places.axis(i), length_rate, w[y + i], w[y + n + i])


@inlined
def shaft_of_motor(p: Vector, n: int, j: int) -> int:
    """Index of the position of motor j's shaft in the integrated quantities.

    An axis's own motor is on the motor's side of the gear play, a load motor on the roller's. Behind a twisting shaft,
    in place of the motor's side, is a part of the load.
    """
    if j < n:
        return j if laws.twists(p, places.axis(j)) else 2 * n + j
    return int(p[places.motor(n, j) + lay.M_AXIS])


@inlined
def acceleration_behind_m_s2(p: Vector, w: Vector, n: int, i: int, y: int) -> float:
    """Acceleration of the load behind the twisting shaft of axis i."""
    twist, rate = w[y + 2 * n + i] - w[y + i], w[y + 3 * n + i] - w[y + n + i]
    return laws.acceleration_behind(p, places.axis(i), twist, rate)


@compiled
def set_masses(p: Vector, w: Vector, t: float) -> None:
    """Set the inverse masses of all axes at a time; a twisting shaft separates the motor's mass from the load's."""
    n, m, k = places.counts(p)
    both, roller, motor = (
        places.part(n, m, k, lay.PER_MASS),
        places.part(n, m, k, lay.PER_ROLLER_MASS),
        places.part(n, m, k, lay.PER_MOTOR_MASS),
    )
    for i in range(n):
        axis = places.axis(i)
        factor = laws.inertia_factor_at(p, axis, t)
        motor_mass, roller_mass = p[axis + lay.A_MOTOR_MASS_KG] * factor, p[axis + lay.A_ROLLER_MASS_KG] * factor
        moved = motor_mass + roller_mass
        if laws.twists(p, axis):
            roller_mass = laws.share_behind(p, axis) * moved
            moved -= roller_mass
        w[both + i] = 1.0 / moved
        w[roller + i] = 1.0 / roller_mass
        w[motor + i] = 1.0 / motor_mass


@inlined
def web_force_N(
    p: Vector, u: Vector, w: Vector, n: int, m: int, k: int, i: int, y: int, strain_prev: float, slides: bool
) -> float:
    """Force of the web on axis i, N forward: the tension after the roller less the one before it, as last put into `w`.

    An unwinder has none before it, a rewinder none after it; a carriage is loaded by all its strands. `slides` as in
    `_go_axis`.
    """
    axis = places.axis(i)
    if p[axis + lay.A_WEB_LOAD] == 0.0:
        return 0.0
    tension = places.part(n, m, k, lay.TENSION)
    if not slides:
        if carriages.is_carriage(k, i):
            return carriages.web_force_N(p, w, axis, tension, w[y + i])
        if reels.is_reel(p, axis):
            return reels.radius_ratio(p, axis, w[y + i]) * (w[tension] if i == 0 else -w[tension + k - 1])
    before = w[tension + i - 1] if i > 0 else strain_prev * p[lay.W_UPSTREAM_STIFFNESS_N]
    return (w[tension + i] if i < k else u[lay.U_F_NEXT_N]) - before


@inlined
def motor_force_N(p: Vector, w: Vector, n: int, m: int, k: int, j: int, x_m: float, slides: bool) -> float:
    """Force of motor j at the web, N, from the torque in `w`; its shaft is at `x_m`. `slides` as in `_go_axis`."""
    motor = places.motor(n, j)
    ratio, torque = p[motor + lay.M_RAD_PER_M], w[places.part(n, m, k, lay.TORQUE) + j]
    if slides:
        return ratio * laws.usual_shaft_torque_Nm(p, motor, torque, x_m * ratio)
    return ratio * laws.shaft_torque_Nm(p, motor, torque, x_m * ratio)


@inlined
def own_force_N(p: Vector, w: Vector, n: int, m: int, k: int, i: int, y: int, slides: bool) -> float:
    """Force on the roller's side of gear i without web and dry friction: load motors, resistance, unbalance, twist."""
    force = -laws.smooth_resistance_N(p, places.axis(i), w[y + n + i])
    if not slides:
        force -= laws.drag_N(p, places.axis(i), w[y + n + i])
        force += laws.unbalance_N(p, places.axis(i), w[y + i])
        if carriages.is_carriage(k, i):
            force += carriages.force_N(p, places.axis(i), w[y + i])
        if laws.twists(p, places.axis(i)):
            force -= acceleration_behind_m_s2(p, w, n, i, y) / w[places.part(n, m, k, lay.PER_ROLLER_MASS) + i]
    for j in range(n, m):  # load motors; of a line without any, the loop is not compiled
        if p[places.motor(n, j) + lay.M_AXIS] == i:
            force += motor_force_N(p, w, n, m, k, j, w[y + i], slides)
    return force


@inlined
def is_apart(p: Vector, s: Vector, n: int, k: int, i: int) -> bool:
    """True if the motor of axis i moves within its gear play."""
    return laws.has_gap(p, places.axis(i)) and s[places.axis_state(n, k, i) + lay.SA_CONTACT] == 0.0


@inlined
def is_at_stop(s: Vector, n: int, k: int, i: int) -> bool:
    """True if axis i is a carriage at one of its stops."""
    return carriages.is_carriage(k, i) and s[places.axis_state(n, k, i) + lay.SA_CONTACT] != 0.0


@inlined
def per_mass(p: Vector, w: Vector, n: int, m: int, k: int, i: int, y: int) -> float:
    """Inverse mass, 1/kg, of roller and motor i as one, of a reel with the web on it."""
    axis = places.axis(i)
    if reels.is_reel(p, axis):
        return 1.0 / (reels.mass_kg(p, axis, w[y + i]) * laws.inertia_factor(p, axis))
    return w[places.part(n, m, k, lay.PER_MASS) + i]


@inlined
def sticks(p: Vector, s: Vector, n: int, k: int, i: int) -> bool:
    """True if dry friction holds roller i."""
    return s[places.axis_state(n, k, i) + lay.SA_DIRECTION] == 0.0 and laws.is_dry(p, places.axis(i))


@inlined
def acceleration_m_s2(
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
    """Acceleration, m/s², of a roller that does not stick, at speed `v` (m/s).

    `per_mass`: 1/kg of all that turns with it; `force_N`: motors and smooth resistance on that, `web_N`: force of the
    web, `load_N`: force of its own motor through the gear. `slides` as in `_go_axis`.
    """
    axis = places.axis(i)
    if slides:
        if laws.breakaway_N(p, axis) != 0.0:
            force_N -= s[places.axis_state(n, k, i) + lay.SA_DIRECTION] * laws.dry_friction_N(p, axis, v)
    elif laws.is_dry(p, axis):
        friction = laws.dry_friction_N(p, axis, v) + laws.load_friction_N(p, axis, load_N)
        force_N -= s[places.axis_state(n, k, i) + lay.SA_DIRECTION] * friction
    return (force_N + web_N) * per_mass


@inlined
def _go(w: Vector, size: int, j: int, rate: float, weight: float, ahead: float) -> None:
    """Advance quantity j of `size`: its rate into the step's weighted sum, and the next stage, `ahead` s from now."""
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
    """Rates of axis i in the stage block: roller and motor as one, or apart within the gear play, or by a twisting
    shaft; it may stick, a carriage be at a stop, and a roller without 1/mass keeps its speed.

    `weight`, `ahead` (s): of this stage of the Runge-Kutta step. `slides`: compile-time constant, true if no gear has
    play, no roller sticks and no rare force acts, which saves the checks.
    """
    size, y = places.block(n, k, 1), places.block(n, k, lay.STAGE)
    v = w[y + n + i]
    of_mass = w[places.part(n, m, k, lay.PER_MASS) + i] if slides else per_mass(p, w, n, m, k, i, y)
    if of_mass == 0.0:
        _go(w, size, i, v, weight, ahead)
        _go(w, size, n + i, 0.0, weight, ahead)
        _go(w, size, 2 * n + i, v, weight, ahead)
        _go(w, size, 3 * n + i, 0.0, weight, ahead)
        return
    twists = not slides and laws.twists(p, places.axis(i))
    drive = motor_force_N(p, w, n, m, k, i, w[y + (i if twists else 2 * n + i)], slides)
    own = own_force_N(p, w, n, m, k, i, y, slides)
    pull = web_force_N(p, u, w, n, m, k, i, y, strain_prev, slides)
    apart = not slides and is_apart(p, s, n, k, i)
    if apart:
        of_mass = w[places.part(n, m, k, lay.PER_ROLLER_MASS) + i]
    if not slides and (sticks(p, s, n, k, i) or is_at_stop(s, n, k, i)):
        acceleration = 0.0
    else:
        force, load = own if apart else own + drive, 0.0 if apart else drive
        acceleration = acceleration_m_s2(p, s, n, k, i, v, of_mass, force, pull, load, slides)
    other = drive * w[places.part(n, m, k, lay.PER_MOTOR_MASS) + i] if apart else acceleration
    if twists:
        other = acceleration_behind_m_s2(p, w, n, i, y)
    other_speed = w[y + 3 * n + i] if apart or twists else v
    _go(w, size, i, v, weight, ahead)
    _go(w, size, n + i, acceleration, weight, ahead)
    _go(w, size, 2 * n + i, other_speed, weight, ahead)
    _go(w, size, 3 * n + i, other, weight, ahead)


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
    """Rates at time t for stage block and torques, and the next stage `ahead` (s) from now.

    `weight` of these rates in the step's sum; `slides` as in `_go_axis`.
    """
    size, y = places.block(n, k, 1), places.block(n, k, lay.STAGE)
    strain_prev = laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t)
    web(p, s, u, w, n, m, k, t, strain_prev, y, slides)
    for i in range(n):
        _go_axis(p, s, u, w, n, m, k, i, strain_prev, weight, ahead, slides)
    for j in range(k):
        _go(w, size, 4 * n + j, w[places.part(n, m, k, lay.RATE) + j], weight, ahead)
        _go(w, size, 4 * n + k + j, w[places.part(n, m, k, lay.LENGTH_RATE) + j], weight, ahead)


@inlined
def _torques(s: Vector, w: Vector, n: int, m: int, k: int, decay: int) -> None:
    """Torques after the time of the decays at `decay`, exact for the held commands."""
    torque = places.part(n, m, k, lay.TORQUE)
    for j in range(m):
        at = places.motor_state(n, k, j)
        w[torque + j] = loops.torque_after(s[at + lay.SM_TORQUE_NM], s[at + lay.SM_COMMAND_NM], w[decay + j])


@inlined
def torques_now(s: Vector, w: Vector, n: int, m: int, k: int) -> None:
    for j in range(m):
        w[places.part(n, m, k, lay.TORQUE) + j] = s[places.motor_state(n, k, j) + lay.SM_TORQUE_NM]


@compiled
def set_decays(p: Vector, w: Vector, h: float) -> None:
    """Decays of the current loops for steps of length h."""
    noinline()
    n, m, k = places.counts(p)
    half, full = places.part(n, m, k, lay.DECAY_HALF), places.part(n, m, k, lay.DECAY_FULL)
    for j in range(m):
        time_constant = w[places.part(n, m, k, lay.LOOP_CURRENT_S) + j]
        w[half + j] = loops.current_decay(0.5 * h, time_constant)
        w[full + j] = loops.current_decay(h, time_constant)
    w[places.part(n, m, k, lay.DECAY_STEP_S)] = h


@merged
def integrate(
    p: Vector, s: Vector, u: Vector, w: Vector, n: int, m: int, k: int, t: float, h: float, slides: bool
) -> None:
    """Classical Runge-Kutta step: quantities at its end in the stage block, torques there; none accepted yet.

    So a step with an event in it can be repeated, shorter. `slides` as in `_go_axis`.
    """
    size = places.block(n, k, 1)
    if w[places.part(n, m, k, lay.DECAY_STEP_S)] != h:
        set_decays(p, w, h)
    for j in range(size):
        w[lay.STAGE * size + j] = w[lay.NOW * size + j]
        w[lay.SUM * size + j] = 0.0
    torques_now(s, w, n, m, k)
    _stage(p, s, u, w, n, m, k, t, 1.0, 0.5 * h, slides)
    _torques(s, w, n, m, k, places.part(n, m, k, lay.DECAY_HALF))
    _stage(p, s, u, w, n, m, k, t + 0.5 * h, 2.0, 0.5 * h, slides)
    _stage(p, s, u, w, n, m, k, t + 0.5 * h, 2.0, h, slides)
    _torques(s, w, n, m, k, places.part(n, m, k, lay.DECAY_FULL))
    _stage(p, s, u, w, n, m, k, t + h, 1.0, h, slides)
    for j in range(size):
        w[lay.STAGE * size + j] = w[lay.NOW * size + j] + h / 6.0 * w[lay.SUM * size + j]


@compiled
def integrate_any(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """`integrate` for any line in any mode."""
    noinline()
    n, m, k = places.counts(p)
    integrate(p, s, u, w, n, m, k, t, h, False)


@inlined
def accept(s: Vector, w: Vector, n: int, m: int, k: int) -> None:
    """Accept the end of the step."""
    size = places.block(n, k, 1)
    for j in range(size):
        w[lay.NOW * size + j] = w[lay.STAGE * size + j]
    for j in range(m):
        s[places.motor_state(n, k, j) + lay.SM_TORQUE_NM] = w[places.part(n, m, k, lay.TORQUE) + j]
