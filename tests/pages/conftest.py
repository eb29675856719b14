"""A short run of the demonstrator, made once, as a bench leaves it."""

from __future__ import annotations

import pytest
from tests.bench.whole_runs import config

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides

STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 0.5}},
    {"hold": {"until_s": 1.0}},
    {"step": {"path": "tension_control.set_point_N", "to": 90.0}},
    {"hold": {"until_s": 4.5}},
]


@pytest.fixture(scope="session")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[LoadedConfig, RunOutcome]:
    folder = tmp_path_factory.mktemp("ran")
    loaded = load_with_overrides(config(folder, steps=STEPS))
    return loaded, run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS)
