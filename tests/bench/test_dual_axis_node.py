"""A bench whose two rollers are driven by one node with two axes: what is on the wire, the same run, wrong configs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.bench.whole_runs import config, run, run_folders, run_here
from tests.cia402.stand_in import StandingClock

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.check import check_bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.can.frame import Frame
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.errors import BenchFaultError, UnusableInputError, UnusableValueError
from hilbench.exchange.effect_objects import effect_place
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.pdo_set import pdo_set_dbc
from hilbench.plant.motor_port import MotorPort
from hilbench.results.recording import read_recording
from hilbench.runs.config import LoadedConfig, load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
SERVO, DUAL = ROOT / "eds" / "hilbench_servo.eds", ROOT / "eds" / "hilbench_servo_dual.eds"
SHIPPED = ROOT / "bench_configs" / "web_section_dual_axis.yaml"


def dual(folder: Path, **of_axis2: Any) -> Path:
    """The short bench of the tests with both rollers on node 1; keys of the second drive by name."""
    path = config(folder)
    data = yaml.safe_load(path.read_text())
    data["drives"]["axis1"] |= {"eds": str(DUAL)}
    data["drives"]["axis2"] |= {"eds": str(DUAL), "node_id": 1, "axis": 2, **of_axis2}
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def checked(path: Path) -> None:
    found = loaded(path)
    check_bench(found.config, found.document)


def loaded(path: Path) -> LoadedConfig:
    return load_with_overrides(path)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a bench with both axes in one node."""
    path = dual(tmp_path_factory.mktemp("dual"))
    assert run_here(path)[0] == 0
    return run_folders(path)[0]


def test_the_second_axis_is_configured_and_sent_to_by_rpdo65_and_tpdo65_and_66(ran: Path) -> None:
    """As CiA 301 has it: SDO requests to node 1, and who sends what afterwards."""
    trace = (ran / "trace.log").read_text()
    requests = re.findall(r" 601#([0-9A-F]{16})", trace)
    for expected in (
        "2340140101030080",  # 1440h:1, the COB-ID 301h, not valid yet
        "2340160110004068",  # 1640h:1, 6840h of 16 bits
        "234016022000FF68",  # 1640h:2, 68FFh of 32 bits
        "2340140101030000",  # valid
        "23401A0110004168",  # 1A40h: statusword,
        "23401A0210007768",  # torque,
        "23401A0320006468",  # position of the second axis
        "2340180181030040",  # 1840h:1, the COB-ID 381h
        "23411A0120006C68",  # 1A41h: its velocity
        "2341180181040040",  # 1841h:1, the COB-ID 481h
        "2F60680009000000",  # 6860h, cyclic synchronous velocity
    ):
        assert expected in requests, expected
    cyclic = {cob_id: len(re.findall(rf" {cob_id}#", trace)) for cob_id in ("201", "301", "181", "281", "381", "481")}
    assert len(set(cyclic.values())) == 1, cyclic
    assert not re.findall(r" (?:202|182|282|702)#", trace)
    assert len(re.findall(r" 701#05", trace)) > 10  # one heartbeat of the node


def test_a_node_without_pdos_from_65_on_has_the_second_axis_in_its_first_ones(tmp_path: Path) -> None:
    """RPDO2, TPDO3 and TPDO4, whose identifiers are those that the axis has anyway."""
    eds = tmp_path / "few_pdos.eds"
    eds.write_text(re.sub(r"(\[|=0x)1([468A]4[0-3])", r"\g<1>3\2", DUAL.read_text()))
    path = dual(tmp_path, eds=str(eds))
    data = yaml.safe_load(path.read_text())
    data["drives"]["axis1"]["eds"] = str(eds)
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    code, _, err = run_here(path)
    assert code == 0, err
    trace = (run_folders(path)[0] / "trace.log").read_text()
    requests = re.findall(r" 601#([0-9A-F]{16})", trace)
    assert {"2301160110004068", "23021A0110004168", "23031A0120006C68", "2301140101030000"} <= set(requests)
    assert not [request for request in requests if request[2:6] in ("4014", "4018", "4118")]
    assert trace.count(" 381#") == trace.count(" 181#") > 100
    nodes = json.loads((run_folders(path)[0] / "nodes.json").read_text())["nodes"]
    assert nodes["axis2"]["found"].keys() >= {"1401h:1", "1601h", "1802h:1", "1A02h", "1803h:1"}
    assert nodes["axis2"]["written"]["1601h:1"] == "10004068"
    assert not {"1401h:1", "1601h:1"} & nodes["axis1"]["written"].keys()


