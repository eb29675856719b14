"""Sinks of other packages: entry points that take the samples of a run as hilbench's own do."""

from __future__ import annotations

from pathlib import Path

from tests.bench.whole_runs import SHORT, config, run_folders
from tests.installed import hilbench_with, install

from hilbench.results.result import Result

SOURCE = """
import csv

class Rows:
    def __init__(self, address, signals, bench, began_s):
        self.file = open(address, "w")
        csv.writer(self.file).writerow([signal.name for signal in signals])

    def take(self, row):
        csv.writer(self.file).writerow(row)

    def close(self):
        self.file.close()
"""
GROUP = "hilbench.sinks"


def test_a_sink_of_another_package_takes_samples_as_they_come(tmp_path: Path) -> None:
    install(tmp_path, "tables", SOURCE, GROUP, table="Rows")
    path, file = config(tmp_path, steps=SHORT), tmp_path / "rows.csv"
    options = ["--in-process", "--no-report", "--out", tmp_path / "runs", "--stream", f"table:{file}"]
    done = hilbench_with(tmp_path, "run", path, *options)
    assert done.returncode == 0, done.stderr
    (record,) = Result.read(run_folders(path)[0] / "result.json").streams or []
    heading, *rows = file.read_text().splitlines()
    assert {"t_s", "F_true_N"} <= set(heading.split(","))
    assert f"stream to table {file}: {len(rows)} samples" in done.stdout
    assert (record.to, record.samples - record.dropped) == (f"table {file}", len(rows))
    assert float(rows[-1].split(",")[heading.split(",").index("t_s")]) > 1.0


def test_one_that_cannot_be_imported_is_a_line_and_nothing_runs(tmp_path: Path) -> None:
    install(tmp_path, "broken", "raise RuntimeError('no tables')\n", GROUP, table="Rows")
    path = config(tmp_path, steps=SHORT)
    done = hilbench_with(tmp_path, "run", path, "--in-process", "--out", tmp_path / "runs", "--stream", "table:x")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "table: broken:Rows of broken can't be loaded (RuntimeError: no tables)" in done.stderr
    assert not (tmp_path / "runs").exists()
