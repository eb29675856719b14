"""Events of a line, compiled: rollers and carriages that stop and slide, flanks of gear play, stops of carriages.

Each is located in time; then the roller sticks or slides, the gear touches or not, the carriage is held. Nothing is
smoothed, nothing chatters. Arguments as in `hilbench.plant.web_line.kernel`.
"""

from __future__ import annotations

from hilbench.compiled import compiled, inlined, noinline
from hilbench.plant.web_line import carriages, laws, motion, records
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.records import LineArrays

#: Most events within one integration step; then the rest of it is integrated without event location.
_MOST_EVENTS = 16
_EVENT_ITERATIONS = 40
#: Tolerance of a violation: in mm/s, N, µm.
_EVENT_TOLERANCE = 1e-9
#: Of a difference of two positions, per position: four units in the last place.
_POSITION_ROUNDING = 1e-15


@inlined
def still_slides(line: LineArrays) -> bool:
    """True if at the step's end all parts with dry friction move in their direction, and no carriage is at a stop."""
    end = records.block(line, lay.STAGE)
    for i in range(line.n):
        axis, v = records.axis(line, i), line.w[end + line.n + i]
        reversal = -v * records.mode(line, i).direction * 1e3  # speed beyond standstill, mm/s
        if reversal > _EVENT_TOLERANCE and laws.is_dry(axis):
            return False
        if carriages.is_carriage(line, i) and carriages.beyond_m(axis, line.w[end + i]) > 0.0:
            return False
    return True


@compiled
def _violations(line: LineArrays, t: float, i: int, y: int) -> tuple[float, float, float]:
    """Violation of axis i's mode by the quantities at `y` with their tensions and torques: gear, friction; and its
    force.

    Gear: a flank passed (µm), or a flank that would have to pull (N); a carriage's stops likewise. Friction: a speed
    against its direction (mm/s), or a force too great for it to stick (N). In these units one tolerance does for all,
    as the search needs one number.
    """
    w, n, axis, mode = line.w, line.n, records.axis(line, i), records.mode(line, i)
    x, v, gear, friction = w[y + i], w[y + n + i], -1.0, -1.0
    drive = motion.motor_force_N(line, i, w[y + motion.shaft_of_motor(line, i)], False)
    web = motion.web_force_N(line, i, y, motion.strain_prev(line, t), False)
    apart, sticks = motion.is_apart(line, i), motion.sticks(line, i)
    own = motion.own_force_N(line, i, y, False) + (0.0 if apart else drive)
    if apart:
        # Positions grow: separating flanks must not count as passed because of the rounding of their distance.
        half_gap_m = 0.5 * axis.backlash.gap_rad / records.motor(line, i).rad_per_m
        gear = (abs(w[y + 2 * n + i] - x) - half_gap_m - _POSITION_ROUNDING * abs(x)) * 1e6
    elif axis.backlash.gap_rad > 0.0:
        per_kg = records.part(line, i).per_kg
        acceleration = 0.0 if sticks else motion.acceleration_m_s2(line, i, v, per_kg, own, web, drive, False)
        motor_kg = axis.motor_mass_kg * (1.0 + axis.inertia_mismatch.relative_change)
        gear = (motor_kg * acceleration - drive) * mode.contact
    net = own + web
    if carriages.is_carriage(line, i):
        gear = (carriages.beyond_m(axis, x) - _POSITION_ROUNDING * abs(x)) * 1e6
    if motion.is_at_stop(line, i):
        gear = -mode.contact * net - laws.breakaway_N(axis)
    elif laws.is_dry(axis):
        breakaway = laws.breakaway_N(axis) + laws.load_friction_N(axis, 0.0 if apart else drive)
        friction = abs(net) - breakaway if sticks else -v * mode.direction * 1e3
    return gear, friction, net


@compiled
def web_at(line: LineArrays, t: float, y: int) -> None:
    """Tensions for the quantities at `y`."""
    motion.web(line, t, motion.strain_prev(line, t), y, False)


