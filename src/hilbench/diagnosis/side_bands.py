"""Side bands that a known wave leaves near its order: a drive's loop responds in another phase at every speed."""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import spanning
from hilbench.diagnosis.terms import Term

#: Orders or frequencies from a present one up to which others are its side bands; how many of them on either side.
NEAR: Final = 0.5
_MOST_SIDE_BANDS: Final = 20.0


class SideBands:
    """Waves near the orders and frequencies of terms: `columns` (J, signals, n), and what spans them where rows count.

    A loop answers to an order in another phase at every speed and in each direction. What that leaves of the order
    is neither an order beside it nor anything else. Where an axis goes there and back each wave has another size
    and phase either way.
    """

    def __init__(self, space: Space, proposer: Proposer, terms: list[Term]) -> None:
        columns = []
        for term in terms:
            name, angle = proposer.searched_angle_rad(term, space.predictor.every)
            if name is None:
                continue
            turns = float(np.ptp(angle)) / (2.0 * np.pi)
            step = max(0.5 / turns, NEAR / _MOST_SIDE_BANDS)
            offsets = step * np.arange(-int(NEAR / step), int(NEAR / step) + 1)
            waves = np.exp(1j * np.outer(term.values[name] + offsets, angle))
            both = np.concatenate([waves.real, waves.imag])
            columns.append(both)
            forward = np.gradient(angle) > 0.0
            counted = forward[space.predictor.rows]
            if term.axis is not None and np.any(counted) and not np.all(counted):
                columns.append(np.where(forward, both, -both))
        signals, n = space.predictor.measured.shape
        self.columns, self._rows = np.empty((0, signals, n)), space.predictor.rows
        if columns:
            found = np.concatenate(columns)
            alone = [found[:, None, :] * np.eye(signals)[k][None, :, None] for k in range(signals)]
            self.columns = np.concatenate(alone)

    @cached_property
    def _spanning(self) -> Array:
        """(B, signals, n), orthonormal on the rows that count."""
        flat, n = self.columns.reshape(len(self.columns), -1), self.columns.shape[-1]
        return spanning(flat, np.tile(self._rows, self.columns.shape[1])).reshape(-1, self.columns.shape[1], n)

    @property
    def basis(self) -> Array:
        """(B, signals·rows): orthonormal rows that span them where rows count."""
        return self._spanning[..., self._rows].reshape(-1, self.columns.shape[1] * int(np.count_nonzero(self._rows)))

    def taken_out_of(self, residual: Array) -> Array:
        """The residual (signals, n) without what they explain of it."""
        if not len(self.columns):
            return residual
        along = np.tensordot(self._spanning[..., self._rows], residual[..., self._rows], 2)
        return np.asarray(residual - np.tensordot(along, self._spanning, 1))


def is_near_present(space: Space, proposer: Proposer, term: Term, current: Fit) -> bool:
    """True if a wave's order is one that is there, or within its side bands."""
    if not term.has_phase:
        return False
    order = order_of(space, proposer, term)
    waves = (other for other in current.terms if other.has_phase)
    return any(abs(order_of(space, proposer, other) - order) < NEAR for other in waves)


def order_of(space: Space, proposer: Proposer, wave: Term) -> float:
    """Times a turn of the motor; once a turn of what it drives where the law has no order."""
    name, _ = proposer.searched_angle_rad(wave, space.predictor.every)
    if name is not None:
        return wave.values[name]
    return 1.0 if wave.axis is None else 1.0 / space.model.gear_ratio(wave.axis)
