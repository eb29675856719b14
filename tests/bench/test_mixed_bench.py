"""Drives of other makers: their units, what their EDS files lack, and what is refused before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.bench.check import check_bench
from hilbench.errors import UnusableInputError
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
MIXED = ROOT / "bench_configs" / "mixed_bench.yaml"


def check(*changes: str) -> list[str]:
    loaded = load_with_overrides(MIXED, changes=list(changes))
    return check_bench(loaded.config, loaded.document).notes


def other_eds(folder: Path, *changes: tuple[str, str]) -> str:
    text = (ROOT / "eds" / "hilbench_servo.eds").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "other.eds").write_text(text)
    return f"drives.axis2.eds={folder / 'other.eds'}"


def test_units_that_differ_are_refused_where_one_frame_feeds_two_devices() -> None:
    assert check() == ["axis2: one unit of velocity (60FFh) moves the web tension by 1.18 N at 1 m/s"]
    with pytest.raises(UnusableInputError, match=r"mixed_bench.yaml:\d+: its velocity unit is 0.00010472 rad/s .*copy"):
        check("mirroring=listen")


def test_a_file_that_lacks_what_the_bench_needs_is_refused_with_the_objects_and_why(tmp_path: Path) -> None:
    changes = (("[1016", "[3016"), ("=0x1016\n", "=0x3016\n"), ("[605E]", "[305E]"), ("=0x605E\n", "=0x305E\n"))
    eds = other_eds(tmp_path, *changes)
    with pytest.raises(UnusableInputError, match=r"yaml:\d+: the EDS lacks 1016h:1 \(the drive watches.*605Eh:0 \(the"):
        check(eds)
    check(eds, "master.heartbeat_ms=0", "drives.axis2.parameters={}")
    with pytest.raises(UnusableInputError, match="an object such as 60A9h or 60C2h:1, 'ramp' is none"):
        check("drives.axis2.parameters={ramp: 1}")


def test_a_drive_that_does_not_tell_its_units_is_refused_until_the_config_does(tmp_path: Path) -> None:
    eds = other_eds(tmp_path, ("[6076]", "[3076]"), ("=0x6076\n", "=0x3076\n"))
    with pytest.raises(UnusableInputError, match=r"yaml:\d+: 6076h is absent or 0, expected it or the unit"):
        check(eds)
    check(eds, "drives.axis2.units.rated_torque_Nm=5.0")
