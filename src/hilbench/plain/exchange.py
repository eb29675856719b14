"""Plain cycles of a bench whose nodes are on the embedded bus and wait for SYNC: packets out and in, on arrays.

What the bench sends is one packet; what answers it comes in packets, in an order that the bus decides. Where all that
came is what was due, and leaves all as it was, `kernel` does what `exchange` and `cia402.drive` do with it. Anything
else is for the interpreted cycle, which is the reference; it goes on in the middle of a cycle, too.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from hilbench.can import protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.wire import frame_bits
from hilbench.canopen.identifiers import SYNC
from hilbench.chain import Chained, LeftError, by_python
from hilbench.cia402.state_machine import Command
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import ChainedCycles
from hilbench.exchange.frame_tap import LineTap
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.own_node import OwnNode
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.plain import kernel, packet_kernel
from hilbench.plain import layout as lay
from hilbench.plain.answers import Order, Orders
from hilbench.plain.bench import BenchFrames, SeenDrives
from hilbench.plain.borrowed_wire import BorrowedWire
from hilbench.plain.kernel import Table
from hilbench.plain.packet_kernel import Gathered
from hilbench.plain.tables import Frames, NotPlainError, Slots, octets, reals, table
from hilbench.topology.sample import CycleSample

#: Cycles after which it is looked anew whether cycles are plain, when they were not; twice as many each time that so
#: few were plain in a row that it did not pay, up to the longest.
_LOOK_AGAIN, _LONGEST_PAUSE, _PAYS = 8, 512, 64
#: Of a bench whose cycles are in pieces, at most so many with the bus for itself.
_CHAINED_CYCLES = 32
#: So long it is waited for a packet before the interpreted cycle goes on waiting.
_PATIENCE_S = 0.1
_ENABLED = Command.ENABLE_OPERATION.value


class PlainExchange:
    """Runs the cycles of a bench that are plain; see `exchange.exchange.PlainCycles`."""

    def __init__(self, link: EmbeddedLink, nodes: Nodes, sync: SyncCycle, own: OwnNode, tap: LineTap | None) -> None:
        kernel.warm_up()
        packet_kernel.warm_up_bench()
        self._link, self._nodes, self._sync, self._own, self._tap = link, nodes, sync, own, tap
        self._wire = BorrowedWire(link)
        self._run: _Run | None = None
        self._wait = 0  # cycles until it is looked again
        self._pause = _LOOK_AGAIN  # cycles to wait when they are plain no more
        sync.before_use = self.settle

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one, as `Exchange.cycle`; False where it was none, and nothing was done."""
        with self._sync.lock:
            run = self._run or self._begin()
            if run is None:
                return False
            if not run.left and run.cycle(outputs):
                return True
            self.settle()
            if not run.sent:
                return False
            received = self._sync.finish(run.outgoing(), run.came(), run.fault)
        self._own.handle(received)
        self._nodes.decode(received, self._sync.before_sync)
        return True

    @contextmanager
    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> Iterator[ChainedCycles | None]:
        """See `exchange.exchange.PlainCycles`: others are waited for by Python, in each cycle."""
        with self._sync.lock:
            yield None if self._run is None else self._run.chained(sample, shown)

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        run, self._run = self._run, None
        if run is not None:
            self._wait = self._pause
            self._pause = _LOOK_AGAIN if run.done >= _PAYS else min(2 * self._pause, _LONGEST_PAUSE)
            run.end()

    def _begin(self) -> _Run | None:
        if self._wait:
            self._wait -= 1
            return None
        if self._nodes.is_plain and self._sync.is_plain and not self._own.has_answers:
            try:
                self._run = _Run(self._link, self._wire, self._nodes, self._sync, self._tap)
            except NotPlainError:
                self._run = None
        if self._run is None:
            self._wait = _LOOK_AGAIN
        return self._run


