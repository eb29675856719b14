"""Gap detection: the residual of measurement and model in pieces of half a second, against noise."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.machines import AnyMachine
from hilbench.diagnosis.noise import floor
from hilbench.live.machine import SHORT, LiveMachine

#: Pieces in a row that have to part, so that a passing transient is none; pieces that the noise is learned from, and
#: how many make it known: one of 25 means is off by a fifth, and up to half, and what parts is not learned from.
ROW, _LEARNED, _KNOWN = 3, 40, 8
#: Share by which the rest is more than the noise of the torque alone where nothing is wrong.
_MORE = 1.15
#: Share of a usual torque by which a level may be off where nothing is wrong: acceleration, emulation, drives.
_TOLERATED = 0.008
#: Standard deviations of a level, and how many times its usual size the rest, from which a piece parts.
_LEVELS, _ROUGHER = 6.0, 1.8
#: Means of a piece that are not left out, at least.
_LEAST_MEANS = 8


@dataclass(frozen=True)
class Piece:
    """The gap over one chunk, N·m at each motor (N,): its level, and what is about it; whether that is more than noise.

    cycle: the last one of the chunk.
    """

    cycle: int
    level: Array
    rest: Array
    parts: bool

    @property
    def size(self) -> Array:
        """Both together (N,)."""
        return np.asarray(np.hypot(self.level, self.rest))


class Watch:
    """The gap of one model of a machine."""

    def __init__(self, machine: LiveMachine[AnyMachine], model: AnyMachine) -> None:
        self._gap = machine.gap(model)
        self._machine = machine
        self._rests: deque[Array] = deque(maxlen=_LEARNED)
        self.in_a_row = 0  #: pieces until now that part
        self.begun_cycle = 0  #: the first of them begins there

    def learned_from(self, other: Watch) -> None:
        """Take the noise, which is that of the machine, from another model's watch."""
        self._rests = other._rests.copy()

    @property
    def noise_Nm(self) -> Array | None:
        """(N,): what is about the level of a piece while nothing parts; None before the first."""
        return np.mean(np.array(self._rests), axis=0) if self._rests else None

    def use_estimate(self, estimate: Array) -> None:
        """Use the twin's estimates (M,) from now on."""
        self._gap.use_estimate(estimate)

    def follow(self, channels: Mapping[str, Array], known: Rows) -> None:
        """Take the rows before the next chunk as initial state, without judging them."""
        if len(known):
            self._gap.follow(channels, known)

    def restart(self) -> None:
        """The next chunk is not the one that follows the last."""
        self._gap.restart()
        self.in_a_row = 0

    def update(self, last_cycle: int, channels: Mapping[str, Array], known: Rows) -> Piece | None:
        """Judge the next chunk (n,) of each channel; `known`: the rows that are no guess. None at standstill, or
        with too few known rows."""
        values = self._gap.follow(channels, known)
        cycles = len(known)
        if min(float(np.min(np.abs(channels[name]))) for name in self._machine.speeds) < self._machine.moves:
            self.in_a_row = 0
            return None
        values = values[np.all(np.isfinite(values), axis=1)]
        if len(values) < _LEAST_MEANS:
            return None
        level = np.median(values, axis=0)
        rest = 1.4826 * np.median(np.abs(values - level), axis=0)
        noise_Nm = np.array([floor(channels[f"tau{k}_Nm"][known]) for k in range(1, len(level) + 1)])
        parts = self._parts(level, rest, len(values), noise_Nm * _MORE / np.sqrt(SHORT))
        piece = Piece(last_cycle, level, rest, parts)
        if piece.parts:
            self.begun_cycle = self.begun_cycle if self.in_a_row else last_cycle + 1 - cycles
            self.in_a_row += 1
        else:
            self.in_a_row = 0
            self._rests.append(rest)
        return piece

    def _parts(self, level: Array, rest: Array, means: int, white: Array) -> bool:
        """`white` (N,): what the noise of the torques alone makes of the rest."""
        learned = self.noise_Nm
        noise = white if learned is None else learned
        if len(self._rests) < _KNOWN:
            noise = np.maximum(noise, white)
        of_level = _LEVELS * 1.25 * noise / np.sqrt(means)
        off = np.abs(level) > np.maximum(of_level, _TOLERATED * self._machine.usual_Nm)
        return bool(np.any(off | (rest > _ROUGHER * noise)))
