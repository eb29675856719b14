"""The report: complete, self-contained, escaped, and made from whatever a run has recorded."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.report.parsed import EVIL, ParsedPage, parsed
from tests.runs.shafts import recorded_shaft

from hilbench.apps.report import page as report_page
from hilbench.apps.report.chart import BLUE, Band, Chart, Curve, Mark
from hilbench.apps.report.html import write_report
from hilbench.apps.report.plots import Picture, drawn
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording, write_recording
from hilbench.results.result import Environment, Fault, Result, Timing, Warned, jitter
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import CriterionResult
from hilbench.runs.events import Changed, Event
from hilbench.runs.metrics import evaluate_metrics, judge
from hilbench.topology.signals import signals_of, smallest_shapes

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
E0, E1 = 8.7e9, 10.5e9


def recording(samples: int = 8000) -> Recording:
    """A plausible run: ramp up, E steps in the middle, the estimate follows, ramp down."""
    random = np.random.default_rng(0)
    t = np.linspace(0, 40, samples)
    v2 = 3 * np.clip(np.minimum(t / 4, (40 - t) / 4), 0, 1)
    true = np.where(t < 10, E0, E1)
    estimate = np.where(t < 10, E0, E1 - (E1 - E0) * np.exp(-(t - 10) / 4))
    strain_prev, strain = np.full(samples, 80 / (E0 * 3.25e-5)), 80 / (estimate * 3.25e-5)
    tension = true * 3.25e-5 * strain
    known: dict[str, Any] = {
        "t_s": t,
        "v1_cmd_m_s": v2,
        "v2_cmd_m_s": v2,
        "x1_m": np.cumsum(v2 * (1 + strain_prev) / (1 + strain)) * (t[1] - t[0]),
        "x2_m": np.cumsum(v2) * (t[1] - t[0]),
        "strain_prev": strain_prev,
        "strain_true": strain,
        "tau2_Nm": (tension - 70) * 0.04 + random.normal(0, 0.05, samples),
        "tau2_sim_Nm": np.full(samples, 0.4),
        "E_true_Pa": true,
        "E_sim_Pa": estimate,
        "E_sd_Pa": np.full(samples, 3e7),
        "F_true_N": tension,
        "F_sim_N": 80 + random.normal(0, 0.1, samples),
        "F_ref_N": np.full(samples, 80.0),
    }
    channels = {
        signal.name: known.get(signal.name, np.zeros(samples))
        for signal in signals_of("web_line", smallest_shapes()["web_line"])
    }
    return Recording(channels, datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC))


def run_folder(base: Path, recorded: Recording, **result: Any) -> RunFolder:
    folder = RunFolder.create(base, "step", datetime(2026, 3, 4, 5, 6, 7))
    folder.config.write_text(f"seed: 7\nname: {EVIL}\n")
    write_recording(recorded, folder.recording)
    percentiles, histogram = jitter(np.random.default_rng(0).exponential(50, 1000))
    timing = Timing(
        pace="realtime",
        cycle_us=2000,
        cycles=8000,
        missed=3,
        jitter_us=percentiles,
        realtime_factor=1.0,
        bus_load_pct=61.4,
        jitter_histogram=histogram,
    )
    defaults: dict[str, Any] = {
        "criteria": [
            CriterionResult(name=EVIL, value=12.5, limit="≤ 25", unit="s", passed=True),
            CriterionResult(name="noise", value=None, limit="≤ 1", unit="%", passed=False, reason=f"none {EVIL}"),
        ],
        "metrics": evaluate_metrics(recorded.channels),
        "judged": judge(recorded.channels),
        "timing": timing,
        "faults": [Fault(time_s=12.5, source=EVIL, text=EVIL)],
        "environment": Environment.here(seed=4711),
    }
    Result.of(**{**defaults, **result}).write(folder.result)
    return folder


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(run_folder(tmp_path_factory.mktemp("runs"), recording()))


def test_nothing_comes_from_outside_and_nothing_else_runs(report: Path) -> None:
    page, source = parsed(report), report.read_text()
    assert not {"link", "img", "iframe", "object"} & set(page.tags)
    assert all(address.startswith("#") for address in page.addresses)
    assert "@import" not in source
    assert re.findall(r"url\((?!#)", re.sub(r"<script.*?</script>", "", source, flags=re.DOTALL)) == []
    data, *code = page.scripts
    json.loads(data)
    assert tuple(code) == report_page.scripts()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', source)
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in code]
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; script-src " + " ".join(
        f"'sha256-{text}'" for text in hashes
    )


def test_what_comes_from_files_is_escaped_and_there(report: Path) -> None:
    assert EVIL not in report.read_text()
    assert parsed(report).text.count(EVIL) >= 4  # criterion, reason, fault, config


def test_a_name_of_an_event_ends_no_script(tmp_path: Path) -> None:
    recorded = recording(400)
    evil = f"</script>{EVIL}"
    event = Event("step", 5.0, 5.0, (Changed(evil, 1.0, 2.0),))
    judged = judge(recorded.channels, journal=[event])
    folder = run_folder(tmp_path, recorded)
    result = Result.read(folder.result)
    Result.of(result.criteria, result.metrics, result.timing, [], judged=judged).write(folder.result)
    page = parsed(write_report(folder))
    assert len(page.scripts) == 4
    assert any(evil in mark["text"] for mark in json.loads(page.scripts[0])["marks"])
    assert evil in page.text


def test_criteria_come_first_and_the_rest_is_there(tmp_path: Path) -> None:
    warned = [Warned(time_s=3.0, source="axis 1", text=f"near its limit {EVIL}")]
    text = parsed(write_report(run_folder(tmp_path, recording(), warnings=warned))).text
    order = [
        text.index(f"\n{title}\n")
        for title in ("Criteria", "Faults", "What happened", "Warnings", "Steps", "Metrics", "Timing", "Config")
    ]
    assert order == sorted(order)
    for wanted in (
        "0 of 2 criteria met",
        "1 fault",
        "1 warning",
        "2026-03-04 05:06:07 UTC",
        "61.4",
        "4711",
        np.__version__,
        "step-2026",
    ):
        assert wanted in text


def test_a_reason_stands_beside_its_verdict(report: Path) -> None:
    cut_off, cell = re.findall(r'<td class="result error">(.*?)</td>', report.read_text())
    assert "not judged: the run was cut off" in cut_off
    assert cell.startswith("✗ error")
    assert f"none {EVIL}" in html.unescape(cell)


def test_the_pictures_are_drawn_with_the_step_marked(report: Path) -> None:
    source = report.read_text()
    pictures = re.findall(r"<svg .*?</svg>", source, flags=re.DOTALL)
    assert len(pictures) == 6  # four of the experiment, one around the step, one of the timing
    for picture in pictures:
        ET.fromstring(picture)
    assert all(picture.count("E +20.7 %") == 1 for picture in pictures[:5])
    for label in ("axis 1", "averaged", "estimated", "set-point", "v1 − line in mm/s"):
        assert label in source


def test_identifiers_are_unique_and_references_resolve(report: Path) -> None:
    page = parsed(report)
    assert len(page.identifiers) == len(set(page.identifiers))
    used = {*re.findall(r"url\(#([^)]+)\)", report.read_text()), *(a.removeprefix("#") for a in page.addresses)}
    assert used <= set(page.identifiers)


def test_a_report_begins_with_its_contents_and_folds_the_config(report: Path) -> None:
    text = report.read_text()
    contents = text[text.index('<nav class="contents">') : text.index("</nav>")]
    listed = re.findall(r'<a href="#([a-z]+)">([^<]+)</a>', contents)
    assert listed == re.findall(r'<section id="([a-z]+)">\s*<h2>([^<]+)</h2>', text)
    assert len(listed) == text.count("<h2>") >= 8
    assert re.search(r'<section id="config">\s*<h2>Config</h2>\s*<details><summary>\d+ lines?</summary><pre>', text)


def test_small_and_the_same_every_time(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, recording(40_000))
    first = write_report(folder).read_bytes()
    assert len(first) < 2_000_000
    assert write_report(folder).read_bytes() == first
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "config.yaml",
        "recording.mf4",
        "report.html",
        "result.json",
    ]


@pytest.mark.slow
def test_a_long_run_with_many_steps_stays_a_small_file(tmp_path: Path) -> None:
    channels = dict(recording(400_000).channels)
    t = channels["t_s"]
    channels["F_ref_N"] = 80.0 + 5.0 * (np.floor(t / 0.05) % 2)  # some 800 steps
    channels["tau2_sim_Nm"] = np.random.default_rng(1).normal(size=len(t))
    path = write_report(run_folder(tmp_path, Recording(channels)))
    assert path.stat().st_size < 2_000_000
    assert len(json.loads(parsed(path).scripts[0])["zooms"]) == 20


def plotted(page: ParsedPage, name: str) -> tuple[list[float], list[float]]:
    """Times and values of a curve as the interactive picture has them."""
    data = json.loads(page.scripts[0])
    (curve,) = [curve for plot in data["plots"] for curve in plot["curves"] if curve["label"] == name]
    table = data["tables"][curve["table"]]
    x, y = base64.b64decode(table["x"]), base64.b64decode(table["columns"][curve["column"]])
    return np.frombuffer(x, "<f8").tolist(), np.frombuffer(y, "<f4").tolist()


@pytest.mark.slow
def test_a_spike_of_a_single_cycle_is_in_the_pictures_whatever_the_length(tmp_path: Path) -> None:
    recorded = recording(400_000)
    recorded["F_true_N"][333_333] = 143.0
    path = write_report(run_folder(tmp_path, recorded))
    _, tension = plotted(parsed(path), "set-point")  # the same table
    times, simulated = plotted(parsed(path), "estimated")
    assert len(times) == len(simulated) == len(tension) < 20_000
    data = json.loads(parsed(path).scripts[0])
    true = next(c for p in data["plots"] if p["picture"] == "tension" for c in p["curves"] if c["label"] == "true")
    values = np.frombuffer(base64.b64decode(data["tables"][true["table"]]["columns"][true["column"]]), "<f4")
    assert values.max() == 143.0


def test_the_axis_reaches_as_far_as_the_tension_does() -> None:
    t = np.linspace(0, 40, 20_000)
    swing = 80 + np.where(t > 10, 16.6 * np.exp(-(t - 10) / 0.2) * np.cos(130 * (t - 10)), 0.0)
    svg = drawn(
        Picture("tension", "", "", [Chart("tension in N", [Curve("true", t, swing, "#0072b2")], least=4.0)])
    ).svg
    assert "cut" not in svg
    (path,) = re.findall(r'<path d="([^"]*)"[^>]*stroke: var\(--blue\)', svg)
    heights = [float(y) for y in re.findall(r"[ML] [\d.]+ ([\d.]+)", path)]
    box = re.search(
        r'<g id="tension-patch_2">\s*<path d="M [\d.]+ ([\d.]+) \s*L [\d.]+ [\d.]+ \s*L [\d.]+ ([\d.]+)', svg
    )
    assert box is not None
    bottom, top = float(box[1]), float(box[2])
    assert top < min(heights) < top + 0.1 * (bottom - top)  # the peak is inside, near the upper edge


@pytest.mark.parametrize(("spread", "whole"), [(3.0, True), (30.0, False)])
def test_a_band_is_shown_whole_unless_the_curves_could_not_be_read(spread: float, whole: bool) -> None:
    t = np.linspace(0, 40, 2000)
    values = np.where(t > 10, 10.0, 8.0)
    band = Band(t, values - spread, values + spread, BLUE, 0.2)
    svg = drawn(Picture("x", "", "", [Chart("y", [Curve("a", t, values, BLUE)], [band])])).svg
    box = re.search(r'<g id="x-patch_2">\s*<path d="M [\d.]+ ([\d.]+) \s*L [\d.]+ [\d.]+ \s*L [\d.]+ ([\d.]+)', svg)
    area = re.search(r'FillBetween.*? d="([^"]*)".*?<use [^>]* y="([\d.]+)"', svg, re.DOTALL)
    assert box is not None
    assert (area is not None) == whole, "its edges are beyond the axes"
    if area is not None:
        heights = [float(area[2]) + float(y) for y in re.findall(r"[ML] [\d.]+ (-?[\d.]+)", area[1])]
        assert float(box[2]) < min(heights) < max(heights) < float(box[1])


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js")
def test_the_labels_of_ticks_say_where_the_ticks_are() -> None:
    source = Path(report_page.__file__).with_name("axes.js").read_text(encoding="utf-8")
    ask = """
    const ask = (values, step) => window.axes.ticks(null, values, 0, 0, step).join(" ");
    console.log([ask([2.5, 5, 7.5], 2.5), ask([0.25, 0.5], 0.25), ask([0, 20], 20), ask([0.1, 0.3], 0.1)].join("|"));
    """
    told = subprocess.run(
        ["node", "-e", f"const window = {{}};\n{source}{ask}"], capture_output=True, text=True, check=True
    )
    assert told.stdout.strip() == "2.5 5.0 7.5|0.25 0.50|0 20|0.1 0.3"


def test_what_a_step_does_for_a_few_cycles_is_not_cut_off() -> None:
    t = np.linspace(0, 40, 20_000)
    values = 80 + 0.01 * np.sin(t)
    values[5000:5008] += 60.0
    curves = [Curve("true", t, values, BLUE)]
    svg = drawn(Picture("x", "", "", [Chart("y", curves)]), [Mark(float(t[5000]), float(t[5000]), "step", "1")]).svg
    assert "cut" not in svg
    assert "cut" in drawn(Picture("x", "", "", [Chart("y", curves)])).svg  # nothing happened there: a glitch


def test_the_buttons_that_zoom_stand_above_the_pictures_that_they_zoom(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, recording())
    folder.config.write_text(
        (CONFIGS / "web_section_step.yaml").read_text().replace("../eds/", f"{CONFIGS.parent / 'eds'}/")
    )
    text = write_report(folder).read_text()
    assert 0 < text.index('data-picture="line"') < text.index('class="zooms"') < text.index('data-picture="velocities"')


@pytest.mark.parametrize("form", ["svg", "png"])
def test_each_picture_of_a_report_is_to_be_had_as_a_file_of_its_own(tmp_path: Path, form: str) -> None:
    folder = run_folder(tmp_path, recording())
    done = hilbench("report", folder.path, "--pictures", tmp_path / "pictures", "--format", form)
    assert done.returncode == 0, done.stderr
    written = [Path(line) for line in done.stdout.splitlines()]
    assert {"velocities", "torques", "elasticity", "tension", "zoom1", "jitter"} <= {path.stem for path in written}
    for path in written:
        content = path.read_bytes()
        if form == "png":
            assert content.startswith(b"\x89PNG\r\n")
        else:
            assert ET.fromstring(content).tag.endswith("svg")
            assert b"var(--" not in content  # no page around it that says which colours
    assert not folder.report.exists()


@pytest.mark.parametrize("options", [["--format", "png"], ["--pictures", "there", "--format", "bmp"]])
def test_a_format_that_pictures_can_not_have_is_unusable_input(tmp_path: Path, options: list[str]) -> None:
    done = hilbench("report", tmp_path, *options)
    assert done.returncode == 2
    assert "--format" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_what_is_far_beyond_the_axis_is_marked_with_its_value() -> None:
    t = np.linspace(0, 40, 20_000)
    values = np.sin(t)
    values[7000] = 5000.0
    svg = drawn(Picture("x", "", "", [Chart("y", [Curve("a", t, values, BLUE)])])).svg
    assert "▲ cut: up to 5000" in svg


@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed")
def test_a_browser_draws_all_plots_and_finds_no_error(report: Path, tmp_path: Path) -> None:
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    command += ["--disable-component-update", "--disable-sync", "--no-first-run", f"--user-data-dir={tmp_path}"]
    done = subprocess.run(
        [*command, "--dump-dom", report.resolve().as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    assert 'data-live="5"' in done.stdout
    assert done.stdout.count("<canvas") == 5
    assert "1: E +20.7 %" in done.stdout


def test_a_run_of_another_kind_gets_what_can_be_drawn(tmp_path: Path) -> None:
    whole = recording(400)
    bare = Recording({name: whole[name] for name in ("t_s", "tau2_Nm", "F_ref_N")})
    timing = Timing(
        pace="lockstep",
        cycle_us=2000,
        cycles=0,
        missed=0,
        jitter_us=None,
        realtime_factor=None,
        bus_load_pct=None,
    )
    folder = run_folder(
        tmp_path, bare, criteria=[], faults=[], metrics={}, timing=timing, environment=None, judged=None
    )
    text = parsed(write_report(folder)).text
    assert text.count("Not drawn: the recording lacks these signals.") == 2
    assert "The config sets none." in text
    assert "Completed, nothing judged" in text


@pytest.mark.parametrize("broken", [np.nan, 0.0])
def test_signals_without_a_single_good_value(tmp_path: Path, broken: float) -> None:
    whole = recording(400)
    channels = {name: values if name == "t_s" else np.full(400, broken) for name, values in whole.channels.items()}
    parsed(write_report(run_folder(tmp_path, Recording(channels))))


@pytest.mark.parametrize("missing", ["config", "result", "recording"])
def test_a_file_that_is_missing_is_named(tmp_path: Path, missing: str) -> None:
    folder = run_folder(tmp_path, recording(100))
    path: Path = getattr(folder, missing)
    path.unlink()
    with pytest.raises(UnusableInputError, match=re.escape(str(path))):
        write_report(folder)
    assert not folder.report.exists()


def test_a_run_folder_whose_name_is_no_utf_8_has_a_report(tmp_path: Path) -> None:
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd-\xff"))
    shutil.copytree(run_folder(tmp_path, recording(100)).path, odd)
    assert "odd-?" in write_report(RunFolder.open(odd)).read_text(encoding="utf-8")


def test_the_report_of_a_servo_axis_speaks_of_a_shaft_and_of_no_web(tmp_path: Path) -> None:
    path = write_report(run_folder(tmp_path, recorded_shaft()))
    text = html.unescape(re.sub(r"<script.*?</script>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL))
    pictures = re.findall(r"<svg .*?</svg>", text, flags=re.DOTALL)
    assert len(pictures) == 7  # five of the experiment, one around the step, one of the timing
    assert all(picture.count("J +25 %") == 1 for picture in pictures[:6])
    for words in ("Inertia of the shaft", "Dry friction", "J in kg·cm²", "rad/s", "torque in N·m", "J_time_to_1pct_s"):
        assert words in text
    assert not re.search(r"\b(web|tension|line speed|Young|roller|N/mm²|m/s)\b", text)
