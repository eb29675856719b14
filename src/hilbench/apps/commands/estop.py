"""`hilbench estop`: the emergency stop from another terminal."""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass

from hilbench.can import claims
from hilbench.can.claims import MASTER, Holder
from hilbench.can.hub_client import running_channels, statistics
from hilbench.can.interfaces import can_interfaces_up
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.emergency_stop import send_emergency_stop
from hilbench.canopen.identifiers import FUNCTION_CODE, HEARTBEAT, NmtState
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_PASSED, BusError, HilbenchError, UnusableInputError

#: How long the nodes' heartbeats are listened to afterwards.
_LISTEN_S = 0.5
#: For a program to say what it does there; it is stopped without that, too.
_ANSWERS_WITHIN_S = 0.05
#: Interfaces that are joined with the bit rate at which they run, whatever we ask for.
_RATE_IS_THERE = ("embedded", "socketcan")


@dataclass(frozen=True)
class Target:
    """A bus that is to be stopped, and who is known to be on it."""

    place: str
    known: tuple[Holder, ...] = ()

    @property
    def who(self) -> str:
        """The bench, or another program, on this bus; empty: nobody that is known."""
        masters = [one for one in self.known if one.role == MASTER]
        return str((masters or self.known)[0]) if self.known else ""

    def address(self) -> BusAddress:
        """The bus, to be joined as it runs. Raises BusError, UnusableInputError."""
        bitrate = next((one.bitrate for one in self.known if one.bitrate), None)
        bus = BusAddress.parse(self.place) if bitrate is None else BusAddress.parse(self.place, bitrate=bitrate)
        if bus.interface == "embedded":
            bus = bus.as_it_runs()
            statistics(bus.channel)  # to open a bus on which nobody is would make one
            return bus
        if self.known and bitrate is None and bus.interface not in _RATE_IS_THERE:
            raise BusError(f"{bus}: its bit rate is unknown; a wrong one would disturb the bus")
        return bus


def estop_command(names: list[str] | None) -> int:
    """Stop each bus, all at once, whether or not another fails; returns the exit code.

    A failure counts on a bus that was named, or on which somebody is known; and when nothing was reached at all. An
    interface that is up and takes no frame, because nobody is on its bus, is said, and is none.
    """
    if names:
        targets, complete = [Target(str(BusAddress.parse(name))) for name in names], True
    else:
        targets, complete = everything()
    with ThreadPoolExecutor(len(targets)) as pool:
        outcomes = list(zip(targets, pool.map(_stop, targets), strict=True))
    for target, problem in outcomes:
        there = f" ({target.who})" if target.who else ""
        if problem:
            print(f"hilbench: {problem}{there}", file=sys.stderr)
        else:
            print(f"{target.place}: emergency stop sent{there}")
    failed = [target for target, problem in outcomes if problem]
    counts = any(names or target.known for target in failed) or len(failed) == len(outcomes)
    return EXIT_BENCH_FAULT if counts or not complete else EXIT_PASSED


def everything() -> tuple[list[Target], bool]:
    """Every bus of this machine on which a bench or its nodes have said that they are, every embedded bus of this user
    that runs, and every CAN interface that is up; and whether that is all.

    Raises UnusableInputError when there is nothing of all that.
    """
    found: dict[str, list[Holder]] = {}
    others = set()
    known, complete = list[Holder](), True
    try:
        known = claims.holders(_ANSWERS_WITHIN_S)
    except BusError as error:
        print(f"hilbench: NOT ALL BENCHES ARE KNOWN: {error}", file=sys.stderr)
        complete = False
    for claimed in known:
        # An embedded bus is its user's and root's; a CAN interface is everybody's, and so is who does not say.
        if not claimed.place.startswith("embedded:") or claimed.uid < 0 or os.getuid() in (claimed.uid, 0):
            found.setdefault(claimed.place, []).append(claimed)
        else:
            others.add(f"{claimed.place}: left alone, only {claimed.user} or root can stop it")
    for line in sorted(others):
        print(line)
    for channel in running_channels():
        found.setdefault(BusAddress("embedded", channel).place, [])
    for name in can_interfaces_up():
        found.setdefault(f"socketcan:{name}", [])
    if not found:
        raise UnusableInputError(
            "estop",
            "no bench is registered on this machine, no embedded bus of this user runs and no CAN interface is up, "
            "expected one, or --bus with the bus to stop",
        )
    return [Target(place, tuple(there)) for place, there in found.items()], complete


def _stop(target: Target) -> str:
    """Why its emergency stop cannot be relied on; empty: it can."""
    try:
        with closing(open_link(target.address())) as link:
            link.set_filters([(HEARTBEAT, FUNCTION_CODE)])
            send_emergency_stop(link)
            moving = _still_operational(link)
    except (HilbenchError, OSError) as error:
        return f"NOT STOPPED: {error}"
    if moving:
        return f"{target.place}: emergency stop sent, node {', '.join(map(str, moving))} still OPERATIONAL"
    return ""


def _still_operational(link: Link) -> list[int]:
    """Nodes whose last heartbeat says OPERATIONAL; those that say nothing are not known."""
    states: dict[int, bytes] = {}
    deadline_s = time.monotonic() + _LISTEN_S
    link.receive(0.0)  # what was said before
    while (left_s := deadline_s - time.monotonic()) > 0.0:
        for frame in link.receive(left_s):
            states[frame.can_id - HEARTBEAT] = frame.data
    return sorted(node for node, data in states.items() if data == NmtState.OPERATIONAL.heartbeat)
