"""Filter inputs from measured position and torque of a shaft (momentum balance), cycle by cycle."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, inf, isnan, nan, sin, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import Reals, Reals2, Reals3, Record, compiled, inlined, record_type
from hilbench.estimation import noise_level
from hilbench.estimation.assumptions import CERTAIN, TORQUE_FLOOR_NM
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.servo_axis import kalman
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look
from hilbench.plant.servo_axis.tracking_filter import ORDER, gains, transition
from hilbench.plant.web_line import laws, records
from hilbench.plant.web_line.shaft_load import follow, later

#: Encoder noise assumed until it is measured, and its least value.
_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD = 3e-6, 1e-7
#: Time constant of the filter for the shaft's speed and acceleration, in cycles.
_FILTER_CYCLES = 5.0
#: Cycles until its initial guess of the speed has faded.
_SETTLED_CYCLES = 75
#: Torque that accelerates the model's inertia, in deviations of the torque's noise, below which the motion is quiet:
#: visible rests of ripple and unbalance are acceleration as well, and would be taken for inertia.
_EXCITED = 2.0
#: Speed below which the shaft may stick, and dry friction is anything up to its greatest.
_STANDSTILL_RAD_S = 0.2
#: Speed below which dry friction may differ from that above (Stribeck), by as much as its greatest.
_LOW_SPEED_RAD_S = 2.0
#: Decay time of sticking when it turns again: a load motor that emulates friction turns it late, and the jump of the
#: acceleration then passes the filter of the emulated inertia.
_AFTER_STANDSTILL_S = 0.02
#: Share of the accelerating torque that counts as noise: emulation follows it only so well.
_SHAKING = 0.01
#: Decay time of an unpredicted acceleration: till then the filter's lags the motion, and so does the load motor's
#: emulation. Torque in phase with it is noise; it would make the shaft seem heavier.
_FORESEEN_AGAIN_S = 0.02
#: Share of the acceleration up to which it counts as predicted.
_FORESEEN = 0.05
#: Share of the motor's torque limit by which the shaft's torque, load motor included, may change. A position further
#: off than this accelerates it is not one cycle after the last.
_TORQUE_CHANGE = 2.0
#: Normal change of the position's course in a cycle, the encoder's noise in deviations, and the coarsest accepted
#: encoder (12 bits).
_POSITION_SLACK_RAD, _NOISE_SLACK, _COARSEST_RAD = 1e-4, 6.0, 3e-3
#: More cycles than this without a usable sample are not bridged: the motion is initialized anew.
_LONGEST_GAP_CYCLES = 20
#: Share of a cycle by which a sample counts as between two of them.
_BETWEEN = 0.25
#: Further missed cycles considered beyond the known ones, and how many times in a row.
_MORE_CYCLES, _MOST_ODD = 5, 3
#: Times from one sample to the next, in cycles from 0.
_ELAPSED: Final = range(1 + _LONGEST_GAP_CYCLES + _MORE_CYCLES + 1)
#: Index in the filter's motion.
_ACCELERATION = 2


@dataclass(frozen=True, slots=True)
class ShaftSample:
    """Measured sample at one SYNC."""

    cycle_s: float  #: of the bus; the number elapsed since the previous sample is found from the motion
    position_rad: float
    torque_Nm: float  #: of the motor, as the drive reports it
    #: Excess of its mean over the cycle over the mean of both its ends, by the simulated drive: set points come with
    #: SYNC, and the torque ripples with them.
    ripple_Nm: float = 0.0


#: Cycles of followed motion, -1: none; cycles without a sample since the last one; samples in a row with an unexpected
#: number of cycles since the previous one; 1: dry friction may be anything; torque of the last sample, NaN: none;
#: whether the inertia filters have lost the motion, or the last sample may be of another time than assumed. Cycle time;
#: noise of the filter's acceleration by that of the position; gear ratio; dry friction at standstill; recently
#: unpredicted acceleration, its gain from a position error, and its largest change by the motors; cycles at low speed.
_STATE: Final = record_type(
    *("followed", "missing", "odd", "sticking", "before_Nm", "lost", "in_doubt", "cycle_s", "noise_gain", "gear_ratio"),
    *("breakaway_Nm", "unforeseen_rad_s2", "unforeseen_gain", "largest_change_rad_s2", "slow"),
)


class InputArrays(NamedTuple):
    """Arrays of the filters' inputs."""

    p: Reals  #: parameters of the shaft
    s: Annotated[Any, _STATE]
    u: Annotated[Any, kalman.INPUTS]
    torque: Reals  #: state of the noise level of the torque,
    position: Reals  #: and of the position
    motion: Reals  #: of the filter for the shaft's speed and acceleration
    forward: Reals3  #: (n, 4, 4): `transition` over so many cycles
    gain: Reals2  #: (n, 4): `gains` of so many cycles
    back: Reals3  #: (n, 4, 4): `transition` over half of so many cycles, back


