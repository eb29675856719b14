"""The monitor beside a running bench, and the dashboard on a bus in memory."""

from __future__ import annotations

import asyncio
import getpass
import struct
import time
from pathlib import Path
from threading import Event
from typing import cast

import pytest
from tests.bench.whole_runs import config
from tests.tiers import slow
from textual.widgets import DataTable, Log, Static
from textual.widgets._footer import FooterKey

from hilbench.apps.monitor import picture as picture_of
from hilbench.apps.monitor.changes import ChangeRequests, Foreseen, OperatorJournal
from hilbench.apps.monitor.dashboard import Dashboard
from hilbench.apps.monitor.picture import BusPicture, trends_of
from hilbench.bench.lifecycle.participants import Participants
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus, MemoryLink
from hilbench.canopen.emergency_stop import EMERGENCY_STOP
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import BusError
from hilbench.exchange.nodes import Nodes
from hilbench.plant.effect import MachineKind
from hilbench.results.journal import read_journal
from hilbench.results.run import run_experiment
from hilbench.results.run_folder import RunFolder
from hilbench.results.trace import TraceReader, TraceWriter
from hilbench.runs.config import load, load_with_overrides
from hilbench.topology.config import BenchConfig
from hilbench.topology.signals import Shape, smallest_shapes

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"


def cycles(bench: BenchConfig, count: int, tension_N: float) -> list[Frame]:
    nodes = Nodes(bench)
    tpdo1 = nodes.pdo_maps("axis1")[1]
    frames = []
    for k in range(count):
        # The last SYNC of a hundred comes 50 µs late.
        frames.append(Frame(0x80, b"", k * 2_000_000 + (50_000 if k % 100 == 99 else 0) + 1))
        frames.append(Frame(tpdo1.cob_id, tpdo1.pack((0x1637, 200, 1_048_576))))
        frames.append(Frame(nodes.io.sent[0].cob_id, nodes.io.sent[0].pack((tension_N + k, 8.7e9))))
    return [*frames, Frame(0x701, b"\5"), Frame(0x82, bytes.fromhex("1186210000000000"))]


@pytest.fixture
def bench() -> BenchConfig:
    return load(SHIPPED)[0].model_copy(update={"pace": "realtime"})


def test_what_is_heard_is_decoded(bench: BenchConfig) -> None:
    picture = BusPicture(bench)
    frames = cycles(bench, 200, 80.0)
    for frame in frames:  # one at a time: nothing may depend on how many are read at once
        picture.take([frame])
    axis1 = dict(picture.as_data()["nodes"][0])
    assert (axis1["drive_state"], axis1["nmt_state"]) == ("OPERATION ENABLED", "OPERATIONAL")
    assert axis1["torque_Nm"] == pytest.approx(1.0)
    picture.take([Frame(0x701, b"\x7f")])  # a node that sends no PDOs any more is not what it was
    data = picture.as_data()
    gone = data["nodes"][0]
    assert (gone["drive_state"], gone["torque_Nm"], gone["nmt_state"]) == (None, None, "PRE-OPERATIONAL")
    assert data["F_sim_N"] == pytest.approx(278.0)  # of the cycle before the last point of the trend
    assert len(picture.trends[0].values) == 200 // picture.every
    assert data["jitter_max_us"] == pytest.approx(50.0)
    assert data["bus_load_pct"] == pytest.approx(100 * (47 + 2 * 118) / 2000, rel=0.1)
    assert [(note["part"], note["text"]) for note in data["faults"]] == [
        ("axis2", "EMCY 8611h, register 21h"),
        ("axis1", "left OPERATIONAL: PRE-OPERATIONAL"),
    ]


