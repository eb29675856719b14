"""What a drive was told, how it moved and what its torque was tell its loops, whatever hangs on its shaft."""

from __future__ import annotations

from typing import Any

import pytest
from tests.independent_line import Line, Loops
from tests.plant.models import effect, model
from tests.simulated_recordings import hidden_recording
from tests.tiers import slow

from hilbench.diagnosis.loop_check import Loop
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.predictor import choice
from hilbench.diagnosis.web_line.on_measured_motion import LineOnMeasuredMotion
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording


def loops_of(line: Line, duration_s: float = 16.0) -> dict[int, Loop]:
    plain = ModelParameters.model_validate(line.model)
    recording = Recording(line.record("identification", seed=2, duration_s=duration_s).channels)
    return {loop.axis: loop for loop in LineOnMeasuredMotion(plain, measured_from(recording, plain, "stand")).loops()}


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "ki", "lag_s"), [(1.3, 0.8, 0.001), (0.7, 1.3, 0.0), (1.0, 1.0, 0.004)])
def test_gains_and_lag_of_a_drive_are_found(kp: float, ki: float, lag_s: float) -> None:
    line = Line(loops=Loops(kp=(1.0, kp), ki=(1.0, ki), lag_s=(0.001, lag_s)))
    of = loops_of(line, 30.0)
    assert of[1].is_known
    assert not of[2].is_known
    assert of[2].kp_Nm_s_per_rad == pytest.approx(1.5 * kp, abs=5.0 * of[2].kp_deviation)
    assert of[2].ki_Nm_per_rad == pytest.approx(30.0 * ki, abs=5.0 * of[2].ki_deviation)
    assert of[2].lag_s == pytest.approx(lag_s, abs=6e-4)


@pytest.mark.parametrize(
    "item",
    [
        effect("coulomb_friction", 2, force_N=8.0),
        *slow(
            effect("inertia_mismatch", 2, relative_change=0.4),
            effect("torque_offset", 2, offset_Nm=0.1),
            effect("roller_eccentricity", 2, amplitude_m=4e-5, phase_rad=0.0),
            effect("elasticity_shift", relative_change=-0.3),
        ),
    ],
    ids=lambda item: item["effect"],
)
def test_what_hangs_on_the_shaft_is_no_loop(item: dict[str, Any]) -> None:
    assert all(loop.is_known for loop in loops_of(Line(hidden=[item])).values())


def test_a_torque_recorded_without_what_is_fed_forward_does_not_speak_against_the_loops() -> None:
    item = EffectEntry.model_validate(effect("feed_forward", 2, inertia_share=0.3))
    recording = hidden_recording(model(), [item], duration_s=24.0, seed=11)
    found = choice(model(), measured_from(recording, model(), "blind"))
    assert found.basis == "the recorded commands"
    assert [loop.is_fed_forward for loop in found.loops] == [False, True]
