"""A law for what no effect explains: a few products of states, chosen from a physical library by sparse regression.

A proposal with units, never a name: what the residual looks like, for a person to think on. Terms are added one by
one (orthogonal matching pursuit) as long as rows that no fit has seen are explained better by them; cf. Brunton,
Proctor, Kutz, Discovering governing equations from data by sparse identification of nonlinear dynamical systems, PNAS
113 (2016).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.residual_analysis import Condition

#: Most terms of a law; share of the held-out sum of squares by which each must lower it, and the law as a whole.
_MOST, _EACH, _ALL = 4, 0.02, 0.1
#: Sliding lengths of presliding friction that are tried, as shares of the travel that the axis covers.
_LENGTHS: Final = (0.001, 0.003, 0.01, 0.03, 0.1)
#: Speeds of falling friction that are tried, as shares of the highest.
_SPEEDS: Final = (0.01, 0.05, 0.2)
#: Highest order of a turn.
_ORDERS: Final = (1, 2, 3, 4, 6)


@dataclass(frozen=True)
class LawTerm:
    """One term: coefficient times what it multiplies."""

    of: str  #: formula of states, as a person reads it
    coefficient: float
    unit: str  #: of the coefficient


@dataclass(frozen=True)
class SparseLaw:
    """A proposal for the residual of one torque."""

    signal: str
    terms: tuple[LawTerm, ...]
    share: float  #: of the residual's sum of squares on held-out rows that it explains

    @property
    def text(self) -> str:
        """The law in one line."""
        sum_of = " ".join(
            f"{'−' if term.coefficient < 0 else '+'} {abs(term.coefficient):.4g} {term.unit}·{term.of}"
            for term in self.terms
        )
        return f"{self.signal.removesuffix('_Nm')} left = {sum_of.removeprefix('+ ')}"


@dataclass(frozen=True)
class _Candidate:
    of: str
    unit: str
    values: Array


def law(signal: str, residual: Array, conditions: Sequence[Condition], train: Rows, test: Rows) -> SparseLaw | None:
    """Law of a residual (n,), N·m, over the states of `conditions`; None where none holds on the rows of `test`.

    Fitted on the rows of `train` (n,); the offset is no part of it: it is fitted with every law and not reported.
    """
    library = [one for one in _library(conditions) if _usable(one.values, train)]
    offset = np.ones(len(residual))
    chosen: list[_Candidate] = []
    start = best = _held_out([offset], residual, train, test)[0]
    while len(chosen) < _MOST:
        offered = [one for one in library if one not in chosen]
        columns = [offset, *(one.values for one in chosen)]
        left = residual - _held_out(columns, residual, train, test)[1] @ np.array(columns)
        gains = [_correlation(one.values, columns, left, train) for one in offered]
        if not gains:
            break
        one = offered[int(np.argmax(gains))]
        square, _ = _held_out([*columns, one.values], residual, train, test)
        if best - square < _EACH * start:
            break
        chosen.append(one)
        best = square
    if not chosen or start - best <= _ALL * start:  # no rows to hold on: nothing is left of nothing
        return None
    _, theta = _held_out([offset, *(one.values for one in chosen)], residual, train, test)
    terms = tuple(LawTerm(one.of, float(f"{c:.5g}"), one.unit) for one, c in zip(chosen, theta[1:], strict=True))
    return SparseLaw(signal, terms, round(1.0 - best / start, 3))


def _usable(values: Array, rows: Rows) -> bool:
    largest = float(np.max(np.abs(values), initial=0.0))
    return bool(np.all(np.isfinite(values)) and np.std(values[rows]) > 1e-9 * max(largest, 1e-300))


def _held_out(columns: Sequence[Array], residual: Array, train: Rows, test: Rows) -> tuple[float, Array]:
    """Sum of squares left on the held-out rows by a fit to the others, and its coefficients."""
    matrix = np.array(columns)
    scale = np.maximum(np.sqrt(np.mean(matrix[:, train] ** 2, axis=1)), 1e-300)
    theta, *_ = np.linalg.lstsq((matrix[:, train] / scale[:, None]).T, residual[train], rcond=1e-8)
    theta = theta / scale
    return float(np.sum((residual[test] - theta @ matrix[:, test]) ** 2)), np.asarray(theta)


def _correlation(values: Array, columns: Sequence[Array], left: Array, rows: Rows) -> float:
    """Reduction of the residual's sum of squares by one more column, on these rows."""
    matrix = np.array(columns)[:, rows]
    matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=1), 1e-300)[:, None]
    theta, *_ = np.linalg.lstsq(matrix.T, values[rows], rcond=1e-8)
    free = values[rows] - theta @ matrix
    square = float(free @ free)
    if square < 1e-8 * float(values[rows] @ values[rows]):
        return 0.0
    return float(free @ left[rows]) ** 2 / square


