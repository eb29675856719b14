"""Machines of ours as FMUs: they run in FMPy, and step as the kernels do."""

from __future__ import annotations

from math import pi, sin
from pathlib import Path

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.plant.fmu.mass import needs_compiler
from tests.plant.models import model
from tests.tiers import slow

from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.fmu.description import read_fmu
from hilbench.plant.fmu.export import archive, servo_axis, web_line
from hilbench.plant.fmu.follower import FmuFollower
from hilbench.plant.fmu.model import FmuModel
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import ServoAxis
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower

pytestmark = needs_compiler
CYCLE_S = 0.002
MODEL = model()
AXIS = ServoAxisParameters.model_validate(
    {
        "kind": "servo_axis",
        "shaft": {
            "inertia_kg_m2": 0.047,
            "coulomb_friction_Nm": 0.2,
            "viscous_friction_Nm_s_per_rad": 0.004,
            "unbalance_Nm": 0.3,
        },
        "drives": {
            "velocity_kp_Nm_s_per_rad": 1.5,
            "velocity_ki_Nm_per_rad": 30.0,
            "torque_limit_Nm": 9.0,
            "current_loop_time_constant_s": 0.001,
        },
        "effects": [{"effect": "torque_ripple", "axis": 1, "parameters": {"amplitude_Nm": 0.1, "order": 6}}],
    }
)


def opened(path: Path, inputs: dict[str, str], outputs: dict[str, str]) -> FmuModel:
    found = read_fmu(path)
    block = FmuLoadConfig.model_validate({"file": path, "speeds": ["x"], "torques": ["x"]})
    model = FmuModel(
        block,
        [found.find(name, "input", unit) for name, unit in inputs.items()],
        [found.find(name, "output", unit) for name, unit in outputs.items()],
        CYCLE_S,
        print,
    )
    model.start()
    return model


