"""Filter inputs from measured position and torque of a shaft (momentum balance), cycle by cycle."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, inf, isnan, nan, sin, sqrt
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    FLAG,
    MATRIX,
    REAL,
    TABLE,
    VECTOR,
    Reals,
    Reals2,
    arrays_in,
    compiled,
    entry_point,
    table_of,
)
from hilbench.estimation import noise_level
from hilbench.estimation.assumptions import CERTAIN, TORQUE_FLOOR_NM
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.servo_axis import kalman
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look
from hilbench.plant.servo_axis.tracking_filter import ORDER, TrackingFilter, gains, transition
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


_STATE: Final = np.dtype(
    [
        ("followed", "f8"),  # cycles of followed motion; -1: none
        ("missing", "f8"),  # cycles without a sample since the last one
        ("odd", "f8"),  # samples in a row with an unexpected number of cycles since the previous one
        ("sticking", "f8"),  # 1: dry friction may be anything
        ("before_Nm", "f8"),  # torque of the last sample; NaN: none
        ("lost", "f8"),  # true if the inertia filters have lost the motion
        ("cycle_s", "f8"),
        ("noise_gain", "f8"),  # noise of the filter's acceleration by that of the position
        ("gear_ratio", "f8"),
        ("breakaway_Nm", "f8"),
        ("unforeseen_rad_s2", "f8"),  # recently unpredicted acceleration,
        ("unforeseen_gain", "f8"),  # and its gain from a position error
        ("slow", "f8"),  # cycles at low speed
    ]
)


class InputArrays(NamedTuple):
    """Arrays of `FilterInputs`, for compiled callers."""

    p: Reals  #: parameters of the shaft
    s: Annotated[Any, _STATE]
    u: Annotated[Any, kalman.INPUTS]
    torque: Reals  #: state of the noise level of the torque,
    position: Reals  #: and of the position
    motion: Reals  #: of the filter for the shaft's speed and acceleration
    forward: Reals2  #: (4, 4): `transition` over a cycle
    gain: Reals  #: (4,): `gains` of a cycle
    back: Reals2  #: (4, 4): `transition` over half a cycle, back


@compiled
def _known_torque_Nm(p: Array, measured_Nm: float, x: float, v: float) -> float:
    """Torque on the shaft by the model: from the reported one, without offset, friction and unbalance."""
    line, direction = records.of_parameters(p), measured_direction(v, _STANDSTILL_RAD_S)
    axis, motor = records.axis(line, 0), records.motor(line, 0)
    torque_Nm = laws.shaft_torque_Nm(motor, laws.true_torque_Nm(motor, measured_Nm), x)
    resistance = laws.measured_resistance_N(axis, x, v, direction)
    return float(laws.passed_on_N(axis, torque_Nm, direction) - resistance)


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
def _take_quality(
    v: InputArrays, position_rad: float, torque_Nm: float, off_rad: float, duration_s: float, next_cycle: bool
) -> None:
    """Update noise levels and the unpredicted acceleration from the position error `off_rad` of a sample `duration_s`
    after the previous one; `next_cycle`: that was in the previous cycle."""
    s = v.s
    if next_cycle:
        noise_level.take(v.torque, torque_Nm)
    else:
        noise_level.interrupt(v.position)
    # An encoder at rest shows no noise, whatever its resolution, and little at a constant speed, where the same part of
    # an increment may remain again and again: each later innovation would weigh too much.
    if _excites(v, v.motion[_ACCELERATION]):
        noise_level.take(v.position, position_rad)
    else:
        noise_level.interrupt(v.position)
    s.unforeseen_rad_s2 *= exp(-duration_s / _FORESEEN_AGAIN_S)
    unforeseen = s.unforeseen_gain * abs(off_rad)
    noisy = abs(off_rad) <= CERTAIN * sqrt(noise_level.variance(v.position))
    if not noisy and unforeseen > _FORESEEN * abs(v.motion[_ACCELERATION]):
        s.unforeseen_rad_s2 = max(s.unforeseen_rad_s2, unforeseen)


@compiled
def _fill(
    v: InputArrays,
    back: Array,
    before_Nm: float,
    position_rad: float,
    torque_Nm: float,
    ripple_Nm: float,
    duration_s: float,
    next_cycle: bool,
) -> None:
    """Fill the filters' inputs; `back` (4, 4): `transition` back over half of the duration; `before_Nm`: previous
    torque."""
    s, u, variance = v.s, v.u, noise_level.variance(v.position)
    x, speed, a = later(v.motion, back, 0), later(v.motion, back, 1), later(v.motion, back, 2)
    significant = abs(a) > CERTAIN * s.noise_gain * sqrt(variance)
    direction = min(max(speed / _STANDSTILL_RAD_S, -1.0), 1.0)
    s.sticking = max(s.sticking * exp(-duration_s / _AFTER_STANDSTILL_S), 1.0 - direction * direction)
    slow = max(1.0 - (speed / _LOW_SPEED_RAD_S) ** 2, 0.0)
    s.slow = s.slow + 1.0 if slow > 0.0 else 0.0
    phi = x / s.gear_ratio
    torque, between_Nm = 0.5 * (before_Nm + torque_Nm), 0.0
    if next_cycle:
        torque += ripple_Nm
    else:  # the torque in between is unknown but for its end values
        between_Nm = abs(torque_Nm - before_Nm) + abs(ripple_Nm)
    shaking_Nm = _SHAKING * u.inertia_kg_m2 * a
    unforeseen_Nm = u.inertia_kg_m2 * s.unforeseen_rad_s2
    u.duration_s = duration_s
    u.torque_Nm = _known_torque_Nm(v.p, torque, x, speed)
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


@compiled
def take_next(v: InputArrays, position_rad: float, torque_Nm: float, ripple_Nm: float) -> bool:
    """`FilterInputs.update` of a sample that is the next of a motion that is well known, one cycle after the last;
    False, and nothing done, where it is not."""
    s = v.s
    if s.lost != 0.0 or s.followed < _SETTLED_CYCLES or s.missing != 0.0 or isnan(s.before_Nm):
        return False
    # Not <=: NaN has to fail.
    off_rad = position_rad - later(v.motion, v.forward, 0)
    if not abs(off_rad) <= _slack_rad(v.position, 1):
        return False
    before_Nm, s.before_Nm, s.odd = s.before_Nm, torque_Nm, 0.0
    _take_quality(v, position_rad, torque_Nm, off_rad, s.cycle_s, True)
    s.followed += 1.0
    follow(v.motion, v.forward, v.gain, position_rad)
    _fill(v, v.back, before_Nm, position_rad, torque_Nm, ripple_Nm, s.cycle_s, True)
    return True


@entry_point(TABLE, REAL, REAL, REAL, REAL, FLAG)
def _take_quality_of(
    table: Places, position_rad: float, torque_Nm: float, off_rad: float, duration_s: float, next_cycle: bool
) -> None:
    _take_quality(arrays_in(table, InputArrays), position_rad, torque_Nm, off_rad, duration_s, next_cycle)


@entry_point(TABLE, MATRIX, REAL, REAL, REAL, REAL, REAL, FLAG)
def _fill_from(
    table: Places,
    back: Array,
    before_Nm: float,
    position_rad: float,
    torque_Nm: float,
    ripple_Nm: float,
    duration_s: float,
    next_cycle: bool,
) -> None:
    _fill(arrays_in(table, InputArrays), back, before_Nm, position_rad, torque_Nm, ripple_Nm, duration_s, next_cycle)


@entry_point(VECTOR, COUNT)
def _slack(position: Array, cycles: int) -> float:
    return _slack_rad(position, cycles)


class FilterInputs:
    """Inputs of `kalman.step` from samples: means over the cycle, and their noise."""

    def __init__(self, model: ServoAxisParameters, config: InertiaConfig) -> None:
        also = config.also
        self._p = lay.pack(model)
        factor, breakaway_Nm, _ = look(self._p, 0.0)
        state, inputs = np.zeros(1, _STATE), np.zeros(1, kalman.INPUTS)
        self._state, self.u = state[0], inputs[0]
        self._state["breakaway_Nm"] = breakaway_Nm + also.coulomb_friction_Nm
        self._state["gear_ratio"] = model.shaft.gear_ratio
        self.inertia_kg_m2 = model.inertia_kg_m2 * factor  #: J0
        self.priors = np.array(
            [
                also.torque_offset_Nm,
                also.viscous_friction_Nm_s_per_rad,
                also.coulomb_friction_Nm,
                also.unbalance_Nm,
                also.unbalance_Nm,
            ]
        )
        self.u["inertia_kg_m2"] = self.inertia_kg_m2
        self.u["parameter_variance_per_s"] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self.u["parameter_bound"] = (0.01 * config.jump_pct) ** 2
        # Without an end an accepted drift goes on through all holds, and grows with all that is not white noise.
        self.u["drift_s"] = config.jump_pct / config.drift_pct_per_s
        self.u["memories_s"] = config.offset_memory_s, *[config.friction_memory_s] * (kalman.TERMS - 1)
        self.u["priors"] = self.priors
        self._torque = NoiseLevel(config.torque_noise_Nm, TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD)
        self._motion = TrackingFilter(0.0)
        self._forward, self._back, self._gain = np.zeros((ORDER, ORDER)), np.zeros((ORDER, ORDER)), np.zeros(ORDER)
        self.in_doubt = False  #: True if the last sample may be of another time than assumed
        largest_Nm = per_item(model.drives.torque_limit_Nm, 1) if model.drives else inf
        self._largest_change_rad_s2 = _TORQUE_CHANGE * largest_Nm / self.inertia_kg_m2
        self._state["followed"] = -1.0
        self._state["before_Nm"] = nan
        self._state["lost"] = 1.0
        self._of_cycle = state, inputs
        self._gather()

    def _gather(self) -> None:
        """Collect the current arrays and the table of their addresses."""
        noise = self._torque.state, self._position.state
        of_a_cycle = self._forward, self._gain, self._back
        self.arrays = InputArrays(self._p, *self._of_cycle, *noise, self._motion.motion, *of_a_cycle)
        self._table = table_of(self.arrays)

    @property
    def speed_rad_s(self) -> float:
        """Speed of the last cycle."""
        return float(self.u["regressors"][1])

    @property
    def duration_s(self) -> float:
        """Time from the previous sample to the last."""
        return float(self.u["duration_s"])

    @property
    def lost(self) -> bool:
        """True while the motion is being initialized anew."""
        return float(self._state["followed"]) < _SETTLED_CYCLES

    def interrupt(self) -> None:
        """Form no mean across the next gap; initialize the motion anew."""
        s = self._state
        s["before_Nm"], s["followed"], s["missing"], s["odd"] = nan, -1.0, 0.0, 0.0
        self._position.interrupt()

    def miss(self) -> None:
        """Count a missing cycle; too many of them are an interruption."""
        self._state["missing"] += 1.0
        if self._state["missing"] > _LONGEST_GAP_CYCLES:
            self.interrupt()

    def update(self, sample: ShaftSample) -> bool:
        """Fill `u`; False for a sample without new information, and for the first of a row, whose motion is unknown."""
        cycles, s = self._cycles_elapsed(sample), self._state
        if cycles == 0:
            return False
        duration_s, s["missing"] = cycles * sample.cycle_s, 0.0
        before_Nm, s["before_Nm"] = float(s["before_Nm"]), sample.torque_Nm
        measured = sample.position_rad, sample.torque_Nm
        off_rad = sample.position_rad - self._motion.predicted(duration_s).item(0) if s["followed"] >= 1.0 else 0.0
        _take_quality_of(self._table, *measured, off_rad, duration_s, cycles == 1)
        self._follow(sample.position_rad, sample.cycle_s, duration_s)
        if isnan(before_Nm) or self.lost:
            return False
        back = transition(-0.5 * duration_s)
        _fill_from(self._table, back, before_Nm, *measured, sample.ripple_Nm, duration_s, cycles == 1)
        return True

    def _find_anew(self, position_rad: float, cycle_s: float) -> None:
        """Initialize the motion here."""
        s = self._state
        if s["cycle_s"] != cycle_s:
            filter_s = _FILTER_CYCLES * cycle_s
            self._motion = TrackingFilter(filter_s)
            self._forward[:], self._back[:] = transition(cycle_s), transition(-0.5 * cycle_s)
            self._gain[:] = gains(cycle_s, filter_s)
            s["cycle_s"], s["noise_gain"] = cycle_s, _acceleration_gain(cycle_s, filter_s)
            s["unforeseen_gain"] = 4.0 / filter_s**2
            self._gather()
        self._motion.reset(position_rad)
        s["followed"] = 0.0

    def _cycles_elapsed(self, sample: ShaftSample) -> int:
        """Cycles since the previous sample, by the motion; no frame shows a SYNC that was lost or sent late.

        0 for a position of the same instant. Where no number fits, or a different one again and again, the motion is
        lost. With a shaft that hardly turns, a position of another time is not separable from one after a jolt:
        `in_doubt`.
        """
        s = self._state
        expected, self.in_doubt = 1 + int(float(s["missing"])), False
        if s["followed"] < 1.0:
            return expected
        if self._off_rad(sample, expected) <= _slack(self._position.state, expected):
            s["odd"] = 0.0
            return expected
        found, travel_per_cycle = expected, abs(self._motion.motion.item(1)) * sample.cycle_s
        is_telling = travel_per_cycle > 2.0 * self._accelerated_rad(sample, 1)
        if is_telling:
            found = min(range(expected + _MORE_CYCLES + 1), key=lambda n: self._off_rad(sample, n))
        off_rad = self._off_rad(sample, found)
        s["odd"] = s["odd"] + 1.0 if found != expected else 0.0
        between = is_telling and off_rad > _BETWEEN * travel_per_cycle
        if between or off_rad > self._accelerated_rad(sample, found) or s["odd"] > _MOST_ODD:
            self.interrupt()
            return 1
        self.in_doubt = not is_telling
        return found

    def _accelerated_rad(self, sample: ShaftSample, cycles: int) -> float:
        """Largest position error after so many cycles by a change of the shaft's acceleration."""
        travel_rad = 0.5 * self._largest_change_rad_s2 * (cycles * sample.cycle_s) ** 2
        return travel_rad + _slack(self._position.state, cycles)

    def _off_rad(self, sample: ShaftSample, cycles: int) -> float:
        return abs(sample.position_rad - self._motion.predicted(cycles * sample.cycle_s).item(0))

    def _follow(self, position_rad: float, cycle_s: float, duration_s: float) -> None:
        """Update position, speed and acceleration by a sample, `duration_s` after the previous one."""
        s = self._state
        if s["followed"] < 0.0:
            self._find_anew(position_rad, cycle_s)
            return
        s["followed"] += 1.0
        if s["followed"] == 1.0:  # two positions are a speed
            speed = (position_rad - self._motion.motion.item(0)) / duration_s
            self._motion.reset(position_rad, speed)
        else:
            self._motion.update(position_rad, duration_s)


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
