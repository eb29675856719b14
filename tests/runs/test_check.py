"""What `check` says of a config, beside what the bench then does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.tiers import slow

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.tension_loop import OperatingPoint, TensionLoop
from hilbench.errors import UnusableInputError
from hilbench.runs.check import CheckedExperiment, check_experiment
from hilbench.runs.config import load_with_overrides
from hilbench.topology.sample import CycleSample

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
CONFIG = CONFIGS / "web_section_step.yaml"
RAMPING = (
    "load.effects=[{effect: elasticity_ramp, parameters: {time_s: 5, duration_s: 5, relative_change: 9}}, "
    "{effect: elasticity_ramp, parameters: {time_s: 1, duration_s: 1, relative_change: 0.1}}]"
)
UNDAMPED = "controllers.tension_control.swing_damping_ratio=0"


def config_of(folder: Path, *steps: str) -> Path:
    """The demo's bench with other steps, the first of them in line 3 of the file."""
    path = folder / "config.yaml"
    path.write_text(f"include: {CONFIG}\nsteps:\n" + "".join(f"  - {step}\n" for step in steps) + "criteria: []\n")
    return path


def check(path: Path, *changes: str, with_margins: bool = False) -> CheckedExperiment:
    return check_experiment(load_with_overrides(path, changes=changes), with_margins=with_margins)


@pytest.mark.parametrize("bandwidth", [2, 4, 6, 8, 10])
def test_every_bandwidth_of_the_sweep_in_the_readme_has_margin(bandwidth: int) -> None:
    found = check(CONFIG, f"controllers.tension_control.bandwidth_rad_per_s={bandwidth}", with_margins=True)
    assert found.worst is not None
    assert found.worst.margins.gain > 2.5
    assert found.worst.margins.phase_deg > 40.0
    assert not found.warnings


def test_a_loop_that_rings_is_told_with_its_margins_and_one_that_is_unstable_is_refused() -> None:
    (warning,) = check(CONFIG, UNDAMPED, with_margins=True).warnings
    assert "rings: gain margin 1." in warning
    assert "1.05e+04 N/mm²" in warning
    match = "bandwidth_rad_per_s=10: the tension loop is unstable with 10 rad/s over a cycle of 2 ms at E 8700 N/mm²"
    with pytest.raises(UnusableInputError, match=match):
        check(CONFIG, UNDAMPED, "controllers.tension_control.bandwidth_rad_per_s=10")


def test_the_torque_that_a_simulated_drive_without_6072h_has_is_told_where_it_is_not_enough(tmp_path: Path) -> None:
    eds = (CONFIGS.parent / "eds" / "hilbench_servo.eds").read_text()
    (tmp_path / "drive.eds").write_text(re.sub(r"\[6072\]\n(?:[^\[]*\n)*?(?=\[)", "", eds))
    changes = [f"drives.axis2.eds={tmp_path / 'drive.eds'}", "drives.axis2.parameters={6076h: 500}"]
    (warning,) = check(config_of(tmp_path, "ramp: {path: line_speed_m_s, to: 3, duration_s: 1.0}"), *changes).warnings
    assert "of axis 2, which has 1.5 N·m" in warning


def swing_behind_a_kick_N(bandwidth: float) -> float:
    """Of the true tension at standstill, from 2 s after its set-point was stepped on; not damped."""
    changes = [UNDAMPED, f"controllers.tension_control.bandwidth_rad_per_s={bandwidth}"]
    seen: list[float] = []

    class Watch:
        def sample(self, sample: CycleSample) -> None:
            seen.append(sample.F_true_N)

    config = load_with_overrides(CONFIG, changes=changes).config
    with Bench(config, participants=Participants.IN_PROCESS, observers=[Watch()]) as bench:
        bench.run(1.0)
        bench.set("tension_control.set_point_N", 85.0)
        bench.run(2.3)
    return float(np.ptp(seen[-150:]))


def test_the_border_of_stability_is_where_the_bench_has_it() -> None:
    config = load_with_overrides(CONFIG, changes=[UNDAMPED]).config
    border = 6.0 * TensionLoop(config, OperatingPoint((8.7e9,), 0.0, (1.0,), (8.7e9,))).margins.gain
    assert swing_behind_a_kick_N(0.9 * border) < 3.0
    assert swing_behind_a_kick_N(1.1 * border) > 20.0


