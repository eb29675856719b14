"""A twin that joins a line that runs already: neither E nor the strain of the web in the span is known."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.estimation.runs import CYCLE_S, NEW_PA, OLD_PA, times, tracked
from tests.plant.models import model

from hilbench.estimation.web_line.config import ChangepointConfig, EkfConfig, LmConfig, RlsConfig, SynchronizerConfig
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.offline import Track
from hilbench.estimation.web_line.synthetic import simulated_measurements

#: What stands in the issue of a line at 3 m/s.
WITHIN_S, WITHIN = 1.5, 0.01


def running(share_of_tension: float, true_Pa: float = OLD_PA, seed: int = 5, until_s: float = 6.0) -> Measurements:
    """Axis 1 turns so much slower that the span has this share of the tension of the web that enters; ramp to 3 m/s."""
    plant = model()
    t_s = times(until_s)
    strain = plant.upstream_strain
    ratio = 1.0 - (share_of_tension - 1.0) * strain
    speed = 3.0 * np.minimum(t_s, 1.0)
    return simulated_measurements(plant, np.column_stack([speed * ratio, speed]), np.full(len(t_s), true_Pa), seed=seed)


def from_row(data: Measurements, first: int) -> Measurements:
    return Measurements(**{each.name: getattr(data, each.name)[first:] for each in fields(Measurements)})


def joined(data: Measurements, at_s: float, believed_Pa: float, method: SynchronizerConfig) -> Track:
    return tracked(from_row(data, round(at_s / CYCLE_S)), method, youngs_modulus_Pa=believed_Pa)


@pytest.mark.parametrize("method", [ChangepointConfig(), EkfConfig(), RlsConfig(), LmConfig()])
@pytest.mark.parametrize("share", [0.6, 1.0, 1.4])
@pytest.mark.parametrize("believed", [0.6, 1.5])
def test_E_is_known_in_time_whatever_was_believed(method: SynchronizerConfig, share: float, believed: float) -> None:
    track = joined(running(share), 2.0, believed * OLD_PA, method)
    error = track.E_Pa / OLD_PA - 1.0
    assert np.all(np.abs(error[round(WITHIN_S / CYCLE_S) :]) < WITHIN)


@pytest.mark.parametrize("at_s", [0.3, 0.6, 1.0, 1.5, 3.0])
def test_a_recording_may_be_cut_anywhere(at_s: float) -> None:
    track = joined(running(1.2), at_s, 0.7 * OLD_PA, ChangepointConfig())
    error = track.E_Pa / OLD_PA - 1.0
    assert np.all(np.abs(error[round(1.5 / CYCLE_S) :]) < WITHIN)
    assert np.mean(np.abs(error) * OLD_PA <= 1.96 * track.E_sd_Pa) > 0.95


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    share=st.floats(0.6, 1.5), believed=st.floats(0.5, 2.0), true=st.sampled_from([OLD_PA, NEW_PA]), seed=st.integers(0)
)
def test_what_is_said_while_joining_is_honest(share: float, believed: float, true: float, seed: int) -> None:
    data = running(share, true, seed=seed % 1000, until_s=4.0)
    track = joined(data, 2.0, believed * true, ChangepointConfig())
    error = track.E_Pa / true - 1.0
    assert np.all(np.abs(error[round(WITHIN_S / CYCLE_S) :]) < WITHIN)
    assert np.all(np.abs(error) * true <= 3.5 * track.E_sd_Pa)


def test_an_E_that_steps_while_the_twin_joins_is_found_afterwards() -> None:
    t_s = times(6.0)
    speed = 3.0 * np.minimum(t_s, 1.0)
    true = np.where(t_s >= 2.3, NEW_PA, OLD_PA)
    data = simulated_measurements(model(), np.column_stack([speed, speed]), true, seed=5)
    track = joined(data, 2.0, 0.7 * OLD_PA, ChangepointConfig())
    assert track.E_Pa[round(2.0 / CYCLE_S) :] == pytest.approx(NEW_PA, rel=WITHIN)
