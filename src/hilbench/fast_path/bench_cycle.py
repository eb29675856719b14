"""Fast-path cycles of a bench, in one process with its devices or over a bus: from objects into arrays and back."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.drive import Drive
from hilbench.compiled import COUNT, TABLE, Reals, Table, Wholes, arrays_in, entry_point, record_type, records
from hilbench.cycle_program import CONTINUE, CompiledStage, StageAbortedError, never
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import ExchangeStages
from hilbench.exchange.frame_tap import FrameTap, LineTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.measured import COUNTED
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import layout as lay
from hilbench.fast_path.tables import (
    FastPathRefusedError,
    Frames,
    Slots,
    feedback_row,
    new_image,
    new_slots,
    reals,
    refuse_if,
    sent_data,
)
from hilbench.topology.sample import CycleSample

#: Totals: fast-path cycles, their frames, bits, and time on the wire in ns; the cycle of the twin's last status.
TOTALS = record_type("cycles", "frames", "bits", "duration_ns", "reported", of=np.int64)
#: Of the twin's status: its frame, and its first slot.
STATUS = record_type("frame", "slot", of=np.int64)
#: An output: its place in a sample, and among the set points or the real numbers of the image.
OUTPUT = record_type("signal", "place", of=np.int64)
#: What `heartbeat_sent` returns where the bench has sent it.
SENT = 1
_BY_CYCLES = lay.BY_CYCLES


class Counting(NamedTuple):
    """The image of a cycle as far as it is counted, and counters; by frame the cycle in which it was there last."""

    frames: Annotated[Any, records(lay.FRAME)]
    given: Annotated[Any, lay.GIVEN]
    left: Annotated[Any, lay.LEFT]
    clocks: Wholes
    whole: Wholes
    counted: Annotated[Any, COUNTED]
    totals: Annotated[Any, TOTALS]
    received: Wholes
    status: Annotated[Any, STATUS]


class Outputs(NamedTuple):
    """Set points, with the factor of each output, and real numbers of the image, from the values of a sample."""

    values: Reals
    set_points: Reals
    targets: Annotated[Any, records(OUTPUT)]
    per_unit: Reals
    real: Reals
    inputs: Annotated[Any, records(OUTPUT)]


#: count(length of a cycle in ns, table of `Counting`): count a fast-path cycle.
#: heartbeat_sent(row of the bench's heartbeat, table of `Counting`): SENT where that was on the wire.
#: take_outputs(0, table of `Outputs`): send the outputs in a sample with the next SYNC.
@entry_point(COUNT, TABLE)
def count(cycle_ns: int, table: Table) -> int:
    a = arrays_in(table, Counting)
    given, left, totals, counted = a.given, a.left, a.totals, a.counted
    given.start_ns += cycle_ns
    given.text = left.text
    for k in range(len(a.clocks)):
        a.clocks[k] += cycle_ns
    totals.cycles += 1
    totals.frames += left.frames
    totals.bits += left.bits
    totals.duration_ns += left.duration_ns
    counted.cycles += 1
    counted.bits = left.bits
    if a.frames[a.status.frame].bits_on_wire != 0:
        counted.twin_sync, counted.twin_status = a.whole[a.status.slot], a.whole[a.status.slot + 2]
        totals.reported = totals.cycles
    if left.timed != 0:
        for k in range(len(a.frames)):
            if a.frames[k].timing != _BY_CYCLES and a.frames[k].bits_on_wire != 0:
                a.received[k] = totals.cycles
    return CONTINUE


@entry_point(COUNT, TABLE)
def heartbeat_sent(row: int, table: Table) -> int:
    return SENT if arrays_in(table, Counting).frames[row].bits_on_wire != 0 else CONTINUE


@entry_point(COUNT, TABLE)
def take_outputs(_: int, table: Table) -> int:
    a = arrays_in(table, Outputs)
    for k in range(len(a.targets)):
        a.set_points[a.targets[k].place] = a.values[a.targets[k].signal] * a.per_unit[k]
    for k in range(len(a.inputs)):
        a.real[a.inputs[k].place] = a.values[a.inputs[k].signal]
    return CONTINUE


#: Loaded before a cycle has to wait for them.
STAGES = count, heartbeat_sent, take_outputs


class BenchFrames(ABC):
    """Frames of each fast-path cycle of a bench: set points, its heartbeat and SYNC, which are the first `asked`, then
    what answers. The slots of their values.

    `targets`: rows of `layout.TARGET`; `boundary_slots`: slots of the twin's boundary inputs; `own_heartbeat`: its row,
    -1: there is none; `virtual_io`: rows of `layout.VIRTUAL_IO`; `status`: row of the twin's status, its first slot;
    `heartbeats`: node ids of those whose heartbeats may come, each with its row.
    """

    def __init__(self, nodes: Nodes, sync: SyncCycle) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self.nodes, self.sync = nodes, sync
        self.slots, self.frames = Slots(), Frames()
        self.targets: list[tuple[float, int, int, int, float]] = []
        self.boundary_slots: list[int] = []
        self.own_heartbeat = -1
        self.heartbeats: list[tuple[int, int]] = []
        self._send_set_points()
        self._send_boundary_inputs()
        heartbeat, every = sync.heartbeat
        if every:
            count = (sync.timing.cycles - 1) % every
            state = bytes(heartbeat.data)
            self.own_heartbeat = self.frames.add(heartbeat.can_id, lay.BEFORE_SYNC, state, every=every, count=count)
        self.frames.add(SYNC, lay.SYNC, b"")
        self.asked = len(self.frames.rows)
        self.answer()
        self.virtual_io: list[tuple[int, int, int, int]] = []
        self._raw: list[tuple[Drive, dict[int, int]]] = []
        self._take()

    @abstractmethod
    def answer(self) -> None:
        """Add what answers. Raises FastPathRefusedError."""

    def _send_set_points(self) -> None:
        frames, slots = self.frames, self.slots
        for drive, _, _ in self.nodes.set_points:
            rpdo = drive.pdos.rpdo
            controlword, target = new_slots(slots, rpdo)
            slots.whole[controlword] = drive.controlword
            frames.add(rpdo.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, target))
            self.targets.append((drive.set_point_unit, drive.most_raw, target, -1, 1.0))
            for copy in drive.settings.copies:
                copied = slots.new(False)
                frames.add(copy.cob_id, lay.BEFORE_SYNC, rpdo, (controlword, copied))
                self.targets.append((1.0, drive.most_raw, copied, target, copy.factor))

    def _send_boundary_inputs(self) -> None:
        for boundary in self.nodes.io.boundary:
            refuse_if(not all(kind.is_float for kind in boundary.kinds))
            boundary_slots = new_slots(self.slots, boundary)
            self.frames.add(boundary.cob_id, lay.BEFORE_SYNC, boundary, boundary_slots)
            self.boundary_slots += boundary_slots

    def _take(self) -> None:
        """Take feedback of the drives, each of whose TPDOs answers each SYNC in whole numbers, and what the twin's
        virtual I/O brings."""
        nodes = self.nodes
        for drive in nodes.drives:
            raw: dict[int, int] = {}
            for pdo in drive.pdos.tpdos:
                refuse_if(pdo.period != 1)
                raw.update(zip(mapped_objects(pdo), self._take_pdo(pdo, is_float=False)[1], strict=True))
            self._raw.append((drive, raw))
        row, taken = self._take_pdo(nodes.io.status, is_float=False)
        self.status = row, taken[0]
        for pdo, part in zip(nodes.io.sent, nodes.measured.parts, strict=True):
            row, taken = self._take_pdo(pdo, is_float=True)
            self.virtual_io.append((row, taken[0], taken[-1] + 1, part.start))

    def _take_pdo(self, pdo: PdoMap, *, is_float: bool) -> tuple[int, list[int]]:
        """Take a TPDO: its row, and the slots of its values."""
        refuse_if(any(kind.is_float is not is_float for kind in pdo.kinds))
        row, taken = self.frames.row_of(pdo.cob_id), new_slots(self.slots, pdo)
        self.frames.take(row, pdo, taken)
        return row, taken

    @property
    def feedback(self) -> list[tuple[Any, ...]]:
        """Rows of `layout.FEEDBACK` for the drives now. Raises FastPathRefusedError if a drive's state is unknown."""
        return [feedback_row(drive, raw) for drive, raw in self._raw]

    def give(self, seen: lay.Rows, whole: lay.Whole) -> None:
        """The drives know what has come."""
        values = whole.tolist()
        for (drive, raw), row in zip(self._raw, seen, strict=True):
            drive.counter.counted_until(int(row["value"]), int(row["last"]))
            drive.decoded_until({index: values[slot] for index, slot in raw.items()})