@compiled
def _slack_rad(position: Array, cycles: int) -> float:
    """Normal prediction error of a position: by the change of motion, and by the encoder's noise."""
    known = noise_level.is_known(position)
    noise_rad = _NOISE_SLACK * sqrt(noise_level.variance(position)) if known else _COARSEST_RAD
    return float(_POSITION_SLACK_RAD * (cycles * cycles) + min(noise_rad, _COARSEST_RAD))


@compiled
def _excites(v: InputArrays, acceleration_rad_s2: float) -> bool:
    """True if the torque for this acceleration exceeds that of noise, ripple and unbalance."""
    accelerating_Nm = abs(acceleration_rad_s2) * v.u.inertia_kg_m2
    return bool(accelerating_Nm > _EXCITED * sqrt(noise_level.variance(v.torque)))


@compiled
def _take_quality(v: InputArrays, position_rad: float, torque_Nm: float, off_rad: float, cycles: int) -> None:
    """Update noise levels and the unpredicted acceleration from the position error `off_rad` of a sample so many cycles
    after the previous one."""
    s = v.s
    if cycles == 1:
        noise_level.take(v.torque, torque_Nm)
    else:
        noise_level.interrupt(v.position)
    # An encoder at rest shows no noise, whatever its resolution, and little at a constant speed, where the same part of
    # an increment may remain again and again: each later innovation would weigh too much.
    if _excites(v, v.motion[_ACCELERATION]):
        noise_level.take(v.position, position_rad)
    else:
        noise_level.interrupt(v.position)
    s.unforeseen_rad_s2 *= exp(-(cycles * s.cycle_s) / _FORESEEN_AGAIN_S)
    unforeseen = s.unforeseen_gain * abs(off_rad)
    noisy = abs(off_rad) <= CERTAIN * sqrt(noise_level.variance(v.position))
    if not noisy and unforeseen > _FORESEEN * abs(v.motion[_ACCELERATION]):
        s.unforeseen_rad_s2 = max(s.unforeseen_rad_s2, unforeseen)


@compiled
def _fill(
    v: InputArrays, before_Nm: float, position_rad: float, torque_Nm: float, ripple_Nm: float, cycles: int
) -> None:
    """Fill the filters' inputs by a sample so many cycles after the previous one, with its torque."""
    s, u, variance, back, duration_s = v.s, v.u, noise_level.variance(v.position), v.back[cycles], cycles * v.s.cycle_s
    x, speed, a = later(v.motion, back, 0), later(v.motion, back, 1), later(v.motion, back, 2)
    significant = abs(a) > CERTAIN * s.noise_gain * sqrt(variance)
    direction = min(max(speed / _STANDSTILL_RAD_S, -1.0), 1.0)
    s.sticking = max(s.sticking * exp(-duration_s / _AFTER_STANDSTILL_S), 1.0 - direction * direction)
    slow = max(1.0 - (speed / _LOW_SPEED_RAD_S) ** 2, 0.0)
    s.slow = s.slow + 1.0 if slow > 0.0 else 0.0
    phi = x / s.gear_ratio
    torque, between_Nm = 0.5 * (before_Nm + torque_Nm), 0.0
    if cycles == 1:
        torque += ripple_Nm
    else:  # the torque in between is unknown but for its end values
        between_Nm = abs(torque_Nm - before_Nm) + abs(ripple_Nm)
    shaking_Nm = _SHAKING * u.inertia_kg_m2 * a
    unforeseen_Nm = u.inertia_kg_m2 * s.unforeseen_rad_s2
    u.duration_s = duration_s
    # On the shaft by the model: without offset, friction and unbalance.
    line, turns = records.of_parameters(v.p), measured_direction(speed, _STANDSTILL_RAD_S)
    axis, motor = records.axis(line, 0), records.motor(line, 0)
    motor_Nm = laws.shaft_torque_Nm(motor, laws.true_torque_Nm(motor, torque), x)
    u.torque_Nm = laws.passed_on_N(axis, motor_Nm, turns) - laws.measured_resistance_N(axis, x, speed, turns)
    u.acceleration_rad_s2 = a if significant and _excites(v, a) else 0.0
    u.torque_variance = (
        noise_level.variance(v.torque)
        + between_Nm * between_Nm
        + shaking_Nm * shaking_Nm
        + unforeseen_Nm * unforeseen_Nm
        # Friction error is no white noise: the impulse of a constant over n cycles has n² times the variance of one
        # cycle, so that of the last one is 2n times. However long a shaft is at rest, it shows no offset.
        + s.breakaway_Nm * s.breakaway_Nm * (s.sticking + 2.0 * slow * s.slow)
    )
    u.position = position_rad
    u.position_variance = variance
    of = u.regressors
    of[0], of[1], of[2], of[3], of[4] = 1.0, speed, direction, -sin(phi), -cos(phi)


