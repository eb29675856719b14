"""Alarms of a run: each kind is told, counted and kept once, however many there are."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from tests.bench.bench_nodes import nodes
from tests.bench.strangers import STEPS, from_sync, on_the_bus
from tests.bench.whole_runs import config

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.reports.notice import MOST_KINDS, Notices
from hilbench.can.frame import Frame
from hilbench.exchange.emergencies import MOST_IN_A_CYCLE
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides

#: EMCY of axis 1 that it has not sent.
FORGED = Frame(0x081, bytes.fromhex("1023030000000000"))
A_CYCLE = 400


def run_in_process(folder: Path, **changes: object) -> tuple[RunOutcome, list[str]]:
    said: list[str] = []
    loaded = load_with_overrides(config(folder, steps=STEPS, **changes))
    outcome = run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS, announce=said.append)
    return outcome, said


def test_a_flood_of_one_alarm_is_one_warning_with_its_count_and_a_few_lines(tmp_path: Path) -> None:
    with on_the_bus(from_sync(100, *[FORGED] * A_CYCLE, until=200)):
        outcome, said = run_in_process(tmp_path)
    assert outcome.exit_code == 0
    (found,) = [warning for warning in outcome.result.warnings or [] if warning.source == "axis1 (node 1)"]
    # Every frame that the run has seen is counted: those of the last cycles may come before it ends.
    assert found.count == 100 * A_CYCLE
    assert found.text == "EMCY 2310h: current"
    assert found.last_time_s is not None
    assert found.time_s is not None
    assert 0.19 < found.last_time_s - found.time_s < 0.21
    assert len([line for line in said if "EMCY 2310h" in line]) <= 2
    assert outcome.folder.result.stat().st_size < 20_000
    write_report(outcome.folder)
    assert f'<td>EMCY 2310h: current</td><td class="number">{100 * A_CYCLE}</td>' in (
        outcome.folder.report.read_text(encoding="utf-8")
    )


@pytest.mark.slow
def test_a_flood_of_ever_other_alarms_hides_no_web_break(tmp_path: Path) -> None:
    draw = random.Random(3)
    noise = [Frame(0x0A0, draw.randbytes(8)) for _ in range(2000)]
    web_break = Frame(0x0A0, bytes.fromhex("15ff210000000000"))
    with on_the_bus(from_sync(100, *noise), from_sync(200, web_break)):
        outcome, said = run_in_process(tmp_path)
    assert outcome.exit_code == 3
    assert "web break" in outcome.result.faults[0].text
    told = [warning for warning in outcome.result.warnings or [] if warning.source == "virtual io (node 32)"]
    assert MOST_KINDS < len(told) <= MOST_KINDS + 1
    assert sum(warning.count for warning in told) > 100 * len(noise)
    assert len(said) < 100
    assert outcome.folder.result.stat().st_size < 20_000


def test_a_cycle_of_a_flood_decodes_a_few_of_its_messages_and_counts_all() -> None:
    bench = nodes()
    draw = random.Random(4)
    bench.decode([Frame(0x082, draw.randbytes(8)) for _ in range(5000)])
    assert len(bench.emergencies) == MOST_IN_A_CYCLE
    assert sum(bench.emergencies.values()) == 5000
    bench.decode([])
    assert not bench.emergencies


def test_alarms_come_first_at_once_and_then_ever_more_seldom() -> None:
    said: list[str] = []
    notices = Notices(said.append)
    for cycle in range(50_000):
        notices.note(cycle * 0.002, "limits", f"speed of axis 1 is {cycle / 7:.3g} m/s, beyond its warning level 8 m/s")
    notices.note(100.0, "limits", "torque of axis 1 is 11 N·m, beyond its warning level 10 N·m", kind="torque")
    first, second = notices
    assert (first.count, first.time_s, first.last_time_s) == (50_000, 0.0, 49_999 * 0.002)
    assert "is 0 m/s" in first.text
    assert "7.14e+03 m/s" in first.last_text
    assert second.count == 1
    assert said[0] == "t = 0.000 s: limits: speed of axis 1 is 0 m/s, beyond its warning level 8 m/s"
    assert said[1].endswith("beyond its warning level 8 m/s (501 times by now)")
    assert 5 <= len(said) <= 9
    assert "torque of axis 1 is 11" in said[-1]
