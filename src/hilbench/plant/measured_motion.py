"""Time by which a machine has to follow measured axes: cycles are counted by travel and speed, where the axes turn.

No frame shows that a drive has missed a SYNC, or that a SYNC was sent late.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from enum import Enum
from struct import pack_into
from typing import Annotated, Any, Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    FLAG,
    TABLE_WIDTH,
    VECTOR,
    Reals,
    Record,
    Vector,
    compiled,
    entry_point,
    interpreted,
    record_at,
    record_in,
    record_type,
    table_of,
)
from hilbench.cycle_program import CompiledStage, Function
from hilbench.plant import sample_coherence
from hilbench.plant.sample_coherence import COHERENCE, OWN, SampleCoherence, coherent, own_travels

#: Largest delay of a sample, in cycles, that is compensated by prediction; an older one has too little information.
MOST_PREDICTED_CYCLES = 3.0
#: Resolution, in parts of a cycle, of a sample's time when it is not whole cycles after the last one.
_PARTS = 1000.0
#: State of `elapsed_s`: least travel that shows cycles, in the unit of the positions; a cycle, s; index of the counting
#: axis; cycles since the instant of the machine's positions; that axis's position and speed there; dead time of the
#: torques, s; whether the axes travel independently, and all of them are used.
MOTION: Final = record_type(*("least_travel", "cycle_s", "axis", "behind", "position", "speed", "lead_s", "own"))


class MotionVectors(NamedTuple):
    """Vectors of a `MeasuredMotion`, for compiled callers: travels as of `elapsed_s`, positions (N,)."""

    state: Annotated[Any, MOTION]
    travels: Reals
    positions: Reals


@compiled
def elapsed_s(m: Record, travels: Vector, positions: Vector, speeds: Vector, late: bool) -> float:
    """Advance a cycle with these positions and speeds (N,): time in s by which the machine has to follow; 0 if they are
    incoherent (`travels`: of `coherent`, or `own_travels`), `late`, or of the machine's present instant."""
    if m.own != 0.0:
        own, elapsed = record_in(travels, 0, OWN), 0.0
        if late:
            own.since, own.behind = own.since + 1.0, own.behind + 1.0
        elif own_travels(travels, positions):
            elapsed = own.elapsed
        m.behind = own.behind
        return float(elapsed * m.cycle_s)
    m.behind += 1.0
    if late:
        pairs = record_in(travels, 0, COHERENCE)
        pairs.cycles, pairs.since = pairs.cycles + 1.0, pairs.since + 1.0
        return 0.0
    if not coherent(travels, positions, m.least_travel):
        return 0.0
    axis, cycle_s = int(m.axis), m.cycle_s
    travel, of_a_cycle = positions[axis] - m.position, 0.5 * (speeds[axis] + m.speed) * cycle_s
    if abs(of_a_cycle) <= m.least_travel:
        cycles = max(m.behind, 1.0)
        duration_s = cycles * cycle_s
    else:
        parts = max(np.rint(_PARTS * travel / of_a_cycle), 0.0) if np.isfinite(travel / of_a_cycle) else _PARTS
        cycles = np.rint(parts / _PARTS)
        whole = cycles == 0.0 or abs(travel - cycles * of_a_cycle) <= m.least_travel
        duration_s = (cycles if whole else parts / _PARTS) * cycle_s
    m.speed = speeds[axis]
    # Up to one cycle ahead of the count: a SYNC that was sent late, and the next one on time.
    m.behind = max(m.behind - cycles, 0.0 if cycles == 1.0 else -1.0)
    if cycles == 0.0:
        return 0.0
    m.position = positions[axis]
    return float(duration_s)


@compiled
def ahead_s(m: Record) -> float:
    """Time by which the machine has to be predicted: dead time of the torques, and delay of the sample."""
    return float(m.lead_s + min(max(m.behind, 0.0), MOST_PREDICTED_CYCLES) * m.cycle_s)


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
    return elapsed_s(record_in(m, 0, MOTION), travels, positions, speeds, late)


_ahead = interpreted(ahead_s)


