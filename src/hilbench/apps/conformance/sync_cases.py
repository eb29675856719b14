"""SYNC cases (CiA 301, 7.2.5): the device as consumer, and as producer where it is one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest, answers
from hilbench.apps.conformance.process_data import set_up, transmit_pdo
from hilbench.apps.conformance.store_cases import store
from hilbench.apps.conformance.wire import ReceivedFrame
from hilbench.canopen.identifiers import PRODUCE_SYNC, SYNC, NmtCommand
from hilbench.canopen.object_store import GENERAL_ERROR, INVALID_VALUE, PRESENT_STATE, VALUE_TOO_HIGH, VALUE_TOO_LOW

_PRODUCED_US: Final = 100_000
_SYNC_LENGTH: Final = "40 82"


def default_identifier(dut: DeviceUnderTest) -> None:
    """1005h is 80h (a consumer; the top bit means nothing)."""
    dut.needs((0x1005, 0))
    dut.ask("read 1005h:0", "40 05 10 00 00000000", "43 05 10 00 80000000", "43 05 10 00 80000080")


def _produced(dut: DeviceUnderTest) -> list[ReceivedFrame]:
    """SYNCs of a producer in 1 s with a period of 100 ms. Raises NotApplicableError for a device that is none."""
    dut.needs_to_write((0x1005, 0), (0x1006, 0))
    dut.configure(0x1006, 0, 0, "no period")
    dut.configure(0x1005, 0, PRODUCE_SYNC | SYNC, "the device is no SYNC producer")
    dut.configure(0x1006, 0, _PRODUCED_US, "a period of 100 ms")
    dut.forget()
    return dut.receive_id(SYNC, 1.0)


def producer(dut: DeviceUnderTest) -> None:
    """Ten in a second."""
    found = _produced(dut)
    dut.check("SYNC every 100 ms", "10 in 1 s", f"{len(found)} in 1 s", 9 <= len(found) <= 11)


def every_tenth(dut: DeviceUnderTest) -> None:
    """Transmission type 10: with every tenth SYNC, whichever the device counts from."""
    pdo = transmit_pdo(dut)
    set_up(dut, pdo, 10)
    dut.nmt(NmtCommand.START)
    came = [number for number in range(1, 41) if answers(dut.sync(), pdo.cob_id, lambda _: True)]
    wanted = list(range(came[0], 41, 10)) if came and came[0] <= 10 else [10, 20, 30, 40]
    dut.check("40 SYNCs, type 10", f"sent with {wanted}", f"sent with {came or 'none'}", came == wanted)


def consumer_without_period(dut: DeviceUnderTest) -> None:
    """1006h = 0: SYNC acts all the same."""
    pdo = transmit_pdo(dut)
    if dut.eds.can_write(0x1006):
        dut.write(0x1006, 0, 0)
    set_up(dut, pdo, 1)
    dut.nmt(NmtCommand.START)
    dut.forget()
    dut.frames("SYNC, type 1", dut.sync(), pdo.cob_id, "??" * pdo.size)


def invalid_counter(dut: DeviceUnderTest) -> None:
    """1019h takes 0 and 2 to 240."""
    dut.needs_to_write((0x1019, 0))
    if dut.eds.can_write(0x1006):
        dut.write(0x1006, 0, 0)
    dut.refuses("1 to 1019h", 0x1019, 0, b"\x01", INVALID_VALUE, VALUE_TOO_LOW)
    dut.refuses("241 to 1019h", 0x1019, 0, b"\xf1", INVALID_VALUE, VALUE_TOO_HIGH)


def without_counter(dut: DeviceUnderTest) -> None:
    """1019h = 0: SYNC has no data, and one with a counter is reported (8240h)."""
    dut.needs_to_write((0x1019, 0))
    pdo = transmit_pdo(dut)
    if dut.eds.can_write(0x1006):
        dut.write(0x1006, 0, 0)
    dut.write(0x1019, 0, 5)
    dut.write(0x1019, 0, 0)
    set_up(dut, pdo, 1)
    dut.nmt(NmtCommand.START)
    dut.forget()
    dut.frames("SYNC without a counter", dut.sync(), pdo.cob_id, "??" * pdo.size)
    dut.frames("SYNC with one", dut.sync(b"\x01"), dut.emergency_id, f"{_SYNC_LENGTH} ?? ??????????")


def counter_of_producer(dut: DeviceUnderTest) -> None:
    """1 to 5, and again."""
    dut.needs_to_write((0x1019, 0))
    if dut.eds.can_write(0x1006):
        dut.write(0x1006, 0, 0)
    dut.write(0x1019, 0, 5)
    seen = [received.data.hex() for received in _produced(dut)][:7]
    first = int(seen[0], 16) if seen and seen[0] else 1
    wanted = [f"{(first - 1 + number) % 5 + 1:02x}" for number in range(len(seen))]
    dut.check(
        "counter up to 5", " ".join(wanted) or "a counter", " ".join(seen) or "nothing", bool(seen) and seen == wanted
    )


def counter_is_stored(dut: DeviceUnderTest) -> None:
    """1019h = 5 is there after 1010h:1 and a reset."""
    dut.needs_to_write((0x1019, 0), (0x1010, 1))
    dut.needs_store()
    if dut.eds.can_write(0x1006):
        dut.write(0x1006, 0, 0)
    dut.write(0x1019, 0, 5)
    store(dut, 1)
    dut.reset()
    dut.reads("1019h after the reset", 0x1019, 0, 5)


def counter_while_period(dut: DeviceUnderTest) -> None:
    """1019h can't be changed while 1006h is not 0."""
    dut.needs_to_write((0x1019, 0), (0x1006, 0))
    dut.write(0x1006, 0, 0)
    dut.write(0x1019, 0, 0)
    dut.write(0x1006, 0, 1000)
    dut.refuses("5 to 1019h", 0x1019, 0, b"\x05", PRESENT_STATE, GENERAL_ERROR)
    dut.write(0x1006, 0, 0)


def values_are_stored(dut: DeviceUnderTest) -> None:
    """1005h, 1006h and 1019h."""
    dut.needs_to_write((0x1005, 0), (0x1006, 0), (0x1019, 0), (0x1010, 1))
    dut.needs_store()
    dut.write(0x1006, 0, 0)
    values = {0x1005: 0x90, 0x1019: 5, 0x1006: 1000}
    for index, value in values.items():
        dut.write(index, 0, value)
    store(dut, 1)
    dut.reset()
    for index, value in values.items():
        dut.reads(f"{index:04X}h after the reset", index, 0, value)


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], None]]] = {
    "SYNC 1": default_identifier,
    "SYNC 2": producer,
    "SYNC 3": every_tenth,
    "SYNC 4": consumer_without_period,
    "SYNC 5": invalid_counter,
    "SYNC 6": without_counter,
    "SYNC 7": counter_of_producer,
    "SYNC 8": counter_is_stored,
    "SYNC 9": counter_while_period,
    "SYNC 10": values_are_stored,
}
