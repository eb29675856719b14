"""A run whose folder somebody removes while it runs: it is told, and the exit code is that of the run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.bench.whole_runs import SHORT, config, run_here

from hilbench.errors import EXIT_BENCH_FAULT

REMOVES = """
import shutil
from pathlib import Path


def experiment(bench):
    yield
    for folder in (Path(__file__).parent / "runs").iterdir():
        shutil.rmtree(folder)
"""


@pytest.mark.parametrize(("options", "report"), [((), True), ((), False), (("--json",), True)])
def test_a_folder_removed_in_mid_run_is_a_fault_with_a_report_and_without(
    tmp_path: Path, options: tuple[str, ...], report: bool
) -> None:
    (tmp_path / "removes.py").write_text(REMOVES)
    path = config(tmp_path, steps=[*SHORT[:2], {"python": {"file": "removes.py"}}, SHORT[-1]])
    code, out, err = run_here(path, *options, report=report)
    assert code == EXIT_BENCH_FAULT
    assert "was removed while the run wrote to it" in out
    assert ("no report: " in err) == report
    if options:
        assert json.loads(out)["exit_code"] == EXIT_BENCH_FAULT
