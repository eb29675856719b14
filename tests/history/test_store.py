"""The history of stands: several runs write at a time, none is lost, and one that is killed leaves the file whole."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.apps.history.store import Entry, History, Quantity
from hilbench.errors import UnusableInputError

BEGAN = datetime(2026, 3, 4, 12, 0, tzinfo=UTC)
#: Writes entries of ten quantities each, one after the other, and says so after each.
WRITER = """
import sys
from datetime import UTC, datetime
from pathlib import Path
from hilbench.apps.history.store import Entry, History, Quantity
path, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
found = [Quantity(f"axis{k}.coulomb_friction.force_N", 5.0 + k, 0.1, "N") for k in range(10)]
for number in range(count):
    entry = Entry("line", f"{name}-{number}", "twin", datetime.now(UTC), path.parent, found)
    History(path).add(entry)
    print(number, flush=True)
"""


def entry(run: str, *quantities: Quantity, stand: str = "line", source: str = "twin", day: float = 0.0) -> Entry:
    return Entry(stand, run, source, BEGAN + timedelta(days=day), Path("runs") / run, quantities)


FRICTION = Quantity("axis2.coulomb_friction.force_N", 8.0, 0.2, "N")


def writer(path: Path, name: str, count: int) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", WRITER, str(path), name, str(count)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_what_was_added_is_read_by_stand_quantity_and_time(tmp_path: Path) -> None:
    history = History(tmp_path / "history.sqlite")
    modulus = Quantity("web.youngs_modulus_Pa", 8.7e9, 1e7, "Pa")
    history.add(entry("b", FRICTION, day=2.0), entry("a", FRICTION, modulus, day=1.0))
    history.add(entry("c", modulus, stand="other"))
    assert history.stands() == ["line", "other"]
    rows = history.rows("line")
    assert [(row.run, row.quantity) for row in rows] == [("a", FRICTION), ("b", FRICTION), ("a", modulus)]
    assert rows[0].time_s == (BEGAN + timedelta(days=1)).timestamp()


def test_a_run_that_is_added_again_takes_its_own_place(tmp_path: Path) -> None:
    history = History(tmp_path / "history.sqlite")
    history.add(entry("a", FRICTION))
    history.add(entry("a", Quantity(FRICTION.name, 9.0, 0.1, "N")))
    history.add(entry("a", FRICTION, source="diagnosis"))
    assert [(row.source, row.quantity.value) for row in history.rows("line")] == [("diagnosis", 8.0), ("twin", 9.0)]


def test_all_of_several_runs_or_none(tmp_path: Path) -> None:
    history = History(tmp_path / "history.sqlite")
    history.add(entry("a", FRICTION))
    with pytest.raises(UnusableInputError):
        history.add(entry("b", FRICTION), entry("c", Quantity("x", 1.0, -1.0, "N")))
    assert [row.run for row in history.rows("line")] == ["a"]


def test_runs_that_end_at_the_same_time_all_get_in(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    writers = [writer(path, name, 12) for name in "abcd"]
    assert [(each.communicate()[1], each.returncode) for each in writers] == [("", 0)] * 4
    assert len(History(path).rows("line")) == 4 * 12 * 10


def test_a_run_that_is_killed_while_it_writes_leaves_the_history_whole(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    for attempt in range(4):
        victim = writer(path, f"run{attempt}", 100_000)
        assert victim.stdout is not None
        said = [victim.stdout.readline() for _ in range(2 + attempt)]
        time.sleep(0.003 * attempt)
        os.kill(victim.pid, signal.SIGKILL)
        said += victim.stdout.readlines()
        victim.wait()
        victim.stderr.close() if victim.stderr else None
        rows = History(path).rows("line")
        runs = {row.run for row in rows}
        assert len(rows) == 10 * len(runs), "each run is there as a whole"
        assert {f"run{attempt}-{int(line)}" for line in said if line.endswith("\n")} <= runs
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


def test_a_file_that_is_no_history_is_told_in_one_line(tmp_path: Path) -> None:
    text = tmp_path / "text.sqlite"
    text.write_text("no data base\n" * 100)
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE song (name TEXT)")
    connection.close()
    for path in (text, other, tmp_path / "none.sqlite", tmp_path):
        with pytest.raises(UnusableInputError, match=r"expected|is no history of stands") as told:
            History(path).rows("line")
        assert str(told.value).startswith(f"{path}: ")
    assert not (tmp_path / "none.sqlite").exists()


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from("ab"), st.sampled_from(("twin", "diagnosis")), st.floats(-1e6, 1e6)), max_size=12
    )
)
def test_the_last_of_each_run_and_source_counts(tmp_path_factory: pytest.TempPathFactory, added: list) -> None:
    history = History(tmp_path_factory.mktemp("history") / "history.sqlite")
    history.replace_all(None, [])
    for run, source, value in added:
        history.add(entry(run, Quantity("q", value, 0.0, "N"), source=source))
    expected = {(run, source): value for run, source, value in added}
    assert {(row.run, row.source): row.quantity.value for row in history.rows("line")} == expected
