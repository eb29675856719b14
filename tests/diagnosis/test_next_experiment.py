"""Steps that would tell what the last recording left open."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from tests.plant.models import effect, lone_axis, model

from hilbench.diagnosis.diagnosis import Diagnosis, Gap, NamedEffect, Unobservable, Value
from hilbench.diagnosis.machines import emulation_of
from hilbench.diagnosis.next_experiment import LONGEST_S, Reach, duration_s, moves, propose, write_steps
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.runs.check import check_experiment
from hilbench.runs.config import load_with_overrides

REACH = Reach(top=4.0, steepest=3.0, tension_N=80.0)


def left_open(
    found: Machine, *, tied: list[str] | None = None, blind: tuple[tuple[str, int | None], ...] = ()
) -> Diagnosis:
    """A diagnosis with one effect of axis 2, tied with others, of the demonstrator or another model."""
    effects = [
        NamedEffect(
            entry.effect,
            entry.axis,
            {name: Value(v, (v, v), "1") for name, v in entry.parameters.items()},
            {},
            tied or [],
            None,
        )
        for entry in found.effects
    ]
    gaps = [Gap(f"tau{axis}_Nm", 0.05, 0.05, 0.05, "N·m") for axis in range(1, found.axis_count + 1)]
    unseen = [Unobservable(name, axis, None, "1", find_effect(name).shown_by) for name, axis in blind]
    nothing = np.zeros((0, 0))
    return Diagnosis(
        verdict="named",
        effects=effects,
        gaps=gaps,
        where=[],
        profiles=[],
        unexplained=[],
        unobservable=unseen,
        missing_channels=[],
        model=found,
        names=(),
        t_s=np.zeros(0),
        before=nothing,
        after=nothing,
        held_out=np.zeros(0, bool),
        simulations=0,
    )


FRICTION = effect("coulomb_friction", 2, force_N=4.2)


def test_friction_that_may_be_an_offset_of_strain_is_asked_by_going_back_and_forth() -> None:
    proposed = propose(left_open(model(FRICTION), tied=["strain_offset"]), REACH)
    assert proposed is not None
    assert "forward and back" in proposed.moves
    assert any("whether it is coulomb_friction or strain_offset" in reason for reason in proposed.reasons)
    speeds = [step["ramp"]["to"] for step in proposed.steps if "ramp" in step]
    assert min(speeds) < 0.0 < max(speeds)


def test_where_nothing_is_left_open_nothing_is_proposed() -> None:
    assert propose(left_open(model(FRICTION)), REACH) is None
    assert propose(left_open(shaft("coulomb_friction", torque_Nm=0.1)), AXIS_REACH) is None


AXIS_REACH = Reach(top=30.0, steepest=40.0, torque_Nm=0.5)


def shaft(name: str, **parameters: float) -> ServoAxisParameters:
    """A servo axis that was found to have an effect."""
    return ServoAxisParameters.model_validate(
        {"shaft": {"inertia_kg_m2": 0.05}, "effects": [{"effect": name, "axis": 1, "parameters": parameters}]}
    )


@pytest.mark.parametrize(
    ("machine", "path"),
    [
        (shaft("coulomb_friction", torque_Nm=0.1), "speed_rad_s"),
        (lone_axis(effect("coulomb_friction", 1, force_N=1.0)), "line_speed_m_s"),
    ],
    ids=["shaft", "lone axis of a web"],
)
def test_friction_that_may_be_an_offset_of_a_lone_axis_is_told_by_turning_both_ways(
    machine: Machine, path: str
) -> None:
    proposed = propose(left_open(machine, tied=["torque_offset"]), AXIS_REACH)
    assert proposed is not None
    assert proposed.duration_s <= LONGEST_S
    ramps = [step["ramp"] for step in proposed.steps if "ramp" in step]
    assert {ramp["path"] for ramp in ramps} == {path}
    speeds = [ramp["to"] for ramp in ramps]
    assert min(speeds) < 0.0 < max(speeds)
    assert max(map(abs, speeds)) <= AXIS_REACH.top
    (reason,) = proposed.reasons
    assert "whether it is coulomb_friction or torque_offset" in reason


def test_no_move_of_an_axis_asks_more_than_it_has_done() -> None:
    for steps in moves(AXIS_REACH, "rad").values():
        before = 0.0
        for ramp in (step["ramp"] for step in steps if "ramp" in step):
            assert abs(ramp["to"]) <= AXIS_REACH.top
            assert abs(ramp["to"] - before) <= 1.001 * AXIS_REACH.steepest * ramp["duration_s"]
            before = ramp["to"]
        assert before == 0.0


def test_an_effect_that_an_axis_could_not_show_is_asked_by_a_move_that_shows_it() -> None:
    unseen = left_open(shaft("coulomb_friction", torque_Nm=0.1), blind=(("inertia_mismatch", 1),))
    proposed = propose(unseen, AXIS_REACH)
    assert proposed is not None
    assert "steep ramps" in proposed.moves


@pytest.mark.parametrize(("frequency_Hz", "shows"), [(5.0, True), (20.0, False)])
def test_a_resonance_that_an_axis_could_not_show_is_asked_at_its_frequency(frequency_Hz: float, shows: bool) -> None:
    """As steep as this axis is, nothing it may be asked tells of a higher one."""
    shown_by = find_effect("resonance", MachineKind.SERVO_AXIS).shown_by
    unseen = Unobservable("resonance", 1, None, "1", shown_by, frequency_Hz=frequency_Hz)
    found = replace(left_open(shaft("coulomb_friction", torque_Nm=0.1)), unobservable=[unseen])
    proposed = propose(found, AXIS_REACH)
    reasons = [] if proposed is None else proposed.reasons
    assert any("whether there is resonance of axis 1" in reason for reason in reasons) == shows


def test_every_effect_that_a_rotary_axis_described_in_metres_did_not_show_can_be_asked() -> None:
    """Of a radius of 1 m a usual eccentricity would be larger than any may be."""
    machine = lone_axis(effect("coulomb_friction", 1, force_N=1.0))
    for name in (each.id for each in effects_of(MachineKind.WEB_LINE) if each.per_axis):
        proposed = propose(left_open(machine, blind=((name, 1),)), AXIS_REACH)
        assert proposed is None or proposed.duration_s <= LONGEST_S


def test_an_effect_that_was_not_shown_is_asked_by_a_move_that_shows_it() -> None:
    unseen = left_open(model(), blind=(("inertia_mismatch", 2),))
    proposed = propose(unseen, REACH)
    assert proposed is not None
    assert any("inertia_mismatch of axis 2" in reason for reason in proposed.reasons)


@pytest.mark.parametrize("top", [0.3, 4.0, 12.0])
@pytest.mark.parametrize("steepest", [0.2, 3.0])
@pytest.mark.parametrize("tension", [None, 80.0])
def test_no_move_asks_more_than_the_machine_has_done_nor_takes_longer_than_may_be(
    top: float, steepest: float, tension: float | None
) -> None:
    reach = Reach(top, steepest, tension)
    for name, steps in moves(reach).items():
        speed = 0.0
        for step in steps:
            if "ramp" in step:
                to, within_s = step["ramp"]["to"], step["ramp"]["duration_s"]
                assert abs(to) <= top * 1.0001, name
                assert abs(to - speed) / within_s <= steepest * 1.01, name
                speed = to
            assert "set" not in step or tension is not None
        assert speed == 0.0
        assert duration_s(steps) + 0.5 <= LONGEST_S


def test_what_is_written_is_an_experiment_that_the_bench_of_the_config_can_run(tmp_path: Path) -> None:
    config = Path("bench_configs/hidden_friction.yaml")
    bench = load_with_overrides(config).config
    found = replace(left_open(model(FRICTION), tied=["strain_offset"]), emulation=emulation_of(bench))
    proposed = propose(found, REACH)
    assert proposed is not None
    assert proposed.duration_s <= LONGEST_S
    path = write_steps(tmp_path / "next.yaml", proposed, config)
    assert path.read_text().startswith(f"# {proposed.moves}, ")
    assert all(f"# - {reason}" in path.read_text() for reason in proposed.reasons)
    checked = check_experiment(load_with_overrides(path))
    assert checked is not None
    steps = load_with_overrides(path).config.steps
    assert len(steps) == len(proposed.steps)


def test_without_a_config_the_steps_say_how_they_are_run(tmp_path: Path) -> None:
    proposed = propose(left_open(model(FRICTION), tied=["strain_offset"]), REACH)
    assert proposed is not None
    text = write_steps(tmp_path / "next.yaml", proposed, None).read_text()
    assert "include: [my_bench.yaml, next.yaml]" in text
    assert yaml.safe_load(text)["steps"] == proposed.steps


@pytest.mark.parametrize(("clear_after", "rounds"), [(1, 1), (2, 2), (9, 3)])
def test_until_clear_the_bench_runs_on_with_more_steps_each_time_and_three_times_at_most(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], clear_after: int, rounds: int
) -> None:
    """The bench and the search are stood in for: what is run in which order, and what is said of it."""
    from hilbench.apps.diagnose import diagnose as command
    from hilbench.apps.diagnose.command import diagnose
    from hilbench.diagnosis.web_line_bench_gap import LiveGap
    from hilbench.results.recording import Recording

    ran: list[list[object]] = []
    tied = left_open(model(FRICTION), tied=["strain_offset"])
    clear = left_open(model(FRICTION))
    folder = SimpleNamespace(recording=Path("recording.mf4"))

    def run_bench(*_: object, more_steps: list[object] = [], **__: object) -> object:  # noqa: B006
        ran.append(list(more_steps))
        return SimpleNamespace(folder=folder)

    t = np.arange(0.0, 10.0, 0.002)
    recording = Recording({"t_s": t, "v2_cmd_m_s": 2.0 * np.sin(t), "F_ref_N": np.full(len(t), 80.0)})
    monkeypatch.setattr(command, "run_bench", run_bench)
    monkeypatch.setattr(command, "live_gap", lambda outcome: LiveGap(Path("run"), 1, ()))
    monkeypatch.setattr(command, "read_section", lambda path: recording)
    monkeypatch.setattr(command, "diagnose", lambda *_: tied if len(ran) <= clear_after else clear)
    diagnose(Path("bench_configs/hidden_friction.yaml"), json=True, until_clear=True)
    said = json.loads(capsys.readouterr().out)
    assert len(said["rounds"]) == rounds
    assert all(line.startswith("slowly forward and back") for line in said["rounds"])
    asked = [len(steps) for steps in ran[: rounds + 1]]
    assert asked == sorted(set(asked)), "each run has the steps of the one before, and more"
    assert ran[-1] == ran[rounds], "the extended model has the same experiment as the last run"
