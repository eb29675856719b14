"""Equations of motion of a line, compiled: tensions, forces and rates of all parts, and a Runge-Kutta step over them.

Arguments as in `hilbench.plant.web_line.kernel`.
"""

from __future__ import annotations

from hilbench.compiled import compiled, inlined, merged, noinline
from hilbench.plant import drive_loops as loops
from hilbench.plant.web_line import carriages, laws, records, reels, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.records import LineArrays


@inlined
def strain_prev(line: LineArrays, t: float) -> float:
    """Strain of the web that enters, with the disturbance."""
    return laws.upstream_strain(records.web(line), records.boundary(line).strain_prev, t)


@inlined
def web(line: LineArrays, t: float, strain_prev: float, y: int, slides: bool) -> None:
    """Tensions (N), and rates of the unstretched lengths (m/s), for the quantities at `y`, into the scratch space.

    `strain_prev`: strain of the web that enters, with the disturbance. `slides` as in `_go_axis`.
    """
    if line.k > 0:
        for i in range(line.n):
            x, v = line.w[y + i], line.w[y + line.n + i]
            records.part(line, i).speed_m_s = laws.web_speed_m_s(records.axis(line, i), x, v)
        if slides:
            laws.span_rates(line, t, strain_prev, y + 4 * line.n)
        else:
            _put_rates_of_stations(line, y)
            travel_m = reels.web_travel_m(records.axis(line, 0), line.w[y])
            span_rates(line, t, strain_prev, y + 4 * line.n, travel_m)


@inlined
def span_rates(line: LineArrays, t: float, strain_prev: float, material: int, x_m: float) -> None:
    """`laws.span_rates`, also with pieces of other web; `x_m`: travel of the web at roller 1."""
    if splice_laws.has_splice(records.web(line), records.pieces(line)):
        splice_laws.spliced_span_rates(line, t, strain_prev, material, x_m)
    else:
        laws.span_rates(line, t, strain_prev, material)


@inlined
def _put_rates_of_stations(line: LineArrays, y: int) -> None:
    """Apply reels to the web's speeds, and carriages to the rates of the lengths."""
    n, m, k = line.n, line.m, line.k
    for i in (0, k):
        if records.axis(line, i).reel_slope_per_m != 0.0:
            records.part(line, i).speed_m_s *= reels.radius_ratio(records.axis(line, i), line.w[y + i])
    if n > k + 1:
        for j in range(k):
            records.part(line, j).length_rate_m_s = line.u[lay.U_MOTORS + m * lay.UM_SIZE + j]
        for i in range(k + 1, n):
            axis = records.axis(line, i)
            rate = carriages.gain(axis, line.w[y + i]) * line.w[y + n + i]
            for j in range(int(axis.first_span), int(axis.last_span) + 1):
                records.part(line, j).length_rate_m_s += rate


@inlined
def shaft_of_motor(line: LineArrays, j: int) -> int:
    """Index of the position of motor j's shaft in the integrated quantities.

    An axis's own motor is on the motor's side of the gear play, a load motor on the roller's. Behind a twisting shaft,
    in place of the motor's side, is a part of the load.
    """
    if j < line.n:
        return j if records.axis(line, j).resonance.inertia_share != 0.0 else 2 * line.n + j
    return int(records.motor(line, j).axis)


@compiled
def acceleration_behind_m_s2(line: LineArrays, i: int, y: int) -> float:
    """Acceleration of the load behind the twisting shaft of axis i."""
    noinline()
    w, n = line.w, line.n
    twist, rate = w[y + 2 * n + i] - w[y + i], w[y + 3 * n + i] - w[y + n + i]
    return laws.acceleration_behind(records.axis(line, i), twist, rate)


@compiled
def set_masses(line: LineArrays, t: float) -> None:
    """Set the inverse masses of all axes at a time; a twisting shaft separates the motor's mass from the load's."""
    for i in range(line.n):
        axis, part = records.axis(line, i), records.part(line, i)
        factor = laws.inertia_factor_at(axis, t, records.web(line).sample_time_s)
        motor_kg, roller_kg = axis.motor_mass_kg * factor, axis.roller_mass_kg * factor
        moved_kg = motor_kg + roller_kg
        if axis.resonance.inertia_share != 0.0:
            roller_kg = axis.resonance.inertia_share * moved_kg
            moved_kg -= roller_kg
        part.per_kg, part.per_roller_kg, part.per_motor_kg = 1.0 / moved_kg, 1.0 / roller_kg, 1.0 / motor_kg