@inlined
def is_lost(s: Record) -> bool:
    """True while the motion is being initialized anew."""
    return bool(s.followed < _SETTLED_CYCLES)


@compiled
def _interrupt(v: InputArrays) -> None:
    """Form no mean across the next gap; initialize the motion anew."""
    s = v.s
    s.before_Nm, s.followed, s.missing, s.odd = nan, -1.0, 0.0, 0.0
    noise_level.interrupt(v.position)


@compiled
def miss(v: InputArrays, usable: bool) -> None:
    """Count a missing cycle; too many of them are an interruption, as is one that is not `usable`."""
    v.s.missing += 1.0
    if not usable or v.s.missing > _LONGEST_GAP_CYCLES:
        _interrupt(v)


@inlined
def _off_rad(v: InputArrays, position_rad: float, cycles: int) -> float:
    return abs(position_rad - later(v.motion, v.forward[cycles], 0))


@compiled
def _accelerated_rad(v: InputArrays, cycles: int) -> float:
    """Largest position error after so many cycles by a change of the shaft's acceleration."""
    duration_s = cycles * v.s.cycle_s
    travel_rad = 0.5 * v.s.largest_change_rad_s2 * (duration_s * duration_s)
    return float(travel_rad + _slack_rad(v.position, cycles))


@compiled
def _cycles_elapsed(v: InputArrays, position_rad: float) -> int:
    """Cycles since the previous sample, by the motion; no frame shows a SYNC that was lost or sent late.

    0 for a position of the same instant. Where no number fits, or a different one again and again, the motion is lost.
    With a shaft that hardly turns, a position of another time is not separable from one after a jolt: `in_doubt`.
    """
    s = v.s
    expected, s.in_doubt = 1 + int(s.missing), 0.0
    if s.followed < 1.0:
        return expected
    if _off_rad(v, position_rad, expected) <= _slack_rad(v.position, expected):
        s.odd = 0.0
        return expected
    found, travel_per_cycle = expected, abs(v.motion[1]) * s.cycle_s
    is_telling = travel_per_cycle > 2.0 * _accelerated_rad(v, 1)
    if is_telling:
        found = 0
        for cycles in range(1, expected + _MORE_CYCLES + 1):
            if _off_rad(v, position_rad, cycles) < _off_rad(v, position_rad, found):
                found = cycles
    off_rad = _off_rad(v, position_rad, found)
    s.odd = s.odd + 1.0 if found != expected else 0.0
    between = is_telling and off_rad > _BETWEEN * travel_per_cycle
    if between or off_rad > _accelerated_rad(v, found) or s.odd > _MOST_ODD:
        _interrupt(v)
        return 1
    s.in_doubt = 0.0 if is_telling else 1.0
    return found


@compiled
def _follow(v: InputArrays, position_rad: float, cycles: int) -> None:
    """Update position, speed and acceleration by a sample so many cycles after the previous one."""
    s, motion = v.s, v.motion
    s.followed += 1.0
    if s.followed > 1.0:
        follow(motion, v.forward[cycles], v.gain[cycles], position_rad)
        return
    speed = (position_rad - motion[0]) / (cycles * s.cycle_s) if s.followed == 1.0 else 0.0  # two positions are a speed
    motion[0], motion[1], motion[2], motion[3] = position_rad, speed, 0.0, 0.0


