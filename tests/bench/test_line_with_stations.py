"""Benches whose web runs over more than driven rollers: load motors emulate dancers, accumulators and reels as well."""

from __future__ import annotations

from functools import cache
from math import pi
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import yaml
from tests.bench.whole_runs import Shipped
from tests.tiers import slow

from hilbench.apps.report.machines.web_line import panels_of
from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.web_line_check import start_point, stiffness_reserves
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording, read_recording
from hilbench.results.recover import recover_run
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.topology.signals import shape_of

Channels = dict[str, np.ndarray]
CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "line_with_dancer.yaml"
WINDING = CONFIG.with_name("winding_line.yaml")
SHORTER = ("steps.0.ramp.duration_s=1.0", "steps.1.hold.until_s=2.0", "steps.3.hold.duration_s=1.0", "criteria=[]")
#: At speed for two seconds, and what comes then, but not for long.
STEADY = (
    "steps.1.hold.until_s=5.0",
    "steps.3.hold.duration_s=1.0",
    "steps.4.ramp.duration_s=1.0",
    "criteria=[]",
)
TORN = "steps.2.step={path: load.web.broken, to: 1.0}"
#: The first two steps of the winding line alone.
_ONLY_THESE = ("steps.2.step.to=1.0", "steps.3.hold.duration_s=0.1", "steps.5.hold.duration_s=0.1", "criteria=[]")


def dancer(folder: Path, *changes: str) -> LoadedConfig:
    return load_with_overrides(CONFIG, bus=f"embedded:{folder.name}", changes=changes)


def run(given: LoadedConfig, folder: Path, how: Participants = Participants.IN_PROCESS) -> RunOutcome:
    return run_experiment(given, folder / how.name, participants=how)


