"""The cyclic path: set points and SYNC out, the answers of this SYNC in."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from hilbench.bench import pacing
from hilbench.bus.frame import Frame
from hilbench.bus.link import Link
from hilbench.bus.wire import frame_bits
from hilbench.errors import NoAnswerError

SYNC_COB_ID = 0x080

#: Part of the cycle, at its end, that is kept for computing and sending the next set points (realtime pace):
#: answers that are not there by then count as missing.
_GUARD_FRACTION = 0.3


class FrameTap(Protocol):
    """Sees every frame of the bus in the order of the wire; each has its time (ns since the epoch)."""

    def write(self, frames: Sequence[Frame]) -> None:
        """Frames that went over the bus."""

    def end_cycle(self) -> None:
        """The frames of a cycle are complete."""


@dataclass(frozen=True)
class ExpectedPdo:
    """A TPDO that must answer every `every`-th SYNC after its node was started (NMT), which was after SYNC `since`."""

    cob_id: int
    every: int
    sender: str  #: for messages: who should have sent it
    since: int = 0


@dataclass
class CycleTiming:
    """Counts and times of the cyclic path; ns of wall time."""

    cycles: int = 0
    bits: int = 0
    missing_pdos: int = 0
    first_loss_cycle: int | None = None  #: in which the link was first seen to have lost frames
    wait_ns: int = 0  #: spent waiting for answers
    started_ns: int = 0
    ended_ns: int = 0


class CyclicExchange:
    """One SYNC after the other, paced in lockstep or by the wall clock.

    `exchange` sends set points and SYNC and returns the frames that answered. In lockstep it waits until every
    expected TPDO is there and raises NoAnswerError, naming who is missing, after `timeout_s` of wall time. In
    real time it waits for them until shortly before the next deadline, and raises when one sender's PDO was
    missing `missing_limit` cycles in a row.
    """

    def __init__(
        self,
        link: Link,
        *,
        cycle_ns: int,
        bitrate: int,
        lockstep: bool,
        expected: Sequence[ExpectedPdo],
        timeout_s: float,
        missing_limit: int,
        heartbeat: tuple[int, int] = (127, 0),
        tap: FrameTap | None = None,
    ) -> None:
        self.timing = CycleTiming()
        self.pacing = pacing.Pacing(period_ns=cycle_ns)
        self._link = link
        self._cycle_ns = cycle_ns
        self._bit_ns = 1e9 / bitrate
        self._lockstep = lockstep
        self._expected = tuple(expected)
        self._timeout_s = timeout_s
        self._missing_limit = missing_limit
        self._missed_in_row: dict[int, int] = {}
        self.last_bits = 0  #: bits on the bus in the last cycle
        self._tap = tap
        self._epoch_ns = 0
        self._sync = Frame(SYNC_COB_ID, b"")
        node_id, period_ms = heartbeat
        self._heartbeat = Frame(0x700 + node_id, b"\x05")
        self._heartbeat_cycles = max(1, period_ms * 1_000_000 // cycle_ns) if period_ms else 0

    def exchange(self, outgoing: Sequence[Frame]) -> list[Frame]:
        """Run one cycle: `outgoing` and SYNC onto the bus, then the frames that came until all have answered.

        `outgoing` is sent before the SYNC that makes it act.
        """
        timing = self.timing
        if timing.cycles == 0:
            timing.started_ns = time.monotonic_ns()
            self._epoch_ns = time.time_ns()
            pacing.start(self.pacing, timing.started_ns)
        if self._heartbeat_cycles and timing.cycles % self._heartbeat_cycles == 0:
            outgoing = [*outgoing, self._heartbeat]
        if self._lockstep:
            self._link.send([*outgoing, self._sync])
        else:
            if outgoing:
                self._link.send(outgoing)
            now_ns = pacing.sleep_until(self.pacing.deadline_ns)
            self._link.send([self._sync])
            pacing.advance(self.pacing, now_ns)
        timing.cycles += 1
        before_ns = time.monotonic_ns()
        received = self._collect(self._due())
        timing.ended_ns = time.monotonic_ns()
        timing.wait_ns += timing.ended_ns - before_ns
        if self._link.dropped and timing.first_loss_cycle is None:
            timing.first_loss_cycle = timing.cycles
        self._account(outgoing, received)
        return received

    def expect(self, pdos: Sequence[ExpectedPdo]) -> None:
        """From the next cycle on these TPDOs are waited for."""
        self._expected = tuple(pdos)

    @property
    def lost_frames(self) -> int | None:
        """Frames the bench's own connection has lost because it was not read in time; None: not known there."""
        return self._link.dropped

    def _due(self) -> dict[int, str]:
        cycle = self.timing.cycles
        return {pdo.cob_id: pdo.sender for pdo in self._expected if (cycle - pdo.since) % pdo.every == 0}

    def _collect(self, due: dict[int, str]) -> list[Frame]:
        received: list[Frame] = []
        remaining_s = self._remaining_s if not self._lockstep else self._lockstep_remaining(time.monotonic())
        while due:
            batch = self._link.receive(max(0.0, remaining_s()))
            if not batch and remaining_s() <= 0.0:
                self._missing(due)
                break
            for frame in batch:
                if due.pop(frame.can_id, None) is not None:
                    self._missed_in_row[frame.can_id] = 0
            received += batch
        return received

    def _lockstep_remaining(self, start_s: float) -> Callable[[], float]:
        return lambda: start_s + self._timeout_s - time.monotonic()

    def _remaining_s(self) -> float:
        guard_ns = self.pacing.deadline_ns - int(_GUARD_FRACTION * self._cycle_ns)
        return (guard_ns - time.monotonic_ns()) * 1e-9

    def _missing(self, due: dict[int, str]) -> None:
        self.timing.missing_pdos += len(due)
        if self._lockstep:
            names = ", ".join(f"{sender} (COB-ID {cob_id:03X}h)" for cob_id, sender in due.items())
            raise NoAnswerError(
                f"cycle {self.timing.cycles}: no answer to SYNC from {names} "
                f"within {self._timeout_s:g} s{self._losses()}"
            )
        for cob_id, sender in due.items():
            in_row = self._missed_in_row.get(cob_id, 0) + 1
            self._missed_in_row[cob_id] = in_row
            if in_row >= self._missing_limit:
                raise NoAnswerError(
                    f"cycle {self.timing.cycles}: no answer to {in_row} SYNCs in a row from {sender} "
                    f"(COB-ID {cob_id:03X}h){self._losses()}"
                )

    def _losses(self) -> str:
        """For a missing answer: it may have come, and have been lost on this side."""
        lost = self._link.dropped
        return f"; the bench itself has lost {lost} frames in this run" if lost else ""

    def _account(self, outgoing: Sequence[Frame], received: Sequence[Frame]) -> None:
        """Count the bits, and hand the frames with their times to the tap.

        In lockstep nobody's clock is right, so a frame's time is when it would be on a wire that starts each cycle
        with its SYNC at k·cycle; the set points before it end the cycle before.
        """
        bits = [frame_bits(frame) for frame in outgoing]
        bits_in = [frame_bits(frame) for frame in received]
        sync_bits = frame_bits(self._sync)
        self.timing.bits += sum(bits) + sum(bits_in) + sync_bits
        self.last_bits = sum(bits) + sum(bits_in) + sync_bits
        if self._tap is None:
            return
        start_ns = self._epoch_ns + (self.timing.cycles - 1) * self._cycle_ns
        tap = self._tap
        tap.write(self._timed(outgoing, bits, start_ns - int(sum(bits) * self._bit_ns)))
        tap.write([self._sync._replace(time_ns=start_ns + int(sync_bits * self._bit_ns))])
        if self._lockstep:
            tap.write(self._timed(received, bits_in, start_ns + int(sync_bits * self._bit_ns)))
        else:
            tap.write(received)
        tap.end_cycle()

    def _timed(self, frames: Sequence[Frame], bits: Sequence[int], start_ns: int) -> list[Frame]:
        timed, at_bits = [], 0
        for (can_id, data, _), length in zip(frames, bits, strict=True):
            at_bits += length
            timed.append(Frame(can_id, data, start_ns + int(at_bits * self._bit_ns)))
        return timed
