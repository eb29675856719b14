"""Every shipped config does what its criteria say, run as a user runs it with `--in-process`."""

from __future__ import annotations

import uuid
from pathlib import Path

import pytest

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

pytestmark = pytest.mark.slow

SHIPPED = sorted((Path(__file__).resolve().parents[2] / "bench_configs").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_config_passes_its_criteria(tmp_path: Path, path: Path) -> None:
    loaded = load_with_overrides(path, bus=f"embedded:t{uuid.uuid4().hex[:10]}")
    outcome = run_experiment(loaded, tmp_path, participants=Participants.IN_PROCESS)
    assert [row.name for row in outcome.result.criteria if not row.passed] == []
    assert outcome.result.verdict == ("passed" if loaded.config.criteria else "completed")
