"""The CANopen device runtime, slave side (CiA 301): NMT states gate SDO, PDO, SYNC, EMCY and heartbeat.

A device does nothing by itself: its host passes frames (`handle`, `sync`) and time (`poll`) and sends the frames in
`replies` (answers to a request, due at once) and `outbox` (frames by the device itself).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import canopen
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.canopen.clock import Clock
from hilbench.canopen.data_types import DataType
from hilbench.canopen.device_pdo import RPDO_TIMED_OUT, Rpdo, Tpdo
from hilbench.canopen.eds import require_integers
from hilbench.canopen.emcy import COMMUNICATION_ERROR, EmergencyProducer
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.canopen.heartbeat import HeartbeatConsumer, HeartbeatProducer, NodeGuarding
from hilbench.canopen.identifiers import (
    COB_ID,
    HEARTBEAT,
    MAPPING,
    NMT,
    PRODUCE_SYNC,
    RPDO_INDICES,
    SDO_REQUEST,
    SYNC,
    TPDO_INDICES,
    NmtCommand,
    NmtState,
    is_restricted,
    node_of,
    pdo_name,
)
from hilbench.canopen.object_store import INVALID_VALUE, PRESENT_STATE, Cell, ObjectStore, SdoAbort
from hilbench.canopen.sdo_server import DeviceSdoServer, may_write
from hilbench.canopen.storage import Storage
from hilbench.errors import UnusableInputError

__all__ = ["Cell", "Device", "SdoAbort"]

#: Actions of 1029h sub 1 when a heartbeat is lost; any other value: no change.
_TO_PRE_OPERATIONAL, _TO_STOPPED = 0, 2

HEARTBEAT_LOST = 0x8130
SYNC_LENGTH = 0x8240

#: In the place of a node id: the master whose guarding is missed (life guarding event, CiA 301).
_GUARD = 0
_WITHOUT_TOP_BIT = 0x7FFFFFFF  #: of 1005h: it means nothing there

_ERROR_REGISTER = 0x1001
#: Objects that the runtime calculates with.
_INTEGERS = {0x1001, *range(0x1005, 0x1008), 0x100C, 0x100D, *range(0x1014, 0x101A), *range(0x1400, 0x1C00)}

_COMMUNICATION_AREA = (0x1000, 0x1FFF)
_ALL_AREAS = (0x1000, 0x9FFF)


class Device:
    """One CANopen device on the object dictionary of an EDS file.

    `cell(index, sub)` is the one place of an object's value. The application may set `on_nmt(state)` (called on every
    change, INITIALISING for a reset), `on_communication_error(code)` (EMCY code: a watched heartbeat or an RPDO
    missed), `on_emergency_stop()` (the global fail-safe command has come) and `on_write` of cells.
    Raises UnusableInputError when the EDS lacks what a device needs.
    """

    def __init__(self, od: canopen.ObjectDictionary, node_id: int, clock: Clock, *, store: Path | None = None) -> None:
        self.node_id = node_id
        self.nmt_state = NmtState.INITIALISING
        self.replies: list[Frame] = []
        self.outbox: list[Frame] = []
        #: For tests of masters: no frame, or no heartbeat, is sent meanwhile.
        self.silent = False
        self.heartbeat_fails = False
        self.on_nmt: Callable[[NmtState], None] | None = None
        self.on_communication_error: Callable[[int], None] | None = None
        self.on_emergency_stop: Callable[[], None] | None = None
        self._clock = clock
        self._store = ObjectStore(od)
        self.cell = self._store.cell
        require_integers(od, _INTEGERS)
        if not self.has(_ERROR_REGISTER):
            raise UnusableInputError(f"EDS of node {node_id}", "object 1001h is missing, a device needs it")
        self._storage = Storage(self._store, store)
        self._sdo = DeviceSdoServer(node_id, self._store, self._reply)
        self._emcy = EmergencyProducer(self._store, self._send, clock.now_ns, self._communicates)
        self.emergency, self.clear_emergency = self._emcy.raise_error, self._emcy.clear_error
        self.keep_emergency, self.acknowledge_emergency = self._emcy.keep, self._emcy.acknowledge
        self.producer = HeartbeatProducer(self._store, clock.now_ns)  #: heartbeat producer of the device
        back = partial(self._emcy.clear_error, HEARTBEAT_LOST)
        self.consumer = HeartbeatConsumer(self._store, clock.now_ns, self._heartbeat_lost, back)
        guard_lost, guard_back = partial(self._heartbeat_lost, _GUARD), partial(back, _GUARD)
        self._guarding = NodeGuarding(self._store, clock.now_ns, guard_lost, guard_back)
        received, sent = (
            [index for index in indices if self.has(index, 1) and self.has(index + MAPPING)]
            for indices in (RPDO_INDICES, TPDO_INDICES)
        )
        self._rpdos = [Rpdo(self._store, index, self._emcy, clock.now_ns) for index in received]
        self._tpdos = [Tpdo(self._store, index, self._send) for index in sent]
        #: PDOs that can't be as the EDS file has them: without a mapping, or valid with one that can't be; a line each.
        self.left_out: dict[str, str] = {
            name: f"{name} is not sent or received: object {index + MAPPING:04X}h is missing, its mapping"
            for index in od.indices
            if (name := pdo_name(index)) and index + MAPPING not in od.indices
        }
        self.receive_pdos: dict[int, Rpdo] = {}  #: RPDOs in use, by identifier
        self.synchronous_pdos: list[Tpdo] = []  #: TPDOs sent with SYNC, in their order
        self._event_driven: list[Tpdo] = []
        self._restrict_sync_objects()
        self._reset(*_ALL_AREAS)

    # -- application side --------------------------------------------------------------------------------

    def has(self, index: int, sub: int = 0) -> bool:
        """True if the EDS has the object."""
        return (index, sub) in self._store

    # -- host side ---------------------------------------------------------------------------------------

    @property
    def fits_fast_path(self) -> bool:
        """True if it is OPERATIONAL and sends only synchronous PDOs and heartbeats."""
        return (
            self.nmt_state is NmtState.OPERATIONAL
            and not (self.silent or self.heartbeat_fails or self.replies or self.outbox or self._event_driven)
            and not (self._sync_counter is not None and self._sync_counter.value)
            and not (self._emcy.waits or self._emcy.is_active(SYNC_LENGTH) or self._guarding.watches)
            and all(tpdo.fits_fast_path for tpdo in self.synchronous_pdos)
        )

    def boot(self) -> None:
        """Send boot-up and enter PRE-OPERATIONAL."""
        self._reply(HEARTBEAT + self.node_id, NmtState.INITIALISING.heartbeat)
        self._enter(NmtState.PRE_OPERATIONAL)

    def identifiers(self) -> set[int]:
        """Identifiers (REMOTE_FLAG in those of remote requests) of the frames other than SYNC that the device
        receives as it is configured now."""
        return {
            *(NMT, SDO_REQUEST + self.node_id, EMERGENCY_STOP_COB_ID),
            *(HEARTBEAT + node_id for node_id in self.consumer.times_ns()),
            *self.receive_pdos,
            *(tpdo.cob_id | REMOTE_FLAG for tpdo in self._tpdos if tpdo.valid),
            *([HEARTBEAT + self.node_id | REMOTE_FLAG] if self._guarding.offered else []),
        }

    def handle(self, frame: Frame) -> None:
        """Any frame of the bus but SYNC."""
        can_id = frame.can_id
        receiver = self.receive_pdos.get(can_id)
        if receiver is not None:
            if self.nmt_state is NmtState.OPERATIONAL:
                receiver.receive(frame.data)
        elif can_id == SDO_REQUEST + self.node_id:
            if self._communicates():
                self._sdo.handle(frame.data)
                if may_write(frame.data):
                    self._compile_pdos_if_changed()
        elif can_id == NMT:
            self._nmt_command(frame.data)
        elif can_id == EMERGENCY_STOP_COB_ID:
            if self.on_emergency_stop is not None:
                self.on_emergency_stop()
        elif can_id == HEARTBEAT + self.node_id | REMOTE_FLAG:
            if self._guarding.offered and not self.producer.period_ns:  # heartbeat takes the place of guarding
                self._reply(HEARTBEAT + self.node_id, self._guarding.answer(self.nmt_state))
        elif sender := node_of(can_id, HEARTBEAT):
            if len(frame.data) == 1 and frame.data != NmtState.INITIALISING.heartbeat:
                self.consumer.received(sender)
        elif can_id & REMOTE_FLAG and not can_id & EXTENDED_FLAG and self.nmt_state is NmtState.OPERATIONAL:
            for tpdo in self._tpdos:
                if tpdo.valid and tpdo.cob_id == can_id & COB_ID:
                    tpdo.request()

    @property
    def sync_cob_id(self) -> int:
        """Identifier of SYNC, 1005h."""
        return int(self._sync_cob.value & COB_ID)

    def sync(self, data: bytes) -> None:
        """SYNC: in OPERATIONAL synchronous RPDOs act, synchronous TPDOs are sampled and sent."""
        if not self._communicates():
            return
        expected = 1 if self._sync_counter is not None and self._sync_counter.value else 0
        if len(data) != expected:
            self._emcy.raise_error(SYNC_LENGTH, COMMUNICATION_ERROR, bytes([len(data)]))
            return
        self._emcy.clear_error(SYNC_LENGTH)
        if self.nmt_state is not NmtState.OPERATIONAL:
            return
        counter = data[0] if expected else None
        for rpdo in self.receive_pdos.values():
            rpdo.sync()
        for tpdo in self.synchronous_pdos:
            tpdo.sync(counter)

    def poll(self) -> None:
        """Time has passed: heartbeats, time-outs, event-driven PDOs, held-back EMCYs."""
        now_ns = self._clock.now_ns()
        if self.producer.due(now_ns) and not self.heartbeat_fails:
            self._send(HEARTBEAT + self.node_id, self.nmt_state.heartbeat)
        self.consumer.poll(now_ns)
        self._guarding.poll(now_ns)
        self._emcy.poll(now_ns)
        if self.nmt_state is not NmtState.OPERATIONAL:
            return
        for rpdo in self.receive_pdos.values():
            if rpdo.poll(now_ns):
                self._communication_error(RPDO_TIMED_OUT, rpdo.number)
        for tpdo in self._event_driven:
            tpdo.poll(now_ns)

    def rephase(self) -> None:
        """Count all periods from now: SYNC has begun, and with it a common time."""
        now_ns = self._clock.now_ns()
        self.producer.rephase()
        self.consumer.rephase()
        for rpdo in self._rpdos:
            rpdo.rephase(now_ns)
        for tpdo in self._tpdos:
            tpdo.rephase(now_ns)

    # -- NMT ---------------------------------------------------------------------------------------------

    def _nmt_command(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        command = data[0]
        if command == NmtCommand.START:
            self._enter(NmtState.OPERATIONAL)
        elif command == NmtCommand.STOP:
            self._enter(NmtState.STOPPED)
        elif command == NmtCommand.ENTER_PRE_OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif command == NmtCommand.RESET_NODE:
            self.reset_node()
        elif command == NmtCommand.RESET_COMMUNICATION:
            self._restart(_COMMUNICATION_AREA)

    def reset_node(self) -> None:
        """Start anew, as after power-on: by NMT, or because the device itself has to."""
        self._restart(_ALL_AREAS)

    def _restart(self, area: tuple[int, int]) -> None:
        self._enter(NmtState.INITIALISING)
        self._reset(*area)
        self.boot()

    def _enter(self, state: NmtState) -> None:
        if state is self.nmt_state:
            return
        self.nmt_state = state
        for rpdo in self._rpdos:
            rpdo.reset()
        if state is NmtState.OPERATIONAL:
            for tpdo in self._tpdos:
                tpdo.restart()
        if self._communicates():
            self._emcy.released()
        if self.on_nmt is not None:
            self.on_nmt(state)

    def _reset(self, first: int, last: int) -> None:
        self._store.reset(first, last)
        self._storage.apply(first, last)
        self._emcy.reset()
        self._sdo.reset()
        self.consumer.reset()
        self.producer.rephase()
        self._guarding.reset()
        self._compile_pdos()

    # -- PDOs --------------------------------------------------------------------------------------------

    def _compile_pdos_if_changed(self) -> None:
        pdos = (*self._rpdos, *self._tpdos)
        changed = [pdo for pdo in pdos if pdo.parameters() != pdo.compiled]
        if changed:
            self._compile_pdos()
        for pdo in changed:
            pdo.restart()

    def _compile_pdos(self) -> None:
        for pdo in (*self._rpdos, *self._tpdos):
            try:
                pdo.compile()
            except (SdoAbort, ValueError) as error:
                # Writes are checked one by one, so this is what the device starts with: no map until one is written.
                if pdo.valid:
                    self.left_out[str(pdo)] = f"{pdo} is not sent or received with its default mapping: {error}"
        self.receive_pdos = {rpdo.cob_id: rpdo for rpdo in self._rpdos if rpdo.valid and rpdo.map is not None}
        active = [tpdo for tpdo in self._tpdos if tpdo.valid and tpdo.map is not None]
        self.synchronous_pdos = [tpdo for tpdo in active if tpdo.transmission_type <= 240]
        self._event_driven = [tpdo for tpdo in active if tpdo.transmission_type > 240]

    # -- SYNC objects ------------------------------------------------------------------------------------

    def _restrict_sync_objects(self) -> None:
        self._sync_cob = self._store.conditional(0x1005, DataType.UNSIGNED32, SYNC)
        self._sync_counter = self.cell(0x1019) if self.has(0x1019) else None
        self._sync_cob.on_write = self._check_sync_cob
        if self._sync_counter is not None:
            self._sync_counter.on_write = self._check_sync_counter

    def _check_sync_cob(self, value: int) -> None:
        # This device produces no SYNC (bit 30).
        if value & PRODUCE_SYNC or (value & _WITHOUT_TOP_BIT != SYNC and is_restricted(value)):
            raise SdoAbort(INVALID_VALUE)

    def _check_sync_counter(self, value: int) -> None:
        if self.has(0x1006) and self.cell(0x1006).value:
            raise SdoAbort(PRESENT_STATE)
        if value == 1 or value > 240:
            raise SdoAbort(INVALID_VALUE)

    # -- errors ------------------------------------------------------------------------------------------

    def _heartbeat_lost(self, node_id: int) -> None:
        self._communication_error(HEARTBEAT_LOST, node_id)
        behaviour = self.cell(0x1029, 1).value if self.has(0x1029, 1) else _TO_PRE_OPERATIONAL
        if behaviour == _TO_PRE_OPERATIONAL and self.nmt_state is NmtState.OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif behaviour == _TO_STOPPED:
            self._enter(NmtState.STOPPED)

    def _communication_error(self, code: int, source: int) -> None:
        """EMCY, and the application's reaction (6007h)."""
        self._emcy.raise_error(code, COMMUNICATION_ERROR, bytes([source & 0xFF]), source)
        if self.on_communication_error is not None:
            self.on_communication_error(code)

    def _communicates(self) -> bool:
        """SDO, SYNC and EMCY live in PRE-OPERATIONAL and OPERATIONAL only (CiA 301, table 37)."""
        return self.nmt_state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    # -- frames out --------------------------------------------------------------------------------------

    def _send(self, cob_id: int, data: bytes) -> None:
        if not self.silent:
            self.outbox.append(Frame(cob_id, bytes(data)))

    def _reply(self, cob_id: int, data: bytes) -> None:
        if not self.silent:
            self.replies.append(Frame(cob_id, bytes(data)))
