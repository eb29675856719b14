"""Controllers of reels, dancers and accumulators: setting a torque, a speed or a force, with feed-forward.

A reel in torque mode pulls the web by its motor's torque: without more it takes the torque of its own acceleration out
of the web. Fed forward, J(r)·a/r and the tension times the radius leave only the unknown rest to the controller. A
dancer's position loop sets the speed before it; the tension is what pushes the carriage. An accumulator's carriage
moves by the speeds at its ends: the force for its rollers' and its own acceleration, and for the friction of guide and
jack, is added to its force.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, cos, pi, sin
from typing import Final

from hilbench.compiled import Record
from hilbench.plant.parameters import per_item
from hilbench.plant.sampling import samples_per
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import Accumulator, Dancer, LineCarriage, Reel


class RollerMotion:
    """Response of a driven roller to its velocity command: m·v' = kp·(u - v) + ki·∫(u - v), sampled as its drive does;
    the web pulls at both sides alike."""

    def __init__(self, model: ModelParameters, axis: int, cycle_s: float) -> None:
        loops, ratio = model.drives, model.motor_rad_per_m(axis)
        assert loops is not None, "a bench's model has drives"
        self._mass_kg = model.mass_kg(axis)
        self._kp_N_s_per_m = per_item(loops.velocity_kp_Nm_s_per_rad, axis) * ratio**2
        self._ki_N_per_m = per_item(loops.velocity_ki_Nm_per_rad, axis) * ratio**2
        self._samples = samples_per(cycle_s, loops.sample_time_s)
        self._sample_s = loops.sample_time_s
        self.reset()

    def reset(self) -> None:
        """Reset to rest."""
        self.speed_m_s = self._integral_N = 0.0  #: speed at the end of the last cycle computed

    def acceleration_m_s2(self, command_m_s: float) -> float:
        """The mean of the next cycle, with this command."""
        before_m_s = self.speed_m_s
        for _ in range(self._samples):
            error_m_s = command_m_s - self.speed_m_s
            self._integral_N += self._ki_N_per_m * error_m_s * self._sample_s
            force_N = self._kp_N_s_per_m * error_m_s + self._integral_N
            self.speed_m_s += force_N / self._mass_kg * self._sample_s
        return (self.speed_m_s - before_m_s) / (self._samples * self._sample_s)


#: Share of a ramp over which its acceleration rises, and falls: the peak is 9/7 of the least possible.
#: With less an unwinder that stops turns back by more than 1 mm/s.
ROUNDED: Final = 2.0 / 9.0
#: Speed below which dry friction is compensated in proportion to it, m/s: a part at rest may stick either way.
_STANDSTILL_M_S = 2e-4


def eased(time: float, rounded: float = ROUNDED) -> tuple[float, float]:
    """Position and speed of a ramp from 0 to 1 over the time 1, with a bounded and continuous jerk.
    `rounded`: share over which the acceleration rises, and falls, up to 1/2."""
    time = min(max(time, 0.0), 1.0)
    left, fastest = min(time, 1.0 - time), 1.0 / (1.0 - rounded)
    if left < rounded:
        turned = pi * left / rounded
        travel, speed = 0.5 * fastest * (left - rounded * sin(turned) / pi), 0.5 * fastest * (1.0 - cos(turned))
    else:
        travel, speed = fastest * (left - 0.5 * rounded), fastest
    return (travel if time <= 0.5 else 1.0 - travel), speed


@dataclass(frozen=True)
class ReelMechanics:
    """Mechanics of a reel with its web, at its own shaft. `side`: 1 for a rewinder, -1 for an unwinder."""

    side: float
    gear_ratio: float
    empty_kg_m2: float
    core_radius_m: float
    web_kg_per_m3_m: float  #: density times width

    @classmethod
    def of_model(cls, model: ModelParameters, axis: int) -> ReelMechanics:
        """Mechanics of an axis that is a reel. Raises ValueError for another."""
        reel = next((roller.station for roller in model.line_rollers if roller.axis == axis), None)
        if not isinstance(reel, Reel):
            raise ValueError(f"axis {axis} is no reel, expected an unwinder or rewinder")
        span = 1 if reel.type == "unwinder" else model.span_count
        width_m = model.section_m2(span) / per_item(model.required_web.thickness_m, span)
        return cls(
            side=-1.0 if reel.type == "unwinder" else 1.0,
            gear_ratio=model.gear_ratio(axis),
            empty_kg_m2=per_item(model.rollers.inertia_kg_m2, axis)
            + model.gear_ratio(axis) ** 2 * per_item(model.motors.inertia_kg_m2, axis),
            core_radius_m=reel.core_radius_m,
            web_kg_per_m3_m=reel.density_kg_m3 * width_m,
        )

    def inertia_kg_m2(self, radius_m: float) -> float:
        """Inertia with the web on it."""
        return self.empty_kg_m2 + 0.5 * pi * self.web_kg_per_m3_m * (radius_m**4 - self.core_radius_m**4)

    def torque_Nm(
        self, tension_N: float, acceleration_m_s2: float, radius_m: float, wound_m: float | None = None
    ) -> float:
        """Torque of the motor, at its shaft, that keeps a tension at an acceleration of the web; `wound_m`: radius of
        the turning roll, where that differs."""
        inertia_kg_m2 = self.inertia_kg_m2(radius_m if wound_m is None else wound_m)
        accelerating_Nm = inertia_kg_m2 * acceleration_m_s2 / radius_m
        return (self.side * tension_N * radius_m + accelerating_Nm) / self.gear_ratio


class ReelTension:
    """A reel's torque from the tension next to it, N·m at the motor: PID on the tension, with feed-forward.

    `gain`: N per N; `rate_per_s`: of the integral; `derivative_s`: N per N/s of the tension, which damps the swing of
    the reel against its web; `limit_Nm`: of the motor.
    """

    def __init__(
        self, reel: ReelMechanics, gain: float, rate_per_s: float, limit_Nm: float, derivative_s: float = 0.0
    ) -> None:
        self._reel = reel
        self._gain = gain
        self._rate_per_s = rate_per_s
        self._derivative_s = derivative_s
        self._limit_Nm = limit_Nm
        self.reset()

    def reset(self) -> None:
        """Forget the integral, and the tension of before."""
        self._integral_N = 0.0
        self._before_N: float | None = None

    def torque_Nm(
        self,
        set_point_N: float,
        tension_N: float,
        acceleration_m_s2: float,
        radius_m: float,
        cycle_s: float,
        wound_m: float | None = None,
    ) -> float:
        """Torque of a cycle; `acceleration_m_s2`: planned, of the web; `radius_m`: of the reel now; `wound_m` as of
        `ReelMechanics.torque_Nm`."""
        error_N = set_point_N - tension_N
        integral_N = self._integral_N + self._rate_per_s * error_N * cycle_s
        changed_N = 0.0 if self._before_N is None else tension_N - self._before_N
        self._before_N = tension_N
        pull_N = set_point_N + self._gain * error_N + integral_N - self._derivative_s * changed_N / cycle_s
        torque_Nm = self._reel.torque_Nm(pull_N, acceleration_m_s2, radius_m, wound_m)
        if abs(torque_Nm) > self._limit_Nm:
            return copysign(self._limit_Nm, torque_Nm)
        self._integral_N = integral_N
        return torque_Nm


class DancerPosition:
    """Speed of the roller before a dancer or accumulator that keeps its carriage at a position.

    The carriage moves by half the difference of the speeds for a dancer, the n-th part for n strands; PI on the
    position with two equal poles at `bandwidth_rad_per_s`, around the speed after it and that of the wanted motion. The
    correction is at most `limit_m_s`, reached within half of 1/`bandwidth_rad_per_s`: rollers without a
    motor take the torque for their acceleration out of the web.
    """

    def __init__(self, station: Dancer | Accumulator, bandwidth_rad_per_s: float, limit_m_s: float) -> None:
        self._strands = station.strand_count
        self._bandwidth = bandwidth_rad_per_s
        self._limit_m_s = limit_m_s
        self.reset()

    def reset(self) -> None:
        """Reset the integral and the correction."""
        self._integral_m_s = self._corrected_m_s = 0.0

    def velocity(
        self, behind_m_s: float, wanted_m: float, wanted_m_s: float, position_m: float, cycle_s: float
    ) -> float:
        """Velocity of the roller before it, by one cycle of its balance: web in is web out plus the strands' uptake."""
        error_m, gain = wanted_m - position_m, self._strands * self._bandwidth
        integral_m_s = self._integral_m_s + 0.25 * gain * self._bandwidth * error_m * cycle_s
        asked_m_s = gain * error_m + integral_m_s
        if self._correct(asked_m_s, cycle_s) == asked_m_s:
            self._integral_m_s = integral_m_s
        return behind_m_s + self._strands * wanted_m_s + self._corrected_m_s

    def let_go(self, behind_m_s: float, cycle_s: float) -> float:
        """One cycle without position control: the correction returns to zero."""
        return behind_m_s + self._correct(0.0, cycle_s)

    def _correct(self, asked_m_s: float, cycle_s: float) -> float:
        step_m_s = 2.0 * self._bandwidth * self._limit_m_s * cycle_s
        least_m_s = max(self._corrected_m_s - step_m_s, -self._limit_m_s)
        largest_m_s = min(self._corrected_m_s + step_m_s, self._limit_m_s)
        self._corrected_m_s = min(max(asked_m_s, least_m_s), largest_m_s)
        return self._corrected_m_s


