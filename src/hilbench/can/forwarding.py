"""Forwarding without the interpreter: tables for `forwarding_kernel`, made from the hub's objects.

Known frames and their receivers are learnt from those that the hub has passed on itself, and forgotten when
a station joins or leaves or changes its filters.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hilbench.can import forwarding_kernel as kernel
from hilbench.can import protocol, wire
from hilbench.can.compiled_wire import STAMPED_BYTES
from hilbench.can.medium import Medium
from hilbench.compiled import load, table_of

#: A station on the wire, as frames are sent and received: descriptor, records in one packet to it, frames
#: dropped so far, true if it receives its own.
Place = tuple[int, int, int, bool]


class Left(NamedTuple):
    """Work left for the hub."""

    #: Sender and packet: not sent yet; None: none came after all.
    packets: list[tuple[int, bytes | None]]
    #: Stations, and the records for each that were held back because the socket of one before it was full.
    undelivered: list[tuple[int, list[bytes]]]


class Forwarder:
    """Passes on packets of known frames; `epoll` waits for the stations, and for all else that can happen."""

    #: More are forwarded by the hub itself.
    MAX_STATIONS = kernel.MAX_STATIONS

    def __init__(self, epoll: int) -> None:
        self._epoll, self._wire = epoll, kernel.new_wire()
        self._table = table_of(self._wire)
        self._places: list[Place] = []
        load(kernel.forward)

    def forward(self, medium: Medium, places: list[Place]) -> Left:
        """Serve the stations at these places, in the order in which they joined, while all that happens is packets of
        known frames; the wire is `undisturbed`."""
        if places != self._places:
            self._take(places)
        state = self._wire.state
        state[0] = 0
        state["bitrate"], state["free_ns"] = medium.bitrate, medium.free_ns
        kernel.forward(self._epoll, self._table)
        left = state[0]
        medium.account(int(left["frames"]), int(left["bits"]), int(left["free_ns"]) - medium.free_ns)
        return Left([self._packet(at) for at in range(left["packets_left"])], list(self._undelivered()))

    def _packet(self, at: int) -> tuple[int, bytes | None]:
        packet = self._wire.packets[at]
        size = int(packet["size"])
        return int(packet["station"]), None if size < 0 else self._wire.received[at].tobytes()[:size]

    def _take(self, places: list[Place]) -> None:
        self._places = places
        headers = (protocol.HEADER.pack(protocol.KIND_CLASSICAL, dropped & 0xFFFFFFFF) for _, _, dropped, _ in places)
        rows = [
            (descriptor, limit, int.from_bytes(header, sys.byteorder), own)
            for (descriptor, limit, _, own), header in zip(places, headers, strict=True)
        ]
        stations = np.array(rows, kernel.STATION)
        of_descriptors = np.full(max(stations["descriptor"], default=0) + 1, -1)
        of_descriptors[stations["descriptor"]] = range(len(places))
        self._wire = self._wire._replace(stations=stations, of_descriptors=of_descriptors)
        self._table = table_of(self._wire)

    def _undelivered(self) -> Iterator[tuple[int, list[bytes]]]:
        state = self._wire.state[0]
        carried, since = self._wire.carried[: state["frames_left"]], int(state["received"])
        for station in range(state["receiver"], len(self._places) if len(carried) else 0):
            yield (
                station,
                [row.tobytes()[:STAMPED_BYTES] for row in carried[since:] if row["receivers"] >> station & 1],
            )
            since = 0

    def learn(self, can_id: int, length: int, received_by: int) -> None:
        """Learn a frame; `received_by`: stations that receive it, a bit each."""
        if can_id < kernel.IDENTIFIERS:
            self._wire.known[can_id * kernel.LENGTHS + length] = (*wire.header(can_id, length), received_by)

    def forget(self) -> None:
        """Forget all frames: a station has joined or left, or changed its filters."""
        self._wire.known[:] = 0
