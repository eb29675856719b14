"""Viewers of a bench on a bus in memory, without a browser: what they see, what they may do, and who is told of it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect
from tests.pages.told_samples import keep

from hilbench.apps.library.live_run import LiveRun
from hilbench.apps.monitor.changes import ChangeRequests
from hilbench.apps.pages.access import Access
from hilbench.apps.pages.live.controls import Controls
from hilbench.apps.pages.live.listener import Listener
from hilbench.apps.pages.live.viewer import Viewers
from hilbench.apps.pages.server import site
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus, MemoryLink
from hilbench.canopen.emergency_stop import EMERGENCY_STOP
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import BusError
from hilbench.exchange.nodes import Nodes
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
HERE = "http://127.0.0.1:8321"
PATIENCE_S = 30.0

#: SDO write of 95.0 to 2200h:2 of node 127, its confirmation, and a refusal: too high.
ASKED, DONE, TOO_HIGH = (bytes.fromhex(text) for text in ("230022020000be42", "6000220200000000", "8000220231000906"))


class Place:
    """A bus in memory with a listener on it, its pages, and the other end of the bus."""

    def __init__(self, bench: BenchConfig, runs: Path) -> None:
        self.bench = bench
        self.bus = MemoryBus()
        self.far: MemoryLink = self.bus.open_link()
        self.listener = Listener(bench, self.bus.open_link, partial(LiveRun.on, runs))
        changes = ChangeRequests(bench, lambda: SdoClient(self.bus.open_python_can(), PATIENCE_S))
        self.controls = Controls(self.listener, changes)
        self.access = Access("127.0.0.1", 8321)
        self.client = TestClient(site(self.access, [], Viewers(self.listener, self.controls)), base_url=HERE)

    def viewer(self, known: str | None = None) -> Viewer:
        return Viewer(self.client.websocket_connect(f"ws{HERE[4:]}/live", headers={"Origin": HERE}), known)

    def received(self, count: int) -> list[Frame]:
        frames: list[Frame] = []
        until_s = time.monotonic() + PATIENCE_S
        while len(frames) < count and time.monotonic() < until_s:
            frames += self.far.receive(0.05)
        return frames


class Viewer:
    """One connection, and what it was told last."""

    def __init__(self, socket: WebSocketTestSession, known: str | None) -> None:
        self._socket = socket
        self._known = known
        self.state: dict[str, Any] = {}
        self.events: list[str] = []
        self.samples: dict[str, list[float]] = {}

    def __enter__(self) -> Viewer:
        self._socket.__enter__()
        self._socket.send_json({"viewer": self._known})
        self.layout = self._socket.receive_json()
        return self

    def __exit__(self, *ending: Any) -> None:
        self._socket.__exit__(*ending)

    def take(self) -> dict[str, Any]:
        message = self._socket.receive()
        if message.get("bytes") is not None:
            keep(self.samples, self.layout["signals"], message["bytes"])
            return {"kind": "samples"}
        if message["type"] != "websocket.send":
            raise WebSocketDisconnect(message.get("code", 0))
        import json

        told: dict[str, Any] = json.loads(message["text"])
        if told["kind"] == "state":
            self.state = told
            self.events += [f"{event['source']}: {event['text']}" for event in told["events"]]
        return told

    def until(self, holds: Any) -> dict[str, Any]:
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            told = self.take()
            if holds(self, told):
                return told
        raise AssertionError(f"did not come; last state {self.state}, events {self.events}")

    def said(self) -> tuple[str, bool]:
        told = self.until(lambda viewer, told: told["kind"] == "said")
        return told["text"], told["done"]

    def ask(self, **action: Any) -> tuple[str, bool]:
        self.send(**action)
        return self.said()

    def send(self, **action: Any) -> None:
        self._socket.send_json(action)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    bench = load_with_overrides(SHIPPED, pace="realtime").config
    place = Place(bench, tmp_path / "runs")
    place.listener.start()
    with place.client:
        place.client.post("/session", headers={"Authorization": place.access.token, "Origin": HERE})
        yield place
    place.listener.close()


def cycles(bench: BenchConfig, count: int, tension_N: float = 80.0) -> list[Frame]:
    """What a bench with enabled drives says in so many cycles."""
    nodes = Nodes(bench)
    frames = [Frame(0x000, b"\x01\x00")]
    for k in range(count):
        frames.append(Frame(0x80, b"", k * 2_000_000 + 1))
        for name in ("axis1", "axis2", "load"):
            pdo = nodes.pdo_maps(name)[1]
            frames.append(Frame(pdo.cob_id, pdo.pack((0x1637, 200, 1000 * k))))
        state = nodes.io.sent[0]
        frames.append(Frame(state.cob_id, state.pack((tension_N, 8.7e9))))
    return frames


def test_what_is_heard_is_seen_by_every_viewer(place: Place) -> None:
    with place.viewer() as first, place.viewer() as second:
        place.far.send(cycles(place.bench, 60))
        for viewer in (first, second):
            viewer.until(lambda viewer, told: viewer.state.get("cycles") == 60 and viewer.samples)
            assert viewer.state["running"]
            assert viewer.state["viewers"] == 2
            assert viewer.samples["F_sim_N"][-1] == 80.0
            axis1 = viewer.state["nodes"][0]
            assert (axis1["part"], axis1["drive_state"]) == ("axis1", "OPERATION ENABLED")


def test_a_viewer_that_comes_late_sees_what_was_before(place: Place) -> None:
    with place.viewer() as first:
        place.far.send(cycles(place.bench, 100, 85.0))
        first.until(lambda viewer, told: viewer.state.get("cycles") == 100)
    with place.viewer() as late:
        late.until(lambda viewer, told: len(viewer.samples.get("F_sim_N", ())) >= 4)
        assert set(late.samples["F_sim_N"]) == {85.0}


def test_faults_are_listed_for_all(place: Place) -> None:
    with place.viewer() as viewer:
        place.far.send([*cycles(place.bench, 5), Frame(0x82, bytes.fromhex("1186210000000000"))])
        viewer.until(lambda viewer, told: "axis2: EMCY 8611h, register 21h" in viewer.events)


def test_anybody_may_stop_the_machine_and_all_see_who(place: Place) -> None:
    with place.viewer() as anna, place.viewer() as ben:
        assert anna.ask(do="take", name="anna") == ("you control", True)
        assert ben.ask(do="stop", name="ben") == ("emergency stop sent", True)
        received = place.received(3 * len(EMERGENCY_STOP))
        assert sorted(frame[:2] for frame in received) == sorted(frame[:2] for frame in 3 * list(EMERGENCY_STOP))
        for viewer in (anna, ben):
            viewer.until(lambda viewer, told: any("emergency stop" in event for event in viewer.events))
            assert any(event.startswith("ben (testclient)") for event in viewer.events)


def test_only_who_controls_changes_anything(place: Place) -> None:
    with place.viewer() as anna, place.viewer() as ben:
        assert anna.ask(do="set", key="t", value=95.0) == ("take control first", False)
        assert anna.ask(do="take", name="anna") == ("you control", True)
        assert ben.ask(do="take", name="ben") == ("control is with anna", False)
        assert ben.ask(do="set", key="t", value=95.0) == ("control is with anna", False)
        assert ben.ask(do="answer", key="p", yes=True)[1] is False
        assert ben.ask(do="give") == ("control is not yours to give back", False)
        assert place.far.receive(0.1) == []
        ben.until(lambda viewer, told: viewer.state.get("control", {}).get("name") == "anna")
        assert not ben.state["control"]["mine"]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (DONE, ("tension set-point 95 N: set", True)),
        (TOO_HIGH, ("tension set-point 95 N: refused, expected 0 to 300 N (abort 06090031h)", False)),
    ],
)
def test_a_change_is_the_request_of_the_terminals_monitor(place: Place, answer: bytes, said: tuple[str, bool]) -> None:
    with place.viewer() as anna:
        anna.ask(do="take", name="anna")
        anna.send(do="set", key="t", value=95.0)
        assert [frame[:2] for frame in place.received(1)] == [(0x67F, ASKED)]
        place.far.send([Frame(0x5FF, answer)])
        assert anna.said() == said


def test_an_emergency_stop_does_not_wait_for_an_answer_of_the_bench(place: Place) -> None:
    with place.viewer() as anna:
        anna.ask(do="take", name="anna")
        anna.send(do="set", key="t", value=95.0)
        place.received(1)  # and nobody answers
        assert anna.ask(do="stop", name="anna") == ("emergency stop sent", True)
        place.far.send([Frame(0x5FF, DONE)])
        assert anna.said() == ("tension set-point 95 N: set", True)


def test_what_a_viewer_asked_goes_with_him_and_a_stop_behind_a_hundred_requests_does_not_wait(place: Place) -> None:
    with place.viewer() as anna:
        anna.ask(do="take", name="anna")
        for _ in range(100):
            anna.send(do="set", key="t", value=95.0)
        place.received(1)  # and nobody answers
        assert anna.ask(do="stop", name="anna") == ("emergency stop sent", True)
        place.received(len(EMERGENCY_STOP))
    with place.viewer() as ben:
        place.far.send([Frame(0x5FF, DONE)])
        ben.until(lambda viewer, told: any("95 N: set" in event for event in viewer.events))
        assert place.far.receive(0.2) == []  # what stood behind it is not asked any more


def test_control_goes_from_one_to_the_next(place: Place) -> None:
    with place.viewer() as anna, place.viewer() as ben:
        anna.ask(do="take", name="anna")
        assert anna.ask(do="give") == ("control given back", True)
        assert ben.ask(do="take", name="ben") == ("you control", True)
        ben.until(lambda viewer, told: sum("control taken" in event for event in viewer.events) == 2)


def test_who_reconnects_still_controls_and_nobody_else_can_say_so(place: Place) -> None:
    with place.viewer() as anna:
        anna.ask(do="take", name="anna")
        secret = anna.layout["viewer"]
    with place.viewer("made up") as other:
        assert other.layout["viewer"] not in (secret, "made up")
        assert other.ask(do="set", key="t", value=1.0) == ("control is with anna", False)
        assert secret not in str(other.state)
    with place.viewer(secret) as anna:
        assert anna.ask(do="give") == ("control given back", True)


@pytest.mark.parametrize(
    "action",
    [
        {},
        {"do": "nothing"},
        {"do": "set", "key": "t"},
        {"do": "set", "key": "t", "value": "95"},
        {"do": "set", "key": "t", "value": float("nan")},
        {"do": "set", "key": "zz", "value": 1.0},
        {"do": "set", "key": "t", "value": 1.0, "more": 1},
        {"do": "take", "name": ""},
        {"do": "take", "name": "<b>"},
        {"do": "take", "name": "x" * 100},
        {"do": "past", "from_s": "x"},
        {"do": "past", "from_s": None, "to_s": []},
    ],
)
def test_what_makes_no_sense_is_refused_and_the_connection_stays(place: Place, action: dict[str, Any]) -> None:
    with place.viewer() as viewer:
        viewer.ask(do="take", name="anna")
        viewer.send(**action)
        assert viewer.ask(do="give") is not None
        assert place.far.receive(0.05) == []
        viewer.until(lambda viewer, told: told["kind"] == "state")


def test_a_stranger_has_no_connection(place: Place) -> None:
    place.client.cookies.clear()
    with pytest.raises(WebSocketDisconnect), place.viewer():
        pass
    assert place.client.get("/session").status_code == 401


def test_a_viewer_that_takes_nothing_delays_nobody(place: Place) -> None:
    with place.viewer(), place.viewer() as awake:  # the first reads nothing at all
        for burst in range(20):
            place.far.send(cycles(place.bench, 50)[1 if burst else 0 :])
            awake.until(lambda viewer, told, received=50 * (burst + 1): viewer.state.get("cycles") == received)
        assert awake.ask(do="stop", name="anna")[1]


def test_the_past_can_be_looked_at_closely(place: Place) -> None:
    with place.viewer() as viewer:
        place.far.send(cycles(place.bench, 200))
        viewer.until(lambda viewer, told: viewer.state.get("cycles") == 200)
        viewer.send(do="past", from_s=0.1, to_s=0.2)
        while True:
            message = viewer._socket.receive()
            if message.get("bytes") is not None and np.frombuffer(message["bytes"], "<u4", 1)[0] == 2:
                break
        count = int(np.frombuffer(message["bytes"], "<u4", 4)[2])
        t_s = np.frombuffer(message["bytes"], "<f8", count, offset=16)
        assert np.diff(t_s) == pytest.approx(0.002)
        assert t_s[0] <= 0.1
        assert t_s[-1] >= 0.2


def test_a_bus_that_is_just_being_made_is_joined_a_moment_later(tmp_path: Path) -> None:
    bus, refused = MemoryBus(), [BusError("timing is virtual on the bus that runs, asked for real")]

    def join() -> MemoryLink:
        if refused:
            raise refused.pop()
        return bus.open_link()

    listener = Listener(load_with_overrides(SHIPPED, pace="realtime").config, join, partial(LiveRun.on, tmp_path))
    listener.start()
    assert listener.state()["bus_problem"] == ""
    listener.close()
