"""`hilbench sdo dump|load|diff` on simulated drives, and what independent readers make of the files."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from canopen.objectdictionary import import_od
from hypothesis import given
from hypothesis import strategies as st
from tests.cli.drives import EDS, bus, sdo
from tests.cli.in_process import hilbench
from tests.tiers import slow

import can
from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen import concise_dcf
from hilbench.canopen.concise_dcf import Write

__all__ = ["bus"]


@pytest.mark.parametrize("name", ["drive.dcf", *slow("drive.bin")])
def test_a_changed_setting_is_shown_and_put_back_from_the_file(bus: str, tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    assert sdo(bus, "dump", 5, file).returncode == 0
    assert sdo(bus, "diff", 5, file).returncode == 0
    assert sdo(bus, "write", 5, "quick_stop_deceleration", 4000).returncode == 0
    differing = sdo(bus, "diff", 5, file, "--json")
    assert differing.returncode == 1
    assert '"key": "6085h:0"' in differing.stdout
    assert '"first": "4000 (FA0h)"' in differing.stdout
    loaded = sdo(bus, "load", 5, file, "--store")
    assert loaded.returncode == 0, loaded.stdout
    assert sdo(bus, "diff", 5, file).returncode == 0


def test_the_dcf_is_read_by_canopen_and_passes_an_independent_checker(bus: str, tmp_path: Path) -> None:
    file = tmp_path / "drive.dcf"
    sdo(bus, "write", 5, "target_torque", "--", "-20")
    assert sdo(bus, "dump", 5, file).returncode == 0
    read = import_od(str(file))
    assert read.node_id == 5
    assert read[0x6071].value == -20
    assert read[0x1014].value == 0x85
    checked = subprocess.run(
        [Path(sys.executable).with_name("dcfchk"), file], capture_output=True, text=True, check=False
    )
    assert (checked.returncode, checked.stderr) == (0, "")
    sdo(bus, "write", 5, "target_torque", "0")


def test_the_settings_of_one_node_are_given_to_another(bus: str, tmp_path: Path) -> None:
    file = tmp_path / "six.dcf"
    sdo(bus, "write", 6, "quick_stop_deceleration", 5000)
    assert sdo(bus, "dump", 6, file).returncode == 0
    loaded = sdo(bus, "load", 5, file)
    assert "9 COB-IDs of node 6 became those of node 5" in loaded.stdout
    assert "(185h)" not in sdo(bus, "read", 5, "1800:1").stdout
    assert "40000185h" in sdo(bus, "read", 5, "1800:1").stdout
    assert "5000" in sdo(bus, "read", 5, "6085").stdout


def test_what_a_device_has_already_counts_as_there_though_it_refuses_it(bus: str, tmp_path: Path) -> None:
    file = tmp_path / "same.bin"
    file.write_bytes(concise_dcf.encode([Write(0x1018, 2, struct.pack("<I", 0x402))]))
    loaded = sdo(bus, "load", 5, file, "--store")
    assert (loaded.returncode, loaded.stdout[:22]) == (0, "node 5: 1 of 1 objects"), loaded.stdout


def test_a_device_without_1010h_is_loaded_and_said_not_to_store(bus: str, tmp_path: Path) -> None:
    file, eds = tmp_path / "same.bin", tmp_path / "drive.eds"
    file.write_bytes(concise_dcf.encode([Write(0x6085, 0, struct.pack("<I", 6500))]))
    eds.write_text(re.sub(r"(?s)\[1010[^\]]*\].*?(?=\n\[)", "", EDS.read_text()))
    loaded = hilbench("sdo", "load", "5", str(file), "--store", "--bus", bus, "--eds", str(eds))
    assert (loaded.returncode, loaded.stderr) == (1, "")
    first, second = loaded.stdout.splitlines()
    assert first.startswith("node 5: 1 of 1 objects")
    assert second == "not stored: its EDS file has no object 1010h sub 1, by which a device stores its parameters"


SLOW_EDS = """[DeviceInfo]
[1000]
ParameterName=Device type
DataType=0x7
AccessType=ro
[2000]
ParameterName=Slow
DataType=0x7
AccessType=ro
"""


def test_an_object_that_takes_longer_than_a_second_is_read_with_a_time_out(bus: str, tmp_path: Path) -> None:
    (tmp_path / "slow.eds").write_text(SLOW_EDS)
    theirs = open_python_can(BusAddress.parse(bus))

    def answer(message: can.Message) -> None:
        if message.arbitration_id == 0x609:
            if message.data[1:3] == b"\0\x20":
                time.sleep(1.2)
            reply = b"\x43" + bytes(message.data[1:4]) + bytes(4)
            theirs.send(can.Message(arbitration_id=0x589, data=reply, is_extended_id=False))

    notifier = can.Notifier(theirs, [answer])
    try:
        arguments = ["sdo", "dump", "9", str(tmp_path / "slow.dcf"), "--bus", bus, "--eds", str(tmp_path / "slow.eds")]
        short, long = hilbench(*arguments), hilbench(*arguments, "--timeout", "5")
    finally:
        notifier.stop()
        theirs.shutdown()
    assert "not read: 2000h sub 0 Slow: no answer within 1 s, or that of another object" in short.stdout
    assert long.stdout.splitlines() == [f"{tmp_path / 'slow.dcf'}: 2 objects of node 9"]


def test_an_unusable_file_of_the_eds_folder_is_named(bus: str, tmp_path: Path) -> None:
    (tmp_path / "good.eds").write_text(EDS.read_text())
    (tmp_path / "odd.eds").write_text("hello")
    read = hilbench("sdo", "read", "5", "target_torque", "--bus", bus, "--eds", str(tmp_path))
    assert read.returncode == 0
    assert "odd.eds:1: 'hello' found, expected [section] or key=value" in read.stderr


def test_what_a_device_refuses_is_said_by_object(bus: str, tmp_path: Path) -> None:
    file = tmp_path / "wrong.bin"
    file.write_bytes(concise_dcf.encode([Write(0x6041, 0, b"\0\0"), Write(0x6085, 0, struct.pack("<I", 7000))]))
    loaded = sdo(bus, "load", 5, file, "--store")
    assert loaded.returncode == 1
    assert "1 of 2 objects" in loaded.stdout
    assert "6041h sub 0 Statusword: 00 00 refused: abort 06010002h" in loaded.stdout
    assert "not stored" in loaded.stdout


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "0 bytes, expected a number of entries"),
        (b"\1\0\0\0", "ends in entry 1 of 1"),
        (b"\1\0\0\0\x40\x60\0\2\0\0\0\0", "ends in entry 1 of 1 (6040h sub 0): 1 bytes are missing"),
        (b"\0\0\0\0\0", "1 bytes after entry 0"),
    ],
)
def test_a_file_that_is_no_concise_dcf_is_refused_in_one_line(
    bus: str, tmp_path: Path, content: bytes, said: str
) -> None:
    file = tmp_path / "broken.bin"
    file.write_bytes(content)
    done = sdo(bus, "load", 5, file)
    assert done.returncode == 2
    assert f"{file}: {said}" in done.stderr


@pytest.mark.slow
@given(st.lists(st.builds(Write, st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20))))
def test_a_concise_dcf_is_read_as_it_was_written(writes: list[Write]) -> None:
    assert concise_dcf.decode(concise_dcf.encode(writes)) == writes
