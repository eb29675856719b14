"""The bench's working state of the fast path, assembled from its objects, and handed back to them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hilbench.can.frame import Frame
from hilbench.cycle_program import CompiledStage, StageAbortedError, python_stage
from hilbench.errors import BenchFaultError
from hilbench.exchange.frame_tap import LineTap
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import ExpectedPdo, SyncCycle
from hilbench.fast_path import kernel
from hilbench.fast_path import layout as lay
from hilbench.fast_path.answers import ArrivalOrder, ArrivalOrders
from hilbench.fast_path.bench import BenchFrames, DriveFeedback
from hilbench.fast_path.kernel import Table
from hilbench.fast_path.tables import FastPathRefusedError, Frames, Slots, octets, reals, table
from hilbench.topology.sample import CycleSample


class BenchFastCycle(ABC):
    """Fast-path cycles one after the other, from objects into arrays and back. Call `begin` before the first."""

    def __init__(self, nodes: Nodes, sync: SyncCycle, tap: LineTap | None) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        self._nodes, self._sync, self._tap = nodes, sync, tap
        self.done = 0  #: fast-path cycles since it began
        self.pieces: Sequence[CompiledStage] = ()  #: see `exchange.exchange.ExchangeStages`
        self._of_pieces: tuple[object, ...] = ()
        self.left = False  #: True if a compiled cycle left the fast path: the interpreter resumes it
        self.sent = False  #: True if the cycle that left the fast path has been sent
        self.fault: BenchFaultError | None = None  #: error of the trace
        self._bitrate = nodes.config.bus.bitrate
        self._slots, self._frames = Slots(), Frames()
        self._bench = BenchFrames(nodes, sync, self._frames, self._slots)
        self._seen = DriveFeedback(nodes, self._slots)
        self._orders = ArrivalOrders(nodes, self._seen, self._slots, self._make)
        self._boundary_places = list(zip(self._bench.boundary_slots, nodes.boundary_names, strict=True))
        self._last: ArrivalOrder | None = None
        self._rare: dict[int, tuple[int, bytes]] = {}  # by COB-ID: the cycle in which it last came, and its data
        self._arrays()

    def begin(self) -> None:
        """Begin with the next cycle. Raises FastPathRefusedError where it does not fit the fast path."""
        nodes, sync = self._nodes, self._sync
        if not all(self._is_in_phase(pdo) for pdo in sync.due_at_times):
            raise FastPathRefusedError
        self._seen_rows[:] = table(self._seen.rows(), lay.FEEDBACK)
        for slot, drive in self._bench.controlwords:
            self._whole[slot] = drive.controlword
        self.done, self.left, self.sent, self.fault, self._last = 0, False, False, None, None
        self._rare.clear()
        nodes.begin_fast_path()
        self._due, self._supervised = sync.due_always, nodes.supervised

    def _is_in_phase(self, pdo: ExpectedPdo) -> bool:
        """True if a PDO of every n-th SYNC is due n SYNCs after its last one."""
        left = (pdo.since - self._sync.timing.cycles) % pdo.every or pdo.every
        return self._nodes.answers[pdo.cob_id].since + left == pdo.every

    # -- from the objects ------------------------------------------------------------------------------------

    def _arrays(self) -> None:
        frames, nodes, slots = self._frames, self._nodes, self._slots
        self._targets = table(self._bench.targets, lay.TARGET)
        self._set_points = np.zeros(len(self._targets))
        self._set_points_at = reals(self._set_points)
        given = np.flatnonzero(self._targets["source"] < 0).tolist()
        self._names = [(at, name, per_unit) for at, (_, name, per_unit) in zip(given, nodes.set_points, strict=True)]
        self._whole, self._real = np.array(slots.whole, np.int64), np.array([*slots.real, 0.0])
        self._real_at = reals(self._real)
        self._status_at = self._whole.data[self._orders.status]
        self._seen_rows = np.zeros(len(self._seen.raw), lay.FEEDBACK)
        self._feedback = np.zeros(4 * len(self._seen_rows))
        self._given = np.zeros(lay.I_SIZE, np.int64)
        self._given_at = self._given.data
        self._find_heads([*frames.cob_ids, *self._orders.cob_ids])
        self._data, self._left = (
            np.zeros((len(frames.rows), 8), np.uint8),
            np.zeros(lay.O_SIZE + len(frames.rows), np.int64),
        )
        for row, content in frames.constants.items():
            self._data[row, : len(content)] = np.frombuffer(content, np.uint8)
        # Access to one value is faster than through the arrays.
        self._left_at, self._text_at = self._left.data, self._text.data
        # No answer yet: values of the last cycle stay.
        self._sent_by = kernel.Vectors(
            targets=self._targets,
            set_points=self._set_points,
            **self._on_wire(frames, self._data, self._left),
        )
        self._table = self._sent_by.table()

    def _find_heads(self, cob_ids: list[int]) -> None:
        """Find the heads of the trace's lines, by COB-ID, and make room for its text."""
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

    def _make(self, frames: Frames, virtual_io: lay.Rows, data: lay.Bytes, left: lay.Whole) -> Table:
        self._kept = [*getattr(self, "_kept", ()), vectors := self._vectors(frames, virtual_io, data, left)]
        return vectors.table()

    def _vectors(self, frames: Frames, virtual_io: lay.Rows, data: lay.Bytes, left: lay.Whole) -> kernel.Vectors:
        """Vectors for answers in these frames."""
        measured = self._nodes.measured
        return kernel.Vectors(
            **self._on_wire(frames, data, left),
            seen=self._seen_rows,
            feedback=self._feedback,
            virtual_io_rows=virtual_io,
            came=measured.came,
            torques=measured.torques,
            before_Nm=measured.before_Nm,
            of_drives=measured.of_drives,
            virtual_io=measured.virtual_io,
        )

    def _on_wire(self, frames: Frames, data: lay.Bytes, left: lay.Whole) -> dict[str, Any]:
        """These frames, with values and text, which are those of the run."""
        return {
            "frames": self._rows_of(frames),
            "sent": table(frames.sent, lay.FIELD),
            "received": table(sorted(frames.received), lay.FIELD),
            "whole": self._whole,
            "real": self._real,
            "given": self._given,
            "left": left,
            "data": data.reshape(-1),
            "heads": self._heads,
            "text": self._text if self._tap is not None else None,
        }

    def _rows_of(self, frames: Frames) -> lay.Rows:
        """Rows of frames with the heads of their trace lines."""
        rows = table(frames.rows, lay.FRAME)
        for row, cob_id in zip(rows, frames.cob_ids, strict=True):
            row["head"], row["head_end"] = self._heads_of.get(cob_id, (0, 0))
        return rows

    # -- cycle by cycle --------------------------------------------------------------------------------------

    @abstractmethod
    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one; False where it does not fit the fast path: nothing was done, or `sent`. Raises as `SyncCycle` and
        `Nodes.decode`."""

    @abstractmethod
    def finish(self) -> list[Frame]:
        """The rest, interpreted, of a cycle that is none, but `sent`; as `SyncCycle.exchange`."""

    @abstractmethod
    def cycles(self) -> int:
        """Number of cycles that may run compiled (`exchange.exchange.ExchangeStages`); other bus users wait so long."""

    @property
    def _is_steady(self) -> bool:
        """True if the drives still follow, and the same answers are due."""
        nodes, sync = self._nodes, self._sync
        return nodes.follow and sync.due_always is self._due and nodes.supervised == self._supervised

    def _take(self, outputs: Mapping[str, float]) -> None:
        """Outputs into the arrays."""
        set_points, real = self._set_points_at, self._real_at
        for at, name, per_unit in self._names:
            set_points[at] = outputs.get(name, 0.0) * per_unit
        for slot, name in self._boundary_places:
            real[slot] = outputs[name]

    def _due_at_times(self) -> Collection[int]:
        """COB-IDs of what answers the next SYNC, but not each."""
        sync = self._sync
        if not sync.due_at_times:
            return ()
        cycle = sync.timing.cycles + 1
        return {pdo.cob_id for pdo in sync.due_at_times if (cycle - pdo.since) % pdo.every == 0}

    def _keep_rare(self, order: ArrivalOrder) -> None:
        """Keep the last PDOs of every n-th SYNC until the end."""
        for cob_id, row in order.rare.items():
            self._rare[cob_id] = self.done, order.data[row, : order.sizes[row]].tobytes()
        self._last = order

    def _end_cycle(self, order: ArrivalOrder, heartbeats: Sequence[int]) -> None:
        """End a cycle run by the fast path; `heartbeats`: node ids received."""
        self.done += 1
        self.sent = False
        fault, self.fault = self.fault, None
        if fault is not None:
            raise fault
        status = self._status_at.tolist() if order.has_status else None
        self._nodes.take_fast_path(status, heartbeats)

    # -- several of them -------------------------------------------------------------------------------------

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> BenchFastCycle:
        """This run as `exchange.exchange.ExchangeStages`."""
        if self._of_pieces != (sample, shown):
            self._of_pieces = sample, shown
            values, kind = sample.reals.data, type(sample)
            at = {output: kind.place(signal) for output, signal in shown.items()}

            def exchange() -> bool:
                if not self.cycle({output: values[place] for output, place in at.items()}):
                    self.left = True
                    raise StageAbortedError
                self._nodes.measured.count(self._sync.timing.cycles, self._sync.last_bits)
                return True

            self.pieces = python_stage(exchange), self._nodes.measured.filling(sample)
        return self

    def passed(self) -> None:
        """Account for the cycles run compiled (`exchange.exchange.ExchangeStages`): nothing is left to do."""
        return  # each cycle was counted

    # -- back to the objects ---------------------------------------------------------------------------------

    def _outgoing(self) -> list[Frame]:
        """Frames sent before SYNC in a cycle that left the fast path."""
        frames = zip(self._frames.cob_ids, self._frames.sizes, self._data, strict=True)
        sent = [Frame(cob_id, data[:size].tobytes(), 0) for cob_id, size, data in frames]
        return [frame for frame, bits in zip(sent, self._left[lay.O_SIZE :], strict=True) if bits][:-1]

    @abstractmethod
    def _write_last(self) -> None:
        """Lines that are not the trace's yet."""

    def end(self) -> None:
        """The objects get what the arrays have."""
        self._write_last()
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
        self._nodes.end_fast_path(self.done)
