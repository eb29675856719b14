"""Links to the embedded bus for tests: addresses, what comes over them, other processes on it."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.open import BusAddress

VIRTUAL = BusAddress(timing="virtual")


REAL = BusAddress()


#: Joins, says so once, and listens.
LISTENER = """
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
link = open_link(BusAddress(timing="virtual"))
link.send([Frame(0x700, b"up")])
while True:
    link.receive(10.0)
"""


def collect(link: Link, count: int) -> list[Frame]:
    """`count` frames from a link (fewer if they do not come)."""
    frames: list[Frame] = []
    deadline = time.monotonic() + 20
    while len(frames) < count and time.monotonic() < deadline:
        frames += link.receive(1.0)
    return frames


def received(frames: list[Frame]) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data) for frame in frames]


Start = Callable[..., "subprocess.Popen[bytes]"]
