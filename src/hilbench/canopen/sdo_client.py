"""SDO client: canopen's, in bytes and without object dictionaries, for any node of a bus."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final, Self

from canopen.sdo.client import SdoClient as CanopenClient

import canopen
from canopen import ObjectDictionary
from canopen import SdoAbortedError as SdoAbortedError
from canopen import SdoCommunicationError as SdoCommunicationError
from hilbench.can.python_can import can
from hilbench.canopen.eds import with_mapped_pdos
from hilbench.canopen.identifiers import FUNCTION_CODE, SDO_ANSWER
from hilbench.errors import BusError, one_line

#: How long its thread waits for a message at a time: by then it sees that it is to end. Leaving waits for half of it
#: on average, and a thread that receives nothing takes some 0.1 % of a core.
_RECEIVES_FOR_S = 0.02


class Network(canopen.Network):
    """canopen's network with a short receive time-out, so that leaving it does not wait long for its thread: takes a
    bus over, and closes it with `disconnect`."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)
        self.NOTIFIER_CYCLE = _RECEIVES_FOR_S


#: For a bus on which nothing is wanted but answers.
SDO_ANSWERS: Final[can.typechecking.CanFilters] = [{"can_id": SDO_ANSWER, "can_mask": FUNCTION_CODE, "extended": False}]

#: A frame, and the command of an abort.
_BYTES, _ABORTED = 8, 0x80
#: Store and restore parameters.
_STORED: Final = (0x1010, 0x1011)
_STORED_S: Final = 10.0

#: Number of sent frames kept until received, and for how long: in lockstep no cycle may run for a while.
_SENT_KEPT, _SENT_KNOWN_S = 4096, 60.0


@dataclass(frozen=True)
class Refusal:
    """The device's abort code (CiA 301, table 22)."""

    code: int

    def __str__(self) -> str:
        return f"abort {self.code:08X}h ({SdoAbortedError.CODES.get(self.code, 'unknown code')})"


def reason_of(error: Exception, timeout_s: float) -> str:
    """Reason of a transfer that has failed: an abort, no answer, or a wrong one."""
    if isinstance(error, SdoAbortedError):
        return str(Refusal(error.code))
    text = str(error).rstrip(".")
    return f"no answer within {timeout_s:g} s" if text.startswith("No SDO response") else f"wrong answer: {text}"


#: None: no answer.
Answer = bytes | Refusal | None


class SentFrames:
    """Frames sent lately, to recognize them when received on another connection to the bus."""

    def __init__(self) -> None:
        self._times_s: dict[tuple[int, bytes], list[float]] = {}
        self._lock = threading.Lock()

    def add(self, can_id: int, data: bytes) -> None:
        """Add a frame about to be sent."""
        with self._lock:
            times_s = self._times_s
            key = can_id, data
            times_s[key] = [*times_s.pop(key, ()), time.monotonic()][-_SENT_KEPT:]  # the last sent are the last kept
            if len(times_s) > _SENT_KEPT:  # those were lost, or there was no listener
                del times_s[next(iter(times_s))]

    def take(self, can_id: int, data: bytes) -> bool:
        """True if a received frame was sent here not long ago; each is recognized once."""
        key = can_id, data
        if key not in self._times_s:
            return False
        with self._lock:
            young = [at_s for at_s in self._times_s.pop(key, ()) if time.monotonic() - at_s < _SENT_KNOWN_S]
            if len(young) > 1:
                self._times_s[key] = young[1:]
            return bool(young)


class _Network(Network):
    """A network that keeps what it sends."""

    def __init__(self, bus: can.BusABC, sent: SentFrames) -> None:
        super().__init__(bus)
        self._sent = sent

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._sent.add(can_id, bytes(data))
        super().send_message(can_id, data, remote)


class _LossIsKnown(can.Listener):
    """Ends canopen's thread silently when the bus is lost; `Network.check` reports it where the bus is used next."""

    def on_message_received(self, msg: can.Message) -> None:
        """Ignore the message: other listeners take it."""

    def on_error(self, exc: Exception) -> None:
        """End the thread: python-can prints an unhandled error, and retries at once, for ever, after a handled one."""
        raise SystemExit

    def stop(self) -> None:
        """Do nothing: no resource is held."""