#: Cycles after which the fast path is tried again after a refusal.
LOOK_AGAIN = 8
#: Most cycles in one compiled call, whose lines of the trace are written together: some milliseconds of a run's time.
TOGETHER = 32


class BenchFastCycle(ABC):
    """Fast-path cycles of a bench one after the other; `ExchangeStages` of those that are run together.

    `drives`, `seen`: rows of the image for devices in this process, in addition to those of the bench.
    """

    def __init__(
        self,
        wiring: BenchFrames,
        tap: FrameTap | None,
        drives: Sequence[tuple[Any, ...]] = (),
        seen: Sequence[tuple[Any, ...]] = (),
    ) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._wiring, self._nodes, self._sync, self._tap = wiring, wiring.nodes, wiring.sync, tap
        self.left = False  #: True if a cycle left the fast path: the interpreter does, or finishes, it
        self.sent = False  #: True if the cycle that left the fast path has been sent
        self.done = self._compiled_ns = 0  # cycles; begin of those that are run together
        self._heartbeat_sent = False
        self._lines = tap if isinstance(tap, LineTap) else None
        self._waiting = self._waiting_frames = 0  # cycles and frames whose lines are in the text
        self.pieces: Sequence[CompiledStage] = ()  #: see `exchange.exchange.ExchangeStages`
        self._of_pieces: tuple[object, ...] = ()
        self._make_arrays(drives, seen)
        self._fault = self._sync.write_last_answers()
        self._nodes.begin_fast_path()
        self._due, self._supervised = self._sync.due_always, self._nodes.supervised

    def _make_arrays(self, drives: Sequence[tuple[Any, ...]], seen: Sequence[tuple[Any, ...]]) -> None:
        nodes, wiring, measured = self._nodes, self._wiring, self._nodes.measured
        self._image = image = new_image(
            wiring.frames,
            wiring.slots,
            tap=self._lines,
            cycles=TOGETHER,
            targets=wiring.targets,
            drives=drives,
            seen=[*wiring.feedback, *seen],
            virtual_io_rows=np.array(wiring.virtual_io, lay.VIRTUAL_IO),
            from_twin=measured.from_twin,
        )
        # Access to one value is faster than through the arrays.
        self._set_points_at, self._real_at = reals(image.set_points), reals(image.real)
        given = np.flatnonzero(image.targets["source"] < 0).tolist()
        self._names = [(at, name, per_unit) for at, (_, name, per_unit) in zip(given, nodes.set_points, strict=True)]
        self._boundary_places = list(zip(wiring.boundary_slots, nodes.boundary_names, strict=True))
        self._totals, self._received = np.zeros(1, TOTALS), np.zeros(len(image.frames), np.int64)
        self._passed = self._totals[0].item()
        counted = Counting(
            *(image.frames, image.given, image.left, image.clocks, image.whole),
            *(measured.counted, self._totals, self._received, np.array([wiring.status], STATUS)),
        )
        self._count = CompiledStage(count, nodes.config.cycle_ns, counted, fallback=never)
        self._heartbeat: list[CompiledStage] = []
        if wiring.own_heartbeat >= 0:
            self._heartbeat.append(
                CompiledStage(heartbeat_sent, wiring.own_heartbeat, counted, fallback=self._send_heartbeat)
            )

    # -- parts of a cycle ------------------------------------------------------------------------------------

    @abstractmethod
    def _fitting_cycles(self, now_ns: int) -> int:
        """Number of cycles from now on that fit the fast path, as far as is known now."""

    @abstractmethod
    def _stages(self) -> Sequence[CompiledStage]:
        """Stages between outputs and"""

    def _account(self, frames: int, bits: int, duration_ns: int, begun_ns: int) -> None:  # noqa: B027
        """Account for cycles that were run, where not only the bench counts them."""

    def _give(self) -> None:  # noqa: B027
        """Update objects that are not of the bench, where these are in the arrays."""

    def _send_heartbeat(self, _: int) -> bool:
        """The bench's heartbeat was on the wire."""
        self._heartbeat_sent = True
        return True

    @property
    def _is_steady(self) -> bool:
        """True if the drives still follow, and the same answers are due."""
        nodes, sync = self._nodes, self._sync
        return nodes.follow and sync.due_always is self._due and nodes.supervised == self._supervised

    # -- cycle by cycle --------------------------------------------------------------------------------------

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one; False where it does not fit: nothing was done, or it was `sent`. Raises as `SyncCycle` and
        `Nodes.decode`."""
        begun_ns = time.monotonic_ns()
        if not self._fitting_cycles(begun_ns):
            return False
        set_points, real = self._set_points_at, self._real_at
        for at, name, per_unit in self._names:
            set_points[at] = outputs.get(name, 0.0) * per_unit
        for slot, name in self._boundary_places:
            real[slot] = outputs[name]
        self._set_times()
        try:
            for stage in (*self._stages(), self._count):
                stage()
        except StageAbortedError:
            return False
        if self._lines is None and self._tap is not None:
            self._tap.write(self._frames_of_cycle())
            self._tap.end_cycle()
        self._pass(begun_ns)
        return True

    def _set_times(self) -> None:
        self._image.given[0]["start_ns"] = self._sync.next_sync_ns

    def finish(self) -> list[Frame]:
        """The rest, interpreted, of a cycle that is none, but `sent`; as `SyncCycle.exchange`."""
        raise AssertionError("a cycle that leaves is not sent")

    # -- several of them -------------------------------------------------------------------------------------

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> BenchFastCycle | None:
        """This run as `exchange.exchange.ExchangeStages`; None where a part of a cycle is Python's."""
        if self._tap is not None and self._lines is None:
            return None
        stages = self._stages()
        if self._of_pieces != (stages, sample, shown):
            self._of_pieces = stages, sample, shown
            filling = self._nodes.measured.filling(sample)
            self.pieces = self._outputs_of(sample, shown), *stages, self._count, filling
        return self

    def _outputs_of(self, sample: CycleSample, shown: Mapping[str, str]) -> CompiledStage:
        """Take outputs from the signals that show them."""
        place, outputs = type(sample).place, self._names
        arrays = Outputs(
            sample.reals,
            self._image.set_points,
            np.array([(place(shown[name]), at) for at, name, _ in outputs], OUTPUT),
            np.array([per_unit for _, _, per_unit in outputs]),
            self._image.real,
            np.array([(place(shown[name]), slot) for slot, name in self._boundary_places], OUTPUT),
        )
        return CompiledStage(take_outputs, 0, arrays, fallback=never)

    def _leave(self) -> None:
        """Leave the fast path in a cycle."""
        self.left = True
        raise StageAbortedError

    def cycles(self) -> int:
        """Number of cycles that may run compiled (`exchange.exchange.ExchangeStages`)."""
        self._compiled_ns = now_ns = time.monotonic_ns()
        self._set_times()
        return min(self._fitting_cycles(now_ns), self._nodes.not_silent_cycles, TOGETHER - self._waiting)

    def passed(self) -> None:
        """Account for the cycles run compiled (`exchange.exchange.ExchangeStages`)."""
        self._pass(self._compiled_ns)

    def _pass(self, begun_ns: int) -> None:
        """The objects that count cycles learn of those since the last time. Raises as `SyncCycle` and
        `Nodes.decode`."""
        totals = self._totals[0].item()
        cycles, frames, bits, duration_ns, _ = (now - then for now, then in zip(totals, self._passed, strict=True))
        before = self._passed[0]
        if not cycles:
            return
        self._passed = totals
        if self._lines is not None:
            self._waiting += cycles
            self._waiting_frames += frames
        self._account(frames, bits, duration_ns, begun_ns)
        last_bits, heartbeat_sent = int(self._image.left[0]["bits"]), self._heartbeat_sent
        self._heartbeat_sent = False
        self._sync.count(cycles, bits, last_bits, begun_ns, time.monotonic_ns(), heartbeat_sent=heartbeat_sent)
        self.done += cycles
        fault, self._fault = self._fault or self._write_lines(TOGETHER), None
        if fault is not None:
            raise fault
        received = [(node, int(self._received[row]) - before) for node, row in self._wiring.heartbeats]
        received = [(node, at) for node, at in received if at > 0]
        self._nodes.pass_fast_path(cycles, received, max(0, totals[4] - before))

    def _write_lines(self, least: int) -> BenchFaultError | None:
        """Write the lines of the last cycles, if they are so many; returns the trace's error, if any."""
        if self._lines is None or self._waiting < least:
            return None
        given = self._image.given[0]
        text = self._image.text[: given["text"]].tobytes().decode("ascii")
        frames, self._waiting, self._waiting_frames = self._waiting_frames, 0, 0
        given["text"] = 0
        try:
            self._lines.write_lines(text, frames)
            self._lines.end_cycle()
        except BenchFaultError as fault:
            return fault
        return None

    def _frames_of_cycle(self) -> list[Frame]:
        """Frames of a cycle as they were on the wire."""
        frames, image = self._wiring.frames, self._image
        rows, times_ns = image.order[: image.left[0]["frames"]].tolist(), image.frames["time_ns"].tolist()
        data = (sent_data(image, row, frames.sizes[row]) for row in rows)
        return [Frame(frames.cob_ids[row], each, times_ns[row]) for row, each in zip(rows, data, strict=True)]

    # -- back to the objects ---------------------------------------------------------------------------------

    def end(self) -> None:
        """The objects get what the arrays have. Raises the trace's error."""
        fault = self._write_lines(1)
        if self.done:
            self._give()
            self._give_bench()
        if fault is not None:
            raise fault

    def _give_bench(self) -> None:
        wiring, image, nodes = self._wiring, self._image, self._nodes
        for cob_id, answer in nodes.answers.items():
            row = wiring.frames.row_of(cob_id)
            since = int(image.frames[row]["count"])
            data = sent_data(image, row, answer.size) if since < self.done else None
            answer.answered_until(self.done, data, since)
        wiring.give(image.seen[: len(nodes.drives)], image.whole)
        for (drive, _, _), (at, _, _) in zip(nodes.set_points, self._names, strict=True):
            drive.setpoint = float(image.set_points[at])
        nodes.end_fast_path(self.done)


