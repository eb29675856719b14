"""Time by which a machine has to follow measured axes: cycles are counted by travel and speed, where the axes turn.

No frame shows that a drive has missed a SYNC, or that a SYNC was sent late.
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

#: Largest delay of a sample, in cycles, that is compensated by prediction; an older one has too little information.
MOST_PREDICTED_CYCLES = 3.0
#: Resolution, in parts of a cycle, of a sample's time when it is not whole cycles after the last one.
_PARTS = 1000.0
#: State of `elapsed_s`: least travel that shows cycles, in the unit of the positions; a cycle, s; index of the counting
#: axis; cycles since the instant of the machine's positions; that axis's position and speed there; dead time of the
#: torques, s; whether the axes travel independently, and all of them are used.
_LEAST_TRAVEL, _CYCLE_S, _AXIS, _BEHIND, _POSITION, _SPEED, _LEAD_S, _OWN, _SIZE = range(9)


@compiled
def _own_elapsed_s(m: Vector, travels: Vector, positions: Vector, late: bool) -> float:
    elapsed = 0.0
    if late:
        sample_coherence.miss_own(travels)
    elif own_travels(travels, positions):
        elapsed = travels[sample_coherence.OWN_ELAPSED]
    m[_BEHIND] = travels[sample_coherence.OWN_BEHIND]
    return float(elapsed * m[_CYCLE_S])


@compiled
def elapsed_s(m: Vector, travels: Vector, positions: Vector, speeds: Vector, late: bool) -> float:
    """Advance a cycle with these positions and speeds (N,): time in s by which the machine has to follow; 0 if they are
    incoherent (`travels`: of `coherent`, or `own_travels`), `late`, or of the machine's present instant."""
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
    # Up to one cycle ahead of the count: a SYNC that was sent late, and the next one on time.
    m[_BEHIND] = max(m[_BEHIND] - cycles, 0.0 if cycles == 1.0 else -1.0)
    if cycles == 0.0:
        return 0.0
    m[_POSITION] = positions[axis]
    return float(duration_s)


@compiled
def ahead_s(m: Vector) -> float:
    """Time by which the machine has to be predicted: dead time of the torques, and delay of the sample."""
    return float(m[_LEAD_S] + min(max(m[_BEHIND], 0.0), MOST_PREDICTED_CYCLES) * m[_CYCLE_S])


@compiled
def take(values: Vector, at: NDArray[np.int64], positions: Vector, speeds: Vector) -> None:
    """Read the input of `InStep.follow` from `values`: positions (N,), then speeds (N,), at the first offsets."""
    count = len(positions)
    for k in range(count):
        positions[k], speeds[k] = values[at[k]], values[at[count + k]]


@compiled
def publish(values: Vector, at: NDArray[np.int64], torques: Vector, shown: Vector) -> None:
    """Write its output into `values`: torques (M,), then pairs of an offset there and an index in `shown`."""
    for k in range(len(torques)):
        values[at[k]] = torques[k]
    for k in range(len(torques), len(at), 2):
        values[at[k]] = shown[at[k + 1]]


@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, FLAG)
def _elapsed(m: Vector, travels: Vector, positions: Vector, speeds: Vector, late: bool) -> float:
    return elapsed_s(m, travels, positions, speeds, late)


@entry_point(VECTOR)
def _ahead(m: Vector) -> float:
    return ahead_s(m)


class MeasuredMotion:
    """Motion of N axes, from cycle to cycle.

    `counted`: index of the axis whose travel counts cycles; `lead_s`: dead time from the measurement to its effect;
    `least_travel`, in the unit of the positions: least travel for counting cycles; `own_play`: of independent axes,
    largest change of a cycle's travel.
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
        """Start the machine at these positions."""
        if self.state[_OWN]:
            sample_coherence.forget_own_travels(self.travels)
            self.elapsed_s(positions, speeds, late=False)
        else:
            self._pairing.reset()
            self._pairing.update(*positions)
        axis = int(self.state[_AXIS])
        self.state[[_BEHIND, _POSITION, _SPEED]] = 0.0, positions[axis], speeds[axis]

    def elapsed_s(self, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> float:
        """`elapsed_s` for these new measurements."""
        pack_into(self._format, self.positions.data, 0, *positions)
        pack_into(self._format, self.speeds.data, 0, *speeds)
        return _elapsed(self.state, self.travels, self.positions, self.speeds, late)

    @property
    def ahead_s(self) -> float:
        """Time by which the machine has to be predicted."""
        return _ahead(self.state)


class HasFollowed(Enum):
    """Result of a follower's cycle."""

    NOT = 0  #: unchanged, as there is nothing to follow
    ALL = 1


class InStep(Protocol):
    """Follower with its cycle counting: all of a cycle in one call."""

    @property
    def usable(self) -> bool:
        """True if it can continue in its present state."""

    @property
    def torques_Nm(self) -> list[float]:
        """Torques of the load motors (M,), as of the last cycle."""

    def follow(self, values: Vector, places: NDArray[np.int64], *, late: bool) -> HasFollowed:
        """Follow, by `elapsed_s`, positions (N,) and speeds (N,) at the first offsets of `values`; write torques of the
        load motors (M,), N·m, predicted by `ahead_s`, at the next ones, then its outputs: pairs of an offset and an
        output index of its description."""

    @property
    def is_shown(self) -> bool:
        """True if nothing was changed since the last cycle."""

    def piece(self, values: Vector, places: NDArray[np.int64], fallback: Callable[[int], bool]) -> CompiledStage:
        """Compiled stage of `follow` with samples that are not late; results other than ALL go to `fallback`."""

    def has_followed(self, code: int) -> HasFollowed:
        """Result of a stage by its return code."""


@runtime_checkable
class FollowsInStep(Protocol):
    """`hilbench.plant.interface.Follower` with a compiled cycle."""

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> InStep:
        """Compiled follower of this motion, with load motors on `axes`, counted from 1."""
