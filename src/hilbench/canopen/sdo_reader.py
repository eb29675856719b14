"""What a device itself says by SDO, whatever its EDS file claims."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType

import canopen
from hilbench.can.python_can import can
from hilbench.errors import BusError


@dataclass(frozen=True)
class Refusal:
    """The device's abort code (CiA 301, table 22)."""

    code: int

    def __str__(self) -> str:
        return f"abort {self.code:08X}h ({canopen.SdoAbortedError.CODES.get(self.code, 'unknown code')})"


#: None: no answer.
Answer = bytes | Refusal | None


class SdoReader:
    """Reads objects of any node through canopen, without object dictionaries: bytes as long as the device sends them.

    Takes the bus over, and closes it.
    """

    def __init__(self, bus: can.BusABC, timeout_s: float) -> None:
        self._network = canopen.Network(bus)
        self._network.NOTIFIER_CYCLE = 0.1  # how long canopen's thread may go on after `close`
        self._network.connect()
        self._timeout_s = timeout_s

    def read(self, node_id: int, index: int, sub: int = 0) -> Answer:
        """The content of an object, the device's refusal, or None when it does not answer in time.

        Raises BusError when the request cannot be sent.
        """
        if node_id not in self._network:
            node = self._network.add_node(node_id, canopen.ObjectDictionary())
            node.sdo.RESPONSE_TIMEOUT = self._timeout_s
            node.sdo.MAX_RETRIES = 1  # one try: canopen counts down to zero before it gives up
        try:
            return bytes(self._network[node_id].sdo.upload(index, sub))
        except canopen.SdoAbortedError as error:
            return Refusal(error.code)
        except canopen.SdoCommunicationError:
            return None
        except (can.CanError, OSError) as error:
            raise BusError(
                f"SDO request to node {node_id} could not be sent: {' '.join(str(error).split())}"
            ) from error

    def close(self) -> None:
        """Leave the bus."""
        self._network.disconnect()

    def __enter__(self) -> SdoReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
