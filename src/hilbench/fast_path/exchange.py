"""Fast path of a bench whose nodes are on the embedded bus and wait for SYNC: packets out and in, on arrays.

The bench sends one packet; its answers come in packets, in an order that the bus decides. Where exactly the frames
due came, and none changes a state, `kernel` does what `exchange` and `cia402.drive` do with them. Anything
else is for the interpreted cycle, which is the reference; it can resume in the middle of a cycle, too.
"""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import HEARTBEAT, NmtState
from hilbench.cia402 import objects
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.state_machine import STATUS_MASK, State
from hilbench.compiled import load
from hilbench.cycle_program import CONTINUE, CompiledStage
from hilbench.exchange.frame_tap import LineTap
from hilbench.exchange.master_node import MasterNode
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.fast_path import layout as lay
from hilbench.fast_path import packet_kernel
from hilbench.fast_path.bench_cycle import LOOK_AGAIN, STAGES, TOGETHER, BenchFastCycle, BenchFrames, FastPath
from hilbench.fast_path.packet_kernel import NOTHING, UNSENT, PacketPort
from hilbench.fast_path.tables import refuse_if

#: The pause after a run is doubled each time that too few cycles in a row fitted for it to pay, up to the longest.
_LONGEST_PAUSE, _PAYS = 512, 64
#: Longest wait for a packet before the interpreted cycle takes over the wait.
_PATIENCE_S = 0.1
_OPERATIONAL = NmtState.OPERATIONAL.heartbeat
_ENABLED = State.OPERATION_ENABLED


class FastPathExchange(FastPath):
    """Runs the cycles of a bench that fit the fast path, over the embedded bus."""

    def __init__(self, link: EmbeddedLink, nodes: Nodes, sync: SyncCycle, own: MasterNode, tap: LineTap | None) -> None:
        super().__init__(nodes, sync, own)
        self._link, self._tap = link, tap
        self._pause = LOOK_AGAIN  # cycles to wait when they leave the fast path
        self.warm_up()
        sync.before_use = self.settle

    @staticmethod
    def warm_up() -> None:
        """Compile, or load from the cache, the functions called: in good time, where one is to be made later."""
        load(packet_kernel.ask, packet_kernel.collect, *STAGES)

    def _new_run(self) -> BenchFastCycle:
        return PacketCycle(self._link, _AnsweredFrames(self._nodes, self._sync), self._tap)

    def _after(self, done: int) -> None:
        self._wait = self._pause
        self._pause = LOOK_AGAIN if done >= _PAYS else min(2 * self._pause, _LONGEST_PAUSE)


class _AnsweredFrames(BenchFrames):
    """Frames of a bench, and what the nodes on its bus answer. `checks`: rows of `packet_kernel.CHECK`."""

    def answer(self) -> None:
        """Add TPDOs and heartbeats. Raises FastPathRefusedError where a TPDO is one that only the interpreted cycle
        knows, or is not due when it was before."""
        self.checks: list[tuple[int, int, int, int, int]] = []
        nodes, frames, cycles = self.nodes, self.frames, self.sync.timing.cycles
        for cob_id, tpdo in nodes.answers.items():
            count = tpdo.since if tpdo.every != 1 else 0
            frames.add(cob_id, lay.ANSWER, bytes(tpdo.size), every=tpdo.every, count=count)
        for pdo in self.sync.due_at_times:  # of every n-th SYNC: due n SYNCs after its last one
            left = (pdo.since - cycles) % pdo.every or pdo.every
            refuse_if(nodes.answers[pdo.cob_id].since + left != pdo.every)
        expected = {*self.sync.due_always, *(pdo.cob_id for pdo in self.sync.due_at_times)}
        taken = {pdo.cob_id for drive in nodes.drives for pdo in drive.pdos.tpdos}
        taken |= {pdo.cob_id for pdo in (nodes.io.status, *nodes.io.sent)}
        refuse_if(not expected == set(nodes.answers) == taken)
        for node_id in dict.fromkeys(part.node.node_id for part in nodes.config.parts):
            row = frames.add(HEARTBEAT + node_id, lay.ANSWER, _OPERATIONAL, timing=lay.BY_ARRIVAL)
            self.heartbeats.append((node_id, row))
            self.checks.append((row, 0, 1, 0xFF, _OPERATIONAL[0]))
        self._check_statuswords()

    def _check_statuswords(self) -> None:
        for drive in self.nodes.drives:
            for pdo in drive.pdos.tpdos:
                offset, row = 0, self.frames.row_of(pdo.cob_id)
                for index, kind in zip(mapped_objects(pdo), pdo.kinds, strict=True):
                    width = kind.width or 0
                    if index == objects.STATUSWORD:
                        self.checks.append((row, offset, width, STATUS_MASK[_ENABLED], _ENABLED.value))
                    offset += width


class PacketCycle(BenchFastCycle):
    """Fast-path cycles in lockstep, over the embedded bus."""

    def __init__(self, link: EmbeddedLink, wiring: _AnsweredFrames, tap: LineTap | None) -> None:
        """Raises FastPathRefusedError where cycles do not fit the fast path."""
        super().__init__(wiring, tap)
        self._link = link
        count, bitrate = len(wiring.frames.rows), self._nodes.config.bus.bitrate
        port = PacketPort(self._image, link.fileno(), link.dropped, wiring.asked, count, wiring.checks)
        self._port = port
        self._packets = (
            CompiledStage(packet_kernel.ask, bitrate, (), fallback=self._asked, table=port.table),
            CompiledStage(packet_kernel.collect, bitrate, (), fallback=self._wait_for_answers, table=port.table),
            *self._heartbeat,
        )

    def _fitting_cycles(self, now_ns: int) -> int:
        until_ns = self._sync.slow_from_ns
        self._port.state["until_ns"] = until_ns
        return TOGETHER if self._is_steady and now_ns <= until_ns else 0

    def _stages(self) -> Sequence[CompiledStage]:
        return self._packets

    def _asked(self, outcome: int) -> bool:
        """The bus did not take the packet, or a value does not fit, or a frame has come before."""
        if outcome != UNSENT:
            came = self._port.packets or (self._link.receive_packet(0.0),)
            self._sync.came_between(self._link.frames_from(*came))
            self._leave()
        self.sent = True
        self._link.send_records(self._port.unsent)
        self.sent = False
        return True

    def _wait_for_answers(self, outcome: int) -> bool:
        """Gather packets until all answers due are there; leave where another frame has come, or none in time."""
        port, stage = self._port, self._packets[1]
        while outcome == NOTHING:
            packet = self._link.receive_packet(_PATIENCE_S)
            if packet is None:
                break
            port.put(packet)
            outcome = stage.function(stage.argument, stage.table)
        if outcome != CONTINUE:
            self.sent = True
            self._leave()
        return True

    def finish(self) -> list[Frame]:
        """Finish a cycle that left the fast path, from the packets received. Raises BusError as well."""
        came = self._link.frames_from(*self._port.packets)
        outgoing = self._frames_of_cycle()
        fault, self._fault = self._fault, None
        return self._sync.finish([frame._replace(time_ns=0) for frame in outgoing[:-1]], [], came, fault)
