"""Recordings as stands make them: loops that are not the model's, no commands, coarse rows, missing channels.

The machine is the independent line, which shares no equation with the model.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.cli.in_process import hilbench
from tests.independent_line import Line, Loops, effect

from hilbench.diagnosis.diagnosis import Diagnosis, Explained, concluded, diagnose
from hilbench.diagnosis.fit import fit
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.predictor import choice
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.selection import CandidateSet, Selection
from hilbench.diagnosis.space import Space, noise_model
from hilbench.plant.effects import find_effect
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording, write_recording

COMMANDS = ("v1_cmd_m_s", "v2_cmd_m_s")
OTHER_GAINS = Loops(kp=(1.2, 1.2), ki=(0.85, 0.85))


def examined(profile: str = "identification", duration_s: float = 30.0, seed: int = 5, **line: Any) -> Diagnosis:
    machine = Line(**line)
    recording = Recording(machine.record(profile, seed, duration_s).channels)
    return diagnose(recording, ModelParameters.model_validate(machine.model), "stand")


def named(found: Diagnosis) -> list[set[tuple[str, int | None]]]:
    """Of each effect what it is, or is said to be tied with."""
    result = []
    for e in found.effects:
        options: set[tuple[str, int | None]] = {(e.effect, e.axis)}
        for text in e.tied_with:
            name, _, axis = text.partition(" (axis ")
            options |= {(name, int(axis.rstrip(")")))} if axis else {(name, e.axis), (name, None)}
        result.append(options)
    return result


def assert_only(found: Diagnosis, item: Mapping[str, Any]) -> None:
    """One effect, the right one, with its values."""
    assert found.verdict == "named"
    (options,) = named(found)
    assert (item["effect"], item["axis"]) in options
    if (found.effects[0].effect, found.effects[0].axis) == (item["effect"], item["axis"]):
        for name, value in item["parameters"].items():
            low, high = found.effects[0].parameters[name].ci95
            assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low)  # four standard errors


@pytest.mark.slow
@pytest.mark.parametrize(
    ("condition", "item"),
    [
        ({"loops": OTHER_GAINS}, effect("coulomb_friction", 2, force_N=4.2)),
        (
            {"loops": Loops(lag_s=(0.003, 0.003))},
            effect("roller_eccentricity", 2, amplitude_m=2.5e-5, phase_rad=0.3),
        ),
        ({"without": COMMANDS}, effect("elasticity_shift", relative_change=0.15)),
        ({"row_s": 0.01}, effect("viscous_friction", 1, coefficient_N_s_per_m=2.0)),
        ({"row_s": 0.02}, effect("inertia_mismatch", 2, relative_change=0.15)),
        ({"without": ("x1_m", "x2_m")}, effect("web_slip", creep_per_N=2.2e-6)),
        ({"without": ("tau1_Nm",)}, effect("torque_offset", 2, offset_Nm=0.04)),
        ({"profile": "production"}, effect("coulomb_friction", 2, force_N=4.2)),
    ],
    ids=["gains", "lag", "no commands", "10 ms", "20 ms", "speeds", "a torque", "production"],
)
def test_what_is_hidden_is_named_and_nothing_else(condition: dict[str, Any], item: Mapping[str, Any]) -> None:
    assert_only(examined(hidden=[item], **condition), item)


@pytest.mark.slow
@pytest.mark.parametrize("condition", [{"loops": OTHER_GAINS}, {"without": COMMANDS}], ids=["gains", "no commands"])
def test_nothing_is_named_where_nothing_is_missing_but_the_loops(condition: dict[str, Any]) -> None:
    found = examined(**condition)
    assert (found.verdict, found.effects) == ("complete", [])


@pytest.mark.slow
def test_what_the_drives_differ_by_is_said_beside_the_effects() -> None:
    found = examined(loops=Loops(kp=(1.2, 1.0), ki=(0.85, 1.0), lag_s=(0.001, 0.003)))
    of = {(e.effect, e.axis): e.parameters for e in found.nuisance}
    assert set(of) == {("drive_gain", 1), ("drive_lag", 2)}
    assert of["drive_gain", 1]["kp_relative_change"].value == pytest.approx(0.2, abs=0.03)
    assert of["drive_gain", 1]["ki_relative_change"].value == pytest.approx(-0.15, abs=0.03)
    assert of["drive_lag", 2]["lag_s"].value == pytest.approx(0.002, abs=4e-4)
    assert found.effects == []
    assert examined().nuisance == []


@pytest.mark.slow
def test_two_effects_are_told_apart_without_commands_on_a_machine_with_other_loops() -> None:
    pair = [effect("coulomb_friction", 2, force_N=4.0), effect("elasticity_shift", relative_change=-0.1)]
    found = examined(hidden=pair, without=COMMANDS, loops=OTHER_GAINS, row_s=0.004)
    assert sorted(e.effect for e in found.effects) == ["coulomb_friction", "elasticity_shift"]


@pytest.mark.slow
def test_the_quick_part_of_the_motion_is_by_what_was_found() -> None:
    """Jitter of the rows leaves a calm part of 1.5 Hz, in which no corner of the speed is."""
    item = effect("torque_scale", 2, relative_change=-0.19)
    assert_only(examined(hidden=[item], row_s=0.001, jitter_s=2e-5, loops=OTHER_GAINS), item)


@pytest.mark.slow
def test_what_only_the_held_out_ramp_shows_is_found_behind_what_shows_everywhere() -> None:
    pair = [effect("inertia_mismatch", 2, relative_change=-0.15), effect("elasticity_shift", relative_change=0.185)]
    loops = Loops(kp=(1.16, 0.72), ki=(1.11, 1.13), lag_s=(0.0037, 0.0039), trapezoidal=True)
    recorded = {"row_s": 0.01, "without": ("v1_m_s", "v2_m_s"), "bristle_N_per_m": 7.2e4}
    found = examined("production", 40.0, 321, hidden=pair, loops=loops, **recorded)
    assert found.verdict == "named"
    assert sorted(e.effect for e in found.effects) == ["elasticity_shift", "inertia_mismatch"]


@pytest.mark.slow
def test_a_ripple_once_a_turn_is_not_taken_for_the_encoder_of_the_other_axis() -> None:
    """Both motors turn nearly alike, and the torque of axis 1 is not recorded."""
    ripple = effect("torque_ripple", 2, amplitude_Nm=0.113, order=1.0, phase_rad=-2.5)
    loops = Loops(kp=(1.29, 0.93), ki=(0.83, 1.03), lag_s=(0.0011, 0.0034), trapezoidal=True)
    hidden = [effect("coulomb_friction", 2, force_N=4.57), ripple]
    found = examined("identification", 40.0, 302, hidden=hidden, loops=loops, without=("tau1_Nm",))
    assert [(e.effect, e.axis) for e in found.effects] == [("coulomb_friction", 2), ("torque_ripple", 2)]
    low, high = found.effects[1].parameters["amplitude_Nm"].ci95
    assert low < 0.113 < high


@pytest.mark.slow
def test_a_ripple_at_one_speed_is_not_looked_for_at_orders_that_the_rows_can_not_follow() -> None:
    """Of rows that come every 12 ms, as the prediction compares them, order 27.93 is order 0 at 3 m/s."""
    pair = [
        effect("torque_ripple", 2, amplitude_Nm=0.0475, order=2.0, phase_rad=-1.04),
        effect("torque_offset", 1, offset_Nm=-0.0626),
    ]
    loops = Loops(kp=(1.02, 1.0), ki=(1.27, 0.91), lag_s=(0.0038, 0.0025))
    found = examined("production", 40.0, 404, hidden=pair, loops=loops, row_s=0.004, bristle_N_per_m=4.7e5)
    assert found.verdict == "named"
    assert [("torque_offset", 1) in options or ("torque_ripple", 2) in options for options in named(found)] == [
        True
    ] * 2
    ripple = next(e for e in found.effects if e.effect == "torque_ripple")
    assert ripple.parameters["order"].value == pytest.approx(2.0, abs=1e-3)


@pytest.mark.slow
def test_a_measured_tension_is_used() -> None:
    """With torques as noisy as these, a change of E is known from the tension alone."""
    item = effect("elasticity_shift", relative_change=0.1)
    hidden = {"hidden": [item], "without": (*COMMANDS, "tau1_Nm"), "torque_noise_Nm": 2.0}
    assert "elasticity_shift" not in [e.effect for e in examined(**hidden).effects]
    assert_only(examined(**hidden, measured_tension_N=0.5), item)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "line"),
    [
        ("production", {"without": COMMANDS, "row_s": 0.01, "jitter_s": 2e-5}),
        ("identification", {"loops": Loops(kp=(0.92, 0.89), ki=(1.29, 0.88)), "row_s": 0.01}),
    ],
    ids=["production", "identification"],
)
def test_the_noise_of_a_coarse_motion_is_not_named_as_a_delay(profile: str, line: dict[str, Any]) -> None:
    found = examined(profile, 40.0, **line)
    assert (found.verdict, found.effects) == ("complete", [])


@pytest.mark.slow
def test_what_only_the_one_ramp_of_a_production_run_shows_is_found() -> None:
    """A third of the recording is held out; the ramp must not be in it alone."""
    pair = [effect("torque_scale", 1, relative_change=0.19), effect("web_slip", creep_per_N=1.8e-6)]
    found = examined("production", 40.0, hidden=pair, loops=OTHER_GAINS, row_s=0.02)
    assert found.verdict == "named"
    assert any(("torque_scale", 1) in options for options in named(found))
    assert any(("web_slip", None) in options for options in named(found))


@pytest.mark.slow
def test_a_step_that_was_held_out_gets_its_time_beside_what_is_found_later() -> None:
    pair = [
        effect("elasticity_step", time_s=25.12207, relative_change=0.15074),
        effect("roller_eccentricity", 1, amplitude_m=1.128e-5, phase_rad=0.99651),
    ]
    loops = Loops(kp=(0.99449, 0.76844), ki=(0.92398, 1.24049), lag_s=(0.0020815, 0.0010799), trapezoidal=True)
    rows = {"row_s": 0.01, "jitter_s": 2e-5, "bristle_N_per_m": 2.02e5}
    found = examined("identification", 40.0, 3, hidden=pair, without=COMMANDS, loops=loops, **rows)
    assert [e.effect for e in found.effects] == ["elasticity_step", "roller_eccentricity"]
    assert found.effects[0].parameters["time_s"].value == pytest.approx(25.122, abs=0.02)


@pytest.mark.slow
def test_a_sudden_change_beside_another_is_no_short_ramp() -> None:
    pair = [
        effect("elasticity_step", time_s=27.11849, relative_change=0.07851),
        effect("elasticity_shift", relative_change=0.05422),
    ]
    loops = Loops(kp=(1.14944, 0.86006), ki=(0.79127, 0.95369), lag_s=(0.0015681, 0.000691), trapezoidal=True)
    found = examined("production", 40.0, 5, hidden=pair, loops=loops, row_s=0.02)
    assert {e.effect for e in found.effects} == {"elasticity_step", "elasticity_shift"}


def known(hidden: Sequence[Mapping[str, Any]], seed: int, **line: Any) -> Diagnosis:
    """What is concluded of effects that are known to be there."""
    machine = Line(hidden=hidden, **line)
    model = ModelParameters.model_validate(machine.model)
    data = measured_from(Recording(machine.record("identification", seed, 30.0).channels), model, "stand")
    chosen = choice(model, data)
    space, proposer = Space(model, chosen.predictor, data.period_s), Proposer(model, data)
    terms = [proposer.known(find_effect(e["effect"]), e["axis"], e["parameters"]) for e in hidden]
    residual = space.residual(terms)
    none = np.empty((0, *residual.shape))
    white = noise_model(space, residual, none)
    offered = CandidateSet(white, residual, none, [], [])
    selection = Selection(fit(space, white, terms), offered)
    return concluded(Explained(space, chosen, data, selection))


def errors(found: Diagnosis, hidden: Sequence[Mapping[str, Any]]) -> list[float]:
    """Of each parameter, in halves of its 95 % interval."""
    of = {(e.effect, e.axis): e.parameters for e in found.effects}
    result = []
    for item in hidden:
        for name, true in item["parameters"].items():
            value = of[item["effect"], item["axis"]][name]
            low, high = value.ci95
            result.append((value.value - true) / (0.5 * (high - low)))
    return result


@pytest.mark.slow
def test_intervals_hold_though_torques_are_read_at_any_time_of_a_drives_sample() -> None:
    hidden = [
        effect("torque_ripple", 2, amplitude_Nm=0.06, order=2.0, phase_rad=0.7),
        effect("elasticity_step", time_s=14.0005, relative_change=0.15),
    ]
    drives = Loops(kp=(1.2, 1.2), lag_s=(0.0, 0.0))
    found = [errors(known(hidden, seed, loops=drives, row_s=0.001), hidden) for seed in range(4)]
    assert np.mean(np.abs(found) < 1.0) >= 0.9
    assert np.max(np.abs(found)) < 2.0


@pytest.mark.slow
def test_a_ripple_faster_than_the_rows_is_found_in_its_size_where_the_line_is_slow() -> None:
    hidden = [effect("torque_ripple", 1, amplitude_Nm=0.08, order=6.0, phase_rad=-0.3)]
    loops = Loops(kp=(0.8, 1.2), ki=(1.2, 0.8), lag_s=(0.002, 0.002))
    found = known(hidden, 5, loops=loops, row_s=0.02, jitter_s=2e-5)
    assert np.max(np.abs(errors(found, hidden))) < 2.0


@pytest.mark.slow
def test_a_ripple_too_fast_for_coarse_rows_is_said_to_be_out_of_sight_and_from_which_order_on(tmp_path: Path) -> None:
    ripple = effect("torque_ripple", 1, amplitude_Nm=0.07, order=2.0, phase_rad=2.98)
    line = Line(hidden=[ripple], row_s=0.02, loops=OTHER_GAINS)
    write_recording(Recording(line.record("production", 5, 30.0).channels), tmp_path / "run.csv")
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(line.model))
    done = hilbench("diagnose", tmp_path / "run.csv", "--model", tmp_path / "model.yaml", "--json")
    found = json.loads(done.stdout)
    assert (found["verdict"], found["effects"]) == ("complete", [])
    (said,) = (blind for blind in found["blind_to"] if (blind["effect"], blind["axis"]) == ("torque_ripple", 1))
    assert said["order"] <= 2.0
    assert "slower" in said["experiment"]
    assert {blind["order"] for blind in found["blind_to"] if "ripple" not in blind["effect"]} <= {None}
