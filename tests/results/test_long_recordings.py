"""Recordings that are longer than memory: they grow on disk, survive a kill to the last sample, and are read short."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from datetime import UTC, datetime
from pathlib import Path

import asammdf
import numpy as np
import pytest

from hilbench.errors import BenchFaultError
from hilbench.results import recording as recordings
from hilbench.results import reduction, spool
from hilbench.results.mdf import MdfPieces
from hilbench.results.recording import (
    BLOCK_ROWS,
    Recording,
    convert_recording,
    read_recording,
    read_section,
    write_recording,
)
from hilbench.results.run_folder import RunFolder
from hilbench.results.spool import Spool, SpooledPieces, read_running
from hilbench.runs.metrics import judge
from hilbench.topology.signals import signals_of, smallest_shapes

SIGNALS = signals_of("web_line", smallest_shapes()["web_line"])
STARTED = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
ROW = [0.0] * len(SIGNALS)


def begin(folder: Path, **settings: bool) -> Spool:
    return Spool(RunFolder(folder), SIGNALS, STARTED, "a night", 0.002, **settings)


def fill(rows: Spool, first: int, count: int) -> None:
    for k in range(first, first + count):
        ROW[0], ROW[1] = k * 0.002, float(k % 7)
        rows.append([int(value) if signal.integer else value for signal, value in zip(SIGNALS, ROW, strict=True)])


def test_a_recording_takes_no_more_memory_the_longer_it_gets(tmp_path: Path) -> None:
    rows = begin(tmp_path)
    fill(rows, 0, 4 * BLOCK_ROWS)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    fill(rows, 4 * BLOCK_ROWS, 8 * BLOCK_ROWS)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    rows.finish()
    assert grown < 0.1 * 8 * BLOCK_ROWS * 8 * len(SIGNALS)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["recording.mf4"]
    found = read_recording(tmp_path / "recording.mf4")
    assert found.start_time == STARTED
    assert np.array_equal(found.time_s, np.arange(12 * BLOCK_ROWS) * 0.002)


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.results.test_long_recordings import begin, fill
rows = begin(Path(sys.argv[1]), around_events=sys.argv[3] == "around_events")
fill(rows, 0, int(sys.argv[2]))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("count", [5, BLOCK_ROWS, 3 * BLOCK_ROWS + 100])
def test_a_kill_costs_no_sample(tmp_path: Path, count: int) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(count), "always"], check=False)
    pieces = list(SpooledPieces(RunFolder(tmp_path), SIGNALS))
    time_s = np.concatenate([piece["t_s"] for piece in pieces])
    assert np.array_equal(time_s, np.arange(count) * 0.002)


def test_other_tools_read_a_recording_that_is_still_written(tmp_path: Path) -> None:
    rows = begin(tmp_path)
    fill(rows, 0, 2 * BLOCK_ROWS + 10)
    assert len(rows.recording()) == 2 * BLOCK_ROWS + 10  # waits until all full blocks are on disk
    with asammdf.MDF(tmp_path / "recording.part.mf4") as mdf:
        assert len(mdf.get(SIGNALS[1].name).samples) == 2 * BLOCK_ROWS
    rows.finish()


def test_what_a_run_has_by_now_is_read_while_it_goes_on(tmp_path: Path) -> None:
    rows = begin(tmp_path)
    for first in range(0, 3 * BLOCK_ROWS, 5000):
        fill(rows, first, 5000)
        found = read_running(RunFolder(tmp_path), SIGNALS)
        assert np.array_equal(found.time_s, np.arange(first + 5000) * 0.002)
    rows.finish()


def test_a_disk_that_is_full_ends_the_recording_with_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    rows = begin(tmp_path)
    rows.warn = said.append

    def full(self: object, columns: object) -> None:
        raise OSError(28, "No space left on device")

    fill(rows, 0, BLOCK_ROWS + 1)
    rows.recording()
    monkeypatch.setattr(spool.MdfWriter, "append", full)
    fill(rows, BLOCK_ROWS + 1, 4 * BLOCK_ROWS)
    assert len(said) == 1
    assert "No space left" in said[0]
    with pytest.raises(BenchFaultError, match="cannot be written"):
        rows.finish()
    assert len(read_recording(tmp_path / "recording.mf4")) == BLOCK_ROWS


def step_change(samples: int) -> Recording:
    """A step of E at half of the time; noise and one spike elsewhere."""
    time_s = np.arange(samples) * 0.002
    random, half = np.random.default_rng(1), time_s[samples // 2]
    true = np.where(time_s < half, 8.7e9, 10.5e9)
    found = np.where(time_s < half, 8.7e9, 10.5e9 - 1.8e9 * np.exp(-np.maximum(time_s - half, 0.0) / 0.05))
    tension = 80.0 + 0.1 * random.normal(size=samples)
    tension[samples // 5] = 95.0
    return Recording(
        {
            "t_s": time_s,
            "E_true_Pa": true,
            "E_sim_Pa": found + 1e6 * random.normal(size=samples),
            "F_true_N": tension,
            "F_ref_N": np.full(samples, 80.0),
            "v2_cmd_m_s": np.full(samples, 3.0),
            "statusword1": np.full(samples, 0x1637, np.uint32),
        }
    )


@pytest.fixture
def long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Recording, Path]:
    """A recording of five times as many values as may be in memory."""
    for module in (reduction, recordings):
        monkeypatch.setattr(module, "MOST_VALUES", 280_000)
    whole = step_change(200_000)
    write_recording(whole, tmp_path / "recording.mf4")
    return whole, tmp_path / "recording.mf4"


def test_a_long_recording_is_read_with_all_of_its_spikes_and_the_same_figures(long: tuple[Recording, Path]) -> None:
    whole, path = long
    found = read_recording(path)
    assert len(found) * 7 <= 1.1 * 280_000
    assert found.samples == 200_000
    assert (found["F_true_N"].min(), found["F_true_N"].max()) == (whole["F_true_N"].min(), whole["F_true_N"].max())
    assert set(found["statusword1"].tolist()) == {0x1637}
    step_s = whole.time_s[100_000]
    near = (found.time_s > step_s - 5.0) & (found.time_s < step_s + 9.0)
    assert np.count_nonzero(near) == 7_000 - 1  # full rate
    whole_figures, figures = (judge(each.channels).metrics() for each in (whole, found))
    judged = {name for name, value in whole_figures.items() if value is not None}
    assert judged == {name for name, value in figures.items() if value is not None}
    for name in ("E_time_to_1pct_s", "E_noise_pct", "E_final_error_pct", "E_overshoot_pct"):
        assert figures[name] == pytest.approx(whole_figures[name], rel=1e-6), name


def test_a_section_of_a_long_recording_has_all_samples_of_its_time(long: tuple[Recording, Path]) -> None:
    whole, path = long
    for around_s, holds_s in ((-np.inf, 0.0), (250.0, 250.0), (np.inf, whole.time_s[-1])):
        found = read_section(path, around_s)
        assert 30_000 < len(found) <= 50_000
        assert found.time_s[0] <= holds_s <= found.time_s[-1]
        at = int(np.searchsorted(whole.time_s, found.time_s[0]))
        assert np.array_equal(found["F_true_N"], whole["F_true_N"][at : at + len(found)])


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.mf4"])
def test_all_samples_of_a_long_recording_go_into_other_formats(long: tuple[Recording, Path], name: str) -> None:
    whole, path = long
    samples, names = convert_recording(path, path.with_name(name))
    assert (samples, len(names)) == (200_000, 7)
    if name == "a.mf4":
        assert MdfPieces(path.with_name(name)).rows == 200_000
        return
    back = read_recording(path.with_name(name))
    assert np.array_equal(back["F_true_N"], whole["F_true_N"])
