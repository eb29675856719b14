"""Every shipped config does what its criteria say, run as a user runs it with `--in-process`."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.bench.whole_runs import Shipped

from hilbench.errors import EXIT_PASSED

pytestmark = pytest.mark.slow

SHIPPED = sorted((Path(__file__).resolve().parents[2] / "bench_configs").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_config_passes_its_criteria(shipped: Shipped, path: Path) -> None:
    outcome = shipped(path.stem)
    assert [row.name for row in outcome.result.criteria if not row.passed] == []
    assert outcome.result.verdict == ("passed" if outcome.result.criteria else "completed")
    assert outcome.exit_code == EXIT_PASSED
