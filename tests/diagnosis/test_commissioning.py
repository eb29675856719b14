"""A commissioning of a simulated stand finds what is hidden in it, within the intervals that it states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.independent_line.line import Line, Loops, effect

from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis.commissioning import Commissioned, commissioned
from hilbench.diagnosis.machines import emulation_of
from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.commissioning import commissioning_plan
from hilbench.runs.config import ExperimentConfig, LoadedConfig, load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
#: Deviations of a 95 % interval; of a dozen values of a stand one may be outside of it, and none by far.
NORMAL_95, FAR = 1.96, 3.3
HIDDEN: dict[tuple[str, int], dict[str, float]] = {
    ("coulomb_friction", 1): {"force_N": 2.0},
    ("coulomb_friction", 2): {"force_N": 4.2},
    ("viscous_friction", 2): {"coefficient_N_s_per_m": 1.1},
    ("torque_offset", 1): {"offset_Nm": -0.04},
    ("torque_offset", 2): {"offset_Nm": 0.06},
    ("inertia_mismatch", 2): {"relative_change": 0.06},
    ("torque_ripple", 2): {"amplitude_Nm": 0.05, "order": 12.0, "phase_rad": 0.7},
    ("roller_eccentricity", 2): {"amplitude_m": 3e-5, "phase_rad": 0.5},
}
HIDDEN_IN_SHAFT: dict[tuple[str, int], dict[str, float]] = {
    ("coulomb_friction", 1): {"torque_Nm": 0.06},
    ("inertia_mismatch", 1): {"relative_change": 0.08},
    ("torque_offset", 1): {"offset_Nm": 0.03},
    ("torque_ripple", 1): {"amplitude_Nm": 0.04, "order": 6.0, "phase_rad": 0.7},
}


def measured(
    folder: Path,
    name: str,
    hidden: dict[tuple[str, int], dict[str, float]],
    seed: int,
    modulus_pct: float = 20.0,
    *,
    forward_only: bool = False,
) -> dict[tuple[str, int | None], Commissioned]:
    """What a commissioning says, by effect and axis, of the stand of a shipped config with this hidden in it."""
    path = CONFIGS / f"{name}.yaml"
    loaded = load_with_overrides(path, seed=seed)
    data: dict[str, Any] = loaded.config.model_dump()
    for (name_of, axis), parameters in hidden.items():
        place = "load" if name_of == "roller_eccentricity" else "hardware"
        data[place]["effects"] = [*data[place]["effects"], {"effect": name_of, "axis": axis, "parameters": parameters}]
    config = ExperimentConfig.model_validate(data)
    plan = commissioning_plan(config, path, forward_only=forward_only)
    config = config.model_copy(update={"steps": plan.steps, "criteria": []})
    outcome = run_experiment(LoadedConfig(config, loaded.document), folder, participants=Participants.IN_PROCESS)
    assert outcome.exit_code == 0, outcome.result.faults
    recording, errors = read_recording(outcome.folder.recording), config.twin.model_errors
    found = commissioned(recording, config.machine, path, emulation_of(config), errors, modulus_pct)
    return {(one.effect, one.axis or one.section): one for one in found}  # type: ignore[misc]


def deviations_off(
    found: dict[tuple[str, int | None], Commissioned], hidden: dict[tuple[str, int], dict[str, float]]
) -> dict[tuple[str, int | None], float]:
    """By how many of its deviations each is off: what is not hidden is 0."""
    truth = {place: next(iter(parameters.values())) for place, parameters in hidden.items()}
    return {
        place: abs(one.value - truth.get(place, 0.0)) / one.deviation  # type: ignore[arg-type]
        for place, one in found.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_what_is_hidden_in_a_web_line_is_found_within_its_intervals(tmp_path: Path, seed: int) -> None:
    found = measured(tmp_path, "web_section_step", HIDDEN, seed)
    off = deviations_off(found, HIDDEN)
    assert max(off.values()) < FAR, off
    assert np.mean([each < NORMAL_95 for each in off.values()]) >= 0.85, off
    # And it is told: each stands out of its deviation, dry friction to a tenth, the offset to a twentieth.
    for place, parameters in HIDDEN.items():
        size = abs(next(iter(parameters.values())))
        known = {"coulomb_friction": 0.1, "torque_offset": 0.05}.get(place[0], 0.6)
        assert found[place].deviation < known * size, found[place]
    assert found["torque_ripple", 2].order == 12.0
    assert "torque_scale" in found["inertia_mismatch", 2].tied_with


@pytest.mark.slow
@pytest.mark.parametrize("seed", [12, 14])
def test_where_nothing_is_hidden_every_interval_contains_zero(tmp_path: Path, seed: int) -> None:
    off = deviations_off(measured(tmp_path, "web_section_step", {}, seed), {})
    assert max(off.values()) < FAR, off
    assert np.mean([each < NORMAL_95 for each in off.values()]) >= 0.85, off


@pytest.mark.slow
def test_a_line_of_two_spans_is_measured_at_each_axis(tmp_path: Path) -> None:
    hidden = {place: HIDDEN[place] for place in (("coulomb_friction", 2), ("viscous_friction", 2))}
    hidden |= {("coulomb_friction", 3): {"force_N": 3.0}}
    found = measured(tmp_path, "line_two_spans", hidden, 1)
    off = deviations_off(found, hidden)
    assert max(off.values()) < FAR, off
    for place, parameters in hidden.items():
        assert found[place].deviation < 0.15 * next(iter(parameters.values())), found[place]


@pytest.mark.slow
def test_forward_only_what_is_tied_stays_as_wide_as_believed(tmp_path: Path) -> None:
    found = measured(tmp_path, "web_section_step", HIDDEN, 4, forward_only=True)
    off = deviations_off(found, HIDDEN)
    assert max(off.values()) < FAR, off


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [{}, HIDDEN_IN_SHAFT], ids=["nothing", "effects"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_servo_axis_is_measured_too(
    tmp_path: Path, hidden: dict[tuple[str, int], dict[str, float]], seed: int
) -> None:
    found = measured(tmp_path, "servo_axis", hidden, seed)
    off = deviations_off(found, hidden)
    assert max(off.values()) < FAR, off
    for place, parameters in hidden.items():
        assert found[place].deviation < 0.75 * next(iter(parameters.values())), found[place]


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [(), tuple(HIDDEN)], ids=["nothing", "effects"])
@pytest.mark.parametrize("loops", [Loops(), Loops(kp=(1.3, 0.8), ki=(0.9, 1.2))], ids=["model", "own"])
def test_its_intervals_hold_on_a_line_of_other_equations_with_a_web_and_drives_of_its_own(
    hidden: tuple[tuple[str, int], ...], loops: Loops
) -> None:
    there = {place: HIDDEN[place] for place in hidden if place[0] not in ("torque_ripple", "roller_eccentricity")}
    line = Line(hidden=[effect(name, axis, **values) for (name, axis), values in there.items()], loops=loops)
    recording, model = Recording(line.record("identification", seed=3).channels), line.model
    parameters = ModelParameters.model_validate(model)
    found = commissioned(recording, parameters, "independent", None, ModelErrorsConfig(), 20.0)
    off = deviations_off({(one.effect, one.axis or one.section): one for one in found}, there)  # type: ignore[misc]
    assert max(off.values()) < NORMAL_95, off
