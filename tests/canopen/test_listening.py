"""Listening on a bus: what has come in its time is heard, however late one looks."""

from __future__ import annotations

import time
from typing import cast

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.listening import present


class LateLink:
    """An answer waits, and sending takes longer than anybody waits for it: a process that was held up."""

    def __init__(self) -> None:
        self.waiting = [Frame(0x581, bytes(8))]

    def send(self, frames: list[Frame]) -> None:
        """Nothing goes anywhere."""

    def receive(self, timeout_s: float) -> list[Frame]:
        """What waits, after a pause that is longer than the time there was."""
        if timeout_s > 0.0:
            time.sleep(2.0 * timeout_s)
            return []
        came, self.waiting = self.waiting, []
        return came


def test_an_answer_that_has_come_is_heard_by_who_was_held_up_meanwhile() -> None:
    assert present(cast(Link, LateLink()), [1, 2], 0.01) == {1}
