"""Asks a running bench to change a quantity: SDO writes of its node (`hilbench.bench.operator.operator_objects`)."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from canopen import SdoAbortedError
from hilbench.bench.machines.ranges import operator_ranges
from hilbench.bench.operator.operator_objects import INDEX, answer_id, request_id
from hilbench.can.frame import Frame
from hilbench.canopen.object_store import PRESENT_STATE, VALUE_TOO_HIGH, VALUE_TOO_LOW
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import LINE_SPEED, TENSION_SET_POINT, YOUNGS_MODULUS

#: Expedited download of four bytes, its confirmation, and an abort (CiA 301, 7.2.4.3).
_DOWNLOAD, _DONE, _ABORT = 0x23, 0x60, 0x80
#: How long the bench may take; in lockstep it answers with its next cycle.
_PATIENCE_S: Final = 3.0


@dataclass(frozen=True)
class Quantity:
    """One that can be changed, as a person is asked for it."""

    path: str
    title: str
    unit: str
    si_per_unit: float


#: By the key that asks for it.
CHANGEABLE: Final = {
    "v": Quantity(LINE_SPEED, "line speed", "m/s", 1.0),
    "t": Quantity(TENSION_SET_POINT, "tension set-point", "N", 1.0),
    "m": Quantity(YOUNGS_MODULUS, "E of the imitated web", "N/mm²", 1e6),
}


class ChangeRequests:
    """Sends one request after the other; `take` is given what was heard, and says how each ended."""

    def __init__(self, config: BenchConfig, send: Callable[[Sequence[Frame]], None]) -> None:
        self._config = config
        self._ranges = operator_ranges(config)
        self._send = send
        self._waiting: deque[tuple[Quantity, float]] = deque()
        self._sent_s: float | None = None

    def ask(self, quantity: Quantity, value: float) -> None:
        """Ask for a value, in the quantity's unit, as soon as those before it have been answered."""
        self._waiting.append((quantity, value))

    def take(self, frames: Iterable[Frame], now_s: float) -> list[str]:
        """Go on; returns a line for each request that has ended."""
        ended = []
        for can_id, data, _ in frames:
            if can_id == answer_id(self._config) and self._sent_s is not None and self._is_answer(data):
                ended.append(self._said(data))
                self._next()
        if self._sent_s is not None and now_s - self._sent_s > _PATIENCE_S:
            ended.append(f"{self._asked()}: no answer from the bench (node {self._config.master.node_id})")
            self._next()
        if self._waiting and self._sent_s is None:
            quantity, value = self._waiting[0]
            data = struct.pack("<BHBf", _DOWNLOAD, INDEX, self._sub(), value * quantity.si_per_unit)
            self._send([Frame(request_id(self._config), data)])
            self._sent_s = now_s
        return ended

    def range_of(self, quantity: Quantity) -> tuple[float, float]:
        """What the bench accepts by its config, in the quantity's unit."""
        low, high = self._ranges[quantity.path]
        return low / quantity.si_per_unit, high / quantity.si_per_unit

    def _next(self) -> None:
        self._waiting.popleft()
        self._sent_s = None

    def _asked(self) -> str:
        quantity, value = self._waiting[0]
        return f"{quantity.title} {value:g} {quantity.unit}"

    def _is_answer(self, data: bytes) -> bool:
        return len(data) == 8 and data[0] in (_DONE, _ABORT) and data[1:4] == struct.pack("<HB", INDEX, self._sub())

    def _sub(self) -> int:
        return list(self._ranges).index(self._waiting[0][0].path) + 1

    def _said(self, data: bytes) -> str:
        if data[0] == _DONE:
            return f"{self._asked()}: set"
        quantity, _ = self._waiting[0]
        code = int.from_bytes(data[4:], "little")
        if code in (VALUE_TOO_HIGH, VALUE_TOO_LOW):
            low, high = self.range_of(quantity)
            reason = f"expected {low:g} to {high:g} {quantity.unit}"
        elif code == PRESENT_STATE:
            reason = "the experiment moves it just now, or does not run"
        else:
            reason = SdoAbortedError.CODES.get(code, "unknown code")
        return f"{self._asked()}: refused, {reason} (abort {code:08X}h)"
