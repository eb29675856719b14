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

from dataclasses import asdict, dataclass
from math import ceil, cos, exp, sin, sqrt
from typing import Any

import numpy as np

from hilbench.compiled import Vector, compiled, interpreted, record_at, record_type, viewed
from hilbench.plant.parameters import per_item
from hilbench.plant.sample_coherence import coherence_state, coherent
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_travel_m

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


DAMPING = record_type(
    "damping_ratio",
    # As of `SwingPlant`.
    "span_length_m",
    "section_m2",
    "upstream_strain",
    "downstream_strain",
    "mass1_kg",
    "mass2_kg",
    "velocity_kp1_N_s_per_m",
    "velocity_kp2_N_s_per_m",
    "cycle_s",
    "least_travel_m",
    "delay_s",
    "limit_m_s",  # of the command
    # Gains: u = rate·r + elongation·y + Σ pending_j·u of j cycles before; y: the sum of r·T that fades with `washout`.
    "modulus_Pa",  # E that they are for
    "rate",
    "elongation_per_s",
    "washout_per_s",
    # State.
    "cycles",  # since the last positions that were taken
    "has_positions",
    "x1_m",
    "x2_m",
    "unstretched_m",  # length of the web in the span
    "strain",
    "elongation_m",
)
#: Pairs behind the record: gain of a command under way and the command, m/s, the last one first.
PENDING = DAMPING.itemsize // 8


@compiled
def set_gains(d: Any, pending: Vector, modulus_Pa: float) -> None:
    """Set the gains that give the swing its damping ratio, as far as the drive of axis 2 does not by itself."""
    kp1 = d.velocity_kp1_N_s_per_m
    omega = sqrt(modulus_Pa * d.section_m2 / d.span_length_m / d.mass2_kg)
    per_s = max(2.0 * d.damping_ratio * omega - d.velocity_kp2_N_s_per_m / d.mass2_kg, 0.0) if kp1 > 0.0 else 0.0
    d.modulus_Pa, d.rate, d.elongation_per_s, d.washout_per_s = modulus_Pa, 0.0, 0.0, _WASHOUT * omega
    for k in range(0, len(pending), 2):
        pending[k] = 0.0
    if per_s == 0.0:
        return
    lag_s = d.mass1_kg / kp1
    c, s = cos(omega * d.delay_s), sin(omega * d.delay_s)
    d.rate = per_s * (lag_s * c + s / omega)
    d.elongation_per_s = per_s * (c - lag_s * omega * s)
    moved = 1.0 - exp(-d.cycle_s / lag_s)  # of a command, by axis 1 in a cycle
    for k in range(len(pending) // 2):  # shares that act after the measurement and before the new command
        pending[2 * k] = -per_s * lag_s * moved * min(max(d.delay_s / d.cycle_s - 0.5 - k, 0.0), 1.0)


@compiled
def follow_modulus(damping: Vector, modulus_Pa: float) -> None:
    """Set the gains again where E has changed."""
    d = viewed(damping, DAMPING)[0]
    if abs(modulus_Pa / d.modulus_Pa - 1.0) > _WORTH_CHANGING:
        set_gains(d, damping[PENDING:], modulus_Pa)


@compiled
def _elongated_m(d: Any, travel1_m: float, travel2_m: float) -> float:
    """Elongation of the span's web, ΔL = L·Δε, by mass conservation of unstretched length: in at roller 1 and out at 2,
    reversed in reverse. The balance forgets an error of the strain within L/v.
    """
    strain = d.strain
    came_in_m = travel1_m / (1.0 + (d.upstream_strain if travel1_m >= 0.0 else strain))
    went_out_m = travel2_m / (1.0 + (strain if travel2_m >= 0.0 else d.downstream_strain))
    d.unstretched_m += came_in_m - went_out_m
    d.strain = d.span_length_m / d.unstretched_m - 1.0
    return float(d.span_length_m * (d.strain - strain))


@compiled
def damp(damping: Vector, rate_m_s: float, cycles: float) -> float:
    """Correction to add to the velocity of axis 1, m/s, from the rate r of the span's lengthening in the last
    `cycles`."""
    d, pending = viewed(damping, DAMPING)[0], damping[PENDING:]
    d.elongation_m *= exp(-d.washout_per_s * cycles * d.cycle_s)
    d.elongation_m += rate_m_s * cycles * d.cycle_s
    command = d.rate * rate_m_s + d.elongation_per_s * d.elongation_m
    for k in range(0, len(pending), 2):
        command += pending[k] * pending[k + 1]
    if -d.limit_m_s > command:
        command = -d.limit_m_s
    if d.limit_m_s < command:
        command = d.limit_m_s
    for k in range(len(pending) - 1, 1, -2):
        pending[k] = pending[k - 2]
    pending[1] = command
    return float(command)


@compiled
def damp_measured(damping: Vector, coherence: Vector, positions_m: Vector, planned_m_s: float) -> float:
    """`damp` by the encoders' positions at the web (2,), with a state of `coherent`; `planned_m_s`: planned lengthening
    of the span in them, which is no swing.

    While the positions are not of one instant it keeps its last value.
    """
    d = viewed(damping, DAMPING)[0]
    d.cycles += 1.0
    if not coherent(coherence, positions_m, d.least_travel_m):
        return float(damping[PENDING + 1])
    travel1_m, travel2_m, cycles = positions_m[0] - d.x1_m, positions_m[1] - d.x2_m, d.cycles
    had_positions = d.has_positions != 0.0
    d.x1_m, d.x2_m, d.cycles, d.has_positions = positions_m[0], positions_m[1], 0.0, 1.0
    if not had_positions:
        return 0.0
    rate_m_s = _elongated_m(d, travel1_m, travel2_m) / (cycles * d.cycle_s)
    return damp(damping, rate_m_s - planned_m_s, cycles)


_set_gains = interpreted(set_gains)


class SwingDamping:
    """Correction of axis 1's velocity command, cycle by cycle; m/s at the web.

    It needs no twin: strain and its rate come from the encoders, by mass conservation. `modulus_Pa`: E at the start.
    """

    def __init__(self, plant: SwingPlant, damping_ratio: float, modulus_Pa: float) -> None:
        commands = ceil(plant.delay_s / plant.cycle_s - 0.5)
        self.vector = np.zeros(PENDING + 2 * commands)  #: a `DAMPING`, and the pairs behind it
        self.record, self.pending = record_at(self.vector, DAMPING), self.vector[PENDING:]
        self.coherence, self.positions_m = coherence_state(2), np.zeros(2)  #: of `damp_measured`
        given = asdict(plant) | {"delay_s": plant.delay_s, "limit_m_s": plant.limit_m_s, "damping_ratio": damping_ratio}
        for name in given.keys() & set(DAMPING.names or ()):
            self.record[name] = given[name]
        _set_gains(self.record, self.pending, modulus_Pa)
        self.reset()

    def reset(self) -> None:
        """The web is strained as upstream, and at rest (drives off)."""
        self.coherence[:] = coherence_state(2)
        d = self.record
        d.cycles = d.has_positions = d.elongation_m = self.pending[1::2] = 0.0
        d.unstretched_m, d.strain = d.span_length_m / (1.0 + d.upstream_strain), d.upstream_strain
