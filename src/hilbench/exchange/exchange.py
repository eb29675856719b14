"""Process data with the nodes of a bench, cycle by cycle: outputs by name go out, inputs come in.

The layers above know set points and measurements; frames, COB-IDs and objects stay here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Protocol

from hilbench.can.confinement import ControllerState
from hilbench.can.link import Link
from hilbench.canopen.object_store import ObjectStore
from hilbench.cycle_program import CompiledStage
from hilbench.errors import BenchFaultError
from hilbench.exchange.emergencies import Emergency
from hilbench.exchange.frame_tap import FrameTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.exchange.sync_producer import SyncProducer
from hilbench.exchange.unexpected_senders import Unexpected
from hilbench.topology.sample import CycleSample


class Inputs(Protocol):
    """Answers of the nodes to one SYNC; valid until the next cycle."""

    @property
    def emergencies(self) -> Mapping[Emergency, int]:
        """EMCY messages of this cycle in order, with the count of each."""

    @property
    def axes_late(self) -> bool:
        """True if the positions of the axes are not those of this SYNC."""

    @property
    def ages_cycles(self) -> tuple[int, ...]:
        """Age in cycles of each drive's measurements in use; 0 where it has answered this SYNC in time."""

    def twin_age(self, syncs: int) -> int:
        """Age in cycles of the twin's last answer, `syncs` after the twin was started."""

    def fill(self, sample: CycleSample) -> None:
        """Put the measurements into a sample; SI, positions and velocities in the machine's unit."""


class ExchangeStages(Protocol):
    """Cycles run entirely in compiled code: reads outputs from the sample, writes inputs to it."""

    @property
    def pieces(self) -> Sequence[CompiledStage]:
        """Compiled stages of a cycle. The one that sends the outputs raises `hilbench.cycle_program.StageAbortedError`
        where the cycle leaves the fast path: `Exchange.cycle` runs or finishes it then."""

    def cycles(self) -> int:
        """Number of cycles from the next one on that may run in these stages; called right before they run."""

    def passed(self) -> None:
        """All that count cycles learn of those that were run. Raises as `SyncCycle` and `Nodes.decode`."""


class FastPathCycles(Protocol):
    """Runs cycles in which nothing but set points and feedback changes, in the place of the interpreted ones."""

    def cycle(self, outputs: Mapping[str, float]) -> bool:
        """Run one, as `Exchange.cycle`; False where it was none, and nothing was done."""

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> AbstractContextManager[ExchangeStages | None]:
        """Compiled stages of cycles while the bus is used exclusively; None: the next cycle needs the interpreter.
        `shown`: signals of the sample that hold the outputs, by output name."""


