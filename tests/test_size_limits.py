"""Files that are small and stand for much, or are large: `check` and its readers say the limit, and come back."""

from __future__ import annotations

import gzip
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from tests.cli.in_process import hilbench

import can
from hilbench import strict_yaml
from hilbench.canopen.device_configuration import read_file
from hilbench.canopen.eds import load_eds
from hilbench.errors import UnusableInputError
from hilbench.plant.fmu.description import read_fmu
from hilbench.results.import_mapping import read_foreign
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.trace_files import read_trace
from hilbench.runs.config import read_document
from hilbench.runs.scenario import read_scenario

SERVO = Path(__file__).resolve().parents[1] / "eds" / "hilbench_servo.eds"


def laughs(path: Path) -> None:
    """Nine lists of nine times the one before."""
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]" for k in range(1, 10)]
    path.write_text("\n".join(rows))


def laughing_key(path: Path) -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"? &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]\n: 1" for k in range(1, 10)]
    path.write_text("\n".join(rows))


def fan(path: Path) -> None:
    """Each file includes the next one twenty times."""
    for k in range(8):
        name = path if k == 0 else path.with_name(f"{k}.yaml")
        name.write_text(f"include: [{', '.join(20 * [f'{k + 1}.yaml'])}]\n")
    path.with_name("8.yaml").write_text("name: last\n")


def large(path: Path) -> None:
    path.write_bytes(b"# " + b"x" * 20_000_000)


def compact(count: int, objects: int = 1) -> Callable[[Path], None]:
    """An EDS file whose arrays have so many entries, in a line each."""

    def write(path: Path) -> None:
        array = "ParameterName=a\nObjectType=8\nDataType=5\nAccessType=rw\nCompactSubObj="
        path.write_text("\n".join(f"[{0x2000 + k:X}]\n{array}{count}" for k in range(objects)))

    return write


def wide(path: Path) -> None:
    names = ",".join(f"a{k}" for k in range(1_000_000))
    path.write_text(f"t_s,{names}\n0,{names}\n")


def unpacked(name: str) -> Callable[[Path], None]:
    """An FMU of a few MB that unpacks to some GB."""

    def write(path: Path) -> None:
        archive = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        with archive, archive.open(name, "w", force_zip64=True) as file:
            for _ in range(1100):
                file.write(bytes(1_000_000))

    return write


def packed_text(path: Path) -> None:
    """A table of some MB that unpacks to 600 MB."""
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(b"t_s,a\n")
        for _ in range(600):
            file.write(b"0,1\n" * 250_000)


def columns_of_nothing(path: Path) -> None:
    """3 MB of Parquet for 9 GB."""
    columns = [pyarrow.nulls(1_100_000, pyarrow.float64())] * 1000
    names = [f"c{k}" for k in range(1000)]
    parquet.write_table(pyarrow.Table.from_arrays(columns, names), path, compression="zstd")


def one_block_many_times(path: Path) -> None:
    """An MDF file whose list of data names one packed block 125,000 times (ASAM MDF 4: DLBLOCK)."""
    count, times = 4000, 125_025
    write_recording(Recording({"t_s": np.arange(count) * 1e-3, "x": np.zeros(count)}), path)
    data = bytearray(path.read_bytes())
    data[16:24] = b"foreign "  # the program in the identification block
    group, (block,) = data.index(b"##DG"), [at.start() for at in re.finditer(b"##DZ", data)]
    channel_group = data.index(b"##CG")
    (cycles,) = struct.unpack_from("<Q", data, channel_group + 24 + 6 * 8 + 8)
    assert cycles == count
    struct.pack_into("<Q", data, channel_group + 24 + 6 * 8 + 8, count * times)
    data += bytes(-len(data) % 8)
    struct.pack_into("<Q", data, group + 24 + 2 * 8, len(data))
    size = 24 + 8 * (times + 1) + 16
    data += struct.pack("<4s4xQQQ", b"##DL", size, times + 1, 0) + struct.pack("<Q", block) * times
    data += struct.pack("<B3xLQ", 1, times, 16 * count)
    path.write_bytes(data)


def one_large_container(path: Path) -> None:
    """A BLF trace of 200 kB with 200 MB in one container."""
    with can.BLFWriter(path) as writer:
        writer.on_message_received(can.Message(timestamp=1.0, arbitration_id=0x181, data=b"12"))
    head, packed = path.read_bytes()[:144], zlib.compress(bytes(200_000_000), 1)
    container = struct.pack("<H6xL4x", 2, 200_000_000) + packed
    size = 16 + len(container)
    path.write_bytes(head + struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + container + bytes(size % 4))


def imported(path: Path) -> None:
    mapping = path.with_name("columns.yaml")
    mapping.write_text("channels: {t_s: {column: t_s}}\n")
    read_foreign(path, mapping)


