"""PDOs of a device, by the present values of 1400h/1600h/1800h/1A00h (CiA 301)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar

from canopen.objectdictionary import ODVariable

from hilbench.canopen.emcy import COMMUNICATION_ERROR, EmergencyProducer
from hilbench.canopen.identifiers import COB_ID, INVALID, MAPPING, is_restricted, pdo_name
from hilbench.canopen.object_store import (
    INVALID_VALUE,
    NOT_MAPPABLE,
    PDO_LENGTH,
    UNSUPPORTED_ACCESS,
    Cell,
    ObjectStore,
    SdoAbort,
)
from hilbench.canopen.pdo import EVENT_DRIVEN_TYPES, PdoMap, bit_length, received_by, sent_by

_DUMMIES = range(0x0002, 0x0008)

PDO_TOO_SHORT = 0x8210
PDO_TOO_LONG = 0x8220
RPDO_TIMED_OUT = 0x8250


class _Pdo:
    """Common part of RPDO and TPDO: their parameters, the rules for writing them, and the codec that follows."""

    _dummies = False  #: true if placeholders may be mapped
    _maps: ClassVar[Callable[[ODVariable], bool]]  #: true for a variable that may be in a PDO of this direction

    def __init__(self, store: ObjectStore, index: int) -> None:
        """`index`: of its communication parameters."""
        self.number = index % MAPPING + 1
        self._store = store
        self._index, mapping = index, index + MAPPING
        self._cob, self._type, self._count = store.cell(index, 1), store.cell(index, 2), store.cell(mapping, 0)
        self._entries = [store.cell(mapping, k) for k in range(1, 65) if (mapping, k) in store]
        self.cells: list[Cell] = []
        self.map: PdoMap | None = None
        self.compiled: tuple[int, ...] = ()  #: parameters that the codec follows
        self._cob.on_write = self._check_cob
        self._type.on_write = self._check_type
        self._count.on_write = self._check_count
        for entry in self._entries:
            entry.on_write = self._check_entry
        for sub in (3, 6):
            if (self._index, sub) in store:
                store.cell(self._index, sub).on_write = self._only_while_invalid

    def __str__(self) -> str:
        return pdo_name(self._index)

    @property
    def valid(self) -> bool:
        """Bit 31 of the COB-ID is clear."""
        return not self._cob.value & INVALID

    @property
    def cob_id(self) -> int:
        """Identifier of its frames."""
        return int(self._cob.value & COB_ID)

    @property
    def transmission_type(self) -> int:
        """Sub-index 2."""
        return int(self._type.value)

    def _timer_ns(self, sub: int, unit_ns: int) -> int:
        return int(self._store.cell(self._index, sub).value * unit_ns) if (self._index, sub) in self._store else 0

    def parameters(self) -> tuple[int, ...]:
        """COB-ID, type and mapping as in the objects."""
        return (self._cob.value, self._type.value, self._count.value, *(entry.value for entry in self._entries))

    def restart(self) -> None:
        """Start anew after a change of its parameters: earlier frames do not count any more."""
        raise NotImplementedError

    def compile(self) -> None:
        """Build the codec anew from the mapping object. Raises SdoAbort for one that can't be; there is no map then."""
        self.compiled = self.parameters()
        self.cells, self.map = [], None
        count = min(self._count.value, len(self._entries))
        # An empty entry of a default mapping carries nothing; none can be written among those that count.
        self.cells = cells = self._mapped_cells(entry.value for entry in self._entries[:count] if entry.value)
        self.map = PdoMap(self.cob_id, self.transmission_type, [cell.variable for cell in cells]) if cells else None

    def _mapped_cells(self, entries: Iterable[int]) -> list[Cell]:
        """Cells named by mapping entries, of eight bytes at most. Raises SdoAbort."""
        cells = [self._mapped(entry) for entry in entries]
        if sum(bit_length(cell.variable) for cell in cells) > 64:
            raise SdoAbort(PDO_LENGTH)
        return cells

    def _mapped(self, entry: int) -> Cell:
        """The cell that a mapping entry names. Raises SdoAbort."""
        index, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if index in _DUMMIES:
            return self._dummy(index, sub, bits)
        cell = self._store.requested(index, sub)
        variable = cell.variable
        if not variable.pdo_mappable or not type(self)._maps(variable):
            raise SdoAbort(NOT_MAPPABLE)
        try:
            length = bit_length(variable)
        except ValueError:
            raise SdoAbort(NOT_MAPPABLE) from None
        if length != bits:
            raise SdoAbort(NOT_MAPPABLE)
        return cell

    def _dummy(self, index: int, sub: int, bits: int) -> Cell:
        """A placeholder: only what the DummyUsage of the EDS allows, and only in a receive PDO."""
        variable = self._store.od.indices.get(index)
        if not isinstance(variable, ODVariable) or sub or not self._dummies or bit_length(variable) != bits:
            raise SdoAbort(NOT_MAPPABLE)
        return Cell(variable)

    def _check_cob(self, value: int) -> None:
        """Bits 0 to 29 may change only while the PDO is invalid, before and after the write."""
        if value & INVALID:
            return
        if is_restricted(value) or (self.valid and value & COB_ID != self.cob_id):
            raise SdoAbort(INVALID_VALUE)
        self._mapped_cells(entry.value for entry in self._entries[: self._count.value] if entry.value)

    def _check_type(self, value: int) -> None:
        if 240 < value not in EVENT_DRIVEN_TYPES:
            raise SdoAbort(INVALID_VALUE)

    def _only_while_invalid(self, value: int) -> None:
        # One that can't be made invalid, by its COB-ID, is mapped as it is.
        if self.valid and self._cob.variable.writable:
            raise SdoAbort(UNSUPPORTED_ACCESS)

    def _check_count(self, value: int) -> None:
        self._only_while_invalid(value)
        if value > len(self._entries):
            raise SdoAbort(PDO_LENGTH)
        self._mapped_cells(entry.value for entry in self._entries[:value])

    def _check_entry(self, value: int) -> None:
        self._only_while_invalid(value)
        if self._count.value:
            raise SdoAbort(UNSUPPORTED_ACCESS)
        if value:
            self._mapped(value)


