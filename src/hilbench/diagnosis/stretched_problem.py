"""Least squares of a residual by columns in contiguous stretches: what any of them would explain, also unseen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array

#: Contiguous stretches, each of which is predicted from the others.
STRETCHES: Final = 8
_RIDGE: Final = 1e-9


@dataclass(frozen=True)
class StretchedProblem:
    """Least squares of a residual by columns, from Gram matrices of stretches (G, J, J), (G, J) and (G,)."""

    gram: Array
    cross: Array
    square: Array
    raw: Array  #: (J,) squares of the columns, as they are without all that is beside them
    ridge: float  #: of the normal equations, as a share of each column's square

    @classmethod
    def of(cls, residual: Array, columns: Array, raw: Array | None = None, ridge: float = _RIDGE) -> StretchedProblem:
        """residual (signals, n), columns (J, signals, n), rows that count only; raw: by default their squares."""
        edges = np.linspace(0, residual.shape[-1], STRETCHES + 1).astype(int)
        gram, cross, square = [], [], []
        for low, high in pairwise(edges):
            c = columns[:, :, low:high].reshape(len(columns), -1)
            r = residual[:, low:high].ravel()
            gram.append(c @ c.T)
            cross.append(c @ r)
            square.append(float(r @ r))
        whole = np.sum(columns**2, axis=(1, 2)) if raw is None else raw
        return cls(np.array(gram), np.array(cross), np.array(square), whole, ridge)

    def with_back(self, columns: range, known: Array) -> StretchedProblem:
        """Problem of a residual that has so much of some of the columns as well."""
        at = list(columns)
        square = self.square + 2.0 * self.cross[:, at] @ known + known @ self.gram[:, at][:, :, at] @ known
        return replace(self, cross=self.cross + self.gram[:, :, at] @ known, square=square)

    @cached_property
    def _whole(self) -> tuple[Array, Array, float]:
        """Gram matrix (J, J), (J,) and sum of squares of all stretches."""
        return self.gram.sum(0), self.cross.sum(0), float(self.square.sum())

    def left(self, chosen: list[int]) -> tuple[float, Array]:
        """Sum of squares that is left by these columns, and their coordinates."""
        gram, cross, square = self._whole
        theta = self._solved(gram, cross, chosen)
        return float(square - theta @ cross[chosen]), theta

    def left_with(self, chosen: list[int], more: list[int], known: Array) -> float:
        """Sum of squares that is left by some columns fitted and more of them with known coordinates."""
        gram, cross, whole = self._whole
        square = float(whole - 2.0 * known @ cross[more] + known @ gram[np.ix_(more, more)] @ known)
        beside = cross - gram[:, more] @ known
        return float(square - self._solved(gram, beside, chosen) @ beside[chosen])

    def left_unseen(self, chosen: list[int]) -> float:
        """Residual sum of squares, each stretch predicted from the others."""
        (gram, cross, _), total = self._whole, 0.0
        for g, c, s in zip(self.gram, self.cross, self.square, strict=True):
            theta = self._solved(gram - g, cross - c, chosen)
            total += float(s - 2.0 * theta @ c[chosen] + theta @ g[np.ix_(chosen, chosen)] @ theta)
        return total

    def gain_by_stretch(self, mine: list[int], group: list[int]) -> float:
        """Fall of the sum of squares by more columns with coordinates of their own in every stretch.

        A loop answers in another phase in each direction and at each speed; the order is the same.
        """
        _, theta = self.left(mine)
        gain = 0.0
        for g, c in zip(self.gram, self.cross, strict=True):
            along = c - g[:, mine] @ theta
            gain += float(self._solved(g, along, group) @ along[group])
        return gain

    def gain_unseen_in_phase(self, mine: list[int], group: list[int]) -> float:
        """Gain of a wave's two columns with the amplitude of the other stretches and a phase of its own: where
        phase is a state of the machine only the amplitude can be predicted."""
        (gram, cross, _), gain = self._whole, 0.0
        for g, c in zip(self.gram, self.cross, strict=True):
            others = self._solved(gram - g, cross - c, [*mine, *group])
            amplitude = float(np.linalg.norm(others[len(mine) :]))
            along = c - g[:, mine] @ others[: len(mine)]
            here = self._solved(g, along, group)
            here *= amplitude / max(float(np.linalg.norm(here)), 1e-300)
            gain += float(2.0 * here @ along[group] - here @ g[np.ix_(group, group)] @ here)
        return gain

    def own_share(self, column: int, beside: list[int]) -> float:
        """Share of a column's square that these others leave of it."""
        gram, whole = self._whole[0], float(self.raw[column])
        if whole <= 0.0:
            return 0.0
        explained = self._solved(gram, gram[column], beside) @ gram[column][beside]
        return (float(gram[column, column]) - float(explained)) / whole

    def _solved(self, gram: Array, cross: Array, chosen: list[int]) -> Array:
        if not chosen:
            return np.empty(0)
        part = gram[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
        normal = part / np.outer(scale, scale) + self.ridge * np.eye(len(chosen))
        return np.asarray(np.linalg.solve(normal, cross[chosen] / scale) / scale)


def basis(columns: Array) -> Array:
    """Orthonormal rows that span the same as these (J, n)."""
    return spanning(columns, np.ones(columns.shape[1], bool))


def spanning(columns: Array, rows: NDArray[np.bool_]) -> Array:
    """Combinations of columns (J, n) that are orthonormal, and span the same, on some of the rows (n,)."""
    scaled = columns / np.maximum(np.linalg.norm(columns[:, rows], axis=1), 1e-300)[:, None]
    of, sizes, _ = np.linalg.svd(np.asarray(np.linalg.qr(scaled[:, rows].T, mode="r")).T, full_matrices=False)
    kept = sizes > 1e-6 * sizes[0]
    return np.asarray((of[:, kept] / sizes[kept]).T @ scaled)


def own_share(response: Array, known: Array) -> float:
    """Share of a response (J, signals, n) that a basis (B, signals·n) leaves of it."""
    return float(np.sum(without(response, known) ** 2)) / max(float(np.sum(response**2)), 1e-300)


def without(columns: Array, basis: Array) -> Array:
    """Columns (J, signals, n) without what they have of the rows of a basis (B, signals·n)."""
    flat = columns.reshape(len(columns), -1)
    return np.asarray((flat - (flat @ basis.T) @ basis).reshape(columns.shape))
