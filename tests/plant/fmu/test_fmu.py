"""An FMU in a process of its own: what it says of itself, its steps, what goes wrong."""

from __future__ import annotations

import tempfile
import time
import zipfile
from pathlib import Path

import pytest
from tests.plant.fmu.mass import build_fmu, needs_compiler

from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.fmu.description import read_fmu
from hilbench.plant.fmu.follower import FmuFollower
from hilbench.plant.fmu.model import FmuModel
from hilbench.plant.interface import Follower

pytestmark = needs_compiler
CYCLE_S = 0.002


def block(path: Path, **more: object) -> FmuLoadConfig:
    given = {"file": path, "speeds": ["speed"], "torques": ["pull"], "parameters": {"spring": "stiffness"}}
    return FmuLoadConfig.model_validate(given | more)


def follower(path: Path, **more: object) -> FmuFollower:
    return FmuFollower(block(path, **more), "servo_axis", "rad", 1, CYCLE_S, ["x1_rad"])


def shaft(path: Path, said: list[str] | None = None, **more: object) -> FmuModel:
    found = read_fmu(path)
    inputs, outputs = [found.find("torque", "input", "N·m")], [found.find("angle", "output", "rad")]
    outputs.append(found.find("rate", "output", "rad/s"))
    report = print if said is None else said.append
    return FmuModel(block(path, **more), inputs, outputs, 0.001, report, mean=True)


def failing(model: FmuModel, path: Path, kind: float, at_s: float = 0.01) -> None:
    found = read_fmu(path)
    model.give(found.find("failure", "parameter", "1"), kind)
    model.give(found.find("failure_at_s", "parameter", "s"), at_s)
    model.start()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_person_reads_what_an_fmu_is_in_one_line(tmp_path: Path, fmi: int) -> None:
    said = read_fmu(build_fmu(tmp_path / "mass.fmu", fmi, any_step=False, step_s=0.003)).summary
    assert f"FMI {fmi}" in said
    assert "2 inputs, 5 outputs, 5 parameters" in said
    assert "steps of one length, asks for 3 ms" in said


def test_a_misspelt_variable_is_told_with_the_nearest_names(tmp_path: Path) -> None:
    found = read_fmu(build_fmu(tmp_path / "mass.fmu"))
    with pytest.raises(ValueError, match=r"an input of mass.fmu such as 'torque'.*'torqe' is none"):
        found.find("torqe", "input", "N·m")
    with pytest.raises(ValueError, match=r"an input of .*'angle' is of causality output"):
        found.find("angle", "input", "rad")


def test_units_are_compared_and_converted(tmp_path: Path) -> None:
    found = read_fmu(build_fmu(tmp_path / "mass.fmu"))
    travel = found.find("travel", "output", "m")
    assert travel.si(5.0) == pytest.approx(0.005, abs=1e-15)
    assert travel.own(0.005) == pytest.approx(5.0, abs=1e-12)
    with pytest.raises(ValueError, match="a variable in rad, or a unit of its kind; 'travel' is in mm"):
        found.find("travel", "output", "rad")


