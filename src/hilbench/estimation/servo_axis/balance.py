"""Filter inputs from measured position and torque of a shaft (momentum balance), cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, inf, isnan, nan, sin, sqrt
from typing import NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    FLAG,
    MATRIX,
    REAL,
    TABLE,
    VECTOR,
    compiled,
    entry_point,
    floats,
    merged,
    table_of,
)
from hilbench.estimation import noise_level
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.servo_axis import kalman
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look
from hilbench.plant.servo_axis.tracking_filter import ORDER, TrackingFilter, follow, gains, later, transition
from hilbench.plant.web_line import laws

#: Encoder noise assumed until it is measured, and its least value; least noise of the torque.
_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD = 3e-6, 1e-7
_TORQUE_FLOOR_NM = 1e-4
#: Time constant of the filter for the shaft's speed and acceleration, in cycles.
_FILTER_CYCLES = 5.0
#: Cycles until its initial guess of the speed has faded.
_SETTLED_CYCLES = 75
#: Deviations of its noise beyond which an acceleration is significant.
_SIGNIFICANT = 4.0
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


class InputVectors(NamedTuple):
    """Vectors of `FilterInputs`, for compiled callers."""

    p: Array  #: parameters of the shaft
    s: Array  #: state and figures
    u: Array  #: inputs of the filters
    torque: Array  #: state of the noise level of the torque,
    position: Array  #: and of the position
    motion: Array  #: of the filter for the shaft's speed and acceleration
    forward: Array  #: (4, 4): `transition` over a cycle
    gain: Array  #: (4,): `gains` of a cycle
    back: Array  #: (4, 4): `transition` over half a cycle, back


# State: cycles of followed motion (-1: none); cycles without a sample since the last one; samples in a row with an
# unexpected number of cycles since the previous one; 1: dry friction may be anything; torque of the last sample (NaN:
# none); true if the inertia filters have lost the motion. Figures: cycle time; noise of the filter's acceleration by
# that of the position; gear ratio; breakaway friction; recently unpredicted acceleration, and its gain from a position
# error.
(
    FOLLOWED,
    _MISSING,
    _ODD,
    _STICKING,
    _BEFORE_NM,
    LOST,
    CYCLE_S,
    _NOISE_GAIN,
    _GEAR_RATIO,
    _BREAKAWAY_NM,
    _UNFORESEEN_RAD_S2,
    _UNFORESEEN_GAIN,
    _SLOW,
) = range(13)
_SIZE = 13


@compiled
def _known_torque_Nm(p: Array, measured_Nm: float, x: float, v: float) -> float:
    """Torque on the shaft by the model: from the reported one, without offset, friction and unbalance."""
    motor = laws.shaft_torque_Nm(p, lay.MOTOR, laws.true_torque_Nm(p, lay.MOTOR, measured_Nm), x)
    direction = measured_direction(v, _STANDSTILL_RAD_S)
    resistance = laws.measured_resistance_N(p, lay.AXIS, x, v, direction)
    return float(laws.passed_on_N(p, lay.AXIS, motor, direction) - resistance)


@compiled
def _slack_rad(position: Array, cycles: int) -> float:
    """Normal prediction error of a position: by the change of motion, and by the encoder's noise."""
    known = noise_level.is_known(position)
    noise_rad = _NOISE_SLACK * sqrt(noise_level.variance(position)) if known else _COARSEST_RAD
    return float(_POSITION_SLACK_RAD * (cycles * cycles) + min(noise_rad, _COARSEST_RAD))


@compiled
def _excites(v: InputVectors, acceleration_rad_s2: float) -> bool:
    """True if the torque for this acceleration exceeds that of noise, ripple and unbalance."""
    accelerating_Nm = abs(acceleration_rad_s2) * v.u[kalman.INERTIA_KG_M2]
    return bool(accelerating_Nm > _EXCITED * sqrt(noise_level.variance(v.torque)))


