"""The EDS files: in step with their tables, complete for the device runtime."""

import configparser
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import dcf
import pytest
import yaml
from tests.cia402.stand_in import StandingClock

from hilbench.can.frame import Frame
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.cia402.configuration import default_reader
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.effect_objects import bind_effect_objects, effect_object
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effects_of

ROOT = Path(__file__).parents[2]
FILES = (
    "hilbench_servo.eds",
    "hilbench_virtual_io.eds",
    "hilbench_virtual_io_servo_axis.eds",
    "hilbench_virtual_io_long.eds",
    "hilbench_bench.eds",
    "hilbench_servo_dual.eds",
)


@pytest.fixture(scope="module")
def make_eds() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_eds", ROOT / "tools" / "make_eds.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_eds"] = module  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def test_files_are_what_the_tables_say(make_eds: ModuleType) -> None:
    made = make_eds.eds_files()
    assert sorted(made) == sorted(FILES)
    for name, text in made.items():
        found = (ROOT / "eds" / name).read_text(encoding="ascii")
        assert found == text, f"eds/{name} is out of date: run tools/make_eds.py"


@pytest.mark.parametrize("node_id", [1, 17])
def test_servo_starts_with_the_pdos_of_the_predefined_connection_set(node_id: int) -> None:
    device = Device(load_eds(ROOT / "eds" / FILES[0], node_id), node_id, StandingClock())
    cob_ids = {index: device.cell(index, 1).value for index in (0x1400, 0x1401, 0x1800, 0x1801, 0x1802)}
    assert cob_ids[0x1400] == 0x200 + node_id
    assert cob_ids[0x1401] == 0x80000300 + node_id
    assert (cob_ids[0x1800], cob_ids[0x1801]) == (0x40000180 + node_id, 0x40000280 + node_id)
    assert cob_ids[0x1802] == 0xC0000380 + node_id
    mapped = [device.cell(0x1A00, sub).value for sub in range(1, 4)]
    assert mapped == [0x60410010, 0x60770010, 0x60640020]


@pytest.mark.parametrize("name", FILES)
def test_every_default_of_a_real32_is_one_number_to_all_who_read_the_file(name: str) -> None:
    """Lely's tools take the digits for the bits of an IEEE 754 number, canopen, gocanopen and others for the number."""
    sections = configparser.ConfigParser(interpolation=None)
    sections.read(ROOT / "eds" / name)
    reals = [section for section in sections.values() if int(section.get("DataType", "0"), 0) == 0x0008]
    assert reals
    for section in reals:
        text = section.get("DefaultValue", "0")
        assert float(text) == dcf.REAL32.parse_value(text), section.name


def test_lelys_dcfgen_configures_a_master_for_the_drives_from_these_files(tmp_path: Path) -> None:
    """As `dcfgen` of the virtual environment does it: its output is what Lely's master writes to the nodes."""
    nodes = {
        "axis1": {"dcf": str(ROOT / "eds" / FILES[0]), "node_id": 1, "heartbeat_producer": 100},
        "io": {"dcf": str(ROOT / "eds" / FILES[1]), "node_id": 32},
    }
    (tmp_path / "bus.yml").write_text(yaml.safe_dump({"master": {"node_id": 127, "sync_period": 10_000}, **nodes}))
    command = [str(Path(sys.executable).with_name("dcfgen")), "-r", "-v", "bus.yml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "axis1: writing 2 bytes to 0x1017/0: 64 00" in done.stdout
    assert (tmp_path / "master.dcf").read_text().count("[") > 10


def test_an_effect_starts_with_its_neutral_values_and_has_them_again_after_a_reset() -> None:
    device = Device(load_eds(ROOT / "eds" / FILES[0], 1), 1, StandingClock())
    bind_effect_objects(device, lambda effect, parameters: None)
    device.boot()
    neutral = {
        effect_object(effect.id, parameter.name): parameter.neutral
        for effect in effects_of(MachineKind.WEB_LINE)
        if effect.enters(EffectPlace.HARDWARE)
        for parameter in effect.parameters
    }
    assert any(neutral.values())
    assert {place: device.cell(*place).value for place in neutral} == neutral
    for place in neutral:
        device.cell(*place).write(7.0)
    device.handle(Frame(0, b"\x81\x01"))
    assert {place: device.cell(*place).value for place in neutral} == neutral


def test_units_of_the_demonstrator() -> None:
    units = DriveUnits.from_objects(default_reader(load_eds(ROOT / "eds" / FILES[0], 1)))
    assert units.torque_Nm == pytest.approx(0.005)
    assert units.position_rad == pytest.approx(5.992e-6, rel=1e-3)
    assert units.velocity_rad_s == pytest.approx(1.0472e-5, rel=1e-4)


@pytest.mark.parametrize("kind", MachineKind)
def test_every_effect_of_the_rig_has_its_object(kind: MachineKind) -> None:
    od = load_eds(ROOT / "eds" / FILES[0], 1)
    for effect in effects_of(kind):
        assert (effect.object_index in od) == effect.enters(EffectPlace.HARDWARE)
        if effect.object_index in od:
            record = od[effect.object_index]
            assert record.name.split(" ")[0] == effect.id
            names = [record[sub].name.split(" ")[0] for sub in range(1, len(effect.parameters) + 1)]
            assert names == [parameter.name for parameter in effect.parameters]


#: What is in the field: masters that were written for these addresses must go on to find what they did there.
ADDRESSES = {
    "coulomb_friction": 0x2200,
    "viscous_friction": 0x2201,
    "stribeck_friction": 0x2202,
    "friction_asymmetry": 0x2204,
    "torque_ripple": 0x2205,
    "torque_offset": 0x2206,
    "torque_scale": 0x2207,
    "torque_delay": 0x2208,
    "inertia_mismatch": 0x2209,
    "backlash": 0x220A,
    "unbalance": 0x2214,
    "load_dependent_friction": 0x2215,
    "quadratic_drag": 0x2216,
    "torque_ripple_load": 0x2217,
    "feed_forward": 0x2218,
    "encoder_error": 0x2219,
    "drive_gain": 0x221A,
    "drive_lag": 0x221B,
}


def test_a_new_row_of_the_vocabulary_renumbers_no_object() -> None:
    hardware = [effect for effect in effects_of(MachineKind.WEB_LINE) if effect.enters(EffectPlace.HARDWARE)]
    assert {effect.id: effect.object_index for effect in hardware}.items() >= ADDRESSES.items()
    rows = [effect for kind in MachineKind for effect in effects_of(kind)]
    index = {(effect.id, effect.parameters): effect.object_index for effect in rows}
    assert len(set(index.values())) == len(index)


def test_virtual_io_maps_what_the_design_says() -> None:
    device = Device(load_eds(ROOT / "eds" / FILES[1], 32), 32, StandingClock())
    assert [device.cell(0x1A00, sub).value for sub in (1, 2)] == [0x64030120, 0x64030220]
    assert [device.cell(0x1A01, sub).value for sub in (1, 2)] == [0x64030320, 0x64030520]
    assert [device.cell(0x1600, sub).value for sub in (1, 2)] == [0x64130120, 0x64130220]
    assert (device.cell(0x1800, 2).value, device.cell(0x1801, 2).value) == (1, 10)