class FastPath(ABC):
    """Runs the cycles of a bench that fit the fast path; see `exchange.exchange.FastPathCycles`."""

    def __init__(self, nodes: Nodes, sync: SyncCycle, own: MasterNode) -> None:
        self._nodes, self._sync, self._own = nodes, sync, own
        self._run: BenchFastCycle | None = None
        self._wait = 0  # cycles until it is tried again

    @abstractmethod
    def _new_run(self) -> BenchFastCycle | None:
        """Begin fast-path cycles. None, or FastPathRefusedError: they do not fit."""

    @property
    def _locks(self) -> Sequence[AbstractContextManager[Any]]:
        """What is held while the arrays are used."""
        return (self._sync.lock,)

    @abstractmethod
    def _after(self, done: int) -> None:
        """So many cycles were run until one left the fast path."""

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one, as `Exchange.cycle`; False where it was none, and nothing was done."""
        with self._locked():
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
        """Compiled stages (`exchange.exchange.FastPathCycles`)."""
        with self._locked():
            yield None if self._run is None else self._run.chained(sample, shown)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        with ExitStack() as held:
            for lock in self._locks:
                held.enter_context(lock)
            yield

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        run, self._run = self._run, None
        if run is not None:
            self._after(run.done)
            run.end()

    def _begin(self) -> BenchFastCycle | None:
        if self._wait:
            self._wait -= 1
            return None
        if self._nodes.fits_fast_path and self._sync.fits_fast_path and not self._own.has_answers:
            try:
                self._run = self._new_run()
            except FastPathRefusedError:
                self._run = None
        if self._run is None:
            self._wait = LOOK_AGAIN
        return self._run
