"""A twin that joins a line that runs already, or rests: neither E nor the strain of the web in the span is known."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.estimation.runs import CYCLE_S, NEW_PA, OLD_PA, times, tracked
from tests.plant.models import model
from tests.simulated_measurements import simulated_measurements
from tests.tiers import slow

from hilbench.bench.tasks.web_standstill_excitation import StandstillExcitation, excitation_amplitudes_m
from hilbench.estimation.web_line.config import (
    ChangepointConfig,
    EkfConfig,
    EstimationConfig,
    LmConfig,
    RlsConfig,
    SynchronizerConfig,
)
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.offline import Track, run_offline

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
@pytest.mark.parametrize("share", [0.6, *slow(1.0), 1.4])
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


AT_REST_S, RAMP_S = 10.0, 2.0


def at_rest(share_of_tension: float, moved_mm: float = 0.0) -> Measurements:
    """A line that stands, its span strained by this share of the strain upstream; after `AT_REST_S` a ramp to 3 m/s.

    `moved_mm`: it makes the bench's small movement from 1 to 9 s.
    """
    plant = model(web_load=[False, True])
    t_s = times(AT_REST_S + RAMP_S + 2.5)
    speeds = np.outer(3.0 * np.clip((t_s - AT_REST_S) / RAMP_S, 0.0, 1.0), [1.0, 1.0])
    leader, axes = SimpleNamespace(creep_m_s=0.0), [SimpleNamespace(pull_m_s=0.0) for _ in range(2)]
    if moved_mm:
        travel_m = 1e-3 * moved_mm
        pulled_m = excitation_amplitudes_m(plant, [80.0], travel_m)
        movement = StandstillExcitation(leader, axes, lambda _: (0.0, 0.0), travel_m, pulled_m, CYCLE_S)
        for row in np.flatnonzero((t_s >= 1.0) & (t_s < 9.0)):
            movement.go_on()
            speeds[row] += [leader.creep_m_s + axis.pull_m_s for axis in axes]
    strained = np.zeros((round(2.0 / CYCLE_S), 2))  # before the recording
    gives_way = 1.0 / plant.stiffness_N(1) + 1.0 / plant.drive_stiffness_N_per_m(2)
    strained[: len(strained) // 4, 0] = (1.0 - share_of_tension) * plant.boundary.upstream_tension_N * gives_way / 0.5
    speeds = np.vstack([strained, speeds])
    data = simulated_measurements(plant, speeds, np.full(len(speeds), OLD_PA), seed=5)
    return from_row(data, len(strained))


def found_at_rest(data: Measurements, believed_Pa: float, method: SynchronizerConfig) -> Track:
    config = EstimationConfig(estimate=[method], youngs_modulus_Pa=believed_Pa, web_at_rest="unknown")
    return run_offline(model(web_load=[False, True]), config, data)


def row_at(t_s: float) -> int:
    return round(t_s / CYCLE_S)


@pytest.mark.parametrize("method", [ChangepointConfig(), EkfConfig()])
@pytest.mark.parametrize(("share", "believed"), [(0.4, 0.5), (1.5, 0.6), *slow((0.7, 1.8), (1.0, 1.0))])
def test_a_web_at_rest_is_unknown_until_it_runs_and_known_in_time_then(
    method: SynchronizerConfig, share: float, believed: float
) -> None:
    track = found_at_rest(at_rest(share), believed * OLD_PA, method)
    error = track.E_Pa / OLD_PA - 1.0
    rests = slice(row_at(0.5), row_at(AT_REST_S))
    assert np.all(np.abs(error[rests]) * OLD_PA <= 1.96 * track.E_sd_Pa[rests])
    assert np.all(track.E_sd_Pa[rests] > 0.5 * OLD_PA)
    assert np.all(np.abs(error[row_at(AT_REST_S + RAMP_S + WITHIN_S) :]) < WITHIN)


@pytest.mark.parametrize(("share", "believed"), [(0.4, 0.5), (0.7, 1.8), (1.5, 0.6)])
def test_a_movement_of_a_millimetre_tells_E_and_the_strain_at_rest(share: float, believed: float) -> None:
    data = at_rest(share, moved_mm=1.0)
    assert 4e-4 < np.ptp(data.x_m[: row_at(AT_REST_S)], axis=0).max() < 1e-3
    track = found_at_rest(data, believed * OLD_PA, ChangepointConfig())
    error = track.E_Pa / OLD_PA - 1.0
    assert np.all(np.abs(error[row_at(9.2) :]) < WITHIN)
    assert np.mean(np.abs(error) * OLD_PA <= 1.96 * track.E_sd_Pa) > 0.95
    # The simulation has the strain, not only E.
    assert abs(track.residual_Nm[row_at(9.2) : row_at(AT_REST_S)].mean()) < 0.02


def test_a_web_that_a_load_model_begins_is_strained_as_upstream() -> None:
    track = tracked(from_row(running(1.0), 0), ChangepointConfig())
    assert np.all(np.abs(track.E_Pa[row_at(0.2) :] / OLD_PA - 1.0) < WITHIN)
