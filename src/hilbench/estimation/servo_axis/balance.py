"""What each cycle says of the shaft: the inputs of the filters, from measured position and torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, inf, nan

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point
from hilbench.estimation.bank import Array
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.servo_axis import kalman
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import kernel, laws
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.tracking_filter import TrackingFilter, gains, transition

#: Encoder noise believed before it is measured, and the least that is believed; least noise of the torque.
_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD = 3e-6, 1e-7
_TORQUE_FLOOR_NM = 1e-4
#: Time constant of the filter that says how fast the shaft turns and accelerates, in cycles.
_FILTER_CYCLES = 5.0
#: Cycles until it has forgotten that it was started at a guess of the speed.
_SETTLED_CYCLES = 75
#: Deviations of its noise beyond which an acceleration is one.
_SIGNIFICANT = 4.0
#: Below this speed the shaft may stick, and dry friction is anything up to its greatest.
_STANDSTILL_RAD_S = 0.2
#: How fast that is over when it turns again: a load motor that imitates friction turns it late, and the jump of the
#: acceleration then goes through the filter of the inertia that it imitates.
_AFTER_STANDSTILL_S = 0.02
#: Share of the accelerating torque that counts as noise: what is imitated follows it only so well.
_SHAKING = 0.01
#: Of the motor's torque limit: by how much more or less torque than before, load motor included, the shaft may be
#: turned. A position that is further off than this accelerates it is not one cycle after the last.
_TORQUE_CHANGE = 2.0
#: By how much the motion changes its course in a cycle without anything being wrong, the encoder's noise in
#: deviations, and the most that is believed of an encoder (12 bits).
_POSITION_SLACK_RAD, _NOISE_SLACK, _COARSEST_RAD = 1e-4, 6.0, 3e-3
#: More cycles than this without a usable sample are not bridged: the motion is found anew.
_LONGEST_GAP_CYCLES = 20
#: Part of a cycle by which a sample is between two of them, and neither.
_BETWEEN = 0.25
#: Beyond those that are known to be missing so many cycles may have passed, so many times in a row.
_MORE_CYCLES, _MOST_ODD = 5, 3
#: Place in the motion of the filter.
_ACCELERATION = 2


@dataclass(frozen=True, slots=True)
class ShaftSample:
    """What is known at one SYNC."""

    cycle_s: float  #: of the bus; how many have passed since the sample before is found from the motion
    position_rad: float
    torque_Nm: float  #: of the motor, as the drive reports it
    #: What its mean over the cycle is more than the mean of both its ends, as the simulated drive has it: set points
    #: come with SYNC, and the torque ripples with them.
    ripple_Nm: float = 0.0


Known = Callable[[Array, float, float, float], float]


def _compiled_known(sources: int) -> Known:
    """The function that is called from Python; `sources` as in the kernel."""

    @entry_point(VECTOR, REAL, REAL, REAL)
    def known_torque(p: Array, measured_Nm: float, x: float, v: float) -> float:
        """Torque on the shaft by the model: from the reported one, without offset, friction and unbalance."""
        motor = laws.shaft_torque_Nm(p, measured_Nm - laws.reported_offset_Nm(p), x) if sources >= 0 else 0.0
        torque = motor + laws.unbalance_Nm(p, x) - laws.smooth_friction_Nm(p, v)
        direction = min(max(v / _STANDSTILL_RAD_S, -1.0), 1.0)
        return float(torque - direction * (laws.dry_friction_Nm(p, v) + laws.load_friction_Nm(p, motor)))

    return known_torque


_known_torque = _compiled_known(kernel.source_number(__file__))


class FilterInputs:
    """Turns samples into the inputs of `kalman.step`: means over the cycle, and how noisy they are."""

    def __init__(self, model: ServoAxisParameters, config: InertiaConfig) -> None:
        also = config.also
        self._p = lay.pack(model)
        factor, breakaway_Nm, _ = kernel.look(self._p, 0.0)
        self._breakaway_Nm = breakaway_Nm + also.coulomb_friction_Nm
        self._gear_ratio = model.shaft.gear_ratio
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
        self.u[kalman.MEMORY_S] = config.friction_memory_s
        self.u[kalman.PRIORS :] = self.priors
        self._torque = NoiseLevel(config.torque_noise_Nm, _TORQUE_FLOOR_NM)
        self._position = NoiseLevel(_POSITION_NOISE_RAD, _POSITION_FLOOR_RAD)
        self._motion: TrackingFilter | None = None
        self._cycles = 0  # that the motion has been followed
        self._missing = 0  # cycles without a sample since the last one
        self.in_doubt = False  #: whether the last sample may be one of another time than it was taken for
        self._odd = 0  # samples in a row that were not so many cycles after the one before as was expected
        largest_Nm = per_item(model.drives.torque_limit_Nm, 1) if model.drives else inf
        self._largest_change_rad_s2 = _TORQUE_CHANGE * largest_Nm / self.inertia_kg_m2
        self._noise_gain = 0.0
        self._sticking = 0.0  # 1: what dry friction is may be anything
        self._before_Nm: float | None = None
        self._before_rad = nan

    @property
    def speed_rad_s(self) -> float:
        """Of the last cycle."""
        return self.u.item(kalman.REGRESSORS + 1)

    @property
    def duration_s(self) -> float:
        """From the sample before to the last."""
        return self.u.item(kalman.DURATION_S)

    @property
    def lost(self) -> bool:
        """Whether the motion is being found anew."""
        return self._motion is None or self._cycles < _SETTLED_CYCLES

    def interrupt(self) -> None:
        """No mean is formed across what is coming, and the motion is found anew."""
        self._before_Nm = None
        self._motion = None
        self._missing = self._odd = 0
        self._position.interrupt()

    def miss(self) -> None:
        """A cycle is missing; so many of them that nothing can be said of the time between are an interruption."""
        self._missing += 1
        if self._missing > _LONGEST_GAP_CYCLES:
            self.interrupt()

    def update(self, sample: ShaftSample) -> bool:
        """Fill `u`; False for a sample that says nothing new, and for the first of a row, of whose motion too little is
        known."""
        cycles = self._cycles_gone(sample)
        if cycles == 0:
            return False
        duration_s, self._missing = cycles * sample.cycle_s, 0
        before, self._before_Nm = self._before_Nm, sample.torque_Nm
        if cycles == 1:
            self._torque.update(sample.torque_Nm)
        else:
            self._position.interrupt()
        # An encoder at rest shows no noise, whatever it counts by.
        if abs(sample.position_rad - self._before_rad) > _STANDSTILL_RAD_S * duration_s:
            self._position.update(sample.position_rad)
        self._before_rad = sample.position_rad
        self._follow(sample.position_rad, sample.cycle_s, duration_s)
        if before is None or self._motion is None or self._cycles < _SETTLED_CYCLES:
            return False
        x, v, a, _ = self._motion.predicted(-0.5 * duration_s).tolist()
        u, variance = self.u, self._position.variance
        significant = abs(a) > _SIGNIFICANT * self._noise_gain * variance**0.5
        direction = min(max(v / _STANDSTILL_RAD_S, -1.0), 1.0)
        self._sticking *= exp(-duration_s / _AFTER_STANDSTILL_S)
        self._sticking = max(self._sticking, 1.0 - direction * direction)
        phi = x / self._gear_ratio
        torque = 0.5 * (before + sample.torque_Nm)
        between_Nm = 0.0
        if cycles == 1:
            torque += sample.ripple_Nm
        else:  # of the torque between nothing is known but where it came from and went
            between_Nm = abs(sample.torque_Nm - before) + abs(sample.ripple_Nm)
        u[kalman.DURATION_S] = duration_s
        u[kalman.TORQUE_NM] = _known_torque(self._p, torque, x, v)
        u[kalman.ACCELERATION_RAD_S2] = a if significant else 0.0
        u[kalman.TORQUE_VARIANCE] = (
            self._torque.variance
            + between_Nm**2
            + (_SHAKING * self.inertia_kg_m2 * a) ** 2
            + self._breakaway_Nm**2 * self._sticking
        )
        u[kalman.POSITION_RAD] = sample.position_rad
        u[kalman.POSITION_VARIANCE] = variance
        u[kalman.REGRESSORS : kalman.PRIORS] = 1.0, v, direction, -np.sin(phi), -np.cos(phi)
        return True

    def _cycles_gone(self, sample: ShaftSample) -> int:
        """Cycles since the sample before, as the motion tells; no frame does, of a SYNC that was lost or sent late.

        0 for a position of the same instant. Where no number fits, or another one again and again, the motion is lost.
        A shaft that hardly turns does not tell a position of another time from one after a jolt: that is in doubt.
        """
        expected, self.in_doubt = 1 + self._missing, False
        if self._motion is None or self._cycles < 1:
            return expected
        if self._off_rad(sample, expected) <= self._slack_rad(expected):
            self._odd = 0
            return expected
        found, way_of_a_cycle = expected, abs(self._motion.motion.item(1)) * sample.cycle_s
        tells = way_of_a_cycle > 2.0 * self._accelerated_rad(sample, 1)
        if tells:
            found = min(range(expected + _MORE_CYCLES + 1), key=lambda n: self._off_rad(sample, n))
        off_rad = self._off_rad(sample, found)
        self._odd = self._odd + 1 if found != expected else 0
        between = tells and off_rad > _BETWEEN * way_of_a_cycle
        if between or off_rad > self._accelerated_rad(sample, found) or self._odd > _MOST_ODD:
            self.interrupt()
            return 1
        self.in_doubt = not tells
        return found

    def _accelerated_rad(self, sample: ShaftSample, cycles: int) -> float:
        """What the position can be off by in so many cycles because the shaft is accelerated otherwise than before."""
        way_rad = 0.5 * self._largest_change_rad_s2 * (cycles * sample.cycle_s) ** 2
        return way_rad + self._slack_rad(cycles)

    def _slack_rad(self, cycles: int) -> float:
        """What a position is off by without anything being wrong: as the motion changes, and by the encoder's noise."""
        noise_rad = _NOISE_SLACK * self._position.deviation if self._position.known else _COARSEST_RAD
        return _POSITION_SLACK_RAD * cycles**2 + min(noise_rad, _COARSEST_RAD)

    def _off_rad(self, sample: ShaftSample, cycles: int) -> float:
        assert self._motion is not None, "compared with a motion that is known"
        return abs(sample.position_rad - self._motion.predicted(cycles * sample.cycle_s).item(0))

    def _follow(self, position_rad: float, cycle_s: float, duration_s: float) -> None:
        """Position, speed and acceleration with a sample, `duration_s` after the one before."""
        if self._motion is None:
            self._motion = TrackingFilter(_FILTER_CYCLES * cycle_s)
            self._motion.reset(position_rad)
            self._noise_gain = _acceleration_gain(cycle_s, _FILTER_CYCLES * cycle_s)
            self._cycles = 0
            return
        self._cycles += 1
        if self._cycles == 1:  # two positions are a speed
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
