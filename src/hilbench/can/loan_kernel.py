"""What a station does that has the wire: its own packets go over it, and those of the others come, without the hub.

The functions are those of the hub (`forwarding_kernel`), on its own memory (`wire_memory`). While a station waits it
holds nothing; what it does then is done under the lock. Whatever it is not through with is left for the hub.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.c_library import MSG_DONTWAIT, MSG_NOSIGNAL, pthread_mutex_trylock, pthread_mutex_unlock, send
from hilbench.can import forwarding_kernel as wire
from hilbench.can import protocol
from hilbench.compiled import compiled, integers, viewed

#: What has become of the wire while it was waited: nothing came within the time; it is the hub's.
NOTHING: Final = 0
GONE: Final = -1
#: Rows of the table: as `loan.Loan` has them.
_OWN, _LOCK, _STATE, _DESCRIPTORS, _OF_DESCRIPTORS, _STATIONS, _KNOWN, _EVENTS = range(8)
_RECEIVED, _PACKETS, _ROWS, _CARRIED, _OUT, _GIVEN = range(8, 14)
#: Places in the first one: the loan's number; which station has the wire; its socket, the hub being at the other end;
#: what waits for all others.
NUMBER, STATION, DESCRIPTOR, EPOLL, OF_OWN = range(5)

#: So often others send something that the station does not hear before the interpreter is asked again.
_MOST_TURNS: Final = 1000
_RETURN: Final = int.from_bytes(protocol.HEADER.pack(protocol.KIND_RETURN, 0), "little")
_HEADER_BYTES: Final = protocol.HEADER.size
_HEADER_WORDS, _STAMPED_WORDS = 1, protocol.STAMPED_CAN_RECORD.size // 8
_OCTET, _WORD = np.dtype(np.uint8), np.dtype(np.uint32)

#: Files that the machine code of who calls these functions depends on.
SOURCES = (__file__, wire.__file__, *wire.SOURCES)

Table = NDArray[np.int64]
Row = NDArray[np.int64]
Octets = NDArray[np.uint8]


@compiled
def has(table: Table) -> bool:
    """Whether the station has the wire; where not, it is the hub's for good."""
    if len(table) == 0:
        return False
    return bool(integers(table, _STATE, (1,))[wire.LOAN] == integers(table, _OWN, (1,))[NUMBER])


@compiled
def _hold(table: Table) -> bool:
    """Whether the station has the wire, and its lock."""
    if not has(table) or pthread_mutex_trylock(integers(table, _LOCK, (1,)).ctypes.data) != 0:
        return False
    if has(table):
        return True
    _release(table)
    return False


@compiled
def _release(table: Table) -> None:
    pthread_mutex_unlock(integers(table, _LOCK, (1,)).ctypes.data)


@compiled
def _give_back(table: Table) -> None:
    """The hub has the wire, and what is left."""
    own, state, given = integers(table, _OWN, (1,)), integers(table, _STATE, (1,)), integers(table, _GIVEN, (1,))
    state[wire.LOAN] = 0
    given[0] = _RETURN
    send(own[DESCRIPTOR], given.ctypes.data, _HEADER_BYTES, MSG_DONTWAIT | MSG_NOSIGNAL)


@compiled
def _pass_on(table: Table, count: int, heard: Row) -> int:
    """So many packets, all of known frames, over the wire to who hears them; how long the packet with what the station
    itself hears is, which is put into `heard`. Until that is done they are left for the hub."""
    own, state = integers(table, _OWN, (1,)), integers(table, _STATE, (1,))
    stations, known = integers(table, _STATIONS, (1, 2))[: state[wire.STATIONS]], integers(table, _KNOWN, (1, 2))
    received, packets = integers(table, _RECEIVED, (1, 2)), integers(table, _PACKETS, (1, 2))
    carried, mask = integers(table, _CARRIED, (1, 2)), 1 << own[STATION]
    rows = integers(table, _ROWS, (1, 2))
    over = wire.carry(state, known, packets, count, rows, received, viewed(received, _OCTET), carried)
    at = _HEADER_WORDS
    for k in range(over):
        frame = carried[k]
        if frame[wire.TO] & mask == 0:
            continue
        frame[wire.TO] ^= mask
        heard[at], heard[at + 1], heard[at + 2] = frame[wire.STAMPED], frame[wire.DATA], frame[wire.TIME_NS]
        at += _STAMPED_WORDS
    heard[0] = stations[own[STATION], wire.HEADER]
    state[wire.RECEIVER] = state[wire.RECEIVED] = 0
    state[wire.FRAMES_LEFT] = over
    state[wire.PACKETS_LEFT] = 0
    descriptors, out = integers(table, _DESCRIPTORS, (1,)), integers(table, _OUT, (1,))
    if wire.hand_out(state, descriptors, stations, carried, over, out):
        state[wire.FRAMES_LEFT] = 0
    else:
        _give_back(table)
    return 0 if at == _HEADER_WORDS else 8 * at


@compiled
def put(table: Table, packet: Octets, size: int, heard: Row) -> bool:
    """Send a packet of this size; False, and nothing done, where that is for the hub: by its socket. `heard`: room."""
    if not _hold(table):
        return False
    own, packets = integers(table, _OWN, (1,)), integers(table, _PACKETS, (1, 2))
    received, known = integers(table, _RECEIVED, (1, 2)), integers(table, _KNOWN, (1, 2))
    octets, words, rows = viewed(received, _OCTET), viewed(received, _WORD), integers(table, _ROWS, (1, 2))
    for k in range(size):
        octets[0, k] = packet[k]
    first = packets[0]
    first[wire.STATION], first[wire.SIZE], first[wire.NEXT] = own[STATION], size, 0
    first[wire.FRAMES] = wire.known_frames(octets[0], words[0], size, known, rows[0])
    known_all = first[wire.FRAMES] > 0
    if known_all:
        _pass_on(table, 1, heard)
    _release(table)
    return bool(known_all)


@compiled
def receive(table: Table, heard: Row, timeout_ms: int) -> int:
    """Wait until the station hears something, and pass on what is sent meanwhile; how long the packet is that it hears,
    put into `heard`; NOTHING, GONE."""
    own, of_descriptors = integers(table, _OWN, (1,)), integers(table, _OF_DESCRIPTORS, (1,))
    events, received = viewed(integers(table, _EVENTS, (1,)), _WORD), integers(table, _RECEIVED, (1, 2))
    known, packets = integers(table, _KNOWN, (1, 2)), integers(table, _PACKETS, (1, 2))
    octets, words, rows = viewed(received, _OCTET), viewed(received, _WORD), integers(table, _ROWS, (1, 2))
    state, stations = integers(table, _STATE, (1,)), integers(table, _STATIONS, (1, 2))
    for _ in range(_MOST_TURNS):
        count = wire.ready(own[EPOLL], of_descriptors, events, timeout_ms)
        if count < 0:
            return NOTHING
        if not _hold(table):
            return GONE
        size = 0
        if count == 0:
            _give_back(table)
        else:
            for at in range(count):
                packets[at, wire.STATION], packets[at, wire.SIZE] = 0, -1
            state[wire.PACKETS_LEFT] = count
            if wire.take_in(count, of_descriptors, stations, known, events, received, packets, rows, octets, words):
                size = _pass_on(table, count, heard)
            else:
                _give_back(table)
        _release(table)
        if size > 0:
            return size
        if not has(table):
            return GONE
    return NOTHING
