"""The twin in real time, whose plain cycles are compiled, against the interpreted one: the same answers, objects,
errors and estimates, whatever stays away, is late, waits, or comes between. The hub is the test: it plays to both what
a twin has heard from a bench, frame by frame, and says what their clocks show, which go on with SYNC, and so do timers.
"""

from __future__ import annotations

import socket
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.plain.test_twin_between import UPLOAD, Packet, frames_of, heard_by_a_twin, linked
from tests.plain_runs import CONFIGS, download, objects_of
from tests.tiers import slow

from hilbench.can import protocol
from hilbench.can.frame import Frame
from hilbench.canopen import clock
from hilbench.canopen import host as canopen_host
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.identifiers import NMT, SYNC
from hilbench.plain import host as serving
from hilbench.plain.host import is_heartbeat
from hilbench.runs.config import load_with_overrides
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.plain_run import ClockedTwinRun
from hilbench.twin.process import TwinApplication, twin
from hilbench.twin.run import plain_host
from hilbench.twin.setup import twin_setup

#: From a SYNC to the answers; before the next one to the set points, which follow them.
ANSWERED_NS, TOLD_NS = 300_000, 1_200_000
#: A cycle that is changed: the machine is released, and compiled cycles have begun; and one more, later.
CHANGED, AGAIN = 80, 150
#: The virtual I/O, and its TPDO with number of the SYNC, age and status.
IO, STATUS = 32, 0x3A0


@dataclass
class Cycle:
    """What comes with a SYNC at its time, and behind it."""

    at_ns: int
    before: list[Frame]  #: the last is SYNC
    answers: list[Frame]


#: A frame, or several that were not read before the last of them came, and when.
Comes = tuple[int, list[Frame]]
Change = Callable[[Cycle], list[Comes]]


def as_they_come(cycle: Cycle) -> list[Comes]:
    """A cycle in which all is in time, frame by frame."""
    *told, sync = cycle.before
    return [
        *((cycle.at_ns - TOLD_NS + 1000 * k, [frame]) for k, frame in enumerate(told)),
        (cycle.at_ns, [sync]),
        *((cycle.at_ns + ANSWERED_NS + 1000 * k, [frame]) for k, frame in enumerate(cycle.answers)),
    ]


@dataclass
class Heard:
    """What a twin has heard: until SYNC begins, and then cycle by cycle."""

    config: str
    cycle_ns: int
    first: list[Packet]
    cycles: list[Cycle]


def heard_beside(folder: Path, config: str, path: str) -> Heard:
    """A bench at something that is set."""
    setup = twin_setup(load_with_overrides(CONFIGS / f"{config}.yaml").config)
    axes = {AxisListener(axis, setup.cycle_s).cob_id for axis in setup.real_axes}
    packets = heard_by_a_twin(folder, config, path)
    begin = next(k for k, packet in enumerate(packets) if packet[-1].can_id == SYNC)
    found, before = Heard(config, round(1e9 * setup.cycle_s), packets[:begin], []), list[Frame]()
    for frame in (frame for packet in packets[begin:] for frame in packet):
        if frame.can_id in axes:
            found.cycles[-1].answers.append(frame)
            continue
        before.append(frame)
        if frame.can_id == SYNC:
            found.cycles.append(Cycle((len(found.cycles) + 1) * found.cycle_ns, before, []))
            before = []
    return found


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Heard:
    return heard_beside(tmp_path_factory.mktemp("heard"), "web_section_step", "line_speed_m_s")


