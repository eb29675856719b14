"""A torsional shaft of a machine of other equations is named, with its size; one that is stiff is not."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.diagnosis.axis_rig import Rig
from tests.diagnosis.servo_bench import HIDDEN, diagnosed, hiding
from tests.independent import real
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, Unobservable, diagnose
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.results.recording import Recording, read_recording

STIFF = Rig(stepped=True)
#: The rig's angle is that after a step of its simulation, its torque that of the step: late by as much.
STEP_S = 2e-4


def twisting(share: float, frequency_Hz: float, damping: float) -> Rig:
    """The rig with so much of its inertia behind a shaft; the antiresonance."""
    behind, omega = share * STIFF.inertia_kg_m2, 2.0 * math.pi * frequency_Hz
    return Rig(
        stepped=True,
        behind_kg_m2=behind,
        shaft_Nm_per_rad=behind * omega**2,
        shaft_Nm_s_per_rad=2.0 * damping * omega * behind,
    )


def examined(recording: Recording, inertia_kg_m2: float = 2e-4) -> Diagnosis:
    rotary = Recording(
        {"t_s": recording.time_s, "x1_rad": recording["x1_m"], "tau1_Nm": recording["tau1_Nm"]},
    )
    model = ServoAxisParameters(shaft=ShaftParameters(inertia_kg_m2=inertia_kg_m2))
    return diagnose(rotary, model, "blind")


def names(found: Diagnosis) -> set[str]:
    return {item.effect for item in found.effects}


KNOWN = {"coulomb_friction", "viscous_friction", "torque_offset", "torque_ripple"}


@cache
def stepped(rig: Rig, seed: int = 3) -> Diagnosis:
    (recording,) = rig.recordings(1, seed=seed)
    return examined(recording)


@pytest.mark.parametrize(
    ("share", "frequency_Hz", "damping"), [(0.4, 20.0, 0.05), (0.25, 12.0, 0.1), (0.6, 20.0, 0.03)]
)
@pytest.mark.slow
def test_a_torsional_shaft_is_named_with_its_share_and_frequency(
    share: float, frequency_Hz: float, damping: float
) -> None:
    found = stepped(twisting(share, frequency_Hz, damping))
    (named,) = (item for item in found.effects if item.effect == "resonance")
    assert named.parameters["inertia_share"].value == pytest.approx(share, rel=0.1)
    assert named.parameters["frequency_Hz"].value == pytest.approx(frequency_Hz, rel=0.03)
    assert named.parameters["damping"].value == pytest.approx(damping, rel=0.5)
    others = [item for item in found.effects if item.effect != "resonance"]
    for late in (item for item in others if item.effect == "torque_delay"):
        assert late.parameters["delay_s"].value == pytest.approx(STEP_S, rel=0.25)
    assert {item.effect for item in others} - {"torque_delay"} <= KNOWN
    assert "coulomb_friction" in names(found)


@pytest.mark.parametrize(("share", "frequency_Hz", "damping"), slow((0.6, 20.0, 0.03), (0.5, 6.0, 0.05)))
def test_the_interval_of_a_share_contains_it_where_the_speed_is_stepped(
    share: float, frequency_Hz: float, damping: float
) -> None:
    (named,) = (item for item in stepped(twisting(share, frequency_Hz, damping)).effects if item.effect == "resonance")
    for name, value in {"inertia_share": share, "frequency_Hz": frequency_Hz, "damping": damping}.items():
        low, high = named.parameters[name].ci95
        assert low <= value <= high
        assert high - low < 0.1 * value


@pytest.mark.parametrize(
    ("swing_Hz", "swing_rad_s"),
    [(3.0, 20.0), *slow((1.0, 30.0), (2.0, 30.0), (2.5, 20.0), (3.5, 15.0), (5.0, 10.0), (8.0, 20.0), (10.0, 10.0))],
)
def test_one_steady_sine_names_no_resonance_with_an_interval_that_does_not_hold(
    swing_Hz: float, swing_rad_s: float
) -> None:
    rig = replace(twisting(0.5, 6.0, 0.05), stepped=False, swing=(swing_Hz, swing_rad_s))
    (recording,) = rig.recordings(1, seed=3)
    found = examined(recording)
    named = [item for item in found.effects if item.effect == "resonance"]
    for item in named:
        low, high = item.parameters["inertia_share"].ci95
        assert low <= 0.5 <= high
        low, high = item.parameters["frequency_Hz"].ci95
        assert low <= 6.0 <= high
    if not named:
        assert found.verdict == "unknown"
        assert unseen(found) != []


@pytest.mark.parametrize(("swing_Hz", "swing_rad_s"), [(3.0, 20.0), (2.0, 30.0), (5.0, 10.0)])
@pytest.mark.slow
def test_gaps_make_no_more_lines_of_one_steady_sine(swing_Hz: float, swing_rad_s: float) -> None:
    """Behind a gap the sine goes on with another phase; and each gap is a beginning whose swing fades at the cost of
    rows, of which most have to stay."""
    rig = replace(twisting(0.5, 6.0, 0.05), stepped=False, swing=(swing_Hz, swing_rad_s))
    (whole,) = rig.recordings(1, seed=3)
    kept = np.ones(len(whole.time_s), bool)
    for first in np.random.default_rng(1).integers(1000, 9000, 9):
        kept[first : first + 30] = False
    found = examined(Recording({name: np.asarray(whole[name])[kept] for name in ("t_s", "x1_m", "tau1_Nm")}))
    assert "coulomb_friction" in names(found)
    for item in found.effects:
        if item.effect == "resonance":
            assert within(item.parameters["inertia_share"].ci95, 0.5)
            assert within(item.parameters["frequency_Hz"].ci95, 6.0)


def within(interval: tuple[float, float], truth: float) -> bool:
    return interval[0] <= truth <= interval[1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_no_resonance_is_named_on_a_stiff_shaft(seed: int) -> None:
    assert names(stepped(STIFF, seed)) <= KNOWN


def unseen(found: Diagnosis) -> list[Unobservable]:
    return [blind for blind in found.unobservable if blind.effect == "resonance"]


@pytest.mark.parametrize("rig", [replace(STIFF, stepped=False, ripple_Nm=0.0), *slow(replace(STIFF, stepped=False))])
def test_from_which_frequency_on_smooth_motion_could_not_show_a_resonance_is_said(rig: Rig) -> None:
    (recording,) = rig.recordings(1, seed=3)
    (blind,) = unseen(examined(recording))
    assert blind.axis == 1
    assert blind.frequency_Hz is not None
    assert blind.frequency_Hz < 20.0
    assert blind.smallest_visible is None or blind.smallest_visible > 0.2
    assert "step the speed" in blind.experiment
    assert f"{blind.frequency_Hz:g} Hz" in blind.experiment


@pytest.mark.slow
def test_steps_of_the_speed_could_have_shown_a_resonance_at_every_frequency() -> None:
    assert unseen(stepped(STIFF)) == []


@pytest.mark.slow
def test_a_resonance_that_triangles_do_not_show_is_above_the_frequency_that_is_said() -> None:
    (recording,) = replace(twisting(0.4, 20.0, 0.05), stepped=False).recordings(1, seed=3)
    found = examined(recording)
    assert "resonance" not in names(found)
    (blind,) = unseen(found)
    assert blind.frequency_Hz is not None
    assert blind.frequency_Hz <= 20.0


@pytest.mark.slow
def test_smooth_swings_of_a_bench_show_a_resonance_up_to_the_frequency_that_is_said() -> None:
    found = diagnosed(hiding(HIDDEN))
    assert (found.verdict, found.effects) == ("complete", [])
    (blind,) = unseen(found)
    assert blind.frequency_Hz is not None
    for frequency_Hz in (0.6 * blind.frequency_Hz, 1.6 * blind.frequency_Hz):
        hidden = {"inertia_share": 0.3, "frequency_Hz": frequency_Hz, "damping": 0.05}
        found = diagnosed(hiding(HIDDEN, ("resonance", hidden)))
        assert ("resonance" in names(found)) == (frequency_Hz < blind.frequency_Hz)


@pytest.mark.slow
def test_a_resonance_hidden_in_the_hardware_of_a_bench_is_named_where_the_speed_is_stepped() -> None:
    steps: list[dict[str, dict[str, object]]] = [{"ramp": {"path": "speed_rad_s", "to": 5.0, "duration_s": 0.5}}]
    for speed in (9.0, 5.0, 10.0, 4.0, 9.0, -5.0, -9.0, -4.0, -10.0, -5.0, 6.0, 10.0, 5.0, 9.0, 4.0):
        steps.append({"ramp": {"path": "speed_rad_s", "to": speed, "duration_s": 0.05}})
        steps.append({"hold": {"duration_s": 0.6}})
    hidden = {"inertia_share": 0.3, "frequency_Hz": 25.0, "damping": 0.05}
    found = diagnosed(hiding(HIDDEN, ("resonance", hidden), steps=steps))
    assert found.verdict == "named"
    (named,) = found.effects
    assert named.effect == "resonance"
    for name, value in hidden.items():
        low, high = named.parameters[name].ci95
        assert low <= value <= high
    assert diagnosed(hiding(HIDDEN, steps=steps)).verdict == "complete"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["Jm", "Bm", "Fc"])
def test_no_resonance_is_named_on_a_real_servo_axis(kind: str) -> None:
    recording = read_recording(real(f"servo/{kind}_01"))
    assert "resonance" not in names(examined(recording, 1.6588e-4))