class Rpdo(_Pdo):
    """A receive PDO. Synchronous data act at the next SYNC, event-driven data at once."""

    _dummies = True
    _maps = received_by

    def __init__(self, store: ObjectStore, index: int, emcy: EmergencyProducer, now_ns: Callable[[], int]) -> None:
        super().__init__(store, index)
        self._emcy = emcy
        self._now_ns = now_ns
        self._waiting: bytes | None = None
        self._deadline_ns: int | None = None
        self._length_error: int | None = None  #: EMCY code of the last frame's wrong length
        self._timer_ms = store.cell(self._index, 5) if (self._index, 5) in store else None
        self.refused = 0  #: values that an object refused

    def receive(self, data: bytes) -> None:
        """Data of its frame. Too short: dropped. Too long: its beginning counts (CiA 301, 7.2.2.5.1)."""
        pdo_map = self.map
        if pdo_map is None:
            return
        if len(data) != pdo_map.size:
            too_short = len(data) < pdo_map.size
            code = PDO_TOO_SHORT if too_short else PDO_TOO_LONG
            self._emcy.raise_error(code, COMMUNICATION_ERROR, bytes([self.number & 0xFF]), self.number)
            if self._length_error not in (None, code):
                self._emcy.clear_error(self._length_error, self.number)
            self._length_error = code
            if too_short:
                return
            data = data[: pdo_map.size]
        elif self._length_error is not None:
            self._emcy.clear_error(self._length_error, self.number)
            self._length_error = None
        if self._timer_ms is not None and self._timer_ms.value:
            self._deadline_ns = self._now_ns() + self._timer_ns(5, 1_000_000)
        self._emcy.clear_error(RPDO_TIMED_OUT, self.number)
        if self._type.value <= 240:
            self._waiting = data
        else:
            self._act(data)

    @property
    def idle(self) -> bool:
        """True if it has received nothing that acts later, or is supervised."""
        return self._waiting is None and self._deadline_ns is None

    def fits_fast_path(self, cycle_ns: int) -> bool:
        """True if a frame a cycle only gives its objects their values at SYNC."""
        timer_ns = self._timer_ns(5, 1_000_000) if self._timer_ms is not None else 0
        return (
            self.map is not None
            and self._type.value <= 240
            and self._waiting is None
            and self._length_error is None
            and not self._emcy.is_active(RPDO_TIMED_OUT)
            and (timer_ns == 0 or timer_ns >= cycle_ns)
        )

    def received_until(self, now_ns: int) -> None:
        """Account for frames taken by the fast path; the last one at `now_ns`."""
        if self._timer_ms is not None and self._timer_ms.value:
            self._deadline_ns = now_ns + self._timer_ns(5, 1_000_000)

    def sync(self) -> None:
        """Let the data received since the last SYNC act."""
        if self._waiting is not None:
            data, self._waiting = self._waiting, None
            self._act(data)

    def poll(self, now_ns: int) -> bool:
        """True if its event timer has just expired without a frame."""
        if self._deadline_ns is None or now_ns <= self._deadline_ns:
            return False
        self._deadline_ns = None
        return self._timer_ns(5, 1_000_000) > 0  # it may have been switched off meanwhile

    def rephase(self, now_ns: int) -> None:
        """Give a running event timer its full time from now on."""
        if self._deadline_ns is not None:
            self._deadline_ns = now_ns + self._timer_ns(5, 1_000_000)

    def reset(self) -> None:
        """Forget what was received."""
        self._waiting, self._deadline_ns = None, None

    def restart(self) -> None:
        """Forget what was received and what was wrong with it."""
        self.reset()
        for code in (PDO_TOO_SHORT, PDO_TOO_LONG, RPDO_TIMED_OUT):
            self._emcy.clear_error(code, self.number)
        self._length_error = None

    def _act(self, data: bytes) -> None:
        assert self.map is not None
        for cell, value in zip(self.cells, self.map.unpack(data), strict=True):
            if cell.on_write is not None:
                try:
                    cell.on_write(value)
                except SdoAbort:
                    self.refused += 1
                    continue
            cell.value = value