@inlined
def web_force_N(line: LineArrays, i: int, y: int, strain_prev: float, slides: bool) -> float:
    """Force of the web on axis i, N forward: the tension after the roller less the one before it, as last put into the
    scratch space.

    An unwinder has none before it, a rewinder none after it; a carriage is loaded by all its strands. `slides` as in
    `_go_axis`.
    """
    axis = records.axis(line, i)
    if axis.web_load == 0.0:
        return 0.0
    if not slides:
        if carriages.is_carriage(line, i):
            total = 0.0
            for j in range(int(axis.first_span), int(axis.last_span) + 1):
                total += records.part(line, j).tension_N
            return -carriages.gain(axis, line.w[y + i]) * total
        if axis.reel_slope_per_m != 0.0:
            pull_N = records.part(line, 0).tension_N if i == 0 else -records.part(line, line.k - 1).tension_N
            return reels.radius_ratio(axis, line.w[y + i]) * pull_N
    before = records.part(line, i - 1).tension_N if i > 0 else strain_prev * records.web(line).upstream_stiffness_N
    return (records.part(line, i).tension_N if i < line.k else records.boundary(line).F_next_N) - before


@inlined
def motor_force_N(line: LineArrays, j: int, x_m: float, slides: bool) -> float:
    """Force of motor j at the web, N, from its present torque; its shaft is at `x_m`. `slides` as in `_go_axis`."""
    motor, torque_Nm = records.motor(line, j), records.part(line, j).torque_Nm
    ratio = motor.rad_per_m
    if slides:
        return ratio * laws.usual_shaft_torque_Nm(motor, torque_Nm, x_m * ratio)
    return ratio * laws.shaft_torque_Nm(motor, torque_Nm, x_m * ratio)


@inlined
def own_force_N(line: LineArrays, i: int, y: int, slides: bool) -> float:
    """Force on the roller's side of gear i without web and dry friction: load motors, resistance, unbalance, twist."""
    axis, x, v = records.axis(line, i), line.w[y + i], line.w[y + line.n + i]
    force = -laws.smooth_resistance_N(axis, v)
    if not slides:
        force -= laws.drag_N(axis, v)
        force += laws.unbalance_N(axis, x)
        if carriages.is_carriage(line, i):
            force += axis.force_N - axis.spring_N_per_m * (x - axis.spring_rest_m)
        if axis.resonance.inertia_share != 0.0:
            force -= acceleration_behind_m_s2(line, i, y) / records.part(line, i).per_roller_kg
    for j in range(line.n, line.m):  # load motors; of a line without any, the loop is not compiled
        if records.motor(line, j).axis == i:
            force += motor_force_N(line, j, x, slides)
    return force


@inlined
def is_apart(line: LineArrays, i: int) -> bool:
    """True if the motor of axis i moves within its gear play."""
    return records.axis(line, i).backlash.gap_rad > 0.0 and records.mode(line, i).contact == 0.0


@inlined
def is_at_stop(line: LineArrays, i: int) -> bool:
    """True if axis i is a carriage at one of its stops."""
    return carriages.is_carriage(line, i) and records.mode(line, i).contact != 0.0


@inlined
def per_kg(line: LineArrays, i: int, y: int) -> float:
    """Inverse mass of roller and motor i as one, of a reel with the web on it."""
    axis = records.axis(line, i)
    if axis.reel_slope_per_m != 0.0:
        return 1.0 / (reels.mass_kg(axis, line.w[y + i]) * (1.0 + axis.inertia_mismatch.relative_change))
    return records.part(line, i).per_kg


@inlined
def sticks(line: LineArrays, i: int) -> bool:
    """True if dry friction holds roller i."""
    return records.mode(line, i).direction == 0.0 and laws.is_dry(records.axis(line, i))


@inlined
def acceleration_m_s2(
    line: LineArrays, i: int, v: float, per_kg: float, force_N: float, web_N: float, load_N: float, slides: bool
) -> float:
    """Acceleration, m/s², of a roller that does not stick, at speed `v` (m/s).

    `per_kg`: 1/mass of all that turns with it; `force_N`: motors and smooth resistance on that, `web_N`: force of the
    web, `load_N`: force of its own motor through the gear. `slides` as in `_go_axis`.
    """
    axis, mode = records.axis(line, i), records.mode(line, i)
    if slides:
        if laws.breakaway_N(axis) != 0.0:
            force_N -= mode.direction * laws.dry_friction_N(axis, v)
    elif laws.is_dry(axis):
        friction = laws.dry_friction_N(axis, v) + laws.load_friction_N(axis, load_N)
        force_N -= mode.direction * friction
    return (force_N + web_N) * per_kg


@inlined
def _go(line: LineArrays, j: int, rate: float, weight: float, ahead: float) -> None:
    """Advance quantity j: its rate into the step's weighted sum, and the next stage, `ahead` s from now."""
    w, stage = line.w, records.block(line, lay.STAGE)
    w[2 * stage + j] += weight * rate
    w[stage + j] = w[j] + ahead * rate


