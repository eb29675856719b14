"""Fast path of a bench with simulated hardware and twin in its own process.

A cycle fits the *fast path* when all drives follow their set points and the wire carries only SYNC, PDOs and
heartbeats. Then no decision in it needs Python: `kernel` does it on arrays. Anything else (SDO,
NMT, EMCY, another state, a fault, a timer that runs out, a foreign frame) is for the interpreted cycle, which
is the reference: before it, and before any other use of the bus, the objects are updated from the arrays.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from hilbench.can.frame import Frame
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.identifiers import HEARTBEAT
from hilbench.cia402.state_machine import Command
from hilbench.cycle_program import CONTINUE, CompiledStage, StageAbortedError, never
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import ExchangeStages
from hilbench.exchange.frame_tap import FrameTap, LineTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.tables import (
    FastPathRefusedError,
    drive_row,
    octets,
    reals,
    table,
)
from hilbench.in_process_cycle import counting
from hilbench.in_process_cycle.wiring import InOneProcess, Wiring
from hilbench.topology.sample import CycleSample
from hilbench.twin.in_arrays import TwinInArrays, give_counters

#: Cycles after which the fast path is tried again after a refusal.
_LOOK_AGAIN = 8
#: Cycles whose lines of the trace are written together: some milliseconds of a run's own time.
_TRACED_TOGETHER = 32
_ENABLED = Command.ENABLE_OPERATION.value


def _left(_: int) -> bool:
    raise StageAbortedError


#: The first of the totals, which only grow.
_SUMS = counting.DURATION_NS + 1


class FastPathCycles:
    """Runs the cycles of a bench that fit the fast path; see `exchange.exchange.FastPathCycles`."""

    def __init__(
        self, here: InOneProcess, nodes: Nodes, sync: SyncCycle, own: MasterNode, tap: FrameTap | None
    ) -> None:
        self._here = here
        self._nodes = nodes
        self._sync = sync
        self._own = own
        self._tap = tap
        self._run: _Run | None = None
        self._wait = 0  # cycles until it is looked again
        here.bus.before_use = self.settle

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one, as `Exchange.cycle`; False where it was none, and nothing was done."""
        with self._sync.lock, self._here.lock:
            run = self._run
            if run is None:
                if self._wait:
                    self._wait -= 1
                    return False
                run = self._begin()
                if run is None:
                    self._wait = _LOOK_AGAIN
                    return False
            if run.cycle(outputs):
                return True
            self.settle()
            return False

    @contextmanager
    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> Iterator[ExchangeStages | None]:
        """Compiled stages (`exchange.exchange.FastPathCycles`)."""
        with self._sync.lock, self._here.lock:
            yield None if self._run is None else self._run.chained(sample, shown)

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        if self._run is None:
            return
        with self._here.lock:
            run, self._run = self._run, None
            if run is not None:
                run.end()

    def _begin(self) -> _Run | None:
        here = self._here
        quiet = here.bus.quiet and not any(
            link.holds_frames for link in (here.link, here.hardware.link, here.twin.link)
        )
        if not (quiet and self._nodes.fits_fast_path and self._sync.fits_fast_path and not self._own.has_answers):
            return None
        if not (here.hardware.host.fits_fast_path and here.twin.host.fits_fast_path):
            return None
        try:
            self._run = _Run(here, self._nodes, self._sync, self._tap)
        except FastPathRefusedError:
            return None
        return self._run