@dataclass
class Twin:
    """A twin in real time: what it has said by COB-ID, and when; how it was left, and SYNCs that it has answered
    compiled."""

    compiled: bool
    options: Sequence[str] = ()
    said: dict[int, list[tuple[int, bytes]]] = field(default_factory=lambda: defaultdict(list))
    left: dict[str, object] = field(default_factory=dict)
    answered: int = 0
    interrupted: Counter[str] = field(default_factory=Counter)  #: compiled cycles, by what was waited for

    def play(self, heard: Heard, all_that_comes: Sequence[Comes]) -> Twin:
        path = CONFIGS / f"{heard.config}.yaml"
        setup = twin_setup(load_with_overrides(path, pace="realtime", changes=self.options).config)
        self._now_ns, end = 0, ClockedTwinRun.end

        def ended(run: ClockedTwinRun) -> None:
            self.answered += run._answers._cycles
            self.interrupted["answers" if run._awaits else "SYNC"] += 1
            end(run)

        with self._clocks(), linked() as (link, hub), patch.object(ClockedTwinRun, "end", ended):
            hosted = twin(setup)
            host = DeviceHost(link, *hosted)
            plain = plain_host(host, link, hosted, setup)
            assert plain is not None
            serve = plain.serve if self.compiled else host.serve
            host.boot()
            for packet in heard.first:
                self._serve(hub, [packet], serve)
            for at_ns, frames in all_that_comes:
                if not frames or any(frame.can_id == SYNC for frame in frames):
                    self._now_ns = max(self._now_ns, at_ns)
                self._serve(hub, [[frame] for frame in frames], serve)
            plain.settle()
        self._look_at(hosted)
        return self

    def _look_at(self, hosted: HostedDevices) -> None:
        application, now_ns = hosted.application, {"_now_ns": None}
        assert isinstance(application, TwinApplication)
        clock = application._clock
        assert clock is not None
        bus_cycle = clock._cycle
        self.left = {
            "objects": objects_of([hosted]),
            "counted": (application.missed, application.surplus, application.malformed),
            "SYNCs": (application._sync_number, application._owed, application._skipped, application._apart),
            "time": (application._time_s, application._kept_s),
            "ways": vars(application._ways),
            "SYNC by the clock": vars(bus_cycle) | now_ns | {"_sync": vars(bus_cycle._sync)},
            "published": list(application._machine.published()),
            "state": repr(application._machine.in_use.plant.get_state()),
        }

    @contextmanager
    def _clocks(self) -> Iterator[None]:
        shown = SimpleNamespace(monotonic_ns=lambda: self._now_ns, monotonic=lambda: 1e-9 * self._now_ns)
        with ExitStack() as stack:
            for module in (clock, canopen_host, serving):
                stack.enter_context(patch.object(module, "time", shown))
            yield

    def _serve(self, hub: socket.socket, packets: Sequence[Packet], serve: Callable[[float], None]) -> None:
        for packet in packets:
            records = [
                protocol.STAMPED_CAN_RECORD.pack(frame.can_id, len(frame.data), 0, frame.data, 0) for frame in packet
            ]
            hub.send(protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0) + b"".join(records))
        for _ in range(2 + len(packets)):
            serve(0.0)
        while True:
            try:
                packet = frames_of(hub.recv(protocol.PACKET_BYTES, socket.MSG_DONTWAIT), protocol.CAN_RECORD)
            except BlockingIOError:
                return
            for frame in packet:
                self.said[frame.can_id].append((self._now_ns, frame.data))


def played(heard: Heard, changes: dict[int, Change]) -> list[Comes]:
    """All that comes, with some cycles changed, by their number."""
    found = [each for k, cycle in enumerate(heard.cycles) for each in changes.get(k, as_they_come)(cycle)]
    return sorted(found, key=lambda each: each[0])


def check(heard: Heard, all_that_comes: Sequence[Comes], least: int, options: Sequence[str] = ()) -> Twin:
    """Both twins make the same of it; so many SYNCs are answered compiled at least."""
    one, other = (Twin(compiled, options).play(heard, all_that_comes) for compiled in (True, False))
    for can_id in {*one.said, *other.said}:
        (whens, whats), (others_whens, others_whats) = (
            zip(*each.said[can_id], strict=True) if each.said[can_id] else ((), ()) for each in (one, other)
        )
        assert whats == others_whats
        # That a node is alive it says with the next SYNC, or where that does not come.
        apart_ns = 2 * heard.cycle_ns if is_heartbeat(can_id) else 0
        assert all(abs(when - others) <= apart_ns for when, others in zip(whens, others_whens, strict=True))
    assert one.left == other.left
    assert one.answered >= least
    assert other.answered == 0
    return one


