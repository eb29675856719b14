"""Files that were damaged or forged: one clear error, or a file that is as good as it looks. Nothing else, ever."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hilbench.bench.reports.change import Change
from hilbench.canopen.eds import load_eds
from hilbench.errors import UnusableInputError
from hilbench.results.journal import JournalWriter, read_journal
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.result import Fault, Result, Timing
from hilbench.results.trace import TraceReader
from hilbench.results.trace_files import convert_trace, read_trace
from hilbench.runs.config import load

ROOT = Path(__file__).resolve().parents[1]
#: What an attacker, or a disk, puts into text.
SNIPPETS = [
    b"!!python/object/apply:os.system ['touch /tmp/owned']",
    b"&a [*a, *a]",
    b"1e400",
    b"-1",
    b"nan",
    b"\x00",
    b"\xff\xfe",
    b"[[[[[[[[[[",
    b"{",
    b"99999999999999999999",
    b"$NODEID+0xFFFFFFFFF",
    b"<script>",
    b"\n",
    b": ",
]


@cache
def originals() -> dict[str, tuple[bytes, str, Callable[[Path], object]]]:
    """Good files by kind: content, name, and how each is read."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        t = np.arange(50) * 0.002
        recording = Recording({"t_s": t, "v1_m_s": np.sin(t), "x": t**2}, datetime(2026, 1, 1, tzinfo=UTC))
        for suffix in ("mf4", "csv", "csv.gz", "parquet"):
            write_recording(recording, folder / f"recording.{suffix}")
        timing = Timing(
            pace="lockstep", cycle_us=2000, cycles=9, missed=0, jitter_us=None, realtime_factor=1.0, bus_load_pct=60.0
        )
        Result.of([], {"a": 1.0}, timing, [Fault(time_s=1.0, source="bench", text="broken")]).write(folder / "r.json")
        with JournalWriter(folder / "journal.log") as journal:
            journal.write(Change(3, "enabled"))
            journal.write(Change(5, "set", "line_speed_m_s", 0.5))
        frames = b"(1700000000.001000) can0 181#0011AABB R\n(1700000000.002000) can0 080# R\n"
        (folder / "trace.log").write_bytes(frames * 3)
        for suffix in ("blf", "asc"):
            convert_trace(folder / "trace.log", folder / f"trace.{suffix}", print, allow_loss=False)
        shipped = ROOT / "bench_configs" / "web_section_step.yaml"
        servo = ROOT / "eds" / "hilbench_servo.eds"
        return {
            "config": (shipped.read_bytes(), "bench.yaml", load),
            "eds": (servo.read_bytes()[:6000], "drive.eds", lambda path: load_eds(path, 1)),
            "mdf": ((folder / "recording.mf4").read_bytes(), "recording.mf4", read_recording),
            "csv": ((folder / "recording.csv").read_bytes(), "recording.csv", read_recording),
            "gzip": ((folder / "recording.csv.gz").read_bytes(), "recording.csv.gz", read_recording),
            "parquet": ((folder / "recording.parquet").read_bytes(), "recording.parquet", read_recording),
            "blf": ((folder / "trace.blf").read_bytes(), "trace.blf", lambda path: list(read_trace(path))),
            "asc": ((folder / "trace.asc").read_bytes(), "trace.asc", lambda path: list(read_trace(path))),
            "result": ((folder / "r.json").read_bytes(), "result.json", Result.read),
            "journal": ((folder / "journal.log").read_bytes(), "journal.log", read_journal),
            "trace": ((folder / "trace.log").read_bytes(), "trace.log", lambda path: list(TraceReader(path))),
        }


def damaged(content: bytes, places: list[tuple[float, str, bytes]]) -> bytes:
    """Each place (share of the length) is overwritten, cut out, filled or cut off."""
    for share, how, what in places:
        at = int(share * len(content))
        if how == "overwrite":
            content = content[:at] + what + content[at + len(what) :]
        elif how == "insert":
            content = content[:at] + what + content[at:]
        elif how == "remove":
            content = content[:at] + content[at + 1 + len(what) :]
        else:
            content = content[:at]
    return content


def told(read: Callable[[Path], object], path: Path) -> str:
    """The error that a person sees, "" for none."""
    try:
        read(path)
    except UnusableInputError as error:
        return str(error)
    return ""


DAMAGE = st.lists(
    st.tuples(
        st.floats(0.0, 1.0),
        st.sampled_from(["overwrite", "insert", "remove", "cut"]),
        st.sampled_from(SNIPPETS) | st.binary(min_size=1, max_size=8),
    ),
    min_size=1,
    max_size=4,
)


@pytest.mark.filterwarnings("ignore", "error::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "kind", ["config", "eds", "mdf", "csv", "gzip", "parquet", "blf", "asc", "result", "journal", "trace"]
)
def test_a_damaged_file_is_one_clear_error_or_none(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, name, read = originals()[kind]
    path = tmp_path / name
    path.write_bytes(content)
    read(path)

    @settings(
        max_examples=60,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )
    @given(DAMAGE)
    def survives(places: list[tuple[float, str, bytes]]) -> None:
        path.write_bytes(damaged(content, places))
        said = told(read, path)
        assert said.isprintable()
        assert not said or said.startswith(str(path))

    survives()
    assert capsys.readouterr() == ("", "")
    assert not Path("/tmp/owned").exists()
