"""Active damping: the axis before a span damps the swing of the roller after it against the web, by
the measured strain rate. Here the span is the first, between axes 1 and 2.

Roller 2 and the span are a mass m on a spring k = E·S/L. The drive of axis 2 damps them by its proportional gain kp
only, and the tension loop, whose proportional part acts through the lag of axis 1, takes most of that away again. A
damper d between the rollers would pull with d·r, r = v2 − v1 the rate at which the web gets longer. The web pulls as
much more when roller 1 is behind by x1 = −(d/k)·r; as a velocity, with the elongation y, r' = −ω²·y and ω² = k/m:

    v1 = (d/m)·y

Axis 1 follows its command through its velocity loop, v1 = u/(1 + s·m1/kp1) above the loop's integral part, so

    u = (d/m)·(y + (m1/kp1)·r)

The command acts later than its positions were measured, by the dead time h = (n + 1/2)·T for the bus and its hold, T/2
because a rate of positions is the mean of a cycle, half a sample of the drive and its current loop. So r and y are
turned ahead by the angle ω·h of the swing, and the part of the commands that is under way and not measured yet is
subtracted. Below a fourth of ω the elongation is washed out: there the tension loop is at work.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, inf, sin, sqrt
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import REAL, VECTOR, compiled, entry_point, interpreted
from hilbench.plant.parameters import per_item
from hilbench.plant.sample_coherence import coherence_state, coherent
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_travel_m

Vector = NDArray[np.float64]

#: Corner of the elongation's high-pass, as a share of the swing's angular frequency.
_WASHOUT = 0.25
#: Share of axis 1's torque limit that the damping may use.
_TORQUE_SHARE = 0.5
#: Relative change of E from which the gains are recomputed.
_WORTH_CHANGING = 1e-3


@dataclass(frozen=True, slots=True)
class SwingPlant:
    """Swinging masses and the damping drive; masses and gains at the web, SI. 1: axis before the span, 2: after it."""

    span_length_m: float
    section_m2: float
    upstream_strain: float
    downstream_strain: float
    mass1_kg: float
    mass2_kg: float
    velocity_kp1_N_s_per_m: float
    velocity_kp2_N_s_per_m: float
    current_loop_time_constant_s: float  #: of axis 1
    sample_time_s: float  #: of the drives
    torque_limit_N: float  #: of axis 1
    cycle_s: float
    least_travel_m: float  #: by which positions of one instant may differ
    delay_cycles: int = 1  #: from measuring to the start of a command's hold

    @classmethod
    def of_model(cls, model: ModelParameters, cycle_s: float, span: int, strains: tuple[float, float]) -> SwingPlant:
        """A span of a model with its drives, and the strains of the web before and behind it.

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
            upstream_strain=strains[0],
            downstream_strain=strains[1],
            mass1_kg=model.mass_kg(span),
            mass2_kg=model.mass_kg(span + 1),
            velocity_kp1_N_s_per_m=kp1,
            velocity_kp2_N_s_per_m=kp2,
            current_loop_time_constant_s=per_item(drives.current_loop_time_constant_s, span),
            sample_time_s=drives.sample_time_s,
            torque_limit_N=per_item(drives.torque_limit_Nm, span) * ratios[0],
            cycle_s=cycle_s,
            least_travel_m=least_travel_m(model, cycle_s),
        )

    @property
    def limit_m_s(self) -> float:
        """Largest velocity that the damping may command axis 1; 0 where its drive has no proportional gain."""
        kp1 = self.velocity_kp1_N_s_per_m
        return _TORQUE_SHARE * self.torque_limit_N / kp1 if kp1 > 0.0 else 0.0

    @property
    def delay_s(self) -> float:
        """Mean dead time from a measured rate to the torque of axis 1 that it causes."""
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
        pending=tuple(-per_s * lag_s * moved * share for share in _plant_in_motion(plant)),
    )


def _plant_in_motion(plant: SwingPlant) -> list[float]:
    """Shares of the commands of 1, 2, … cycles before that act after the measurement and before the new command."""
    left, shares = plant.delay_s / plant.cycle_s - 0.5, []
    while left > 0.0:
        shares.append(min(left, 1.0))
        left -= 1.0
    return shares


#: Places in the vectors of `damp`. Plant: span, strains upstream and downstream, limit of the command, cycle,
#: tolerance of travel differences, E that the gains are for.
_LENGTH_M, _UPSTREAM, _DOWNSTREAM, _LIMIT_M_S, _CYCLE_S, _LEAST_TRAVEL_M, _MODULUS_PA = range(7)
#: Gains: those of `DampingGains`, then how many are pending, and these.
_RATE, _ELONGATION, _FADES, _PENDING, _GAINS = range(5)
#: State: cycles since the last positions that were taken, whether there are any, they, the web in the span unstretched,
#: its strain, the elongation; then the last commands.
_CYCLES, _STARTED, _X1_M, _X2_M, _UNSTRETCHED_M, _STRAIN, _ELONGATION_M, _COMMANDS = range(8)


@compiled
def has_changed(plant: Vector, modulus_Pa: float) -> bool:
    """True if E has changed so much that `SwingDamping.use_modulus` recomputes the gains."""
    return bool(abs(modulus_Pa / plant[_MODULUS_PA] - 1.0) > _WORTH_CHANGING)