def test_what_the_steps_make_of_e_is_looked_at(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("t_s,load.web.youngs_modulus_Pa\n0,8.7e9\n1,90e9\n2,\n")
    for step in (
        "step: {path: load.web.youngs_modulus_Pa, to: 90e9}",
        "ramp: {path: load.web.youngs_modulus_Pa, to: 90e9, duration_s: 3}",
        "set: {path: load.effects.elasticity_shift.relative_change, to: 9}",
        "hold: {duration_s: 12}",
        f"table: {{file: {table}}}",
    ):
        with pytest.raises(UnusableInputError, match=r"config.yaml:3: the load motor can't emulate so stiff a web"):
            check(config_of(tmp_path, step), *([RAMPING] if "hold" in step else []))


@pytest.mark.parametrize(
    ("steps", "changes", "said"),
    [
        (["set: {path: tension_control.set_point_N, to: 450}"], [], "set-point of the tension 450 N is beyond"),
        (["ramp: {path: line_speed_m_s, to: 12, duration_s: 9}"], [], "line speed 12 m/s is beyond the trip level 10"),
        (
            ["ramp: {path: line_speed_m_s, to: 8, duration_s: 9}"],
            [],
            "line speed 8 m/s reaches the warning level 8 m/s",
        ),
        (
            ["step: {path: load.web.youngs_modulus_Pa, to: 17e9}"],
            ["safety.limits.tension_N.warning=90", "safety.limits.tension_N.trip=100"],
            "tension right behind this step of E 156.3 N is beyond the trip level 100 N",
        ),
        (["set: {path: line_speed_m_s, to: 3}"], [], r"3 m/s at once asks for 112 N·m of axis 2, which has 9 N·m"),
        (
            ["ramp: {path: line_speed_m_s, to: 3, duration_s: 4}"],
            ["machine.rollers.inertia_kg_m2=100"],
            "within 4 s asks for 75.4 N·m of axis 2, which has 9 N·m: it is at its limit and there no sooner than 35 s",
        ),
        (
            ["ramp: {path: line_speed_m_s, to: 3, duration_s: 4}"],
            ["drives.axis2.parameters={6072h: 200}"],
            "from 0 to 3 m/s within 4 s asks for 1.3 N·m of axis 2, which has 1 N·m",
        ),
        (
            ["ramp: {path: line_speed_m_s, to: 3, duration_s: 4}"],
            ["machine.boundary.downstream_tension_N=0", "machine.drives.torque_limit_Nm=4"],
            "from 0 to 3 m/s within 4 s asks for 4.1 N·m of axis 2, which has 4 N·m",
        ),
    ],
)
def test_what_a_step_will_run_into_is_a_warning_with_its_line(
    tmp_path: Path, steps: list[str], changes: list[str], said: str
) -> None:
    (warning,) = check(config_of(tmp_path, *steps), *changes).warnings
    assert "config.yaml:3: " in warning
    assert said in warning


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            ["machine.rollers.gear_ratio=15"],
            "3 m/s asks for 2149 rpm of axis2, which goes up to 2000 rpm (6080h, max motor speed): it is at its limit, "
            "expected at most 2.79 m/s",
        ),
        (["machine.rollers.gear_ratio=15", "drives.axis2.parameters={6080h: 3000}"], ""),
        (
            ["load_motors.load.parameters={607Fh: 6000000}"],
            "3 m/s asks for 716 rpm of load, which goes up to 600 rpm (607Fh, max profile velocity)",
        ),
    ],
)
def test_a_speed_that_a_motor_cannot_turn_at_is_told_before_the_run(
    tmp_path: Path, changes: list[str], said: str
) -> None:
    ramp = config_of(tmp_path, "ramp: {path: line_speed_m_s, to: 3, duration_s: 9}")
    warnings = check(ramp, "drives.axis2.parameters={6080h: 2000}", *changes).warnings
    assert len(warnings) == bool(said)
    assert all(f"config.yaml:3: {said}" in warning for warning in warnings)


