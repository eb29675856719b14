"""Outputs in, inputs out: a cycle of process data with nodes that answer from a list, without a bus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest
from tests.bench.bench_nodes import nodes
from tests.bench.samples import sample_of_two_axes

from hilbench.bench.operator.operator_objects import OperatorObjects
from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus, MemoryCanBus
from hilbench.canopen.identifiers import SYNC, NmtCommand
from hilbench.canopen.master import Master
from hilbench.canopen.sdo_client import SentFrames
from hilbench.cia402.drive import DriveGoal
from hilbench.errors import BenchFaultError, NoAnswerError
from hilbench.exchange.answers import Tpdo
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.nodes import Nodes

ENABLED, FAULT = 0x27, 0x08  #: statuswords
OUTPUTS = {"axis1": 1.0, "axis2": 1.25, "load": 0.5, "strain_prev": 2.8e-4, "F_next_N": 70.0}
TWIN = "virtual io (node 32)"


class Answering:
    """A link on which all TPDOs come after each SYNC but those `missing`; `further` come once, beside them."""

    channel, dropped, controller = "fake0", 0, ControllerState.ERROR_ACTIVE

    def __init__(self, found: Nodes) -> None:
        self._nodes = found
        self.waiting: list[Frame] = []
        self.statusword = ENABLED
        self.missing: set[int] = set()
        self.further: list[Frame] = []
        self.sent: list[Frame] = []

    def send(self, frames: Sequence[Frame]) -> None:
        self.sent += frames
        if any(frame.can_id == SYNC for frame in frames):
            self.waiting += [frame for frame in [*self.further, *self._answers()] if frame.can_id not in self.missing]
            self.further = []

    def _answers(self) -> list[Frame]:
        answers = []
        for drive in self._nodes.drives:
            for pdo in drive.pdos.tpdos:
                values = [self.statusword if each.index == 0x6041 else 7 for each in pdo.variables]
                answers.append(Frame(pdo.cob_id, pdo.pack(values)))
        io = self._nodes.io
        return [*answers, *(Frame(pdo.cob_id, bytes(pdo.size)) for pdo in (*io.sent, io.status))]

    def receive(self, timeout_s: float) -> list[Frame]:
        taken, self.waiting = self.waiting, []
        return taken

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None: ...

    def fileno(self) -> int:
        return -1

    def close(self) -> None: ...


class Bench:
    """An exchange with its nodes and link; 20 ms of patience."""

    def __init__(self) -> None:
        self.nodes = nodes()
        self.master = Master(MemoryCanBus(MemoryBus("memory0", 1_000_000)))
        self.nodes.introduce(self.master)
        for drive in self.nodes.drives:
            drive.request(DriveGoal.ENABLED)
        config = self.nodes.config
        safety = config.safety.model_copy(update={"cycle_timeout_s": 0.02})
        self.nodes.config = config.model_copy(update={"safety": safety})
        self.link = Answering(self.nodes)
        self.objects = OperatorObjects(config, lambda path: 3.0, lambda path: True)
        self.exchange = Exchange(self.nodes, self.link, self.objects.store)

    def silence(self, *parts: str) -> None:
        self.link.missing |= {pdo.cob_id for part in parts for pdo in self.nodes.pdo_maps(part)}


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.master.close()


def test_outputs_go_out_by_name_before_sync_and_inputs_are_the_answers_to_it(bench: Bench) -> None:
    for _ in range(2):
        inputs = bench.exchange.cycle(OUTPUTS)
    sample = sample_of_two_axes()
    inputs.fill(sample)
    sent = [frame.can_id for frame in bench.link.sent]
    rpdos = [bench.nodes.pdo_maps(part)[0] for part in ("axis1", "axis2", "load")]
    assert all(sent.index(pdo.cob_id) < sent.index(SYNC) for pdo in rpdos)
    velocity = next(frame.data for frame in reversed(bench.link.sent) if frame.can_id == rpdos[0].cob_id)
    assert rpdos[0].unpack(velocity)[-1] != 0
    axis = bench.nodes.axes[0]
    assert sample.x1_m == pytest.approx(7 * axis.units.position_rad / 25.0)
    assert inputs.ages_cycles == (0, 0, 0)
    assert not inputs.axes_late


def test_a_request_to_the_bench_is_answered_with_the_next_cycle(bench: Bench) -> None:
    bench.link.further = [Frame(0x67F, bytes.fromhex("4000220100000000"))]
    bench.exchange.cycle(OUTPUTS)
    assert 0x5FF not in [frame.can_id for frame in bench.link.sent]
    bench.exchange.cycle(OUTPUTS)
    sent = [frame.can_id for frame in bench.link.sent]
    assert sent.count(0x5FF) == 1
    assert sent.index(0x5FF) < len(sent) - 1 - sent[::-1].index(SYNC)


def test_a_drive_that_is_silent_is_a_fault_and_a_twin_that_is_none_is_not_waited_for_again(bench: Bench) -> None:
    bench.silence("virtual_io")
    bench.exchange.cycle(OUTPUTS)
    assert bench.exchange.silent == {TWIN}
    bench.exchange.expect_all(twin_since=1)
    assert bench.exchange.silent == set()
    bench.exchange.expect_drives()
    bench.exchange.cycle(OUTPUTS)
    assert bench.exchange.silent == set()
    bench.silence("axis2")
    with pytest.raises(NoAnswerError, match="axis2"):
        bench.exchange.cycle(OUTPUTS)


def test_while_drives_are_stopped_one_that_is_silent_keeps_none_of_the_others(bench: Bench) -> None:
    bench.exchange.expect_drives(vital=False)
    bench.silence("axis2", "virtual_io")
    bench.exchange.cycle(OUTPUTS)
    assert bench.exchange.silent == {bench.nodes.sender(bench.nodes.axes[1])}
    bench.exchange.expect_nobody()
    bench.silence("axis1", "load")
    bench.exchange.sync_only()


def test_what_a_stranger_has_sent_is_known_with_the_fault_of_a_drive_and_forgotten_in_the_next_cycle(
    bench: Bench,
) -> None:
    bench.exchange.cycle(OUTPUTS)
    pdo = bench.nodes.pdo_maps("axis1")[1]
    bench.link.further = [Frame(pdo.cob_id, pdo.pack([ENABLED, 1, 1]))]
    bench.link.statusword = FAULT
    with pytest.raises(BenchFaultError):
        bench.exchange.cycle(OUTPUTS)
    assert [found.about for found in bench.exchange.unexpected_frames] == [bench.nodes.sender(bench.nodes.axes[0])]
    bench.silence("axis1")
    with pytest.raises(NoAnswerError):
        bench.exchange.cycle(OUTPUTS)
    assert not bench.exchange.unexpected_frames


@pytest.mark.parametrize("command", [1, 2, 128, 129, 130])
@pytest.mark.parametrize("where", ["before SYNC", "behind SYNC"])
def test_an_nmt_command_of_somebody_else_is_known_where_the_node_answers_no_more(
    bench: Bench, command: int, where: str
) -> None:
    bench.exchange.cycle(OUTPUTS)
    nmt = Frame(0x000, bytes((command, 1)))
    if where == "before SYNC":
        bench.link.waiting.append(nmt)
    else:
        bench.link.further = [nmt]
    bench.silence("axis1")
    with pytest.raises(NoAnswerError, match="axis1"):
        bench.exchange.cycle(OUTPUTS)
    (found,) = bench.exchange.unexpected_frames
    assert (found.about, found.certain) == (bench.nodes.sender(bench.nodes.axes[0]), True)
    assert found.text.startswith("NMT '")


def test_an_nmt_command_of_somebody_else_beside_the_benchs_own_is_known_while_the_twin_comes_back(
    bench: Bench,
) -> None:
    bench.exchange.cycle(OUTPUTS)
    bench.master.nmt(NmtCommand.RESET_NODE, 32)
    bench.link.waiting += [Frame(0x000, bytes((129, 32))), Frame(0x000, bytes((2, 1)))]
    bench.exchange.discard_waiting()
    bench.exchange.cycle(OUTPUTS)
    assert [found.text for found in bench.exchange.unexpected_frames] == ["NMT 'stop' that the bench has not sent"]
    bench.link.further = [Frame(0x000, bytes((129, 32)))]  # the bench has sent that only once
    bench.exchange.cycle(OUTPUTS)
    assert [found.about for found in bench.exchange.unexpected_frames] == [TWIN]


@pytest.mark.parametrize("between", [200, 4050])
def test_what_the_bench_sends_again_to_a_twin_that_comes_back_is_its_own(between: int) -> None:
    sent = SentFrames()
    again = [(0x620, bytes((0x2B, number, 0x14, 1, 0, 0, 0, 0))) for number in range(40)]
    for can_id, data in again:  # configured at the start, and heard by nobody
        sent.add(can_id, data)
    for number in range(between):
        sent.add(0x601, number.to_bytes(8, "little"))
    for can_id, data in again:
        sent.add(can_id, data)
    for number in range(40):
        sent.add(0x602, number.to_bytes(8, "little"))
    assert all(sent.take(can_id, data) for can_id, data in again)


@pytest.mark.parametrize("every", [1, 5])
def test_a_twin_that_is_back_and_works_off_what_it_has_missed_is_no_second_sender(every: int) -> None:
    tpdo = Tpdo(0x1A0, 2, every, TWIN)
    tpdo.supervise(False)
    tpdo.supervise(True)
    surplus = []
    for cycle in range(400):
        tpdo.begin()
        foreign = cycle == 300
        for place in range(3 if (cycle < 60 and cycle % 4 == 3) or foreign else int(cycle % every == 0)):
            tpdo.add(bytes((cycle % 256, place)), before_sync=False)
        tpdo.end(0)
        surplus += [cycle] * bool(tpdo.surplus)
    assert surplus == [300]
