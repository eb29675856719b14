"""Feed-forward of a tension loop from the twin's estimates: a span's set-point, the strain
that comes into it and the line's speed need not become an error first, and neighbours are not disturbed.

Mass conservation in span j, solved for the speed of the roller before it at the wanted strain ε and its rate:

    v_j = (v_{j+1} - L·ε'/(1 + ε)) · (1 + ε_{j-1}) / (1 + ε),   ε = F/(E·S)
    v_j = v_{j+1} · (1 + ε) / (1 + ε_{j+1}) - L·ε'/(1 + ε)      in reverse

with E and the strain of the span that the web comes from as the twin has them; ε is on its way to that of the
set-point. That roller is also the one after span j - 1: the rollers before it take their speeds from its command by
the ratios of their own spans, so a correction in one span is passed on to all rollers on the side away from the
master speed, and only there.

A roller held by a velocity loop u → kp·(u - v) + ki·∫(u - v) gives way to a force until the integral has taken it up.
For a force f that is known (m·a at a ramp, the difference of the wanted tensions, with what a change of E that the twin
has found makes of them) the command that keeps v as planned leads it by (f - f')/kp, f' being f behind a lag of kp/ki.
The last roller gets the line's speed only: the others are commanded to follow its compliance.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import nan
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CompiledStages, CyclicTask, Outputs
from hilbench.bench.tasks.tension_cycle import MODULUS_PA, SET_POINT_N, SHIFT_N
from hilbench.bench.tasks.web_strain_trajectory import (
    StrainTrajectory,
    lengthening_m_s2,
    trajectory_tension_N,
    trajectory_update,
)
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    floats,
    interpreted,
    table_of,
)
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

Vector = NDArray[np.float64]
Table = NDArray[np.int64]

#: Share of a motor's greatest torque that feed-forward may use.
_TORQUE_SHARE = 0.5
#: A roller: mass, kg, and kp, N·s/m, at the web; share of the missing torque that the drive takes up in a
#: cycle; feed-forward limit, N; force that its drive has, N (NaN: unknown); place of its axis among the
#: leads, of its own trajectory (NOWHERE: none), and of those of the spans that pull it back and forward.
_MASS_KG, _KP_N_S_PER_M, _SHARE, _LIMIT_N, _HELD_N, _AXIS, _OWN_TRAJECTORY, _PULLED_BACK, _PULLED_ON, _ROLLER = range(
    10
)
NOWHERE = -1
# Rows of the table; after them, for each trajectory, its vector and that of its loop.
_ROLLERS, _LEADS_M_S, _LINE_SPEED, _OWN, _TRAJECTORIES = range(5)
#: Vector of the task: a cycle, s, and the line's speed in the last one.
_CYCLE_S, _SPEED_M_S = range(2)


@compiled
def _lead_m_s(r: Vector, acceleration_m_s2: float, force_N: float) -> float:
    """Velocity lead of a roller (`RollerForces.lead_m_s`)."""
    if r[_KP_N_S_PER_M] <= 0.0:
        return 0.0
    wanted_N = r[_MASS_KG] * acceleration_m_s2 + force_N
    held_N = wanted_N if np.isnan(r[_HELD_N]) else r[_HELD_N]
    ahead_N = min(max(wanted_N - held_N, -r[_LIMIT_N]), r[_LIMIT_N])
    r[_HELD_N] = held_N + r[_SHARE] * (wanted_N - held_N)
    return float(ahead_N / r[_KP_N_S_PER_M])


@compiled
def _pull_N(table: Table, trajectory: float, sign: float) -> float:
    """Pull of a span's wanted tension; 0 without a trajectory."""
    if trajectory < 0.0:
        return 0.0
    row = _TRAJECTORIES + 2 * int(trajectory)
    return sign * trajectory_tension_N(floats(table, row, (1,)), floats(table, row + 1, (1,))[MODULUS_PA])


