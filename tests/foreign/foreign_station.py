"""The station of station.js on a link: its frames go to the bus, the bus' frames to it; requests and events as JSON."""

from __future__ import annotations

import configparser
import json
import os
import re
import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import StringIO
from itertools import count
from pathlib import Path
from typing import Any

from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.link import Link

SCRIPT = Path(__file__).with_name("station.js")
PACKAGES = Path(__file__).parents[2] / ".cache" / "node-canopen" / "node_modules"
OWN_NODE = 0x7E
OF_VALUES = ("DataType", "AccessType", "DefaultValue", "PDOMapping")
_PATIENCE_S = 30.0
_POLL_S = 0.05


def with_node_id(eds: str, node: int) -> str:
    """The EDS as npm's canopen reads it: COB-IDs as numbers (it knows no $NODEID), a DCF's values as the defaults, and
    nothing of a value in records and arrays.
    """
    file = configparser.ConfigParser(interpolation=None, strict=False, comment_prefixes=(";", "#"))
    file.optionxform = str  # type: ignore[assignment, method-assign]
    file.read_string(re.sub(r"(?i)\$NODEID *\+ *(0x[0-9a-f]+)", lambda match: hex(int(match[1], 0) + node), eds))
    for section in file.values():
        if section.get("ParameterValue"):
            section["DefaultValue"] = section.pop("ParameterValue")
        if int(section.get("ObjectType", "7"), 0) in (8, 9):
            for name in OF_VALUES:
                section.pop(name, None)
    with StringIO() as text:
        file.write(text, space_around_delimiters=False)
        return text.getvalue()


class Refused(Exception):  # noqa: N818 - an answer
    """An SDO transfer that the other side aborted."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}h")
        self.code = code


class ForeignStation:
    """Requests to the station and what it has heard."""

    def __init__(self, process: subprocess.Popen[str], link: Link, node: int) -> None:
        self._process, self._node = process, node
        self._link = link
        self._numbers = count(1)
        self._news = threading.Condition()
        self._answers: dict[int, Mapping[str, Any]] = {}
        self._events: list[Mapping[str, Any]] = []
        self._ended = False
        self._writing = threading.Lock()

    def upload(self, index: int, sub: int = 0, *, block: bool = False) -> bytes:
        """Read an object. Raises Refused."""
        return bytes.fromhex(self._ask("upload", index=index, sub=sub, block=block))

    def download(self, index: int, sub: int, data: bytes, *, block: bool = False) -> None:
        """Write an object. Raises Refused."""
        self._ask("download", index=index, sub=sub, data=data.hex(), block=block)

    def nmt(self, service: str) -> None:
        """An NMT service by the name of its method."""
        self._ask("nmt", service=service)

    def heartbeat(self, period_ms: int) -> None:
        """Produce a heartbeat, the first of which is out then; 0: none."""
        self._ask("heartbeat", period_ms=period_ms)

    def sync(self) -> None:
        """Send SYNC."""
        self._ask("sync")

    def sync_every(self, period_ms: int) -> None:
        """Send SYNC by its own timer from now on."""
        self._ask("sync_every", period_us=1000 * period_ms)

    def command(self, controlword: int, target_velocity: int = 0) -> None:
        """Send RPDO1 of our servo drive."""
        self.write_pdo(0x200 + self._node, {"6040": controlword, "60ff": target_velocity})

    def write_pdo(self, cob_id: int, values: Mapping[str, int]) -> None:
        """Send an RPDO of the node, with these values of objects (hexadecimal digits) from now on."""
        self._ask("pdo", cob_id=cob_id, values=values)

    def find(self, vendor_id: int, product_code: int, revision_number: int) -> Mapping[str, int] | None:
        """Who of this kind has no node id, by LSS fastscan; it is selected then."""
        found: Mapping[str, int] | None = self._ask(
            "find", vendorId=vendor_id, productCode=product_code, revisionNumber=revision_number
        )
        return found

    def give_node_id(self, node_id: int) -> None:
        """Give it to the selected device (LSS), which stores it."""
        self._ask("give_node_id", node_id=node_id)

    def event(self, name: str, **content: object) -> Mapping[str, Any]:
        """The next event of this name whose entries are these; it and those before it are taken."""
        with self._news:
            assert self._news.wait_for(lambda: self._place(name, content) is not None or self._ended, _PATIENCE_S), (
                f"no {name} {content}, but {self._events}"
            )
            place = self._place(name, content)
            assert place is not None, f"the station has ended, and had heard {self._events}"
            found = self._events[place]
            del self._events[: place + 1]
            return found

    def _place(self, name: str, content: Mapping[str, object]) -> int | None:
        wanted = {"event": name, **content}
        return next((place for place, event in enumerate(self._events) if wanted.items() <= event.items()), None)

    def _ask(self, request: str, **content: object) -> Any:
        number = next(self._numbers)
        self._write(json.dumps({"id": number, "do": request, **content}))
        with self._news:
            assert self._news.wait_for(lambda: number in self._answers or self._ended, _PATIENCE_S), request
            assert number in self._answers, f"the station has ended at {request}"
            answer = self._answers.pop(number)
        if "abort" in answer:
            raise Refused(answer["abort"])
        return answer["value"]

    # -- the lines -----------------------------------------------------------------------------------------

    def _write(self, line: str) -> None:
        assert self._process.stdin is not None
        with self._writing:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()

    def read(self) -> None:
        """Take the station's lines until it ends."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.startswith("{"):
                can_id, data = line.strip().split("#")
                self._link.send([Frame(int(can_id, 16), bytes.fromhex(data))])
                continue
            message = json.loads(line)
            with self._news:
                if "event" in message:
                    self._events.append(message)
                else:
                    self._answers[message["id"]] = message
                self._news.notify_all()
        with self._news:
            self._ended = True
            self._news.notify_all()

    def forward(self, stop: threading.Event) -> None:
        """Give the bus' data frames to the station."""
        while not stop.is_set():
            for frame in self._link.receive(_POLL_S):
                if not frame.can_id & (REMOTE_FLAG | EXTENDED_FLAG):
                    self._write(f"{frame.can_id:03x}#{frame.data.hex()}")


@contextmanager
def foreign_station(link: Link, node: int, eds: Path) -> Iterator[ForeignStation]:
    """The station on the link, with the EDS of the node it shall know; the link is closed at the end."""
    process = subprocess.Popen(
        ["node", str(SCRIPT), str(node), str(eds)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"NODE_PATH": str(PACKAGES)},
    )
    station = ForeignStation(process, link, node)
    stop = threading.Event()
    threads = [threading.Thread(target=station.read), threading.Thread(target=station.forward, args=(stop,))]
    for thread in threads:
        thread.start()
    try:
        yield station
    finally:
        stop.set()
        threads[1].join()
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(_PATIENCE_S) == 0
        threads[0].join()
        link.close()