def _library(conditions: Sequence[Condition]) -> Iterator[_Candidate]:
    """Candidate laws: friction of every kind, load, position, and products of them."""
    states = {one.name: one for one in conditions}
    speeds = [one for name, one in states.items() if name.startswith("speed of axis")]
    for speed in speeds:
        v, unit = speed.values, speed.unit
        yield _Candidate("sign(v)", "N·m", np.sign(v))
        yield _Candidate("v", f"N·m/({unit})", v)
        yield _Candidate("|v|", f"N·m/({unit})", np.abs(v))
        yield _Candidate("v·|v|", f"N·m/({unit})²", v * np.abs(v))
        yield _Candidate("v²", f"N·m/({unit})²", v**2)
        yield _Candidate("sign(v)·√|v|", f"N·m/√({unit})", np.sign(v) * np.sqrt(np.abs(v)))
        top = float(np.max(np.abs(v), initial=0.0))
        for share in _SPEEDS if top > 0.0 else ():
            slow = share * top
            yield _Candidate(f"sign(v)·exp(−|v|/{slow:.3g} {unit})", "N·m", np.sign(v) * np.exp(-np.abs(v) / slow))
    for name, one in states.items():
        if name.startswith("acceleration of axis"):
            yield _Candidate("a", f"N·m/({one.unit})", one.values)
            yield _Candidate("|a|", f"N·m/({one.unit})", np.abs(one.values))
        elif name in ("tension", "strain rate"):
            letter = "F" if name == "tension" else "strain rate"
            yield _Candidate(letter, f"N·m/({one.unit})", one.values)
            for speed in speeds:
                yield _Candidate(f"{letter}·sign(v)", f"N·m/({one.unit})", one.values * np.sign(speed.values))
                yield _Candidate(f"{letter}·v", f"N·m/({one.unit}·{speed.unit})", one.values * speed.values)
        elif name.startswith("position of axis"):
            x, unit = one.values, one.unit
            travel = float(np.ptp(x))
            yield _Candidate("x", f"N·m/{unit}", x - float(np.mean(x)))
            for order in _ORDERS:
                yield _Candidate(f"sin({order}·x/1 {unit})", "N·m", np.sin(order * x))
                yield _Candidate(f"cos({order}·x/1 {unit})", "N·m", np.cos(order * x))
            for share in _LENGTHS if travel > 0.0 else ():
                length = share * travel
                yield _Candidate(f"presliding over {length:.3g} {unit}", "N·m", presliding(x, length))
            for speed in speeds:
                yield _Candidate("x·sign(v)", f"N·m/{unit}", (x - float(np.mean(x))) * np.sign(speed.values))
        elif one.period is not None:
            angle = 2.0 * np.pi * one.values / one.period
            for order in _ORDERS:
                yield _Candidate(f"sin({order}·{name})", "N·m", np.sin(order * angle))
                yield _Candidate(f"cos({order}·{name})", "N·m", np.cos(order * angle))


def presliding(x: Array, length: float) -> Array:
    """Friction per Coulomb friction that builds up over a sliding length: dz/dx = (1 − z·sign(dx))/length, −1 to 1.

    Dahl, A solid friction model (1968), exponent 1; LuGre's bristles when they move slowly. x (n,) and length in one
    unit.
    """
    z, out = 0.0, np.empty(len(x))
    for k, step in enumerate(np.diff(x, prepend=x[:1])):
        toward = 1.0 if step > 0.0 else -1.0
        if step != 0.0:
            z = toward + (z - toward) * float(np.exp(-abs(step) / length))
        out[k] = z
    return out