class CarriageForce:
    """Force on the carriage of an accumulator or dancer that keeps the tension next to it, by its momentum balance.

    The rollers between the strands turn at speeds interpolated between that before and that after; roller j of n - 1
    has the inertia m and friction R, so that strand j pulls by the sum of m·a + R of the rollers after it less the
    web after the carriage; the carriage has the sum of the strands, its mass and its friction. All of that is as the
    model has it, with its effects.

    No force on it can change the difference of the tensions at its ends, only which of them changes: `behind_takes`
    is the share of the change, against an even speed, that the tension after it has, 0 where it is to stay, 1 where
    that before is. `mass_error`, `friction_error`: relative errors of the masses used, and of friction other than the
    carriage's viscous one.
    """

    def __init__(
        self,
        model: ModelParameters,
        carriage: LineCarriage,
        mass_error: float = 0.0,
        friction_error: float = 0.0,
        behind_takes: float = 0.0,
    ) -> None:
        rows = lay.Layout.of(p := lay.pack(model)).axis_rows(p)
        own = rows[len(model.line_rollers) + model.carriages.index(carriage)]
        moved, held = 1.0 + mass_error, 1.0 + friction_error
        self._behind_takes = behind_takes
        self._station, self._strands = carriage.station, carriage.station.strand_count
        between = rows[carriage.first_span : carriage.last_span]
        self._rollers = [Resisting.of_row(row, moved, held, held) for row in between]
        self._carriage = Resisting.of_row(own, moved, held, 1.0)
        self._spring_N_per_m: float = float(own.spring_N_per_m)
        self._rest_m = carriage.station.spring_rest_m
        self._more_N: float = float(own.force_N) - carriage.station.force_N  # an effect of the model

    def force_N(
        self,
        tension_N: float,
        before_m_s: float,
        behind_m_s: float,
        before_m_s2: float,
        behind_m_s2: float,
        position_m: float = 0.0,
    ) -> float:
        """Force from the speeds of the web at the ends and their planned accelerations; `tension_N` is wanted after it
        at an even speed."""
        strands, gain = self._strands, self._station.strand_gain(position_m)
        needs_N, more_N = [], 0.0
        for number in range(strands - 1, 0, -1):
            roller, share = self._rollers[number - 1], number / strands
            speed_m_s = before_m_s + share * (behind_m_s - before_m_s)
            acceleration_m_s2 = before_m_s2 + share * (behind_m_s2 - before_m_s2)
            needs_N.append(roller.mass_kg * acceleration_m_s2 + roller.friction_N(speed_m_s))
            more_N += needs_N[-1] - roller.friction_N(behind_m_s)
        strand_N = tension_N + self._behind_takes * more_N
        total_N = strand_N
        for need_N in needs_N:
            strand_N -= need_N
            total_N += strand_N
        carriage_m_s, carriage_m_s2 = (
            (before - behind) / (strands * gain)
            for before, behind in ((before_m_s, behind_m_s), (before_m_s2, behind_m_s2))
        )
        moving_N = self._carriage.mass_kg * carriage_m_s2 + self._carriage.friction_N(carriage_m_s)
        spring_N = self._spring_N_per_m * (position_m - self._rest_m)
        return gain * total_N + moving_N + spring_N - self._more_N


@dataclass(frozen=True, slots=True)
class Resisting:
    """A roller with its friction at the web, or a carriage with that along its travel."""

    mass_kg: float
    dry_N: float
    viscous_N_s_per_m: float

    @classmethod
    def of_row(cls, row: Record, moved: float, dry: float, viscous: float) -> Resisting:
        """Make from the `AXIS` of a roller or carriage (`hilbench.plant.web_line.layout`), times these."""
        dry_N, viscous_N_s_per_m = row.coulomb_friction.force_N, row.viscous_friction.coefficient_N_s_per_m
        return cls(moved * float(row.roller_mass_kg), dry * float(dry_N), viscous * float(viscous_N_s_per_m))

    def friction_N(self, speed_m_s: float) -> float:
        """Against its motion."""
        direction = min(max(speed_m_s / _STANDSTILL_M_S, -1.0), 1.0)
        return direction * self.dry_N + self.viscous_N_s_per_m * speed_m_s