@compiled
def _take_quality(
    v: InputVectors, position_rad: float, torque_Nm: float, off_rad: float, duration_s: float, next_cycle: bool
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
    s[_UNFORESEEN_RAD_S2] *= exp(-duration_s / _FORESEEN_AGAIN_S)
    unforeseen = s[_UNFORESEEN_GAIN] * abs(off_rad)
    noisy = abs(off_rad) <= _SIGNIFICANT * sqrt(noise_level.variance(v.position))
    if not noisy and unforeseen > _FORESEEN * abs(v.motion[_ACCELERATION]):
        s[_UNFORESEEN_RAD_S2] = max(s[_UNFORESEEN_RAD_S2], unforeseen)


@compiled
def _fill(
    v: InputVectors,
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
    significant = abs(a) > _SIGNIFICANT * s[_NOISE_GAIN] * sqrt(variance)
    direction = min(max(speed / _STANDSTILL_RAD_S, -1.0), 1.0)
    s[_STICKING] = max(s[_STICKING] * exp(-duration_s / _AFTER_STANDSTILL_S), 1.0 - direction * direction)
    slow = max(1.0 - (speed / _LOW_SPEED_RAD_S) ** 2, 0.0)
    s[_SLOW] = s[_SLOW] + 1.0 if slow > 0.0 else 0.0
    phi = x / s[_GEAR_RATIO]
    torque, between_Nm = 0.5 * (before_Nm + torque_Nm), 0.0
    if next_cycle:
        torque += ripple_Nm
    else:  # the torque in between is unknown but for its end values
        between_Nm = abs(torque_Nm - before_Nm) + abs(ripple_Nm)
    shaking_Nm = _SHAKING * u[kalman.INERTIA_KG_M2] * a
    unforeseen_Nm = u[kalman.INERTIA_KG_M2] * s[_UNFORESEEN_RAD_S2]
    u[kalman.DURATION_S] = duration_s
    u[kalman.TORQUE_NM] = _known_torque_Nm(v.p, torque, x, speed)
    u[kalman.ACCELERATION_RAD_S2] = a if significant and _excites(v, a) else 0.0
    u[kalman.TORQUE_VARIANCE] = (
        noise_level.variance(v.torque)
        + between_Nm * between_Nm
        + shaking_Nm * shaking_Nm
        + unforeseen_Nm * unforeseen_Nm
        # Friction error is no white noise: the impulse of a constant over n cycles has n² times the variance of one
        # cycle, so that of the last one is 2n times. However long a shaft is at rest, it shows no offset.
        + s[_BREAKAWAY_NM] * s[_BREAKAWAY_NM] * (s[_STICKING] + 2.0 * slow * s[_SLOW])
    )
    u[kalman.POSITION_RAD] = position_rad
    u[kalman.POSITION_VARIANCE] = variance
    at = kalman.REGRESSORS
    u[at], u[at + 1], u[at + 2], u[at + 3], u[at + 4] = 1.0, speed, direction, -sin(phi), -cos(phi)


@compiled
def take_next(v: InputVectors, position_rad: float, torque_Nm: float, ripple_Nm: float) -> bool:
    """`FilterInputs.update` of a sample that is the next of a motion that is well known, one cycle after the last;
    False, and nothing done, where it is not."""
    s = v.s
    if s[LOST] != 0.0 or s[FOLLOWED] < _SETTLED_CYCLES or s[_MISSING] != 0.0 or isnan(s[_BEFORE_NM]):
        return False
    # Not <=: NaN has to fail.
    off_rad = position_rad - later(v.motion, v.forward, 0)
    if not abs(off_rad) <= _slack_rad(v.position, 1):
        return False
    before_Nm, s[_BEFORE_NM], s[_ODD] = s[_BEFORE_NM], torque_Nm, 0.0
    _take_quality(v, position_rad, torque_Nm, off_rad, s[CYCLE_S], True)
    s[FOLLOWED] += 1.0
    follow(v.motion, v.forward, v.gain, position_rad)
    _fill(v, v.back, before_Nm, position_rad, torque_Nm, ripple_Nm, s[CYCLE_S], True)
    return True


@merged
def of_table(table: Places, first: int) -> InputVectors:
    """Vectors in a `table_of` them from this row on."""
    return InputVectors(
        floats(table, first, (1,)),
        floats(table, first + 1, (1,)),
        floats(table, first + 2, (1,)),
        floats(table, first + 3, (1,)),
        floats(table, first + 4, (1,)),
        floats(table, first + 5, (1,)),
        floats(table, first + 6, (1, 2)),
        floats(table, first + 7, (1,)),
        floats(table, first + 8, (1, 2)),
    )


Fill = Callable[[Places, Array, float, float, float, float, float, bool], None]


@entry_point(TABLE, REAL, REAL, REAL, REAL, FLAG)
def _take_quality_of(
    table: Places, position_rad: float, torque_Nm: float, off_rad: float, duration_s: float, next_cycle: bool
) -> None:
    _take_quality(of_table(table, 0), position_rad, torque_Nm, off_rad, duration_s, next_cycle)


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
    v = of_table(table, 0)
    _fill(v, back, before_Nm, position_rad, torque_Nm, ripple_Nm, duration_s, next_cycle)


@entry_point(VECTOR, COUNT)
def _slack(position: Array, cycles: int) -> float:
    return _slack_rad(position, cycles)


class FilterInputs:
    """Inputs of `kalman.step` from samples: means over the cycle, and their noise."""

    def __init__(self, model: ServoAxisParameters, config: InertiaConfig) -> None:
        also = config.also
        self._p = lay.pack(model)
        factor, breakaway_Nm, _ = look(self._p, 0.0)
        self._state = np.zeros(_SIZE)
        self._state[_BREAKAWAY_NM] = breakaway_Nm + also.coulomb_friction_Nm
        self._state[_GEAR_RATIO] = model.shaft.gear_ratio
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
        self.u = np.zeros(kalman.INPUTS)
        self.u[kalman.INERTIA_KG_M2] = self.inertia_kg_m2
        self.u[kalman.BETA_VARIANCE_PER_S] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self.u[kalman.BETA_BOUND] = (0.01 * config.jump_pct) ** 2
        # Without an end an accepted drift goes on through all holds, and grows with all that is not white noise.
        self.u[kalman.DRIFT_S] = config.jump_pct / config.drift_pct_per_s
        self.u[kalman.MEMORIES_S : kalman.PRIORS] = config.friction_memory_s
        self.u[kalman.MEMORIES_S] = config.offset_memory_s
        self.u[kalman.PRIORS :] = self.priors
        self._torque = NoiseLevel(config.torque_noise_Nm, _TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD)
        self._motion = TrackingFilter(0.0)
        self._forward, self._back, self._gain = np.zeros((ORDER, ORDER)), np.zeros((ORDER, ORDER)), np.zeros(ORDER)
        self.in_doubt = False  #: True if the last sample may be of another time than assumed
        largest_Nm = per_item(model.drives.torque_limit_Nm, 1) if model.drives else inf
        self._largest_change_rad_s2 = _TORQUE_CHANGE * largest_Nm / self.inertia_kg_m2
        self._state[FOLLOWED] = -1.0
        self._state[_BEFORE_NM] = nan
        self._state[LOST] = 1.0
        self._gather()

    def _gather(self) -> None:
        """Collect the current vectors and the table of their addresses."""
        noise = self._torque.state, self._position.state
        of_a_cycle = self._forward, self._gain, self._back
        self.vectors = InputVectors(self._p, self._state, self.u, *noise, self._motion.motion, *of_a_cycle)
        self._table = table_of(self.vectors)

    @property
    def speed_rad_s(self) -> float:
        """Speed of the last cycle."""
        return self.u.item(kalman.REGRESSORS + 1)

    @property
    def duration_s(self) -> float:
        """Time from the previous sample to the last."""
        return self.u.item(kalman.DURATION_S)

    @property
    def lost(self) -> bool:
        """True while the motion is being initialized anew."""
        return self._state.item(FOLLOWED) < _SETTLED_CYCLES

    def interrupt(self) -> None:
        """Form no mean across the next gap; initialize the motion anew."""
        s = self._state
        s[_BEFORE_NM], s[FOLLOWED], s[_MISSING], s[_ODD] = nan, -1.0, 0.0, 0.0
        self._position.interrupt()

    def miss(self) -> None:
        """Count a missing cycle; too many of them are an interruption."""
        self._state[_MISSING] += 1.0
        if self._state[_MISSING] > _LONGEST_GAP_CYCLES:
            self.interrupt()

    def update(self, sample: ShaftSample) -> bool:
        """Fill `u`; False for a sample without new information, and for the first of a row, whose motion is unknown."""
        cycles, s = self._cycles_elapsed(sample), self._state
        if cycles == 0:
            return False
        duration_s, s[_MISSING] = cycles * sample.cycle_s, 0.0
        before_Nm, s[_BEFORE_NM] = s.item(_BEFORE_NM), sample.torque_Nm
        measured = sample.position_rad, sample.torque_Nm
        off_rad = sample.position_rad - self._motion.predicted(duration_s).item(0) if s[FOLLOWED] >= 1.0 else 0.0
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
        if s[CYCLE_S] != cycle_s:
            filter_s = _FILTER_CYCLES * cycle_s
            self._motion = TrackingFilter(filter_s)
            self._forward[:], self._back[:] = transition(cycle_s), transition(-0.5 * cycle_s)
            self._gain[:] = gains(cycle_s, filter_s)
            s[CYCLE_S], s[_NOISE_GAIN] = cycle_s, _acceleration_gain(cycle_s, filter_s)
            s[_UNFORESEEN_GAIN] = 4.0 / filter_s**2
            self._gather()
        self._motion.reset(position_rad)
        s[FOLLOWED] = 0.0

    def _cycles_elapsed(self, sample: ShaftSample) -> int:
        """Cycles since the previous sample, by the motion; no frame shows a SYNC that was lost or sent late.

        0 for a position of the same instant. Where no number fits, or a different one again and again, the motion is
        lost. With a shaft that hardly turns, a position of another time is not separable from one after a jolt:
        `in_doubt`.
        """
        s = self._state
        expected, self.in_doubt = 1 + int(s.item(_MISSING)), False
        if s[FOLLOWED] < 1.0:
            return expected
        if self._off_rad(sample, expected) <= _slack(self._position.state, expected):
            s[_ODD] = 0.0
            return expected
        found, travel_per_cycle = expected, abs(self._motion.motion.item(1)) * sample.cycle_s
        is_telling = travel_per_cycle > 2.0 * self._accelerated_rad(sample, 1)
        if is_telling:
            found = min(range(expected + _MORE_CYCLES + 1), key=lambda n: self._off_rad(sample, n))
        off_rad = self._off_rad(sample, found)
        s[_ODD] = s[_ODD] + 1.0 if found != expected else 0.0
        between = is_telling and off_rad > _BETWEEN * travel_per_cycle
        if between or off_rad > self._accelerated_rad(sample, found) or s[_ODD] > _MOST_ODD:
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
        if s[FOLLOWED] < 0.0:
            self._find_anew(position_rad, cycle_s)
            return
        s[FOLLOWED] += 1.0
        if s[FOLLOWED] == 1.0:  # two positions are a speed
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