@pytest.mark.parametrize(
    ("config", "path", "options"),
    [
        ("web_section_step", "line_speed_m_s", []),
        *slow(
            ("web_section_step", "line_speed_m_s", ["twin.estimate.0.method=ekf"]),
            ("web_section_step", "line_speed_m_s", ["twin.transfer.axes=true"]),
            ("line_three_spans", "line_speed_m_s", []),
            ("line_with_dancer", "line_speed_m_s", []),
            ("line_with_dancer", "line_speed_m_s", ["controllers.dancer_position.force={}"]),
            ("servo_axis", "speed_rad_s", []),
        ),
    ],
)
def test_cycles_in_which_all_is_in_time(config: str, path: str, options: list[str], tmp_path: Path) -> None:
    heard = heard_beside(tmp_path, config, path)
    check(heard, played(heard, {}), 200, options)


# -- what happens to a cycle -----------------------------------------------------------------------------------------


def missed(cycle: Cycle) -> list[Comes]:
    """The bench leaves it out."""
    return []


def answered_by(change: Callable[[list[Frame]], list[Frame]]) -> Change:
    """Answers are others."""
    return lambda cycle: as_they_come(Cycle(cycle.at_ns, cycle.before, change(cycle.answers)))


def untold(cycle: Cycle) -> list[Comes]:
    """Set points for it stay away."""
    return as_they_come(Cycle(cycle.at_ns, cycle.before[-1:], cycle.answers))


def late(by_ns: int) -> Change:
    """The second axis answers so long after SYNC."""

    def change(cycle: Cycle) -> list[Comes]:
        first, second = cycle.answers
        return [*as_they_come(Cycle(cycle.at_ns, cycle.before, [first])), (cycle.at_ns + by_ns, [second])]

    return change


def at_another_time(by_ns: int) -> Change:
    """All of it comes later."""
    return lambda cycle: [(at_ns + by_ns, frames) for at_ns, frames in as_they_come(cycle)]