def test_both_axes_of_one_node_are_shown_each_with_its_own_values() -> None:
    bench = load(SHIPPED.with_name("web_section_dual_axis.yaml"))[0]
    picture, nodes = BusPicture(bench), Nodes(bench)
    first, second = (nodes.pdo_maps(part)[1] for part in ("axis1", "axis2"))
    told = [(first, (0x1637, 200, 0)), (second, (0x1218, 0, 0))]
    picture.take([Frame(0x80, b"", 1), *(Frame(pdo.cob_id, pdo.pack(values)) for pdo, values in told)])
    picture.take([Frame(0x701, b"\5"), Frame(0x81, bytes.fromhex("1186210000000000"))])
    one, two = picture.as_data()["nodes"][:2]
    assert (one["part"], one["drive_state"], one["torque_Nm"]) == ("axis1", "OPERATION ENABLED", pytest.approx(1.0))
    assert (two["part"], two["drive_state"], two["torque_Nm"]) == ("axis2", "FAULT", 0.0)
    assert (one["nmt_state"], two["nmt_state"], two["node_id"]) == ("OPERATIONAL", "OPERATIONAL", 1)
    told_of = [(note["part"], note["text"]) for note in picture.as_data()["faults"]]
    assert told_of == [("axis2", "FAULT"), ("axis1 and axis2", "EMCY 8611h, register 21h")]