class SdoClient:
    """Transfers with any node, one at a time with each; `sent` is what it has put on the bus.

    Takes the bus over, and closes it.
    """

    def __init__(self, bus: can.BusABC, timeout_s: float) -> None:
        self.sent = SentFrames()
        self._network = _Network(bus, self.sent)
        self._network.listeners.append(_LossIsKnown())  # type: ignore[arg-type] # any listener will do
        self._network.connect()
        self.timeout_s = timeout_s  #: time-out of an answer to a request
        self._locks: dict[int, threading.Lock] = {}  # a node that does not answer holds up no other

    def read(self, node_id: int, index: int, sub: int = 0) -> Answer:
        """The content of an object, the device's refusal, or None when it does not answer in time.

        Raises BusError when the request cannot be sent.
        """
        try:
            return self.upload(node_id, index, sub)
        except SdoAbortedError as error:
            return Refusal(error.code)
        except SdoCommunicationError:
            return None

    def upload(self, node_id: int, index: int, sub: int, width: int | None = None) -> bytes:
        """All bytes of the answer; of one without a size indication, the first `width`.

        Raises canopen's SdoAbortedError and SdoCommunicationError (no answer), and BusError when the bus is lost.
        """
        with self._transfer(node_id) as client, client.open(index, sub, buffering=0) as answer:
            data = bytes(answer.read())  # canopen's own `upload` truncates to the EDS's length
        # Expedited without a size (CiA 301, 7.2.4.3.6, s = 0): four bytes, of which the type's are meant.
        return data[:width] if answer.exp_data is not None and answer.size is None else data

    def download(self, node_id: int, index: int, sub: int, data: bytes) -> None:
        """Write an object. Raises as `upload`."""
        with self._transfer(node_id) as client:
            client.RESPONSE_TIMEOUT = self._time_out_s(index)
            try:
                client.download(index, sub, data)
            finally:
                client.RESPONSE_TIMEOUT = self.timeout_s

    def _time_out_s(self, index: int) -> float:
        """Time-out of the answer to a write: storing in a device's flash memory takes longer."""
        return max(self.timeout_s, _STORED_S) if index in _STORED else self.timeout_s

    def receive_only_answers(self) -> None:
        """Receive SDO answers only from now on: the cyclic traffic is read elsewhere."""
        bus = self._network.bus
        assert bus is not None, "connected since it was made"
        bus.set_filters(SDO_ANSWERS)

    def close(self) -> None:
        """Leave the bus. A lost one has been reported where it was used."""
        with suppress(can.CanError):
            self._network.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add(self, node_id: int, od: ObjectDictionary) -> None:
        node = self._network.add_node(node_id, with_mapped_pdos(od))
        node.sdo.RESPONSE_TIMEOUT = self.timeout_s
        node.sdo.MAX_RETRIES = 1  # one try: canopen counts down to zero before it gives up
        self._locks[node_id] = threading.Lock()

    @contextmanager
    def _transfer(self, node_id: int) -> Iterator[Any]:
        if node_id not in self._locks:
            self._add(node_id, ObjectDictionary())
        try:
            with self._locks[node_id]:
                yield self._network[node_id].sdo
        except (can.CanError, OSError) as error:
            raise BusError(f"SDO request to node {node_id} could not be sent: {one_line(error)}") from error


class Transfers(CanopenClient):
    """canopen's transfers, by a function that answers a request."""

    def __init__(self, exchange: Callable[[bytes], bytes | None]) -> None:
        super().__init__(0, 0, ObjectDictionary())
        self._exchange = exchange

    def request_response(self, sdo_request: bytes) -> bytes:
        """Raises SdoAbortedError, and SdoCommunicationError without an answer of the length of one."""
        answer = self._exchange(bytes(sdo_request))
        if answer is None or len(answer) != _BYTES:
            raise SdoCommunicationError("no answer")
        if answer[0] == _ABORTED:
            raise SdoAbortedError(int.from_bytes(answer[4:], "little"))
        return answer

    def abort(self, abort_code: int = 0) -> None:
        """No abort is sent."""
