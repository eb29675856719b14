"""A line that no config ships: three rollers, two spans, a load motor at the middle and at the last, one controller."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import yaml
from tests.tiers import slow

from hilbench.apps.monitor.picture import BusPicture
from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.machines.ranges import OPERATOR_OBJECTS, operator_ranges
from hilbench.bench.tasks.emulated_web import web_load_model
from hilbench.canopen.identifiers import SYNC
from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.pdo_set import pdo_set_dbc
from hilbench.results.recording import read_recording
from hilbench.results.recover import recover_run
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.results.trace import TraceReader
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides

EDS = Path(__file__).resolve().parents[2] / "eds"
SERVO, VIRTUAL_IO, LONG_VIRTUAL_IO = (
    str(EDS / f"hilbench_{name}.eds") for name in ("servo", "virtual_io", "virtual_io_long")
)
STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 1.0}},
    {"wait_until": {"condition": "loop2_closed > 0", "timeout_s": 5.0}},
    {"hold": {"until_s": 3.0}},
    {"step": {"path": "tension_control.span2.set_point_N", "to": 95.0}},
    {"wait_until": {"condition": "F2_true_N >= 94", "timeout_s": 5.0}},
    {"hold": {"until_s": 6.0}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 9.5e9}},
    {"hold": {"duration_s": 3.0}},
    {"set": {"path": "load.effects.coulomb_friction.axis3.force_N", "to": 2.0}},
    {"set": {"path": "hardware.effects.viscous_friction.axis3.coefficient_N_s_per_m", "to": 0.5}},
    {"hold": {"duration_s": 0.3}},
]


def config(folder: Path, **changes: Any) -> Path:
    """Machine, drives and all else in a file of its own."""
    drives = {
        name: {"node_id": k, "eds": SERVO, "virtual": {"node_id": 16 + k, "eds": SERVO}}
        for k, name in enumerate(("unwind", "middle", "rewind"), 1)
    }
    data: dict[str, Any] = {
        "name": "three",
        "cycle_time_s": 0.003,
        "bus": {"address": f"embedded:{folder.name}"},
        "drives": drives,
        "load_motors": {
            "pull_b": {"node_id": 6, "eds": SERVO, "shaft": "rewind"},
            "pull_a": {"node_id": 5, "eds": SERVO, "shaft": "middle"},
        },
        "machine": {
            "web": {"youngs_modulus_Pa": 8.7e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": [3.0, 4.0]},
            "rollers": {"radius_m": [0.2, 0.18, 0.2], "inertia_kg_m2": 1.167, "gear_ratio": 5.0},
            "motors": {"inertia_kg_m2": 0.001},
            "web_load": [False, True, True],
            "drives": {
                "velocity_kp_Nm_s_per_rad": 1.5,
                "velocity_ki_Nm_per_rad": 30.0,
                "torque_limit_Nm": 9.0,
                "current_loop_time_constant_s": 0.001,
                "sample_time_s": 0.001,
            },
            "boundary": {"upstream_tension_N": 80.0, "downstream_tension_N": 70.0},
        },
        "twin": {"node": {"node_id": 32, "eds": VIRTUAL_IO}, "estimate": [{"span": 2, "method": "changepoint"}]},
        "controllers": {"rewind_tension": {"span": 2, "set_point_N": 90.0, "bandwidth_rad_per_s": 4.0}},
        "steps": STEPS,
        "criteria": [
            {"name": "E", "metric": "E2_final_error_pct", "max": 1.0, "unit": "%"},
            {"name": "kept", "metric": "tension2_final_error_N", "max": 1.0, "unit": "N"},
            {"name": "mass", "metric": "v2_deviation_m_s", "target": 0.0, "tolerance": 5e-6, "unit": "m/s"},
        ],
    }
    path = folder / "three.yaml"
    path.write_text(yaml.safe_dump(data | changes, sort_keys=False), encoding="utf-8")
    return path


def loaded(folder: Path, *changes: str, **blocks: Any) -> LoadedConfig:
    return load_with_overrides(config(folder, **blocks), changes=changes)


@cache
def whole() -> tuple[LoadedConfig, RunOutcome]:
    """One run for all that is asked of it."""
    given = loaded(Path(mkdtemp()))
    return given, run_experiment(given, given.document.path.parent / "runs", participants=Participants.IN_PROCESS)


def test_it_runs_with_all_its_channels_and_passes_the_criteria_of_its_span() -> None:
    _, outcome = whole()
    assert outcome.result.faults == []
    assert [(row.name, row.verdict) for row in outcome.result.criteria] == [
        ("E", "passed"),
        ("kept", "passed"),
        ("mass", "passed"),
    ]
    found = read_recording(outcome.folder.recording)
    of_spans = {f"{name}_N" for k in (1, 2) for name in (f"F{k}_sim", f"F{k}_true")}
    of_spans |= {name for k in (1, 2) for name in (f"strain{k}_true", f"E{k}_true_Pa")}
    of_span_2 = {"F2_ref_N", "loop2_closed", "E2_sim_Pa", "E2_sd_Pa", "tau3_sim_Nm", "tau3_residual_Nm"}
    of_motors = {f"tau_{name}_{what}" for name in ("pull_a", "pull_b") for what in ("Nm", "cmd_Nm")}
    of_axes = {f"{name}{k}_{unit}" for k in (1, 2, 3) for name, unit in (("x", "m"), ("v", "m_s"), ("tau", "Nm"))}
    assert of_spans | of_span_2 | of_motors | of_axes < set(found.channels)
    assert not {"F1_ref_N", "loop1_closed", "E1_sim_Pa"} & set(found.channels)


def test_the_twin_simulates_every_span_and_the_uncontrolled_one_keeps_the_strain_that_enters() -> None:
    found = {name: np.asarray(values) for name, values in read_recording(whole()[1].folder.recording).channels.items()}
    steady = (found["t_s"] > 8.0) & (found["t_s"] < 8.9)
    for k in (1, 2):
        assert np.mean(np.abs(found[f"F{k}_true_N"] - found[f"F{k}_sim_N"])[steady]) < 0.5
    assert np.mean(found["F2_true_N"][steady]) == pytest.approx(95.0, abs=1.0)
    assert np.mean(found["strain1_true"][steady]) == pytest.approx(float(found["strain_prev"][0]), rel=0.03)


def test_its_load_motors_pull_by_the_difference_of_the_tensions_around_their_roller() -> None:
    found = read_recording(whole()[1].folder.recording)
    steady = (np.asarray(found["t_s"]) > 5.0) & (np.asarray(found["t_s"]) < 5.9)
    F1_N, F2_N = (float(np.mean(np.asarray(found[f"F{k}_true_N"])[steady])) for k in (1, 2))
    for name, radius_m, pull_N in (("pull_a", 0.18, F2_N - F1_N), ("pull_b", 0.2, 70.0 - F2_N)):
        torque_Nm = float(np.mean(np.asarray(found[f"tau_{name}_cmd_Nm"])[steady]))
        assert torque_Nm == pytest.approx(pull_N * radius_m / 5.0, abs=0.02)


def test_its_run_is_recovered_from_the_frames_as_it_was() -> None:
    folder = whole()[1].folder
    before = read_recording(folder.recording)
    kept = folder.recording.rename(folder.recording.with_name("kept.mf4"))
    try:
        recover_run(folder)
        again = read_recording(folder.recording)
    finally:
        kept.replace(folder.recording)
    assert set(again.channels) == set(before.channels)
    for name in before.channels:
        if not name.endswith("_cmd_m_s"):  # in whole units of the drives
            assert np.array_equal(np.asarray(before[name]), np.asarray(again[name])), name


@pytest.mark.slow
def test_report_and_monitor_show_both_spans() -> None:
    given, outcome = whole()
    page = write_report(outcome.folder).read_text(encoding="utf-8")
    assert "Web tension in span 1" in page
    assert "Web tension in span 2" in page
    assert "tension2_final_error_N" in page
    picture = BusPicture(given.config)
    found, frames = read_recording(outcome.folder.recording), list(TraceReader(outcome.folder.trace))
    syncs = [at for at, frame in enumerate(frames) if frame.can_id == SYNC]
    picture.take(frames[: syncs[len(found)]])  # while the bench runs
    shown = {trend.signal: trend.values[-1] for trend in picture.trends}
    assert set(shown) == {"F1_sim_N", "F2_sim_N", "E2_sim_Pa"}
    for name, value in shown.items():
        assert value == pytest.approx(float(np.asarray(found[name])[-1]), rel=0.1)


@pytest.mark.slow
def test_e_is_found_from_the_torques_behind_the_first_span_as_well(tmp_path: Path) -> None:
    given = loaded(tmp_path, "twin.estimate.0.span=1", steps=STEPS[:1] + STEPS[6:8], criteria=[])
    outcome = run_experiment(given, tmp_path / "runs", participants=Participants.IN_PROCESS)
    found = read_recording(outcome.folder.recording)
    assert float(np.asarray(found["E1_sim_Pa"])[-100:].mean()) == pytest.approx(9.5e9, rel=0.01)


@pytest.mark.slow
def test_e_of_one_span_steps_and_is_found_while_the_other_stays(tmp_path: Path) -> None:
    steps = [
        *STEPS[:1],
        {"hold": {"until_s": 4.0}},
        {"step": {"path": "load.web.span2.youngs_modulus_Pa", "to": 9.5e9}},
    ]
    given = loaded(tmp_path, steps=[*steps, STEPS[7]], criteria=[])
    outcome = run_experiment(given, tmp_path / "runs", participants=Participants.IN_PROCESS)
    found = {name: np.asarray(values) for name, values in read_recording(outcome.folder.recording).channels.items()}
    assert set(found["E1_true_Pa"]) == {8.7e9}
    assert (found["E2_true_Pa"][0], found["E2_true_Pa"][-1]) == (8.7e9, 9.5e9)
    assert float(found["E2_sim_Pa"][-100:].mean()) == pytest.approx(9.5e9, rel=0.01)
    at = int(np.argmax(found["E2_true_Pa"] > 9e9))
    assert found["F2_true_N"][at] == pytest.approx(found["F2_true_N"][at - 1] * 9.5 / 8.7, rel=0.01)
    assert found["F1_true_N"][at] == pytest.approx(found["F1_true_N"][at - 1], rel=0.01)


def test_the_emulated_spans_have_what_the_config_says_of_each(tmp_path: Path) -> None:
    hidden = [{"effect": "elasticity_shift", "span": 2, "parameters": {"relative_change": 0.1}}]
    given = loaded(tmp_path, load={"web": {"youngs_modulus_Pa": [8.0e9, 9.0e9]}, "effects": hidden})
    web = web_load_model(given.config)
    outputs = web.machine.outputs()
    assert (outputs["E1_Pa"], outputs["E2_Pa"]) == (8.0e9, pytest.approx(9.9e9))
    web.set("load.effects.elasticity_shift.relative_change", 0.2)
    assert web.value("load.effects.elasticity_shift.span2.relative_change") == 0.2
    web.set("load.effects.elasticity_shift.span1.relative_change", 0.0)
    assert [web.value(f"load.effects.elasticity_shift.span{k}.relative_change") for k in (1, 2)] == [0.0, 0.2]
    outputs = web.machine.outputs()
    assert (outputs["E1_Pa"], outputs["E2_Pa"]) == (8.0e9, pytest.approx(10.8e9))


def test_an_operator_changes_e_of_one_span(tmp_path: Path) -> None:
    ranges = operator_ranges(loaded(tmp_path).config)
    assert {f"load.web.span{k}.youngs_modulus_Pa" for k in (1, 2)} < set(ranges) <= set(OPERATOR_OBJECTS)
    addresses = {path: OPERATOR_OBJECTS[path][0] for path in ranges}
    assert addresses["load.web.youngs_modulus_Pa"] == 3
    assert [addresses[f"load.web.span{k}.youngs_modulus_Pa"] for k in (1, 2)] == [32, 33]


def test_the_pdo_set_follows_from_the_topology_and_must_fit_the_cycle(tmp_path: Path) -> None:
    given = loaded(tmp_path)
    checked = check_experiment(given)
    assert checked.bench.load.fraction < 0.75
    nodes = Nodes(given.config)
    names = [tuple(signal.name for signal in pdo.signals) for pdo in nodes.io.data.sent]
    assert names == [("F2_sim_N", "E2_sim_Pa"), ("E2_sd_Pa", "tau3_residual_Nm"), ("F1_sim_N",)]
    with pytest.raises(UnusableInputError, match=r"the PDO set takes .* in a cycle of 2 ms .*%\), expected"):
        check_experiment(loaded(tmp_path, "cycle_time_s=0.002"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("controllers.rewind_tension.span=3", "a span of 1 to 2, '3' is none"),
        ("twin.estimate.0.span=3", "a span of 1 to 2, '3' is none"),
        ("twin.estimate.0.method=input", "another method than 'input'"),
        ("machine.web_load=[false, true, false]", "axis 3 carries none"),
        ("load_motors.pull_a.shaft=rewind", "one load motor on a shaft"),
        ("steps.3.step.path=tension_control.set_point_N", "a quantity of a web_line"),
        ("steps.3.step.path=tension_control.span1.set_point_N", "a quantity of a web_line"),
        ("steps.8.set.path=load.effects.coulomb_friction.axis1.force_N", "coulomb_friction of axis 3 or 2"),
        ("steps.8.set.path=load.effects.coulomb_friction.axis4.force_N", "coulomb_friction of axis 3 or 2"),
        ("steps.6.step.path=load.web.span3.youngs_modulus_Pa", "a quantity of a web_line"),
        ("steps.8.set.path=load.effects.elasticity_shift.span3.relative_change", "with span 3, expected 1 to 2"),
        ("steps.8.set.path=load.effects.splice.span1.relative_change", "'splice' without an axis"),
        ("load.web.youngs_modulus_Pa=[8e9, 9e9, 8e9]", "'web.youngs_modulus_Pa' as one number or 2"),
        ("load.effects=[{effect: elasticity_shift, span: 3, parameters: {relative_change: 0.1}}]", "with span 3"),
        ("criteria.0.metric=E1_final_error_pct", "none of this machine"),
        ("criteria.0.metric=E_final_error_pct", "none of this machine"),
    ],
)
def test_what_is_not_of_this_line_is_refused_in_one_line(tmp_path: Path, change: str, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said) as refused:
        check_experiment(loaded(tmp_path, change))
    assert "\n" not in str(refused.value)


def test_five_rollers_have_more_tpdos_than_a_node_has_identifiers_and_each_has_a_name(tmp_path: Path) -> None:
    names = [f"axis_{k}" for k in range(1, 6)]
    drives = {
        name: {"node_id": k, "eds": SERVO, "virtual": {"node_id": 16 + k, "eds": SERVO}}
        for k, name in enumerate(names, 1)
    }
    motors = {f"pull{k}": {"node_id": 5 + k, "eds": SERVO, "shaft": names[k]} for k in range(1, 5)}
    five = loaded(
        tmp_path,
        "cycle_time_s=0.006",
        "machine.web.span_length_m=[20.0, 20.0, 20.0, 20.0]",
        "machine.rollers.radius_m=0.2",
        "machine.web_load=[false, true, true, true, true]",
        "twin.estimate.0.span=4",
        drives=drives,
        load_motors=motors,
        criteria=[],
    ).config
    nodes = Nodes(five)
    cob_ids = [pdo.cob_id for pdo in nodes.io.all]
    assert len(set(cob_ids)) == len(cob_ids) == 6
    assert [pdo.name for pdo in nodes.io.tpdos] == [f"TPDO{k}" for k in range(1, 6)]
    text = pdo_set_dbc(five)
    assert text.count("BO_ ") == len({line for line in text.splitlines() if line.startswith("BO_ ")})
    assert "virtual_io_TPDO5" in text


def of_rollers(folder: Path, count: int, cycle_s: float, virtual_io: str) -> LoadedConfig:
    """A line of soft web with an estimate at each span."""
    names = [f"axis_{k}" for k in range(1, count + 1)]
    return loaded(
        folder,
        f"cycle_time_s={cycle_s}",
        "machine.web.youngs_modulus_Pa=1e9",
        f"machine.web.span_length_m={[20.0] * (count - 1)}",
        "machine.rollers.radius_m=0.2",
        f"machine.web_load=[false{', true' * (count - 1)}]",
        f"controllers.rewind_tension.span={count - 1}",
        drives={
            name: {"node_id": k, "eds": SERVO, "virtual": {"node_id": 64 + k, "eds": SERVO}}
            for k, name in enumerate(names, 1)
        },
        load_motors={
            f"pull{k}": {"node_id": 32 + k, "eds": SERVO, "shaft": name} for k, name in enumerate(names[1:], 1)
        },
        twin={
            "node": {"node_id": 120, "eds": virtual_io},
            "estimate": [{"span": k, "method": "changepoint"} for k in range(1, count)],
        },
        criteria=[],
        steps=[
            STEPS[0],
            {"hold": {"until_s": 4.0}},
            {"step": {"path": "load.web.youngs_modulus_Pa", "to": 1.1e9}},
            {"hold": {"duration_s": 4.0}},
        ],
    )


def test_a_line_of_eight_rollers_runs_with_an_estimate_at_each_span(tmp_path: Path) -> None:
    with pytest.raises(
        UnusableInputError, match=r"no TPDO12 .*, expected an EDS file with 15 .*hilbench_virtual_io_long"
    ):
        check_experiment(of_rollers(tmp_path, 8, 0.01, VIRTUAL_IO))
    eight = of_rollers(tmp_path, 8, 0.01, LONG_VIRTUAL_IO)
    outcome = run_experiment(eight, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert outcome.result.faults == []
    for span in range(1, 8):
        error_pct = outcome.result.metrics[f"E{span}_final_error_pct"]
        assert error_pct is not None
        assert abs(error_pct) < 1.0


@pytest.mark.parametrize(("count", "cycle_s"), [(3, 0.016), *slow((3, 0.03), (8, 0.02))])
def test_a_line_of_long_cycles_is_followed_from_its_first_ramp_on(tmp_path: Path, count: int, cycle_s: float) -> None:
    given = of_rollers(tmp_path, count, cycle_s, LONG_VIRTUAL_IO)
    outcome = run_experiment(given, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert outcome.result.faults == []
    assert outcome.result.all_warnings() == []
    errors_pct = [outcome.result.metrics[f"E{span}_final_error_pct"] for span in range(1, count)]
    assert max(abs(error_pct or 0.0) for error_pct in errors_pct) < 0.3


@pytest.mark.parametrize(("count", "cycle_s", "ramp_s"), [(10, 0.03, 0.4), *slow((24, 0.03, 1.0))])
def test_a_whole_web_is_not_broken_where_many_rollers_end_their_ramp_within_a_long_cycle(
    tmp_path: Path, count: int, cycle_s: float, ramp_s: float
) -> None:
    given = of_rollers(tmp_path, count, cycle_s, LONG_VIRTUAL_IO)
    step = type(given.config.steps[0]).model_validate
    steps = [
        step({"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": ramp_s}}),
        step({"hold": {"duration_s": 1.0}}),
    ]
    given = replace(given, config=given.config.model_copy(update={"steps": steps}))
    outcome = run_experiment(given, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert outcome.result.faults == []
    assert not [text for text in outcome.result.all_warnings() if "FF15h" in text]


def test_each_value_of_24_rollers_has_a_place_and_each_pdo_an_identifier_of_its_own(tmp_path: Path) -> None:
    bench = of_rollers(tmp_path, 24, 0.03, LONG_VIRTUAL_IO)
    check_experiment(bench)
    nodes = Nodes(bench.config)
    signals = [(signal.index, signal.sub) for signal in nodes.io.data.published]
    assert len(set(signals)) == len(signals) == 5 * 23
    used = [pdo.cob_id for part in bench.config.parts for pdo in nodes.pdo_maps(part.name)]
    of_twin = [pdo.cob_id for pdo in nodes.io.all]
    assert len(set(of_twin)) == len(of_twin) == 47 + 1
    assert all(used.count(cob_id) == 1 for cob_id in of_twin)


def test_a_load_that_no_motor_emulates_is_noted(tmp_path: Path) -> None:
    notes = check_experiment(loaded(tmp_path, "machine.web_load=true")).notes
    assert any("unwind" in note and "no load motor on its shaft" in note for note in notes)


def test_the_old_key_of_the_twin_is_answered_with_the_new_one(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"'estimate: \[\{method: …\}\]' in place of 'synchronizer:'"):
        loaded(tmp_path, "twin.synchronizer={method: pid}")
