"""Recordings: what is written is read back, and what cannot be used is said in one line."""

from __future__ import annotations

import gzip
import math
import struct
from datetime import UTC, datetime
from pathlib import Path

import asammdf
import numpy as np
import pytest

from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.topology.signals import signals_of, smallest_shapes

FORMATS = ("recording.mf4", "recording.csv", "recording.csv.gz")
SIGNALS = signals_of("web_line", smallest_shapes()["web_line"])
NAMES = tuple(signal.name for signal in SIGNALS)


def sample(samples: int = 300) -> Recording:
    """A recording with every channel of the list, and one of its own."""
    random = np.random.default_rng(1)
    builder = RecordingBuilder((*NAMES, "own_m_s"), expected_rows=100)
    for k in range(samples):
        values = random.normal(size=len(NAMES) + 1)
        row = [
            float(round(abs(value) * 100)) if name in NAMES and SIGNALS[NAMES.index(name)].integer else float(value)
            for name, value in zip((*NAMES, "own_m_s"), values, strict=True)
        ]
        row[0] = k * 0.002
        builder.append(row)
    return builder.recording(datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC), "a run")


@pytest.mark.parametrize("name", FORMATS)
def test_round_trip_is_exact(tmp_path: Path, name: str) -> None:
    recording = sample()
    write_recording(recording, tmp_path / name)
    back = read_recording(tmp_path / name, required=NAMES)
    assert set(back.channels) == set(recording.channels)
    assert next(iter(back.channels)) == "t_s"
    for channel in recording.channels:
        np.testing.assert_array_equal(back[channel], recording[channel])
        assert back[channel].dtype == recording[channel].dtype
        assert back.unit(channel) == recording.unit(channel)


@pytest.mark.parametrize("name", FORMATS)
def test_equal_samples_make_equal_files(tmp_path: Path, name: str) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_recording(sample(), tmp_path / folder / name)
    assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert [path.name for path in (tmp_path / "a").iterdir()] == [name]


def test_mdf_says_unit_meaning_group_and_start(tmp_path: Path) -> None:
    write_recording(sample(), tmp_path / "recording.mf4")
    with asammdf.MDF(tmp_path / "recording.mf4") as mdf:
        assert mdf.start_time == datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
        torque = mdf.get("tau2_Nm")
        assert torque.unit == "N·m"
        assert "axis 2" in torque.comment
        assert mdf.get("own_m_s").unit == "m/s"
        group, _ = mdf.whereis("E_true_Pa")[0]
        assert mdf.groups[group].channel_group.acq_name == "truth"
        assert mdf.get_master(group).tolist() == [k * 0.002 for k in range(300)]


def test_start_time_and_comment_survive(tmp_path: Path) -> None:
    write_recording(sample(), tmp_path / "a.mf4")
    back = read_recording(tmp_path / "a.mf4")
    assert back.start_time == datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
    assert back.comment == "a run"
    write_recording(Recording({"t_s": np.arange(3.0), "x1_m": np.zeros(3)}), tmp_path / "b.mf4")
    assert read_recording(tmp_path / "b.mf4").start_time is None


def test_builder_grows_past_what_was_expected() -> None:
    builder = RecordingBuilder(("t_s", "x1_m"), expected_rows=3)
    for k in range(20_000):
        builder.append((k, -k))
        assert len(builder) == k + 1
    recording = builder.recording()
    np.testing.assert_array_equal(recording["t_s"], np.arange(20_000))
    np.testing.assert_array_equal(recording["x1_m"], -np.arange(20_000))


