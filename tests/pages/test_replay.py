"""An ended run in the page of a running bench, from its folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect
from tests.pages.told_samples import keep

from hilbench.apps.pages.access import Access
from hilbench.apps.pages.runs import FAST, PlayedTrace, routes
from hilbench.apps.pages.server import site
from hilbench.canopen.identifiers import SYNC
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import LoadedConfig

HERE = "http://127.0.0.1:8321"
PATIENCE_S = 60.0
Ran = tuple[LoadedConfig, RunOutcome]


@pytest.fixture
def client(ran: Ran) -> Iterator[TestClient]:
    access, base = Access("127.0.0.1", 8321), ran[1].folder.path.parent
    with TestClient(site(access, routes(base, replays=True)), base_url=HERE) as client:
        client.post("/session", headers={"Authorization": access.token, "Origin": HERE})
        yield client


def played(client: TestClient, name: str) -> WebSocketTestSession:
    return client.websocket_connect(f"ws{HERE[4:]}/played/{quote(name)}", headers={"Origin": HERE})


class Seen:
    """What a viewer of a run has been told."""

    def __init__(self, socket: WebSocketTestSession) -> None:
        self._socket = socket
        socket.send_json({"viewer": None})
        self.layout = socket.receive_json()
        self.state: dict[str, Any] = {}
        self.events: dict[str, float | None] = {}  # and the time of the picture when each was told
        self.samples: dict[str, list[float]] = {}

    def until(self, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            message = self._socket.receive()
            if message.get("bytes") is not None:
                keep(self.samples, self.layout["signals"], message["bytes"])
                continue
            told: dict[str, Any] = json.loads(message["text"])
            if told["kind"] == "state":
                self.state = told
                for event in told["events"]:
                    self.events.setdefault(f"{event['source']}: {event['text']}", told["t_s"])
            if holds(told):
                return told
        raise AssertionError(f"did not come; last state {self.state}, events {self.events}")

    def ask(self, **action: Any) -> dict[str, Any]:
        self._socket.send_json({"number": 1, **action})
        return self.until(lambda told: told["kind"] == "said")


def test_an_ended_run_is_played_again_with_what_happened_when_it_did(client: TestClient, ran: Ran) -> None:
    folder = ran[1].folder
    before = {file: file.stat().st_mtime_ns for file in folder.path.iterdir()}
    with played(client, folder.name) as socket:
        seen = Seen(socket)
        assert seen.layout["replay"] == folder.name
        seen.until(lambda told: told["kind"] == "state" and told["running"] and told["t_s"] is not None)
        assert seen.state["ended"] is None
        assert {node["drive_state"] for node in seen.state["nodes"][:2]} == {"OPERATION ENABLED"}
        seen.ask(do="pace", pace=None)
        seen.until(lambda told: told["kind"] == "state" and told["ended"] is not None)
    assert seen.state["condition"] == "ENDED"
    assert seen.state["ended"]["verdict"] == ran[1].result.verdict
    recording = read_recording(folder.recording)
    for name in ("F_true_N", "F_sim_N", "v2_m_s"):
        largest = np.max(recording[name])
        assert max(seen.samples[name]) == pytest.approx(largest, rel=1e-6), name
    (step,) = (event for event in seen.events if "set-point" in event and "90" in event)
    told_s = seen.events[step]
    assert told_s is not None
    assert told_s >= 1.0  # not before it happened
    assert {file: file.stat().st_mtime_ns for file in folder.path.iterdir()} == before


@pytest.mark.parametrize(
    "action",
    [
        {"do": "stop", "name": "anna"},
        {"do": "take", "name": "anna"},
        {"do": "set", "key": "t", "value": 95.0},
        {"do": "pace", "pace": -1.0},
    ],
)
def test_nothing_that_is_asked_of_a_replay_is_done(client: TestClient, ran: Ran, action: dict[str, Any]) -> None:
    with played(client, ran[1].folder.name) as socket:
        said = Seen(socket).ask(**action)
    assert not said["done"]
    assert "nothing of that reaches a machine" in said["text"]


def test_a_list_of_runs_leads_to_the_replay_and_strangers_have_none(client: TestClient, ran: Ran) -> None:
    name = ran[1].folder.name
    assert f"/replay/{quote(name)}" in client.get("/runs").text
    shown = client.get(f"/replay/{name}")
    assert shown.status_code == 200
    assert "data-replay" in shown.text
    assert client.get("/replay/../../etc").status_code == 404
    client.cookies.clear()
    assert client.get(f"/replay/{name}").status_code == 401
    with pytest.raises(WebSocketDisconnect), played(client, name):
        pass


def test_what_is_no_run_is_said(client: TestClient) -> None:
    with played(client, "none") as socket, pytest.raises(WebSocketDisconnect) as refused:
        socket.receive_json()
    assert "no such run" in refused.value.reason


def test_a_trace_is_heard_at_the_pace_that_is_asked_for(ran: Ran) -> None:
    now_s = [0.0]
    trace = PlayedTrace(ran[1].folder, 0.002, lambda: now_s[0])

    def syncs(seconds: float) -> int:
        now_s[0] += seconds
        return sum(frame.can_id == SYNC for frame in trace.receive(0.0))

    assert syncs(0.0) == 1
    assert syncs(0.1) == 50
    trace.pace = 0.0
    assert syncs(10.0) == 0
    trace.pace = 4.0
    assert syncs(0.05) == 100
    trace.pace = FAST
    received = [syncs(0.02) for _ in range(3)]
    assert received == [200, 200, 200]
    assert trace.clock_s() == pytest.approx(0.002 * 750, abs=0.003)


def test_a_torn_trace_is_played_to_where_it_ends(ran: Ran, tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path, "torn")
    whole, _, torn = ran[1].folder.trace.read_bytes()[:100_001].rpartition(b"\n")
    folder.trace.write_bytes(whole + b"\n" + torn)
    trace = PlayedTrace(folder, 0.002)
    trace.pace = FAST
    frames = [frame for _ in range(100) for frame in trace.receive(0.0)]
    assert torn
    assert len(frames) == len(whole.splitlines())
    assert trace.receive(0.0) == []
