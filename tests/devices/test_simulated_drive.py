"""A simulated drive on a python-can bus, driven by canopen's own CiA-402 client."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError, SdoClient
from tests.cia402.every_mode import INCREMENTS, eds_file, eds_text
from tests.cia402.stand_in import EDS as OWN
from tests.cia402.stand_in import answers, enable, eventually, on_a_virtual_bus

from canopen import Network
from hilbench import SimulatedDrive
from hilbench.apps.devices.behaviour import Behaviour
from hilbench.can.python_can import can
from hilbench.canopen.eds import load_eds
from hilbench.cia402.state_machine import State
from hilbench.errors import UnusableInputError

OTHERS = [
    path
    for path in sorted(Path(__file__).parents[3].glob("shared/eds/*"))
    if "[6040]" in path.read_text(errors="replace")
]


@contextmanager
def driven(eds: Path, behaviour: Behaviour | Path | None = None) -> Iterator[tuple[SimulatedDrive, BaseNode402]]:
    """The drive as node 5, and the client that drives it."""
    node = BaseNode402(5, load_eds(eds, 5))
    with on_a_virtual_bus(eds, node, behaviour) as (drive, _):
        yield drive, node


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    return eds_file(tmp_path)


def test_canopens_client_positions_it(eds: Path) -> None:
    with driven(eds) as (drive, node):
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine(read_pdos=False)
        node.op_mode = "PROFILED POSITION"
        for word in (0x06, 0x07, 0x0F):
            node.sdo[0x6040].raw = word
        node.sdo[0x607A].raw = 2 * INCREMENTS
        node.sdo[0x6040].raw = 0x1F
        node.sdo[0x6040].raw = 0x0F
        eventually(lambda: bool(node.sdo[0x6041].raw & 0x400))
        eventually(lambda: abs(node.sdo[0x6064].raw - 2 * INCREMENTS) <= 20)
        assert drive.position_turns == pytest.approx(2.0, abs=0.01)
        assert drive.state is State.OPERATION_ENABLED


def test_a_master_with_sync_and_pdos_gets_its_positions_back(eds: Path) -> None:
    with driven(eds) as (drive, node):
        enable(node, 8)
        node.tpdo.read()
        node.rpdo.read()
        seen: list[int] = []
        node.tpdo[1].add_callback(lambda message: seen.append(message["entry 6064"].raw))
        node.nmt.state = "OPERATIONAL"
        node.rpdo[1]["entry 6040"].raw = 0x0F
        node.rpdo[1]["entry 607A"].raw = 300
        node.rpdo[1].start(0.01)
        node.network.sync.start(0.01)
        try:
            eventually(lambda: bool(seen) and abs(seen[-1] - 300) <= 2)
        finally:
            node.network.sync.stop()
            node.rpdo[1].stop()
        assert drive.position_turns == pytest.approx(0.03, abs=0.001)


def test_a_fault_on_command_is_told_and_reset(eds: Path) -> None:
    with driven(eds) as (drive, node):
        enable(node, 3)
        drive.fault(0x8611)
        eventually(lambda: node.sdo[0x6041].raw & 0x4F == 0x08)
        eventually(lambda: any(entry.code == 0x8611 for entry in node.emcy.active))
        node.sdo[0x6040].raw = 0x00
        node.sdo[0x6040].raw = 0x80
        assert drive.state is State.SWITCH_ON_DISABLED
        eventually(lambda: not node.emcy.active)


def test_it_falls_silent_and_its_heartbeat_stays_away(eds: Path) -> None:
    with driven(eds) as (drive, node):
        node.sdo[0x1017].raw = 20
        node.nmt.wait_for_heartbeat(2.0)
        drive.no_heartbeat(0.5)
        time.sleep(0.1)
        assert node.sdo[0x1000].raw, "it answers"
        beats: list[float] = []
        node.nmt.add_heartbeat_callback(lambda _state: beats.append(time.monotonic()))
        eventually(lambda: len(beats) > 3)
        drive.silence(0.6)
        node.sdo.RESPONSE_TIMEOUT = 0.2
        with pytest.raises(Exception, match="No SDO response"):
            _ = node.sdo[0x1000].raw
        eventually(lambda: answers(node))


def test_the_encoder_jumps_and_it_resets_itself(eds: Path) -> None:
    with driven(eds) as (drive, node):
        before = node.sdo[0x6064].raw
        drive.encoder_jump(0.5)
        eventually(lambda: node.sdo[0x6064].raw - before == INCREMENTS // 2)
        node.sdo[0x6081].raw = 77
        booted: list[int] = []
        node.network.subscribe(0x705, lambda _id, data, _time: booted.append(data[0]))
        drive.reset()
        eventually(lambda: 0 in booted)
        assert node.sdo[0x6081].raw == 600


def test_what_the_behaviour_file_asks_for_goes_wrong(eds: Path, tmp_path: Path) -> None:
    path = tmp_path / "behaviour.yaml"
    path.write_text(
        "state_change_s: 0.2\n"
        "refuse:\n  - {index: 0x6083, abort_code: 0x06010002}\n"
        "events:\n  - {at_s: 0.0, emergency: {code: 0x5000, register_bits: 8, data: [1, 2]}}\n"
    )
    with driven(eds, path) as (drive, node):
        with pytest.raises(SdoAbortedError) as refused:
            node.sdo[0x6083].raw = 1
        assert refused.value.code == 0x06010002
        node.sdo[0x6040].raw = 0x06
        assert drive.state is State.SWITCH_ON_DISABLED
        eventually(lambda: drive.state is State.READY_TO_SWITCH_ON)
        assert node.sdo[0x1001].raw & 8


def test_an_error_of_the_behaviour_file_names_line_key_and_what_was_expected(eds: Path, tmp_path: Path) -> None:
    path = tmp_path / "behaviour.yaml"
    path.write_text("events:\n  - {at_s: 1.0}\n")
    with pytest.raises(UnusableInputError, match=r"behaviour.yaml:2: .*expected one a row"):
        SimulatedDrive(eds, 5, "virtual:x", behaviour=path)


def test_a_file_of_no_drive_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"every_mode.eds: object 6040h is missing, expected"):
        SimulatedDrive(eds_file(tmp_path, 0x6040, 0x1400, 0x1600), 5, "virtual:x")


def test_a_drive_whose_file_lacks_the_mapping_of_a_pdo_is_driven_by_sdo_and_its_other_pdos(tmp_path: Path) -> None:
    channel = "devices-without-a-mapping"
    with (
        can.Bus(interface="virtual", channel=channel) as ours,
        SimulatedDrive(eds_file(tmp_path, 0x1600), 5, can.Bus(interface="virtual", channel=channel)) as drive,
    ):
        network = Network(ours)
        network.connect()
        sdo = SdoClient(0x605, 0x585, load_eds(OWN, 5))
        sdo.network, sdo.RESPONSE_TIMEOUT = network, 2.0
        network.subscribe(0x585, sdo.on_response)
        try:
            for word, state in ((0x06, State.READY_TO_SWITCH_ON), (0x07, State.SWITCHED_ON)):
                sdo.download(0x6040, 0, word.to_bytes(2, "little"))
                eventually(lambda state=state: drive.state is state)
            with pytest.raises(SdoAbortedError, match="0x06020000"):
                sdo.upload(0x1600, 0)
        finally:
            network.disconnect()


def test_drives_without_conditional_objects_or_with_odd_default_maps_are_mapped_and_enabled(tmp_path: Path) -> None:
    text = eds_text(0x1005, 0x1017)
    text = _default(text, "1600sub2", "0")  # an entry that counts and is empty
    text = _default(text, "1800sub1", "$NODEID+0x80000180")
    text = _default(text, "1A00sub2", "0x20770010")  # of no object, in a PDO that is not valid
    file = tmp_path / "drive.eds"
    file.write_text(text)
    with driven(file) as (drive, node):
        cob_id = node.sdo[0x1800][1].raw
        with pytest.raises(SdoAbortedError, match="0x06020000"):
            node.sdo[0x1800][1].raw = cob_id & ~0x80000000
        node.sdo[0x1A00][0].raw = 0
        node.sdo[0x1A00][1].raw = 0x60410010
        node.sdo[0x1A00][0].raw = 1
        node.sdo[0x1800][1].raw = cob_id & ~0x80000000
        enable(node, 3)
        assert drive.state is State.OPERATION_ENABLED


def _default(text: str, section: str, value: str) -> str:
    return re.sub(rf"(\[{section}\][^\[]*?DefaultValue=)[^\n]*", rf"\g<1>{value}", text)


def test_identity_is_the_headers_where_its_objects_have_no_value(tmp_path: Path) -> None:
    text = OWN.read_text()
    for key, value in {"VendorNumber": "0xFB", "ProductNumber": "0x6150", "RevisionNumber": "0x170"}.items():
        text = re.sub(rf"(?m)^{key}=.*$", f"{key}={value}", text)
    for sub in (1, 3):  # the product code keeps its own
        text = re.sub(rf"(\[1018sub{sub}\][^\[]*?)DefaultValue=[^\n]*\n", r"\1", text)
    file = tmp_path / "drive.eds"
    file.write_text(text)
    with driven(file) as (_, node):
        assert [node.sdo[0x1018][sub].raw for sub in (1, 2, 3)] == [0xFB, 0x402, 0x170]


def test_several_drives_on_one_bus(eds: Path) -> None:
    def bus() -> can.BusABC:
        return can.Bus(interface="virtual", channel="devices-several")

    with SimulatedDrive(eds, 5, bus()) as one, SimulatedDrive(eds, 6, bus()) as other, bus() as ours:
        network = Network(ours)
        network.connect()
        nodes = [BaseNode402(number, load_eds(eds, number)) for number in (5, 6)]
        for node in nodes:
            network.add_node(node)
            eventually(lambda node=node: answers(node))
        enable(nodes[1], 3)
        assert (one.state, other.state) == (State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED)
        network.disconnect()


@pytest.mark.parametrize("path", OTHERS, ids=lambda path: path.stem)
def test_drives_of_other_makers_are_enabled_and_move(path: Path) -> None:
    with driven(path) as (drive, node):
        mode = drive.modes[0]
        enable(node, int(mode))
        assert mode == 1, "all of them have profile position"
        turn = round(2 * 3.14159265 / drive.position_unit_rad)
        node.sdo[0x607A].raw = turn
        for word in (0x1F, 0x0F):
            node.sdo[0x6040].raw = word
        eventually(lambda: abs(node.sdo[0x6064].raw - turn) <= max(3, turn // 500))
        assert drive.position_turns == pytest.approx(1.0, abs=0.01)