def test_builder_takes_rows_as_they_stand_in_memory() -> None:
    builder = RecordingBuilder(("t_s", "x1_m", "statusword1"), expected_rows=2, whole={"statusword1"})
    row = bytearray(24)
    for k in range(5):
        if k == 3:
            builder.append((k, 0.5 * k, k))
        else:
            struct.pack_into("=ddq", row, 0, k, 0.5 * k, k)
            builder.append_packed(memoryview(row))
    recording = builder.recording()
    assert recording["x1_m"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert (recording["statusword1"].dtype, recording["statusword1"].tolist()) == (np.uint32, [0, 1, 2, 3, 4])
    with pytest.raises(ValueError, match="different structures"):
        builder.append_packed(memoryview(row)[:16])
    assert len(builder) == 5


def test_builder_refuses_a_row_of_another_length() -> None:
    builder = RecordingBuilder(("t_s", "x1_m"))
    with pytest.raises(struct.error):
        builder.append((1.0,))
    assert len(builder) == 0


@pytest.mark.parametrize("names", [(), ("x1_m",), ("t_s", "x1_m", "x1_m")])
def test_builder_refuses_bad_names(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="expected distinct names"):
        RecordingBuilder(names)


def test_bit_field_with_a_gap_stays_a_float(tmp_path: Path) -> None:
    builder = RecordingBuilder(("t_s", "statusword1"))
    builder.append((0.0, math.nan))
    builder.append((1.0, 0x27))
    recording = builder.recording()
    assert recording["statusword1"].dtype == np.float64
    write_recording(recording, tmp_path / "a.csv")
    assert math.isnan(read_recording(tmp_path / "a.csv")["statusword1"][0])


HEADER = "t_s,x1_m,tau1_Nm\n"


@pytest.mark.parametrize(
    ("text", "required", "place", "problem"),
    [
        ("", (), ":1", "row of channel names"),
        ("0.0,1.0,2.0\n", (), ":1", "row of channel names"),
        ("t_s;x1_m\n0;1\n1;2\n", (), "", ":2: value 1 is '0;1', expected a number"),
        (HEADER, (), "", "0 sample(s), expected at least 2"),
        ("t_s,x1_m,x1_m\n", (), ":1", "channel x1_m is there twice"),
        ("x1_m,tau1_Nm\n1,2\n2,3\n", (), "", "channel t_s missing, expected beside x1_m, tau1_Nm"),
        (HEADER + "0,1,2\n1,1,2\n", ("v1_m_s", "x1_m", "F_next_N"), "", "channel v1_m_s, F_next_N missing"),
        (HEADER + "0,1,2\n1,1\n", (), ":3", "2 values, expected 3 as in the header"),
        (HEADER + "0,1\n1,1\n", (), ":2", "2 values, expected 3 as in the header"),
        (HEADER + "0,1,2\n1,abc,2\n", (), ":3", "value 2 is 'abc', expected a number"),
        (HEADER + "0,1,2\n1,,2\n", (), ":3", "value 2 is '', expected a number"),
        (HEADER + "0,1,2\n2,1,2\n1,1,2\n", (), "", "t_s goes from 2 s to 1 s in sample 3"),
        (HEADER + "0,1,2\n0,1,2\n", (), "", "t_s goes from 0 s to 0 s in sample 2"),
        (HEADER + "0,1,2\nnan,1,2\n", (), "", "t_s of sample 2 is no finite number"),
        (HEADER + "0,1,2\n1,nan,2\n2,inf,2\n", ("x1_m",), "", "channel x1_m has 2 value(s)"),
    ],
)
def test_unusable_csv(tmp_path: Path, text: str, required: tuple[str, ...], place: str, problem: str) -> None:
    path = tmp_path / "recording.csv"
    path.write_text(text)
    with pytest.raises(UnusableInputError) as caught:
        read_recording(path, required)
    message = str(caught.value)
    assert message.startswith(f"{path}{place}")
    assert problem in message
    assert "\n" not in message


def test_nan_is_allowed_where_nobody_asks(tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    path.write_text(HEADER + "0,nan,2\n1,1,2\n")
    assert len(read_recording(path, required=("tau1_Nm",))) == 2


def test_csv_of_other_programs(tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    path.write_bytes(b'\xef\xbb\xbf"t_s", x1_m\r\n0.0, 1e-3\r\n1.0, -2\r\n')
    recording = read_recording(path, required=("x1_m",))
    np.testing.assert_array_equal(recording["x1_m"], [1e-3, -2.0])


@pytest.mark.parametrize("name", FORMATS)
def test_unreadable_files(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with pytest.raises(UnusableInputError, match="recording"):
        read_recording(path)
    path.write_bytes(b"\x00\xffnot a recording at all\n" * 20)
    with pytest.raises(UnusableInputError) as caught:
        read_recording(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("keep", [10, 70, 2000, -20000])
def test_cut_off_files(tmp_path: Path, keep: int) -> None:
    write_recording(sample(), tmp_path / "whole.csv.gz")
    path = tmp_path / "cut.csv.gz"
    path.write_bytes((tmp_path / "whole.csv.gz").read_bytes()[:keep])
    with pytest.raises(UnusableInputError, match="cannot be read"):
        read_recording(path)
    write_recording(sample(), tmp_path / "whole.mf4")
    path = tmp_path / "cut.mf4"
    path.write_bytes((tmp_path / "whole.mf4").read_bytes()[:keep])
    with pytest.raises(UnusableInputError, match=r"not an MDF file|cut off"):
        read_recording(path)


def test_channels_with_time_bases_of_their_own(tmp_path: Path) -> None:
    with asammdf.MDF(version="4.10") as mdf:
        for name, samples in (("x1_m", 5), ("x2_m", 6)):
            mdf.append(asammdf.Signal(np.zeros(samples), np.arange(float(samples)), name=name))
        mdf.save(tmp_path / "recording.mf4")
    with pytest.raises(UnusableInputError, match="x2_m has a time base of its own"):
        read_recording(tmp_path / "recording.mf4")


def test_another_suffix(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"expected a recording: \.mf4, \.csv, \.csv\.gz or \.parquet"):
        read_recording(tmp_path / "recording.xlsx")
    with pytest.raises(UnusableInputError, match="expected a recording"):
        write_recording(sample(3), tmp_path / "recording")


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="cannot be written"):
        write_recording(sample(3), tmp_path / "nowhere" / "recording.csv")


def test_gzip_is_a_gzip(tmp_path: Path) -> None:
    write_recording(sample(3), tmp_path / "recording.csv.gz")
    with gzip.open(tmp_path / "recording.csv.gz", "rt") as file:
        assert file.readline().startswith("t_s,v1_cmd_m_s,v2_cmd_m_s,x1_m,")
