"""What other tools read, and what is read of other machines."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import cantools
import numpy as np
import pytest
from tests.cli.in_process import hilbench

from hilbench.canopen.dbc import DbcMessage, dbc_text
from hilbench.canopen.eds import load_eds
from hilbench.canopen.pdo import PdoMap
from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.pdo_set import pdo_set_dbc
from hilbench.results.import_mapping import read_foreign
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.trace_files import read_trace
from hilbench.runs.config import load

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"


def test_parquet_gives_back_what_was_written(tmp_path: Path) -> None:
    channels = {"t_s": np.arange(5) * 0.002, "x1_m": np.array([0.1, 0.2, np.nan, 1e-300, 3.0])}
    channels["statusword1"] = np.array([1, 2, 3, 4, 5], np.uint32)
    written = Recording(channels, datetime(2026, 1, 2, tzinfo=UTC), "a run")
    write_recording(written, tmp_path / "a.parquet")
    found = read_recording(tmp_path / "a.parquet")
    assert (found.start_time, found.comment, found.unit("x1_m")) == (written.start_time, "a run", "m")
    for name, values in channels.items():
        assert found[name].dtype == values.dtype
        assert np.array_equal(found[name], values, equal_nan=name == "x1_m")
    (tmp_path / "b.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(UnusableInputError, match=r"b.parquet: not a readable Parquet file"):
        read_recording(tmp_path / "b.parquet")


CANDUMP = """\
(1700000000.005123) can0 181#0001020304050607 R
(1700000000.006123) can1 00012345#01 R
(1700000000.007123) can0 281#0102 T
"""
ODD = (
    CANDUMP
    + """\
(1700000000.008123) can0 191##3000102030405060708090A0B R
(1700000000.009123) can0 181#R8 R
(1700000000.010123) can0 20000080#0000000000000000 R
"""
)


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".log"])
def test_a_trace_of_two_buses_comes_back_as_it_was_from_any_format(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "a.log").write_text(CANDUMP)
    there = hilbench("convert", tmp_path / "a.log", tmp_path / f"b{suffix}")
    back = hilbench("convert", tmp_path / f"b{suffix}", tmp_path / "c.log")
    assert (there.stderr, back.stderr, back.stdout) == ("", "", f"{tmp_path / 'c.log'}: 3 frames\n")
    assert (tmp_path / "c.log").read_text() == CANDUMP
    assert [frame.data.hex() for frame in read_trace(tmp_path / f"b{suffix}")] == ["0001020304050607", "01", "0102"]


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
def test_can_fd_remote_and_error_frames_come_back_where_a_format_holds_them(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "a.log").write_text(ODD)
    lossy = suffix == ".asc"  # an error frame without its class
    there = hilbench("convert", tmp_path / "a.log", tmp_path / f"b{suffix}", *["--allow-loss"] * lossy)
    assert there.returncode == 0, there.stderr
    assert ("does not hold 1 × error class of a frame" in there.stderr) == lossy
    assert hilbench("convert", tmp_path / f"b{suffix}", tmp_path / "c.log").returncode == 0
    assert (tmp_path / "c.log").read_text() == ODD
    with pytest.raises(UnusableInputError, match=r"a CAN FD frame.*, expected classical CAN"):
        list(read_trace(tmp_path / f"b{suffix}"))


def test_what_a_format_does_not_hold_is_told_and_written_only_when_asked(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(ODD.replace("can1", "vcan7"))
    refused = hilbench("convert", tmp_path / "a.log", tmp_path / "b.trc")
    lost = ".trc does not hold 1 × CAN FD frame, 1 × remote frame, 1 × error frame"
    assert (refused.returncode, refused.stdout) == (1, "")
    assert f"b.trc: {lost} (" in refused.stderr
    assert "--allow-loss" in refused.stderr
    assert not (tmp_path / "b.trc").exists()
    done = hilbench("convert", tmp_path / "a.log", tmp_path / "b.trc", "--allow-loss")
    assert (done.returncode, done.stdout) == (0, f"{tmp_path / 'b.trc'}: 3 frames\n")
    told = [f"hilbench: {tmp_path / 'a.log'}: {text}" for text in (lost, "channels have numbers in it: vcan7 is 8")]
    assert done.stderr.splitlines() == told
    assert len(list(read_trace(tmp_path / "b.trc"))) == 3


def test_a_last_line_without_an_end_is_converted_and_told(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(CANDUMP.removesuffix("\n"))
    done = hilbench("convert", tmp_path / "a.log", tmp_path / "b.log")
    assert done.stdout.endswith(": 3 frames\n")
    assert "the last line has no line end, its data may be cut off: taken as it is" in done.stderr
    (tmp_path / "a.log").write_text(CANDUMP + "(1700000000.0081")
    assert "left out" in hilbench("convert", tmp_path / "a.log", tmp_path / "b.log").stderr


ASC = """\
date Mon Jan 6 10:00:00.000 am 2025
base hex  timestamps absolute
internal events logged
   0.010000 1  181             Rx   d 2 00 11
