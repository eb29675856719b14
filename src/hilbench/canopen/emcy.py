"""Emergency producer: EMCY frames, error register 1001h and error history 1003h (CiA 301)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

from hilbench.canopen.identifiers import COB_ID, INVALID, is_restricted
from hilbench.canopen.object_store import INVALID_VALUE, NO_DATA, ObjectStore, SdoAbort

GENERIC_ERROR = 0x01
COMMUNICATION_ERROR = 0x10

_EMCY = struct.Struct("<HB5s")


class EmergencyProducer:
    """Reports errors when they arise and when they end; `send(cob_id, data)` puts a frame on the bus.

    An error is known by its code and its source (a node that fell silent, the number of an RPDO; 0: the device). It
    counts in 1001h and 1003h in any NMT state; `may_send()` is true if the state lets EMCY frames out. An error that
    arises in STOPPED is pending until `released()` (CiA 301, 7.3.2.2.4): of an error either both messages are sent, or
    none when it came and ended in STOPPED.
    """

    def __init__(
        self,
        store: ObjectStore,
        send: Callable[[int, bytes], None],
        now_ns: Callable[[], int],
        may_send: Callable[[], bool],
    ) -> None:
        self._send = send
        self._now_ns = now_ns
        self._may_send = may_send
        self._active: dict[tuple[int, int], int] = {}
        self._kept: set[tuple[int, int]] = set()  #: codes that the application acknowledges, and for which axis
        self._over: set[tuple[int, int]] = set()  #: errors with such a code whose cause has vanished
        #: Errors that arose while nothing may be sent: their info, or None for an error that has ended.
        self._pending: dict[tuple[int, int], bytes | None] = {}
        self._register = store.cell(0x1001)
        self._cob_id = store.cell(0x1014) if (0x1014, 0) in store else None
        self._inhibit = store.cell(0x1015) if (0x1015, 0) in store else None
        self._count = store.cell(0x1003) if (0x1003, 0) in store else None
        self._history = [store.cell(0x1003, n) for n in range(1, 255) if (0x1003, n) in store]
        self._waiting: list[bytes] = []
        self._free_ns: int | None = None
        if self._count is not None:
            self._count.on_write = self._clear_history
        for place, entry in enumerate(self._history):
            entry.on_read = partial(self._read, place)
        if self._cob_id is not None:
            self._cob_id.on_write = self._check_cob_id

    def raise_error(self, code: int, register_bits: int, info: bytes = b"", source: int = 0) -> None:
        """An error has come: EMCY, register and history; an error that is there already is not reported again."""
        error = code, source
        self._over.discard(error)
        if error in self._active:
            return
        self._active[error] = register_bits | GENERIC_ERROR
        self._update_register()
        self._remember(code, info)
        if self._may_send():
            self._report_come(code, info)
        elif error in self._pending:  # its end is pending: it is known as it is now
            del self._pending[error]
        else:
            self._pending[error] = info

    def clear_error(self, code: int, source: int = 0) -> None:
        """End an error whose cause has vanished: EMCY 0000h with the remaining register, and its code in the info;
        an error with a kept code ends once that is acknowledged."""
        error = code, source
        if error not in self._active:
            return
        if any(code == kept for kept, _ in self._kept):
            self._over.add(error)
            return
        del self._active[error]
        self._update_register()
        if self._may_send():
            self._report_reset(code)
        elif error in self._pending:  # it was never reported
            del self._pending[error]
        else:
            self._pending[error] = None

    def keep(self, code: int, axis: int) -> None:
        """Keep errors with this code, also when their cause vanishes, until `acknowledge` of each axis in fault."""
        self._kept.add((code, axis))

    def acknowledge(self, code: int, axis: int) -> None:
        """Acknowledge an axis's fault reset: errors with this code end with their cause again, or now if it is gone."""
        self._kept.discard((code, axis))
        for error in sorted(self._over):
            if error[0] == code:
                self._over.discard(error)
                self.clear_error(*error)

    def released(self) -> None:
        """Send the pending messages, with the present register: the NMT state lets EMCY frames out again."""
        pending, self._pending = self._pending, {}
        for (code, _), info in pending.items():
            if info is None:
                self._report_reset(code)
            else:
                self._report_come(code, info)

    def reset(self) -> None:
        """Clear the active errors (reset of the node or of its communication); the history stays."""
        self._active.clear()
        self._kept.clear()
        self._over.clear()
        self._pending.clear()
        self._waiting.clear()
        self._free_ns = None
        self._update_register()

    @property
    def waits(self) -> bool:
        """True if a message is held back."""
        return bool(self._waiting)

    def is_active(self, code: int) -> bool:
        """True if an error with this code, of any source, is active."""
        return any(active == code for active, _ in self._active)

    def poll(self, now_ns: int) -> None:
        """Send what the inhibit time held back."""
        while self._waiting and self._is_free(now_ns) and self._may_send():
            self._transmit(self._waiting.pop(0), now_ns)

    def _is_free(self, now_ns: int) -> bool:
        """True if the inhibit time since the last EMCY is over."""
        return self._free_ns is None or now_ns >= self._free_ns

    def _report_come(self, code: int, info: bytes) -> None:
        self._report(_EMCY.pack(code, self._register.value, info[:5].ljust(5, b"\0")))

    def _report_reset(self, code: int) -> None:
        self._report(_EMCY.pack(0, self._register.value, struct.pack("<H", code).ljust(5, b"\0")))

    def _report(self, data: bytes) -> None:
        now_ns = self._now_ns()
        if self._waiting or not self._is_free(now_ns):
            self._waiting.append(data)
        else:
            self._transmit(data, now_ns)

    def _transmit(self, data: bytes, now_ns: int) -> None:
        if self._cob_id is None or self._cob_id.value & INVALID:
            return
        self._send(self._cob_id.value & COB_ID, data)
        if self._inhibit is not None:
            self._free_ns = now_ns + self._inhibit.value * 100_000

    def _update_register(self) -> None:
        value = 0
        for bits in self._active.values():
            value |= bits
        self._register.value = value

    def _remember(self, code: int, info: bytes) -> None:
        if self._count is None or not self._history:
            return
        for older, newer in zip(reversed(self._history[1:]), reversed(self._history[:-1]), strict=True):
            older.value = newer.value
        self._history[0].value = code | int.from_bytes(info[:2].ljust(2, b"\0"), "little") << 16
        self._count.value = min(self._count.value + 1, len(self._history))

    def _read(self, place: int) -> int:
        """An entry of 1003h has no data before so many errors have come."""
        if self._count is None or place >= self._count.value:
            raise SdoAbort(NO_DATA)
        return int(self._history[place].value)

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise SdoAbort(INVALID_VALUE)
        for entry in self._history:
            entry.value = 0

    def _check_cob_id(self, value: int) -> None:
        """1014h: 11-bit identifiers that CiA 301 leaves free; changed only while bit 31 is set."""
        assert self._cob_id is not None
        if value & INVALID:
            return
        in_use = not self._cob_id.value & INVALID
        if is_restricted(value) or (in_use and value != self._cob_id.value):
            raise SdoAbort(INVALID_VALUE)
