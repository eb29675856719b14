"""Compiled cycles (`hilbench.in_process_cycle`) against the interpreted ones: the same frames, samples, objects and
endings, bit by bit, whatever comes between."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from tests.fast_path_runs import (
    CONFIGS,
    NMT,
    OPTIONS,
    Change,
    How,
    between,
    chained_as,
    download,
    ending_of,
    events_on_a_line,
    notices_of,
    objects_of,
    sets,
)
from tests.tiers import slow

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle import in_process
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.reports.change import Change as Change_
from hilbench.can.frame import Frame
from hilbench.canopen.host import HostedDevices
from hilbench.estimation.web_line import span_estimator_cycle
from hilbench.in_process_cycle.cycles import FastPathCycles, _Run
from hilbench.results.recording_builder import Recorder
from hilbench.results.trace import TraceWriter
from hilbench.runs.config import load_with_overrides
from hilbench.twin.machines import web_line_cycle
from hilbench.twin.machines.web_line_cycle import LineCycle

#: The time of the first SYNC: traces have the same times.
EPOCH_NS = 1_700_000_000_123_456_789
#: SDO (580h to 67Fh), and boot-ups.
POLLS = re.compile(r" (5[89A-F]|6[0-7]).#| 7..#00$")


@dataclass
class Left:
    """What a run left behind."""

    fast_path: int = 0  #: cycles
    chained: int = 0  #: those of them that went without Python
    trace: list[str] = field(default_factory=list)
    samples: dict[str, bytes] = field(default_factory=dict)
    journal: list[Change_] = field(default_factory=list)
    notices: list[tuple[float, str, str, int]] = field(default_factory=list)
    objects: list[object] = field(default_factory=list)
    ending: str = ""


def run(folder: Path, loaded: Any, changes: Sequence[tuple[int, Change]], cycles: int, how: How) -> Left:
    """A bench that runs for so many cycles, with what is done in between, by cycle."""
    left, hosted = Left(), list[HostedDevices]()
    fast = FastPathCycles.cycle

    def counted(self: FastPathCycles, outputs: Any) -> bool:
        done = how is not How.INTERPRETED and fast(self, outputs)
        left.fast_path += done
        return done

    def kept(make: Callable[..., HostedDevices]) -> Callable[..., HostedDevices]:
        def made(*arguments: Any) -> HostedDevices:
            hosted.append(make(*arguments))
            return hosted[-1]

        return made

    recorder = Recorder(loaded.config.signals)
    trace = folder / f"trace-{how.name}.log"
    trace.unlink(missing_ok=True)
    with (
        patch.object(FastPathCycles, "cycle", counted),
        chained_as(how) as chained,
        patch.object(in_process, "hardware", kept(in_process.hardware)),
        patch.object(in_process, "twin", kept(in_process.twin)),
        patch.object(time, "time_ns", lambda: EPOCH_NS),
        TraceWriter(trace, "can0") as tap,
    ):
        bench = Bench(
            loaded.config,
            observers=[recorder],
            tap=tap,
            participants=Participants.IN_PROCESS,
            journal=left.journal.append,
        )
        left.ending = ending_of(bench, cycles, changes, together=how is How.CHAINED)
    left.chained = chained()
    left.fast_path += left.chained
    recording = recorder.recording(datetime.fromtimestamp(0, UTC), "")
    left.samples = {name: recording[name].tobytes() for name in recording.channels}
    left.notices = notices_of(bench)
    left.objects = objects_of(hosted)
    lines = trace.read_text().splitlines()
    first = next(at for at, line in enumerate(lines) if " 080#" in line)
    last = max(at for at, line in enumerate(lines) if " 080#" in line)
    left.trace = lines[first:last]  # before and after SYNC heartbeats go by the wall clock
    return left


def check(
    folder: Path,
    loaded: Any,
    changes: Sequence[tuple[int, Change]],
    cycles: int = 150,
    least: int = 60,
    *,
    chains: bool = True,
    polled: bool = False,
) -> Left:
    """All kinds of cycles make the same; `least`: so many of them are fast-path cycles at least, and so many of these
    go without Python where all of a cycle can (`chains`). `polled`: nodes may boot or stop on the way, and are polled
    by the wall clock then: what belongs to that is left out of the trace."""
    reference = run(folder, loaded, changes, cycles, How.INTERPRETED)
    assert reference.fast_path == 0
    for how in (How.ONE_BY_ONE, How.CHAINED):
        left = run(folder, loaded, changes, cycles, how)
        assert left.fast_path >= least
        assert left.chained >= (least // 2 if how is How.CHAINED and chains else 0)
        assert left.ending == reference.ending
        assert [name for name in left.samples if left.samples[name] != reference.samples[name]] == []
        traces = ([line for line in each.trace if not (polled and POLLS.search(line))] for each in (left, reference))
        assert next(traces) == next(traces)
        assert left.journal == reference.journal
        assert left.notices == reference.notices
        assert left.objects == reference.objects
    return left


# -- what comes between ----------------------------------------------------------------------------------------------


def sends(*frames: Frame) -> Change:
    """Somebody else on the bus sends something; the devices get it with the next SYNC."""

    def change(bench: Bench) -> None:
        assert bench.exchange is not None
        link = bench.exchange._sync._link._participants.bus.open_link()  # type: ignore[attr-defined]
        link.send(frames)
        link.close()  # one that stays would receive all, and no cycle would fit the fast path

    return change


def restarts_the_twin(bench: Bench) -> None:
    bench.restart_twin()


def interrupts(bench: Bench) -> None:
    bench.request_interrupt()


LINE = [
    *events_on_a_line(sends),
    sets("line_speed_m_s", -0.1),
    restarts_the_twin,
    interrupts,
    sends(Frame(0x080, b"")),
    sends(Frame(NMT, bytes((0x82, 17)))),
]


@pytest.mark.slow
@given(changes=between(LINE), options=OPTIONS)
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_line_runs_alike_whatever_comes_between(
    tmp_path: Path, changes: list[tuple[int, Change]], options: list[str]
) -> None:
    # Less than the time after which devices go by the wall clock.
    timeout = "safety.cycle_timeout_s=2"
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml", changes=[*options, timeout])
    check(tmp_path, loaded, changes, least=0, polled=True)


#: Benches of which every part of a cycle is compiled.
CHAINED = {"web_section_step", "line_two_spans", "line_three_spans", "servo_axis"}


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("web_section_step", "line_speed_m_s"),
        ("line_two_spans", "line_speed_m_s"),
        ("line_three_spans", "line_speed_m_s"),
        ("web_section_step_pid", "line_speed_m_s"),
        ("servo_axis", "speed_rad_s"),
        *slow(("line_with_dancer", "line_speed_m_s")),
    ],
)
def test_every_kind_of_bench_runs_alike(tmp_path: Path, name: str, path: str) -> None:
    changes = [(10, sets(path, 0.05)), (80, sets(path, 0.1))]
    check(tmp_path, load_with_overrides(CONFIGS / f"{name}.yaml"), changes, chains=name in CHAINED)


def test_a_force_that_is_told_ahead_runs_alike(tmp_path: Path) -> None:
    ahead = load_with_overrides(CONFIGS / "line_with_dancer.yaml", changes=["controllers.dancer_position.force={}"])
    left = check(tmp_path, ahead, [(10, sets("line_speed_m_s", 0.05)), (80, sets("line_speed_m_s", 0.1))], chains=False)
    assert np.ptp(np.frombuffer(left.samples["f_dancer_cmd_N"])) > 0.1


def ramps(path: str, to: float, duration_s: float) -> Change:
    return lambda bench: bench.ramp(path, to, duration_s)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("web_section_step", ramps("line_speed_m_s", 0.7, 0.3)),
        ("web_section_step", ramps("tension_control.set_point_N", 95.0, 0.1)),
        *slow(("line_three_spans", ramps("line_speed_m_s", 0.7, 0.3))),
    ],
)
def test_what_is_moved_runs_alike(tmp_path: Path, name: str, change: Change) -> None:
    check(tmp_path, load_with_overrides(CONFIGS / f"{name}.yaml"), [(10, sets("line_speed_m_s", 0.05)), (40, change)])


@pytest.mark.parametrize("name", ["web_section_step", "line_with_dancer", "servo_axis"])
def test_a_cycle_that_does_not_fit_after_all_runs_alike(tmp_path: Path, name: str) -> None:
    """As when the machine held the process up between two cycles."""
    held_up, fitting = list[object](), _Run._fitting_cycles

    def is_held_up_first(run: _Run, now_ns: int) -> int:
        if len(held_up) < 3 and run not in held_up:
            held_up.append(run)
            return 0
        return fitting(run, now_ns)

    with patch.object(_Run, "_fitting_cycles", is_held_up_first):
        check(tmp_path, load_with_overrides(CONFIGS / f"{name}.yaml"), [])
    assert len(held_up) == 3


def test_a_limit_warns_and_trips_in_the_same_cycle(tmp_path: Path) -> None:
    limits = ["safety.limits.speed_m_s.warning=0.2", "safety.limits.speed_m_s.trip=0.6"]
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml", changes=limits)
    left = check(tmp_path, loaded, [(10, ramps("line_speed_m_s", 1.0, 0.4))])
    assert "speed of axis 1" in left.ending or "speed of axis 2" in left.ending
    assert "beyond its trip level 0.6 m/s" in left.ending
    assert [text for _, source, text, _ in left.notices if source == "limits"] != []


def test_what_the_twin_reports_under_way_is_on_the_bus_before_the_next_sync(tmp_path: Path) -> None:
    """Friction that comes shifts the torque: the twin is sure of it within a second, and says so by EMCY."""
    changes = [
        (5, ramps("line_speed_m_s", 3.0, 2.0)),
        (1005, sets("hardware.effects.coulomb_friction.axis2.force_N", 16.0)),
    ]
    left = check(tmp_path, load_with_overrides(CONFIGS / "web_section_step.yaml"), changes, cycles=1500, least=1400)
    assert [text for _, _, text, _ in left.notices if "FF17h" in text] != []


def test_what_the_twin_reports_while_nothing_else_changes_is_on_the_bus_before_the_next_sync(tmp_path: Path) -> None:
    """Nothing tells what a small shift of the torque is while the strain stays: the twin says so by EMCY, and goes on
    in the same vectors."""
    changes = [
        (5, ramps("line_speed_m_s", 3.0, 2.0)),
        (1005, sets("hardware.effects.torque_offset.axis2.offset_Nm", 0.19)),
    ]
    slow_loop = "controllers.tension_control.bandwidth_rad_per_s=0.05"
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml", changes=[slow_loop])
    left = check(tmp_path, loaded, changes, cycles=3000, least=2800)
    assert [text for _, _, text, _ in left.notices if "FF18h" in text] != []


def test_drives_at_their_limit_are_told_in_the_same_cycles(tmp_path: Path) -> None:
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml")
    left = check(tmp_path, loaded, [(10, sets("line_speed_m_s", 1.0))], cycles=700, least=500)
    assert len([text for _, source, text, _ in left.notices if source == "saturation"]) >= 2


def test_a_load_motor_that_its_shaft_turns_too_fast_fails_alike(tmp_path: Path) -> None:
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml")
    changes = [(5, sends(download(3, 0x6080, 100, 4))), (40, sets("line_speed_m_s", 1.0))]  # 6080h: rpm; 1 m/s are 239
    left = check(tmp_path, loaded, changes, least=40)
    assert left.ending.startswith("BenchFaultError: load (node 3): is in FAULT")


def test_who_reads_and_finds_nothing_ends_no_plain_cycles(tmp_path: Path) -> None:
    settled, readers = list[bool](), list[Any]()
    settle = FastPathCycles.settle

    def counted(self: FastPathCycles) -> None:
        settled.append(self._run is not None)
        settle(self)

    def opens(bench: Bench) -> None:
        assert bench.exchange is not None
        link = bench.exchange._sync._link._participants.bus.open_link()  # type: ignore[attr-defined]
        link.set_filters([(0x123, 0x7FF)])
        readers.append(link)

    def reads(bench: Bench) -> None:
        settled.clear()
        assert readers[0].receive(0.0) == []
        assert settled == []

    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml")
    with patch.object(FastPathCycles, "settle", counted):
        left = run(tmp_path, loaded, [(20, opens), (60, reads)], 80, How.ONE_BY_ONE)
    assert left.fast_path >= 40
    assert left.ending == ""


def counts_stages(made: list[int]) -> Any:
    """`_go_on_by_objects` of a line in vectors keeps the stages at which it was called."""
    original = LineCycle._go_on_by_objects

    def counted(self: LineCycle, stage: int) -> int:
        if not self._figures["by_object"][0]:
            made.append(stage)
        return original(self, stage)

    return patch.object(LineCycle, "_go_on_by_objects", counted)


@pytest.mark.slow
def test_what_a_twin_has_python_do_now_and_then_is_alike(tmp_path: Path) -> None:
    """A standstill, a start, a twin that joins under way, another E, a web that tears."""
    stages = list[int]()
    changes = [
        (20, sets("line_speed_m_s", 0.3)),
        (300, restarts_the_twin),
        (500, sets("line_speed_m_s", 1.0)),
        (900, sets("load.web.youngs_modulus_Pa", 10.5e9)),
        (1300, sets("load.web.broken", 1.0)),
    ]
    loaded = load_with_overrides(CONFIGS / "web_section_step.yaml")
    with counts_stages(stages):
        check(tmp_path, loaded, changes, cycles=1600, least=1000)
    assert {span_estimator_cycle.HOLD, span_estimator_cycle.FOUND_WEB} <= set(stages)


@pytest.mark.slow
def test_what_a_twin_of_several_spans_has_python_do_now_and_then_is_alike(tmp_path: Path) -> None:
    """A standstill, a start, another web that comes in, another E, a web that tears."""
    stages = list[int]()
    changes = [
        (20, sets("line_speed_m_s", 1.0)),
        (600, sets("load.effects.splice.relative_change", 0.3)),
        (1100, sets("load.web.span2.youngs_modulus_Pa", 10.5e9)),
        (1300, sets("load.web.broken", 1.0)),
    ]
    loaded = load_with_overrides(CONFIGS / "line_two_spans.yaml")
    with counts_stages(stages):
        check(tmp_path, loaded, changes, cycles=1500, least=1000)
    assert {span_estimator_cycle.HOLD, web_line_cycle.PASSAGE} <= set(stages)


@pytest.mark.slow
def test_a_twin_of_several_spans_that_joins_under_way_finds_the_same(tmp_path: Path) -> None:
    """One span waits for the other, in objects; then both are in vectors. While the twin boots, heartbeats may go by
    the wall clock: the frames are not compared."""
    changes = [(20, sets("line_speed_m_s", 1.0)), (300, restarts_the_twin)]
    loaded = load_with_overrides(CONFIGS / "line_two_spans.yaml")
    one, other = (run(tmp_path, loaded, changes, 1000, how) for how in (How.CHAINED, How.INTERPRETED))
    assert one.fast_path >= 600
    assert one.samples == other.samples


def test_what_happens_to_a_twin_of_a_servo_axis_now_and_then_is_alike(tmp_path: Path) -> None:
    """A standstill, a start, another inertia, and more torque than the drive has."""
    changes = [
        (5, sets("speed_rad_s", 2.0)),
        (180, sets("speed_rad_s", 4.0)),
        (200, sets("load.shaft.inertia_kg_m2", 0.06)),
        (260, sets("speed_rad_s", 20.0)),
    ]
    loaded = load_with_overrides(CONFIGS / "servo_axis.yaml")
    check(tmp_path, loaded, changes, cycles=320, least=250)