class _Run:
    """Fast-path cycles one after the other, from objects into arrays and back."""

    def __init__(self, here: InOneProcess, nodes: Nodes, sync: SyncCycle, tap: FrameTap | None) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._here, self._nodes, self._sync, self._tap = here, nodes, sync, tap
        self._cycles = self._compiled_ns = 0
        self.pieces: Sequence[CompiledStage] = ()  #: see `exchange.exchange.ExchangeStages`
        self._of_pieces: tuple[object, ...] = ()
        self._bench_drives = nodes.drives
        self._devices = (*here.hardware.devices, *here.twin.devices)
        step_s = here.rig.fast_path_step_s()
        if step_s is None:
            raise FastPathRefusedError
        self._step_s = step_s
        drives = (*here.rig.drives, *here.machine.drives)
        advances_by_sync = here.machine.fits_fast_path and not here.machine.advances_by_clock
        if not all(drive.follows(_ENABLED) for drive in drives) or not advances_by_sync:
            raise FastPathRefusedError
        self._wiring = wiring = Wiring(here, nodes, sync)
        self._frames, self._slots = wiring.frames, wiring.slots
        self._boundary_places = list(zip(wiring.bench.boundary_slots, nodes.boundary_names, strict=True))
        self._own_heartbeat = wiring.bench.own_heartbeat
        self._heartbeats = [each for host in wiring.hosts for each in host.heartbeats]
        self._arrays()
        self._deadlines()
        fault = sync.write_last_answers()
        self._fault = fault
        nodes.begin_fast_path()
        self._due, self._supervised = sync.due_always, nodes.supervised

    # -- from the objects ------------------------------------------------------------------------------------

    def _arrays(self) -> None:
        frames, slots, here = self._frames, self._slots, self._here
        self._rows = table(frames.rows, lay.FRAME)
        self._sent = table(frames.sent, lay.FIELD)
        self._received = table(sorted(frames.received), lay.FIELD)
        self._target_rows = table(self._wiring.bench.targets, lay.TARGET)
        drives: list[tuple[Any, ...]] = []
        for slots.side, of_side in enumerate((here.rig.drives, here.machine.drives)):
            drives += [drive_row(drive, slots) for drive in of_side]
        self._drives = table(drives, lay.DRIVE)
        self._seen_rows = table([*self._wiring.seen.rows(), *self._wiring.received], lay.FEEDBACK)
        slots.side = 1
        self._machine = TwinInArrays(here.machine, self._wiring.hosts[1], slots)
        self._whole, self._real = np.array(slots.whole, np.int64), np.array(slots.real, np.float64)
        self._real = self._real if len(self._real) else np.zeros(1)
        # Access to one value is faster than through the array.
        self._real_at = reals(self._real)
        self._data = np.zeros((len(frames.rows), 8), np.uint8)
        for row, content in frames.constants.items():
            self._data[row, : len(content)] = np.frombuffer(content, np.uint8)
        self._given, self._left = (
            np.zeros(lay.I_SIZE, np.int64),
            np.zeros(lay.O_SIZE + len(frames.rows), np.int64),
        )
        self._given_at, self._left_at = self._given.data, self._left.data
        self._feedback = np.zeros(4 * len(self._seen_rows))
        self._asked, self._shown = np.zeros(len(drives)), np.zeros(lay.PORT_SIZE * len(drives))
        self._set_points = np.zeros(len(self._target_rows))
        self._set_points_at = reals(self._set_points)
        given = np.flatnonzero(self._target_rows["source"] < 0).tolist()
        self._names = [
            (at, name, per_unit) for at, (_, name, per_unit) in zip(given, self._nodes.set_points, strict=True)
        ]
        self._join_motors()
        self._trace()
        measured = self._nodes.measured
        self._vectors = kernel.Vectors(
            targets=self._target_rows,
            set_points=self._set_points,
            frames=self._rows,
            sent=self._sent,
            received=self._received,
            drives=self._drives,
            seen=self._seen_rows,
            whole=self._whole,
            real=self._real,
            given=self._given,
            left=self._left,
            data=self._data.reshape(-1),
            heads=self._heads,
            text=self._text,
            feedback=self._feedback,
            asked=self._asked,
            shown=self._shown,
            virtual_io_rows=table(self._wiring.virtual_io_rows, lay.VIRTUAL_IO),
            came=measured.came,
            torques=measured.torques,
            before_Nm=measured.before_Nm,
            of_drives=measured.of_drives,
            virtual_io=measured.virtual_io,
        )
        self._table = self._vectors.table()
        self._count_from_here()

    def _count_from_here(self) -> None:
        """Stages of a cycle that belong to no drive and no machine."""
        config, (row, of_status) = self._nodes.config, self._wiring.status
        self._totals, self._received = np.zeros(counting.TOTALS, np.int64), np.zeros(len(self._rows), np.int64)
        self._totals_at, self._received_at = self._totals.data, self._received.data
        self._passed, self._ticked, self._heartbeat_sent = [0] * _SUMS, 0, False
        kept = (
            *(self._given, self._left, self._vectors.frames.view(np.int64).reshape(-1), self._whole),
            *(self._nodes.measured.counted, self._totals, self._received, np.array([row, of_status.start])),
        )
        self._exchange = CompiledStage(kernel.exchange, config.bus.bitrate, (), fallback=never, table=self._table)
        self._publish = CompiledStage(kernel.publish, 0, (), fallback=self._publish_by_objects, table=self._table)
        self._count = CompiledStage(counting.count, config.cycle_ns, kept, fallback=never)
        self._alive: CompiledStage | None = None
        if self._own_heartbeat >= 0:
            self._alive = CompiledStage(
                counting.heartbeat_sent, self._own_heartbeat, kept, fallback=self._send_heartbeat
            )

    def _join_motors(self) -> None:
        """The drives on both sides, with what they turn."""
        here, count = self._here, len(self._here.rig.drives)
        of_hardware, _ = self._slots.cells
        vectors = self._whole, self._real
        self._hardware = Motors(
            here.rig.drives,
            self._drives[:count],
            *(*vectors, self._asked[:count], self._shown[: lay.PORT_SIZE * count]),
            here.rig.rig,
            self._step_s,
            of_hardware,
            alone=count == len(here.rig.ports),
            shows_ports=False,
        )
        self._machine.join(
            self._drives[count:],
            *vectors,
            self._asked[count:],
            self._shown[lay.PORT_SIZE * count :],
            self._feedback[self._wiring.received_axes[0] :],
        )

    def _trace(self) -> None:
        """Heads of the trace's lines, and room for its text."""
        tap, frames = self._tap, self._frames
        self._lines = tap if isinstance(tap, LineTap) else None
        heads, self._text = b"", np.zeros(0, np.uint8)
        if self._lines is not None:
            for row, cob_id in enumerate(frames.cob_ids):
                head = self._lines.head(cob_id).encode("ascii", "backslashreplace")
                self._rows[row]["head"], self._rows[row]["head_end"] = len(heads), len(heads) + len(head)
                heads += head
            self._text = octets(_TRACED_TOGETHER * (len(frames.rows) * lay.LINE + len(heads)))
        self._heads = octets(len(heads))
        self._heads[: len(heads)] = np.frombuffer(heads, np.uint8)
        self._waiting = self._waiting_frames = 0  # cycles and frames whose lines are in the text

    def _deadlines(self) -> None:
        """Times, by each host's clock, until which no heartbeat consumer time-out can expire."""
        self._until_ns: list[tuple[SyncClock, int]] = []
        for served, host in zip((self._here.hardware, self._here.twin), self._wiring.hosts, strict=True):
            self._until_ns.append((served.clock, host.quiet_until_ns()))

    # -- cycle by cycle --------------------------------------------------------------------------------------

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one; False, and nothing done, where it does not fit. Raises as `SyncCycle` and `Nodes.decode`."""
        begun_ns = time.monotonic_ns()
        if not self._fast_path_cycles(begun_ns):
            return False
        self._put(outputs)
        if self._exchange.function(self._exchange.argument, self._exchange.table) != CONTINUE:
            return False
        if self._alive is not None:
            self._alive()
        self._tick(begun_ns, self._ticked + 1)
        self._hardware.step()
        self._machine.go_on()
        self._publish()
        self._count()
        self._tap_frames()
        self._pass(begun_ns)
        return True

    def _fast_path_cycles(self, now_ns: int) -> int:
        """Number of cycles from now on that fit the fast path, as far as is known now."""
        here, nodes, sync = self._here, self._nodes, self._sync
        if self._hardware.over or here.bus.waiting or not self._machine.stays():
            return 0
        if sync.due_always is not self._due or nodes.supervised != self._supervised:
            return 0
        for drive in self._bench_drives:
            if drive.controlword != _ENABLED or not drive.reached:
                return 0
        for device in self._devices:
            if device.outbox:
                return 0
        if sync.is_slow(now_ns * 1e-9):
            return 0
        return min(clock.syncs_until(now_ns, until_ns) for clock, until_ns in self._until_ns)

    def _put(self, outputs: Mapping[str, float]) -> None:
        """Set outputs, boundary inputs and times for the next SYNC."""
        set_points, real = self._set_points_at, self._real_at
        for at, name, per_unit in self._names:
            set_points[at] = outputs.get(name, 0.0) * per_unit
        for slot, name in self._boundary_places:
            real[slot] = outputs[name]
        self._machine.before_sync()
        self._set_times()

    def _set_times(self) -> None:
        here, given = self._here, self._given_at
        given[lay.I_START_NS] = self._sync.next_sync_ns
        given[lay.I_CLOCKS], given[lay.I_CLOCKS + 1] = here.hardware.clock.next_ns, here.twin.clock.next_ns

    def _send_heartbeat(self, _: int) -> bool:
        """The bench's heartbeat was on the wire."""
        self._tick(time.monotonic_ns(), self._totals_at[counting.RUN])
        sender = self._frames.cob_ids[self._own_heartbeat] - HEARTBEAT
        for served in (self._here.hardware, self._here.twin):
            for device in served.devices:
                device.consumer.received(sender)
        self._deadlines()
        self._heartbeat_sent = True
        return True

    def _tick(self, now_ns: int, syncs: int) -> None:
        """Advance the clocks of hardware and twin to `syncs` SYNCs since this run began."""
        for served in (self._here.hardware, self._here.twin):
            served.clock.tick_at(now_ns, syncs - self._ticked)
        self._ticked = syncs

    def _publish_by_objects(self, _: int) -> bool:
        self._tick_this()
        self._hardware.publish_by_objects()
        self._machine.publish_by_objects()
        return False

    def _tick_this(self) -> None:
        """The SYNC of the cycle that is not counted yet was on the wire."""
        self._tick(time.monotonic_ns(), self._totals_at[counting.RUN] + 1)

    # -- many cycles -----------------------------------------------------------------------------------------

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> _Run | None:
        """This run as `exchange.exchange.ExchangeStages`; None where a part of a cycle is Python's."""
        machine, hardware = self._machine.piece, self._hardware.step
        row, _ = self._wiring.status
        if machine is None or not isinstance(hardware, CompiledStage) or self._rows[row]["every"] != 1:
            return None
        if self._tap is not None and self._lines is None:
            return None
        if self._of_pieces != (machine, sample, shown):
            self._of_pieces = machine, sample, shown

            def fallback(code: int) -> bool:
                self._tick_this()
                return machine.fallback(code)

            self.pieces = (
                self._ask(sample, shown),
                CompiledStage(kernel.exchange, self._exchange.argument, (), fallback=_left, table=self._table),
                *(() if self._alive is None else (self._alive,)),
                hardware,
                CompiledStage(
                    machine.function,
                    machine.argument,
                    machine.arrays,
                    continues=machine.continues,
                    fallback=fallback,
                    table=machine.table,
                ),
                self._publish,
                self._count,
                self._nodes.measured.filling(sample),
            )
        return self

    def _ask(self, sample: CycleSample, shown: Mapping[str, str]) -> CompiledStage:
        """Outputs by what shows them."""
        kind, outputs = type(sample), self._names
        places = [place for at, name, _ in outputs for place in (at, kind.place(shown[name]))]
        boundary_slots = [place for slot, name in self._boundary_places for place in (slot, kind.place(shown[name]))]
        kept = (
            *(sample.reals, self._set_points, np.array([per_unit for _, _, per_unit in outputs])),
            *(np.array(places, np.int64), self._real, np.array(boundary_slots, np.int64)),
        )
        return CompiledStage(counting.ask, 0, kept, fallback=never)

    def cycles(self) -> int:
        """Number of cycles that may run compiled (`exchange.exchange.ExchangeStages`)."""
        self._compiled_ns = now_ns = time.monotonic_ns()
        self._set_times()
        room = _TRACED_TOGETHER - self._waiting
        return min(self._fast_path_cycles(now_ns), self._nodes.not_silent_cycles, room)

    def passed(self) -> None:
        """Account for the cycles run compiled (`exchange.exchange.ExchangeStages`)."""
        self._pass(self._compiled_ns)

    def _pass(self, begun_ns: int) -> None:
        """The objects that count cycles learn of those since the last time. Raises as `SyncCycle` and
        `Nodes.decode`."""
        totals = self._totals_at.tolist()
        cycles, frames, bits, duration_ns = (now - then for now, then in zip(totals[:_SUMS], self._passed, strict=True))
        if not cycles:
            return
        self._passed = totals[:_SUMS]
        self._here.bus.account(frames, bits, duration_ns)
        if self._lines is not None:
            self._waiting += cycles
            self._waiting_frames += frames
        self._tick(begun_ns, totals[counting.RUN])
        last_bits, heartbeat_sent, self._heartbeat_sent = self._left_at[lay.O_BITS], self._heartbeat_sent, False
        self._sync.count(cycles, bits, last_bits, begun_ns, time.monotonic_ns(), heartbeat_sent=heartbeat_sent)
        self._cycles += cycles
        fault, self._fault = self._fault or self._write_waiting(), None
        if fault is not None:
            raise fault
        before = totals[counting.RUN] - cycles
        received = [
            (device.node_id, at - before) for device, row in self._heartbeats if (at := self._received_at[row]) > before
        ]
        self._nodes.pass_fast_path(cycles, received, max(0, totals[counting.REPORTED] - before))

    def _tap_frames(self) -> None:
        """Write frames to a tap that takes no text."""
        if self._lines is None and self._tap is not None:
            self._tap.write(self._sent_frames())
            self._tap.end_cycle()

    def _sent_frames(self) -> list[Frame]:
        frames, times_ns = self._frames, self._rows["time_ns"].tolist()
        data = self._data.tobytes()
        return [
            Frame(cob_id, data[8 * row : 8 * row + size], times_ns[row])
            for row, (cob_id, size) in enumerate(zip(frames.cob_ids, frames.sizes, strict=True))
            if self._left_at[lay.O_SIZE + row]
        ]

    def _write_waiting(self) -> BenchFaultError | None:
        """Write the lines of the last cycles; returns the trace's error, if any."""
        if self._lines is None or self._waiting < _TRACED_TOGETHER:
            return None
        try:
            self._give_lines(self._lines)
            self._lines.end_cycle()
        except BenchFaultError as fault:
            return fault
        return None

    def _give_lines(self, lines: LineTap) -> None:
        text = self._text[: self._given_at[lay.I_TEXT]]
        lines.write_lines(text.tobytes().decode("ascii"), self._waiting_frames)
        self._waiting = self._waiting_frames = self._given_at[lay.I_TEXT] = 0

    # -- back to the objects ---------------------------------------------------------------------------------

    def end(self) -> None:
        """The objects get what the arrays have."""
        if self._lines is not None and self._waiting:
            self._give_lines(self._lines)
        if not self._cycles:
            return
        self._hardware.give()
        self._machine.give()
        self._give_bench()
        now_s = time.monotonic()
        for served in (self._here.hardware, self._here.twin):
            served.host.served_until(now_s)

    def _give_bench(self) -> None:
        """Update both sides from the last PDOs and heartbeats."""
        here, rows, cycles = self._here, self._rows, self._cycles
        last: dict[int, tuple[int, bytes | None]] = {}
        for served, host in zip((here.hardware, here.twin), self._wiring.hosts, strict=True):
            received_ns = served.clock.next_ns - 2 * self._nodes.config.cycle_ns
            last |= host.give(rows, self._data, cycles, received_ns)
        for cob_id, answer in self._nodes.answers.items():
            count, data = last[cob_id]
            answer.answered_until(cycles, data, count)
        of_drives = len(self._wiring.seen.raw)
        give_counters(here.machine.listeners, self._seen_rows[of_drives:])
        self._wiring.seen.give(self._seen_rows[:of_drives], self._whole)
        for (drive, _, _), (at, _, _) in zip(self._nodes.set_points, self._names, strict=True):
            drive.setpoint = float(self._set_points[at])
        self._nodes.end_fast_path(cycles)
