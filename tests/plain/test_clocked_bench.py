"""A bench by the clock, whose plain cycles are compiled, against the interpreted: the same samples, frames, lines of
the trace, counts, notices and errors, whatever comes between. Its bus and nodes are a script, packet by packet, and
SYNC is out when the script says so, so that both hear the same at the same place of a cycle."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.plain.scripted_bus import (
    ENABLED,
    EPOCH_NS,
    FAULT,
    Answering,
    Bus,
    Change,
    Producer,
    changed_once_more,
    comes_late,
    counts,
    cut_short,
    falls_silent,
    goes_by,
    hears,
    hears_before,
    in_packets,
    loses,
    misses,
    once_more,
    says,
)
from tests.plain_runs import CONFIGS, Samples

from hilbench.bench.cycle import BenchCycle
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CyclicTask, Outputs, Pieces
from hilbench.bench.tasks.watches import EmergencyWatch, LatenessWatch
from hilbench.can import hub_client
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.canopen.identifiers import EMERGENCY, HEARTBEAT, SDO_REQUEST, SYNC
from hilbench.canopen.object_store import ObjectStore
from hilbench.chain import by_python
from hilbench.cia402.drive import DriveGoal
from hilbench.errors import HilbenchError
from hilbench.exchange import measured
from hilbench.exchange.addressing import declared_units
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.timeliness import Timeliness
from hilbench.plain import clocked_exchange
from hilbench.plain.clocked_exchange import ClockedExchange, _ClockedRun
from hilbench.results.trace import TraceWriter
from hilbench.runs.config import load_with_overrides
from hilbench.topology.parts import Role
from hilbench.topology.sample import CycleSample, sample_type

#: Where the bench sends SYNC itself the clock is the machine's: time enough for what is to come before.
_OWN_CYCLE_S = 0.06
_ATTEMPTS = 10


class Says(CyclicTask):
    """Outputs that change with each cycle, from signals of the sample."""

    shown: Mapping[str, str] = {
        "axis1": "v1_cmd_m_s",
        "axis2": "v2_cmd_m_s",
        "load": "tau_load_cmd_Nm",
        "strain_prev": "strain_prev",
        "F_next_N": "F_next_N",
    }

    def _say(self, sample: CycleSample) -> bool:
        for place, name in enumerate(self.shown.values()):
            setattr(sample, name, 0.01 * place * (sample.cycle % 50) + 0.001)
        return True

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        self._say(sample)
        outputs.update({output: getattr(sample, name) for output, name in self.shown.items()})

    def in_pieces(self, sample: CycleSample) -> Pieces:
        return Pieces(before=[by_python(lambda: self._say(sample))], shown=self.shown)


@dataclass
class Left:
    """What a run left behind; `compiled`: cycles that were plain, `begun`: that were begun as such; `held_up`: whether
    the machine has let the bench miss what the script does not say."""

    compiled: int = 0
    begun: int = 0
    held_up: bool = False
    ending: str = ""
    found: dict[str, Any] = field(default_factory=dict)


def _nodes(cycle_s: float) -> Nodes:
    nodes = Nodes(
        load_with_overrides(
            CONFIGS / "web_section_step.yaml", pace="realtime", changes=[f"cycle_time_s={cycle_s}"]
        ).config
    )
    parts = [*nodes.config.parts_of(Role.AXIS), *nodes.config.parts_of(Role.LOAD_MOTOR)]
    for part, drive in zip(parts, nodes.drives, strict=True):
        drive.units = declared_units(part, drive.od)
    return nodes


def run(
    folder: Path,
    changes: Sequence[tuple[int, Change]],
    cycles: int,
    *,
    compiled: bool,
    together: bool,
    own_sync: bool,
    pays: int = 0,
) -> Left:
    """A bench that runs for so many cycles, one by one or `together`; the frames, and all that it counts."""
    left = Left()
    nodes, samples = _nodes(_OWN_CYCLE_S if own_sync else 0.002), Samples()
    for drive in nodes.drives:
        drive.request(DriveGoal.ENABLED)
    nodes.introduce(SimpleNamespace(add=lambda *_: None, sent=SimpleNamespace(take=lambda *_: False)))  # type: ignore[arg-type]
    bus = Bus(nodes, changes)
    trace = folder / f"{compiled}{together}{time.monotonic_ns()}.log"
    plain_cycle = _ClockedRun.cycle

    def counted(self: _ClockedRun, outputs: Any) -> bool:
        left.begun += 1
        done = plain_cycle(self, outputs)
        left.compiled += done
        return done

    with ExitStack() as resources:
        resources.callback(bus.close)
        tap = resources.enter_context(TraceWriter(trace, "can0"))
        membership = SimpleNamespace(station=0, connection=bus.ours)
        resources.enter_context(patch.object(hub_client, "join", lambda *_, **__: membership))
        resources.enter_context(patch.object(time, "time_ns", lambda: EPOCH_NS))
        resources.enter_context(patch.object(_ClockedRun, "cycle", counted))
        resources.enter_context(patch.object(clocked_exchange, "_PAYS", pays))
        link = EmbeddedLink("scripted", nodes.config.bus.bitrate, "real")
        producer: Any = None if own_sync else Producer(bus)
        answering = Answering(bus)
        if own_sync:
            resources.callback(answering.join)
            resources.callback(answering.end.set)
            answering.start()
        exchange = Exchange(nodes, link, ObjectStore(nodes.dictionary("axis1")), tap=tap, producer=producer)
        measured.warm_up()
        if compiled:
            exchange.use(lambda sync, own: ClockedExchange(link, nodes, sync, own, tap))
        notes: list[str] = []
        state = BenchState(nodes.config.cycle_time_s, sample_type(nodes.config.signals)(), notes.append, lambda _: None)
        state.enabled, state.exchange = True, exchange
        timeliness = Timeliness(("axis1", "axis2", "load", "twin"), nodes.config.cycle_time_s)
        bench = BenchCycle(
            state,
            exchange,
            machine=[Says()],
            watches=[LatenessWatch(timeliness, state.twin, state.reports), EmergencyWatch(state.reports)],
            observers=[samples],
            stop_on_unexpected_frames=False,
        )
        try:
            if together:
                bench.run_many(cycles)
            else:
                for _ in range(cycles):
                    bench.run()
        except HilbenchError as error:
            left.ending = f"{type(error).__name__}: {error}"
        exchange._sync.before_use()
    timing, pacing = exchange.timing, exchange.pacing
    in_time = pacing.missed == 0 and timing.missing_pdos == bus.withheld and not answering.was_late
    left.held_up = own_sync and not in_time
    left.found = {
        "samples": samples.kept,
        "trace": trace.read_text(),
        "sent": bus.sent,
        "notices": [(each.time_s, each.source, each.text, each.count) for each in state.reports.notices],
        "notes": notes,
        "lateness": {name: (each.late, each.oldest_cycles, each.lately) for name, each in timeliness.of.items()},
        "cycles": (timeliness.cycles, timing.cycles, timing.bits, timing.missing_pdos, timing.first_loss_cycle),
        "pacing": () if own_sync else (pacing.missed, pacing.late_set_points, len(pacing.lateness_ns)),
        "silent": exchange.silent,
        "lost": (exchange.lost_frames, exchange.controller, nodes.malformed, nodes.twin_problem),
        "answers": [
            (cob_id, tpdo.age_cycles, tpdo.since, tpdo.is_plain, tpdo._owed, tpdo._used)
            for cob_id, tpdo in nodes.answers.items()
        ],
        "drives": [(drive.feedback, drive.setpoint, drive.controlword, drive._raw) for drive in nodes.drives],
        "counted": nodes.measured.counted.tolist(),
        "twin": (nodes.twin_reported_cycle, nodes.twin_heard, nodes._heartbeat_cycle),
        "steady": [tpdo._steady for tpdo in nodes.answers.values()],
        "gone_by": exchange._sync.gone_by,
    }
    return left


EMCY = Frame(EMERGENCY + 2, bytes((0x10, 0x42, 0x08, 0, 0, 0, 0, 0)))
CHANGES: list[Change] = [
    misses(0x282),
    misses(0x3A0),
    comes_late(0x183),
    comes_late(0x3A0),
    comes_late(0x281),
    hears(EMCY),
    hears_before(EMCY),
    hears(Frame(0x123, b"abc")),
    hears_before(Frame(0x123, b"abc"), Frame(0x456, b"")),
    hears(Frame(SDO_REQUEST + 127, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0)))),
    hears(Frame(SDO_REQUEST + 1, bytes((0x2B, 0x17, 0x10, 0, 0x1E, 0, 0, 0)))),
    hears(Frame(0x201, bytes(6))),
    hears(Frame(0x000, b"\x80\x01"), at=9),
    hears(Frame(ERROR_FLAG | 0x04, b"\x00\x10" + bytes(6))),
    hears_before(Frame(ERROR_FLAG | 0x04, b"\x00\x10" + bytes(6))),
    hears(Frame(SYNC, b"")),
    hears_before(Frame(SYNC, b"")),
    hears(Frame(HEARTBEAT + 32, b"\x05"), Frame(HEARTBEAT + 32, b"\x05")),
    hears(Frame(HEARTBEAT + 32, b"\x7f")),
    hears(Frame(HEARTBEAT + 99, b"\x05")),
    in_packets,
    loses,
    cut_short,
    once_more,
    changed_once_more,
    counts(-1),
    counts(2),
    says("axis1", ENABLED | 0x80),
]
GONE: list[Change] = [goes_by(1, joins=True), goes_by(2, joins=True), goes_by(1, joins=False), goes_by(3, joins=False)]
ENDS: list[Change] = [
    hears(Frame(0x001, b"")),
    hears_before(Frame(0x001, b"")),
    hears(Frame(HEARTBEAT + 2, b"\x00")),
    says("axis2", FAULT),
    falls_silent,
]


def undisturbed(folder: Path, changes: Sequence[tuple[int, Change]], cycles: int, **how: bool) -> Left:
    """A run on a machine that has time for it, where its clock plays a part."""
    for _ in range(_ATTEMPTS):
        left = run(folder, changes, cycles, **how)
        if not left.held_up:
            return left
    raise AssertionError("the machine has no time for this test")


def check(
    folder: Path,
    changes: Sequence[tuple[int, Change]],
    *,
    cycles: int = 90,
    least: int = 40,
    own_sync: bool = False,
    but: str = "",
) -> Left:
    """Both, and the cycles in pieces, leave the same; `least`: so many are compiled, at least; `but`: for this."""
    reference = undisturbed(folder, changes, cycles, compiled=False, together=False, own_sync=own_sync)
    assert reference.begun == 0
    for together in (False, True):
        left = undisturbed(folder, changes, cycles, compiled=True, together=together, own_sync=own_sync)
        assert left.compiled >= least
        assert left.ending == reference.ending
        for what, value in reference.found.items():
            assert left.found[what] == value or what == but, what
    return reference


def test_a_bench_runs_alike_where_nothing_comes_between(tmp_path: Path) -> None:
    left = check(tmp_path, [(40, in_packets)], least=80)
    assert len(left.found["samples"]) == 90


def test_a_bench_runs_alike_when_answers_are_late_or_stay_away(tmp_path: Path) -> None:
    changes = [(30, CHANGES[0]), (40, CHANGES[2]), (50, CHANGES[3]), (52, CHANGES[4]), (70, CHANGES[1])]
    left = check(tmp_path, changes)
    assert left.found["cycles"][3] == 5


def test_an_answer_that_was_lost_is_owed_for_as_long(tmp_path: Path) -> None:
    left = check(tmp_path, [(20, misses(0x282)), (30, misses(0x181)), (31, misses(0x181))], cycles=560, least=500)
    assert [steady for steady in left.found["steady"] if steady]


def test_a_bench_runs_alike_when_others_send(tmp_path: Path) -> None:
    changes = [(20 + 6 * at, change) for at, change in enumerate(CHANGES[5:20])]
    left = check(tmp_path, changes, cycles=130)
    assert len(left.found["notices"]) > 3


def test_a_bench_runs_alike_when_syncs_go_by(tmp_path: Path) -> None:
    changes = [(20 + 15 * at, change) for at, change in enumerate(GONE)]
    left = check(tmp_path, changes)
    assert left.found["pacing"][:2] == (5, 2)


def test_a_bench_that_sends_sync_itself_runs_alike(tmp_path: Path) -> None:
    changes = [(13, CHANGES[2]), (16, CHANGES[5]), (19, CHANGES[8]), (21, in_packets), (23, CHANGES[16])]
    check(tmp_path, changes, cycles=26, least=8, own_sync=True)


def test_where_strange_frames_are_a_rule_few_cycles_are_begun_in_vain(tmp_path: Path) -> None:
    changes = [(at, hears(Frame(0x191, bytes(8)))) for at in range(20, 220)]
    left = run(tmp_path, changes, 220, compiled=True, together=False, own_sync=False, pays=8)
    assert left.begun - left.compiled <= 9  # after 1, 2, 4, … cycles


@pytest.mark.parametrize("change", range(len(ENDS)))
def test_a_bench_ends_alike(tmp_path: Path, change: int) -> None:
    # Who is silent is told behind what has been answered.
    left = check(tmp_path, [(50, ENDS[change])], cycles=280, but="drives" if ENDS[change] is falls_silent else "")
    assert left.ending


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.integers(3, 80), st.sampled_from([*CHANGES, *GONE])), max_size=6, unique_by=lambda each: each[0]
    )
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_bench_runs_alike_whatever_comes_between(tmp_path: Path, changes: list[tuple[int, Change]]) -> None:
    check(tmp_path, changes, least=0)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(3))
def test_a_bench_that_sends_sync_itself_runs_alike_whatever_comes_between(tmp_path: Path, first: int) -> None:
    changes = [(12 + 11 * at, change) for at, change in enumerate(CHANGES[first::3])]
    check(tmp_path, changes, cycles=120, least=10, own_sync=True)