class Exchange:
    """The cyclic exchange of one bench whose nodes are operational.

    `objects`: what others may read and write of the bench's own node; `tap` sees every frame; `in_process`: simulated
    hardware and twin are in this process, and wait for SYNC at any pace; `producer`: sends SYNC by the clock. What a
    cycle raises, and when: `SyncCycle`, `Nodes.decode`.
    """

    def __init__(
        self,
        nodes: Nodes,
        link: Link,
        objects: ObjectStore,
        *,
        tap: FrameTap | None = None,
        in_process: bool = False,
        producer: SyncProducer | None = None,
    ) -> None:
        config = nodes.config
        self.in_step = in_process or config.pace == "lockstep"  #: participants wait for SYNC, and SYNC for them
        self.runs_by_clock = in_process and config.pace == "realtime"
        self.counted = nodes.measured.counted  #: counters, a record `exchange.measured.COUNTED`, after each cycle
        self._nodes, self._link = nodes, link
        self._own = MasterNode(config.master.node_id, objects)
        self._sync = sync = SyncCycle(
            link,
            cycle_ns=config.cycle_ns,
            bitrate=config.bus.bitrate,
            lockstep=self.in_step,
            expected=nodes.expected_pdos(),
            timeout_s=config.safety.cycle_timeout_s,
            missing_limit=config.safety.missing_cycles,
            heartbeat=(config.master.node_id, config.master.heartbeat_ms),
            tap=tap,
            producer=producer,
        )
        self._fast_path: FastPathCycles | None = None
        self._foreign_between: list[Unexpected] = []  # among what was discarded since the last cycle, and before it
        self._foreign_before: list[Unexpected] = []
        self.timing = sync.timing
        self.pacing = sync.pacing
        self.silent = sync.silent  #: senders that do not answer, not waited for any longer
        self.stay_alive = sync.stay_alive
        self.stand_still = sync.stand_still
        self.emergency_stop = sync.emergency_stop

    def cycle(self, outputs: Mapping[str, float]) -> Inputs:
        """Outputs and SYNC onto the bus, then what the nodes answer. `outputs` as in `Nodes.encode`."""
        nodes, sync, own = self._nodes, self._sync, self._own
        nodes.unexpected_frames = []
        self._foreign_before, self._foreign_between = self._foreign_between, []
        if self.runs_by_clock:
            sync.wait_for_turn()
        try:
            if self._fast_path is not None and self._fast_path.cycle(outputs):
                self._count()
                return nodes
            set_points, answers = nodes.encode(outputs), own.answers()
            received = sync.exchange([*set_points, *answers], may_be_left_out=nodes.follow and not answers)
        except BenchFaultError:
            if sync.received:  # an answer that stays away may be a stranger's doing
                nodes.unexpected_frames, sync.received = nodes.foreign_among(sync.received), []
            raise
        own.handle(received)
        nodes.decode(received, sync.before_sync, sync.elapsed_cycles)
        self._count()
        return nodes

    def _count(self) -> None:
        self._nodes.measured.count(self.timing.cycles, self._sync.last_bits)

    @property
    def unexpected_frames(self) -> Sequence[Unexpected]:
        """Frames of the last cycle that are neither the bench's nor its nodes'; also after a fault of a drive, which
        such a frame may have caused."""
        return [*self._foreign_before, *self._nodes.unexpected_frames]

    def chained(self, sample: CycleSample, shown: Mapping[str, str]) -> AbstractContextManager[ExchangeStages | None]:
        """Compiled stages of cycles (`FastPathCycles.chained`); None without a fast path."""
        return self._fast_path.chained(sample, shown) if self._fast_path is not None else nullcontext()

    def use(self, made: Callable[[SyncCycle, MasterNode], FastPathCycles | None]) -> None:
        """Set the fast path: `made` creates it from the SYNC cycle and the bench's node."""
        self._fast_path = made(self._sync, self._own)

    def discard_waiting(self, timeout_s: float = 0.0) -> None:
        """Discard frames that wait, or come within `timeout_s`, as answers to the last SYNC; foreign frames among
        them appear in `unexpected_frames` of the next cycle."""
        self._foreign_between += self._nodes.foreign_among(self._sync.discard_waiting(timeout_s))

    def sync_only(self) -> None:
        """Send a SYNC without expecting answers: simulated time advances. Frames that come are only traced."""
        self._sync.exchange([])
        self._sync.discard_waiting()

    def expect_all(self, twin_since: int = 0) -> None:
        """Expect TPDOs of drives and twin from the next cycle on; `twin_since`: SYNC before the twin's start."""
        self.silent.discard(self._nodes.twin_name)
        self._sync.expect(self._nodes.expected_pdos(twin_since))

    def expect_drives(self, *, vital: bool = True) -> None:
        """Expect TPDOs of the drives only, from the next cycle on; a drive that is not `vital` may fall silent."""
        drives = [pdo for pdo in self._nodes.expected_pdos() if pdo.vital]
        self._sync.expect([replace(pdo, vital=vital) for pdo in drives])

    def expect_nobody(self) -> None:
        """Expect no TPDO from the next cycle on."""
        self._sync.expect([])

    @property
    def lost_frames(self) -> int | None:
        """Frames the bench's own connection has lost because it was not read in time; None: not known there."""
        return self._link.dropped

    @property
    def controller(self) -> ControllerState:
        """State of the bench's own CAN controller."""
        return self._link.controller
