"""Files that are small and stand for much, or are large: `check` and its readers say the limit, and come back."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench

from hilbench import strict_yaml
from hilbench.canopen.device_configuration import read_file
from hilbench.canopen.eds import load_eds
from hilbench.errors import UnusableInputError
from hilbench.plant.fmu.description import read_fmu
from hilbench.results.import_mapping import read_foreign
from hilbench.results.recording import read_recording
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