@pytest.mark.parametrize("fmi", [2, *slow(3)])
@pytest.mark.parametrize("drives", [True, *slow(False)])
def test_an_exported_servo_axis_steps_as_the_kernel_does(tmp_path: Path, fmi: archive.Fmi, drives: bool) -> None:
    path = tmp_path / "axis.fmu"
    exported = servo_axis.exported_axis(AXIS, drives=drives)
    archive.write_fmu(exported, fmi, path)
    port = MotorPort(mode=MotorMode.VELOCITY if drives else MotorMode.TORQUE)
    free = AXIS.drives.model_copy(update={"torque_limit_Nm": 1e9, "current_loop_time_constant_s": 0.0})  # type: ignore[union-attr]
    ours = ServoAxis(AXIS if drives else AXIS.model_copy(update={"drives": free}), [port])
    asked = ("v1_cmd_rad_s", "rad/s") if drives else ("tau1_cmd_Nm", "N·m")
    names = {quantity.name: quantity.unit for quantity in ours.describe().outputs}
    theirs = opened(path, dict([asked]), names)
    for cycle in range(600):
        port.setpoint = (30.0 if drives else 0.9) * sin(2 * pi * cycle * CYCLE_S / 0.7)
        ours.step(CYCLE_S)
        found = theirs.advance([port.setpoint], CYCLE_S)
        np.testing.assert_allclose(found, list(ours.outputs().values()), rtol=1e-12, atol=1e-12)
    assert abs(ours.outputs()["v1_rad_s"]) > 1.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_web_pulls_as_the_load_model_does(tmp_path: Path, fmi: archive.Fmi) -> None:
    path = tmp_path / "web.fmu"
    archive.write_fmu(web_line.exported_load(MODEL), fmi, path)
    ours = LineFollower(MODEL)
    names = ("F1_N", "strain1", "E1_Pa")
    config = FmuLoadConfig.model_validate(
        {
            "file": path,
            "speeds": ["v1_m_s", "v2_m_s"],
            "torques": ["tau_load1_Nm", "tau_load2_Nm"],
            "outputs": {name: name for name in names},
            "parameters": {"youngs_modulus_Pa": "youngs_modulus_Pa"},
        }
    )
    theirs = FmuFollower(config, "web_line", "m", 2, CYCLE_S)
    x = np.array([1.0, 1.0])
    ours.reset(x)
    theirs.reset(x.tolist())
    for cycle in range(500):
        x += [3.0 * CYCLE_S, (3.0 + 0.002 * sin(cycle / 20.0)) * CYCLE_S]
        if cycle == 250:
            ours.set_parameter("youngs_modulus_Pa", 10.5e9)
            theirs.set_parameter("youngs_modulus_Pa", 10.5e9)
        ours.follow(x, CYCLE_S)
        theirs.follow(x.tolist(), CYCLE_S)
        found, expected = theirs.outputs(), ours.outputs()
        np.testing.assert_allclose([found[name] for name in names], [expected[name] for name in names], rtol=1e-12)
        speeds = ours.v_m_s.tolist()
        expected_Nm = ours.load_torques_Nm([1, 2], speeds, 0.0041)
        np.testing.assert_allclose(theirs.load_torques_Nm([1, 2], speeds, 0.0041), expected_Nm, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_an_exported_line_with_its_drives_steps_as_the_kernel_does(tmp_path: Path) -> None:
    path = tmp_path / "line.fmu"
    archive.write_fmu(web_line.exported_line(MODEL, drives=True), 3, path)
    ports = [MotorPort(mode=MotorMode.VELOCITY) for _ in range(2)]
    ours = Line(MODEL, ports)
    names = {quantity.name: quantity.unit for quantity in ours.describe().outputs}
    theirs = opened(path, {"v1_cmd_m_s": "m/s", "v2_cmd_m_s": "m/s"}, names)
    for cycle in range(600):
        speeds = [2.0 * min(cycle / 300, 1.0), 2.001 * min(cycle / 300, 1.0)]
        for axis, (port, speed) in enumerate(zip(ports, speeds, strict=True), 1):
            port.setpoint = speed * MODEL.motor_rad_per_m(axis)
        ours.step(CYCLE_S)
        found = theirs.advance(speeds, CYCLE_S)
        np.testing.assert_allclose(found, list(ours.outputs().values()), rtol=1e-12, atol=1e-12)
    assert ours.outputs()["F1_N"] > 50.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_machine_is_valid_and_runs_in_fmpy(tmp_path: Path, fmi: archive.Fmi) -> None:
    import fmpy
    from fmpy.validation import validate_fmu

    path = tmp_path / "axis.fmu"
    shaft = AXIS.shaft.model_copy(update={"unbalance_Nm": 0.0})
    plain = AXIS.model_copy(update={"shaft": shaft, "effects": ()})
    archive.write_fmu(servo_axis.exported_axis(plain, drives=True), fmi, path)
    assert not validate_fmu(str(path))
    given = np.array([(0.0, 0.0), (0.1, 20.0), (1.0, 20.0)], dtype=[("time", float), ("v1_cmd_rad_s", float)])
    result = fmpy.simulate_fmu(str(path), stop_time=1.0, output_interval=0.01, input=given, output=["v1_rad_s"])
    assert result["v1_rad_s"][-1] == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_state_of_an_exported_machine_is_taken_and_given_back_also_as_bytes(
    tmp_path: Path, fmi: archive.Fmi
) -> None:
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    path = tmp_path / "axis.fmu"
    exported = servo_axis.exported_axis(AXIS, drives=True)
    archive.write_fmu(exported, fmi, path)
    found = read_fmu(path)
    folder = str(fmpy.extract(str(path), str(tmp_path / "unpacked")))
    slave = (FMU2Slave if fmi == 2 else FMU3Slave)(
        guid=found.token, unzipDirectory=folder, modelIdentifier=found.identifier
    )
    slave.instantiate()
    get, put = (slave.getReal, slave.setReal) if fmi == 2 else (slave.getFloat64, slave.setFloat64)
    if fmi == 2:
        slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    command, speed = (found.variables[name].reference for name in ("v1_cmd_rad_s", "v1_rad_s"))
    put([command], [12.0])
    slave.doStep(0.0, 0.01)
    kept = slave.getFMUState()
    as_bytes = slave.serializeFMUstate(kept) if fmi == 2 else slave.serializeFMUState(kept)
    slave.doStep(0.01, 0.01)
    first = get([speed])
    slave.setFMUState(kept)
    slave.doStep(0.01, 0.01)
    assert get([speed]) == first
    again = slave.deSerializeFMUstate(as_bytes) if fmi == 2 else slave.deserializeFMUState(as_bytes)
    slave.setFMUState(again)
    slave.doStep(0.01, 0.01)
    assert get([speed]) == first
    slave.terminate()


def test_a_step_that_the_drives_cannot_take_is_told(tmp_path: Path) -> None:
    path = tmp_path / "axis.fmu"
    archive.write_fmu(servo_axis.exported_axis(AXIS, drives=True), 2, path)
    said: list[str] = []
    found = read_fmu(path)
    block = FmuLoadConfig.model_validate({"file": path, "speeds": ["x"], "torques": ["x"]})
    model = FmuModel(block, [found.find("v1_cmd_rad_s", "input", "rad/s")], [], CYCLE_S, said.append)
    model.start()
    with pytest.raises(Exception, match="DoStep"):
        model.advance([1.0], 0.0015)
    assert any("no multiple of the drives' sample time (0.001 s)" in text for text in said)


def test_the_same_machine_makes_the_same_file(tmp_path: Path) -> None:
    exported = servo_axis.exported_axis(AXIS, drives=True)
    for name in ("a.fmu", "b.fmu"):
        archive.write_fmu(exported, 3, tmp_path / name)
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()


def test_without_a_compiler_the_export_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive.shutil, "which", lambda name: None)
    given = ["fmu", "export", "--machine", "bench_configs/servo_axis.yaml", "--output", str(tmp_path / "a.fmu")]
    ended = hilbench(*given)
    assert ended.returncode == 2
    assert "no C compiler, expected one of cc, gcc, clang on the PATH" in ended.stderr
    assert not (tmp_path / "a.fmu").exists()
