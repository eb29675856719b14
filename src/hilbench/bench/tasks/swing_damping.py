"""Active damping: the axis before a span takes the swing of the roller behind it against the web out, from the
measured strain rate. Here the span is the first, between axes 1 and 2.

Roller 2 and the span are a mass m on a spring k = E·S/L. The drive of axis 2 damps them by its proportional gain kp
only, and the tension loop, whose proportional part acts through the lag of axis 1, takes most of that away again. A
damper d between the rollers would pull with d·r, r = v2 − v1 the rate at which the web gets longer. The web pulls as
much more when roller 1 is behind by x1 = −(d/k)·r; as a velocity, with the elongation y, r' = −ω²·y and ω² = k/m:

    v1 = (d/m)·y

Axis 1 follows its command through its velocity loop, v1 = u/(1 + s·m1/kp1) above the loop's integral part, so

    u = (d/m)·(y + (m1/kp1)·r)

The command acts later than its positions were measured, by h = (n + 1/2)·T for the bus and its hold, T/2 because a
rate of positions is the mean of a cycle, half a sample of the drive and its current loop. So r and y are turned ahead
by the angle ω·h of the swing, and the part of the commands that is under way and shows in no measurement yet is taken
off. Below a fourth of ω the elongation is let go: there the tension loop is at work.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import cos, exp, inf, sin, sqrt

from hilbench.plant.pairing import Pairing
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m

#: Corner of the elongation's high-pass, as a share of the swing's angular frequency.
_WASHOUT = 0.25
#: Share of axis 1's torque limit that the damping may ask for.
_TORQUE_SHARE = 0.5
#: Relative change of E from which the gains are made anew.
_WORTH_CHANGING = 1e-3


@dataclass(frozen=True, slots=True)
class SwingPlant:
    """What swings and what damps it; masses and gains at the web, SI. 1 is the axis before the span, 2 that behind."""

    span_length_m: float
    section_m2: float
    upstream_strain: float
    mass1_kg: float
    mass2_kg: float
    velocity_kp1_N_s_per_m: float
    velocity_kp2_N_s_per_m: float
    current_loop_time_constant_s: float  #: of axis 1
    sample_time_s: float  #: of the drives
    torque_limit_N: float  #: of axis 1
    cycle_s: float
    least_way_m: float  #: by which positions of one instant may differ
    delay_cycles: int = 1  #: from measuring to the start of a command's hold

    @classmethod
    def of_model(cls, model: ModelParameters, cycle_s: float, span: int, upstream_strain: float) -> SwingPlant:
        """A span of a model with its drives, and the strain of the web that enters it.

        Raises ValueError for a model without drives or web.
        """
        drives = model.drives
        if drives is None:
            raise ValueError("the model has no drives, expected 'drives'")
        around = (span, span + 1)
        ratios = [model.motor_rad_per_m(axis) for axis in around]
        kp1, kp2 = (
            per_item(drives.velocity_kp_Nm_s_per_rad, axis) * ratio**2
            for axis, ratio in zip(around, ratios, strict=True)
        )
        return cls(
            span_length_m=model.span_length_m(span),
            section_m2=model.section_m2(span),
            upstream_strain=upstream_strain,
            mass1_kg=model.mass_kg(span),
            mass2_kg=model.mass_kg(span + 1),
            velocity_kp1_N_s_per_m=kp1,
            velocity_kp2_N_s_per_m=kp2,
            current_loop_time_constant_s=per_item(drives.current_loop_time_constant_s, span),
            sample_time_s=drives.sample_time_s,
            torque_limit_N=per_item(drives.torque_limit_Nm, span) * ratios[0],
            cycle_s=cycle_s,
            least_way_m=least_way_m(model),
        )

    @property
    def limit_m_s(self) -> float:
        """Largest velocity that the damping may ask axis 1 for; 0 where its drive has no proportional gain."""
        kp1 = self.velocity_kp1_N_s_per_m
        return _TORQUE_SHARE * self.torque_limit_N / kp1 if kp1 > 0.0 else 0.0

    @property
    def delay_s(self) -> float:
        """Mean time from a measured rate to the torque of axis 1 that it asks for."""
        held_s = (self.delay_cycles + 1.0) * self.cycle_s
        return held_s + 0.5 * self.sample_time_s + self.current_loop_time_constant_s


@dataclass(frozen=True, slots=True)
class DampingGains:
    """u = rate·r + elongation·y + Σ pending_j·u of j cycles before; y is the sum of r·T that fades with `washout`."""

    rate: float
    elongation_per_s: float
    washout_per_s: float
    pending: tuple[float, ...]


def damping_gains(plant: SwingPlant, damping_ratio: float, modulus_Pa: float) -> DampingGains:
    """Gains that give the swing this damping ratio, as far as the drive of axis 2 does not by itself."""
    mass_kg, kp1 = plant.mass2_kg, plant.velocity_kp1_N_s_per_m
    omega = sqrt(modulus_Pa * plant.section_m2 / plant.span_length_m / mass_kg)
    per_s = max(2.0 * damping_ratio * omega - plant.velocity_kp2_N_s_per_m / mass_kg, 0.0) if kp1 > 0.0 else 0.0
    lag_s = plant.mass1_kg / kp1 if kp1 > 0.0 else inf
    if per_s == 0.0:
        return DampingGains(0.0, 0.0, _WASHOUT * omega, ())
    c, s = cos(omega * plant.delay_s), sin(omega * plant.delay_s)
    moved = 1.0 - exp(-plant.cycle_s / lag_s)  # of a command, by axis 1 in a cycle
    return DampingGains(
        rate=per_s * (lag_s * c + s / omega),
        elongation_per_s=per_s * (c - lag_s * omega * s),
        washout_per_s=_WASHOUT * omega,
        pending=tuple(-per_s * lag_s * moved * share for share in _under_way(plant)),
    )


def _under_way(plant: SwingPlant) -> list[float]:
    """Of the commands of 1, 2, … cycles before: the share that acts after the measurement, and before the new one."""
    left, shares = plant.delay_s / plant.cycle_s - 0.5, []
    while left > 0.0:
        shares.append(min(left, 1.0))
        left -= 1.0
    return shares


class SwingDamping:
    """What axis 1's velocity command gets added, cycle by cycle; m/s at the web.

    It needs no twin: strain and its rate come from the encoders, by mass conservation. `modulus_Pa`: E at the start.
    """

    def __init__(self, plant: SwingPlant, damping_ratio: float, modulus_Pa: float) -> None:
        self._plant = plant
        self._ratio = damping_ratio
        self._limit_m_s = plant.limit_m_s
        self._modulus_Pa = modulus_Pa
        self._gains = damping_gains(plant, damping_ratio, modulus_Pa)
        self._pairing = Pairing(plant.least_way_m)
        self._commands: deque[float] = deque(maxlen=len(_under_way(plant)))
        self.reset()

    def reset(self) -> None:
        """The web is strained as upstream, and at rest (drives off)."""
        self._pairing.reset()
        self._before: tuple[float, float] | None = None
        self._unstretched_m = self._plant.span_length_m / (1.0 + self._plant.upstream_strain)
        self._strain = self._plant.upstream_strain
        self._elongation_m = 0.0
        self._cycles = 0
        self._commands.clear()
        self._commands.extend([0.0] * len(_under_way(self._plant)))

    def use_modulus(self, modulus_Pa: float) -> None:
        """E that the gains follow from now on."""
        if abs(modulus_Pa / self._modulus_Pa - 1.0) > _WORTH_CHANGING:
            self._modulus_Pa = modulus_Pa
            self._gains = damping_gains(self._plant, self._ratio, modulus_Pa)

    def velocity(self, x1_m: float, x2_m: float, planned_m_s: float = 0.0) -> float:
        """To be added to the velocity of axis 1, from the encoder positions at the web; `planned_m_s`: what they are
        to show of the span's lengthening, which is no swing.

        While they are not of one instant it stays what it was.
        """
        self._cycles += 1
        if not self._pairing.update(x1_m, x2_m):
            return self._commands[0]
        before, cycles = self._before, self._cycles
        self._before, self._cycles = (x1_m, x2_m), 0
        if before is None:
            return 0.0
        rate_m_s = self._elongated_m(x1_m - before[0], x2_m - before[1]) / (cycles * self._plant.cycle_s)
        rate_m_s -= planned_m_s
        gains = self._gains
        self._elongation_m *= exp(-gains.washout_per_s * cycles * self._plant.cycle_s)
        self._elongation_m += rate_m_s * cycles * self._plant.cycle_s
        command = gains.rate * rate_m_s + gains.elongation_per_s * self._elongation_m
        for gain, sent in zip(gains.pending, self._commands, strict=False):
            command += gain * sent
        command = min(max(command, -self._limit_m_s), self._limit_m_s)
        self._commands.appendleft(command)
        return command

    def _elongated_m(self, way1_m: float, way2_m: float) -> float:
        """How much longer the span's web has become, ΔL = L·Δε, by what came in and went out unstretched.

        Forward the balance forgets an error of the strain within L/v. In reverse the same error would grow as fast: so
        there the strain that is believed goes the other way, and what lasts longer than L/v is forgotten as well.
        """
        plant, strain = self._plant, self._strain
        direction = 1.0 if way2_m >= 0.0 else -1.0
        came_in_m = way1_m / (1.0 + plant.upstream_strain) - way2_m / (1.0 + strain)
        self._unstretched_m += direction * came_in_m
        self._strain = plant.span_length_m / self._unstretched_m - 1.0
        return direction * plant.span_length_m * (self._strain - strain)
