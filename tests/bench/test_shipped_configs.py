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
#: What is not as it should be yet; the test fails when it has come to be.
SHORT_OF = {"shift": pytest.mark.xfail(strict=True, reason="E is found up to 5.4 s behind its steps, in place of 1 s")}


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=path.stem, marks=SHORT_OF.get(path.stem, ())) for path in SHIPPED]
)
def test_a_shipped_config_passes_its_criteria(tmp_path: Path, path: Path) -> None:
    loaded = load_with_overrides(path, bus=f"embedded:t{uuid.uuid4().hex[:10]}")
    outcome = run_experiment(loaded, tmp_path, participants=Participants.IN_PROCESS)
    assert [row.name for row in outcome.result.criteria if not row.passed] == []
    assert outcome.result.verdict == ("passed" if loaded.config.criteria else "completed")
