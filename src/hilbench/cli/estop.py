"""`hilbench estop`: the emergency stop from another terminal."""

from __future__ import annotations

import sys
import time

from hilbench.bus.hub_client import running_channels, statistics
from hilbench.bus.link import Link
from hilbench.bus.open import BusAddress, open_link
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_PASSED, BusError, UnusableInputError
from hilbench.fieldbus.emergency_stop import send_emergency_stop

#: How long the nodes' heartbeats are listened to afterwards.
_LISTEN_S = 0.5
_OPERATIONAL = 5


def estop_command(names: list[str] | None) -> int:
    """Stop each bus, the others too when one fails; returns the exit code."""
    addresses = [BusAddress.parse(name) for name in names or _embedded_channels()]
    return max(_stop(address) for address in addresses)


def _embedded_channels() -> list[str]:
    channels = running_channels()
    if not channels:
        raise UnusableInputError(
            "estop", "no embedded bus of this user runs, expected --bus with the bus to stop (socketcan:can0, …)"
        )
    return [f"embedded:{channel}" for channel in channels]


def _as_it_runs(address: BusAddress) -> BusAddress:
    """An embedded bus is joined with the settings that it has."""
    if address.interface != "embedded":
        return address
    found = statistics(address.channel)
    return BusAddress(address.interface, address.channel, found.bitrate, found.timing)


def _stop(address: BusAddress) -> int:
    try:
        link = open_link(_as_it_runs(address))
    except BusError as error:
        print(f"hilbench: {error}", file=sys.stderr)
        return EXIT_BENCH_FAULT
    try:
        link.set_filters([(0x700, 0x780)])
        send_emergency_stop(link)
        moving = _still_operational(link)
    except BusError as error:
        print(f"hilbench: {error}", file=sys.stderr)
        return EXIT_BENCH_FAULT
    finally:
        link.close()
    if moving:
        nodes = ", ".join(str(node) for node in moving)
        print(f"hilbench: {address}: emergency stop sent, node {nodes} still says OPERATIONAL", file=sys.stderr)
        return EXIT_BENCH_FAULT
    print(f"{address}: emergency stop sent")
    return EXIT_PASSED


def _still_operational(link: Link) -> list[int]:
    """Nodes whose last heartbeat says OPERATIONAL; those that say nothing are not known."""
    states: dict[int, bytes] = {}
    deadline_s = time.monotonic() + _LISTEN_S
    link.receive(0.0)  # what was said before
    while (left_s := deadline_s - time.monotonic()) > 0.0:
        for frame in link.receive(left_s):
            states[frame.can_id - 0x700] = frame.data
    return sorted(node for node, data in states.items() if data == bytes([_OPERATIONAL]))