@pytest.mark.parametrize(
    ("name", "write", "read", "limit"),
    [
        ("a.yaml", laughs, strict_yaml.load, "more than 10000 values"),
        ("a.yaml", laughing_key, strict_yaml.load, "as a key, expected a name"),
        ("a.yaml", large, strict_yaml.load, "larger than 1 MB"),
        ("a.yaml", fan, read_document, "more than 100 files"),
        ("a.eds", compact(4_294_967_295), lambda path: load_eds(path, 1), "4294967295, expected 0 to 254"),
        ("a.eds", compact(254, 1000), lambda path: load_eds(path, 1), "more than 65536 objects"),
        ("a.eds", large, lambda path: load_eds(path, 1), "larger than 4 MB"),
        ("a.cdcf", large, lambda path: read_file(path, load_eds(SERVO, 1)), "larger than 4 MB"),
        ("a.csv", wide, read_scenario, "1000001 columns, expected at most 1000"),
        ("a.csv", large, read_scenario, "larger than 16 MB"),
        ("a.csv", wide, read_recording, "more than 4096 columns"),
        ("a.csv", wide, imported, "more than 4096 columns"),
        ("a.csv.gz", packed_text, read_recording, "more than 500 MB of text"),
        ("a.csv.gz", packed_text, imported, "more than 500 MB of text"),
        ("a.parquet", columns_of_nothing, read_recording, "1100 million values when unpacked, expected at most 1000"),
        ("a.mf4", one_block_many_times, read_recording, "1000 million values when unpacked, expected at most 1000"),
        ("a.blf", one_large_container, lambda path: list(read_trace(path)), "more than 100 MB when unpacked"),
        ("a.fmu", unpacked("binaries/a.so"), read_fmu, "1100 MB when unpacked, expected at most 1000 MB"),
        ("a.fmu", unpacked("modelDescription.xml"), read_fmu, "1100 MB when unpacked, expected at most 30 MB"),
    ],
)
def test_a_file_beyond_the_limit_of_its_reader_is_refused_with_the_limit(
    name: str, write: Callable[[Path], None], read: Callable[[Path], object], limit: str, tmp_path: Path
) -> None:
    write(tmp_path / name)
    with pytest.raises(UnusableInputError, match=limit) as refused:
        read(tmp_path / name)
    assert str(tmp_path / name).rpartition(".")[0][:-1] in str(refused.value)


def test_check_of_a_config_with_words_of_100_kB_says_a_line_that_can_be_read(tmp_path: Path) -> None:
    path, word = tmp_path / "a.yaml", "x" * 100_000
    texts = ("include: {0}", "bus: {0}", "name: [{0}]", "drives: {{a: {{eds: {0}}}}}", "? {0}\n: 1\n? {0}\n: 1")
    for text in (each.format(word) for each in texts):
        path.write_text(text)
        said = hilbench("check", path)
        assert said.returncode == 2
        assert 0 < max(map(len, said.stderr.splitlines())) < 4000
        assert "unexpected" not in said.stderr


def test_check_of_three_thousand_unknown_keys_names_the_first(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("".join(f"key{k}: 1\n" for k in range(3000)))
    said = hilbench("check", path)
    assert said.returncode == 2
    assert "unknown key 'key0'" in said.stderr
    assert len(said.stderr.splitlines()) < 50


@pytest.mark.parametrize("name", ["a.mf4", "a.csv", "a.csv.gz", "a.parquet", "a.log", "a.asc", "a.blf"])
def test_a_pipe_with_the_name_of_a_recording_or_trace_is_refused_without_waiting(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    read = read_recording if name[2:] in ("mf4", "csv", "csv.gz", "parquet") else lambda path: list(read_trace(path))
    with pytest.raises(UnusableInputError, match="file"):
        read(tmp_path / name)


@pytest.mark.parametrize(
    "words", [["convert", "a.mf4", "b.csv"], ["simulate-drive", "a.eds", "--bus", "embedded:pipes"]]
)
def test_a_command_that_is_given_a_pipe_for_a_file_says_so_without_waiting(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.mf4", "a.eds"):
        os.mkfifo(name)
    done = hilbench(*words)
    assert done.returncode == 2
    assert done.stderr.endswith("is no file, expected one\n")


@pytest.mark.parametrize("suffix", ["mf4", "csv", "csv.gz", "parquet"])
def test_a_recording_is_kept_in_a_folder_whose_name_is_no_utf_8(suffix: str, tmp_path: Path) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xfcller"))
    folder.mkdir()
    path = folder / f"recording.{suffix}"
    write_recording(Recording({"t_s": np.arange(5.0), "v1_m_s": np.ones(5)}), path)
    assert len(read_recording(path)) == 5
