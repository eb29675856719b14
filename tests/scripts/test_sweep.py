"""`hilbench sweep`: which points, and a sweep with a run that fails, taken up again."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas
import pytest
from distributed import LocalCluster
from tests.bench.whole_runs import config
from tests.cli.in_process import hilbench

from hilbench.apps.sweep.sweep import Axis, Row, Sweep, parse_axis, points
from hilbench.errors import UnusableInputError
from hilbench.processes import ChildProcess


def sweep(path: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hilbench", "sweep", str(path), "--out", str(path.parent / "sweep"), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_lists_are_combined_and_ranges_are_sampled_evenly() -> None:
    assert parse_axis("a.b=1..2:3") == Axis("a.b", ("1", "1.5", "2"))
    made = points([parse_axis("a=1,2"), parse_axis("b=x"), parse_axis("c=0..10")], 10, seed=3)
    assert [run["a"] for run in made] == ["1"] * 10 + ["2"] * 10
    assert {run["b"] for run in made} == {"x"}
    # A Latin hypercube: one sample in each tenth of the range, the same points for every combination of the lists.
    assert sorted(int(float(run["c"])) for run in made[:10]) == list(range(10))
    assert [run["c"] for run in made[:10]] == [run["c"] for run in made[10:]]
    assert points([parse_axis("c=0..10")], 4, seed=3) == points([parse_axis("c=0..10")], 4, seed=3)


@pytest.mark.parametrize(
    ("text", "samples", "said"),
    [
        ("a", None, "expected KEY=V1,V2"),
        ("a=3..1:4", None, "expected FROM below TO"),
        ("a=1..x", None, "in numbers"),
        ("a=1..3", None, "--samples: expected together with a range"),
        ("a=1..9:1000000000", None, "a COUNT of 2 to 10000"),
        ("a=1..inf:3", None, "expected FROM below TO"),
        ("a=1..3", 10**9, "1000000000 runs in all, expected 10000 at most"),
        ("a=1,3", 5, "--samples: expected together with a range"),
    ],
)
def test_what_cannot_be_varied_is_said(text: str, samples: int | None, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said):
        points([parse_axis(text)], samples, seed=1)


@pytest.mark.slow
def test_a_failed_run_leaves_its_row_and_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.1}}])
    out, cycles = tmp_path / "sweep", [{"cycle_time_s": text} for text in ("0.001", "0.002")]
    with pytest.raises(UnusableInputError, match=r"--set cycle_time_s=-1: .*expected: 0.0005 or more"):
        Sweep(path, (), [*cycles, {"cycle_time_s": "-1"}], out)
    assert not out.exists()
    done = sweep(path, "--vary", "cycle_time_s=0.001,0.002", "--json")
    assert done.returncode == 1, done.stderr
    rows = json.loads(done.stdout)["runs"]
    assert [row["exit_code"] for row in rows] == [2, 0]
    assert "bit times of the 1000" in rows[0]["said"]
    with open(out / "results.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["cycle_time_s"] for row in table] == ["0.001", "0.002"]
    assert float(table[1]["bus_load_pct"]) > 10.0
    assert (out / table[1]["run"] / "recording.mf4").exists()
    typed = pandas.read_parquet(out / "results.parquet")
    assert typed["passed"].tolist() == [False, None]  # nothing is judged
    assert typed["bus_load_pct"][1] == pytest.approx(float(table[1]["bus_load_pct"]))
    again = Sweep(path, (), cycles, out)
    again.run(2, lambda row: pytest.fail(f"run {row.number} is done already"))
    assert again.as_data() == rows
    log = out / "results.jsonl"
    log.write_text(log.read_text()[:-20])  # as a crash leaves it: the last row is torn
    resumed = Sweep(path, (), cycles, out)
    assert len(resumed.rows) == 1
    resumed.run(1, lambda row: None)
    assert len(Sweep(path, (), cycles, out).rows) == 2, "what is written behind the torn row can be read"
    with pytest.raises(UnusableInputError, match="holds another sweep"):
        Sweep(path, (), cycles[:1], out)


def test_a_sweep_prints_its_table_and_draws_metrics_against_what_was_varied(tmp_path: Path) -> None:
    criterion = {"name": "load", "metric": "bus_load_pct", "max": 60}
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.1}}], criteria=[criterion])
    out = tmp_path / "sweep"
    made = Sweep(path, (), [{"cycle_time_s": text} for text in ("0.002", "0.003")], out)
    rows = [(0, "0.002", 1, 80.0), (1, "0.003", 0, 53.25)]
    log = [asdict(Row(n, {"cycle_time_s": text}, code, None, {"bus_load_pct": load})) for n, text, code, load in rows]
    (out / "results.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in log))
    done = hilbench("sweep", path, "--vary", "cycle_time_s=0.002,0.003", "--out", out)
    assert done.returncode == 1, done.stderr
    *table, last = done.stdout.splitlines()
    assert [line.split() for line in table] == [
        ["run", "cycle_time_s", "bus_load_pct"],
        ["0", "0.002", "exit", "code", "1", "80"],
        ["1", "0.003", "passed", "53.25"],
    ]
    assert last == f"2 runs, 1 not passed: {out / 'results.csv'}, {out / 'results.svg'}"
    picture = (out / "results.svg").read_text()
    assert picture.count("<use ") >= 2
    assert made.shown_metrics() == ["bus_load_pct"]


@pytest.mark.slow
def test_a_cluster_does_the_runs_and_one_that_is_not_there_is_said(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.1}}])
    made = Sweep(path, (), [{"cycle_time_s": "0.001"}], tmp_path / "sweep")
    with LocalCluster(  # workers in this process: what crosses is the scheduler's protocol, on loopback
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        made.run(1, lambda row: None, cluster.scheduler_address)
    assert made.rows[0].exit_code == 2
    assert "bit times of the 1000" in made.rows[0].said
    again = Sweep(path, (), [{"seed": "2"}], tmp_path / "other")
    with pytest.raises(UnusableInputError, match="expected a running Dask scheduler"):
        again.run(1, lambda row: None, "gopher://nobody")


@pytest.mark.slow
def test_the_runs_of_a_sweep_are_copies_of_it_that_load_nothing_anew(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.02}}])
    program = f"""if True:
        from pathlib import Path
        from types import SimpleNamespace
        from hilbench import processes
        from hilbench.apps.sweep.sweep import Sweep
        def new_interpreter(*_, **__):
            raise AssertionError("a new interpreter")
        processes.subprocess = SimpleNamespace(Popen=new_interpreter)
        made = Sweep(Path({str(path)!r}), (), [{{"seed": "1"}}, {{"seed": "2"}}], Path("sweep"))
        made.run(2, lambda row: None)
        assert [(row.exit_code, row.said) for row in made.rows.values()] == [(0, ""), (0, "")], made.rows
        assert all((made.out / row.run / "recording.mf4").exists() for row in made.rows.values())
    """
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_whoever_ends_a_sweep_ends_the_runs_that_are_under_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 1.0}}])
    made = Sweep(path, (), [{"steps.0.hold.duration_s": text} for text in ("50000.0", "0.02")], tmp_path / "sweep")
    begun: list[int] = []

    class Noted(ChildProcess):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            begun.append(self.pid)

    def interrupt(row: Row) -> None:
        assert (row.number, row.exit_code) == (1, 0)
        raise KeyboardInterrupt

    monkeypatch.setattr("hilbench.apps.sweep.sweep.ChildProcess", Noted)
    with pytest.raises(KeyboardInterrupt):
        made.run(2, interrupt)
    assert len(begun) == 2
    for pid in begun:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert list(Sweep(path, (), made.runs, made.out).rows) == [1]  # what is left to do when it is started again