@cache
def steady() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What the line with a dancer records, and which rows are of steady speed."""
    folder = Path(mkdtemp())
    found = channels(run(dancer(folder, *STEADY), folder))
    return found, (found["t_s"] > 4.0) & (found["t_s"] < 4.9)


def channels(outcome: RunOutcome) -> dict[str, np.ndarray]:
    found: Recording = read_recording(outcome.folder.recording)
    return {name: np.asarray(values) for name, values in found.channels.items()}


@pytest.mark.slow
def test_the_shipped_dancer_passes_its_criteria(shipped: Shipped) -> None:
    result = shipped("line_with_dancer").result
    assert result.faults == []
    assert {row.verdict for row in result.criteria} == {"passed"}
    assert len(result.criteria) == 3


@pytest.mark.slow
def test_the_dancer_keeps_the_tension_before_the_press_and_its_position_is_recorded(shipped: Shipped) -> None:
    found = channels(shipped("line_with_dancer"))
    steady = (found["t_s"] > 6.0) & (found["t_s"] < 7.9)
    for name in ("F1_true_N", "F2_true_N"):
        assert np.mean(found[name][steady]) == pytest.approx(80.0, abs=0.5)
    assert np.mean(found["F4_true_N"][steady]) == pytest.approx(np.mean(found["F3_true_N"][steady]), abs=1.5)
    assert np.ptp(found["x_dancer_true_m"]) > 1e-4
    assert np.array_equal(found["x_dancer_meas_m"], found["x_dancer_true_m"])


def test_the_twin_follows_the_dancer_and_tells_each_section_once() -> None:
    found, rows = steady()
    assert {name for name in found if name.endswith("_sim_N")} == {"F1_sim_N", "F3_sim_N"}
    for span in (1, 3):
        assert np.mean((found[f"F{span}_sim_N"] - found[f"F{span}_true_N"])[rows]) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("as_shipped", [False, *slow(True)])
def test_E_that_was_right_stays_so_as_the_line_speeds_up_and_its_tension_steps(
    as_shipped: bool, shipped: Shipped
) -> None:
    found = channels(shipped("line_with_dancer")) if as_shipped else steady()[0]
    error = np.convolve(found["E3_sim_Pa"] / found["E3_true_Pa"] - 1.0, np.full(66, 1.0 / 66), "valid")  # over 0.2 s
    assert np.all(np.isfinite(found["E3_sd_Pa"][200:]))
    assert np.max(np.abs(error[167:])) < 0.01


def test_each_load_motor_pulls_by_the_spans_beside_its_roller() -> None:
    found, rows = steady()
    mean = {name: float(np.mean(values[rows])) for name, values in found.items()}
    for motor, pull_N in (
        ("press", mean["F3_true_N"] - mean["F2_true_N"]),
        ("outfeed", 70.0 - mean["F4_true_N"]),
    ):
        assert mean[f"tau_load_{motor}_cmd_Nm"] == pytest.approx(pull_N * 0.2 / 5.0, abs=0.02)


@pytest.mark.slow
def test_processes_record_the_bits_of_one_process_and_frames_recover_them(tmp_path: Path) -> None:
    given = dancer(tmp_path, *SHORTER)
    folder = run(given, tmp_path, Participants.STARTED).folder
    apart, together = read_recording(folder.recording), channels(run(given, tmp_path))
    assert list(apart.channels) == list(together)
    assert [name for name in together if not np.array_equal(np.asarray(apart[name]), together[name], True)] == []
    folder.recording.unlink()
    recover_run(folder)
    again = read_recording(folder.recording)
    commands = {name for name in together if name.endswith("_cmd_m_s")}  # in whole units of the drives
    assert set(again.channels) == set(together)
    different = [name for name in together if not np.array_equal(np.asarray(again[name]), together[name], True)]
    assert set(different) <= commands


@pytest.mark.slow
def test_the_twin_tells_a_web_that_tears_and_where_before_the_dancer_is_at_its_stop(tmp_path: Path) -> None:
    outcome = run(dancer(tmp_path, *SHORTER, TORN), tmp_path)
    assert outcome.exit_code == 3
    (fault,) = outcome.result.faults
    assert "reports a web break in span 1" in str(fault)
    found = channels(outcome)
    assert found["t_s"][-1] < 2.0 + 0.1
    assert np.max(found["x_dancer_true_m"]) < 0.05


@pytest.mark.slow
def test_a_slip_behind_the_guide_roller_is_told_there_and_nothing_before(tmp_path: Path) -> None:
    with Bench(dancer(tmp_path).config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 2.0, 2.0)
        bench.run(4.0)
        bench.set("tension_control.span3.set_point_N", 100.0)
        bench.run(4.0)
        assert not bench.notices
        bench.set("load.effects.web_slip.span4.creep_per_N", 1e-5)
        bench.run(5.0)
        (notice,) = bench.notices
        assert "FF16h: slip in span 3" in notice.text


@pytest.mark.slow
def test_a_web_that_tears_lets_the_dancer_go_to_its_stop_and_ends_the_run(tmp_path: Path) -> None:
    changes = (*SHORTER, TORN, "safety={on_web_break: warn}")
    outcome = run(dancer(tmp_path, *changes), tmp_path)
    assert outcome.exit_code == 3
    (fault,) = outcome.result.faults
    assert "the carriage of dancer is at its stop, 0.2 m: the web has torn, or more comes in" in str(fault)
    assert "in spans 1 to 2" in str(fault)
    # Pushed by 160 N against 400 N·s/m it goes 0.2 m with 0.4 m/s, behind the 10 kg that it has to speed up.
    assert channels(outcome)["t_s"][-1] == pytest.approx(2.0 + 0.2 / 0.4 + 10.0 / 400.0, abs=0.02)


@pytest.mark.slow
def test_an_accumulator_that_runs_empty_ends_the_run(tmp_path: Path) -> None:
    changes = ("machine.stations.1.lower_stop_m=0.5", "steps.1.hold.until_s=3.5", "criteria=[]")
    outcome = run(load_with_overrides(WINDING, bus=f"embedded:{tmp_path.name}", changes=changes), tmp_path)
    (fault,) = outcome.result.faults
    assert "the carriage of store is at its stop, 0.5 m: there is no web left for it in spans 1 to 4" in str(fault)


def reels(folder: Path, **changes: Any) -> LoadedConfig:
    """Unwinder, accumulator of four strands, press, rewinder; a thick web that is soon wound."""
    rolls = {"radius_m": [0.2, 0.1, 0.12], "inertia_kg_m2": [0.5, 0.3, 0.2], "gear_ratio": 5.0}
    machine: dict[str, Any] = {
        "web": {
            "youngs_modulus_Pa": 2e8,
            "width_m": 0.5,
            "thickness_m": 1e-3,
            "span_length_m": [2.0, 1.5, 1.5, 2.0, 3.0],
        },
        "stations": [
            {"type": "unwinder", "core_radius_m": 0.05, "density_kg_m3": 300.0},
            {
                "type": "accumulator",
                "name": "store",
                "strands": 4,
                "radius_m": 0.06,
                "inertia_kg_m2": 0.01,
                "mass_kg": 40.0,
                "force_N": 320.0,
                "viscous_friction_N_s_per_m": 500.0,
                "lower_stop_m": -0.5,
                "upper_stop_m": 0.5,
            },
            {"type": "roller"},
            {"type": "rewinder", "name": "wound", "core_radius_m": 0.05, "density_kg_m3": 300.0},
        ],
        "rollers": rolls,
        "web_load": True,
        "boundary": {"upstream_strain": 80.0 / 1e5},
    }
    given = {
        "load_motors": {
            f"load_{name}": {
                "node_id": 4 + k,
                "eds": str(CONFIG.parents[1] / "eds" / "hilbench_servo.eds"),
                "shaft": name,
            }
            for k, name in enumerate(("infeed", "press", "outfeed"))
        },
        "machine": {**dancer(folder).document.data["machine"], **machine},  # type: ignore[index]
        "load": {"measured": ["store", "unwinder", "wound"]},
        "controllers": {"wound_tension": {"span": 5, "set_point_N": 80.0, "bandwidth_rad_per_s": 2.0}},
        "steps": [{"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 2.0}}, {"hold": {"duration_s": 4.0}}],
        "criteria": [],
    } | changes
    return load_with_overrides(_written(folder, given), bus=f"embedded:{folder.name}")


def _written(folder: Path, given: dict[str, Any]) -> Path:
    path = folder / "reels.yaml"
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8")) | given
    for node in [
        *data["drives"].values(),
        *(each["virtual"] for each in data["drives"].values()),
        data["twin"]["node"],
    ]:
        node["eds"] = str((CONFIG.parent / node["eds"]).resolve())
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_reels_and_an_accumulator_run_and_their_radii_are_recorded(tmp_path: Path) -> None:
    given = reels(tmp_path)
    outcome = run(given, tmp_path)
    assert outcome.result.faults == []
    found = channels(outcome)
    turns = found["x1_m"] / (2.0 * pi * 0.2)
    assert found["r_unwinder_meas_m"] == pytest.approx(0.2 - 1e-3 * turns, abs=1e-5)
    assert np.ptp(found["r_wound_true_m"]) > 0.004
    steady = found["t_s"] > 4.0
    for span in (1, 2, 3, 4):
        assert np.mean(found[f"F{span}_true_N"][steady]) == pytest.approx(80.0, abs=2.0)
    radius_m, tension_N = found["r_unwinder_true_m"][steady], found["F1_true_N"][steady]
    pulled_Nm = found["tau_load_infeed_cmd_Nm"][steady]
    assert np.mean(pulled_Nm) == pytest.approx(np.mean(tension_N * radius_m) / 5.0, rel=0.01)


def test_the_flywheel_of_a_reel_is_that_of_the_web_that_is_on_it(tmp_path: Path) -> None:
    given = reels(tmp_path).config
    wound_kg_m2 = 0.5 * pi * 300.0 * 0.5 * (0.2**4 - 0.05**4)
    flywheel = given.rig_parameters().flywheel_inertia_kg_m2
    assert isinstance(flywheel, list)
    assert flywheel[0] == pytest.approx((0.5 + wound_kg_m2) / 25.0 - 0.0005)


def test_the_check_tells_how_stiff_a_web_each_load_motor_can_emulate(tmp_path: Path) -> None:
    checked = check_experiment(dancer(tmp_path))
    assert set(checked.stiffness_reserves) == {"load_press", "load_outfeed"}
    assert checked.stiffness_reserve == min(checked.stiffness_reserves.values()) > 1.0
    with pytest.raises(UnusableInputError, match=r"the load motor of axis 3 .* stable up to \d+ % of it"):
        check_experiment(dancer(tmp_path, "machine.web.span_length_m=[1.5, 2.5, 2.0, 0.5]"))


def test_the_shortest_span_beside_a_roller_decides_about_its_load_motor(tmp_path: Path) -> None:
    found = {}
    for length_m in (1.0, 2.0):
        given = dancer(tmp_path, f"machine.web.span_length_m=[{length_m}, 2.5, 2.0, 3.0]").config
        found[length_m] = stiffness_reserves(given, start_point(given))
    assert found[1.0] == found[2.0], "what is before the dancer is held by it"


@pytest.mark.slow
def test_a_reel_change_at_full_speed_leaves_all_tensions_within_3_percent(shipped: Shipped) -> None:
    result, found = shipped("winding_line").result, channels(shipped("winding_line"))
    assert result.faults == []
    assert [row.verdict for row in result.criteria] == ["passed"] * 3
    running = (found["t_s"] > 5.0) & (found["t_s"] < 31.5)
    for span in range(1, 6):
        assert np.max(np.abs(found[f"F{span}_true_N"][running] / 80.0 - 1.0)) < 0.03
    assert np.min(found["v1_m_s"][running]) == pytest.approx(0.0, abs=1e-3)
    # What the accumulator gave, four strands of its way, is what did not come from the unwinder meanwhile.
    travel_m = found["x_store_true_m"]
    assert np.min(travel_m) < travel_m[0] - 1.0
    end = np.flatnonzero(running)[-1]
    assert travel_m[end] == pytest.approx(0.65, abs=0.03)
    assert found["x_store_ref_m"][end] == 0.65


@pytest.mark.slow
def test_the_web_on_a_reel_has_the_speed_of_the_line_whatever_its_radius(shipped: Shipped) -> None:
    found = channels(shipped("winding_line"))
    steady = (found["t_s"] > 4.5) & (found["t_s"] < 6.0)
    late = (found["t_s"] > 29.0) & (found["t_s"] < 31.0)
    turns_faster = found["r_rewinder_true_m"] / 0.12
    assert np.mean(turns_faster[late]) > 1.2
    for part in (steady, late):
        assert np.mean((found["v3_m_s"] * turns_faster)[part]) == pytest.approx(1.2, rel=2e-3)
        assert np.mean(found["line_speed_cmd_m_s"][part]) == pytest.approx(1.2)
        assert np.mean(found["v2_m_s"][part]) == pytest.approx(1.2, rel=2e-3)


def test_the_report_shows_where_carriages_are_and_how_large_reels_are(tmp_path: Path) -> None:
    changes = ("steps.0.ramp={path: line_speed_m_s, to: 0.2, duration_s: 0.2}", "steps.1.hold.until_s=0.3")
    ended = ("steps.6.ramp.duration_s=0.2", *_ONLY_THESE)
    given = load_with_overrides(WINDING, bus=f"embedded:{tmp_path.name}", changes=(*changes, *ended))
    shape = shape_of(channels(run(given, tmp_path)))
    assert (shape.carriages, shape.reels) == (("store",), ("unwinder", "rewinder"))
    titles = [picture.title for picture in panels_of(shape).pictures]
    assert titles[-2:] == ["Positions of the carriages", "Radii of the reels"]
    assert [title for title in titles if title.startswith("Torque")] == ["Torque of axis 3"]


@pytest.mark.slow
def test_frames_recover_a_line_with_reels(tmp_path: Path) -> None:
    changes = ("steps.0.ramp.duration_s=1.0", "steps.1.hold.until_s=1.5", *_ONLY_THESE)
    given = load_with_overrides(WINDING, bus=f"embedded:{tmp_path.name}", changes=changes)
    outcome = run(given, tmp_path)
    whole = channels(outcome)
    outcome.folder.recording.unlink()
    recover_run(outcome.folder)
    again = read_recording(outcome.folder.recording)
    assert set(again.channels) == set(whole)
    different = [name for name in whole if not np.array_equal(np.asarray(again[name]), whole[name], True)]
    assert all(name.endswith("_cmd_m_s") for name in different)  # in whole units of the drives


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "controllers.store_position.station=shop",
            r"the position of a dancer or accumulator \(store\), 'shop' is none",
        ),
        ("load.measured=[store]", r"'load: \{measured: \[rewinder\]\}' for the loop of the tension beside it"),
        ("load.measured=[unwinder]", r"'load: \{measured: \[store\]\}' for the loop"),
        ("controllers.store_position.set_point_m=0.9", "between the stops of 'store', -0.8 to 0.8 m, not 0.9 m"),
        ("controllers.winding_tension.span=2", "one controller between two driven rollers"),
        ("controllers={store: {kind: position, station: store}}", "at least one of a tension"),
        ("controllers.store_position.kind=speed", "kind: tension, position, reel or compensate"),
        ("steps.2.step.path=position_control.shop.feed", "a quantity of a web_line"),
        ("steps.2.step.to=0.5", "expected: 0 or 1"),
    ],
)
def test_a_loop_of_a_position_that_a_line_can_not_have_is_refused_in_one_line(
    tmp_path: Path, change: str, said: str
) -> None:
    with pytest.raises(UnusableInputError, match=said) as refused:
        check_experiment(load_with_overrides(WINDING, bus=f"embedded:{tmp_path.name}", changes=(change,)))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("load.measured=[nobody]", "'load.measured' of dancers, accumulators, reels and idlers"),
        ("twin.prediction={}", "driven rollers alone"),
        ("controllers.outfeed_tension.probing=on", "driven rollers alone"),
        ("controllers.outfeed_tension.span=5", "a span of 1 to 4"),
        ("controllers.press_tension={span: 4, set_point_N: 90.0}", "one controller between two driven rollers"),
        ("machine.stations.1.name=press", "a station and another part are both named press"),
        (
            "machine.stations.0={type: idler, name: first, radius_m: 0.1, inertia_kg_m2: 0.01}; "
            "machine.stations.3={type: roller}",
            "driven roller or reel",
        ),
    ],
)
def test_what_such_a_bench_can_not_have_is_refused_in_one_line(tmp_path: Path, change: str, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said) as refused:
        check_experiment(dancer(tmp_path, *change.split("; ")))
    assert "\n" not in str(refused.value)
