"""What other tools read, and what is read of other machines."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cantools
import numpy as np
import pytest

from hilbench.bench.nodes import Nodes
from hilbench.bench.pdo_set import pdo_set_dbc
from hilbench.bus.frame import EXTENDED_FLAG, Frame
from hilbench.errors import UnusableInputError
from hilbench.experiment.config import load
from hilbench.record.foreign import read_foreign
from hilbench.record.recording import Recording, read_recording, write_recording
from hilbench.record.trace_files import read_trace, write_trace

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


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log"])
def test_frames_survive_the_formats_of_other_tools(tmp_path: Path, suffix: str) -> None:
    start_ns = 1_790_000_000_000_000_000
    frames = [Frame(0x181, bytes(range(8)), start_ns), Frame(EXTENDED_FLAG | 0x12345, b"\1", start_ns + 2_000_000)]
    path = tmp_path / f"trace{suffix}"
    assert write_trace(frames, path, "can0") == 2
    found = list(read_trace(path))
    assert [(frame.can_id, frame.data) for frame in found] == [(frame.can_id, frame.data) for frame in frames]
    assert found[1].time_ns - found[0].time_ns == pytest.approx(2_000_000, abs=2_000)


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
    values = twin.decode(nodes.io.state.pack((80.5, 8.7e9)))
    assert list(values.values()) == pytest.approx([80.5, 8.7e9])
    shared = [message.name for message in database.messages if message.frame_id == 0x201]
    assert shared == ["axis1_RPDO1"]


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
    with pytest.raises(UnusableInputError, match="no column 'M3' for tau2_Nm, expected among Zeit"):
        read_foreign(tmp_path / "machine.csv", tmp_path / "map.yaml")
    (tmp_path / "map.yaml").write_text(MAPPING.replace("tau2_Nm", "torque"))
    with pytest.raises(UnusableInputError, match=r"map.yaml:3: .*'torque' does not"):
        read_foreign(tmp_path / "machine.csv", tmp_path / "map.yaml")
