"""Actions of SYNC cases (CiA 301, 7.2.5): the device as consumer, and as producer where it is one."""

from __future__ import annotations

from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest, answers
from hilbench.apps.conformance.wire import ReceivedFrame
from hilbench.canopen.identifiers import PRODUCE_SYNC, SYNC

_PRODUCED_US: Final = 100_000


def _produced(dut: DeviceUnderTest) -> list[ReceivedFrame]:
    """SYNCs of a producer in 1 s with a period of 100 ms. Raises NotApplicableError for a device that is none."""
    dut.needs_to_write((0x1005, 0), (0x1006, 0))
    dut.configure(0x1006, 0, 0, "no period")
    dut.configure(0x1005, 0, PRODUCE_SYNC | SYNC, "the device is no SYNC producer")
    dut.configure(0x1006, 0, _PRODUCED_US, "a period of 100 ms")
    dut.forget()
    return dut.receive_id(SYNC, 1.0)


@action
def produces_sync(dut: DeviceUnderTest) -> None:
    """Ten in a second."""
    found = _produced(dut)
    dut.check("SYNC every 100 ms", "10 in 1 s", f"{len(found)} in 1 s", 9 <= len(found) <= 11)


@action
def every_tenth_sync(dut: DeviceUnderTest) -> None:
    """Transmission type 10: with every tenth SYNC, whichever the device counts from."""
    came = [number for number in range(1, 41) if answers(dut.sync(), dut.pdo.cob_id, lambda _: True)]
    wanted = list(range(came[0], 41, 10)) if came and came[0] <= 10 else [10, 20, 30, 40]
    dut.check("40 SYNCs, type 10", f"sent with {wanted}", f"sent with {came or 'none'}", came == wanted)


@action
def produces_sync_counter(dut: DeviceUnderTest) -> None:
    """1 to 5, and again."""
    seen = [received.data.hex() for received in _produced(dut)][:7]
    first = int(seen[0], 16) if seen and seen[0] else 1
    wanted = [f"{(first - 1 + number) % 5 + 1:02x}" for number in range(len(seen))]
    dut.check(
        "counter up to 5", " ".join(wanted) or "a counter", " ".join(seen) or "nothing", bool(seen) and seen == wanted
    )
