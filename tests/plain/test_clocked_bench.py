"""A bench by the clock, whose plain cycles are compiled, against the interpreted: the same samples, frames, lines of
the trace, counts, notices and errors, whatever comes between. Its bus and nodes are a script, packet by packet, and
SYNC is out when the script says so, so that both hear the same at the same place of a cycle."""

from __future__ import annotations

import socket
import threading
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.plain_runs import CONFIGS, Samples

from hilbench.bench.cycle import BenchCycle
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import CyclicTask, Outputs, Pieces
from hilbench.bench.tasks.watches import EmergencyWatch, LatenessWatch
from hilbench.can import hub_client, protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.can.waiting import wait_readable
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

ENABLED, FAULT = 0x27, 0x08
_EPOCH_NS = 1_700_000_000_000_000_000
_LONG_NS = 10_000_000_000
_FRAME_NS = 130_000  # from one time stamp to the next
#: Where the bench sends SYNC itself the clock is the machine's: time enough for what is to come before.
_OWN_CYCLE_S = 0.06
_ATTEMPTS = 10
_NODE_IDS = (1, 2, 3, 17, 18, 32)
_DATA = {"axis1": 11, "axis2": -7, "load": 3}

Packets = list[list[Frame]]


@dataclass
class Script:
    """What the bench hears in a cycle: packets before SYNC, that in which SYNC is with what is behind it, and those
    that come later; `gone_by`: SYNCs, with their answers, that are out before the bench comes, the last of which it may
    join; `in_time`: else the time for answers is over at once; `lost`: frames that the bus has dropped by then."""

    before: Packets
    with_sync: list[Frame]
    later: Packets = field(default_factory=list)
    gone_by: Packets = field(default_factory=list)
    joins: bool = False
    in_time: bool = True
    lost: int = 0


Change = Callable[["Bus", int, Script], None]


class Bus:
    """The other end of the bench's socket, and what the nodes on it say."""

    def __init__(self, nodes: Nodes, changes: Sequence[tuple[int, Change]]) -> None:
        self.ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours.setblocking(False)
        self._theirs.setblocking(False)
        self.nodes, self._changes = nodes, changes
        self.sent: list[str] = []
        self.held_back: list[Frame] = []  #: what comes before the next SYNC only
        self.withheld = 0  #: answers that stay away, or come late
        self.silent: set[int] = set()  #: nodes that send no heartbeats
        self._syncs = self.count = 0  #: that were out, and that the twin has counted
        self.statuswords = dict.fromkeys(_DATA, ENABLED)
        self._stamp_ns, self.lost = _EPOCH_NS, 0

    def answers(self) -> list[Frame]:
        """Of all nodes to one SYNC."""
        self.count += 1
        self._syncs += 1
        found, io = [], self.nodes.io
        for part, value in _DATA.items():
            tpdos = self.nodes.pdo_maps(part)[1:]
            found.append(Frame(tpdos[0].cob_id, tpdos[0].pack((self.statuswords[part], value + self.count, value))))
            found += [Frame(pdo.cob_id, pdo.pack((value * self.count,))) for pdo in tpdos[1:]]
        for pdo in io.sent:
            if self._syncs % pdo.period:
                continue
            found.append(Frame(pdo.cob_id, pdo.pack([0.5 * self.count + k for k in range(len(pdo.kinds))])))
        return [*found, Frame(io.status.cob_id, io.status.pack((self.count & 0xFFFF, 0, 3)))]

    def script(self, cycle: int) -> Script:
        """Of this cycle: heartbeats now and then, some before SYNC."""
        alive = [
            Frame(HEARTBEAT + node_id, b"\x05")
            for node_id in _NODE_IDS
            if (cycle + node_id) % 7 == 0 and node_id not in self.silent
        ]
        before = [self.held_back] if self.held_back else []
        self.held_back = []
        if cycle % 2 and alive:
            before.append(alive)
        script = Script(before, [Frame(SYNC, b""), *self.answers()])
        if alive and not cycle % 2:
            script.with_sync[3:3] = alive
        for at, change in self._changes:
            if at == cycle:
                change(self, cycle, script)
        return script

    def deliver(self, packets: Packets) -> None:
        for frames in packets:
            records = b""
            for frame in frames:
                self._stamp_ns += _FRAME_NS
                data = frame.data.ljust(8, b"\0")
                records += protocol.STAMPED_CAN_RECORD.pack(frame.can_id, len(frame.data), 0, data, self._stamp_ns)
            self._theirs.send(protocol.HEADER.pack(protocol.KIND_CLASSICAL, self.lost) + records)

    def take(self, timeout_s: float = 0.0) -> list[Frame]:
        """What the bench has sent since the last call, or within a time; it is kept."""
        found: list[Frame] = []
        while wait_readable(self._theirs.fileno(), timeout_s):
            packet, timeout_s = self._theirs.recv(protocol.PACKET_BYTES), 0.0
            if not packet:
                break
            for can_id, size, _, data in protocol.CAN_RECORD.iter_unpack(packet[protocol.HEADER.size :]):
                found.append(Frame(can_id, data[:size]))
        self.sent += [f"{frame.can_id:03X}#{frame.data.hex()}" for frame in found]
        return found

    @property
    def has_something(self) -> bool:
        """Whether the bench has sent more."""
        return wait_readable(self._theirs.fileno(), 0.0)

    def close(self) -> None:
        self.ours.close()
        self._theirs.close()


