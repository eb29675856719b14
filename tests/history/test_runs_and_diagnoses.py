"""What runs and diagnoses find enters the history of their stand, which the command shows and can make again."""

from __future__ import annotations

import json
import re
from math import hypot
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
import yaml
from tests.cli import in_process
from tests.simulated_recordings import hidden_recording

from hilbench.apps.history.store import History, Row
from hilbench.plant.parameters import EffectEntry
from hilbench.results.recording import read_recording, write_recording
from hilbench.runs.config import load

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
VISCOUS = "axis2.viscous_friction.coefficient_N_s_per_m"
STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 0.6}},
    {"hold": {"duration_s": 1.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.6}},
]


def hilbench(*words: str) -> str:
    done = in_process.hilbench(*words)
    assert done.returncode == 0, done
    return done.stdout + done.stderr


def bench(folder: Path, name: str = "line", **more: object) -> Path:
    path = folder / f"{name}.yaml"
    own = {"include": str(CONFIG), "name": name, "steps": STEPS, "criteria": []}
    path.write_text(yaml.safe_dump(own | more))
    return path


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run in it, and what it has left."""
    folder = tmp_path_factory.mktemp("stand")
    path = bench(folder, stand="pilot line", wear_limits={"web.youngs_modulus_Pa": 9e9, "axis2.creep": 1.0})
    hilbench("run", str(path), "--in-process", "--no-report", "--out", str(folder / "runs"))
    return folder


def test_a_run_adds_what_its_twin_estimated_under_the_name_of_the_stand(stand: Path) -> None:
    history = History(stand / "history.sqlite")
    assert history.stands() == ["pilot line"]
    row = named(history)["web.youngs_modulus_Pa"]
    recording = read_recording(next(stand.glob("runs/*/recording.mf4")))
    assert (row.source, row.quantity.name, row.quantity.unit) == ("twin", "web.youngs_modulus_Pa", "Pa")
    assert row.quantity.value in recording["E_sim_Pa"]
    assert row.quantity.value == pytest.approx(8.7e9, rel=0.02)
    assert row.quantity.sd in recording["E_sd_Pa"]
    assert abs(row.time_s - next(stand.glob("runs/*/result.json")).stat().st_mtime) < 600.0


def named(history: History) -> dict[str, Row]:
    """What the twin of the one run has found, by its name."""
    return {row.quantity.name: row for row in history.rows("pilot line")}


def test_a_run_adds_errors_of_the_model_that_its_twin_could_tell(stand: Path) -> None:
    result = json.loads(next(stand.glob("runs/*/result.json")).read_text())
    told = {
        f"{each['place']}.{each['effect']}.{each['parameter']}": each
        for each in result["estimated"]
        if each["separable"]
    }
    rows = named(History(stand / "history.sqlite"))
    friction, row = told[VISCOUS], rows[VISCOUS]
    assert row.quantity.value == friction["value"]
    assert row.quantity.sd == pytest.approx((friction["ci95"][1] - friction["ci95"][0]) / 3.92, rel=1e-3)


def test_the_inertia_enters_as_the_torque_shows_it_with_what_does_the_same(stand: Path) -> None:
    result = json.loads(next(stand.glob("runs/*/result.json")).read_text())
    (told,) = [each for each in result["estimated"] if each["effect"] == "inertia_mismatch"]
    row = named(History(stand / "history.sqlite"))["axis2.inertia_mismatch.relative_change"]
    assert (row.quantity.value, row.quantity.unit) == (told["value"], "1")
    assert told["ci95"][0] < 0.0 < told["ci95"][1]
    assert row.quantity.tied_with == "torque_scale"
    assert not [each for each in result["estimated"] if each["effect"] == "torque_scale"]


@pytest.mark.slow
def test_friction_that_is_there_is_in_the_history_of_a_plain_run(tmp_path: Path) -> None:
    friction = {"path": "load.effects.viscous_friction.axis2.coefficient_N_s_per_m", "to": 3.0}
    steps = [
        {"hold": {"duration_s": 0.2}},
        {"step": friction},
        {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 2.0}},
        {"hold": {"duration_s": 3.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 1.0}},
        {"hold": {"duration_s": 3.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 1.0}},
    ]
    path = bench(tmp_path, stand="pilot line", steps=steps)
    hilbench("run", str(path), "--in-process", "--out", str(tmp_path / "runs"))
    found = named(History(tmp_path / "history.sqlite"))[VISCOUS].quantity
    assert abs(found.value - 3.0) < 1.96 * found.sd
    # What friction may have changed by itself within the run is in it: 15 % of what was found.
    assert found.sd < hypot(0.5, 0.15 * found.value)
    page = next(tmp_path.glob("runs/*/report.html")).read_text(encoding="utf-8")
    assert "Estimated model errors" in page
    assert "coefficient_N_s_per_m" in page


def test_what_no_twin_has_found_does_not_enter(tmp_path: Path) -> None:
    standstill = bench(tmp_path, steps=[{"hold": {"duration_s": 0.2}}])
    hilbench("run", str(standstill), "--in-process", "--no-report", "--out", str(tmp_path / "runs"))
    assert not (tmp_path / "history.sqlite").exists()


def test_the_history_of_runs_elsewhere_is_that_beside_them(
    stand: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    History(tmp_path / "history.sqlite").add()
    shown = json.loads(hilbench("history", "--runs", str(stand / "runs"), "--json"))
    assert shown["file"] == str(stand / "history.sqlite")
    assert [each["stand"] for each in shown["stands"]] == ["pilot line"]


def test_the_history_is_shown_with_the_stand_and_the_limits_of_a_config(stand: Path) -> None:
    file = ("--file", str(stand / "history.sqlite"))
    shown = json.loads(hilbench("history", str(stand / "line.yaml"), "--json", *file))
    assert [each["stand"] for each in shown["stands"]] == ["pilot line"]
    quantities = {each["quantity"]: each for each in shown["stands"][0]["quantities"]}
    quantity = quantities["web.youngs_modulus_Pa"]
    assert (quantity["quantity"], quantity["runs"], quantity["trend"]) == ("web.youngs_modulus_Pa", 1, None)
    assert quantity["limit"] == {"value": 9e9, "reached": None}
    assert shown["notes"] == ["wear_limits: no run has found 'axis2.creep' yet"]
    assert "web.youngs_modulus_Pa" in hilbench("history", *file)


def test_a_config_says_where_its_history_lies(tmp_path: Path) -> None:
    path = bench(tmp_path, history="kept/all.sqlite")
    assert load(path)[0].history == tmp_path / "kept" / "all.sqlite"
    hilbench("run", str(path), "--in-process", "--no-report", "--out", str(tmp_path / "runs"))
    assert History(tmp_path / "kept" / "all.sqlite").stands() == ["line"]
    assert not (tmp_path / "history.sqlite").exists()


@pytest.mark.slow
def test_a_diagnosis_of_a_run_adds_its_effects_and_stays_in_the_run_folder(tmp_path: Path) -> None:
    config, _ = load(CONFIG)
    run = tmp_path / "runs" / "line-20260304-120000"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text(bench(tmp_path).read_text())
    friction = EffectEntry(effect="coulomb_friction", axis=2, parameters={"force_N": 4.2})
    write_recording(hidden_recording(config.web_line, [friction], duration_s=12.0), run / "recording.mf4")
    found = json.loads(hilbench("diagnose", str(run), "--json"))
    assert json.loads((run / "diagnosis.json").read_text()) == found
    rows = {row.quantity.name: row for row in History(tmp_path / "history.sqlite").rows("line")}
    low, high = found["effects"][0]["parameters"]["force_N"]["ci95"]
    kept = rows["axis2.coulomb_friction.force_N"]
    assert kept.source == "diagnosis"
    assert kept.quantity.value == found["effects"][0]["parameters"]["force_N"]["value"]
    assert kept.quantity.tied_with == ", ".join(found["effects"][0]["tied_with"])
    assert 2 * 1.959964 * kept.quantity.sd == pytest.approx(high - low)


def test_the_history_can_be_made_again_from_the_run_folders(stand: Path, tmp_path: Path) -> None:
    before, again = stand / "history.sqlite", tmp_path / "again.sqlite"
    runs = Path(copytree(stand / "runs", tmp_path / "runs"))
    broken = runs / "broken"
    broken.mkdir()
    (broken / "config.yaml").write_text("name: [")
    (broken / "recording.mf4").write_text("")
    words = ("--rebuild", "--runs", str(runs), "--file", str(again), "--json")
    made = json.loads(hilbench("history", *words))
    assert len(made["notes"]) == 1
    assert "broken/config.yaml" in made["notes"][0]
    assert History(again).rows("pilot line") == History(before).rows("pilot line")


def test_a_page_shows_each_quantity(stand: Path, tmp_path: Path) -> None:
    page = tmp_path / "history.html"
    hilbench("history", "--file", str(stand / "history.sqlite"), "--html", str(page))
    text = page.read_text()
    assert "pilot line" in text
    assert text.count("<figure ") == len(named(History(stand / "history.sqlite")))
    for picture in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        dates = re.findall(r"\d{4}-\d\d-\d\d", picture)
        assert 0 < len(dates) == len(set(dates))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--limit", "web.youngs_modulus_Pa"), "--limit: 'web.youngs_modulus_Pa', expected QUANTITY=VALUE"),
        (("--limit", "web.youngs_modulus=9e9"), "did you mean 'web.youngs_modulus_Pa'?"),
        (("--stand", "pilot"), "knows no stand 'pilot', expected one of: pilot line"),
        (("--file", "none.sqlite"), "none.sqlite: no such file, expected the history of a stand"),
        (("--rebuild", "--runs", "none"), "none: no such folder, expected that in which the run folders are"),
    ],
)
def test_what_can_not_be_used_is_told(
    stand: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(stand)
    done = in_process.hilbench("history", *words)
    assert done.returncode == 2
    assert said in done.stderr


def test_a_run_whose_history_can_not_be_written_is_no_worse_for_it(tmp_path: Path) -> None:
    (tmp_path / "history.sqlite").write_text("no data base\n" * 100)
    words = ("run", str(bench(tmp_path)), "--in-process", "--no-report", "--out", str(tmp_path / "runs"))
    assert "not in the history" in hilbench(*words)
    assert np.all(np.isfinite(read_recording(next(tmp_path.glob("runs/*/recording.mf4")))["E_sim_Pa"]))