def test_what_is_kept_of_the_stand_is_of_each_axis(ran: Path) -> None:
    nodes = json.loads((ran / "nodes.json").read_text())["nodes"]
    for name, own, others in (("axis1", "60A9h", "68A9h"), ("axis2", "68A9h", "60A9h")):
        assert own in nodes[name]["found"]
        assert others not in nodes[name]["found"]
    assert nodes["axis2"]["found"]["1640h:1"] == "10004068"
    assert "6860h" in nodes["axis2"]["written"].keys() - nodes["axis1"]["written"].keys()


def test_a_run_on_one_node_with_two_axes_is_that_on_two_nodes(ran: Path, tmp_path: Path) -> None:
    """Sample by sample, and with processes as well; the wire carries other identifiers, so other stuff bits."""
    recordings = []
    for name, made, how in (("two", config, run_here), ("processes", dual, run)):
        folder = tmp_path / name
        folder.mkdir()
        path = made(folder)
        code, _, err = how(path)
        assert code == 0, err
        recordings.append(read_recording(run_folders(path)[0] / "recording.mf4"))
    (two, processes), one = recordings, read_recording(ran / "recording.mf4")
    assert two.channels.keys() == one.channels.keys() == processes.channels.keys()
    for name, values in one.channels.items():
        assert np.array_equal(values, processes.channels[name], equal_nan=True), name
        assert name == "bus_bits" or np.array_equal(values, two.channels[name], equal_nan=True), name


def test_an_effect_of_the_second_axis_is_its_own_object_and_acts_on_it_alone(tmp_path: Path) -> None:
    """The first roller, which carries no web load, by the second axis of the node, and the other way round."""
    path = dual(tmp_path, axis=1)
    data = yaml.safe_load(path.read_text())
    data["drives"]["axis1"]["axis"] = 2
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    friction = "hardware.effects.viscous_friction.axis1.coefficient_N_s_per_m"
    assert effect_place(loaded(path).config, friction) == (1, 0x2A01, 1)
    with Bench(path, participants=Participants.IN_PROCESS) as running:
        running.ramp("line_speed_m_s", 1.0, 0.4)
        before = torques_Nm(running)
        running.set(friction, 20.0)
        change_Nm = torques_Nm(running) - before
    assert change_Nm == pytest.approx([20.0 / 25.0, 0.0], abs=0.1)  # N at 1 m/s, radius 0.2 m, a gear of 5


def torques_Nm(bench: Bench) -> Any:
    """Of both rollers, once they have settled."""
    bench.run(0.5)
    return np.mean([(sample.tau1_Nm, sample.tau2_Nm) for sample in (bench.cycle() for _ in range(250))], axis=0)


