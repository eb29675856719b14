"""How far a machine has to follow measured axes: cycles are counted by way and speed, where the axes turn.

Of a drive that has missed a SYNC, or of a SYNC that was sent late, no frame says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from struct import pack_into
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import FLAG, VECTOR, compiled, entry_point
from hilbench.cycle_program import CompiledStage
from hilbench.plant import sample_coherence
from hilbench.plant.sample_coherence import SampleCoherence, Vector, coherent, own_travels

#: So many cycles that a sample is late by are made good by prediction; an older one has too little in it.
MOST_PREDICTED_CYCLES = 3.0
#: A sample that is not whole cycles after the last one is so many parts of a cycle after it.
_PARTS = 1000.0
#: What `elapsed_s` goes by: which travel shows cycles, in the unit of the positions; a cycle, s; the axis that is
#: counted by, from 0; cycles since the instant of the positions that the machine is at; that axis' position and speed
#: there; how much later torques act, s; whether the axes travel independently, which shows it all.
_LEAST_TRAVEL, _CYCLE_S, _AXIS, _BEHIND, _POSITION, _SPEED, _LEAD_S, _OWN, _SIZE = range(9)


@compiled
def _own_elapsed_s(m: Vector, travels: Vector, positions: Vector, late: bool) -> float:
    gone = 0.0
    if late:
        sample_coherence.miss_own(travels)
    elif own_travels(travels, positions):
        gone = travels[sample_coherence.OWN_GONE]
    m[_BEHIND] = travels[sample_coherence.OWN_BEHIND]
    return float(gone * m[_CYCLE_S])


@compiled
def elapsed_s(m: Vector, travels: Vector, positions: Vector, speeds: Vector, late: bool) -> float:
    """A cycle on, with these positions and speeds (N,): the time in s by which the machine has to follow; 0 where they
    are not of one instant (`travels`: of `coherent`, or `own_travels`), `late`, or of the instant it is at already."""
    if m[_OWN] != 0.0:
        return _own_elapsed_s(m, travels, positions, late)
    m[_BEHIND] += 1.0
    if late:
        sample_coherence.miss(travels)
        return 0.0
    if not coherent(travels, positions, m[_LEAST_TRAVEL]):
        return 0.0
    axis, cycle_s = int(m[_AXIS]), m[_CYCLE_S]
    travel, of_a_cycle = positions[axis] - m[_POSITION], 0.5 * (speeds[axis] + m[_SPEED]) * cycle_s
    if abs(of_a_cycle) <= m[_LEAST_TRAVEL]:
        cycles = max(m[_BEHIND], 1.0)
        duration_s = cycles * cycle_s
    else:
        parts = max(np.rint(_PARTS * travel / of_a_cycle), 0.0) if np.isfinite(travel / of_a_cycle) else _PARTS
        cycles = np.rint(parts / _PARTS)
        whole = cycles == 0.0 or abs(travel - cycles * of_a_cycle) <= m[_LEAST_TRAVEL]
        duration_s = (cycles if whole else parts / _PARTS) * cycle_s
    m[_SPEED] = speeds[axis]
    # One cycle ahead of what is counted there may be: a SYNC that was sent late, and the next one on time.
    m[_BEHIND] = max(m[_BEHIND] - cycles, 0.0 if cycles == 1.0 else -1.0)
    if cycles == 0.0:
        return 0.0
    m[_POSITION] = positions[axis]
    return float(duration_s)


@compiled
def ahead_s(m: Vector) -> float:
    """By how much the machine is to be predicted: until torques act, and over what the sample is late by."""
    return float(m[_LEAD_S] + min(max(m[_BEHIND], 0.0), MOST_PREDICTED_CYCLES) * m[_CYCLE_S])


@compiled
def take(values: Vector, at: NDArray[np.int64], positions: Vector, speeds: Vector) -> None:
    """What `InStep.follow` is given, from `values`: positions (N,), then speeds (N,), at the first places."""
    count = len(positions)
    for k in range(count):
        positions[k], speeds[k] = values[at[k]], values[at[count + k]]


@compiled
def publish(values: Vector, at: NDArray[np.int64], torques: Vector, shown: Vector) -> None:
    """What it puts behind them, into `values`: torques (M,), then pairs of a place there and one of those shown."""
    for k in range(len(torques)):
        values[at[k]] = torques[k]
    for k in range(len(torques), len(at), 2):
        values[at[k]] = shown[at[k + 1]]


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, FLAG)
def _gone(m: Vector, travels: Vector, positions: Vector, speeds: Vector, late: bool) -> float:
    return elapsed_s(m, travels, positions, speeds, late)


@entry_point(VECTOR)
def _ahead(m: Vector) -> float:
    return ahead_s(m)


class MeasuredMotion:
    """The motion of N axes, from cycle to cycle.

    `counted`: the axis, from 0, whose way counts cycles; `lead_s`: how much later than it was measured what follows
    from it acts; `least_travel`, in the unit of the positions: what is measured well enough to count cycles by it;
    `own_play`: of axes that go ways of their own, by how much that of a cycle may differ from the one before.
    """

    def __init__(
        self, axes: int, counted: int, cycle_s: float, lead_s: float, least_travel: float, own_play: float | None = None
    ) -> None:
        self.state = np.zeros(_SIZE)  #: of `elapsed_s`
        self.state[[_LEAST_TRAVEL, _CYCLE_S, _AXIS, _LEAD_S]] = least_travel, cycle_s, counted, lead_s
        self.state[_OWN] = own_play is not None
        self._pairing = SampleCoherence(least_travel)
        self.travels, self.positions = self._pairing.vectors(axes)
        if own_play is not None:
            self.travels = sample_coherence.own_travels_state(axes, own_play)
        self.speeds = np.zeros(axes)
        self._format = f"={axes}d"

    def begin(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """The machine is at these positions."""
        if self.state[_OWN]:
            sample_coherence.forget_own_travels(self.travels)
            self.elapsed_s(positions, speeds, late=False)
        else:
            self._pairing.reset()
            self._pairing.update(*positions)
        axis = int(self.state[_AXIS])
        self.state[[_BEHIND, _POSITION, _SPEED]] = 0.0, positions[axis], speeds[axis]

    def elapsed_s(self, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> float:
        """`elapsed_s` with these, which are measured now."""
        pack_into(self._format, self.positions.data, 0, *positions)
        pack_into(self._format, self.speeds.data, 0, *speeds)
        return _gone(self.state, self.travels, self.positions, self.speeds, late)

    @property
    def ahead_s(self) -> float:
        """By how much the machine is to be predicted."""
        return _ahead(self.state)


class HasFollowed(Enum):
    """What a follower has done of a cycle."""

    NOT = 0  #: it is as it was, as there is nothing to follow
    TORQUES = 1  #: followed, and told torques alone
    ALL = 2


class InStep(Protocol):
    """A follower with what counts its cycles: all of a cycle in one call."""

    @property
    def usable(self) -> bool:
        """Whether it goes on so as it is now."""

    @property
    def torques_Nm(self) -> list[float]:
        """Of the load motors (M,), as it has followed last."""

    def follow(self, values: Vector, places: NDArray[np.int64], *, late: bool) -> HasFollowed:
        """Let it follow, by `elapsed_s`, positions (N,) and speeds (N,) at the first places of `values`, and put there
        torques of the load motors (M,), N·m, predicted by `ahead_s`, at the next ones, then what it is now: a place,
        and which output of its description, of each that is asked for."""

    @property
    def is_shown(self) -> bool:
        """Whether nothing was changed since it has followed last."""

    def piece(self, values: Vector, places: NDArray[np.int64], fallback: Callable[[int], bool]) -> CompiledStage:
        """The same as a piece of a cycle with samples that are not late, of which all but ALL is `fallback`."""

    def has_followed(self, code: int) -> HasFollowed:
        """What the piece has done where it has returned this."""


@runtime_checkable
class FollowsInStep(Protocol):
    """A `hilbench.plant.interface.Follower` that can do so."""

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> InStep:
        """With this motion, and load motors on `axes`, counted from 1."""