def test_a_web_that_pulls_a_roller_away_when_it_is_enabled_is_told_before_the_run(tmp_path: Path) -> None:
    slow, far = "drives.axis2.parameters={6080h: 12}", "machine.boundary.downstream_tension_N=400"
    config = config_of(tmp_path, "hold: {duration_s: 1}")
    (warning,) = check(config, slow, far).warnings
    assert "+320 N behind axis 2" in warning
    assert "axis2 goes up to 12 rpm (6080h): it may report overspeed, expected tensions that are at most" in warning
    assert not check(config, slow).warnings
    assert not check(config, far).warnings


def test_torque_that_the_current_loop_smooths_between_two_set_points_is_not_told(tmp_path: Path) -> None:
    ramp = config_of(tmp_path, "ramp: {path: line_speed_m_s, to: 3, duration_s: 4}")
    flat, soft = "machine.boundary.downstream_tension_N=80", "machine.web.youngs_modulus_Pa=1e8"
    stiff, weak = "machine.drives.velocity_kp_Nm_s_per_rad=3", "machine.drives.torque_limit_Nm=1.05"
    asked, current = ("cycle_time_s=0.008", flat, soft, stiff, weak), "machine.drives.current_loop_time_constant_s="
    assert not check(ramp, *asked, f"{current}0.001").warnings
    (warning,) = check(ramp, *asked, f"{current}0").warnings
    assert "asks for 1.14 N·m of axis 1, which has 1.05 N·m" in warning


def test_a_virtual_axis_with_less_torque_than_its_motor_needs_is_told_before_the_run(tmp_path: Path) -> None:
    ramp = config_of(tmp_path, "ramp: {path: line_speed_m_s, to: 3, duration_s: 4}")
    (warning,) = check(ramp, "drives.axis2.virtual.parameters={6072h: 200}").warnings
    assert "from 0 to 3 m/s within 4 s asks for 1.3 N·m of virtual axis 2, which has 1 N·m" in warning


def test_a_gentle_experiment_has_no_warning(tmp_path: Path) -> None:
    found = check(
        config_of(
            tmp_path,
            "ramp: {path: line_speed_m_s, to: 3, duration_s: 4}",
            "step: {path: load.web.youngs_modulus_Pa, to: 12e9}",
        )
    )
    assert not found.warnings
    assert not found.notes


def test_a_set_point_beyond_the_trip_level_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="set_point_N is 450, expected less than the trip level"):
        check(CONFIG, "controllers.tension_control.set_point_N=450")


def test_python_files_are_looked_at_before_and_what_they_ask_for_is_said_to_be_unknown(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def experiment(bench):\n    yield\n")
    (note,) = check(config_of(tmp_path, f"python: {{file: {tmp_path / 'mine.py'}}}")).notes
    assert "config.yaml:3: what 'experiment' of mine.py asks for can't be known" in note
    with pytest.raises(UnusableInputError, match="no function 'other'"):
        check(config_of(tmp_path, f"python: {{file: {tmp_path / 'mine.py'}, function: other}}"))


def eds_with(folder: Path, *changes: str) -> str:
    """The shipped drive's EDS file with other entries ("60C2sub1/AccessType=const"), as the one of axis 1."""
    sections = (CONFIGS.parent / "eds" / "hilbench_servo.eds").read_text().split("\n[")
    for change in changes:
        name, _, entry = change.partition("/")
        at = next(k for k, section in enumerate(sections) if section.startswith(f"{name}]"))
        key = entry.partition("=")[0]
        kept = [line for line in sections[at].splitlines() if not line.startswith(f"{key}=")]
        sections[at] = "\n".join([kept[0], entry, *kept[1:], ""])
    (folder / "drive.eds").write_text("\n[".join(sections))
    return f"drives.axis1.eds={folder / 'drive.eds'}"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            ["60C2sub1/AccessType=const", "60C2sub1/DefaultValue=4"],
            "takes a cycle of 2 ms: 60C2h:1 is read-only and has 4",
        ),
        (["60C2sub2/AccessType=ro", "60C2sub2/DefaultValue=-2"], "60C2h:2 is read-only and has -2"),
        (["60C2sub1/HighLimit=1"], "60C2h that takes a cycle of 2 ms: 60C2h:1 goes to 1"),
        (["6502/DefaultValue=1"], r"lacks mode 9 in 6502h \(00000001h\)"),
        (["6060/AccessType=ro"], r"6060h:0 that takes 9 \(the mode is written to it\), which is read-only and has 0"),
        (["6060/HighLimit=8"], r"6060h:0 that takes 9 \(the mode is written to it\), which goes to 8"),
        (["605A/AccessType=const", "605A/DefaultValue=1"], "605Ah:0 that takes 2 .* which is read-only and has 1"),
        (["6085/HighLimit=1000"], "6085h:0 that takes 7161972 .* which goes from 1 to 1000"),
        (["1017/AccessType=const"], "1017h:0 that takes 100 .* which is read-only and has 0"),
        (["1400sub2/AccessType=const", "1400sub2/DefaultValue=255"], "1400h:2 that takes 1 .* read-only and has 255"),
        (
            ["1400sub1/AccessType=ro", "1400sub1/DefaultValue=0x305"],
            r"1400h:1 that takes 201h .* which is read-only and has 773",
        ),
        (["6064/PDOMapping=0"], r"6064h \('Position actual value'\) is not mappable by its EDS"),
        (["60FF/AccessType=ro"], r"60FFh \('Target velocity'\) is ro by its EDS, .* can be received in a PDO"),
        (["6041/AccessType=wo"], r"6041h \('Statusword'\) is wo by its EDS, .* can be sent in a PDO"),
    ],
)
def test_a_drive_whose_eds_cannot_do_what_the_config_asks_is_refused(
    tmp_path: Path, changes: list[str], said: str
) -> None:
    with pytest.raises(UnusableInputError, match=f"web_section_step.yaml:15: .*{said}"):
        check(CONFIG, eds_with(tmp_path, *changes))