def test_who_answers_late_is_shown_with_the_share(bench: BenchConfig) -> None:
    picture = BusPicture(bench)
    frames = cycles(bench, 3000, 80.0)
    late = [frame for n, frame in enumerate(frames) if not (frame.can_id == 0x181 and n // 3 % 5 == 0)]
    picture.take(late)
    shown = picture.as_data()["late_samples_pct"]
    assert shown.keys() == {"axis1"}  # the others say nothing here: they are silent, not late
    assert shown["axis1"] == pytest.approx(20.0, abs=2.0)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that are sent once are what a bench says all the time."""
    monkeypatch.setattr(picture_of, "SILENCE_S", 1e9)


def dashboard_of(
    bench: BenchConfig, bus: MemoryBus, link: MemoryLink | None = None, operator_journal: OperatorJournal | None = None
) -> Dashboard:
    changes = ChangeRequests(bench, lambda: SdoClient(bus.open_python_can(), 30.0))
    return Dashboard(
        BusPicture(bench),
        link or bus.open_link(),
        changes,
        operator_journal or OperatorJournal(Path("none"), "memory", 1),
    )


def test_the_dashboard_shows_it_and_sends_nothing(bench: BenchConfig, patient: None) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def watch() -> tuple[str, str, int]:
        async with dashboard.run_test(size=(110, 36)) as pilot:
            theirs.send(cycles(bench, 100, 80.0))
            table = dashboard.query_one("#nodes", DataTable)
            while not (table.row_count and table.get_row_at(0)[3] == "OPERATION ENABLED"):
                await pilot.pause(0.05)
            await pilot.pause(0.3)
            figures = str(dashboard.query_one("#figures", Static).render())
            tension = str(dashboard.query_one("#F_sim_N-value", Static).render())
            return figures, tension, dashboard.query_one("#faults", Log).line_count

    figures, tension, faults = asyncio.run(asyncio.wait_for(watch(), 30.0))
    assert "cycle 100" in figures
    assert tension.startswith("tension: 178.0 N")
    assert faults
    assert theirs.receive(0.0) == []


#: SDO write of 95.0 to 2200h:2 of node 127, its confirmation, and a refusal: too high.
ASKED, DONE, TOO_HIGH = (bytes.fromhex(text) for text in ("230022020000be42", "6000220200000000", "8000220231000906"))


#: Keys, what they send, the bench's answer, and what the monitor says then.
PRESSED = [
    (["t", "9", "5", "enter", "n"], [], None, ""),
    (["t", "escape"], [], None, ""),
    (["t", "enter"], [], None, ""),
    (["e", "n"], [], None, ""),
    (["t", "9", "5", "enter", "y"], [Frame(0x67F, ASKED)], DONE, "tension set-point 95 N: set"),
    (
        ["t", "9", "5", "enter", "y"],
        [Frame(0x67F, ASKED)],
        TOO_HIGH,
        "tension set-point 95 N: refused, expected 0 to 300 N (abort 06090031h)",
    ),
    (["e", "y"], 3 * list(EMERGENCY_STOP), None, "emergency stop sent"),
]


def test_who_stops_the_machine_is_shown_that_it_is_stopped(bench: BenchConfig, patient: None) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def stop() -> str:
        async with dashboard.run_test(size=(110, 36)) as pilot:
            theirs.send(cycles(bench, 20, 80.0))
            await pilot.press("e", "y")
            while not theirs.receive(0.0):
                await pilot.pause(0.05)
            theirs.send([Frame(0x000, b"\x80\x00")])  # and then the bench lets its nodes go
            await pilot.pause(0.5)
            return str(dashboard.query_one("#condition", Static).render())

    assert asyncio.run(asyncio.wait_for(stop(), 30.0)).startswith("E-STOP")


def test_only_a_confirmed_key_sends(bench: BenchConfig) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def press() -> None:
        async with dashboard.run_test(size=(110, 36)) as pilot:
            log = dashboard.query_one("#faults", Log)
            for keys, sent, answer, said in PRESSED:
                before = log.line_count
                await pilot.press(*keys)
                received: list[Frame] = []
                while len(received) < len(sent):
                    await pilot.pause(0.05)
                    received += theirs.receive(0.0)
                if answer is not None:
                    theirs.send([Frame(0x5FF, answer)])
                while said and not any(said in line for line in log.lines):
                    await pilot.pause(0.05)
                await pilot.pause(0.2)  # what must not be sent would be by now
                received += theirs.receive(0.0)
                # What nobody has read yet competes by identifier.
                assert sorted(frame[:2] for frame in received) == sorted(frame[:2] for frame in sent), keys
                assert log.line_count == before + bool(said), keys

    asyncio.run(asyncio.wait_for(press(), 60.0))


@pytest.mark.parametrize("keys", [("t", "9", "9", "9"), ("v", "9", ".", "5"), ("w", "t", "9", "9", "9")])
def test_a_value_beyond_its_range_can_not_be_confirmed(bench: BenchConfig, keys: tuple[str, ...]) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def press() -> tuple[object, object, object]:
        async with dashboard.run_test(size=(80, 24)) as pilot:
            whole = dashboard.screen
            await pilot.press(*keys)
            field = dashboard.screen
            await pilot.press("enter", "y")
            await pilot.pause(0.2)
            still = dashboard.screen
            await pilot.press("escape")
            return whole is field, still is field, dashboard.screen is whole

    assert asyncio.run(asyncio.wait_for(press(), 30.0)) == (False, True, True)
    assert theirs.receive(0.0) == []


def test_what_is_said_is_whole_in_a_terminal_of_80_columns(bench: BenchConfig) -> None:
    dashboard = dashboard_of(bench, MemoryBus())
    told = "what if line speed 2 m/s: within 2 s tension 70.1 to 95.3 N, torque of axis1 -0.4 to 0.7 N·m, " * 3

    async def say() -> list[str]:
        async with dashboard.run_test(size=(80, 24)) as pilot:
            dashboard._notify(told)
            await pilot.pause(0.1)
            return list(dashboard.query_one("#faults", Log).lines)

    lines = asyncio.run(asyncio.wait_for(say(), 30.0))
    assert max(map(len, lines)) <= 80
    assert told.split() == " ".join(lines).split("monitor:")[1].split()


def test_a_monitor_that_hears_nothing_says_of_which_runs_it_can_not(bench: BenchConfig) -> None:
    assert "--in-process" in BusPicture(bench).condition_text


#: SDO writes of 1 and of 0 to 2200h:7 and :8 of node 127, and their confirmations.
YES_NO = {
    ("p", "y"): ("230022070000803f", "6000220700000000", "probe: yes: set"),
    ("p", "n"): ("2300220700000000", "6000220700000000", "probe: no: set"),
    ("c", "y"): ("230022080000803f", "6000220800000000", "model change: yes: set"),
    ("c", "n"): ("2300220800000000", "6000220800000000", "model change: no: set"),
    ("p", "escape"): ("", "", ""),
    ("c", "escape"): ("", "", ""),
}


@pytest.mark.slow
def test_a_probe_and_a_proposed_model_are_allowed_or_refused_by_two_keys() -> None:
    changes = ["twin.live_diagnosis={}", "controllers.tension_control.probing=ask", "pace=realtime"]
    bench = load_with_overrides(SHIPPED, changes=changes).config
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def press() -> None:
        async with dashboard.run_test(size=(110, 36)) as pilot:
            log = dashboard.query_one("#faults", Log)
            for keys, (sent, answer, said) in YES_NO.items():
                await pilot.press(*keys)
                received: list[Frame] = []
                while sent and not received:
                    await pilot.pause(0.05)
                    received = theirs.receive(0.0)
                if answer:
                    theirs.send([Frame(0x5FF, bytes.fromhex(answer))])
                while said and not any(said in line for line in log.lines):
                    await pilot.pause(0.05)
                await pilot.pause(0.2)
                received += theirs.receive(0.0)
                assert [frame[:2] for frame in received] == ([(0x67F, bytes.fromhex(sent))] if sent else []), keys

    asyncio.run(asyncio.wait_for(press(), 60.0))


def test_what_somebody_does_at_the_terminal_stands_in_the_journal_with_who_it_was(
    bench: BenchConfig, tmp_path: Path
) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    folder = RunFolder.create(tmp_path, "run")
    folder.journal.touch()
    dashboard = dashboard_of(bench, bus, ours, OperatorJournal(tmp_path, ours.channel, bench.cycle_ns))

    async def act() -> None:
        async with dashboard.run_test(size=(110, 36)) as pilot:
            await pilot.press("t", "9", "5", "enter", "y")
            while not theirs.receive(0.0):
                await pilot.pause(0.05)
            theirs.send([Frame(0x5FF, bytes.fromhex("6000220200000000"))])
            while not folder.journal.read_bytes():
                await pilot.pause(0.05)
            await pilot.press("e", "e")
            while len(read_journal(folder.journal)) < 2:
                await pilot.pause(0.05)

    with TraceWriter(folder.trace, ours.channel) as trace:  # whoever writes it: the run goes on
        trace.write(cycles(bench, 7, 80.0))
        trace.end_cycle()
        asyncio.run(asyncio.wait_for(act(), 60.0))
    who = f"{getpass.getuser()} (terminal)"
    assert [
        (change.cycle, change.what, change.path, change.value, change.who) for change in read_journal(folder.journal)
    ] == [
        (7, "asked", "tension set-point 95 N: set", 95.0, who),
        (7, "asked", "emergency stop", 0.0, who),
    ]


def test_keys_of_what_a_bench_has_not_do_not_exist(bench: BenchConfig) -> None:
    dashboard = dashboard_of(bench, MemoryBus())
    keys = set(dashboard._bindings.key_to_bindings)
    assert {"w", "v", "t", "m"} <= keys
    assert not {"p", "c"} & keys


class Node:
    """A bench's node as who asks it sees it: a set-point of 80 N, E of 8700 N/mm²."""

    def upload(self, node_id: int, index: int, sub: int) -> bytes:
        return struct.pack("<f", {1: 2.0, 2: 80.0, 3: 8.7e9}[sub])

    def close(self) -> None:
        """Nothing was opened."""


def test_what_would_come_is_said_from_what_the_monitor_has_heard(tmp_path: Path) -> None:
    steps = [{"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 1.0}}, {"hold": {"duration_s": 1.0}}]
    loaded = load_with_overrides(config(tmp_path, steps=steps))
    outcome = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS)
    frames = list(TraceReader(outcome.folder.trace))
    ends = [at for at, frame in enumerate(frames) if frame.can_id == 0x80]
    requests = ChangeRequests(loaded.config, lambda: cast("SdoClient", Node()))
    received = frames[ends[700] : ends[900]]  # 1.4 to 1.8 s after the first SYNC
    requests.look_ahead(requests.foreseeable["v"], 9.0, received)
    (said,) = ended(requests)
    assert said.startswith("what if line speed 9 m/s: within ")
    assert "tension of the web" in said
    # From 2 to 8 m/s at the 3 m/s² at which the bench moves the speed.
    assert "speed of axis 2 beyond its warning level 8 m/s in 2.0 s, probability 100 %" in said, said


def test_a_change_does_not_wait_until_somebody_has_looked_ahead(bench: BenchConfig) -> None:
    read, told = Event(), Event()

    class Slow(Node):
        def download(self, node_id: int, index: int, sub: int, data: bytes) -> None:
            told.set()

    class Looking(ChangeRequests):
        def _looked_ahead(self, *asked: object) -> Foreseen:
            read.set()
            assert told.wait(30.0)
            return Foreseen("seen")

    requests = Looking(bench, lambda: cast("SdoClient", Slow()))
    seen = requests.look_ahead(requests.foreseeable["t"], 90.0, [])
    assert read.wait(30.0)
    assert requests.ask(requests.changeable["t"], 90.0).result(30.0) == "tension set-point 90 N: set"
    assert str(seen.result(30.0)) == "seen"
    assert requests.ended() == ["seen", "tension set-point 90 N: set"]
    requests.close()


def test_nothing_is_foreseen_of_a_bench_that_is_not_heard(bench: BenchConfig) -> None:
    requests = ChangeRequests(bench, lambda: cast("SdoClient", Node()))
    requests.look_ahead(requests.foreseeable["t"], 90.0, [])
    (said,) = ended(requests)
    assert "expected a bench that runs" in said


@pytest.mark.parametrize(
    "opened",
    [
        ["t"],
        *slow(["v", "2"], ["t", "9", "5", "enter"], ["m", "9", "0", "0", "0", "enter"], ["w"], ["w", "v", "5"]),
        [],
    ],
)
@pytest.mark.parametrize("confirmed", ["y", "e"])
def test_the_emergency_stop_works_in_every_dialogue(bench: BenchConfig, opened: list[str], confirmed: str) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def press() -> list[Frame]:
        async with dashboard.run_test(size=(40, 20)) as pilot:
            await pilot.press(*opened, "e")
            await pilot.pause(0.1)
            assert not theirs.receive(0.0)
            await pilot.press(confirmed)
            received: list[Frame] = []
            while len(received) < 3 * len(EMERGENCY_STOP):
                await pilot.pause(0.05)
                received += theirs.receive(0.0)
            await pilot.pause(0.2)
            assert len(dashboard.screen_stack) == 1  # no dialogue is left that would take the next keys
            return received + theirs.receive(0.0)

    received = asyncio.run(asyncio.wait_for(press(), 60.0))
    assert sorted(frame[:2] for frame in received) == sorted(frame[:2] for frame in 3 * list(EMERGENCY_STOP))


@pytest.mark.parametrize("columns", [40, 60, 200])
def test_the_emergency_stop_is_first_in_the_footer_and_whole(bench: BenchConfig, columns: int) -> None:
    dashboard = dashboard_of(bench, MemoryBus())

    async def look() -> tuple[str, str, int, int]:
        async with dashboard.run_test(size=(columns, 20)) as pilot:
            while not any(key.region.width for key in dashboard.query(FooterKey)):  # until it is drawn
                await pilot.pause(0.05)
            first = min((key for key in dashboard.query(FooterKey) if key.region.width), key=lambda key: key.region.x)
            return first.key, first.description, first.region.x, first.region.right

    key, description, left, right = asyncio.run(asyncio.wait_for(look(), 30.0))
    assert (key, description) == ("e", "EMERGENCY STOP")
    assert 0 <= left < right <= columns
    assert right - left >= len("e EMERGENCY STOP")


def ended(requests: ChangeRequests) -> list[str]:
    said: list[str] = []
    deadline_s = time.monotonic() + 30.0
    while not said and time.monotonic() < deadline_s:
        time.sleep(0.01)
        said = requests.ended()
    requests.close()
    return said


def test_a_bench_that_does_not_answer_is_said(bench: BenchConfig) -> None:
    requests = ChangeRequests(bench, lambda: SdoClient(MemoryBus().open_python_can(), 0.1))
    requests.ask(requests.changeable["v"], 2.0)
    assert ended(requests) == ["line speed 2 m/s: no answer from the bench (node 127)"]


def test_a_bus_that_cannot_be_joined_is_said(bench: BenchConfig) -> None:
    def refuse() -> SdoClient:
        raise BusError("vcan9: no such interface")

    requests = ChangeRequests(bench, refuse)
    requests.ask(requests.changeable["v"], 2.0)
    assert ended(requests) == ["line speed 2 m/s: NOT SENT: vcan9: no such interface"]


#: What ends a cycle of frames that are heard every 0.1 s, what the monitor calls the bench 3 s later, and why.
ENDS = [
    ([], "STALE", "no SYNC for 3 s, nothing of the bench either"),
    ([Frame(0x000, b"\x80\x00")], "ENDED", "the bench has let its nodes go"),
    ([Frame(0x000, b"\x02\x00")], "ENDED", "the bench has let its nodes go"),
    ([*EMERGENCY_STOP], "E-STOP", "an emergency stop was received"),
    ([Frame(0x000, b"\x80\x01")], "STALE", "nothing of the bench"),  # one node's own affair
]


def running(bench: BenchConfig) -> BusPicture:
    picture = BusPicture(bench)
    frames = [*cycles(bench, 50, 80.0)[:-1], Frame(0x7A0, b"\5"), Frame(0x77F, b"\5")]
    for k in range(20):
        picture.take(frames, 0.1 * k)
    data = picture.as_data()
    assert (data["condition"], data["nodes"][0]["drive_state"]) == ("running", "OPERATION ENABLED")
    assert data["F_sim_N"] is not None
    return picture


@pytest.mark.parametrize(("last", "word", "why"), ENDS, ids=["silent", "let go", "stopped", "e-stop", "one node"])
def test_a_bench_that_does_not_run_has_no_values(bench: BenchConfig, last: list[Frame], word: str, why: str) -> None:
    picture = running(bench)
    picture.take(last, 2.0)
    picture.take([], 4.9)
    data = picture.as_data()
    assert data["condition"] == word
    assert why in data["condition_text"]
    assert (data["F_sim_N"], data["E_sim_Pa"]) == (None, None)
    assert {node[key] for node in data["nodes"] for key in ("drive_state", "torque_Nm", "statusword")} == {None}
    # The nodes are started again, and SYNC goes on.
    picture.take([Frame(0x000, b"\x01\x00"), *cycles(bench, 50, 80.0)], 6.0)
    again = picture.as_data()
    assert (again["condition"], again["nodes"][0]["drive_state"]) == ("running", "OPERATION ENABLED")
    assert again["F_sim_N"] is not None


def test_the_cycles_are_those_of_this_run(bench: BenchConfig) -> None:
    picture = running(bench)
    picture.take([Frame(0x000, b"\x80\x00")], 2.0)
    assert picture.cycles == 1000
    picture.take([Frame(0x000, b"\x01\x00"), *cycles(bench, 20, 80.0)], 6.0)
    assert (picture.cycles, picture.as_data()["condition"]) == (20, "running")


def test_sync_alone_does_not_end_an_emergency_stop(bench: BenchConfig) -> None:
    picture = running(bench)
    picture.take([*EMERGENCY_STOP, Frame(0x080, b"")], 2.0)  # the bench goes on to see whether the drives have stopped
    assert picture.as_data()["condition"] == "E-STOP"


def test_a_script_that_pauses_is_told_from_a_bench_that_is_gone(bench: BenchConfig) -> None:
    picture = running(bench)
    for k in range(20, 60):
        picture.take([Frame(0x77F, b"\5")], 0.1 * k)
    assert picture.as_data()["condition_text"] == "STALE: no SYNC for 4 s, the bench pauses"


def test_of_a_node_that_falls_silent_nothing_old_is_shown(bench: BenchConfig) -> None:
    picture = running(bench)
    # The twin is gone, the bench goes on without it.
    others = [frame for frame in cycles(bench, 50, 80.0) if frame.can_id < 0x1A0 or frame.can_id == 0x701]
    for k in range(20, 60):
        picture.take(others, 0.1 * k)
    data = picture.as_data()
    assert (data["condition"], data["F_sim_N"]) == ("running", None)
    stale = {node["node_id"] for node in data["nodes"] if node["stale"]}
    assert stale == {32}
    assert data["nodes"][0]["drive_state"] == "OPERATION ENABLED"


def test_a_slow_bench_in_lockstep_is_not_stale_while_it_answers(bench: BenchConfig) -> None:
    picture = BusPicture(bench.model_copy(update={"pace": "lockstep"}))
    cycle = cycles(bench, 1, 80.0)[:-2]
    for k in range(40):  # heartbeats come with every 50th cycle: two cycles a second here
        beat = [Frame(0x701, b"\5")] if k % 20 == 0 else []
        picture.take([*cycle, *beat], 0.5 * k)
    nodes = picture.as_data()["nodes"]
    assert (nodes[0]["nmt_state"], nodes[0]["stale"]) == ("OPERATIONAL", False)


def test_the_frames_of_a_whole_run_are_waited_for_run_and_ended(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path, steps=[{"hold": {"duration_s": 0.5}}]))
    outcome = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS)
    picture = BusPicture(loaded.config)
    seen = [picture.as_data()["condition"]]
    for frame in TraceReader(outcome.folder.trace):
        picture.take([frame], 1e-9 * frame.time_ns)
        if picture.as_data()["condition"] != seen[-1]:
            seen.append(picture.as_data()["condition"])
    assert seen == ["not received", "running", "ENDED"]


def test_the_dashboard_says_it_instead_of_old_values(bench: BenchConfig, patient: None) -> None:
    bus = MemoryBus()
    ours, theirs = bus.open_link(), bus.open_link()
    dashboard = dashboard_of(bench, bus, ours)

    async def watch() -> list[tuple[str, ...]]:
        seen = []
        async with dashboard.run_test(size=(110, 36)) as pilot:
            received = ([], "not received"), (cycles(bench, 100, 80.0), "running"), ([*EMERGENCY_STOP], "E-STOP")
            for frames, said in received:
                theirs.send(frames)
                while not str(dashboard.query_one("#condition", Static).render()).startswith(said):
                    await pilot.pause(0.05)
                await pilot.pause(0.3)
                tension = str(dashboard.query_one("#F_sim_N-value", Static).render())
                row = dashboard.query_one("#nodes", DataTable).get_row_at(0)
                seen.append((tension, row[3], row[6]))
        return seen

    before, runs, stopped = asyncio.run(asyncio.wait_for(watch(), 60.0))
    assert before == ("tension: not received", "-", "-")
    assert runs[0].startswith("tension: 178.0 N")
    assert runs[1:] == ("OPERATION ENABLED", "1.000")
    assert stopped == ("tension: E-STOP", "E-STOP", "-")


def test_of_a_line_the_trends_have_the_tension_of_every_span_controlled_or_not() -> None:
    shape = Shape(axes=4, load_motors=(), spans=3, estimated=(3,), controlled=(1, 3))
    found = {trend.signal: trend.unit for trend in trends_of(MachineKind.WEB_LINE, shape)}
    assert {signal: found[signal] for signal in ("F1_sim_N", "F2_sim_N", "F3_sim_N")} == {
        "F1_sim_N": "N",
        "F2_sim_N": "N",
        "F3_sim_N": "N",
    }


def test_of_a_servo_axis_the_trends_are_its_inertia_and_friction() -> None:
    inertia, friction = trends_of(MachineKind.SERVO_AXIS, smallest_shapes()["servo_axis"])
    assert (inertia.signal, inertia.title, inertia.unit) == ("J_sim_kg_m2", "J", "kg·cm²")
    assert (friction.signal, friction.title, friction.unit) == ("coulomb_sim_Nm", "friction", "N·m")
    inertia.values.append(2.5e-3)
    assert inertia.shown == [pytest.approx(25.0)]
