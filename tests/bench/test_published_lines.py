"""Published lines as benches: what their papers do, within what is asked of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"


@pytest.mark.slow
def test_Giannoccaros_tensions_stay_within_3_percent_as_the_speed_doubles(tmp_path: Path) -> None:
    given = load_with_overrides(CONFIGS / "giannoccaro_2016.yaml", bus=f"embedded:{tmp_path.name}")
    result = run_experiment(given, tmp_path / "run", participants=Participants.IN_PROCESS).result
    assert result.faults == []
    assert [row.verdict for row in result.criteria] == ["passed"] * 3
    assert max(row.value or 0.0 for row in result.criteria) < 0.03 * 14.0
