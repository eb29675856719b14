"""Events of a line, compiled: rollers and carriages that stop and slide, flanks of gear play, stops of carriages.

Each is located in time; then the roller sticks or slides, the gear touches or not, the carriage is held. Nothing is
smoothed, nothing chatters. Arguments as in `hilbench.plant.web_line.kernel`.
"""

from __future__ import annotations

from hilbench.compiled import compiled, inlined, noinline
from hilbench.plant.web_line import carriages, laws, motion, places
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector

#: Most events within one integration step; then the rest of it is integrated without event location.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Tolerance of a violation: in mm/s, N, µm.
_EVENT_TOLERANCE = 1e-9
#: Of a difference of two positions, per position: four units in the last place.
_POSITION_ROUNDING = 1e-15


@inlined
def any_sticks(p: Vector, s: Vector, n: int, k: int) -> bool:
    """True if dry friction holds a roller or carriage, or a stop a carriage."""
    sticks = False
    for i in range(n):
        sticks |= motion.sticks(p, s, n, k, i) or motion.is_at_stop(s, n, k, i)
    return sticks


@inlined
def still_slides(p: Vector, s: Vector, w: Vector, n: int, k: int) -> bool:
    """True if at the step's end all parts with dry friction move in their direction, and no carriage is at a stop."""
    for i in range(n):
        v, direction = w[places.block(n, k, lay.STAGE) + n + i], s[places.axis_state(n, k, i) + lay.SA_DIRECTION]
        if _reversal(v, direction) > _EVENT_TOLERANCE and laws.is_dry(p, places.axis(i)):
            return False
        x = w[places.block(n, k, lay.STAGE) + i]
        if carriages.is_carriage(k, i) and carriages.beyond_m(p, places.axis(i), x) > 0.0:
            return False
    return True


@inlined
def _reversal(v: float, direction: float) -> float:
    """Speed beyond standstill in the opposite direction, mm/s."""
    return -v * direction * 1e3


@compiled
def _violations(p: Vector, s: Vector, u: Vector, w: Vector, t: float, i: int, y: int) -> tuple[float, float, float]:
    """Violation of axis i's mode by the quantities at `y` with their tensions and torques: gear, friction; and its
    force.

    Gear: a flank passed (µm), or a flank that would have to pull (N); a carriage's stops likewise. Friction: a speed
    against its direction (mm/s), or a force too great for it to stick (N). In these units one tolerance does for all,
    as the search needs one number.
    """
    n, m, k = places.counts(p)
    axis, mode = places.axis(i), places.axis_state(n, k, i)
    v, gear, friction = w[y + n + i], -1.0, -1.0
    drive = motion.motor_force_N(p, w, n, m, k, i, w[y + motion.shaft_of_motor(p, n, i)], False)
    web = motion.web_force_N(p, u, w, n, m, k, i, y, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t), False)
    apart, sticks = motion.is_apart(p, s, n, k, i), motion.sticks(p, s, n, k, i)
    own = motion.own_force_N(p, w, n, m, k, i, y, False) + (0.0 if apart else drive)
    if apart:
        # Positions grow: separating flanks must not count as passed because of the rounding of their distance.
        rounding_m = _POSITION_ROUNDING * abs(w[y + i])
        gear = (abs(w[y + 2 * n + i] - w[y + i]) - _half_gap_m(p, n, i) - rounding_m) * 1e6
    elif laws.has_gap(p, axis):
        per_mass = w[places.part(n, m, k, lay.PER_MASS) + i]
        acceleration = 0.0 if sticks else motion.acceleration_m_s2(p, s, n, k, i, v, per_mass, own, web, drive, False)
        motor_mass = p[axis + lay.A_MOTOR_MASS_KG] * laws.inertia_factor(p, axis)
        gear = (motor_mass * acceleration - drive) * s[mode + lay.SA_CONTACT]
    net = own + web
    if carriages.is_carriage(k, i):
        gear = (carriages.beyond_m(p, axis, w[y + i]) - _POSITION_ROUNDING * abs(w[y + i])) * 1e6
    if motion.is_at_stop(s, n, k, i):
        gear = -s[mode + lay.SA_CONTACT] * net - laws.breakaway_N(p, axis)
    elif laws.is_dry(p, axis):
        breakaway = laws.breakaway_N(p, axis) + laws.load_friction_N(p, axis, 0.0 if apart else drive)
        friction = abs(net) - breakaway if sticks else _reversal(v, s[mode + lay.SA_DIRECTION])
    return gear, friction, net


@inlined
def _half_gap_m(p: Vector, n: int, i: int) -> float:
    """Half the gear play of an axis, at the web."""
    return laws.half_gap_m(p, places.axis(i), p[places.motor(n, i) + lay.M_RAD_PER_M])


