"""Frames that the bench lost are seen: in the result, as a criterion, in the report and on the terminal."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console
from tests.bench.whole_runs import SHORT, config, gone

from hilbench.apps.commands.run import show_outcome
from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle import startup
from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.open import open_link
from hilbench.errors import NoAnswerError
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.results.result import Timing
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

LOST, LOST_IN_CYCLE = 5, 300


class LosingLink:
    """The bench's link, which from one cycle on says that frames were lost."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._syncs = 0
        self.channel, self.controller = link.channel, link.controller
        self.receive, self.set_filters, self.fileno, self.close = (
            link.receive,
            link.set_filters,
            link.fileno,
            link.close,
        )

    def send(self, frames: Sequence[Frame]) -> None:
        self._syncs += sum(frame.can_id == 0x80 for frame in frames)
        self._link.send(frames)

    @property
    def dropped(self) -> int:
        return LOST if self._syncs >= LOST_IN_CYCLE else 0


@pytest.mark.slow
def test_a_run_that_lost_frames_says_so_everywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "open_link", lambda bus: LosingLink(open_link(bus)))
    criterion = {"name": "no frame lost", "metric": "lost_frames", "max": 0}
    path = config(tmp_path, criteria=[criterion], steps=[SHORT[0], {"hold": {"until_s": 1.0}}])
    outcome = run_experiment(load_with_overrides(path), tmp_path / "runs")
    timing = json.loads(outcome.folder.result.read_text())["timing"]
    assert timing["lost_frames"] == LOST
    assert timing["lost_frames_of"] == {"simulated hardware": 0, "twin": 0}
    assert 0.0 < timing["first_loss_s"] <= LOST_IN_CYCLE * 0.002
    assert outcome.exit_code == 1
    assert not outcome.result.criteria[0].passed
    page = write_report(outcome.folder).read_text()
    assert "Warnings" in page
    for row in (f'by the bench</td><td class="number">{LOST}<', 'by the twin</td><td class="number">0<'):
        assert f"frames lost {row}" in page
    assert f"the bench lost {LOST} frames, first noticed at t = " in page
    console = Console(width=200, record=True, file=(tmp_path / "out").open("w"))
    show_outcome(console, outcome)
    assert f"warning the bench lost {LOST} frames" in console.export_text()
    assert gone(path)


class SilentLink:
    """Nobody answers, because frames were lost on this side."""

    channel, dropped = "fake0", 7
    controller = ControllerState.ERROR_ACTIVE

    def send(self, frames: Sequence[Frame]) -> None: ...

    def receive(self, timeout_s: float) -> list[Frame]:
        return []

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None: ...

    def fileno(self) -> int:
        return -1

    def close(self) -> None: ...


def test_a_missing_answer_that_may_be_our_own_loss_is_told_as_such() -> None:
    exchange = SyncCycle(
        SilentLink(),
        cycle_ns=2_000_000,
        bitrate=1_000_000,
        lockstep=True,
        expected=[ExpectedPdo(0x181, 1, "axis1 (node 1)")],
        timeout_s=0.01,
        missing_limit=1,
    )
    with pytest.raises(NoAnswerError, match=r"axis1 .*; the bench itself has lost 7 frames"):
        exchange.exchange([])


def test_losses_of_the_other_processes_are_warnings_too() -> None:
    timing = Timing(
        pace="lockstep",
        cycle_us=2000,
        cycles=10,
        missed=0,
        jitter_us=None,
        realtime_factor=1.0,
        bus_load_pct=60.0,
        lost_frames=0,
        lost_frames_of={"simulated hardware": 0, "twin": 3},
    )
    assert timing.warnings() == ["the twin lost 3 frames: set points or measurements are missing there"]
    assert Timing.model_validate_json(timing.model_dump_json()) == timing
    assert timing.metrics()["lost_frames"] == 0.0
