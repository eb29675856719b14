"""Simulated hardware by the clock, whose plain cycles are compiled, against the interpreted: the same answers, objects
and errors, whatever comes between. Its clock counts SYNCs here, so that both are at the same times."""

from __future__ import annotations

import threading
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import pytest
from tests.plain_runs import CONFIGS, download, objects_of

from hilbench.can.frame import Frame
from hilbench.can.open import open_link, open_python_can
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.identifiers import SDO_ANSWER, NmtCommand
from hilbench.canopen.master import Master
from hilbench.cia402.drive import DriveGoal
from hilbench.errors import BenchFaultError
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.hardware import simulation
from hilbench.plain.host import PlainHost
from hilbench.plain.rig_run import ClockedRigRun
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig

_CYCLE_NS = 2_000_000
_CYCLES = 140
_ENABLED_AT = 3
#: Until what somebody has sent has been taken.
_A_MOMENT_S = 0.05


class _Counts(MonotonicClock):
    """A SYNC is a cycle; none is missed as long as a test takes."""

    def __init__(self, stall_s: float = 0.0) -> None:
        super().__init__(stall_s=60.0)
        self._now_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        return self._now_ns

    def tick(self) -> None:
        super().tick()
        self._now_ns += _CYCLE_NS


@dataclass
class _Stand:
    """Drives that a bench has configured and started."""

    config: BenchConfig
    nodes: Nodes
    master: Master
    exchange: SyncCycle
    sent: Callable[[list[Frame]], list[Frame]] = field(default=lambda frames: frames)  #: what becomes of set points


