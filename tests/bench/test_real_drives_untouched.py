"""What is meant for the simulated hardware never reaches a real drive, nor an object of a maker's own."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from tests.bench.whole_runs import config
from tests.cia402.stand_in import StandingClock

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.errors import UnusableInputError, UnusableValueError
from hilbench.exchange.effect_objects import bind_effect_objects
from hilbench.runs.check import check_experiment
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
STEP = ROOT / "bench_configs" / "web_section_step.yaml"
FRICTION = "hardware.effects.coulomb_friction.axis2.force_N"
OURS = "[2200]\nParameterName=coulomb_friction\n"


def makers_eds(folder: Path) -> Path:
    """A drive whose maker has an analog input at 2200h and the gain of a position loop at 2201h."""
    text = (ROOT / "eds" / "hilbench_servo.eds").read_text()
    for ours, makers in (("force_N [N]", "Analog input 1"), ("coefficient_N_s_per_m [N s/m]", "Gain")):
        text = text.replace(f"ParameterName={ours}", f"ParameterName={makers}", 1)
    (folder / "makers.eds").write_text(text.replace(OURS, "[2200]\nParameterName=Analog inputs\n"))
    return folder / "makers.eds"


def check(*changes: str, path: str = FRICTION) -> None:
    steps = f"steps=[{{step: {{path: {path}, to: 5.0}}}}]"
    check_experiment(load_with_overrides(STEP, changes=[*changes, steps, "criteria=[]"]))


def test_a_step_of_friction_hidden_in_a_drive_that_is_real_is_refused_before_anything_starts() -> None:
    check()
    with pytest.raises(UnusableInputError, match="an axis of the simulated hardware, 'axis2' is a real drive"):
        check("drives.axis2.simulated=false")
    check("drives.axis2.simulated=false", path=FRICTION.replace("axis2", "axis1"))


def test_a_step_of_friction_in_a_simulated_drive_by_a_makers_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"'coulomb_friction' as 2200h, makers\.eds has 'Analog inputs' there"):
        check(f"drives.axis2.eds={makers_eds(tmp_path)}")


def test_a_script_cannot_reach_the_objects_of_a_makers_drive(tmp_path: Path) -> None:
    drives = yaml.safe_load(config(tmp_path).read_text())["drives"]
    drives["axis2"] |= {"eds": str(makers_eds(tmp_path)), "virtual": drives["axis1"]["virtual"] | {"node_id": 18}}
    with Bench(config(tmp_path, drives=drives), participants=Participants.IN_PROCESS) as running:
        with pytest.raises(UnusableValueError, match="'coulomb_friction' as 2200h"):
            running.set(FRICTION, 5.0)
        running.set(FRICTION.replace("axis2", "axis1"), 5.0)


def test_writing_a_setting_of_the_makers_changes_no_friction(tmp_path: Path) -> None:
    device, applied = Device(load_eds(makers_eds(tmp_path), 1), 1, StandingClock()), []
    bind_effect_objects(device, lambda effect, parameters: applied.append(effect))
    for index in (0x2200, 0x2201, 0x2202):
        device.cell(index, 1).write(8.0)
    assert applied == ["stribeck_friction"]
