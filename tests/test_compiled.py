"""Compiled functions, called by compiled ones and by Python."""

from __future__ import annotations

import numpy as np

from hilbench.compiled import REAL, VECTOR, Vector, compiled, entry_point, inlined, merged


@compiled
def _quotient(numerator: float, denominator: float) -> float:
    return numerator / denominator


@inlined
def _square(value: float) -> float:
    return value * value


@merged
def _scale(vector: Vector, factor: float) -> None:
    for k in range(len(vector)):
        vector[k] = _square(vector[k]) * factor


@entry_point(VECTOR, REAL)
def _scale_by_quotient(vector: Vector, denominator: float) -> float:
    factor = _quotient(6.0, denominator)
    _scale(vector, factor)
    return factor


def test_an_entry_point_runs_the_compiled_functions_that_it_calls() -> None:
    vector = np.array([1.0, 2.0, 3.0])
    assert _scale_by_quotient(vector, 2.0) == 3.0
    assert vector.tolist() == [3.0, 12.0, 27.0]


def test_python_calls_compiled_functions_and_gets_what_their_compiled_callers_get() -> None:
    vector = np.array([1.0, 2.0, 3.0])
    _scale(vector, 3.0)
    assert vector.tolist() == [3.0, 12.0, 27.0]
    assert _square(1.5) == 2.25
    assert _quotient(1.0, 0.0) == np.inf  # as in compiled code, without ZeroDivisionError
