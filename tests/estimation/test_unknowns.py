"""The filter of what is unknown of a line tells what a parameter was wrong by from what it has changed by since."""

from __future__ import annotations

import numpy as np

from hilbench.estimation.web_line.augmented_filter import AugmentedFilter

#: A parameter of 20 %, of which 1 % is 0.8 N, and a state of 2 N; a measurement with a slow error of 0.4 N.
_PARAMETER, _STATE_N, _OFFSET_N, _NOISE_N, _PER_SHARE_N = 0.2, 2.0, 0.4, 0.1, 80.0
_SHIFT_S = 5e4
_HOUR = 120_000  #: windows of 30 ms
_NOTHING = np.zeros(2)
#: Of a sudden change: of the parameter; of the state nothing.
_JUMPS = (np.array([[_PARAMETER**2]]), np.eye(2))


def unknowns(rate_N_per_m: float = 0.0) -> AugmentedFilter:
    """The parameter first; the state changes with the way of the web by so much."""
    start, parameters = np.diag([_PARAMETER**2, _STATE_N**2]), np.array([True, False])
    rates = np.array([0.0, rate_N_per_m])
    return AugmentedFilter(start, parameters, rates, np.array([_OFFSET_N]), *(np.zeros(1) for _ in range(4)))


def let_pass(filtered: AugmentedFilter, windows: int, travel_m: float = 0.0) -> None:
    """So many windows: the change of the parameter, and the offset, are others within a shift."""
    prior = np.zeros((len(filtered.mean),) * 2)
    changes, offset = 2, filtered.first_offset
    prior[changes, changes], prior[offset, offset] = _PARAMETER**2, _OFFSET_N**2
    left = np.where(np.diag(prior) > 0.0, np.exp(-0.03 * windows / _SHIFT_S), 1.0)
    filtered.grow(left, (1.0 - np.outer(left, left)) * prior, travel_m)


def look(filtered: AugmentedFilter, innovation_N: float, *, learns: bool = True) -> np.ndarray:
    """One measurement of parameter and state."""
    slopes, variances = np.array([[_PER_SHARE_N, 1.0]]), np.array([_NOISE_N**2])
    learned = None if learns else np.zeros((2, 1), bool)
    return filtered.update(np.array([innovation_N]), slopes, variances, _JUMPS, learned)


def test_what_changes_by_itself_stays_within_its_prior_however_long_nothing_is_measured() -> None:
    filtered = unknowns()
    look(filtered, 0.0)
    known = filtered.deviation(0)
    deviations = []
    for _ in range(24):
        let_pass(filtered, 10 * _HOUR)
        deviations.append(filtered.deviation(0))
    assert known < 0.2 * _PARAMETER
    assert np.all(np.diff(deviations) >= 0.0)
    assert 0.99 * _PARAMETER < deviations[-1] <= 1.02 * _PARAMETER


def test_noise_of_hours_is_no_evidence() -> None:
    filtered, rng = unknowns(), np.random.default_rng(1)
    corrected_N, evidence, windows = 0.0, [], 20
    for noise_N in _NOISE_N * rng.normal(size=2 * _HOUR // windows):
        let_pass(filtered, windows)
        changes = look(filtered, float(noise_N) - corrected_N)
        corrected_N += changes[1]
        assert changes[0] == 0.0
        evidence.append(filtered.evidence_of_start(_NOTHING))
    assert max(evidence) < 5.0


def test_another_parameter_is_overwhelming_evidence_is_taken_once_and_can_be_given_back() -> None:
    filtered = unknowns()
    corrected_N = 0.0
    for _ in range(50):
        corrected_N += look(filtered, 0.1 * _PER_SHARE_N - corrected_N)[1]
    evidence = filtered.evidence_of_start(_NOTHING)
    assert evidence > 9.0
    taken = filtered.take_start()
    assert 0.08 < taken[0] < 0.11
    assert filtered.evidence_of_start(_NOTHING) == 0.0
    assert filtered.evidence_of_start(taken) == evidence
    assert not filtered.take_start().any()
    assert filtered.give_back(taken)[0] == -taken[0]
    assert filtered.evidence_of_start(_NOTHING) == evidence


def test_a_drift_is_a_change_of_the_parameter_and_not_what_it_was_from_the_start() -> None:
    """Of 5 % in five minutes, beside an offset that is as large."""
    filtered, rng = unknowns(), np.random.default_rng(2)
    found = 0.0
    for window in range(10_000):
        let_pass(filtered, 1)
        left_N = (0.05 * window / 10_000 - found) * _PER_SHARE_N + _OFFSET_N + _NOISE_N * float(rng.normal())
        filtered.update(
            np.array([left_N]), np.array([[_PER_SHARE_N, 0.0]]), np.array([_NOISE_N**2]), _JUMPS
        )  # fmt: skip
        found += filtered.take_changes(0.03)[0]
    assert abs(found - 0.05) < 0.003
    assert filtered.evidence_of_start(_NOTHING) < 5.0


def test_what_goes_on_changing_with_the_way_is_followed_without_delay() -> None:
    filtered, rate_N_per_m, errors_N = unknowns(rate_N_per_m=1.0), 0.5, []
    at_N = 0.0
    for window in range(400):
        let_pass(filtered, 1, travel_m=0.05)
        state_N = rate_N_per_m * 0.05 * window
        at_N += filtered.update(
            np.array([state_N - at_N]), np.array([[0.0, 1.0]]), np.array([_NOISE_N**2]), _JUMPS
        )[1]  # fmt: skip
        errors_N.append(abs(state_N - at_N))
    assert max(errors_N[200:]) < 0.01


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


def test_a_sudden_change_is_one_of_the_parameter_with_the_size_that_it_has() -> None:
    filtered = unknowns()
    corrected_N = found = 0.0
    for window in range(160):
        let_pass(filtered, 1)
        stepped_N = 0.08 * _PER_SHARE_N if window >= 100 else 0.0
        corrected_N += look(filtered, stepped_N - corrected_N - found * _PER_SHARE_N)[1]
        found += filtered.take_changes(1.0 if window >= 100 else 0.03)[0]
    assert abs(found - 0.08) < 0.005