class MeasuredMotion:
    """Motion of N axes, from cycle to cycle.

    `counted`: index of the axis whose travel counts cycles; `lead_s`: dead time from the measurement to its effect;
    `least_travel`, in the unit of the positions: least travel for counting cycles; `own_play`: of independent axes,
    largest change of a cycle's travel.
    """

    def __init__(
        self, axes: int, counted: int, cycle_s: float, lead_s: float, least_travel: float, own_play: float | None = None
    ) -> None:
        self._pairing = SampleCoherence(least_travel)
        travels, positions = self._pairing.vectors(axes)
        if own_play is not None:
            travels = sample_coherence.own_travels_state(axes, own_play)
        given = least_travel, cycle_s, counted, 0.0, 0.0, 0.0, lead_s, float(own_play is not None)
        self.vectors = MotionVectors(np.array(given), travels, positions)
        self.speeds = np.zeros(axes)
        self._state = record_at(self.vectors.state, MOTION)
        self._format = f"={axes}d"

    def begin(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Start the machine at these positions."""
        state = self._state
        if state.own:
            sample_coherence.forget_own_travels(self.vectors.travels)
            self.elapsed_s(positions, speeds, late=False)
        else:
            self._pairing.reset()
            self._pairing.update(*positions)
        axis = int(state.axis)
        state.behind, state.position, state.speed = 0.0, positions[axis], speeds[axis]

    def elapsed_s(self, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> float:
        """`elapsed_s` for these new measurements."""
        pack_into(self._format, self.vectors.positions.data, 0, *positions)
        pack_into(self._format, self.speeds.data, 0, *speeds)
        return _elapsed(*self.vectors, self.speeds, late)

    @property
    def ahead_s(self) -> float:
        """Time by which the machine has to be predicted."""
        return _ahead(self._state)

    @property
    def unfollowed_s(self) -> float:
        """Time since there were positions of one instant."""
        travels = self.vectors.travels
        own = self._state.own
        cycles = record_at(travels, OWN).since if own else record_at(travels, COHERENCE).cycles
        return float(cycles * self._state.cycle_s)


class HasFollowed(Enum):
    """Result of a follower's cycle."""

    NOT = 0  #: unchanged, as there is nothing to follow
    ALL = 1


class InStep(ABC):
    """Follower with its cycle counting: all of a cycle in one call of a compiled `function` of a table of `arrays`.

    `arrays`: a NamedTuple, with the process image's `values` and offsets `at` in it; `followed`: returned if the cycle
    is complete; `torques_Nm`: one of the arrays, for the load motors' torques (M,).
    """

    def __init__(self, function: Function, followed: int, torques_Nm: Vector, arrays: Any) -> None:
        self._function, self._followed = function, followed
        self._torques, self._arrays = torques_Nm, arrays
        self._table = np.zeros((0, TABLE_WIDTH), np.int64)

    @property
    def usable(self) -> bool:
        """True if it can continue in its present state."""
        return True

    @property
    def is_shown(self) -> bool:
        """True if nothing was changed that acts before the next cycle."""
        return True

    @property
    def torques_Nm(self) -> list[float]:
        """Torques of the load motors (M,), as of the last cycle."""
        torques_Nm: list[float] = self._torques.tolist()
        return torques_Nm

    def follow(self, values: Vector, places: NDArray[np.int64], *, late: bool) -> HasFollowed:
        """Follow, by `elapsed_s`, positions (N,) and speeds (N,) at the first offsets of `values`; write torques of the
        load motors (M,), N·m, predicted by `ahead_s`, at the next ones, then its outputs: pairs of an offset and an
        output index of its description."""
        return self.has_followed(self._function(int(late), self._table_on(values, places)))

    def piece(self, values: Vector, places: NDArray[np.int64], fallback: Callable[[int], bool]) -> CompiledStage:
        """Compiled stage of `follow` with samples that are not late; results other than ALL go to `fallback`."""
        table = self._table_on(values, places)
        return CompiledStage(self._function, 0, self._arrays, continues=self._followed, fallback=fallback, table=table)

    @abstractmethod
    def has_followed(self, code: int) -> HasFollowed:
        """Result of a stage by its return code."""

    def _table_on(self, values: Vector, places: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._arrays.values is not values or self._arrays.at is not places:
            self._arrays = self._arrays._replace(values=values, at=places)
            self._table = table_of(self._arrays)
        return self._table


@runtime_checkable
class FollowsInStep(Protocol):
    """`hilbench.plant.interface.Follower` with a compiled cycle."""

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> InStep | None:
        """Compiled follower of this motion, with load motors on `axes`, counted from 1; None: there is none."""