def test_a_fault_of_the_second_axis_is_told_with_its_place_and_its_object(tmp_path: Path) -> None:
    path = dual(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["hardware"] = {"effects": []}
    data["drives"]["axis2"]["parameters"] = {"6880h": 30}  # faster than that is overspeed
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with (
        Bench(path, participants=Participants.IN_PROCESS) as running,
        pytest.raises(BenchFaultError, match=r"axis2 \(node 1, axis 2\): .*error code \(683Fh\) 84FFh"),
    ):
        running.ramp("line_speed_m_s", 3.0, 0.2)


def test_an_emcy_of_a_node_with_two_axes_says_of_which_of_them(tmp_path: Path) -> None:
    """Byte 7, as the simulated drive fills it; without it, and of a real drive, it is the node's."""
    device = Device(load_eds(DUAL, 1), 1, StandingClock())
    drives = [SimulatedDrive(device, MotorPort(), axis=axis) for axis in (1, 2)]
    device.handle(Frame(0, b"\x01\x00"))
    drives[1].fault(0x7305)
    (frame,) = [frame for frame in device.outbox if frame.can_id == 0x81]
    for real, data, speaker in (
        (False, frame.data, "axis2"),
        (False, frame.data[:7] + b"\0", "axis1 and axis2"),
        (True, frame.data, "axis1 and axis2"),
    ):
        path = dual(tmp_path, simulated=not real)
        given = yaml.safe_load(path.read_text())
        given["drives"]["axis1"]["simulated"] = not real
        path.write_text(yaml.safe_dump(given, sort_keys=False))
        nodes = Nodes(loaded(path).config)
        nodes.decode([Frame(0x81, data)])
        (emergency,) = nodes.emergencies
        assert (emergency.node, emergency.code) == (speaker, 0x7305)


@pytest.mark.parametrize(
    ("of_axis2", "problem"),
    [
        (
            {"axis": 1},
            r"'drives.axis2.node_id' is 1, expected: node ids that differ, .*axis1 and axis2 both have 1, axis 1",
        ),
        ({"axis": 3}, r"'drives.axis2.axis' is 3, expected: 2 at most"),
        (
            {"node_id": 3},
            r"'load_motors.load.eds' is '.*servo.eds', expected: .*the EDS file of axis2, which is on node 3",
        ),
        (
            {"eds": str(SERVO)},
            r"'drives.axis2.eds' is '.*servo.eds', expected: .*servo_dual.eds, the EDS file of axis1",
        ),
        ({"simulated": False}, r"'drives.axis2.simulated' is False, expected: true, as axis1 on the same node 1 is"),
        ({"node_id": 2, "eds": str(SERVO)}, r"axis is 2, expected one that hilbench_servo.eds has: 1 \(6840h is not"),
        (
            {"virtual": {"node_id": 1, "eds": str(SERVO)}},
            r"'drives.axis2.virtual.node_id' is 1, expected: .*axis1 and virtual_axis2 both have 1",
        ),
    ],
)
def test_what_two_axes_cannot_be_is_said_with_its_line(tmp_path: Path, of_axis2: dict[str, Any], problem: str) -> None:
    path = dual(tmp_path, **of_axis2)
    with pytest.raises(UnusableInputError) as raised:
        checked(path)
    found = re.search(r"bench.yaml:(\d+): (.*)", str(raised.value))
    assert found is not None
    assert re.search(problem, found[2]), found[2]
    key = re.search(r"(\w+)'? is ", found[2])
    assert key is not None
    assert key[1] in path.read_text().splitlines()[int(found[1]) - 1]


def test_objects_of_the_config_are_those_of_the_eds_file(tmp_path: Path) -> None:
    path = dual(tmp_path, parameters={"6880h": 1500})
    nodes = Nodes(loaded(path).config)
    assert (0x6880, 0) in nodes.axes[1].settings.parameters
    checked(path)
    other = dual(tmp_path, parameters={"6999h": 1})
    with pytest.raises(UnusableInputError, match=r"the EDS lacks 6999h:0"):
        checked(other)


def test_a_real_second_axis_gets_no_effect(tmp_path: Path) -> None:
    path = dual(tmp_path)
    data = yaml.safe_load(path.read_text())
    for drive in data["drives"].values():
        drive["simulated"] = False
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with pytest.raises(UnusableValueError, match="real drive"):
        effect_place(loaded(path).config, "hardware.effects.viscous_friction.axis2.coefficient_N_s_per_m")


def test_the_dbc_file_names_the_pdos_by_their_numbers() -> None:
    messages = dict(re.findall(r"^BO_ (\d+) (\w+):", pdo_set_dbc(loaded(SHIPPED).config), re.MULTILINE))
    names = {int(can_id): name for can_id, name in messages.items()}
    assert {can_id: names[can_id] for can_id in (0x201, 0x181, 0x281, 0x301, 0x381, 0x481)} == {
        0x201: "axis1_RPDO1",
        0x181: "axis1_TPDO1",
        0x281: "axis1_TPDO2",
        0x301: "axis2_RPDO65",
        0x381: "axis2_TPDO65",
        0x481: "axis2_TPDO66",
    }
