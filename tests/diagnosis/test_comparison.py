"""`diagnose B --against A`: what changed between two recordings of one machine, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.plant.models import effect, lone_axis, model
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.comparison import Run, compared
from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.errors import UnusableInputError
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.results.recording import Recording, write_recording

PERIOD_S = 0.002
#: What both recordings have: the machine, as far as nobody knows it.
FRICTION = (effect("coulomb_friction", 1, force_N=1.5), effect("viscous_friction", 1, coefficient_N_s_per_m=0.8))
RIPPLE = effect("torque_ripple", 1, amplitude_Nm=0.15, order=7.0, phase_rad=0.4)


def recorded(*effects: dict[str, object], seed: int = 0, count_m: float = 1e-5, seconds: float = 14.0) -> Recording:
    """An axis of 3 kg to and fro in trapezoids of speed, by an encoder with counts; torque with noise."""
    t = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    corner = 2.0 * np.interp(t % 4.0, [0.0, 0.5, 1.5, 2.5, 3.5, 4.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    v = corner * (1.0 + 0.4 * np.sin(0.45 * t))
    x, a = np.cumsum(v) * PERIOD_S, np.gradient(v, PERIOD_S)
    torque = np.empty(len(t))
    required_torque_Nm(lay.pack(lone_axis(*effects)), x, v, a, PERIOD_S, torque)
    torque += 0.05 * np.random.default_rng(seed).standard_normal(len(t))
    return Recording({"t_s": t, "x1_m": np.round(x / count_m) * count_m, "tau1_Nm": torque})


def changed(after: Recording, before: Recording, *, known: bool = False) -> Diagnosis:
    return compared(Run(after, "after.csv"), Run(before, "before.csv"), lone_axis() if known else None)


def places(found: Diagnosis) -> set[tuple[str, int | None]]:
    return {(one.effect, one.axis) for one in found.effects}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_repeats_of_one_motion_differ_in_nothing_whatever_the_machine_has(seed: int) -> None:
    before = recorded(*FRICTION, RIPPLE, seed=10 + seed)
    found = changed(recorded(*FRICTION, RIPPLE, seed=seed), before)
    assert (found.verdict, found.effects) == ("complete", [])


@pytest.mark.parametrize(
    ("what", "parameter", "change"),
    [
        (effect("coulomb_friction", 1, force_N=1.9), "force_N", 0.4),
        (effect("coulomb_friction", 1, force_N=0.4), "force_N", -1.1),
        (effect("viscous_friction", 1, coefficient_N_s_per_m=1.2), "coefficient_N_s_per_m", 0.4),
        (effect("torque_offset", 1, offset_Nm=-0.3), "offset_Nm", -0.3),
    ],
)
def test_one_change_is_named_alone_with_its_size_in_its_interval(
    what: dict[str, object], parameter: str, change: float
) -> None:
    others = [one for one in FRICTION if one["effect"] != what["effect"]]
    found = changed(recorded(*others, RIPPLE, what, seed=1), recorded(*FRICTION, RIPPLE, seed=2))
    assert found.verdict == "named"
    assert places(found) == {(what["effect"], 1)}
    value = found.effects[0].parameters[parameter]
    low, high = value.ci95
    assert low <= change <= high
    assert high - low < 0.3 * abs(change)
    assert value.before is not None
    assert found.gap.after < 0.5 * found.gap.before


def test_an_inertia_that_is_less_is_named_by_its_share_with_a_model_of_it() -> None:
    lighter = effect("inertia_mismatch", 1, relative_change=-0.4)
    found = changed(recorded(*FRICTION, lighter, seed=1), recorded(*FRICTION, seed=2), known=True)
    assert places(found) == {("inertia_mismatch", 1)}
    assert found.effects[0].parameters["relative_change"].value == pytest.approx(-0.4, rel=0.05)


def test_two_changes_at_once_are_both_named() -> None:
    after = recorded(FRICTION[0], effect("torque_offset", 1, offset_Nm=0.4), seed=1)
    found = changed(after, recorded(*FRICTION, seed=2))
    assert places(found) == {("viscous_friction", 1), ("torque_offset", 1)}


def test_a_sensor_that_reads_more_is_one_change_and_not_one_of_each_force() -> None:
    before = recorded(*FRICTION, seed=1)
    after = Recording({**before.channels, "tau1_Nm": 1.2 * recorded(*FRICTION, seed=2)["tau1_Nm"]})
    found = changed(after, before, known=True)
    assert places(found) == {("torque_scale", 1)}
    assert found.effects[0].parameters["relative_change"].value == pytest.approx(1.0 / 1.2 - 1.0, abs=0.01)


@pytest.mark.slow
def test_intervals_of_a_change_hold_over_repeats() -> None:
    inside = []
    for seed in range(6):
        after = recorded(effect("coulomb_friction", 1, force_N=2.1), FRICTION[1], seed=seed)
        found = changed(after, recorded(*FRICTION, seed=100 + seed))
        low, high = found.effects[0].parameters["force_N"].ci95
        inside.append(low <= 0.6 <= high)
    assert sum(inside) >= 5


def test_recordings_that_do_not_belong_together_are_refused_in_one_line() -> None:
    here = recorded(*FRICTION)
    foreign = Recording({**here.channels, "tau1_Nm": 1e4 * here["tau1_Nm"]})
    with pytest.raises(
        UnusableInputError, match=r"torque of axis 1 is .* in before.csv, expected two recordings of one"
    ):
        changed(foreign, here)
    two = Recording({**here.channels, "x2_m": here["x1_m"], "tau2_Nm": here["tau1_Nm"]})
    with pytest.raises(UnusableInputError, match="--model: missing"):
        changed(two, here)
    web = hidden_recording(model(), [], duration_s=8.0)
    less = Recording({name: values for name, values in web.channels.items() if name != "tau1_Nm"})
    with pytest.raises(UnusableInputError, match=r"torque of axes \[2\] where before.csv has \[1, 2\]"):
        compared(Run(less, "after.csv"), Run(web, "before.csv"), model())


def entry(*given: dict[str, object]) -> list[EffectEntry]:
    return [EffectEntry.model_validate(one) for one in given]


@pytest.fixture(scope="module")
def worn() -> Recording:
    """A web machine with dry friction."""
    friction = effect("coulomb_friction", 2, force_N=4.2)
    return hidden_recording(model(), entry(friction), duration_s=24.0, seed=1)


@pytest.mark.slow
def test_of_a_web_machine_only_what_came_is_named_and_what_both_have_is_not(worn: Recording) -> None:
    friction, slip = effect("coulomb_friction", 2, force_N=4.2), effect("web_slip", 2, creep_per_N=3e-6)
    after = hidden_recording(model(), entry(friction, slip), duration_s=24.0, seed=2)
    found = compared(Run(after, "after.csv"), Run(worn, "before.csv"), model())
    assert (found.verdict, [one.effect for one in found.effects]) == ("named", ["web_slip"])
    low, high = found.effects[0].parameters["creep_per_N"].ci95
    assert low <= 3e-6 <= high
    assert {one.effect for one in found.model.effects} == {"coulomb_friction", "web_slip"}


@pytest.mark.slow
def test_of_a_web_machine_what_went_is_named_with_what_it_was(worn: Recording) -> None:
    after = hidden_recording(model(), [], duration_s=24.0, seed=3)
    found = compared(Run(after, "after.csv"), Run(worn, "before.csv"), model())
    assert places(found) == {("coulomb_friction", 2)}
    value = found.effects[0].parameters["force_N"]
    assert value.ci95[0] <= -4.2 <= value.ci95[1]
    assert value.before == pytest.approx(4.2, rel=0.02)


@pytest.mark.slow
def test_two_repeats_of_a_web_machine_differ_in_nothing(worn: Recording) -> None:
    friction = effect("coulomb_friction", 2, force_N=4.2)
    after = hidden_recording(model(), entry(friction), duration_s=24.0, seed=4)
    found = compared(Run(after, "after.csv"), Run(worn, "before.csv"), model())
    assert (found.verdict, found.effects) == ("complete", [])


def test_on_the_command_line_it_prints_the_changes_and_writes_one_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hilbench.apps.diagnose.command import diagnose

    before, after, out = tmp_path / "before.csv", tmp_path / "after.csv", tmp_path / "out"
    write_recording(recorded(*FRICTION, seed=1), before)
    write_recording(recorded(effect("coulomb_friction", 1, force_N=2.4), FRICTION[1], seed=2), after)
    diagnose(after, out=out, json=True, against=before)
    said = json.loads(capsys.readouterr().out)
    assert said["against"] == str(before)
    assert [one["effect"] for one in said["effects"]] == ["coulomb_friction"]
    assert said["effects"][0]["parameters"]["force_N"]["before"] == pytest.approx(1.5, rel=0.1)
    diagnose(after, out=out, against=before)
    shown = capsys.readouterr().out
    assert "named: the effects below changed" in shown
    page = (out / "diagnosis.html").read_text()
    assert "Diagnosis of after.csv against before.csv" in page
    assert "What changed" in page
    with pytest.raises(UnusableInputError, match="expected with --against the recording after"):
        diagnose(Path("bench_configs/hidden_friction.yaml"), json=True, against=before)
