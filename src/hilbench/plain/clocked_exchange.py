"""Plain cycles of a bench on the embedded bus where time is real: set points ahead of SYNC, answers as they come.

As in lockstep (`exchange`) anything else than what was due is for the interpreted cycle, at any place of a cycle, with
all that has come of it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from hilbench.can import protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import ERROR_FLAG, Frame
from hilbench.can.wire import frame_bits
from hilbench.canopen.identifiers import HEARTBEAT, SYNC, NmtState
from hilbench.compiled import table_of
from hilbench.errors import BenchFaultError
from hilbench.exchange import pacing
from hilbench.exchange.frame_tap import LineTap
from hilbench.exchange.measured import TWIN_SYNC
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.exchange.sync_marks import Awaited, Met
from hilbench.plain import clocked_kernel, kernel, packet_kernel
from hilbench.plain import layout as lay
from hilbench.plain.answers import Order
from hilbench.plain.bench_run import BenchRun
from hilbench.plain.clocked_kernel import BEHIND_AT, BITS, SYNC_CAME, TEXT_END, Heard
from hilbench.plain.exchange import PlainExchange
from hilbench.plain.packet_kernel import (
    ANSWERED,
    LENGTH,
    LOOKED_AT,
    NOW_NS,
    OTHER,
    OUT_LENGTH,
    SYNCED,
    UNSENT,
    Gathered,
)
from hilbench.plain.tables import Frames, NotPlainError, octets

#: An operator, and other users of the bus, wait for cycles in pieces for so long.
_CHAINED_S = 0.02
#: Behind a strange frame before which so few cycles were plain that it did not pay it is waited for so many until it is
#: looked again, at most; for twice as many each time.
_PAYS, _LONGEST_PAUSE = 8, 512
_HEADER, _RECEIVED = protocol.HEADER.size, protocol.STAMPED_CAN_RECORD.size
_SYNC = Frame(SYNC, b"")


class ClockedExchange(PlainExchange):
    """Runs the cycles of a bench that are plain; see `exchange.exchange.PlainCycles`."""

    @staticmethod
    def warm_up() -> None:
        """See `PlainExchange`."""
        kernel.warm_up()
        clocked_kernel.warm_up()

    def _prepare(self) -> None:
        self.warm_up()
        self._pause = 1
        self._tables: _ClockedRun | None = None
        with suppress(NotPlainError):  # to make them takes too long between two cycles
            self._tables = _ClockedRun(self._link, self._nodes, self._sync, self._tap)

    def _new_run(self) -> BenchRun:
        if self._tables is None:
            raise NotPlainError
        return self._tables

    def _rest(self, done: int | None) -> None:
        """The tables are there: to look in each cycle takes less than one interpreted, and a bench that is late comes
        back into its time only by cycles that take less. Where strange frames are a rule each begins in vain."""
        if done is None or self._tables is None or not self._tables.foreign:
            return
        pays = done >= _PAYS
        self._wait = 0 if pays else self._pause
        self._pause = 1 if pays else min(2 * self._pause, _LONGEST_PAUSE)


class _ClockedRun(BenchRun):
    """The same from when on they are plain."""

    def __init__(self, link: EmbeddedLink, nodes: Nodes, sync: SyncCycle, tap: LineTap | None) -> None:
        """Raises NotPlainError where cycles are not plain."""
        super().__init__(nodes, sync, tap, lines=False)
        self._link = link
        in_each = [cob_id for cob_id, answer in nodes.answers.items() if answer.every == 1]
        at_times = [cob_id for cob_id, answer in nodes.answers.items() if answer.every != 1]
        self._node_ids = [part.node.node_id for part in nodes.config.parts]
        self._listen([*in_each, *at_times], len(in_each))
        self._orders_of: dict[frozenset[int], tuple[Order, int]] = {}  # by what answers only at times; its status
        self._in_each, self._at_times = tuple(in_each), set(at_times)
        self._order_of(frozenset())
        own = self._bench.own_heartbeat
        if own >= 0:  # its clock counts them
            row = self._sent_by.frames[own]
            row["timing"], row["period_ns"], row["next_ns"] = lay.BY_TIME, 1, 1
        self._status_bytes = self._nodes.io.status.kinds[0].width or 0
        self.foreign = False  #: whether something that is no part of a plain cycle has ended them
        self._awaited = Awaited(0, False)
        self._is_out = False  # SYNC of the cycle that is no plain one
        self._text_end = self._traced = 0

    def begin(self) -> None:
        """See `BenchRun`."""
        sync = self._sync
        if sync.due_always.keys() != set(self._in_each) or {pdo.cob_id for pdo in sync.due_at_times} != self._at_times:
            raise NotPlainError
        super().begin()
        self.foreign = False
        self._numbers[packet_kernel.DROPPED] = self._link.dropped & 0xFFFFFFFF

    def _listen(self, answers: list[int], in_each: int) -> None:
        """To these, the first of which come in each cycle, to heartbeats and SYNC."""
        known = Frames()
        for cob_id in answers:
            known.add(cob_id, lay.ANSWER, bytes(self._nodes.answers[cob_id].size))
        for node_id in self._node_ids:
            known.add(HEARTBEAT + node_id, lay.ANSWER, NmtState.OPERATIONAL.heartbeat)
        known.add(SYNC, lay.SYNC, b"")
        count, heads = len(known.rows), len(self._heads)
        due = np.zeros(count, np.int64)
        due[:in_each] = 1
        places = np.zeros(clocked_kernel.PLACES, np.int64)
        places[clocked_kernel.ANSWERS] = len(answers)
        longest = (count + len(self._frames.rows)) * lay.LINE + heads
        self._heard = Heard(
            places,
            np.zeros(count, np.int64),
            due,
            np.zeros(8 * count, np.uint8),
            self._rows_of(known),
            self._rows_of(self._frames),
            self._heads,
            octets(longest if self._tap is not None else 0),
        )
        self._heard_table = self._heard.table()
        self._places, self._came, self._due_rows = places.data, self._heard.came.data, due.data
        self._rare_at = {cob_id: row for row, cob_id in enumerate(answers) if row >= in_each}
        self._heartbeats_at = slice(len(answers), count - 1)
        sent = np.column_stack((self._frames.cob_ids, self._frames.sizes)).astype(np.int64)
        self._port = packet_kernel.new_port(
            self._link.fileno(),
            self._link.dropped,
            np.column_stack((known.cob_ids, known.sizes)).astype(np.int64),
            np.zeros((0, 5), np.int64),
            sent[:-1].copy(),
            self._left,
            self._data.reshape(-1),
            packet_kernel.buffer(),
        )
        self._port_table, self._numbers = self._port.table(), self._port.numbers.data
        self._gathered = Gathered(self._link.fileno(), self._link.dropped)
        self._answered, self._counted = self._gathered.data.data, self._nodes.measured.counted.data
        self._set_point_bits = int(self._heard.sent["bits"][:-1].sum())
        self._sync_bits = frame_bits(_SYNC)
        packet = self._link.packet(_SYNC)
        self._sync_packet = octets(len(packet))
        self._sync_packet[: len(packet)] = np.frombuffer(packet, np.uint8)
        self._sync_table, self._sync_length = table_of([self._sync_packet.view(np.int64)]), len(packet)

    def _order_of(self, due: frozenset[int]) -> tuple[Order, int]:
        """The answers to a SYNC as they are gathered, with these that come at times; and where the twin's status is
        among their data, -1: nowhere."""
        rare = tuple(cob_id for cob_id in self._rare_at if cob_id in due)
        order = self._orders.find((*self._in_each, *rare))
        if order is None:
            raise NotPlainError
        at = 8 * order.cob_ids.index(self._nodes.io.status.cob_id) if order.has_status else -1
        self._orders_of[due] = order, at
        return order, at

    # -- cycle by cycle --------------------------------------------------------------------------------------

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """See `BenchRun`."""
        if not self._is_steady or not self._tell(outputs) or not self._meet():
            return False
        begun_ns = time.monotonic_ns()
        due = frozenset(self._due_at_times())
        for cob_id, row in self._rare_at.items():
            self._due_rows[row] = cob_id in due
        until_ns = self._sync.answers_until_ns
        outcome = clocked_kernel.await_answers(
            self._port_table, self._heard_table, self._gathered.table, self._bitrate, until_ns
        )
        if outcome != ANSWERED:
            self.foreign = outcome == OTHER
            return False
        order, status_at = self._orders_of.get(due) or self._order_of(due)
        if not self._is_counted_on(status_at) or not packet_kernel.take_apart(
            order.table, order.port, self._gathered.table, self._bitrate
        ):
            return False
        self._account(begun_ns)
        self._keep_rare(order)
        self._end_cycle(order, self._heartbeats())
        return True

    def cycles(self) -> int:
        """See `BenchRun`."""
        return int(_CHAINED_S / self._nodes.config.cycle_time_s)

    def _tell(self, outputs: Mapping[str, float]) -> bool:
        """Set points ahead of SYNC; False, and nothing done, where a value does not fit."""
        self._take(outputs)
        if self._sync.leaves_out(self._set_point_bits):
            self._tell_nothing()
            return True
        alive = self._sync.is_heartbeat_due
        self._given_at[lay.I_CLOCKS] += alive
        outcome = clocked_kernel.tell(self._table, self._port_table, self._heard_table, self._bitrate)
        if outcome == OTHER:
            return False
        if outcome == UNSENT:
            self._link.send_records(self._port.sent[_HEADER : self._numbers[OUT_LENGTH]].tobytes())
        self.sent, self._is_out = True, False
        if alive:
            self._sync.heartbeat_is_said()
        return True

    def _tell_nothing(self) -> None:
        """The same where no set points are sent."""
        left, numbers, places = self._left_at, self._numbers, self._places
        self._left[:] = 0
        left[lay.O_FRAMES] = 1
        left[lay.O_BITS] = left[-1] = self._sync_bits
        numbers[LENGTH] = numbers[LOOKED_AT] = places[BEHIND_AT] = places[SYNC_CAME] = 0
        self._heard.came[:] = 0
        self.sent, self._is_out = True, False

    def _meet(self) -> bool:
        """SYNC, and the lines of the last cycle until it is due; False where something else has come, too."""
        sync, marks = self._sync, self._sync.marks
        if marks is None:
            self._write_lines()
            outcome = clocked_kernel.send_sync(
                self._port_table, self._heard_table, self._sync_table, self._sync_length, sync.pacing.deadline_ns
            )
            if outcome == UNSENT:
                self._link.send([_SYNC])
            pacing.advance(sync.pacing, self._numbers[NOW_NS])
            self._is_out, self.foreign = True, outcome == OTHER
            return outcome == SYNCED
        self._awaited = marks.expect()
        if not marks.is_next(self._awaited):
            return False
        self._write_lines()
        outcome = clocked_kernel.await_sync(self._port_table, self._heard_table, marks.late_ns())
        self.foreign = outcome == OTHER
        self._is_out = outcome == SYNCED and marks.came()
        return self._is_out

    def _is_counted_on(self, at: int) -> bool:
        """Whether the twin has counted this SYNC behind the last one that it has told of."""
        if at < 0:
            return True
        width = self._status_bytes
        told = int.from_bytes(self._answered[at : at + width], "little")
        before = self._counted[TWIN_SYNC] + self._sync.gone_by
        return told == (before + 1) % (1 << 8 * width)

    def _account(self, begun_ns: int) -> None:
        """Bits and lines of the cycle."""
        sync = self._sync
        clocked_kernel.account(self._port_table, self._heard_table, self._bitrate, sync.next_sync_ns)
        bits, own = self._places[BITS], self._bench.own_heartbeat
        said_alive = own >= 0 and self._left_at[lay.O_SIZE + own] != 0
        sync.count(1, bits, bits, begun_ns, time.monotonic_ns(), said_alive=said_alive)
        if self._tap is not None:
            came = (self._numbers[LENGTH] - _HEADER) // _RECEIVED - self._places[SYNC_CAME]
            self._text_end, self._traced = self._places[TEXT_END], self._left_at[lay.O_FRAMES] + came

    def _heartbeats(self) -> list[int]:
        """Node ids of those that have come in this cycle."""
        came = self._came[self._heartbeats_at].tolist()
        return (
            [node_id for node_id, has_come in zip(self._node_ids, came, strict=True) if has_come] if any(came) else []
        )

    def _write_lines(self) -> None:
        """The lines of the last cycle, while SYNC is waited for; `fault`: what the trace has to say against them."""
        if self._tap is None or not self._text_end:
            return
        self._write_last()
        try:
            self._tap.end_cycle()
        except BenchFaultError as fault:
            self.fault = self.fault or fault

    def _write_last(self) -> None:
        if self._tap is not None and self._text_end:
            self._tap.write_lines(str(self._heard.text.data[: self._text_end], "ascii"), self._traced)
            self._text_end = 0

    # -- a cycle that is no plain one ------------------------------------------------------------------------

    def finish(self) -> list[Frame]:
        """See `BenchRun`. Raises BusError as well."""
        sync, marks, outgoing = self._sync, self._sync.marks, self._outgoing()
        length = self._numbers[LENGTH]
        packet = self._port.received[:length].tobytes()
        frames = self._link.frames_from(packet if length else None)
        if not self._is_out:
            return sync.meet(outgoing, frames, self._awaited, self.fault)
        before = _frames_in(packet[_HEADER : self._places[BEHIND_AT]])
        if marks is None:
            return sync.finish(outgoing, frames[:before], frames[before:], self.fault)
        late, behind = frames[: before - 1], marks.answers_in(frames[before:])
        met = Met(frames[before - 1], late, behind, on_wire=late)
        return sync.finish(outgoing, late, behind, self.fault, met)


def _frames_in(records: bytes) -> int:
    """How many of them `EmbeddedLink.frames_from` makes frames of."""
    return sum(not can_id & ERROR_FLAG for can_id, *_ in protocol.STAMPED_CAN_RECORD.iter_unpack(records))
