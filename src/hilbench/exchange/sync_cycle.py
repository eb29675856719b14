"""The cyclic path in frames: RPDOs and SYNC out, the TPDOs that answer this SYNC in.

`hilbench.exchange.nodes` interprets the frames; `hilbench.exchange.exchange` joins the two.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, replace
from typing import Any

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.wire import frame_bits
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID, send_emergency_stop
from hilbench.canopen.identifiers import HEARTBEAT, SYNC, NmtState
from hilbench.errors import BenchFaultError, EmergencyStopError, NoAnswerError
from hilbench.exchange import pacing
from hilbench.exchange.frame_tap import FrameTap
from hilbench.exchange.sync_producer import SyncProducer
from hilbench.exchange.sync_tracker import SyncReceived, SyncTracker

#: Lockstep: part of the time-out after which a bench that waits for an answer sends its heartbeat.
_ALIVE = 0.3
#: The longest time between two of them while no cycle runs, far less than the nodes' SYNC time-out.
_LONGEST_SILENCE_S = 0.5
#: Part of the time-out for cycles that are answered, but slowly.
_SLOW = 0.6
#: Between cycles: wall time in which devices of this process may take what was sent to them.
_A_MOMENT_S = 0.001
#: Lockstep: wall time to wait for who is not vital, where that is shorter than the time-out. The drives wait for SYNC
#: meanwhile, and take a bench for dead after 5 s.
_NOT_VITAL_S = 2.0


#: So many cycles in a row set points may be left out, for a bench that is late to come back into its time: one that is
#: interpreted, and one more. Where all this does not fit into a cycle that helps for no longer: not again for so many.
_MOST_LEFT_OUT, _NOT_AGAIN = 2, 64
#: NMT state in the bench's own heartbeat: OPERATIONAL, and PRE-OPERATIONAL after an emergency stop.
_OPERATIONAL, _PRE_OPERATIONAL = NmtState.OPERATIONAL.heartbeat, NmtState.PRE_OPERATIONAL.heartbeat


@dataclass(frozen=True)
class ExpectedPdo:
    """A TPDO that must answer every `every`-th SYNC after its node was started (NMT), which was after SYNC `since`."""

    cob_id: int
    every: int
    sender: str  #: for messages: who should have sent it
    size: int | None = None  #: bytes; a frame of another size is no answer. None: any
    since: int = 0
    vital: bool = True  #: false: the bench can go on without it


@dataclass
class CycleTiming:
    """Counts and times of the cyclic path; ns of wall time."""

    cycles: int = 0
    bits: int = 0
    missing_pdos: int = 0
    first_loss_cycle: int | None = None  #: in which the link was first seen to have lost frames
    wait_ns: int = 0  #: from SYNC to the last answer
    started_ns: int = 0
    ended_ns: int = 0


def _nobody() -> None:
    """Do nothing: no other code runs cycles."""


class SyncCycle:
    """One SYNC after the other, paced in lockstep or by the wall clock: SYNC is sent by the `producer` on its own,
    or where there is none (on other interfaces of python-can) from this thread.

    `exchange` sends frames and SYNC and returns the frames that answered. In lockstep it waits until every
    expected TPDO is there and raises NoAnswerError, naming who is missing, after `timeout_s` of wall time (2 s at most
    where no vital one is missing). In real time it waits for them until shortly before the next deadline, and raises
    when one sender's PDO was missing `missing_limit` cycles in a row; not for a sender that is not vital. A sender
    that does not answer is put into `silent`, and not waited for any longer. An emergency stop on the bus raises
    EmergencyStopError, once.
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
        producer: SyncProducer | None = None,
    ) -> None:
        self.timing = CycleTiming()
        self.pacing = pacing.Pacing(period_ns=cycle_ns)
        self._marks = None if producer is None else SyncTracker(link, producer, self.pacing)
        self._link = link
        self._cycle_ns = cycle_ns
        self._bit_ns = 1e9 / bitrate
        self._lockstep = lockstep
        self._timeout_s = timeout_s
        self._missing_limit = missing_limit
        self._missed_in_row: dict[int, int] = {}
        self._left_out = 0  # cycles in a row whose set points were
        self._leaves_out_from = 0  # cycles before which none are
        self.expect(expected)
        self.last_bits = 0  #: bits on the bus in the last cycle
        self.before_sync = 0  #: number of frames returned by the last cycle that came before its SYNC
        self.silent: set[str] = set()  #: senders that don't answer: not waited for any longer
        self._emergency_stop_seen = False
        self._alive_s = 0.0  #: when the last heartbeat was sent, monotonic clock
        self._tap = tap
        self.lock = threading.Lock()  #: its holder uses the link: a cycle, or between two of them `stay_alive`
        #: Called before the link is used other than by the fast path, so that it hands its state back.
        self.before_use: Callable[[], None] = _nobody
        self._came_between: list[Frame] = []
        self.received: list[Frame] = []  #: frames received in a cycle that a fault has ended
        self._fault_between: Exception | None = None
        self._epoch_ns = 0
        self._sync = Frame(SYNC, b"")
        self._sync_bits = frame_bits(self._sync)
        self._since_sync_bits = 0  # on the bus from the beginning of SYNC on
        self._unwritten: tuple[Sequence[Frame], Sequence[int], int] | None = None  # last answers, bits, when they began
        node_id, period_ms = heartbeat
        self._heartbeat = Frame(HEARTBEAT + node_id, _OPERATIONAL)
        self._next_heartbeat = 0  # in periods, by the clock
        self._heartbeat_cycles = max(1, period_ms * 1_000_000 // cycle_ns) if period_ms else 0

    def wait_for_turn(self) -> None:
        """Wait until the next SYNC is due by the clock, for participants that run by SYNC."""
        if self.pacing.deadline_ns == 0:
            pacing.start(self.pacing, time.monotonic_ns())
        pacing.advance_in_step(self.pacing, pacing.sleep_until(self.pacing.deadline_ns))

    def exchange(self, outgoing: Sequence[Frame], *, may_be_left_out: bool = False) -> list[Frame]:
        """Run one cycle: send `outgoing` and SYNC, return the frames received until all have answered.

        `outgoing` is sent before the SYNC that makes it act; it `may_be_left_out` where it is nothing but the next set
        points of drives that follow them (`_leaves_out`).
        """
        with self.lock:
            self.before_use()
            if may_be_left_out and self._leaves_out(sum(map(frame_bits, outgoing))):
                outgoing = []
            return self._exchange(outgoing)

    def _leaves_out(self, bits: int) -> bool:
        """True if set points of so many bits are not to be sent in this cycle, and count as late.

        Where an answer has stayed away the bench has waited for it to the end. What it sends then is on the wire when
        SYNC is due, acts with the next one, and keeps the wire from the answers to this one, of which the last comes
        too late as well: so it would go on. Set points of the next cycle act at the same time.
        """
        marks, left_out, cycles = self._marks, self._left_out, self.timing.cycles
        begins = not left_out and self._missed_in_row and cycles >= self._leaves_out_from
        behind = begins or 0 < left_out < _MOST_LEFT_OUT
        if marks is None or not behind or time.monotonic_ns() + bits * self._bit_ns <= marks.next_ns:
            self._left_out = 0
            return False
        self._left_out = left_out + 1
        self._leaves_out_from = cycles + _NOT_AGAIN
        self.pacing.late_set_points += 1
        return True

    def _exchange(self, outgoing: Sequence[Frame]) -> list[Frame]:
        between, self._fault_between = self._fault_between, None
        if between is not None:
            raise between
        timing = self.timing
        if timing.cycles == 0:
            timing.started_ns = time.monotonic_ns()
            self._epoch_ns = time.time_ns()
            if not self._lockstep and self._marks is None:
                pacing.start(self.pacing, timing.started_ns)
        if self._heartbeat_is_due():
            outgoing = [*outgoing, self._heartbeat]
            self._alive_s = time.monotonic()
        # Late answers (lockstep: those to a SYNC that was there twice) are no answers to this SYNC: counted as such
        # they would push the true ones to the next.
        trace_fault, met = None, None
        if self._lockstep:
            late = self._take_waiting()
            self._link.send([*outgoing, self._sync])
            trace_fault = self.write_last_answers()
        else:
            if outgoing:
                self._link.send(outgoing)
            if self._marks is not None:
                met = self._marks.meet()
                late = met.before
            else:
                now_ns = pacing.sleep_until(self.pacing.deadline_ns)
                late = self._link.receive(0.0)
                self._link.send([self._sync])
                pacing.advance(self.pacing, now_ns)
        return self.finish(outgoing, late, met.behind if met is not None else [], trace_fault, met)

    def finish(
        self,
        outgoing: Sequence[Frame],
        late: list[Frame],
        came: list[Frame],
        trace_fault: BenchFaultError | None,
        met: SyncReceived | None = None,
    ) -> list[Frame]:
        """Finish a cycle, which may be one that the fast path has begun, under `lock`: `outgoing` and SYNC are sent,
        `late` came before its SYNC, `came` after it so far; `trace_fault`: the error of the trace, if any; `met`: the
        producer's SYNC."""
        timing = self.timing
        timing.cycles += 1
        before_ns = time.monotonic_ns()
        if met is not None:
            self._account_met(outgoing, met)
        else:
            self._account_before_sync(outgoing, late)
        answers, failure = self._collect(self._due(), came)
        received, self.before_sync = late + answers, len(late)
        self.received = received
        timing.ended_ns = time.monotonic_ns()
        timing.wait_ns += timing.ended_ns - before_ns
        timing.bits += self.last_bits
        if self._tap is not None and self._unwritten is None:
            self._tap.end_cycle()
        if self._link.dropped and timing.first_loss_cycle is None:
            timing.first_loss_cycle = timing.cycles
        if not self._emergency_stop_seen and any(frame.can_id == EMERGENCY_STOP_COB_ID for frame in received):
            self._emergency_stop_seen = True
            self._heartbeat = self._heartbeat._replace(data=_PRE_OPERATIONAL)
            raise EmergencyStopError(f"cycle {timing.cycles}: emergency stop (COB-ID 001h) on the bus")
        fault = trace_fault or failure
        if fault is not None:
            raise fault
        self.received = []
        return received

    def _heartbeat_is_due(self) -> bool:
        """True if a heartbeat is due: by cycles, so that runs are alike; in lockstep also when these take very long,
        before the supervisor's time-out. By the clock missed cycles count, too."""
        if not self._heartbeat_cycles:
            return False
        if not self._lockstep:
            now = self.timing.cycles + self.pacing.missed
            due = now >= self._next_heartbeat
            if due:
                self._next_heartbeat = now + self._heartbeat_cycles
            return due
        slow = time.monotonic() - self._alive_s > _SLOW * self._timeout_s
        return slow or self.timing.cycles % self._heartbeat_cycles == 0

    def expect(self, pdos: Sequence[ExpectedPdo]) -> None:
        """Set the TPDOs that are waited for from the next cycle on."""
        self.due_always = {pdo.cob_id: pdo for pdo in pdos if pdo.every == 1}
        self.due_at_times = [pdo for pdo in pdos if pdo.every != 1]  #: TPDOs due with every n-th SYNC only
        self._size = {pdo.cob_id: pdo.size for pdo in pdos if pdo.size is not None}
        self._out_of_phase: dict[int, int] = {}  # PDOs whose phase is in doubt: the cycle in which one came between
        self._missed_in_row.clear()

    def _take_waiting(self) -> list[Frame]:
        came, self._came_between = self._came_between, []
        return came + self._link.receive(0.0) if came else self._link.receive(0.0)

    def discard_waiting(self, timeout_s: float = 0.0) -> list[Frame]:
        """Write frames that wait, or come within `timeout_s`, into the trace only: no answer to the last SYNC."""
        with self.lock:
            self.before_use()
            return self._discard_waiting(timeout_s)

    def _discard_waiting(self, timeout_s: float) -> list[Frame]:
        trace_fault = self.write_last_answers()
        came, self._came_between = self._came_between, []
        waiting = came + (self._link.receive if self._marks is None else self._marks.discard)(timeout_s)
        if waiting and self._tap is not None:
            bits = [frame_bits(frame) for frame in waiting]
            self._tap.write(self._timed(waiting, bits, self.next_sync_ns - int(sum(bits) * self._bit_ns)))
            self._tap.end_cycle()
        if trace_fault is not None:
            raise trace_fault
        return list(waiting)

    def emergency_stop(self) -> None:
        """Stop everything on the bus at once. Raises BusError when it can't be sent."""
        self.before_use()
        self._heartbeat = self._heartbeat._replace(data=_PRE_OPERATIONAL)
        send_emergency_stop(self._link)

    def stand_still(self, done: Future[Any], longest_s: float) -> None:
        """Lockstep: no cycle until `done`, or for `longest_s` of wall time: the nodes wait for SYNC meanwhile."""
        with self.lock:
            self.before_use()
            trace_fault = self.write_last_answers()
            if trace_fault is not None:
                raise trace_fault
            self._send_heartbeat()
            end_s = time.monotonic() + longest_s
            while (left_s := end_s - time.monotonic()) > 0.0:
                if not wait_for([done], timeout=min(left_s, _ALIVE * self._timeout_s, _LONGEST_SILENCE_S)).not_done:
                    return
                self._send_heartbeat()
                self._came_between += self._link.receive(_A_MOMENT_S)

    def stay_alive(self, silence_s: float) -> None:
        """Send a heartbeat in lockstep, from another thread, between cycles, where the last one is more than
        `silence_s` of wall time ago, and receive frames.

        Does nothing while a cycle runs. After an emergency stop the heartbeat state is PRE-OPERATIONAL.
        An exception is raised by the next cycle.
        """
        if time.monotonic() - self._alive_s < silence_s or not self.lock.acquire(blocking=False):
            return
        try:
            self.before_use()
            if self._fault_between is None:
                self._fault_between = self.write_last_answers()
                self._send_heartbeat()
                came = self._link.receive(_A_MOMENT_S)
                self._came_between += came
                if any(frame.can_id == EMERGENCY_STOP_COB_ID for frame in came):
                    self._heartbeat = self._heartbeat._replace(data=_PRE_OPERATIONAL)
                    self._send_heartbeat()
        except Exception as fault:
            self._fault_between = fault
        finally:
            self.lock.release()

    def _send_heartbeat(self) -> None:
        """Send the heartbeat between cycles in lockstep, where it is due by cycles; a long one is no stalled bench."""
        if self._heartbeat_cycles:
            self._alive_s = time.monotonic()
            self._link.send([self._heartbeat])
            if self._tap is not None:
                self._tap.write([self._heartbeat._replace(time_ns=self.next_sync_ns)])

    @property
    def elapsed_cycles(self) -> int:
        """Number of SYNCs on the bus for which no cycle was run."""
        return self._marks.elapsed_cycles if self._marks is not None else 0

    @property
    def next_sync_ns(self) -> int:
        """Start of the next SYNC in ns, on the time base of the trace."""
        return self._epoch_ns + self.timing.cycles * self._cycle_ns

    # -- cycles run by the fast path (`hilbench.in_process_cycle`) ----------------------------------------------------

    @property
    def fits_fast_path(self) -> bool:
        """True if nothing is left over from the last cycle: all expected TPDOs came in phase, no fault or stop."""
        return (
            self.timing.cycles > 0
            and self._fault_between is None
            and not (self._came_between or self.silent or self._out_of_phase or self._emergency_stop_seen)
            and not self._missed_in_row
            and self._heartbeat.data == _OPERATIONAL
        )

    def came_between(self, frames: Sequence[Frame]) -> None:
        """Take frames that the fast path has received before SYNC."""
        self._came_between += frames

    @property
    def heartbeat(self) -> tuple[Frame, int]:
        """The bench's heartbeat frame, and its period in SYNCs (0: never)."""
        return self._heartbeat, self._heartbeat_cycles

    @property
    def slow_from_ns(self) -> int:
        """Time of the monotonic clock from which on a heartbeat is due because cycles take so long."""
        return int((self._alive_s + _SLOW * self._timeout_s) * 1e9) if self._heartbeat_cycles else 1 << 62

    def count(
        self, cycles: int, bits: int, last_bits: int, begun_ns: int, ended_ns: int, *, heartbeat_sent: bool
    ) -> None:
        """Count cycles run by the fast path: their bits, the bits of the last of them, begin and end in ns of the
        monotonic clock."""
        timing = self.timing
        timing.cycles += cycles
        timing.bits += bits
        timing.wait_ns += ended_ns - begun_ns
        timing.ended_ns = ended_ns
        self.last_bits = last_bits
        self.before_sync = 0
        if heartbeat_sent:
            self._alive_s = begun_ns * 1e-9

    def _due(self) -> dict[int, ExpectedPdo]:
        cycle, silent = self.timing.cycles + self.elapsed_cycles, self.silent
        due = self.due_always.copy()
        for pdo in self.due_at_times:
            if (cycle - pdo.since) % pdo.every == 0 and pdo.cob_id not in self._out_of_phase:
                due[pdo.cob_id] = pdo
        return {cob_id: pdo for cob_id, pdo in due.items() if pdo.sender not in silent} if silent else due

    def _collect(self, due: dict[int, ExpectedPdo], came: list[Frame]) -> tuple[list[Frame], NoAnswerError | None]:
        """Receive until no TPDO is due (`came` first). Returns the frames, and an error to raise after tracing."""
        received: list[Frame] = []
        failure = None
        receive = self._link.receive if self._marks is None else self._marks.answers
        remaining_s = self._remaining_s if not self._lockstep else self._lockstep_remaining(due)
        while due or came:
            left_s = max(0.0, remaining_s())
            wait_s = min(left_s, _ALIVE * self._timeout_s) if self._lockstep else left_s
            batch, came = came or receive(wait_s), []
            if not batch:
                if remaining_s() <= 0.0:
                    failure = self._missing(due)
                    break
                if self._lockstep:
                    self._send_heartbeat()
            for can_id, data, _ in batch:
                if self._size.get(can_id, len(data)) != len(data):
                    continue
                self._missed_in_row.pop(can_id, None)
                if due.pop(can_id, None) is not None:
                    continue
                if can_id == EMERGENCY_STOP_COB_ID:
                    due.clear()  # the nodes leave OPERATIONAL: no answers will come
                elif self.due_at_times:
                    self._look_at_phase(can_id)
            if batch:
                self._account_received(batch, last=not due)
            received += batch
        return received, failure

    def write_last_answers(self) -> BenchFaultError | None:
        """Write answers deferred in lockstep, while the others compute; returns the trace's error, if any."""
        if self._unwritten is None or self._tap is None:
            return None
        answers, self._unwritten = self._unwritten, None
        try:
            self._tap.write(self._timed(*answers))
            self._tap.end_cycle()
        except BenchFaultError as fault:
            return fault
        return None

    def _look_at_phase(self, cob_id: int) -> None:
        """Check the phase of a PDO of every n-th SYNC. One in between: its sender has received a SYNC twice or missed
        one, or it is foreign. It is not waited for until one comes when due, or n SYNCs after the one in between."""
        cycle, doubt = self.timing.cycles + self.elapsed_cycles, self._out_of_phase
        for at, pdo in enumerate(self.due_at_times):
            if pdo.cob_id != cob_id:
                continue
            if (cycle - pdo.since) % pdo.every == 0:
                doubt.pop(cob_id, None)
            elif doubt.get(cob_id) == cycle - pdo.every:
                self.due_at_times[at] = replace(pdo, since=cycle - pdo.every)
                del doubt[cob_id]
            else:
                doubt[cob_id] = cycle

    def _lockstep_remaining(self, due: Mapping[int, ExpectedPdo]) -> Callable[[], float]:
        start_s, timeout_s = time.monotonic(), self._timeout_s

        def remaining_s() -> float:
            vital = any(pdo.vital for pdo in due.values())
            return start_s + (timeout_s if vital else min(timeout_s, _NOT_VITAL_S)) - time.monotonic()

        return remaining_s

    def _remaining_s(self) -> float:
        until_ns = self.pacing.deadline_ns - int(pacing.GUARD_FRACTION * self._cycle_ns)
        return (until_ns - time.monotonic_ns()) * 1e-9

    def _missing(self, due: dict[int, ExpectedPdo]) -> NoAnswerError | None:
        self.timing.missing_pdos += len(due)
        if not self._lockstep:
            for cob_id in due:
                self._missed_in_row[cob_id] = self._missed_in_row.get(cob_id, 0) + 1
            due = {cob_id: pdo for cob_id, pdo in due.items() if self._missed_in_row[cob_id] >= self._missing_limit}
        self.silent |= {pdo.sender for pdo in due.values()}
        names = ", ".join(f"{pdo.sender} (COB-ID {cob_id:03X}h)" for cob_id, pdo in due.items() if pdo.vital)
        if not names:
            return None
        how_long = f"within {self._timeout_s:g} s" if self._lockstep else f"{self._missing_limit} times in a row"
        return NoAnswerError(f"cycle {self.timing.cycles}: no answer to SYNC from {names} {how_long}{self._losses()}")

    def _losses(self) -> str:
        """Text for a missing answer about frames lost on the bench's side."""
        lost = self._link.dropped
        return f"; the bench itself has lost {lost} frames in this run" if lost else ""

    def _account_before_sync(self, outgoing: Sequence[Frame], late: Sequence[Frame]) -> None:
        """Count the bits sent and received before SYNC, and hand the frames to the tap, while the others compute.

        In lockstep no clock is real time, so a frame's time is when it would be on a wire that starts each cycle
        with its SYNC at k·cycle; frames before it end the cycle before.
        """
        frames = [*outgoing, *late]
        bits = [frame_bits(frame) for frame in frames]
        self._since_sync_bits = self._sync_bits
        self.last_bits = sum(bits) + self._sync_bits
        if self._tap is not None:
            start_ns = self._cycle_start_ns()
            timed = self._timed(frames, bits, start_ns - int(sum(bits) * self._bit_ns))
            if not self._lockstep:
                timed[len(outgoing) :] = late
            timed.append(Frame(SYNC, b"", start_ns + int(self._sync_bits * self._bit_ns)))
            self._tap.write(timed)

    def _account_met(self, outgoing: Sequence[Frame], met: SyncReceived) -> None:
        """Count and trace frames where each SYNC was received in its place; ours sent after it are traced after it."""
        sent_bits = [frame_bits(frame) for frame in outgoing]
        self._since_sync_bits = self._sync_bits
        self.last_bits = sum(sent_bits) + sum(frame_bits(frame) for frame in met.on_wire) + self._sync_bits
        if self._tap is not None:
            start_ns = met.sync.time_ns - int(self._sync_bits * self._bit_ns)
            if met.joined:
                ours = self._timed(outgoing, sent_bits, met.sync.time_ns)
                self._tap.write([*met.on_wire, met.sync, *ours])
            else:
                ours = self._timed(outgoing, sent_bits, start_ns - int(sum(sent_bits) * self._bit_ns))
                # After the last SYNC that went by; late frames come after ours, as always.
                at = max((at for at, frame in enumerate(met.on_wire, 1) if frame.can_id == SYNC), default=0)
                self._tap.write([*met.on_wire[:at], *ours, *met.on_wire[at:], met.sync])

    def _account_received(self, frames: Sequence[Frame], *, last: bool = False) -> None:
        """Count and trace answers as they come; in real time each has its own time. The last ones of a cycle are what
        all wait for: in lockstep they go into the trace once the next SYNC is out."""
        bits = [frame_bits(frame) for frame in frames]
        if self._tap is not None:
            start_ns = self._cycle_start_ns() + int(self._since_sync_bits * self._bit_ns)
            if not self._lockstep:
                self._tap.write(frames)
            elif last:
                self._unwritten = (frames, bits, start_ns)
            else:
                self._tap.write(self._timed(frames, bits, start_ns))
        self._since_sync_bits += sum(bits)
        self.last_bits += sum(bits)

    def _cycle_start_ns(self) -> int:
        return self._epoch_ns + (self.timing.cycles - 1) * self._cycle_ns

    def _timed(self, frames: Sequence[Frame], bits: Sequence[int], start_ns: int) -> list[Frame]:
        timed, at_bits, bit_ns = [], 0, self._bit_ns
        for (can_id, data, _), length in zip(frames, bits, strict=True):
            at_bits += length
            timed.append(Frame(can_id, data, start_ns + int(at_bits * bit_ns)))
        return timed
