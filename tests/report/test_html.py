"""The report: complete, self-contained, escaped, and made from whatever a run has recorded."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilbench.bench.signals import SIGNALS
from hilbench.errors import UnusableInputError
from hilbench.experiment.criteria import CriterionResult
from hilbench.experiment.metrics import evaluate_metrics
from hilbench.record.recording import Recording, write_recording
from hilbench.record.result import Environment, Fault, Result, Timing, jitter
from hilbench.record.run_folder import RunFolder
from hilbench.report.html import write_report

E0, E1 = 8.7e9, 10.5e9
EVIL = "<script>alert('1')</script> & \"x\""


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
    channels = {signal.name: known.get(signal.name, np.zeros(samples)) for signal in SIGNALS}
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
        "timing": timing,
        "faults": [Fault(time_s=12.5, source=EVIL, text=EVIL)],
        "environment": Environment.here(seed=4711),
    }
    Result.of(**{**defaults, **result}).write(folder.result)
    return folder


class _Page(HTMLParser):
    """Collects tags, addresses, identifiers and text; checks that every element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.identifiers: list[str] = []
        self.text = ""
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "br"):
            self._open.append(tag)
        self.handle_attributes(attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.handle_attributes(attrs)

    def handle_attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action"):
                self.addresses.append(value or "")
            if name == "id":
                self.identifiers.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def parsed(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    assert not page._open
    return page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(run_folder(tmp_path_factory.mktemp("runs"), recording()))


def test_nothing_comes_from_outside_and_nothing_runs(report: Path) -> None:
    page = parsed(report)
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert all(address.startswith("#") for address in page.addresses)
    assert "@import" not in report.read_text()
    assert re.findall(r"url\((?!#)", report.read_text()) == []


def test_what_comes_from_files_is_escaped_and_there(report: Path) -> None:
    assert "<script" not in report.read_text()
    assert parsed(report).text.count(EVIL) >= 4  # criterion, reason, fault, config


def test_criteria_come_first_and_the_rest_is_there(report: Path) -> None:
    text = parsed(report).text
    order = [
        text.index(f"\n{title}\n") for title in ("Criteria", "Faults", "What happened", "Metrics", "Timing", "Config")
    ]
    assert order == sorted(order)
    for wanted in (
        "1 of 2 criteria met",
        "1 fault",
        "2026-03-04 05:06:07 UTC",
        "61.4",
        "4711",
        np.__version__,
        "step-2026",
    ):
        assert wanted in text


def test_the_pictures_are_drawn_with_the_step_marked(report: Path) -> None:
    source = report.read_text()
    pictures = re.findall(r"<svg .*?</svg>", source, flags=re.DOTALL)
    assert len(pictures) == 5  # four of the experiment, one of the timing
    for picture in pictures:
        ET.fromstring(picture)
    assert source.count("E +20.7 %") == 4
    for label in ("axis 1", "averaged", "estimated", "set-point", "v1 − line in mm/s"):
        assert label in source


def test_identifiers_are_unique_and_references_resolve(report: Path) -> None:
    page = parsed(report)
    assert len(page.identifiers) == len(set(page.identifiers))
    used = {*re.findall(r"url\(#([^)]+)\)", report.read_text()), *(a.removeprefix("#") for a in page.addresses)}
    assert used <= set(page.identifiers)


def test_small_and_the_same_every_time(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, recording(40_000))
    first = write_report(folder).read_bytes()
    assert len(first) < 1_500_000
    assert write_report(folder).read_bytes() == first
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "config.yaml",
        "recording.mf4",
        "report.html",
        "result.json",
    ]


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
    folder = run_folder(tmp_path, bare, criteria=[], faults=[], metrics={}, timing=timing, environment=None)
    text = parsed(write_report(folder)).text
    assert text.count("Not drawn: the recording lacks these signals.") == 2
    assert "The config sets none." in text
    assert "Passed" in text


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