class Tpdo(_Pdo):
    """A transmit PDO; `send(cob_id, data)` puts its frame on the bus."""

    _maps = sent_by

    def __init__(self, store: ObjectStore, index: int, send: Callable[[int, bytes], None]) -> None:
        super().__init__(store, index)
        self._send = send
        self.syncs = 0  #: SYNCs since it was sent
        self._sent: bytes | None = None
        self._free_ns = 0
        self._event_ns = 0
        self._started = False

    def restart(self) -> None:
        """Count SYNCs anew and forget what was sent (also when OPERATIONAL is entered)."""
        self.syncs = 0
        self._sent = None
        self._started = (self._index, 6) not in self._store or not self._store.cell(self._index, 6).value

    @property
    def fits_fast_path(self) -> bool:
        """True if it is sent with every n-th SYNC, and has been started."""
        return self._started and 1 <= self._type.value <= 240

    def sent_until(self, syncs: int, data: bytes | None) -> None:
        """Account for frames sent by the fast path: SYNCs since the last, and its data; None: none sent."""
        self.syncs = syncs
        if data is not None:
            self._sent = data

    def sync(self, counter: int | None) -> None:
        """SYNC: send if it is this PDO's turn."""
        kind = self._type.value
        if kind > 240 or self.map is None or not self.valid:
            return
        if not self._started:
            # With a SYNC start value the SYNC that carries it is the first one that counts.
            if counter is None or counter != self._store.cell(self._index, 6).value:
                return
            self._started = True
            self.syncs = kind - 1
        if kind == 0:
            if self._data() != self._sent:
                self._transmit(self._data())
            return
        self.syncs += 1
        if self.syncs >= kind:
            self.syncs = 0
            self._transmit(self._data())

    def poll(self, now_ns: int) -> None:
        """Event-driven types: send on change and when the event timer is over, not before the inhibit time is."""
        if self._type.value not in EVENT_DRIVEN_TYPES or self.map is None or not self.valid or now_ns < self._free_ns:
            return
        data = self._data()
        timer_ns = self._timer_ns(5, 1_000_000)
        if data != self._sent or (timer_ns and now_ns >= self._event_ns):
            self._transmit(data)
            self._free_ns = now_ns + self._timer_ns(3, 100_000)
            self._event_ns = now_ns + timer_ns

    def rephase(self, now_ns: int) -> None:
        """Count inhibit time and event timer from now."""
        self._free_ns = min(self._free_ns, now_ns)
        self._event_ns = now_ns + self._timer_ns(5, 1_000_000)

    def request(self) -> None:
        """A remote request for it."""
        if self.map is not None and not self._cob.value & 0x40000000:
            self._transmit(self._data())

    def _data(self) -> bytes:
        assert self.map is not None
        return self.map.pack([cell.value for cell in self.cells])

    def _transmit(self, data: bytes) -> None:
        self._sent = data
        self._send(self._cob.value & COB_ID, data)