@compiled
def take(v: InputArrays, position_rad: float, torque_Nm: float, ripple_Nm: float) -> bool:
    """Fill the filters' inputs by a sample: means over the time since the last, and their noise; False for one without
    new information, and for the first of a row, whose motion is unknown."""
    s, cycles = v.s, _cycles_elapsed(v, position_rad)
    if cycles == 0:
        return False
    before_Nm, s.before_Nm, s.missing = s.before_Nm, torque_Nm, 0.0
    off_rad = position_rad - later(v.motion, v.forward[cycles], 0) if s.followed >= 1.0 else 0.0
    _take_quality(v, position_rad, torque_Nm, off_rad, cycles)
    _follow(v, position_rad, cycles)
    if isnan(before_Nm) or is_lost(s):
        return False
    _fill(v, before_Nm, position_rad, torque_Nm, ripple_Nm, cycles)
    return True


def new_inputs(model: ServoAxisParameters, config: InertiaConfig) -> InputArrays:
    """Inputs of `kalman.step`; their cycle time is to be set."""
    also, p = config.also, lay.pack(model)
    factor, breakaway_Nm, _ = look(p, 0.0)
    inertia_kg_m2 = model.inertia_kg_m2 * factor
    friction = also.viscous_friction_Nm_s_per_rad, also.coulomb_friction_Nm
    state, u = np.zeros(1, _STATE), np.zeros(1, kalman.INPUTS)
    state["breakaway_Nm"] = breakaway_Nm + also.coulomb_friction_Nm
    state["gear_ratio"] = model.shaft.gear_ratio
    largest_Nm = per_item(model.drives.torque_limit_Nm, 1) if model.drives else inf
    state["largest_change_rad_s2"] = _TORQUE_CHANGE * largest_Nm / inertia_kg_m2
    state["followed"], state["before_Nm"], state["lost"] = -1.0, nan, 1.0
    u["inertia_kg_m2"] = inertia_kg_m2
    u["parameter_variance_per_s"] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
    u["parameter_bound"] = (0.01 * config.jump_pct) ** 2
    # Without an end an accepted drift goes on through all holds, and grows with all that is not white noise.
    u["drift_s"] = config.jump_pct / config.drift_pct_per_s
    u["memories_s"] = config.offset_memory_s, *[config.friction_memory_s] * (kalman.TERMS - 1)
    u["priors"] = also.torque_offset_Nm, *friction, also.unbalance_Nm, also.unbalance_Nm
    noise = NoiseLevel(config.torque_noise_Nm, TORQUE_FLOOR_NM), NoiseLevel(_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD)
    square, count = (ORDER, ORDER), len(_ELAPSED)
    times = np.zeros((count, *square)), np.zeros((count, ORDER)), np.zeros((count, *square))
    return InputArrays(p, state, u, noise[0].state, noise[1].state, np.zeros(ORDER), *times)


def set_cycle_time(v: InputArrays, cycle_s: float) -> None:
    """Set the cycle time."""
    filter_s, s = _FILTER_CYCLES * cycle_s, v.s[0]
    for cycles in _ELAPSED:
        v.forward[cycles], v.back[cycles] = transition(cycles * cycle_s), transition(-0.5 * (cycles * cycle_s))
        v.gain[cycles] = gains(cycles * cycle_s, filter_s) if cycles else 0.0
    s["cycle_s"], s["noise_gain"] = cycle_s, _acceleration_gain(cycle_s, filter_s)
    s["unforeseen_gain"] = 4.0 / filter_s**2


def _acceleration_gain(cycle_s: float, filter_s: float) -> float:
    """Deviation of the filter's acceleration per deviation of white noise of the position, 1/s²."""
    gain, forward = gains(cycle_s, filter_s), transition(cycle_s)
    memory = forward - np.outer(gain, forward[0])
    # In units in which all four are of one size, for the solver.
    unit = cycle_s ** -np.arange(4.0)
    from scipy.linalg import (
        solve_discrete_lyapunov,  # not with the module: the processes of a bench start without scipy
    )

    scaled = memory * unit[None, :] / unit[:, None]
    noise = gain / unit
    covariance = solve_discrete_lyapunov(scaled, np.outer(noise, noise))
    return float(np.sqrt(covariance[_ACCELERATION, _ACCELERATION]) * unit[_ACCELERATION])
