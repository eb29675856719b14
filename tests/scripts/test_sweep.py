"""`hilbench sweep`: which points, and a sweep with a run that fails, taken up again."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.bench.test_runs import config

from hilbench.errors import UnusableInputError
from hilbench.scripts.sweep import Axis, Row, Sweep, parse_axis, points


def sweep(path: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hilbench.cli", "sweep", str(path), "--out", str(path.parent / "sweep"), *options]
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
        ("a=1,3", 5, "--samples: expected together with a range"),
    ],
)
def test_what_cannot_be_varied_is_said(text: str, samples: int | None, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said):
        points([parse_axis(text)], samples, seed=1)


def test_a_failed_run_leaves_its_row_and_what_is_done_is_not_done_again(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.1}}])
    out, limits = tmp_path / "sweep", [{"safety.tension_limit_N": text} for text in ("1", "400")]
    with pytest.raises(UnusableInputError, match=r"--set safety.tension_limit_N=-1: .*greater than 0"):
        Sweep(path, (), [*limits, {"safety.tension_limit_N": "-1"}], out)
    assert not out.exists()
    done = sweep(path, "--vary", "safety.tension_limit_N=1,400", "--json")
    assert done.returncode == 1, done.stderr
    rows = json.loads(done.stdout)["runs"]
    assert [row["exit_code"] for row in rows] == [3, 0]
    assert "outside 0 to 1 N" in rows[0]["said"]
    with open(tmp_path / "sweep" / "results.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["safety.tension_limit_N"] for row in table] == ["1", "400"]
    assert float(table[1]["bus_load_pct"]) > 10.0
    assert (tmp_path / "sweep" / table[1]["run"] / "recording.mf4").exists()
    assert [vars(row)["exit_code"] for row in Sweep(path, (), limits, out).rows.values()] == [3, 0]
    log = out / "results.jsonl"
    log.write_text(log.read_text()[:-20])  # as a crash leaves it: the last row is torn
    left: list[Row] = []
    resumed = Sweep(path, (), limits, out)
    resumed.run(2, left.append)
    assert len(left) == 1
    assert sorted(resumed.rows) == [0, 1]
    with pytest.raises(UnusableInputError, match="holds another sweep"):
        Sweep(path, (), limits[:1], out)
