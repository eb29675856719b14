"""The twin of a run begins with the newest commissioning of its stand, and says how old that is."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import yaml
from tests.cli import in_process

from hilbench.apps.history.store import COMMISSIONING, Entry, History, Quantity
from hilbench.apps.history.web_line_priors import with_commissioned
from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.commissioned import commissioned_text
from hilbench.runs.config import LoadedConfig, load, load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
NOW = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)
FRICTION = Quantity("axis2.coulomb_friction.force_N", 4.2, 0.1, "N")
MEASURED = (
    FRICTION,
    Quantity("axis2.torque_offset.offset_Nm", 0.06, 0.002, "N·m"),
    Quantity("axis2.inertia_mismatch.relative_change", 0.04, 0.03, "1", "torque_scale"),
    Quantity("web.web_slip.creep_per_N", 5e-8, 9e-8, "1/N"),
    Quantity("axis2.torque_ripple.amplitude_Nm", 0.05, 0.002, "N·m"),
)


def entry(run: str, source: str, days_ago: float, *quantities: Quantity) -> Entry:
    return Entry("pilot", run, source, NOW - timedelta(days=days_ago), Path("runs") / run, quantities)


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """The folder of the runs of a stand that was commissioned twice, and diagnosed since."""
    History(tmp_path / "history.sqlite").add(
        entry("old", COMMISSIONING, 9.0, Quantity("axis2.coulomb_friction.force_N", 1.0, 0.1, "N")),
        entry("new", COMMISSIONING, 3.0, *MEASURED),
        entry("later", "diagnosis", 1.0, Quantity("axis2.coulomb_friction.force_N", 7.0, 0.1, "N")),
    )
    return tmp_path / "runs"


def loaded(runs: Path, *changes: str) -> LoadedConfig:
    return with_commissioned(load_with_overrides(CONFIG, changes=["stand=pilot", *changes]), runs, pytest.fail)


def test_a_run_of_the_stand_begins_with_the_newest_commissioning(runs: Path) -> None:
    priors = {prior.quantity: prior for prior in loaded(runs).config.twin.priors}
    assert set(priors) == {"dry_friction_N", "torque_offset_Nm", "inertia_share", "creep_per_N"}
    friction = priors["dry_friction_N"]
    assert (friction.axis, friction.value, friction.deviation) == (2, 4.2, 0.1)
    assert friction.measured_at == NOW - timedelta(days=3)
    assert priors["creep_per_N"].axis == 2  # of the roller behind the span


def test_of_what_the_model_has_already_only_the_rest_is_lacking(runs: Path) -> None:
    known = "machine.effects=[{effect: coulomb_friction, axis: 2, parameters: {force_N: 4.0}}]"
    priors = {prior.quantity: prior for prior in loaded(runs, known).config.twin.priors}
    assert priors["dry_friction_N"].value == pytest.approx(0.2)
    assert priors["torque_offset_Nm"].value == 0.06


@pytest.mark.parametrize("change", ["twin.commissioned=ignore", "stand=another"])
def test_it_begins_without_where_that_is_not_wanted_or_of_another_stand(runs: Path, change: str) -> None:
    assert loaded(runs, change).config.twin.priors == []


def test_priors_of_the_config_win(runs: Path) -> None:
    own = "twin.priors=[{quantity: dry_friction_N, axis: 2, value: 1.0, deviation: 0.5}]"
    (prior,) = loaded(runs, own).config.twin.priors
    assert (prior.value, prior.measured_at) == (1.0, None)


def test_what_it_says_names_age_values_and_half_of_the_interval(runs: Path) -> None:
    text = commissioned_text(loaded(runs).config.twin.priors, NOW)
    assert text is not None
    assert text.startswith("commissioned 3 days ago: dry friction of axis 2 4.20 ± 0.20 N, ")
    assert "inertia of axis 2 4.0 ± 5.9 %" in text
    assert "torque offset of axis 2 0.0600 ± 0.0039 N·m" in text
    assert "\n" not in text
    assert commissioned_text([], NOW) is None


@pytest.mark.parametrize(
    ("age", "said"), [(30.0, "less than a minute ago"), (60.0, "1 minute ago"), (7300.0, "2 hours ago")]
)
def test_it_says_how_old_in_the_largest_whole_unit(runs: Path, age: float, said: str) -> None:
    measured = NOW - timedelta(days=3)
    text = commissioned_text(loaded(runs).config.twin.priors, measured + timedelta(seconds=age))
    assert text is not None
    assert text.startswith(f"commissioned {said}: ")


def test_a_run_says_it_at_the_start_in_its_result_and_in_its_report(runs: Path) -> None:
    path = runs.parent / "short.yaml"
    steps = [{"ramp": {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.3}}, {"hold": {"duration_s": 0.2}}]
    path.write_text(yaml.safe_dump({"include": str(CONFIG), "stand": "pilot", "steps": steps, "criteria": []}))
    done = in_process.hilbench("run", str(path), "--in-process", "--out", str(runs))
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("commissioned ")]
    assert "dry friction of axis 2 4.20 ± 0.20 N" in line
    (folder,) = runs.iterdir()
    assert json.loads((folder / "result.json").read_text())["commissioned"].split(": ")[1] == line.split(": ")[1]
    assert "dry friction of axis 2 4.20 ± 0.20 N" in (folder / "report.html").read_text()
    assert load(folder / "config.yaml")[0].twin.priors == loaded(runs).config.twin.priors


def test_a_script_begins_with_it_as_well(runs: Path) -> None:
    said: list[str] = []
    bench = Bench(CONFIG, changes=["stand=pilot"], out=runs, participants=Participants.IN_PROCESS, announce=said.append)
    assert [prior.value for prior in bench.config.twin.priors if prior.quantity == "dry_friction_N"] == [4.2]
    assert any("dry friction of axis 2" in line for line in said)


def test_a_config_without_a_name_of_the_stand_is_refused_in_one_line(tmp_path: Path) -> None:
    done = in_process.hilbench("commission", str(CONFIG), "--in-process", "--out", str(tmp_path))
    assert done.returncode == 2
    assert "no 'stand', expected the name" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_commissioned_a_stand_has_it_in_its_history_which_can_be_made_again(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    hidden = {"effects": [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 4.2}}]}
    path = tmp_path / "stand.yaml"
    path.write_text(yaml.safe_dump({"include": str(CONFIG), "stand": "pilot", "hardware": hidden}))
    done = in_process.hilbench("commission", str(path), "--in-process", "--json", "--out", str(runs))
    assert done.returncode == 0, done
    told = {each["name"]: each for each in json.loads(done.stdout)["quantities"]}
    friction = told["axis2.coulomb_friction.force_N"]
    assert abs(friction["value"] - 4.2) < 1.96 * friction["sd"] < 0.5
    rows = [row for row in History(tmp_path / "history.sqlite").rows("pilot") if row.source == COMMISSIONING]
    assert {row.quantity.name: row.quantity.value for row in rows} == {
        name: each["value"] for name, each in told.items()
    }
    in_process.hilbench("history", "--rebuild", "--runs", str(runs), "--file", str(tmp_path / "again.sqlite"))
    again = [row for row in History(tmp_path / "again.sqlite").rows("pilot") if row.source == COMMISSIONING]
    assert [row.quantity for row in again] == [row.quantity for row in rows]
    assert any(prior.quantity == "dry_friction_N" and prior.axis == 2 for prior in loaded(runs).config.twin.priors)