@compiled
def _settle_one(line: LineArrays, t: float) -> bool:
    """Change the mode of the first axis that has left it, if there is one."""
    web_at(line, t, 0)
    w, n = line.w, line.n
    for i in range(n):
        axis, mode = records.axis(line, i), records.mode(line, i)
        gear, friction, net = _violations(line, t, i, 0)
        if gear > _EVENT_TOLERANCE:
            if carriages.is_carriage(line, i):
                _meet_or_leave_stop(line, i)
            elif mode.contact != 0.0:
                mode.contact = 0.0
            else:  # plastic impact of the gear's flanks, momentum kept
                motor_kg, roller_kg = axis.motor_mass_kg, axis.roller_mass_kg
                v = (motor_kg * w[3 * n + i] + roller_kg * w[n + i]) / (motor_kg + roller_kg)
                mode.contact = 1.0 if w[2 * n + i] > w[i] else -1.0
                w[2 * n + i] = w[i] + mode.contact * 0.5 * axis.backlash.gap_rad / records.motor(line, i).rad_per_m
                w[n + i] = w[3 * n + i] = v
                if v != 0.0:
                    mode.direction = 1.0 if v > 0.0 else -1.0
            return True
        if friction > _EVENT_TOLERANCE:
            if mode.direction == 0.0:
                mode.direction = 1.0 if net > 0.0 else -1.0
            else:
                mode.direction = w[n + i] = 0.0
                if not (motion.is_apart(line, i) or axis.resonance.inertia_share != 0.0):
                    w[3 * n + i] = 0.0
            return True
    return False


@compiled
def _meet_or_leave_stop(line: LineArrays, i: int) -> None:
    """Stop a carriage at its stop, without a rebound; or release it from there."""
    axis, mode, w, n = records.axis(line, i), records.mode(line, i), line.w, line.n
    if mode.contact != 0.0:
        mode.direction, mode.contact = -mode.contact, 0.0
        return
    above = w[i] - axis.upper_stop_m > axis.lower_stop_m - w[i]
    mode.contact = 1.0 if above else -1.0
    w[i] = w[2 * n + i] = axis.upper_stop_m if above else axis.lower_stop_m
    w[n + i] = w[3 * n + i] = 0.0


@compiled
def _try(line: LineArrays, t: float, h: float) -> float:
    """Integrate one step of length h; returns the greatest violation of any axis at its end."""
    motion.integrate_any(line, t, h)
    end, worst = records.block(line, lay.STAGE), -1.0
    web_at(line, t + h, end)
    for i in range(line.n):
        gear, friction, _ = _violations(line, t + h, i, end)
        worst = max(worst, gear, friction)
    return worst


@compiled
def _until_event(line: LineArrays, t: float, h: float, search: bool) -> float:
    """Integrate a step of length h or, if there is an event in it and `search`, up to it; returns its length, s.

    The event's time is found by the Illinois form of regula falsi: the violation is nearly linear in the time within a
    step, and halving the value at the end that stays keeps the bracket from shrinking from one side only. Each trial
    starts from the same quantities, so that the accepted step is a whole Runge-Kutta step.
    """
    low, high, within, beyond, last = 0.0, h, -_EVENT_TOLERANCE, 0.0, 0  # no violation at the start of the step
    cut, found = h, not search
    for iteration in range(_EVENT_ITERATIONS):
        violation = _try(line, t, cut)
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
def step_with_events(line: LineArrays, t: float, h: float) -> None:
    """Integrate one step, cut at every event; after too many of them the rest without event location."""
    noinline()
    left = h
    for event in range(_MOST_EVENTS + 1):
        search = event < _MOST_EVENTS
        if search:
            # Until every axis fits its mode (a roller that stops may stick at once, or slide back); one at a time, as a
            # change of one axis's mode may change the forces on others.
            for i in range(line.n):
                mode, v = records.mode(line, i), line.w[line.n + i]
                if mode.direction == 0.0 and v != 0.0:
                    mode.direction = 1.0 if v > 0.0 else -1.0
            motion.torques_now(line)
            for _ in range(2 * _MOST_EVENTS):
                if not _settle_one(line, t):
                    break
        done = _until_event(line, t, left, search)
        motion.accept(line)
        t += done
        left -= done
        if left <= 1e-12 * h:
            return