class Producer:
    """Sends SYNC when the bench has said that it is there, and waits: see `SyncProducer`."""

    period_ns = 2_000_000
    is_running = True

    def __init__(self, bus: Bus) -> None:
        self.sent = self.without = 0
        self.next_ns_now = 0
        self._bus, self._cycle = bus, 0
        self._script: Script | None = None

    def go_on(self) -> None:
        self._bus.take()
        script = self._script = self._bus.script(self._cycle)
        self._cycle += 1
        self._bus.lost = script.lost or self._bus.lost
        self.sent += len(script.gone_by)
        self._bus.deliver(script.gone_by)

    @property
    def next_ns(self) -> int:
        """What the bench looks at last before it waits."""
        script, self._script = self._script, None
        if script is None:
            return self.next_ns_now
        now_ns = time.monotonic_ns()
        self.next_ns_now = now_ns + _LONG_NS if script.in_time else now_ns
        if script.joins:
            return now_ns + _LONG_NS
        self.sent += 1
        self._bus.deliver([*script.before, script.with_sync, *script.later])
        return now_ns

    def tell_lateness(self, to: array[int]) -> None:
        to.append(0)

    def check(self, waited_s: float) -> None:
        raise AssertionError(f"waited {waited_s} s for SYNC")


class Answering(threading.Thread):
    """The same where the bench sends SYNC itself: what is before it comes when its set points are there."""

    def __init__(self, bus: Bus) -> None:
        super().__init__(daemon=True)
        self._bus = bus
        self.end = threading.Event()
        self.was_late = False  #: SYNC was out before what is to come before it

    def run(self) -> None:
        """Until the `end`."""
        cycle, script = 0, None
        while not self.end.is_set():
            frames = self._bus.take(0.01)
            self.was_late |= script is None and Frame(SYNC, b"") in frames
            for frame in frames:
                if script is None:
                    script = self._bus.script(cycle)
                    self._bus.deliver(script.before)
                    self.was_late |= self._bus.has_something
                if frame.can_id == SYNC:
                    self._bus.deliver([script.with_sync[1:], *script.later])
                    cycle, script = cycle + 1, None


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
        resources.enter_context(patch.object(time, "time_ns", lambda: _EPOCH_NS))
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


# -- what comes between ----------------------------------------------------------------------------------------------


def _without(bus: Bus, script: Script, cob_id: int) -> Frame:
    """An answer stays away."""
    frame = next(frame for frame in script.with_sync if frame.can_id == cob_id)
    script.with_sync.remove(frame)
    script.in_time = False
    bus.withheld += 1
    return frame


def misses(cob_id: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        _without(bus, script, cob_id)

    return change


def comes_late(cob_id: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.held_back.append(_without(bus, script, cob_id))

    return change


def hears(*frames: Frame, at: int = 4) -> Change:
    """Behind SYNC."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        script.with_sync[at:at] = frames

    return change


def hears_before(*frames: Frame) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        script.before.append(list(frames))

    return change


def in_packets(bus: Bus, cycle: int, script: Script) -> None:
    """The answers one by one."""
    script.later, script.with_sync = [[frame] for frame in script.with_sync[2:]], script.with_sync[:2]


def goes_by(syncs: int, *, joins: bool) -> Change:
    """So many SYNCs are out when the bench comes."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        found = [script.with_sync, *([Frame(SYNC, b""), *bus.answers()] for _ in range(syncs - joins))]
        script.gone_by, script.joins = found[:syncs], joins
        if not joins:
            script.with_sync = found[-1]

    return change


def counts(by: int) -> Change:
    """The twin has counted SYNCs otherwise from now on."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.count += by

    return change


def says(part: str, statusword: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.statuswords[part] = statusword

    return change


def falls_silent(bus: Bus, cycle: int, script: Script) -> None:
    bus.silent.add(2)


def loses(bus: Bus, cycle: int, script: Script) -> None:
    """The bus has dropped frames for the bench."""
    script.lost = 3


def cut_short(bus: Bus, cycle: int, script: Script) -> None:
    frame = script.with_sync[2]
    script.with_sync[2] = frame._replace(data=frame.data[:-1])
    script.in_time = False  # it is no answer
    bus.withheld += 1


def once_more(bus: Bus, cycle: int, script: Script) -> None:
    script.with_sync.append(script.with_sync[2])


def changed_once_more(bus: Bus, cycle: int, script: Script) -> None:
    frame = script.with_sync[2]
    script.with_sync.append(frame._replace(data=bytes(8)))


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
