"""Who connects and says nothing, who asks and takes no answers, and who leaves: the others do not notice."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from tests.bench.whole_runs import config
from tests.pages.page_server import Server
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from hilbench.can.open import open_link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP
from hilbench.runs.config import load


class Site:
    """The address of a server, and a session with its token."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.at, self._token = (str(parts.hostname), int(parts.port or 0)), parts.fragment
        self.origin = f"http://{parts.netloc}"

    def session(self) -> str:
        asked = http.client.HTTPConnection(*self.at, timeout=60)
        asked.request("POST", "/session", headers={"Origin": self.origin, "Authorization": self._token})
        answer = asked.getresponse()
        assert answer.status == 204
        return str(answer.headers["Set-Cookie"]).partition(";")[0]

    @contextmanager
    def viewer(self) -> Iterator[ClientConnection]:
        headers = {"Cookie": self.session()}
        with connect(f"ws{self.origin[4:]}/live", origin=Origin(self.origin), additional_headers=headers) as viewer:
            viewer.send(json.dumps({"viewer": None}))
            yield viewer


def answered(viewer: ClientConnection, **asked: object) -> str:
    viewer.send(json.dumps({**asked, "number": 1}))
    for message in viewer:
        told = json.loads(message) if isinstance(message, str) else {}
        if told.get("number") == 1:
            return str(told["text"])
    raise AssertionError("no answer")


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: "])
def test_the_machine_is_stopped_from_a_page_that_others_hold_connections_to(tmp_path: Path, begun: bytes) -> None:
    path = config(tmp_path)
    server = Server(path)
    site = Site(server.address)
    with ExitStack() as open_ones:
        for _ in range(300):
            silent = open_ones.enter_context(socket.create_connection(site.at))
            silent.sendall(begun)
        link = open_ones.enter_context(closing(open_link(load(path)[0].bus_address.as_it_runs())))
        viewer = open_ones.enter_context(site.viewer())
        assert answered(viewer, do="stop", name="anna") == "emergency stop sent"
        received = link.receive(1.0)
        assert {frame[:2] for frame in received} == {frame[:2] for frame in EMERGENCY_STOP}
    server.end()


def test_who_asks_what_nobody_can_read_or_leaves_is_no_error_of_the_server(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    server = Server(config(tmp_path))
    site = Site(server.address)
    for message in ("[" * 4090, "{", "[]"):
        with site.viewer() as viewer, suppress(ConnectionClosed):
            viewer.send(message)
            for _ in viewer:
                pass
    with site.viewer() as viewer:
        viewer.send('{"do":"past","to_s":1,"from_s":1' + "0" * 4000 + "}")
        viewer.send('{"do":"what_if","key":"v","value":1' + "0" * 4000 + "}")
        assert answered(viewer, do="give") == "control is not yours to give back"
    for _ in range(20):
        with site.viewer() as viewer:
            viewer.socket.shutdown(socket.SHUT_RDWR)
    server.end()
    assert capfd.readouterr().err == ""