def between(*frames: Frame) -> Change:
    """Somebody sends something between SYNC and its answers."""
    return lambda cycle: [*as_they_come(cycle), *((cycle.at_ns + ANSWERED_NS // 2, [frame]) for frame in frames)]


def behind(*frames: Frame) -> Change:
    """The same behind the answers."""
    return lambda cycle: [*as_they_come(cycle), *((cycle.at_ns + 2 * ANSWERED_NS, [frame]) for frame in frames)]


def read_late(cycle: Cycle) -> list[Comes]:
    """All but its set points are read at once."""
    *told, sync, first, second = as_they_come(cycle)
    return [*told, (second[0], [*sync[1], *first[1], *second[1]])]


OTHER_METHOD = download(IO, 0x2101, 2, 1, 1)
FAILS = download(18, 0x2001, 0x7305, 2)
CHANGES: dict[str, Change] = {
    "missed": missed,
    "no set points": untold,
    "no answers": answered_by(lambda answers: []),
    "one answer": answered_by(lambda answers: answers[1:]),
    "an answer behind the set points": late(1_000_000),
    "an answer behind the next SYNC": late(2_100_000),
    "an answer behind that to the next SYNC": late(2_305_000),
    "answers the other way round": answered_by(lambda answers: answers[::-1]),
    "an answer twice": answered_by(lambda answers: [answers[0], *answers]),
    "answers of two senders": answered_by(lambda answers: [*answers, answers[1]._replace(data=bytes(8))]),
    "a short answer": answered_by(lambda answers: [answers[0]._replace(data=answers[0].data[:-1]), *answers]),
    "an implausible answer": answered_by(lambda answers: [answers[0], answers[1]._replace(data=b"\x40" * 8)]),
    "answers that are read with their SYNC": read_late,
    "a SYNC that jitters": at_another_time(400_000),
    "a SYNC more": lambda cycle: [*as_they_come(cycle), (cycle.at_ns + 700_000, [Frame(SYNC, b"")])],
    "an SDO between": between(UPLOAD),
    "an SDO behind": behind(UPLOAD),
    "another method between": between(OTHER_METHOD),
    "another method behind": behind(OTHER_METHOD),
    "an axis fails": behind(FAILS),
    "an axis fails between": between(FAILS),
    "heartbeats more often": behind(download(17, 0x1017, 7, 2)),
    "foreign frames": between(Frame(0x6FF, b"abc"), Frame(0x701, b"\x05")),
    "stopped": behind(Frame(NMT, bytes((2, IO)))),
    "pre-operational": between(Frame(NMT, bytes((0x80, 17)))),
    "reset": behind(Frame(NMT, bytes((0x81, IO)))),
    "an emergency stop": between(Frame(0x001, b"")),
}
OFTEN = ("missed", "an answer behind the next SYNC", "answers of two senders", "another method between")


@pytest.mark.parametrize("change", [*OFTEN, *slow(*sorted(set(CHANGES) - set(OFTEN)))])
def test_a_cycle_is_another_one(heard: Heard, change: str) -> None:
    check(heard, played(heard, dict.fromkeys((CHANGED, AGAIN), CHANGES[change])), 30)


@pytest.mark.slow
@given(changes=st.dictionaries(st.integers(60, 300), st.sampled_from(sorted(CHANGES)), max_size=8))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_cycles_are_other_ones(heard: Heard, changes: dict[int, str]) -> None:
    check(heard, played(heard, {at: CHANGES[change] for at, change in changes.items()}), 0)


# -- what lasts ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", ["catch_up", *slow("hold")])
@pytest.mark.parametrize("cycles", [2, *slow(1, 5)])
def test_a_twin_that_was_held_up_finds_all_that_has_come_at_once(heard: Heard, cycles: int, hold: str) -> None:
    comes, found, meanwhile = played(heard, {}), list[Comes](), list[Frame]()
    begin_ns = heard.cycles[CHANGED].at_ns + heard.cycle_ns // 2
    for at_ns, frames in comes:
        if begin_ns <= at_ns < begin_ns + cycles * heard.cycle_ns:
            meanwhile += frames
            continue
        if meanwhile:
            found.append((begin_ns + cycles * heard.cycle_ns, meanwhile))
            meanwhile = []
        found.append((at_ns, frames))
    twin_of_both = check(heard, found, 30, [f"twin.behind={hold}"])
    ages = {data[2] for _, data in twin_of_both.said[STATUS]}
    assert max(ages) == cycles - 1


def with_another_cycle(heard: Heard, cycle_ns: int, at: int) -> list[Comes]:
    """SYNC comes so often from a cycle on."""
    begin_ns, factor = heard.cycles[at].at_ns, cycle_ns / heard.cycle_ns
    return [
        (round(at_ns if at_ns <= begin_ns else begin_ns + factor * (at_ns - begin_ns)), frames)
        for at_ns, frames in played(heard, {})
    ]


@pytest.mark.parametrize("cycle_us", [2100, *slow(1500, 1980, 2006, 4000)])
def test_sync_comes_by_another_cycle_from_a_cycle_on(heard: Heard, cycle_us: int) -> None:
    check(heard, with_another_cycle(heard, 1000 * cycle_us, 120), 150)


@pytest.mark.slow
@pytest.mark.parametrize(("config", "path"), [("line_three_spans", "line_speed_m_s"), ("servo_axis", "speed_rad_s")])
def test_every_kind_of_twin_goes_by_another_cycle(config: str, path: str, tmp_path: Path) -> None:
    heard = heard_beside(tmp_path, config, path)
    check(heard, with_another_cycle(heard, heard.cycle_ns // 2, 0), 30)


@pytest.mark.parametrize("silent_ns", [*slow(20_000_000), 400_000_000])
def test_sync_stays_away_for_a_while(heard: Heard, silent_ns: int) -> None:
    begin_ns = heard.cycles[CHANGED].at_ns + heard.cycle_ns // 2
    polls: list[Comes] = [(begin_ns + at_ns, []) for at_ns in range(0, silent_ns, heard.cycle_ns)]
    found = [(at_ns if at_ns < begin_ns else at_ns + silent_ns, frames) for at_ns, frames in played(heard, {})]
    check(heard, sorted([*found, *polls], key=lambda each: each[0]), 30)


def test_where_every_cycle_is_interrupted_it_is_tried_ever_more_seldom(heard: Heard) -> None:
    interrupted = dict.fromkeys(range(CHANGED, len(heard.cycles)), CHANGES["an SDO between"])
    found = check(heard, played(heard, interrupted), 0)
    assert 0 < found.interrupted["answers"] <= 6  # 14 where the wait for the next is always the same