@compiled
def web_at(p: Vector, s: Vector, u: Vector, w: Vector, t: float, y: int) -> None:
    """Tensions for the quantities at `y`."""
    n, m, k = places.counts(p)
    motion.web(p, s, u, w, n, m, k, t, laws.upstream_strain(p, u[lay.U_STRAIN_PREV], t), y, False)


@compiled
def _settle_one(p: Vector, s: Vector, u: Vector, w: Vector, t: float) -> bool:
    """Change the mode of the first axis that has left it, if there is one."""
    n, _, k = places.counts(p)
    web_at(p, s, u, w, t, 0)
    for i in range(n):
        mode = places.axis_state(n, k, i)
        gear, friction, net = _violations(p, s, u, w, t, i, 0)
        if gear > _EVENT_TOLERANCE and carriages.is_carriage(k, i):
            _meet_or_leave_stop(p, s, w, n, k, i)
            return True
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
    """Stop the roller: it sticks."""
    s[places.axis_state(n, k, i) + lay.SA_DIRECTION] = 0.0
    w[n + i] = 0.0
    if not (motion.is_apart(p, s, n, k, i) or laws.twists(p, places.axis(i))):
        w[3 * n + i] = 0.0


@compiled
def _meet_or_leave_stop(p: Vector, s: Vector, w: Vector, n: int, k: int, i: int) -> None:
    """Stop a carriage at its stop, without a rebound; or release it from there."""
    mode = places.axis_state(n, k, i)
    side = s[mode + lay.SA_CONTACT]
    if side != 0.0:
        s[mode + lay.SA_CONTACT] = 0.0
        s[mode + lay.SA_DIRECTION] = -side
        return
    axis = places.axis(i)
    side = carriages.side_of_stop(p, axis, w[i])
    s[mode + lay.SA_CONTACT] = side
    at = p[axis + lay.A_UPPER_STOP_M] if side > 0.0 else p[axis + lay.A_LOWER_STOP_M]
    w[i] = at
    w[2 * n + i] = at
    w[n + i] = 0.0
    w[3 * n + i] = 0.0


@compiled
def _touch(p: Vector, s: Vector, w: Vector, n: int, k: int, i: int, half_m: float) -> None:
    """Close the gear's flanks: plastic impact, momentum kept."""
    axis, mode = places.axis(i), places.axis_state(n, k, i)
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

    One at a time: a change of one axis's mode may change the forces on others.
    """
    n, m, k = places.counts(p)
    for i in range(n):
        direction = places.axis_state(n, k, i) + lay.SA_DIRECTION
        if s[direction] == 0.0 and w[n + i] != 0.0:
            s[direction] = 1.0 if w[n + i] > 0.0 else -1.0
    motion.torques_now(s, w, n, m, k)
    for _ in range(2 * _MOST_EVENTS):
        if not _settle_one(p, s, u, w, t):
            return


@compiled
def _try(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> float:
    """Integrate one step of length h; returns the greatest violation of any axis at its end."""
    n, _, k = places.counts(p)
    motion.integrate_any(p, s, u, w, t, h)
    end = places.block(n, k, lay.STAGE)
    web_at(p, s, u, w, t + h, end)
    worst = -1.0
    for i in range(n):
        gear, friction, _ = _violations(p, s, u, w, t + h, i, end)
        worst = max(worst, gear, friction)
    return worst


@compiled
def _until_event(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float, search: bool) -> float:
    """Integrate a step of length h or, if there is an event in it and `search`, up to it; returns its length, s.

    The event's time is found by the Illinois form of regula falsi: the violation is nearly linear in the time within a
    step, and halving the value at the end that stays keeps the bracket from shrinking from one side only. Each trial
    starts from the same quantities, so that the accepted step is a whole Runge-Kutta step.
    """
    low, high, within, beyond, last = 0.0, h, -_EVENT_TOLERANCE, 0.0, 0  # no violation at the start of the step
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
        # The end after the event: the new mode starts there, and is not in the old one again.
        cut = high if found else low + (high - low) * min(max(share, 1e-3), 0.999)
    return cut


@compiled
def step_with_events(p: Vector, s: Vector, u: Vector, w: Vector, t: float, h: float) -> None:
    """Integrate one step, cut at every event; after too many of them the rest without event location."""
    noinline()
    n, m, k = places.counts(p)
    left = h
    for event in range(_MOST_EVENTS + 1):
        search = event < _MOST_EVENTS
        if search:
            _settle(p, s, u, w, t)
        done = _until_event(p, s, u, w, t, left, search)
        motion.accept(s, w, n, m, k)
        t += done
        left -= done
        if left <= 1e-12 * h:
            return