def test_a_file_that_is_no_fmu_is_told_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "mass.fmu"
    with pytest.raises(UnusableInputError, match="no such file, expected an FMU"):
        read_fmu(path)
    path.write_text("no zip")
    with pytest.raises(UnusableInputError, match="no FMU, expected a zip archive"):
        read_fmu(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="2.0"/>')
    with pytest.raises(UnusableInputError, match=r"expected a modelDescription.xml as FMI 2 or 3 has it"):
        read_fmu(path)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_torque_turns_the_mass_as_its_equation_says(tmp_path: Path, fmi: int) -> None:
    model = shaft(build_fmu(tmp_path / "mass.fmu", fmi))
    model.start()
    for _ in range(100):
        angle, rate = model.advance([0.5], 0.001)
    assert rate == pytest.approx(0.5 / 0.01 * 0.1, rel=1e-12)
    assert angle == pytest.approx(0.5 * 0.5 / 0.01 * 0.1**2, rel=1e-12)


@pytest.mark.parametrize("step_s", [0.003, 0.0005, 0.00075])
def test_steps_that_do_not_divide_the_cycle_are_carried(tmp_path: Path, step_s: float) -> None:
    model = shaft(build_fmu(tmp_path / "mass.fmu", any_step=False, step_s=step_s))
    model.start()
    for number in range(1, 101):
        rate = model.advance([0.5], 0.001)[1]
        assert 0.0 <= model.behind_s < step_s * (1 + 1e-6)
        assert rate == pytest.approx(50.0 * (number * 0.001 - model.behind_s), rel=1e-9, abs=1e-12)


def test_torques_within_a_long_step_count_by_their_mean(tmp_path: Path) -> None:
    model = shaft(build_fmu(tmp_path / "mass.fmu", any_step=False, step_s=0.003))
    model.start()
    for torque in (3.0, 0.0, -1.5):
        _, rate = model.advance([torque], 0.001)
    assert rate == pytest.approx(0.5 / 0.01 * 0.003, rel=1e-9)


@pytest.mark.parametrize("any_step", [True, False])
@pytest.mark.parametrize("fmi", [2, 3])
def test_load_torques_are_predicted_and_the_fmu_stays_where_it_is(tmp_path: Path, fmi: int, any_step: bool) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu", fmi, any_step=any_step))
    assert isinstance(machine, Follower)
    machine.reset([1.0])
    for cycle in range(1, 11):
        machine.follow([1.0 + 0.1 * cycle], CYCLE_S)
    before = machine.load_torques_Nm([1], [50.0], 0.0)
    later = machine.load_torques_Nm([1], [50.0], 0.003)
    assert before == pytest.approx([-2.0], rel=1e-9)
    assert later == pytest.approx([-2.0 * (1.0 + 50.0 * 0.003)], rel=1e-9)
    assert machine.load_torques_Nm([1], [50.0], 0.0) == before


def test_an_fmu_that_cannot_be_taken_back_emulates_what_is_now(tmp_path: Path) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu", rollback=False))
    machine.reset([0.0])
    machine.follow([0.1], CYCLE_S)
    assert machine.load_torques_Nm([1], [50.0], 0.003) == pytest.approx([-0.2], rel=1e-9)
    with pytest.raises(ValueError, match="expected one with canGetAndSetFMUstate"):
        machine.get_state()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_is_gone_on_from_exactly(tmp_path: Path, fmi: int) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu", fmi))
    machine.reset([0.0])
    machine.follow([0.13], CYCLE_S)
    kept = machine.get_state()
    machine.follow([0.4], CYCLE_S)
    first = machine.load_torques_Nm([1], [0.0], 0.0)
    machine.set_state(kept)
    machine.follow([0.4], CYCLE_S)
    assert machine.load_torques_Nm([1], [0.0], 0.0) == first


def test_parameters_act_at_once_and_stay_when_the_drives_are_enabled_again(tmp_path: Path) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu"))
    assert machine.parameter("spring") == 2.0
    machine.reset([0.0])
    machine.follow([0.1], CYCLE_S)
    machine.set_parameter("spring", 3.0)
    assert machine.load_torques_Nm([1], [0.0], 0.0) == pytest.approx([-0.3])
    machine.reset([0.0])
    machine.follow([0.1], CYCLE_S)
    assert machine.load_torques_Nm([1], [0.0], 0.0) == pytest.approx([-0.3])
    with pytest.raises(ValueError, match="unknown parameter 'sprng', did you mean 'spring'"):
        machine.set_parameter("sprng", 1.0)


def test_an_fmu_that_cannot_be_reset_is_loaded_again(tmp_path: Path) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu", fails=5.0))
    for _ in range(2):
        machine.reset([0.0])
        machine.follow([0.1], CYCLE_S)
        assert machine.load_torques_Nm([1], [0.0], 0.0) == pytest.approx([-0.2])


def test_a_parameter_that_is_fixed_while_the_fmu_runs_is_refused(tmp_path: Path) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu"), parameters={"kind": "failure"})
    with pytest.raises(ValueError, match="failure is fixed while the FMU runs, expected a tunable parameter"):
        machine.set_parameter("kind", 1.0)


def test_what_is_not_mapped_is_not_known(tmp_path: Path) -> None:
    outputs = follower(build_fmu(tmp_path / "mass.fmu"), outputs={"s_m": "travel"}).outputs()
    assert outputs["s_m"] == 0.0
    assert outputs["x1_rad"] != outputs["x1_rad"]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (1.0, r"FMU mass.fmu crashed \(SIGSEGV\) in 'steps'"),
        (2.0, r"FMU mass.fmu gave no answer to 'steps' within 0.3 s"),
        (3.0, r"FMU mass.fmu .*DoStep failed with status 3"),
    ],
)
def test_an_fmu_that_fails_is_one_fault_and_leaves_nothing(tmp_path: Path, fmi: int, kind: float, told: str) -> None:
    path = build_fmu(tmp_path / "mass.fmu", fmi)
    model = shaft(path, [], timeout_s=0.3)
    failing(model, path, kind)
    folder = model._process._folder
    assert folder.is_dir()
    for _ in range(9):
        model.advance([0.5], 0.001)
    with pytest.raises(BenchFaultError, match=told):
        model.advance([0.5], 0.003)
    assert not folder.exists()
    assert model._process._process.poll() is not None
    with pytest.raises(BenchFaultError, match="has been ended"):
        model.advance([0.5], 0.001)


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_an_fmu_logs_is_reported(tmp_path: Path, fmi: int) -> None:
    path, said = build_fmu(tmp_path / "mass.fmu", fmi), []
    model = shaft(path, said)
    failing(model, path, 4.0)
    for _ in range(20):
        model.advance([0.5], 0.001)
    assert said == ["FMU mass.fmu: warning: the screw is jammed"]


def test_the_folder_of_an_fmu_goes_with_the_machine_that_used_it(tmp_path: Path) -> None:
    machine = follower(build_fmu(tmp_path / "mass.fmu"))
    folder = machine._model._process._folder
    assert folder.parent == Path(tempfile.gettempdir())
    del machine
    for _ in range(50):
        if not folder.exists():
            break
        time.sleep(0.1)
    assert not folder.exists()
