"""Fast path of a bench whose nodes are on the embedded bus and wait for SYNC: packets out and in, on arrays.

The bench sends one packet; its answers come in packets, in an order that the bus decides. Where exactly the frames
due came, and none changes a state, `kernel` does what `exchange` and `cia402.drive` do with them. Anything
else is for the interpreted cycle, which is the reference; it can resume in the middle of a cycle, too.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from hilbench.can import protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.wire import frame_bits
from hilbench.canopen.identifiers import SYNC
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import ExchangeStages
from hilbench.exchange.frame_tap import LineTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.answers import ArrivalOrder
from hilbench.fast_path.bench_run import BenchFastCycle
from hilbench.fast_path.packet_kernel import Gathered
from hilbench.fast_path.tables import FastPathRefusedError
from hilbench.topology.sample import CycleSample

#: Cycles after which the fast path is tried again after a refusal; doubled each time that too few cycles in a row
#: fitted for it to pay, up to the longest.
_LOOK_AGAIN, _LONGEST_PAUSE, _PAYS = 8, 512, 64
#: Most cycles run compiled in one call, with the bus for itself.
_CHAINED_CYCLES = 32
#: Longest wait for a packet before the interpreted cycle takes over the wait.
_PATIENCE_S = 0.1


class FastPathExchange:
    """Runs the cycles of a bench that fit the fast path; see `exchange.exchange.FastPathCycles`."""

    def __init__(self, link: EmbeddedLink, nodes: Nodes, sync: SyncCycle, own: MasterNode, tap: LineTap | None) -> None:
        self._link, self._nodes, self._sync, self._own, self._tap = link, nodes, sync, own, tap
        self._run: BenchFastCycle | None = None
        self._wait = 0  # cycles until it is tried again
        self._pause = _LOOK_AGAIN  # cycles to wait when they leave the fast path
        self.warm_up()
        sync.before_use = self.settle

    @staticmethod
    def warm_up() -> None:
        """Compile, or load from the cache, the functions called: in good time, where one is to be made later."""
        kernel.warm_up()
        packet_kernel.warm_up_bench()

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
            received = run.finish()
        self._own.handle(received)
        self._nodes.decode(received, self._sync.before_sync)
        return True

    @contextmanager
    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> Iterator[ExchangeStages | None]:
        """Compiled stages (`exchange.exchange.FastPathCycles`); the wait for answers is interpreted, in each cycle."""
        with self._sync.lock:
            yield None if self._run is None else self._run.chained(sample, shown)

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        run, self._run = self._run, None
        if run is not None:
            self._wait = self._pause
            self._pause = _LOOK_AGAIN if run.done >= _PAYS else min(2 * self._pause, _LONGEST_PAUSE)
            run.end()

    def _begin(self) -> BenchFastCycle | None:
        if self._wait:
            self._wait -= 1
            return None
        if self._nodes.fits_fast_path and self._sync.fits_fast_path and not self._own.has_answers:
            try:
                run = _Run(self._link, self._nodes, self._sync, self._tap)
                run.begin()
                self._run = run
            except FastPathRefusedError:
                self._run = None
        if self._run is None:
            self._wait = _LOOK_AGAIN
        return self._run


class _Run(BenchFastCycle):
    """Fast-path cycles in lockstep, over the embedded bus."""

    def __init__(self, link: EmbeddedLink, nodes: Nodes, sync: SyncCycle, tap: LineTap | None) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        super().__init__(nodes, sync, tap)
        self._link = link
        frames = self._frames
        sent = np.column_stack((frames.cob_ids, frames.sizes)).astype(np.int64)
        self._port = packet_kernel.new_port(
            link.fileno(),
            0,
            sent[:0],
            np.zeros((0, 5), np.int64),
            sent,
            self._left,
            self._data.reshape(-1),
            packet_kernel.buffer(),
        )
        self._port_table, self._numbers = self._port.table(), self._port.numbers.data
        self._gathered = Gathered(link.fileno(), link.dropped)
        self._sync_bits_ns = int(frame_bits(Frame(SYNC, b"")) * 1e9 / self._bitrate)
        self._text_end = 0
        self._traced = 0  # frames whose lines are in the text

    def begin(self) -> None:
        """Begin with the next cycle (`BenchFastCycle.begin`)."""
        super().begin()
        self.fault = self._sync.write_last_answers()

    # -- cycle by cycle --------------------------------------------------------------------------------------

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one cycle (`BenchFastCycle.cycle`)."""
        sync = self._sync
        if not self._is_steady or sync.is_slow(time.monotonic()):
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
        heartbeat_sent = own >= 0 and self._left_at[lay.O_SIZE + own] != 0
        sync.count(1, bits, bits, begun_ns, time.monotonic_ns(), heartbeat_sent=heartbeat_sent)
        self._end_cycle(order, order.heartbeats)
        return True

    def finish(self) -> list[Frame]:
        """Finish a cycle that left the fast path, from the packets received. Raises BusError as well."""
        came = self._link.frames_from(*self._gathered.packets)
        return self._sync.finish(self._outgoing(), [], came, self.fault)

    def cycles(self) -> int:
        """Number of cycles that may run compiled."""
        return _CHAINED_CYCLES

    def _ask(self, outputs: Mapping[str, float]) -> bool:
        """Send set points and SYNC, and put their lines after those of the last cycle; False, and nothing done,
        where a value does not fit, or a frame has come before."""
        given = self._given_at
        self._take(outputs)
        given[lay.I_START_NS], given[lay.I_TEXT] = self._sync.next_sync_ns, self._text_end
        self._gathered.begin()
        outcome = packet_kernel.ask(self._table, self._port_table, self._bitrate)
        if outcome == packet_kernel.UNSENT:
            at, end = protocol.HEADER.size, self._numbers[packet_kernel.OUT_LENGTH]
            self._link.send_records(self._port.sent[at:end].tobytes())
        elif outcome == packet_kernel.OTHER:
            length = self._numbers[packet_kernel.LENGTH]
            packet = self._port.received[:length].tobytes() if length else self._link.receive_packet(0.0)
            self._sync.came_between(self._link.frames_from(packet))
            return False
        return True

    def _collect(self) -> ArrivalOrder | None:
        """Gather packets until all answers due are there; None where another frame has come, or none in time."""
        gathered, stage = self._gathered, packet_kernel.RECEIVE
        due = self._due_at_times()
        answers = len(self._due) + len(due)
        while (outcome := packet_kernel.gather(gathered.table, answers, stage)) == packet_kernel.NOTHING:
            packet = self._link.receive_packet(_PATIENCE_S)
            if packet is None:
                return None
            gathered.put(packet)
            stage = packet_kernel.TAKEN
        if outcome != packet_kernel.ANSWERED:
            return None
        try:
            order = self._orders.find(gathered.cob_ids)
        except FastPathRefusedError:
            return None
        return order if order is not None and set(due) == order.rare.keys() else None

    def _decode(self, order: ArrivalOrder) -> int | None:
        """Decode the answers into the bench's measurements and trace lines; returns the bits of the cycle. None, and
        nothing done, where an answer changes a state."""
        given, left, answered = self._given_at, self._left_at, order.left
        given[lay.I_START_NS] = self._sync.next_sync_ns + self._sync_bits_ns
        given[lay.I_TEXT] = left[lay.O_TEXT]
        if not packet_kernel.take_apart(order.table, order.port, self._gathered.table, self._bitrate):
            return None
        if self._tap is not None:
            self._text_end = answered[lay.O_TEXT]
            self._traced += left[lay.O_FRAMES] + answered[lay.O_FRAMES]
        self._keep_rare(order)
        return left[lay.O_BITS] + answered[lay.O_BITS]

    def _write_text(self) -> BenchFaultError | None:
        """Write the lines of the last cycle, while the others compute; returns the trace's error, if any."""
        tap, end = self._tap, self._text_end
        if tap is None or not end:
            return None
        # Lines of the frames sent just now follow them.
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

    def _write_last(self) -> None:
        if self._text_end and self._tap is not None:
            self._give_lines(self._tap, self._text_end)
