"""The bus of this machine as a case sees it, on a link that hands over what it is given."""

from __future__ import annotations

import signal

import pytest

from hilbench.apps.conformance.wire import Wire
from hilbench.can.frame import Frame
from hilbench.errors import EndSignal
from hilbench.processes import end_requests


class Given:
    """A link on which these frames wait."""

    channel = "given"

    def __init__(self, *frames: Frame) -> None:
        self.waiting = list(frames)

    def receive(self, timeout_s: float) -> list[Frame]:
        found, self.waiting = self.waiting, []
        return found


def test_what_waits_is_heard_in_no_time() -> None:
    wire = Wire(Given(Frame(0x585, b"\x01"), Frame(0x705, b"\x7f")))
    assert [received.can_id for received in wire.listen(0.0)] == [0x585, 0x705]
    assert wire.listen(0.0) == []


def test_what_comes_behind_the_awaited_frame_is_kept_for_the_next_look() -> None:
    wire = Wire(Given(Frame(0x705, b"\x00"), Frame(0x585, b"\x01"), Frame(0x185, b"\x02")))
    assert [received.can_id for received in wire.listen(5.0, lambda received: received.can_id == 0x585)] == [
        0x705,
        0x585,
    ]
    assert [received.can_id for received in wire.listen(0.0)] == [0x185]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_who_is_asked_to_end_is_interrupted_once_and_can_put_things_in_order(number: signal.Signals, code: int) -> None:
    with end_requests() as end_if_requested:
        wire = Wire(Given(Frame(0x585, b"\x01")), end_if_requested)
        signal.raise_signal(number)
        with pytest.raises(EndSignal) as raised:
            wire.listen(1.0)
        signal.raise_signal(number)
        assert len(wire.listen(0.0)) == 1
    assert raised.value.exit_code == code
