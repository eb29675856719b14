"""EDS files: ours, real ones' habits, and what is refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from canopen.objectdictionary import ODArray
from tests.canopen.device_under_test import SECTIONS, U8, eds_text, record, var

from hilbench.canopen.eds import all_variables, find, load_eds, shared_eds, variable
from hilbench.errors import UnusableInputError


def write(folder: Path, text: str) -> Path:
    path = folder / "some.eds"
    path.write_text(text, encoding="latin-1")
    return path


def test_node_id_and_types(tmp_path: Path) -> None:
    od = load_eds(write(tmp_path, eds_text()), 9)
    assert variable(od, 0x1400, 1).default == 0x209
    assert variable(od, 0x1800, 1).default == 0x40000189
    assert (variable(od, 0x2000, 0).min, variable(od, 0x2000, 0).max) == (-100, 100)
    assert variable(od, 0x2006, 0).default == 1.5
    assert od.node_id == 9


@pytest.mark.parametrize(
    ("key", "index", "sub"),
    [
        (0x60FF, 0x60FF, 0),
        ("0x60FF", 0x60FF, 0),
        ("0x1018sub2", 0x1018, 2),
        ("target_velocity", 0x60FF, 0),
        ("identity_object.product_code", 0x1018, 2),
    ],
)
def test_find(tmp_path: Path, key: int | str, index: int, sub: int) -> None:
    found = find(load_eds(write(tmp_path, eds_text()), 1), key)
    assert (found.index, found.subindex) == (index, sub)


@pytest.mark.parametrize("key", [0x6098, "0x1018sub9", "no_such_object", "0x1003sub20"])
def test_find_says_what_is_missing(tmp_path: Path, key: int | str) -> None:
    with pytest.raises(KeyError):
        find(load_eds(write(tmp_path, eds_text()), 1), key)


def test_two_objects_of_one_name_are_not_guessed_between(tmp_path: Path) -> None:
    text = eds_text(SECTIONS | {"3000": var("Twin", U8), "3001": var("Twin", U8)})
    with pytest.raises(KeyError, match="0x3000sub0, 0x3001sub0"):
        find(load_eds(write(tmp_path, text), 1), "twin")


def test_habits_of_real_files(tmp_path: Path) -> None:
    text = (
        "; made by a tool\r\n[FileInfo]\r\nFileName=\r\n[DeviceInfo]\r\nVendorNumber=\r\nRevisionNumber=\r\n"
        "[DummyUsage]\r\nDummy0005=1\r\n[Comments]\r\nLines=3\r\nLine1=only one\r\n"
        # the entry stands before its record, keys and $NodeID in other cases, comments behind values
        "[1800sub1]\r\nparametername=COB-ID\r\nDataType=7\r\nAccessType=RW ; read and write\r\n"
        "DefaultValue=$NodeID + 0x180\r\nLowLimit=\r\nHighLimit=\r\nPDOMapping=\r\n"
        "[1800]\r\nParameterName=TPDO 1\r\nObjectType=0x9\r\nSubNumber=1\r\n"
        "[2000]\r\nParameterName=Signed\r\nDataType=0x3\r\nAccessType=ro\r\nDefaultValue=0xFFFF\r\n"
    )
    od = load_eds(write(tmp_path, text), 3)
    assert variable(od, 0x1800, 1).default == 0x183
    assert variable(od, 0x2000, 0).default == -1
    assert [found.index for found in all_variables(od)] == [0x1800, 0x2000]


def test_compact_arrays_have_the_members_that_are_named(tmp_path: Path) -> None:
    text = (
        "[2100]\nParameterName=Gains\nObjectType=0x8\nDataType=0x6\nAccessType=rw\nDefaultValue=5\nCompactSubObj=3\n"
        "[2100Name]\nNrOfEntries=1\n2=Integral\n[2100Value]\nNrOfEntries=1\n3=8\n"
    )
    od = load_eds(write(tmp_path, text), 1)
    assert isinstance(od[0x2100], ODArray)
    assert variable(od, 0x2100, 0).default == 3
    assert find(od, "gains.integral").subindex == 2
    assert variable(od, 0x2100, 3).value == 8
    with pytest.raises(KeyError):
        variable(od, 0x2100, 4)


def test_a_file_of_several_nodes_is_read_alike_for_each_and_each_has_a_dictionary_of_its_own(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        eds_text()
        + "[2100]\nParameterName=Gains\nObjectType=0x8\nDataType=0x6\nAccessType=rw\nDefaultValue=5\nCompactSubObj=3\n",
    )
    first, second = load_eds(path, 9), load_eds(path, 10)
    assert [one.index for one in all_variables(first)] == [one.index for one in all_variables(second)]
    assert [variable(second, 0x2100, sub).default for sub in range(4)] == [3, 5, 5, 5]
    assert (variable(first, 0x1400, 1).default, variable(second, 0x1400, 1).default) == (0x209, 0x20A)
    variable(first, 0x2100, 1).default = 7
    assert variable(load_eds(path, 9), 0x2100, 1).default == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", r"some\.eds:1: 'hello' found, expected \[section\]"),
        ("[FileInfo]\nFileName=x\n", r"some\.eds: no object is in the file"),
        (
            "[2000]\n" + var("A", U8) + "[2000]\n" + var("B", U8),
            r"some\.eds:8: section \[2000\] is repeated, .* line 1",
        ),
        ("[2000]\nParameterName=A\nParameterName=B\n", r"some\.eds:3: key 'ParameterName' is repeated, .* line 2"),
        ("[2000]\nParameterName=A\nAccessType=rw\n", r"some\.eds:1: \[2000\] has no DataType"),
        ("[2000]\nDataType=5\nAccessType=rw\n", r"some\.eds:1: \[2000\] has no ParameterName"),
        ("[2000]\nParameterName=A\nDataType=five\nAccessType=rw\n", r"some\.eds:3: DataType of \[2000\] is 'five'"),
        (
            "[2000]\nParameterName=A\nDataType=5\nAccessType=r\n",
            r"some\.eds:4: AccessType of \[2000\] is 'r', expected",
        ),
        ("[1015]\n" + var("A", U8, default="300"), r"some\.eds:6: DefaultValue of \[1015\] is '300', expected a value"),
        ("[1015]\n" + var("A", U8, extra="HighLimit=x\n"), r"some\.eds:8: HighLimit of \[1015\] is 'x'"),
        ("[2000]\n" + var("A", U8, extra="ParameterValue=300\n"), r"some\.eds:8: ParameterValue of \[2000\] is '300'"),
        ("[2000sub1]\n" + var("A", U8), r"some\.eds:1: \[2000sub1\] has no array or record \[2000\]"),
    ],
)
def test_unusable_files_are_refused_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UnusableInputError, match=message) as error:
        load_eds(write(tmp_path, text), 1)
    assert "\n" not in str(error.value)


def test_a_limit_beyond_the_range_of_its_type_limits_nothing(tmp_path: Path) -> None:
    od = load_eds(write(tmp_path, "[2000]\n" + var("A", U8, extra="LowLimit=-1\nHighLimit=256\n")), 1)
    assert (variable(od, 0x2000, 0).min, variable(od, 0x2000, 0).max) == (None, None)


def test_a_makers_own_types_are_what_the_file_defines_them_as(tmp_path: Path) -> None:
    """DEFTYPE (ObjectType 5): by a basic type, or by a length in bits as an UNSIGNED32; others are bytes."""
    text = eds_text(SECTIONS) + (
        "[0040]\nParameterName=T_STATE\nObjectType=0x5\nDataType=0x0003\nAccessType=ro\n"
        "[0041]\nParameterName=T_WORD\nObjectType=0x5\nDataType=0x0007\nAccessType=ro\nDefaultValue=16\n"
        "[0042]\nParameterName=T_ODD\nObjectType=0x5\nDataType=0x0007\nAccessType=ro\n"
    )
    values = {"2100": "-3", "2101": "0xBEEF", "2102": "whatever"}
    for index, (code, value) in zip((0x40, 0x41, 0x42), values.items(), strict=True):
        text += f"[{code}]\n{var(f'Value {code}', index, default=value, mappable=True)}\n"
    od = load_eds(write(tmp_path, text), 1)
    assert [variable(od, index, 0).default for index in (0x2100, 0x2101, 0x2102)] == [-3, 0xBEEF, None]
    assert [variable(od, index, 0).data_type for index in (0x2100, 0x2101, 0x2102)] == [3, 6, 0xF]


@pytest.mark.parametrize(
    ("text", "value"), [("0", bytes(6)), ("0xA00000005", b"\5\0\0\0\n\0"), ("050000000a00", b"\5\0\0\0\n\0")]
)
def test_a_time_of_day_has_six_bytes_however_its_default_is_written(tmp_path: Path, text: str, value: bytes) -> None:
    od = load_eds(write(tmp_path, eds_text(SECTIONS | {"2100": var("Time", 0xC, default=text)})), 1)
    assert variable(od, 0x2100, 0).default == value


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="cannot be read"):
        load_eds(tmp_path / "none.eds", 1)


def test_values_of_a_dcf_win(tmp_path: Path) -> None:
    od = load_eds(write(tmp_path, "[2000]\n" + var("A", U8, default="1", extra="ParameterValue=2\n")), 1)
    assert (variable(od, 0x2000, 0).default, variable(od, 0x2000, 0).value) == (1, 2)


def test_array_members_are_those_of_the_file(tmp_path: Path) -> None:
    sections = record(0x2200, "Pair", var("First", U8), var("Second", U8))
    sections["2200"] = "ParameterName=Pair\nObjectType=0x8\n"
    od = load_eds(write(tmp_path, eds_text(sections)), 1)
    assert [found.subindex for found in all_variables(od)] == [0, 1, 2]


def test_each_who_loads_a_file_has_a_dictionary_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "device.eds"
    path.write_text(eds_text(), encoding="ascii")
    mine, theirs = load_eds(path, 5), load_eds(path, 5)
    del mine[0x1000]
    assert 0x1000 not in mine
    assert 0x1000 in theirs
    assert 0x1000 in load_eds(path, 5)


def test_a_shared_dictionary_is_read_once_and_anew_when_its_file_is_another_one(tmp_path: Path) -> None:
    path = write(tmp_path, eds_text())
    first = shared_eds(path, 9)
    assert shared_eds(path, 9) is first
    assert shared_eds(path, 10) is not first
    assert load_eds(path, 9) is not first
    path.write_text(path.read_text().replace("Device type", "Kind of device"))
    assert (first[0x1000].name, shared_eds(path, 9)[0x1000].name) == ("Device type", "Kind of device")