"""


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ("date Mon Jan 6 10:00:00.000 am 2025", ""),
        ("date lundi 6 janvier 2025", "its date is not understood"),
        ("// no date", "it says no date: times count from the start"),
    ],
)
def test_the_date_of_a_trace_is_kept_or_its_loss_told(tmp_path: Path, header: str, told: str) -> None:
    (tmp_path / "a.asc").write_text(ASC.replace("date Mon Jan 6 10:00:00.000 am 2025", header))
    done = hilbench("convert", tmp_path / "a.asc", tmp_path / "b.log")
    assert done.returncode == 0, done.stderr
    assert told in done.stderr if told else done.stderr == ""
    (frame,) = read_trace(tmp_path / "b.log")
    start_s = 0.0 if told else datetime(2025, 1, 6, 10).timestamp()
    assert frame.time_ns * 1e-9 == pytest.approx(start_s + 0.01, abs=1e-5)


def test_time_stamps_relative_to_the_line_before_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(ASC.replace("timestamps absolute", "timestamps relative"))
    done = hilbench("convert", tmp_path / "a.asc", tmp_path / "b.log")
    assert done.returncode == 2
    assert "a.asc: time stamps relative to the line before, expected absolute ones" in done.stderr


def test_lines_of_a_trace_that_nobody_reads_are_counted(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(CANDUMP)
    hilbench("convert", tmp_path / "a.log", tmp_path / "b.trc")
    with open(tmp_path / "b.trc", "a") as file:
        file.write("      4         9.000 ST  1      00 Rx -  4    00 00 00 04\n")
    done = hilbench("convert", tmp_path / "b.trc", tmp_path / "c.log")
    assert "1 × TRCReader: Unsupported type" in done.stderr


@pytest.mark.parametrize("name", ["bad.asc", "bad.blf", "missing.blf"])
def test_what_is_no_trace_is_refused(tmp_path: Path, name: str) -> None:
    if name.startswith("bad"):
        (tmp_path / name).write_bytes(b"no trace at all")
    with pytest.raises(UnusableInputError, match=rf"{name}: .*expected a trace|{name}: not a readable .blf trace"):
        list(read_trace(tmp_path / name))


def test_a_dbc_reader_decodes_the_pdos_of_a_bench_in_si_units() -> None:
    config, _ = load(CONFIG)
    database = cantools.database.load_string(pdo_set_dbc(config), "dbc")
    nodes = Nodes(config)
    tpdo1 = database.get_message_by_name("axis2_TPDO1")
    told = tpdo1.decode(nodes.pdo_maps("axis2")[1].pack((0x1637, -200, 1_048_576)))
    assert told["Torque_actual_value"] == pytest.approx(-1.0)  # per mille of 5 N·m
    assert told["Position_actual_value"] == pytest.approx(2 * np.pi)
    assert tpdo1.get_signal_by_name("Position_actual_value").unit == "rad"
    twin = database.get_message_by_name("virtual_io_TPDO1")
    values = twin.decode(nodes.io.sent[0].pack((80.5, 8.7e9)))
    assert values == {"F_sim_N": 80.5, "E_sim_Pa": pytest.approx(8.7e9)}
    shared = [message.name for message in database.messages if message.frame_id == 0x201]
    assert shared == ["axis1_RPDO1"]


def test_a_dbc_file_of_a_servo_axis_names_what_its_twin_finds_in_its_units() -> None:
    config, _ = load(CONFIG.with_name("servo_axis.yaml"))
    database = cantools.database.load_string(pdo_set_dbc(config), "dbc")
    twin = [database.get_message_by_name(f"virtual_io_TPDO{number}") for number in (1, 2)]
    units = {signal.name: signal.unit for message in twin for signal in message.signals}
    assert units == {"J_sim_kg_m2": "kgm^2", "coulomb_sim_Nm": "Nm", "J_sd_kg_m2": "kgm^2", "tau1_residual_Nm": "Nm"}
    more = [database.get_message_by_name(f"virtual_io_TPDO{number}") for number in (4, 5)]
    assert {signal.name: signal.unit for message in more for signal in message.signals} == {
        "viscous_sim_Nm_s_per_rad": "Nms/rad",
        "viscous_sd_Nm_s_per_rad": "Nms/rad",
        "coulomb_sd_Nm": "Nm",
    }


MAPPING = """
file: {delimiter: ";", decimal: ",", skip_rows: 1, encoding: latin-1}
channels:
  tau2_Nm: M2
  v2_m_s: {column: "v Bahn [m/min]", factor: 0.0166666666666667}
  t_s: {column: Zeit, factor: 0.001, offset: 1.0}
