"""What a tension loop does ahead of its controller, from what the twin knows: so that a span's set-point, the strain
that comes into it and the line's speed do not have to become an error first, and neighbours notice nothing.

Mass conservation in span j, solved for the speed of the roller before it at the wanted strain ε and its rate:

    v_j = (v_{j+1} - L·ε'/(1 + ε)) · (1 + ε_{j-1}) / (1 + ε),   ε = F/(E·S)
    v_j = v_{j+1} · (1 + ε) / (1 + ε_{j+1}) - L·ε'/(1 + ε)      in reverse

with E and the strain of the span that the web comes from as the twin has them; ε is on its way to that of the
set-point. That roller is also the one behind span j - 1: the rollers before it take their speeds from its command by
the ratios of their own spans, so what is corrected in one span is passed on to all rollers on the side away from the
master speed, and only there.

A roller held by a velocity loop u → kp·(u - v) + ki·∫(u - v) gives way to a force until the integral has taken it up.
For a force f that is known (m·a at a ramp, the difference of the wanted tensions, with what a change of E that the twin
has found makes of them) the command that keeps v as planned leads it by (f - f')/kp, f' being f behind a lag of kp/ki.
The last roller is told the line's speed and no more: by what it gives way the others are told to go with it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import exp
from typing import Protocol

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

#: Way of a set-point: rate of the three equal poles, times the rise time; 2 % are left then.
_POLES = 7.5
#: Share of a motor's greatest torque that is asked of it ahead.
_TORQUE_SHARE = 0.5
#: Cycles from a command to the sample that shows what the axes have made of it.
_SHOWN_CYCLES = 2


def way_per_s(rise_s: float) -> float:
    """Rate of the three equal poles of a way, of which 98 % are made in `rise_s`."""
    return _POLES / rise_s


class StrainWay:
    """The strain wanted in a span, on its smooth way to what the set-point asks for at the present E.

    Three equal poles; `rise_s`: until 98 % of a step are made. A change of E moves the goal, and leaves the strain of
    the moment, as it leaves that of the web: what the controller sees is how far the web is from its way back.
    """

    def __init__(self, rise_s: float, cycle_s: float, length_m: float, section_m2: float) -> None:
        self._per_s = way_per_s(rise_s)
        self._cycle_s = cycle_s
        self._left = exp(-self._per_s * cycle_s)
        self._length_m = length_m
        self._section_m2 = section_m2
        self.reset(0.0)

    def reset(self, strain: float) -> None:
        """At rest there."""
        self._strain = strain
        self._rate_per_s = self._bend_per_s2 = 0.0
        self._shown_m_s = deque([0.0] * _SHOWN_CYCLES, _SHOWN_CYCLES)

    def update(self, goal_N: float, modulus_Pa: float) -> None:
        """One cycle towards the goal."""
        stiffness_N, w, duration_s = modulus_Pa * self._section_m2, self._per_s, self._cycle_s
        goal = goal_N / stiffness_N
        off = self._strain - goal
        slope = self._rate_per_s + w * off
        bend = 0.5 * (self._bend_per_s2 + 2.0 * w * self._rate_per_s + w * w * off)
        left = self._left
        off = (off + (slope + bend * duration_s) * duration_s) * left
        sloping = (slope + 2.0 * bend * duration_s) * left
        self._strain = goal + off
        self._rate_per_s = sloping - w * off
        self._bend_per_s2 = 2.0 * bend * left - 2.0 * w * sloping + w * w * off
        self._shown_m_s.append(self.lengthening_m_s)

    @property
    def lengthening_m_s(self) -> float:
        """L·ε'."""
        return self._length_m * self._rate_per_s

    @property
    def shown_m_s(self) -> float:
        """That which the last sample is to show."""
        return self._shown_m_s[0]

    @property
    def lengthening_m_s2(self) -> float:
        """L·ε''."""
        return self._length_m * self._bend_per_s2

    def tension_N(self, modulus_Pa: float) -> float:
        """What is wanted at this moment."""
        return self._strain * modulus_Pa * self._section_m2

    def velocity(self, behind_m_s: float, entering_strain: float) -> float:
        """Of the axis before the span by mass conservation, from that of the axis behind it and the strain that
        enters, in reverse that of the web behind the span."""
        wanted = 1.0 + self._strain
        if behind_m_s < 0.0:
            return behind_m_s * wanted / (1.0 + entering_strain) - self.lengthening_m_s / wanted
        return (behind_m_s - self.lengthening_m_s / wanted) * (1.0 + entering_strain) / wanted