@dataclass
class _Left:
    """What was said, by COB-ID, and what the objects are in the end; SYNCs that were answered on arrays."""

    said: dict[int, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    objects: list[object] = field(default_factory=list)
    compiled: int = 0
    ending: str = ""


Change = Callable[[_Stand], None]


def _writes(node_id: int, index: int, value: int, size: int) -> Change:
    def change(stand: _Stand) -> None:
        with closing(open_link(stand.config.bus_address)) as link:
            link.set_filters([(SDO_ANSWER + node_id, 0x7FF)])
            link.send([download(node_id, index, value, size)])
            assert link.receive(20.0)

    return change


def _becomes(sent: Callable[[list[Frame]], list[Frame]]) -> Change:
    def change(stand: _Stand) -> None:
        stand.sent = sent

    return change


def _asks_for(setpoint: float) -> Change:
    def change(stand: _Stand) -> None:
        for drive in stand.nodes.drives:
            drive.setpoint = setpoint

    return change


def _heads_for(goal: DriveGoal) -> Change:
    def change(stand: _Stand) -> None:
        for drive in stand.nodes.drives:
            drive.request(goal)

    return change


CHANGES = [
    _asks_for(0.3),
    _asks_for(-1.5),
    _becomes(lambda frames: frames[1:]),  # a set point stays away
    _becomes(lambda frames: []),
    _becomes(lambda frames: [*frames, *frames]),
    _becomes(lambda frames: frames[::-1]),
    _becomes(lambda frames: [*frames, Frame(0x6FF, b"abc"), Frame(0x701, b"\x05")]),
    _becomes(lambda frames: [frames[0]._replace(data=frames[0].data[:-1]), *frames[1:]]),  # too short
    _writes(2, 0x6072, 5, 2),  # hardly any torque
    _writes(1, 0x1017, 30, 2),  # heartbeats more often
    _writes(1, 0x2001, 0x7305, 2),  # it fails
    _writes(2, 0x6080, 1, 4),  # overspeed
    _heads_for(DriveGoal.QUICK_STOP),
    _heads_for(DriveGoal.DISABLED),
]


@contextmanager
def _hardware(config: BenchConfig, left: _Left, *, compiled: bool) -> Iterator[None]:
    stop, serve = threading.Event(), PlainHost.serve

    def counted(self: PlainHost, timeout_s: float) -> None:
        before = self._run._answers._cycles if isinstance(self._run, ClockedRigRun) else 0
        run = self._run
        serve(self, timeout_s)
        if isinstance(run, ClockedRigRun):
            left.compiled += run._answers._cycles - before

    with ExitStack() as resources:
        resources.enter_context(patch.object(simulation, "MonotonicClock", _Counts))
        resources.enter_context(patch.object(PlainHost, "serve", counted))
        hosted: HostedDevices = simulation.hardware(config)
        link = open_link(config.bus_address)
        resources.callback(link.close)
        host = DeviceHost(link, *hosted)
        plain = simulation.plain_host(host, link, hosted, config)
        assert plain is not None
        arguments = stop.is_set, plain.serve if compiled else None
        thread = threading.Thread(target=host.run, args=arguments, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join(10.0)
            plain.settle()
            left.objects = objects_of([hosted])


@contextmanager
def _stand(config: BenchConfig) -> Iterator[_Stand]:
    nodes = Nodes(config)
    theirs = {pdo.cob_id for drive in nodes.drives for _, pdo, _ in drive.pdos.tpdos}
    with ExitStack() as resources:
        link = open_link(config.bus_address)
        resources.callback(link.close)
        master = Master(open_python_can(config.bus_address), sdo_timeout_s=30.0)
        resources.callback(master.close)
        nodes.introduce(master)
        for drive in nodes.drives:
            drive.configure(master)
        for drive in nodes.drives:
            master.nmt(NmtCommand.START, drive.settings.node_id)
            master.read(drive.settings.node_id, 0x1000)  # answered once it has started
        while link.receive(_A_MOMENT_S):
            pass
        exchange = SyncCycle(
            link,
            cycle_ns=_CYCLE_NS,
            bitrate=config.bus.bitrate,
            lockstep=True,
            expected=[pdo for pdo in nodes.expected_pdos() if pdo.cob_id in theirs],
            timeout_s=20.0,
            missing_limit=1,
            heartbeat=(config.master.node_id, 50),
        )
        yield _Stand(config, nodes, master, exchange)


def _run(changes: Sequence[tuple[int, Change]], *, compiled: bool) -> _Left:
    bus = f"embedded:c{uuid.uuid4().hex[:10]}"
    path = CONFIGS / "web_section_step.yaml"
    config = load_with_overrides(path, bus=bus, pace="realtime").config
    left = _Left()
    with _bus_of(config), _hardware(config, left, compiled=compiled), _stand(config) as stand:
        nodes, exchange = stand.nodes, stand.exchange
        for cycle in range(_CYCLES):
            if cycle == _ENABLED_AT:
                _heads_for(DriveGoal.ENABLED)(stand)
            for at, change in changes:
                if at == cycle:
                    change(stand)
            came = exchange.exchange(stand.sent([frame for drive in nodes.drives for frame in drive.encode()]))
            for can_id, data, _ in came:
                left.said[can_id].append(data)
            frames = {frame.can_id: frame.data for frame in came}
            try:
                for drive in nodes.drives:
                    drive.decode(frames)
            except BenchFaultError as fault:
                left.ending = str(fault)
                break
    return left


def _bus_of(config: BenchConfig) -> ExitStack:
    """The bus is there, with the timing of its config."""
    resources = ExitStack()
    link = open_link(config.bus_address)
    link.set_filters([])
    resources.callback(link.close)
    return resources


def _check(changes: Sequence[tuple[int, Change]], least: int) -> None:
    compiled, interpreted = (_run(changes, compiled=each) for each in (True, False))
    assert compiled.compiled >= least
    assert interpreted.compiled == 0
    assert compiled.ending == interpreted.ending
    assert compiled.said == interpreted.said
    assert compiled.objects == interpreted.objects


def test_drives_answer_alike_with_set_points_and_a_limit() -> None:
    _check([(20, CHANGES[0]), (80, CHANGES[1]), (110, CHANGES[8])], 30)


def test_drives_answer_alike_when_set_points_stay_away_and_others_send() -> None:
    _check([(75, CHANGES[2]), (85, CHANGES[6]), (95, CHANGES[4]), (110, CHANGES[0])], 10)


@pytest.mark.slow
@pytest.mark.parametrize("change", range(len(CHANGES)))
def test_drives_answer_alike_with_each_change(change: int) -> None:
    _check([(90, CHANGES[change])], 20)
