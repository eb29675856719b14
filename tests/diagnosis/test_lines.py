"""Lines of several spans: what is hidden is named at its axis or its span, on recordings of the model's own equations
and on those of a line that shares none with it."""

from __future__ import annotations

from typing import Any

import pytest
from tests.independent_line import effect
from tests.independent_line.spans import LineOfSpans, at_span, of_drives
from tests.plant.models import line_of
from tests.simulated_recordings import hidden_recording

from hilbench.apps.cli.columns import unknown_columns
from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.terms import Place
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

#: Loops of four drives that are not the model's.
UNEQUAL = of_drives((1.2, 0.85, 1.1, 0.9), (0.8, 1.2, 1.0, 1.1), (2e-3, 1e-3, 3e-3, 1e-3))
DURATION_S = 30.0


def of_model(axes: int, *hidden: dict[str, Any]) -> Diagnosis:
    """Of a recording that is simulated with the model's equations."""
    model = line_of(axes)
    entries = [EffectEntry.model_validate(item) for item in hidden]
    return diagnose(hidden_recording(model, entries, duration_s=DURATION_S, seed=2), model, "line")


def of_other_equations(*hidden: Any, **line: Any) -> Diagnosis:
    """Of a recording of a line that is simulated with other equations."""
    machine = LineOfSpans(hidden=hidden, **line)
    recording = Recording(machine.record("identification", 3, DURATION_S).channels)
    return diagnose(recording, ModelParameters.model_validate(machine.model), "stand")


def places(found: Diagnosis) -> list[Place]:
    return [effect.place for effect in found.effects]


@pytest.mark.slow
@pytest.mark.parametrize(
    "item",
    [
        effect("coulomb_friction", 2, force_N=4.0),
        at_span(effect("elasticity_shift", relative_change=0.1), 1),
        at_span(effect("elasticity_step", time_s=17.3, relative_change=0.1), 2),
    ],
    ids=lambda item: item["effect"],
)
def test_an_effect_of_a_line_is_named_at_its_axis_or_span(item: dict[str, Any]) -> None:
    found = of_model(3, item)
    assert found.verdict == "named"
    assert places(found) == [Place(item["effect"], item.get("axis"), item.get("span"))]
    (entry,) = found.model.effects
    assert (entry.axis, entry.section) == (item.get("axis"), item.get("span"))
    for name, value in found.effects[0].parameters.items():
        low, high = value.ci95
        assert low - 0.5 * (high - low) < item["parameters"][name] < high + 0.5 * (high - low)


@pytest.mark.slow
def test_another_web_in_all_spans_is_one_effect_without_a_span() -> None:
    found = of_model(3, effect("elasticity_shift", relative_change=0.1))
    assert found.verdict == "named"
    assert places(found) == [Place("elasticity_shift")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "item",
    [
        effect("coulomb_friction", 3, force_N=4.0),
        at_span(effect("elasticity_shift", relative_change=0.1), 2),
        at_span(effect("web_slip", creep_per_N=2.2e-6), 3),
    ],
    ids=lambda item: item["effect"],
)
def test_on_a_stand_whose_loops_are_not_the_models_as_well(item: dict[str, Any]) -> None:
    found = of_other_equations(item, loops=UNEQUAL, jitter_s=2e-5)
    assert found.verdict == "named"
    assert places(found) == [Place(item["effect"], item.get("axis"), item.get("span"))]


@pytest.mark.slow
def test_a_splice_is_found_with_its_length_and_is_no_step_of_a_span() -> None:
    found = of_other_equations(effect("splice", time_s=15.2, relative_change=0.3, length_m=0.4))
    assert found.verdict == "named"
    assert places(found) == [Place("splice")]
    values = found.effects[0].parameters
    assert values["time_s"].value == pytest.approx(15.2, abs=0.01)
    assert values["relative_change"].value == pytest.approx(0.3, rel=0.15)
    assert values["length_m"].value == pytest.approx(0.4, rel=0.15)


def test_channels_of_a_fourth_axis_are_no_misspelt_ones_of_others() -> None:
    assert unknown_columns(["t_s", "v1_cmd_m_s", "v4_cmd_m_s", "tau4_Nm", "x4_m"]) == []
    assert unknown_columns(["t_s", "tau4_N"]) != []


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_hidden() -> None:
    assert of_other_equations(loops=UNEQUAL).verdict == "complete"
    assert of_model(3).verdict == "complete"