@entry_point(COUNT, TABLE)
def _plan(_: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    for row in range(_TRAJECTORIES, len(table), 2):
        loop = floats(table, row + 1, (1,))
        trajectory_update(floats(table, row, (1,)), loop[SET_POINT_N] + loop[SHIFT_N], loop[MODULUS_PA])
    own, rollers, leads_m_s = (
        floats(table, _OWN, (1,)),
        floats(table, _ROLLERS, (1, 2)),
        floats(table, _LEADS_M_S, (1,)),
    )
    speed_m_s = floats(table, _LINE_SPEED, (1,))[0]
    acceleration_m_s2 = (speed_m_s - own[_SPEED_M_S]) / own[_CYCLE_S]
    own[_SPEED_M_S] = speed_m_s
    for k in range(len(rollers)):
        roller = rollers[k]
        if roller[_OWN_TRAJECTORY] >= 0.0:
            acceleration_m_s2 -= lengthening_m_s2(floats(table, _TRAJECTORIES + 2 * int(roller[_OWN_TRAJECTORY]), (1,)))
        pull_N = 0.0
        pull_N += _pull_N(table, roller[_PULLED_BACK], 1.0)
        pull_N += _pull_N(table, roller[_PULLED_ON], -1.0)
        leads_m_s[int(roller[_AXIS])] = _lead_m_s(roller, acceleration_m_s2, pull_N)
    leading_m_s = leads_m_s[int(rollers[0, _AXIS])]
    for k in range(len(leads_m_s)):
        leads_m_s[k] -= leading_m_s
    return CONTINUE


_lead_once = interpreted(_lead_m_s)


class RollerForces:
    """Lead of a roller's velocity command over its planned speed, so that its drive has the torque in time.

    `kp_N_s_per_m`, `ki_N_per_m`: of its velocity loop, at the web; `limit_N`: feed-forward limit.
    """

    def __init__(self, mass_kg: float, kp_N_s_per_m: float, ki_N_per_m: float, limit_N: float, cycle_s: float) -> None:
        # With this share the leads of a step sum up to the final integral of the drive.
        share = min(cycle_s * ki_N_per_m / kp_N_s_per_m, 1.0) if kp_N_s_per_m > 0.0 else 0.0
        self.vector = np.full(_ROLLER, float(NOWHERE))  #: as above
        self.vector[: _LIMIT_N + 1] = mass_kg, kp_N_s_per_m, share, limit_N
        self.reset()

    @classmethod
    def of_model(cls, model: ModelParameters, axis: int, cycle_s: float) -> RollerForces:
        """Lead of an axis of a model with drives."""
        assert model.drives is not None, "a bench's model has drives"
        ratio = model.motor_rad_per_m(axis)
        kp = per_item(model.drives.velocity_kp_Nm_s_per_rad, axis) * ratio**2
        ki = per_item(model.drives.velocity_ki_Nm_per_rad, axis) * ratio**2
        limit_N = _TORQUE_SHARE * per_item(model.drives.torque_limit_Nm, axis) * ratio
        return cls(model.mass_kg(axis), kp, ki, limit_N, cycle_s)

    @property
    def figures(self) -> tuple[float, float, float, float]:
        """Mass, kg, and kp, N·s/m, at the web; share of the missing torque that the drive takes up in a cycle;
        feed-forward limit, N."""
        mass_kg, kp_N_s_per_m, share, limit_N = self.vector[: _LIMIT_N + 1].tolist()
        return mass_kg, kp_N_s_per_m, share, limit_N

    def reset(self) -> None:
        """The drive's integral has what is there (drives off)."""
        self.vector[_HELD_N] = nan

    def lead_m_s(self, acceleration_m_s2: float, force_N: float) -> float:
        """Lead to add to the command, from the planned acceleration and the force that pulls it back, N at the web."""
        return _lead_once(self.vector, acceleration_m_s2, force_N)


class Goal(Protocol):
    """Something that keeps a tension."""

    @property
    def loop(self) -> Vector:
        """Vector of the loop as in `tension_cycle`: wanted tension, and E of the web there."""


class FeedForwardTask(CyclicTask):
    """Feed-forward plan of a cycle, before any speed command: set-point trajectories, and leads of the rollers.

    `loops`: tension loops by the number of the span, also those added later; `trajectories`: trajectories of those
    spans that have one. The others count as having a constant tension.
    """

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        line_speed: Reference,
        loops: Mapping[int, Goal],
        trajectories: Mapping[int, StrainTrajectory],
    ) -> None:
        self._line_speed = line_speed
        self._loops, self._trajectories = loops, trajectories
        self._upstream_strain = model.upstream_strain
        self._own, self._leads_m_s = np.array([cycle_s, 0.0]), np.zeros(model.axis_count)
        for trajectory in trajectories.values():
            trajectory.reset(self._upstream_strain)
        self._rollers = np.array([self._roller(model, axis, cycle_s) for axis in range(model.axis_count, 0, -1)])
        self._piece: CompiledStage | None = None
        _plan(0, np.zeros((0, TABLE_WIDTH), np.int64))  # compiled, or loaded, before a cycle waits for it

    def _roller(self, model: ModelParameters, axis: int, cycle_s: float) -> Vector:
        place = {span: at for at, span in enumerate(self._trajectories)}
        roller = RollerForces.of_model(model, axis, cycle_s).vector
        roller[_AXIS], roller[_OWN_TRAJECTORY] = axis - 1, place.get(axis, NOWHERE)
        if model.carries_web_load(axis):
            roller[_PULLED_BACK], roller[_PULLED_ON] = place.get(axis - 1, NOWHERE), place.get(axis, NOWHERE)
        return roller

    def lead(self, axis: int) -> Vector:
        """Lead of an axis's command over its planned speed in this cycle, m/s (1,)."""
        return self._leads_m_s[axis - 1 : axis]

    @property
    def piece(self) -> CompiledStage:
        """Compiled stage: advance the plan by a cycle."""
        if self._piece is None:
            kept = [self._rollers, self._leads_m_s, self._line_speed.vector, self._own]
            for span, trajectory in self._trajectories.items():
                kept += [trajectory.vector, self._loops[span].loop]
            self._piece = CompiledStage(_plan, 0, table_of(kept), fallback=never, keeps=kept)
        return self._piece

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Advance the plan by a cycle."""
        self.piece()

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage that makes the plan of a cycle."""
        return CompiledStages(before=[self.piece])

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Reset at rest: the web is strained as upstream, and the trajectories begin there."""
        self._own[_SPEED_M_S] = self._line_speed.present
        for trajectory in self._trajectories.values():
            trajectory.reset(self._upstream_strain)
        self._rollers[:, _HELD_N] = nan
        self._leads_m_s[:] = 0.0