@inlined
def _go_axis(
    line: LineArrays, i: int, strain_prev: float, weight: float, ahead: float, slides: bool, held: bool
) -> None:
    """Rates of axis i in the stage block: roller and motor as one, or apart within the gear play, or by a twisting
    shaft; it may stick, a carriage be at a stop, and a roller without 1/mass keeps its speed.

    `weight`, `ahead` (s): of this stage of the Runge-Kutta step. `slides`: compile-time constant, true if no gear has
    play, no roller sticks and no rare force acts, which saves the checks; `held`: one, true if every roller keeps its
    speed.
    """
    n, y, part, axis = line.n, records.block(line, lay.STAGE), records.part(line, i), records.axis(line, i)
    v = line.w[y + n + i]
    of_mass = part.per_kg if slides or held else per_kg(line, i, y)
    if held or of_mass == 0.0:
        _go(line, i, v, weight, ahead)
        _go(line, 2 * n + i, v, weight, ahead)
        return
    twists = not slides and axis.resonance.inertia_share != 0.0
    drive = motor_force_N(line, i, line.w[y + (i if twists else 2 * n + i)], slides)
    own, pull = own_force_N(line, i, y, slides), web_force_N(line, i, y, strain_prev, slides)
    apart = not slides and is_apart(line, i)
    if apart:
        of_mass = part.per_roller_kg
    if not slides and (sticks(line, i) or is_at_stop(line, i)):
        acceleration = 0.0
    else:
        force, load = own if apart else own + drive, 0.0 if apart else drive
        acceleration = acceleration_m_s2(line, i, v, of_mass, force, pull, load, slides)
    other = drive * part.per_motor_kg if apart else acceleration
    if twists:
        other = acceleration_behind_m_s2(line, i, y)
    other_speed = line.w[y + 3 * n + i] if apart or twists else v
    _go(line, i, v, weight, ahead)
    _go(line, n + i, acceleration, weight, ahead)
    _go(line, 2 * n + i, other_speed, weight, ahead)
    _go(line, 3 * n + i, other, weight, ahead)


@merged
def _stage(line: LineArrays, t: float, weight: float, ahead: float, slides: bool, held: bool) -> None:
    """Rates at time t for stage block and torques, and the next stage `ahead` (s) from now.

    `weight` of these rates in the step's sum; `slides`, `held` as in `_go_axis`.
    """
    n, k, entering = line.n, line.k, strain_prev(line, t)
    web(line, t, entering, records.block(line, lay.STAGE), slides)
    for i in range(n):
        _go_axis(line, i, entering, weight, ahead, slides, held)
    for j in range(k):
        part = records.part(line, j)
        _go(line, 4 * n + j, part.rate_m_s, weight, ahead)
        _go(line, 4 * n + k + j, part.length_rate_m_s, weight, ahead)


@inlined
def torques_now(line: LineArrays) -> None:
    """Update the torques to those of the drives."""
    for j in range(line.m):
        records.part(line, j).torque_Nm = records.drive(line, j).torque_Nm


@compiled
def set_decays(line: LineArrays, h: float) -> None:
    """Decays of the current loops for steps of length h."""
    noinline()
    for j in range(line.m):
        part = records.part(line, j)
        part.decay_half = loops.current_decay(0.5 * h, part.current_s)
        part.decay_full = loops.current_decay(h, part.current_s)
    records.call(line).decay_step_s = h


@merged
def integrate(line: LineArrays, t: float, h: float, slides: bool, held: bool) -> None:
    """Classical Runge-Kutta step: quantities at its end in the stage block, torques there; none accepted yet.

    So a step with an event in it can be repeated, shorter. `slides`, `held` as in `_go_axis`; held rollers have no
    torques.
    """
    w, size, motors = line.w, records.block(line, lay.STAGE), 0 if held else line.m
    if not held and records.call(line).decay_step_s != h:
        set_decays(line, h)
    for j in range(size):
        w[size + j] = w[j]
        w[2 * size + j] = 0.0
    if not held:
        torques_now(line)
    _stage(line, t, 1.0, 0.5 * h, slides, held)
    for j in range(motors):
        drive, part = records.drive(line, j), records.part(line, j)
        part.torque_Nm = loops.torque_after(drive.torque_Nm, drive.command_Nm, part.decay_half)
    _stage(line, t + 0.5 * h, 2.0, 0.5 * h, slides, held)
    _stage(line, t + 0.5 * h, 2.0, h, slides, held)
    for j in range(motors):
        drive, part = records.drive(line, j), records.part(line, j)
        part.torque_Nm = loops.torque_after(drive.torque_Nm, drive.command_Nm, part.decay_full)
    _stage(line, t + h, 1.0, h, slides, held)
    for j in range(size):
        w[size + j] = w[j] + h / 6.0 * w[2 * size + j]


@compiled
def integrate_usual(line: LineArrays, t: float, h: float) -> None:
    """`integrate` for any line in the usual mode that has no roller that sticks."""
    noinline()
    integrate(line, t, h, True, False)


@compiled
def integrate_any(line: LineArrays, t: float, h: float) -> None:
    """`integrate` for any line in any mode."""
    noinline()
    integrate(line, t, h, False, False)


@inlined
def accept(line: LineArrays) -> None:
    """Accept the end of the step."""
    size = records.block(line, lay.STAGE)
    for j in range(size):
        line.w[j] = line.w[size + j]
    for j in range(line.m):
        records.drive(line, j).torque_Nm = records.part(line, j).torque_Nm
