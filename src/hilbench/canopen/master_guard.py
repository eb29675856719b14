"""One master per bus: a program that writes to it claims it on this machine, and first listens for other masters.

The claim (`hilbench.can.claims`) is what decides between two programs of this machine, also when they start in the
same moment. Received frames show masters that claim nothing: foreign ones, and those of other machines.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from types import MappingProxyType
from typing import Final

from hilbench.can import claims, hub_client
from hilbench.can.claims import MASTER, bringer_of, player_of
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.identifiers import FUNCTION_CODE, SDO_ANSWER
from hilbench.canopen.listening import listen_for_master, present
from hilbench.errors import BusError, UnusableInputError

#: Longer than the usual periods of SYNC (1 to 100 ms) and of a master's heartbeat (up to 1 s).
LISTEN_S: Final = 1.1
#: For a node to answer an SDO request, on a bus of 10 kbit/s too.
_ANSWER_S: Final = 0.2
#: The processes of a bench that was killed end within that.
_PATIENCE_S: Final = 3.0
_NO_MASTER: Final = "a bus without a master; it ends with its program (Ctrl-C there), hilbench estop stops its drives"


def master_of(bus: BusAddress) -> str | None:
    """Program on this machine that is the master of a bus, for a person; None: none has claimed it."""
    holder = claims.holder(bus.place, MASTER)
    return None if holder is None else str(holder)


@contextmanager
def mastery(
    bus: BusAddress,
    master_id: int,
    what: str,
    *,
    brings: Mapping[int, str] = MappingProxyType({}),
    despite_heard: bool = False,
) -> Iterator[None]:
    """Be the master of `bus` meanwhile; `what` is shown to others. `brings`: nodes (id → part) that it will start.

    Raises UnusableInputError when a program on this machine is its master already, when frames of another one are
    received (unless `despite_heard`), when one of the nodes is there without us, or when the bus cannot be opened.
    """
    roles = {MASTER: _NO_MASTER}
    roles |= {
        bringer_of(node_id): f"nobody who plays {part} (node {node_id}); or --no-start, to use it"
        for node_id, part in brings.items()
    }
    with claims.claim(bus.place, roles, what, bus=str(bus), bitrate=bus.bitrate):
        if _may_be_others(bus):
            signs = [] if despite_heard else _listen(bus, master_id)
            if signs:
                raise UnusableInputError(
                    str(bus),
                    f"another master is at work, received {', '.join(signs)}; no program of this machine has said that "
                    "it is the one; expected a bus without, or --force",
                )
            _refuse_answers(bus, {node_id: f"{part}, simulated; or --no-start" for node_id, part in brings.items()})
        yield


@contextmanager
def nodes_of_ours(bus: BusAddress, node_ids: Collection[int], what: str, *, by_bench: bool) -> Iterator[None]:
    """Play these nodes meanwhile. A bench that starts who plays them has looked whether they are there.

    Raises UnusableInputError when another program of this machine plays one of them, or one answers already.
    """
    expected = "nobody who plays node {}"
    roles = {player_of(node_id): expected.format(node_id) for node_id in node_ids}
    if not by_bench:
        roles |= {bringer_of(node_id): expected.format(node_id) for node_id in node_ids}
    with claims.claim(
        bus.place, roles, what, bus=str(bus), bitrate=bus.bitrate, patience_s=_PATIENCE_S if by_bench else 0.0
    ):
        if not by_bench and _may_be_others(bus):
            _refuse_answers(bus, dict.fromkeys(node_ids, "to be simulated"))
        yield


def _refuse_answers(bus: BusAddress, nodes: Mapping[int, str]) -> None:
    if not nodes:
        return
    with closing(_open(bus)) as link:
        link.set_filters([(SDO_ANSWER, FUNCTION_CODE)])
        there = sorted(present(link, nodes, _ANSWER_S))
    if there:
        raise UnusableInputError(
            str(bus), f"node {there[0]} answers already, expected none with that id ({nodes[there[0]]})"
        )


def _listen(bus: BusAddress, master_id: int) -> list[str]:
    with closing(_open(bus)) as link:
        return listen_for_master(link, LISTEN_S, master_id)


def _open(bus: BusAddress) -> Link:
    """Open the bus. Nothing has been started yet, so a bus that cannot be opened is unusable input."""
    try:
        return open_link(bus)
    except BusError as error:
        raise UnusableInputError("bus", str(error)) from error


def _may_be_others(bus: BusAddress) -> bool:
    """True if there may be other stations: an embedded bus without any need not be listened to."""
    if bus.interface != "embedded":
        return True
    try:
        return hub_client.runs(bus.channel) and hub_client.statistics(bus.channel).stations > 0
    except BusError:  # it has just ended
        return False