@pytest.mark.parametrize("fixed", [("60C2sub2",), ("60C2sub1", "60C2sub2"), ("605A",), ("1400sub1", "1800sub1")])
def test_a_drive_that_has_what_it_is_asked_for_in_read_only_objects_runs(
    tmp_path: Path, fixed: tuple[str, ...]
) -> None:
    drive = eds_with(tmp_path, "605A/DefaultValue=2", *(f"{name}/AccessType=const" for name in fixed))
    config = load_with_overrides(CONFIG, changes=[drive]).config
    check(CONFIG, drive)
    with Bench(config, participants=Participants.IN_PROCESS) as bench:
        bench.run(0.1)


def test_a_drive_without_a_heartbeat_runs_and_is_watched_by_its_tpdos(tmp_path: Path) -> None:
    """1017h is conditional: a device with node guarding needs none."""
    drive = eds_with(tmp_path)
    path = tmp_path / "drive.eds"
    path.write_text(re.sub(r"(?s)\[1017\].*?(?=\n\[)", "", path.read_text()))
    check(CONFIG, drive)
    with Bench(load_with_overrides(CONFIG, changes=[drive]).config, participants=Participants.IN_PROCESS) as bench:
        bench.run(0.5)


def test_a_bus_that_is_not_there_is_refused_in_one_line() -> None:
    done = hilbench("check", CONFIG, "--bus", "socketcan:nosuchcan0")
    assert done.returncode == 2
    assert not done.stdout
    assert len(done.stderr.strip().splitlines()) == 1
    assert "nosuchcan0" in done.stderr


@pytest.mark.parametrize(
    "changes",
    [
        ["cycle_time_s=0.004"],
        ["machine.web.span_length_m=0.05", "machine.web.youngs_modulus_Pa=1.1e9"],
        *slow(
            ["machine.web.span_length_m=0.05", "machine.web.youngs_modulus_Pa=1e8"],
            ["controllers.tension_control.bandwidth_rad_per_s=10"],
        ),
    ],
)
def test_what_check_calls_usable_runs_through_a_step_of_e(changes: list[str]) -> None:
    config = load_with_overrides(CONFIG, changes=changes).config
    before_Pa = config.web_line.youngs_modulus_Pa(1)
    changes = [*changes, f"steps.2.step.to={1.207 * before_Pa}"]
    check(CONFIG, *changes)
    with Bench(config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 3.0, 3.0)
        bench.run(1.0)
        bench.step("load.web.youngs_modulus_Pa", 1.207 * before_Pa)
        bench.run(1.5)
        assert bench.last.F_true_N == pytest.approx(80.0, abs=2.0)
        assert not [notice.text for notice in bench.notices if notice.source in ("limits", "saturation", "twin")]
