"""The filter of what is unknown of a line corrects a model's parameters on overwhelming evidence, and never forgets."""

from __future__ import annotations

import numpy as np

from hilbench.estimation.web_line.unknowns import Unknowns

#: A parameter of 20 %, of which 1 % is 0.8 N, and a state of 2 N; a measurement with a slow error of 0.4 N.
_PARAMETER, _STATE_N, _OFFSET_N, _NOISE_N, _PER_SHARE_N = 0.2, 2.0, 0.4, 0.1, 80.0
_HOUR = 120_000  #: windows of 30 ms


def unknowns() -> Unknowns:
    """The parameter first."""
    start, parameters = np.diag([_PARAMETER**2, _STATE_N**2]), np.array([True, False])
    return Unknowns(start, parameters, np.array([_OFFSET_N]), np.zeros(1), 0.0)


def shift(windows: int) -> tuple[np.ndarray, np.ndarray]:
    """What is left of what is known of all, and its growth, in so many windows: parameter 13 h, offset 10 min."""
    left = np.exp(-0.03 * windows / np.array([5e4, np.inf, 600.0]))
    return left, np.diag((1.0 - left**2) * np.array([_PARAMETER, 0.0, _OFFSET_N]) ** 2)


def look(filtered: Unknowns, innovation_N: float, *, learns: bool = True) -> np.ndarray:
    """One measurement of parameter and state."""
    slopes, variances = np.array([[_PER_SHARE_N, 1.0]]), np.array([_NOISE_N**2])
    learned = None if learns else np.zeros((2, 1), bool)
    return filtered.update(np.array([innovation_N]), slopes, variances, np.zeros((2, 2)), learned)


def test_what_changes_by_itself_stays_within_its_prior_however_long_nothing_is_measured() -> None:
    filtered = unknowns()
    look(filtered, 0.0)
    known = filtered.deviation(0)
    deviations = []
    for _ in range(24):
        filtered.grow(*shift(10 * _HOUR))
        deviations.append(filtered.deviation(0))
    assert known < 0.2 * _PARAMETER
    assert np.all(np.diff(deviations) >= 0.0)
    assert 0.99 * _PARAMETER < deviations[-1] <= _PARAMETER


def test_noise_of_hours_is_no_evidence_and_a_parameter_is_not_corrected_for_it() -> None:
    filtered, rng = unknowns(), np.random.default_rng(1)
    corrected_N, evidence, windows = 0.0, [], 20
    for noise_N in _NOISE_N * rng.normal(size=2 * _HOUR // windows):
        filtered.grow(*shift(windows))
        changes = look(filtered, float(noise_N) - corrected_N)
        corrected_N += changes[1]
        assert changes[0] == 0.0
        evidence.append(filtered.evidence(filtered.mean[:2]))
    assert max(evidence) < 5.0
    assert abs(filtered.mean[0]) < 0.5 * filtered.deviation(0)


def test_another_parameter_is_overwhelming_evidence_and_is_taken_once() -> None:
    filtered = unknowns()
    corrected_N = 0.0
    for _ in range(50):
        corrected_N += look(filtered, 0.1 * _PER_SHARE_N - corrected_N)[1]
    mean = filtered.mean[:2].copy()
    assert filtered.evidence(mean) > 9.0
    taken = filtered.take_parameters(np.zeros(2))
    assert 0.08 < taken[0] < 0.11
    assert taken[0] == mean[0]
    assert filtered.evidence(filtered.mean[:2]) == 0.0
    assert not filtered.take_parameters(np.zeros(2)).any()


def test_what_is_not_learned_counts_in_the_deviation_all_the_same() -> None:
    filtered = unknowns()
    before = filtered.deviation(0)
    assert not look(filtered, 3.0, learns=False).any()
    assert filtered.deviation(0) == before


def test_a_step_is_a_sudden_change_and_what_comes_gradually_is_none() -> None:
    def changes(courses_N: np.ndarray) -> bool:
        filtered = unknowns()
        for _ in range(100):
            look(filtered, 0.0)
        return any(look(filtered, value_N) is not None and filtered.has_changed for value_N in courses_N.tolist())

    assert changes(np.full(3, 20.0))
    assert not changes(np.full(1, 20.0)), "one alone may be chance"
    assert not changes(np.linspace(0.0, 20.0, 200))


def test_a_parameter_that_was_another_one_for_a_while_is_as_uncertain_as_it_was_wrong() -> None:
    filtered = unknowns()
    for _ in range(50):
        look(filtered, 0.0)
    known, offset = filtered.deviation(0), filtered.covariance[2, 2]
    filtered.mean[0] = 3.0 * known
    filtered.reopen()
    assert np.isclose(filtered.deviation(0), np.hypot(1.0, 3.0) * known)
    assert filtered.covariance[2, 2] > offset, "what was learned beside it depends on it"
    assert np.isclose(filtered.evidence(filtered.mean[:2]), 0.9)
