"""Asks a running bench to change a quantity: SDO writes of its node (`hilbench.bench.operator.operator_objects`)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from canopen import SdoAbortedError, SdoCommunicationError
from hilbench.bench.machines.ranges import OPERATOR_OBJECTS, operator_ranges
from hilbench.bench.operator.operator_objects import INDEX
from hilbench.canopen.data_types import REAL32, data_type
from hilbench.canopen.object_store import PRESENT_STATE, VALUE_TOO_HIGH, VALUE_TOO_LOW
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import BusError
from hilbench.topology.config import BenchConfig
from hilbench.topology.main_quantities.of_kind import find_quantity
from hilbench.topology.main_quantities.quantity import MainQuantity

#: How long the bench may take, s; in lockstep it answers with its next cycle.
PATIENCE_S: Final = 3.0


class ChangeRequests:
    """Makes one request after the other, in a thread of its own; `ended` says how each ended.

    The bus is joined, by `open_client`, with the first request: until then a monitor only listens.
    """

    def __init__(self, config: BenchConfig, open_client: Callable[[], SdoClient]) -> None:
        self._config = config
        self._open_client = open_client
        self._client: SdoClient | None = None
        self._thread = ThreadPoolExecutor(1, "changes")
        self._requests: deque[Future[str]] = deque()
        self._ranges = operator_ranges(config)
        known = map(find_quantity, self._ranges)
        self.changeable = {quantity.key: quantity for quantity in known if quantity is not None}  #: by key

    def ask(self, quantity: MainQuantity, value: float) -> None:
        """Ask for a value, in the quantity's unit, as soon as those before it have been answered."""
        self._requests.append(self._thread.submit(self._change, quantity, value))

    def ended(self) -> list[str]:
        """A line for each request that has ended since the last call."""
        lines = []
        while self._requests and self._requests[0].done():
            lines.append(self._requests.popleft().result())
        return lines

    def range_of(self, quantity: MainQuantity) -> tuple[float, float]:
        """What the bench accepts by its config, in the quantity's unit."""
        low, high = self._ranges[quantity.path]
        return low / quantity.si_per_shown, high / quantity.si_per_shown

    def close(self) -> None:
        """Leave the bus; what was not asked yet is not asked any more."""
        self._thread.shutdown(cancel_futures=True)
        if self._client is not None:
            self._client.close()

    def _change(self, quantity: MainQuantity, value: float) -> str:
        asked = f"{quantity.title} {value:g} {quantity.in_unit}"
        node_id, data = self._config.master.node_id, data_type(REAL32).encode(value * quantity.si_per_shown)
        try:
            if self._client is None:
                self._client = self._open_client()
            self._client.download(node_id, INDEX, OPERATOR_OBJECTS[quantity.path][0], data)
        except SdoAbortedError as error:
            return f"{asked}: refused, {self._reason(quantity, error.code)} (abort {error.code:08X}h)"
        except SdoCommunicationError:
            return f"{asked}: no answer from the bench (node {node_id})"
        except BusError as error:
            return f"{asked}: NOT SENT: {error}"
        return f"{asked}: set"

    def _reason(self, quantity: MainQuantity, code: int) -> str:
        if code in (VALUE_TOO_HIGH, VALUE_TOO_LOW):
            low, high = self.range_of(quantity)
            return f"expected {low:g} to {high:g} {quantity.in_unit}"
        if code == PRESENT_STATE:
            return "the experiment moves it just now, or does not run"
        return str(SdoAbortedError.CODES.get(code, "unknown code"))