class RollerForces:
    """By how much a roller's velocity command leads its planned speed, so that its drive has the torque in time.

    `kp_N_s_per_m`, `ki_N_per_m`: of its velocity loop, at the web; `limit_N`: the most that it is asked for ahead.
    """

    def __init__(self, mass_kg: float, kp_N_s_per_m: float, ki_N_per_m: float, limit_N: float, cycle_s: float) -> None:
        self._mass_kg = mass_kg
        self._kp_N_s_per_m = kp_N_s_per_m
        self._limit_N = limit_N
        # By this share the leads of a step sum up to what the integral of the drive is to be.
        self._share = min(cycle_s * ki_N_per_m / kp_N_s_per_m, 1.0) if kp_N_s_per_m > 0.0 else 0.0
        self._held_N: float | None = None

    @classmethod
    def of_model(cls, model: ModelParameters, axis: int, cycle_s: float) -> RollerForces:
        """Of an axis of a model with drives."""
        assert model.drives is not None, "a bench's model has drives"
        ratio = model.motor_rad_per_m(axis)
        kp = per_item(model.drives.velocity_kp_Nm_s_per_rad, axis) * ratio**2
        ki = per_item(model.drives.velocity_ki_Nm_per_rad, axis) * ratio**2
        limit_N = _TORQUE_SHARE * per_item(model.drives.torque_limit_Nm, axis) * ratio
        return cls(model.mass_kg(axis), kp, ki, limit_N, cycle_s)

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """Mass, kg, and kp, N·s/m, at the web; share of what the drive does not have yet that it takes up in a cycle;
        the most that is asked ahead, N."""
        return self._mass_kg, self._kp_N_s_per_m, self._share, self._limit_N

    def reset(self) -> None:
        """The drive's integral has what is there (drives off)."""
        self._held_N = None

    def lead_m_s(self, acceleration_m_s2: float, force_N: float) -> float:
        """What to add to the command, from the planned acceleration and what pulls the roller back, N at the web."""
        if self._kp_N_s_per_m <= 0.0:
            return 0.0
        wanted_N = self._mass_kg * acceleration_m_s2 + force_N
        held_N = wanted_N if self._held_N is None else self._held_N
        ahead_N = min(max(wanted_N - held_N, -self._limit_N), self._limit_N)
        self._held_N = held_N + self._share * (wanted_N - held_N)
        return ahead_N / self._kp_N_s_per_m


class Goal(Protocol):
    """Something that keeps a tension."""

    @property
    def goal_N(self) -> float:
        """What it is to be."""

    @property
    def modulus_Pa(self) -> float:
        """E of the web there, as far as it is known."""


class FeedForwardTask(CyclicTask):
    """The plan of a cycle, before any axis is told its speed: ways of the set-points, and what leads each roller needs.

    `loops`: what keeps the tensions, by the number of the span, also those that are added later; `ways`: of those spans
    that have one. The others count as of a tension that does not change.
    """

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        line_speed: Reference,
        loops: Mapping[int, Goal],
        ways: Mapping[int, StrainWay],
    ) -> None:
        self._cycle_s = cycle_s
        self._line_speed = line_speed
        self._speed_m_s = 0.0
        self._loops, self._ways = loops, ways
        self._upstream_strain = model.upstream_strain
        for way in ways.values():
            way.reset(self._upstream_strain)
        axes = range(model.axis_count, 0, -1)
        self._rollers = {axis: RollerForces.of_model(model, axis, cycle_s) for axis in axes}
        self._pulled = {
            axis: tuple((span, sign) for span, sign in ((axis - 1, 1.0), (axis, -1.0)) if span in ways)
            for axis in axes
            if model.carries_web_load(axis)
        }
        self._leads_m_s = dict.fromkeys(axes, 0.0)

    def lead_m_s(self, axis: int) -> float:
        """What the command of an axis has more than its planned speed, in this cycle."""
        return self._leads_m_s[axis]

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """One cycle further."""
        for span, way in self._ways.items():
            way.update(self._loops[span].goal_N, self._loops[span].modulus_Pa)
        speed_m_s = self._line_speed.present
        acceleration_m_s2 = (speed_m_s - self._speed_m_s) / self._cycle_s
        self._speed_m_s = speed_m_s
        for axis, roller in self._rollers.items():
            if axis in self._ways:
                acceleration_m_s2 -= self._ways[axis].lengthening_m_s2
            pull_N = 0.0
            for span, sign in self._pulled.get(axis, ()):
                pull_N += sign * self._ways[span].tension_N(self._loops[span].modulus_Pa)
            self._leads_m_s[axis] = roller.lead_m_s(acceleration_m_s2, pull_N)
        leading_m_s = next(iter(self._leads_m_s.values()))
        for axis in self._leads_m_s:
            self._leads_m_s[axis] -= leading_m_s

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Nothing turns: the web is strained as upstream, and the ways begin there."""
        self._speed_m_s = self._line_speed.present
        for way in self._ways.values():
            way.reset(self._upstream_strain)
        for axis, roller in self._rollers.items():
            roller.reset()
            self._leads_m_s[axis] = 0.0