@compiled
def _elongated_m(plant: Vector, s: Vector, travel1_m: float, travel2_m: float) -> float:
    """Elongation of the span's web, ΔL = L·Δε, by mass conservation of unstretched length: in at roller 1 and out at 2,
    reversed in reverse. The balance forgets an error of the strain within L/v.
    """
    strain = s[_STRAIN]
    came_in_m = travel1_m / (1.0 + (plant[_UPSTREAM] if travel1_m >= 0.0 else strain))
    went_out_m = travel2_m / (1.0 + (strain if travel2_m >= 0.0 else plant[_DOWNSTREAM]))
    s[_UNSTRETCHED_M] += came_in_m - went_out_m
    s[_STRAIN] = plant[_LENGTH_M] / s[_UNSTRETCHED_M] - 1.0
    return float(plant[_LENGTH_M] * (s[_STRAIN] - strain))


@compiled
def damp(plant: Vector, gains: Vector, coherence: Vector, s: Vector, positions_m: Vector, planned_m_s: float) -> float:
    """`SwingDamping.velocity` on its vectors (`coherence`: for `coherent`); positions (2,)."""
    s[_CYCLES] += 1.0
    if not coherent(coherence, positions_m, plant[_LEAST_TRAVEL_M]):
        return float(s[_COMMANDS])
    travel1_m, travel2_m, cycles = positions_m[0] - s[_X1_M], positions_m[1] - s[_X2_M], s[_CYCLES]
    started = s[_STARTED] != 0.0
    s[_X1_M], s[_X2_M], s[_CYCLES], s[_STARTED] = positions_m[0], positions_m[1], 0.0, 1.0
    if not started:
        return 0.0
    rate_m_s = _elongated_m(plant, s, travel1_m, travel2_m) / (cycles * plant[_CYCLE_S])
    rate_m_s -= planned_m_s
    s[_ELONGATION_M] *= exp(-gains[_FADES] * cycles * plant[_CYCLE_S])
    s[_ELONGATION_M] += rate_m_s * cycles * plant[_CYCLE_S]
    command = gains[_RATE] * rate_m_s + gains[_ELONGATION] * s[_ELONGATION_M]
    for k in range(int(gains[_PENDING])):
        command += gains[_GAINS + k] * s[_COMMANDS + k]
    if -plant[_LIMIT_M_S] > command:
        command = -plant[_LIMIT_M_S]
    if plant[_LIMIT_M_S] < command:
        command = plant[_LIMIT_M_S]
    for k in range(len(s) - 1, _COMMANDS, -1):
        s[k] = s[k - 1]
    s[_COMMANDS] = command
    return float(command)


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL)
def _damp(plant: Vector, gains: Vector, coherence: Vector, s: Vector, positions_m: Vector, planned_m_s: float) -> float:
    return damp(plant, gains, coherence, s, positions_m, planned_m_s)


_POSITIONS = Struct("=2d")
_has_changed = interpreted(has_changed)


class SwingDamping:
    """Correction of axis 1's velocity command, cycle by cycle; m/s at the web.

    It needs no twin: strain and its rate come from the encoders, by mass conservation. `modulus_Pa`: E at the start.
    """

    def __init__(self, plant: SwingPlant, damping_ratio: float, modulus_Pa: float) -> None:
        self._plant = plant
        self._ratio = damping_ratio
        self._sent = len(_plant_in_motion(plant))
        strains = (plant.upstream_strain, plant.downstream_strain)
        figures = plant.span_length_m, *strains, plant.limit_m_s, plant.cycle_s, plant.least_travel_m, modulus_Pa
        self._figures = np.array(figures)
        self._gains = np.zeros(_GAINS + self._sent)
        self._state = np.zeros(_COMMANDS + self._sent)
        self._coherence, self._positions_m = coherence_state(2), np.zeros(2)
        self._use(modulus_Pa)
        self.velocity(0.0, 0.0)  # compiled, or loaded, before a cycle waits for it
        self.reset()

    @property
    def vectors(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        """Vectors of `damp`, for compiled callers."""
        return self._figures, self._gains, self._coherence, self._state, self._positions_m

    def reset(self) -> None:
        """The web is strained as upstream, and at rest (drives off)."""
        self._coherence[:] = coherence_state(2)
        self._state[:] = 0.0
        self._state[_UNSTRETCHED_M] = self._plant.span_length_m / (1.0 + self._plant.upstream_strain)
        self._state[_STRAIN] = self._plant.upstream_strain

    def use_modulus(self, modulus_Pa: float) -> None:
        """E that the gains follow from now on."""
        if _has_changed(self._figures, modulus_Pa):
            self._use(modulus_Pa)

    def _use(self, modulus_Pa: float) -> None:
        self._figures[_MODULUS_PA] = modulus_Pa
        gains = damping_gains(self._plant, self._ratio, modulus_Pa)
        self._gains[:_GAINS] = gains.rate, gains.elongation_per_s, gains.washout_per_s, len(gains.pending)
        self._gains[_GAINS : _GAINS + len(gains.pending)] = gains.pending

    def velocity(self, x1_m: float, x2_m: float, planned_m_s: float = 0.0) -> float:
        """Correction to add to the velocity of axis 1, from the encoder positions at the web; `planned_m_s`: planned
        lengthening of the span in them, which is no swing.

        While the positions are not of one instant it keeps its last value.
        """
        _POSITIONS.pack_into(self._positions_m.data, 0, x1_m, x2_m)
        return _damp(self._figures, self._gains, self._coherence, self._state, self._positions_m, planned_m_s)