class _Run:
    """Plain cycles one after the other, from objects into arrays and back."""

    def __init__(
        self, link: EmbeddedLink, wire: BorrowedWire, nodes: Nodes, sync: SyncCycle, tap: LineTap | None
    ) -> None:
        """Raises NotPlainError where cycles are not plain."""
        self._link, self._wire, self._nodes, self._sync, self._tap = link, wire, nodes, sync, tap
        self.done = 0  #: plain cycles so far
        self.pieces: Sequence[Chained] = ()  #: see `exchange.exchange.ChainedCycles`
        self._of_pieces: tuple[object, ...] = ()
        self.left = False  #: whether a chained cycle was no plain one: it goes on otherwise
        self.sent = False  #: whether the cycle that is no plain one has begun
        slots, self._frames = Slots(), Frames()
        self._bench = BenchFrames(nodes, sync, self._frames, slots)
        self._seen = SeenDrives(nodes, slots)
        self._orders = Orders(nodes, self._seen, slots, self._make)
        self._told = list(zip(self._bench.told, nodes.boundary_names, strict=True))
        self._arrays(slots)
        self._gathered = Gathered(link.fileno(), link.dropped)
        self._sync_bits_ns = int(frame_bits(Frame(SYNC, b"")) * 1e9 / nodes.config.bus.bitrate)
        self._last: Order | None = None
        self._rare: dict[int, tuple[int, bytes]] = {}  # by COB-ID: the cycle in which it last came, and its data
        self._text_end = 0
        self._traced = 0  # frames whose lines are in the text
        self.fault = sync.write_last_answers()  #: what the trace has to say against itself
        nodes.begin_plain()
        self._due, self._supervised = sync.due_always, nodes.supervised

    # -- from the objects ------------------------------------------------------------------------------------

    def _arrays(self, slots: Slots) -> None:
        frames, nodes = self._frames, self._nodes
        self._targets = table(self._bench.targets, lay.TARGET)
        self._set_points = np.zeros(len(self._targets))
        self._set_points_at = reals(self._set_points)
        given = np.flatnonzero(self._targets["source"] < 0).tolist()
        self._names = [(at, name, per_unit) for at, (_, name, per_unit) in zip(given, nodes.set_points, strict=True)]
        self._whole, self._real = np.array(slots.whole, np.int64), np.array([*slots.real, 0.0])
        self._real_at = reals(self._real)
        self._status_at = self._whole.data[self._orders.status]
        self._seen_rows = table(self._seen.rows, lay.SEEN)
        self._feedback = np.zeros(4 * len(self._seen_rows))
        self._given = np.zeros(lay.I_SIZE, np.int64)
        self._given_at = self._given.data
        self._find_heads([*frames.cob_ids, *self._orders.cob_ids])
        data, self._left = np.zeros((len(frames.rows), 8), np.uint8), np.zeros(lay.O_SIZE + len(frames.rows), np.int64)
        for row, content in frames.constants.items():
            data[row, : len(content)] = np.frombuffer(content, np.uint8)
        # One value goes faster through these than through the arrays.
        self._left_at, self._text_at = self._left.data, self._text.data
        self._data = data
        wire = np.column_stack((frames.cob_ids, frames.sizes)).astype(np.int64)
        self._port = packet_kernel.new_port(
            self._link.fileno(),
            0,
            wire[:0],
            np.zeros((0, 5), np.int64),
            wire,
            self._left,
            data.reshape(-1),
            packet_kernel.buffer(),
        )
        self._port_table, self._numbers = self._port.table(), self._port.numbers.data
        # Nobody has answered yet: what stands there from the last cycle stays.
        self._sent_by = kernel.Vectors(
            targets=self._targets,
            set_points=self._set_points,
            **self._on_wire(frames, data, self._left),
        )
        self._table = self._sent_by.table()
        self._bitrate = nodes.config.bus.bitrate

    def _find_heads(self, cob_ids: list[int]) -> None:
        """Of the trace's lines, by COB-ID, and room for its text."""
        self._heads_of: dict[int, tuple[int, int]] = {}
        heads = b""
        if self._tap is not None:
            for cob_id in cob_ids:
                head = self._tap.head(cob_id).encode("ascii", "backslashreplace")
                self._heads_of[cob_id] = len(heads), len(heads) + len(head)
                heads += head
        self._heads = octets(len(heads))
        self._heads[: len(heads)] = np.frombuffer(heads, np.uint8)
        # The lines of a cycle are written while the next one is answered.
        self._text = octets(2 * (len(cob_ids) * lay.LINE + len(heads)) if self._tap is not None else 0)

    def _make(self, frames: Frames, said: lay.Rows, data: lay.Bytes, left: lay.Whole) -> Table:
        self._kept = [*getattr(self, "_kept", ()), vectors := self._vectors(frames, said, data, left)]
        return vectors.table()

    def _vectors(self, frames: Frames, said: lay.Rows, data: lay.Bytes, left: lay.Whole) -> kernel.Vectors:
        """Of what answers in these frames."""
        measured = self._nodes.measured
        return kernel.Vectors(
            **self._on_wire(frames, data, left),
            seen=self._seen_rows,
            feedback=self._feedback,
            said_rows=said,
            came=measured.came,
            torques=measured.torques,
            before_Nm=measured.before_Nm,
            of_drives=measured.of_drives,
            said=measured.said,
        )

    def _on_wire(self, frames: Frames, data: lay.Bytes, left: lay.Whole) -> dict[str, Any]:
        """These frames, with values and text, which are those of the run."""
        rows = table(frames.rows, lay.FRAME)
        for row, cob_id in zip(rows, frames.cob_ids, strict=True):
            row["head"], row["head_end"] = self._heads_of.get(cob_id, (0, 0))
        return {
            "frames": rows,
            "sent": table(frames.sent, lay.FIELD),
            "received": table(sorted(frames.received), lay.FIELD),
            "whole": self._whole,
            "real": self._real,
            "given": self._given,
            "left": left,
            "data": data.reshape(-1),
            "heads": self._heads,
            "text": self._text,
        }

    # -- cycle by cycle --------------------------------------------------------------------------------------

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one; False where it is not plain: nothing was done, or `sent`. Raises as `SyncCycle` and
        `Nodes.decode`."""
        sync, nodes = self._sync, self._nodes
        if not self._still_plain(time.monotonic()):
            return False
        begun_ns = time.monotonic_ns()
        if not self._ask(outputs):
            return False
        self.sent = True
        self.fault = self.fault or self._write_text()
        order = self._collect()
        bits = None if order is None else self._decode(order)
        if order is None or bits is None:
            return False
        own = self._bench.own_heartbeat
        said_alive = own >= 0 and self._left_at[lay.O_SIZE + own] != 0
        sync.count(1, bits, bits, begun_ns, time.monotonic_ns(), said_alive=said_alive)
        self.done += 1
        self.sent = False
        fault, self.fault = self.fault, None
        if fault is not None:
            raise fault
        status = self._status_at.tolist() if order.has_status else None
        nodes.take_plain(status, order.heartbeats)
        return True

    # -- several of them -------------------------------------------------------------------------------------

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> _Run:
        """This run as `exchange.exchange.ChainedCycles`."""
        if self._of_pieces != (sample, shown):
            self._of_pieces = sample, shown
            values, kind = sample.reals.data, type(sample)
            at = {output: kind.place(signal) for output, signal in shown.items()}

            def exchange() -> bool:
                if not self.cycle({output: values[place] for output, place in at.items()}):
                    self.left = True
                    raise LeftError
                self._nodes.measured.count(self._sync.timing.cycles, self._sync.last_bits)
                return True

            self.pieces = by_python(exchange), self._nodes.measured.filling(sample)
        return self

    def cycles(self) -> int:
        """See `exchange.exchange.ChainedCycles`; other users of the bus wait so long."""
        return _CHAINED_CYCLES

    def passed(self) -> None:
        """See `exchange.exchange.ChainedCycles`: each cycle was counted."""

    def _still_plain(self, now_s: float) -> bool:
        nodes, sync = self._nodes, self._sync
        if sync.due_always is not self._due or nodes.supervised != self._supervised:
            return False
        for drive in nodes.drives:
            if drive.controlword != _ENABLED or not drive.reached:
                return False
        return not sync.is_slow(now_s)

    def _ask(self, outputs: Mapping[str, float]) -> bool:
        """Set points and SYNC onto the bus, and their lines behind those of the last cycle; False, and nothing done,
        where a value does not fit, or something has come before."""
        set_points, real, given = self._set_points_at, self._real_at, self._given_at
        came = self._wire.look()
        if came:
            self._sync.came_between(self._link.frames_from(*came))
            return False
        for at, name, per_unit in self._names:
            set_points[at] = outputs.get(name, 0.0) * per_unit
        for slot, name in self._told:
            real[slot] = outputs[name]
        given[lay.I_START_NS], given[lay.I_TEXT] = self._sync.next_sync_ns, self._text_end
        self._gathered.begin()
        outcome = packet_kernel.ask(
            self._table, self._port_table, self._wire.table, self._gathered.table, self._bitrate
        )
        if outcome == packet_kernel.UNSENT:
            at, end = protocol.HEADER.size, self._numbers[packet_kernel.OUT_LENGTH]
            self._link.send_records(self._port.sent[at:end].tobytes())
        elif outcome == packet_kernel.OTHER:
            length = self._numbers[packet_kernel.LENGTH]
            packet = self._port.received[:length].tobytes() if length else self._link.receive_packet(0.0)
            self._sync.came_between(self._link.frames_from(packet))
            return False
        return True

    def _collect(self) -> Order | None:
        """What has answered, once all is there that is due; None where something else has come, or nothing."""
        gathered, stage = self._gathered, packet_kernel.RECEIVE
        due: Collection[int] = ()
        if self._sync.due_at_times:
            cycle = self._sync.timing.cycles + 1
            due = {pdo.cob_id for pdo in self._sync.due_at_times if (cycle - pdo.since) % pdo.every == 0}
        answers = len(self._due) + len(due)
        while (
            outcome := packet_kernel.gather(gathered.table, self._wire.table, answers, stage)
        ) == packet_kernel.NOTHING:
            packet = self._link.receive_packet(_PATIENCE_S)
            if packet is None:
                return None
            gathered.put(packet)
            stage = packet_kernel.TAKEN
        if outcome != packet_kernel.ANSWERED:
            return None
        try:
            order = self._orders.find(gathered.cob_ids)
        except NotPlainError:
            return None
        return order if order is not None and set(due) == order.rare.keys() else None

    def _decode(self, order: Order) -> int | None:
        """What came into the bench's view of the nodes, and its lines; the bits of the cycle. None, and nothing done,
        where something is not as it was."""
        given, left, answered = self._given_at, self._left_at, order.left
        given[lay.I_START_NS] = self._sync.next_sync_ns + self._sync_bits_ns
        given[lay.I_TEXT] = left[lay.O_TEXT]
        if not packet_kernel.take_apart(order.table, order.port, self._gathered.table, self._bitrate):
            return None
        if self._tap is not None:
            self._text_end = answered[lay.O_TEXT]
            self._traced += left[lay.O_FRAMES] + answered[lay.O_FRAMES]
        for cob_id, row in order.rare.items():
            self._rare[cob_id] = self.done, order.data[row, : order.sizes[row]].tobytes()
        self._last = order
        return left[lay.O_BITS] + answered[lay.O_BITS]

    def _write_text(self) -> BenchFaultError | None:
        """The lines of the last cycle, while the others compute; what the trace has to say against them."""
        tap, end = self._tap, self._text_end
        if tap is None or not end:
            return None
        # What was sent just now stands behind them.
        now_end = self._left_at[lay.O_TEXT]
        self._give_lines(tap, end)
        self._text_at[: now_end - end] = self._text_at[end:now_end]
        self._left_at[lay.O_TEXT] = now_end - end
        try:
            tap.end_cycle()
        except BenchFaultError as fault:
            return fault
        return None

    def _give_lines(self, tap: LineTap, end: int) -> None:
        tap.write_lines(str(self._text_at[:end], "ascii"), self._traced)
        self._text_end = self._traced = 0

    # -- back to the objects ---------------------------------------------------------------------------------

    def outgoing(self) -> list[Frame]:
        """What was sent before SYNC in a cycle that is no plain one."""
        frames = zip(self._frames.cob_ids, self._frames.sizes, self._data, strict=True)
        sent = [Frame(cob_id, data[:size].tobytes(), 0) for cob_id, size, data in frames]
        return [frame for frame, bits in zip(sent, self._left[lay.O_SIZE :], strict=True) if bits][:-1]

    def came(self) -> list[Frame]:
        """What has answered it so far. Raises BusError."""
        return self._link.frames_from(*self._gathered.packets)

    def end(self) -> None:
        """The objects get what the arrays have."""
        if self._text_end and self._tap is not None:
            self._give_lines(self._tap, self._text_end)
        if not self.done or self._last is None:
            return
        data = self._last.data.tobytes()
        for row, cob_id in enumerate(self._last.cob_ids):
            answer = self._nodes.answers.get(cob_id)
            if answer is not None and answer.every == 1:
                answer.answered_until(self.done, data[8 * row : 8 * row + answer.size], 0)
        for cob_id, answer in self._nodes.answers.items():
            if answer.every != 1:
                at, content = self._rare.get(cob_id, (-1, None))
                answer.answered_until(self.done, content, self.done - 1 - at)
        self._seen.give(self._seen_rows, self._whole)
        for (drive, _, _), (at, _, _) in zip(self._nodes.set_points, self._names, strict=True):
            drive.setpoint = float(self._set_points[at])
        self._nodes.end_plain(self.done)