"""


def test_a_recording_of_another_machine_comes_in_by_its_columns(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAPPING)
    table = "Anlage Süd\nZeit;v Bahn [m/min];M2;Text\n0;180,0;1,25;a\n2;181,2;1,5;b\n"
    (tmp_path / "machine.csv").write_bytes(table.encode("latin-1"))
    found = read_foreign(tmp_path / "machine.csv", tmp_path / "map.yaml")
    assert list(found.channels) == ["t_s", "tau2_Nm", "v2_m_s"]
    assert found.time_s == pytest.approx([1.0, 1.002])
    assert found["v2_m_s"] == pytest.approx([3.0, 3.02])
    (tmp_path / "map.yaml").write_text(MAPPING.replace("M2", "M3"))
    with pytest.raises(UnusableInputError, match="no column 'M3' for tau2_Nm, expected one of Zeit"):
        read_foreign(tmp_path / "machine.csv", tmp_path / "map.yaml")
    (tmp_path / "map.yaml").write_text(MAPPING.replace("tau2_Nm", "torque"))
    with pytest.raises(UnusableInputError, match=r"map.yaml:3: .*'torque' does not"):
        read_foreign(tmp_path / "machine.csv", tmp_path / "map.yaml")


def test_a_recording_with_a_row_of_units_or_iso_times_comes_in(tmp_path: Path) -> None:
    (tmp_path / "units.csv").write_text("Zeit;M2\ns;Nm\n0;3,0\n2;3,1\n")
    (tmp_path / "units.yaml").write_text(
        'file: {delimiter: ";", decimal: ","}\nchannels:\n  t_s: {column: Zeit, factor: 0.001}\n  tau2_Nm: M2\n'
    )
    said: list[str] = []
    found = read_foreign(tmp_path / "units.csv", tmp_path / "units.yaml", said.append)
    assert (found["t_s"].tolist(), found["tau2_Nm"].tolist()) == ([0.0, 0.002], [3.0, 3.1])
    assert said == [f"line 2 of {tmp_path / 'units.csv'} is no row of numbers, and taken as one of units: s;Nm"]
    (tmp_path / "iso.csv").write_text(
        "Time,v2,Remark\n2024-05-01 12:00:00.000,1.0,start\n2024-05-01T12:00:00.002Z,1.1,go\n"
    )
    (tmp_path / "iso.yaml").write_text("channels:\n  t_s: Time\n  v2_m_s: v2\n")
    found = read_foreign(tmp_path / "iso.csv", tmp_path / "iso.yaml")
    assert found["t_s"].tolist() == [0.0, 0.002]


@pytest.mark.parametrize(
    ("text", "times_s"),
    [
        ("Time,v2\ns,m/s\nREAL64,REAL64\n0,1\n0.5,2\n", [0.0, 0.5]),
        ("Time,v2\n12:59:59.900,1\n13:00:00.150,2\n", [0.0, 0.25]),
    ],
    ids=["units and types", "times of day"],
)
def test_a_recording_with_more_rows_of_heads_or_times_of_day_comes_in(
    tmp_path: Path, text: str, times_s: list[float]
) -> None:
    (tmp_path / "run.csv").write_text(text)
    (tmp_path / "run.yaml").write_text("channels:\n  t_s: Time\n  v2_m_s: v2\n")
    found = read_foreign(tmp_path / "run.csv", tmp_path / "run.yaml")
    assert found["t_s"].tolist() == pytest.approx(times_s)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("Time,v2\n01.05.2024 12:00,1\n01.05.2024 12:01,1\n", "column 'Time' for t_s has '01.05.2024 12:00'"),
        ("Time,v2\n0,1\n1,ERR\n", "column 'v2' for v2_m_s has 'ERR'"),
    ],
)
def test_a_column_that_is_there_without_numbers_is_named_with_its_text(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / "run.csv").write_text(text)
    (tmp_path / "run.yaml").write_text("channels:\n  t_s: Time\n  v2_m_s: v2\n")
    with pytest.raises(UnusableInputError, match=re.escape(f"{place}, expected numbers, or times by ISO 8601")):
        read_foreign(tmp_path / "run.csv", tmp_path / "run.yaml")


@pytest.mark.parametrize("encoding", [None, "utf-8", "cp1252"], ids=["as cantools does", "utf-8", "cp1252"])
def test_units_and_comments_of_a_dbc_file_are_the_same_in_any_encoding(tmp_path: Path, encoding: str | None) -> None:
    done = hilbench("dbc", CONFIG, "--out", tmp_path / "bench.dbc")
    assert done.returncode == 0, done.stderr
    database = cantools.database.load_file(tmp_path / "bench.dbc", **({"encoding": encoding} if encoding else {}))
    units = {signal.unit for message in database.messages for signal in message.signals}
    assert units == {None, "rad", "rad/s", "Nm", "N", "Pa"}
    assert (tmp_path / "bench.dbc").read_bytes().isascii()


def test_names_of_any_language_come_into_a_dbc_file() -> None:
    od = load_eds(CONFIG.parents[1] / "eds" / "hilbench_servo.eds", 1)
    variable = od[0x6064]
    variable.name = "Lage-Istwert der Förderachse Ω"
    message = DbcMessage("axis", "axis", PdoMap(0x181, 1, (variable,)), ((1.0, "µm/s²"),))
    text = dbc_text([message], "Prüfstand")
    assert text.isascii()
    (signal,) = cantools.database.load_string(text, "dbc").messages[0].signals
    assert (signal.unit, signal.comment) == ("um/s^2", "6064h:0 Lage-Istwert der Forderachse ?")


def test_names_that_begin_alike_stay_apart_in_a_dbc_file() -> None:
    od = load_eds(CONFIG.parents[1] / "eds" / "hilbench_servo.eds", 1)
    begins = "Temperature of the winding of phase"
    for index, letter in ((0x6040, "U"), (0x6041, "V")):
        od[index].name = f"{begins} {letter}"
    message = DbcMessage("axis", "axis", PdoMap(0x181, 1, (od[0x6040], od[0x6041])), (None, None))
    found = cantools.database.load_string(dbc_text([message], ""), "dbc").messages[0]
    assert len(begins) > 32
    assert found.decode(bytes([1, 0, 2, 0])) == {
        "Temperature_of_the_winding_of_phase_U": 1,
        "Temperature_of_the_winding_of_phase_V": 2,
    }


@pytest.mark.parametrize("how", ["same name", "another path", "symbolic link", "hard link"])
@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_convert_never_writes_over_what_it_reads(tmp_path: Path, how: str, suffix: str) -> None:
    source = tmp_path / f"a{suffix}"
    content = b"t_s,x1_m\n0,1\n0.002,2\n" if suffix == ".csv" else b"(1.000001) vcan0 181#0011\n"
    source.write_bytes(content)
    target = tmp_path / f"b{suffix}"
    if how == "same name":
        target = source
    elif how == "another path":
        target = tmp_path / "folder" / ".." / source.name
        (tmp_path / "folder").mkdir()
    elif how == "symbolic link":
        target.symlink_to(source)
    else:
        target.hardlink_to(source)
    done = hilbench("convert", source, target)
    assert done.returncode == 2
    assert "is what is read" in done.stderr
    assert source.read_bytes() == content


def test_convert_does_not_write_over_its_mapping_file(tmp_path: Path) -> None:
    (tmp_path / "machine.csv").write_text("Zeit,M2\n0,1\n2,2\n")
    mapping = tmp_path / "columns.csv"
    mapping.write_text("channels: {t_s: {column: Zeit, factor: 0.001}, tau2_Nm: M2}\n")
    done = hilbench("convert", tmp_path / "machine.csv", mapping, "--columns", mapping)
    assert done.returncode == 2
    assert mapping.read_text().startswith("channels:")


def test_columns_that_are_no_channel_are_told_with_what_may_have_been_meant(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t_s,x1_m,x3_m,tau2_NM,v2_cmdm_s,note,bearing_N\n0,1,1,1,1,1,1\n0.002,2,2,2,2,2,2\n"
    )
    done = hilbench("convert", tmp_path / "a.csv", tmp_path / "b.csv")
    assert done.returncode == 0
    expected = "'tau2_NM' (did you mean tau2_Nm?), 'v2_cmdm_s' (did you mean v2_cmd_m_s?), 'note'"
    assert done.stderr.splitlines() == [f"hilbench: {tmp_path / 'a.csv'}: columns that are no channel: {expected}"]
    assert "tau2_NM" in read_recording(tmp_path / "b.csv")  # it is kept as it is
    model = CONFIG.parent / "identification.yaml"
    for command in ("diagnose", "sync"):
        refused = hilbench(command, tmp_path / "a.csv", "--model", model)
        assert refused.returncode == 2
        assert expected in refused.stderr
    with pytest.raises(UnusableInputError, match=r"channel tau2_Nm missing, did you mean 'tau2_NM'"):
        read_recording(tmp_path / "b.csv").require(["tau2_Nm"], "b.csv")


def test_columns_that_a_mapping_leaves_out_are_told(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("channels: {t_s: Zeit, tau2_Nm: M2}\n")
    (tmp_path / "machine.csv").write_text("Zeit,M1,M2,v\n0,1,1,1\n2,2,2,2\n")
    words = ["convert", tmp_path / "machine.csv", tmp_path / "a.csv", "--columns", tmp_path / "map.yaml"]
    done = hilbench(*words)
    assert done.stderr.splitlines() == [
        f"hilbench: {tmp_path / 'machine.csv'}: columns that {tmp_path / 'map.yaml'} does not name: M1, v"
    ]
    (tmp_path / "map.yaml").write_text("channels: {t_s: Zeit, tau2_Nm: m2}\n")
    assert "did you mean 'M2'?" in hilbench(*words).stderr
