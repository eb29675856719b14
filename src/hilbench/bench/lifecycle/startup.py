"""Start-up to nodes that answer SYNC: processes, boot-up, configuration, NMT start."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from hilbench.bench.lifecycle.idle import meanwhile
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.lifecycle.supervisor import Watch
from hilbench.can import hub_client
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.link import Link, PacketLink
from hilbench.can.open import open_link, open_python_can, starting
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.canopen.identifiers import NmtCommand
from hilbench.canopen.master import Master
from hilbench.canopen.master_guard import mastery
from hilbench.canopen.object_store import ObjectStore
from hilbench.canopen.sdo_client import SentFrames
from hilbench.errors import BusError, EmergencyStopError, UnusableInputError
from hilbench.exchange.addressing import dictionary_of
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.frame_tap import FrameTap, LineTap
from hilbench.exchange.node_data import FILE, ask_all, stand_data
from hilbench.exchange.nodes import ForEachNode, Nodes
from hilbench.exchange.sync_producer import SyncProducer
from hilbench.forked_workers import ForkedWorker, Preparation, forked_workers
from hilbench.processes import ChildProcess
from hilbench.real_time import comes_first, kept_ready
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import remember, write_resolved
from hilbench.twin.machines.kinds import warm_up

if TYPE_CHECKING:
    from hilbench.bench.lifecycle.in_process import InProcess
    from hilbench.exchange.master_node import MasterNode
    from hilbench.exchange.sync_cycle import SyncCycle
    from hilbench.fast_path.exchange import FastPathExchange

#: Heartbeat periods within which a node that does not wait for SYNC surely sends one.
_HEARTBEATS_TO_WAIT = 1.5
#: Poll period of the bus reader while the nodes are configured: woken by each frame it would take from
#: the transfers as much time of the interpreter as they need.
_LOOKS_S = 0.001
#: Time for a reset to be taken: a heartbeat from before it that is still under way is no boot-up.
_RESET_S = 0.05
#: Time for the last command to come back from the bus: it belongs in the trace.
_LAST_FRAME_S = 0.1
_EXPECTED = "expected simulate-hardware and twin that were started with --pace "
#: Names of the processes started with a bench.
TWIN, _HARDWARE, _SUPERVISOR = "twin", "simulated hardware", "supervisor"


@dataclass
class StartedBench:
    """Parts of a bench whose nodes are operational."""

    nodes: Nodes
    exchange: Exchange
    children: list[ChildProcess]
    supervisor: ChildProcess | None  #: None when there is no heartbeat to watch
    warnings: list[str]  #: requests of the config to the operating system that are not permitted


@contextmanager
def held_bus(config: BenchConfig, participants: Participants, *, force: bool = False) -> Iterator[None]:
    """Hold the bus of a bench as its only master; a bus inside the process is not shared anyway.

    Raises UnusableInputError when it has another master (`force`: ignores one that is only received, not a program of
    this machine that claims it), or when a node to be started is already provided.
    """
    if participants is Participants.IN_PROCESS:
        yield
        return
    brings = config.simulated_drives | config.virtual_nodes if participants is Participants.STARTED else {}
    bus = config.bus_address
    with (
        mastery(bus, config.master.node_id, f"bench {config.name}", brings=brings, despite_heard=force),
        starting(bus),
    ):
        yield


@contextmanager
def bring_up(
    config: BenchConfig,
    *,
    objects: ObjectStore,
    tap: FrameTap | None,
    work_folder: Path | None,
    participants: Participants,
    announce: Callable[[str], None],
    forked_workers: dict[str, ForkedWorker],
) -> Iterator[StartedBench]:
    """Start the simulated hardware and the twin (unless they run already), configure the nodes, start them (NMT).

    `objects`: those of the bench's own node. `forked_workers`: taken for processes, as far as they go. All is ended
    again on leaving. Raises BenchFaultError when a process ends, a node does not answer, or refuses what it is sent.
    """
    with ExitStack() as resources:
        folder = work_folder or Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="hilbench-")))
        nodes = Nodes(config)
        if participants is Participants.PRESENT:
            _check_timing(config)
        here = _in_process(config) if participants is Participants.IN_PROCESS else None
        inside = here.open_link() if here else None
        link = resources.enter_context(closing(inside or open_link(config.bus_address)))
        bus = here.open_python_can() if here else open_python_can(config.bus_address)
        master = resources.enter_context(Master(bus, config.master.sdo_timeout_s))
        nodes.introduce(master)
        with _watched(link, tap, master.sent):
            children: list[ChildProcess] = []
            supervisor = None
            if here:
                announce("boot simulated hardware and twin")
                here.boot()
            elif participants is Participants.STARTED:
                announce("start simulated hardware and twin")
                children = start_children(config, folder, forked_workers)
            else:
                announce("look for simulated hardware and twin")
            for child in children:
                resources.callback(child.end)
            if not here:  # what ends this process ends the devices with it
                supervisor = _start_supervisor(config, folder, forked_workers)
            if supervisor is not None:
                resources.callback(supervisor.end)
            fast_path = None if here else _fast_path_cycles(config, link, nodes, tap)  # loaded while they start
            announce("configure nodes")
            found = _configure(config, nodes, master, children, participants)
            brought = {} if participants is Participants.PRESENT else config.simulated_drives
            stand_data(config, found, master.written, started=brought).write(folder / FILE)
            master.nmt(NmtCommand.START)
            for part in config.parts:  # once it answers all frames sent before have come, and its clock waits for SYNC
                master.read(part.node.node_id, 0x1000)
            if participants is Participants.PRESENT:
                check_that_they_wait(config, master)
            master.receive_only_answers()
        warnings: list[str] = []
        resources.enter_context(kept_ready(config.process_settings("bench"), warnings.append))
        if not here:
            warnings += wire_first(config)
        producer = None if here else sync_producer(config, link)
        exchange = Exchange(nodes, link, objects, tap=tap, in_process=here is not None, producer=producer)
        if here and inside:
            exchange.use(here.fast_path_cycles(inside, nodes, tap))
        elif fast_path is not None:
            exchange.use(fast_path)
        resources.callback(_release_nodes, master, exchange)
        if producer is not None:
            resources.callback(producer.close)
        yield StartedBench(nodes, exchange, children, supervisor, warnings)


def _fast_path_cycles(
    config: BenchConfig, link: Link, nodes: Nodes, tap: FrameTap | None
) -> Callable[[SyncCycle, MasterNode], FastPathExchange] | None:
    """Factory of the fast path on the embedded bus, with its functions loaded. None in real
    time, on other buses or for a tap that takes no text."""
    lockstep = config.pace == "lockstep"
    if not lockstep or not isinstance(link, EmbeddedLink) or not (tap is None or isinstance(tap, LineTap)):
        return None
    from hilbench.fast_path.exchange import FastPathExchange  # machine code, which other benches do without

    FastPathExchange.warm_up()
    return partial(FastPathExchange, link, nodes, tap=tap)


def wire_first(config: BenchConfig) -> list[str]:
    """Give the hub of an embedded bus a higher priority than the bench's where that has one; returns the errors
    of doing so."""
    settings, bus = config.process_settings("bench"), config.bus_address
    if settings is None or settings.priority is None or bus.interface != "embedded":
        return []
    try:
        hub_client.set_priority(bus.channel, min(settings.priority + 1, os.sched_get_priority_max(os.SCHED_FIFO)))
    except BusError as error:
        return [str(error)]
    return []


def sync_producer(config: BenchConfig, link: Link) -> SyncProducer | None:
    """Sender of SYNC by the clock, over a connection of its own; None: the bench itself, in lockstep, on an interface
    that takes frames through Python only, and without a priority.

    A bench without a priority would itself be delayed so that most of its SYNCs had gone by, and control with them:
    rather its cycles become longer.
    """
    if config.pace == "lockstep" or not isinstance(link, PacketLink) or not comes_first():
        return None
    own = open_link(config.bus_address)
    assert isinstance(own, PacketLink)
    return SyncProducer(own, config.cycle_ns)


def _check_timing(config: BenchConfig) -> None:
    """An embedded bus has the timing of the pace for which its first station was started."""
    address = config.bus_address
    running = address.as_it_runs().timing
    if running != address.timing:
        found = "by the clock" if running == "real" else "by SYNC"
        raise UnusableInputError(
            "pace", f"{config.pace}, but who is on {address} goes {found}: {_EXPECTED}{config.pace}"
        )


def check_that_they_wait(config: BenchConfig, master: Master) -> None:
    """Check in lockstep that simulated hardware and twin started by another program wait for SYNC.

    Those that do send nothing by time between NMT start and the first SYNC. Raises UnusableInputError naming the
    senders of a heartbeat in it; no node is left OPERATIONAL then.
    """
    if config.pace != "lockstep":
        return
    received = master.responding_within(_HEARTBEATS_TO_WAIT * config.master.node_heartbeat_ms * 1e-3)
    by_clock = [
        f"{part.label} (node {part.node.node_id})"
        for part in config.parts
        if part.is_ours and part.node.node_id in received
    ]
    if by_clock:
        master.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        raise UnusableInputError(
            "pace",
            f"lockstep, but {', '.join(by_clock)} went by the clock: {_EXPECTED}lockstep",
        )


def _release_nodes(master: Master, exchange: Exchange) -> None:
    """Leave the nodes in PRE-OPERATIONAL; on a bus that was lost they are on their own."""
    with suppress(BusError):
        exchange.discard_waiting()
        master.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        exchange.discard_waiting(_LAST_FRAME_S)


def _in_process(config: BenchConfig) -> InProcess:
    from hilbench.bench.lifecycle.in_process import InProcess  # what a bench with processes need not load

    return InProcess(config)


@contextmanager
def copies_beside(config: BenchConfig, participants: Participants) -> Iterator[dict[str, ForkedWorker]]:
    """Copies of this process for the processes that `bring_up` starts, by name: the earlier they are made, the more
    they have loaded by then. One that is not taken ends on leaving."""
    with suppress(UnusableInputError):  # the bench reports it
        for part in config.parts:  # once, here, and not in each of them
            dictionary_of(part)
    with forked_workers(_processes_beside(config, participants)) as waiting:
        yield waiting


def _processes_beside(config: BenchConfig, participants: Participants) -> dict[str, Preparation]:
    """Processes that `bring_up` starts, by name, with the preparation that a copy of this process runs for each."""
    beside: dict[str, Preparation] = {}
    if participants is Participants.STARTED:
        if config.simulated_drives:
            beside[_HARDWARE] = partial(_load, "hilbench.hardware.simulation", config)
        beside[TWIN] = partial(_load, "hilbench.twin.run", config)
    if participants is not Participants.IN_PROCESS and config.master.heartbeat_ms:
        beside[_SUPERVISOR] = lambda: None
    return beside


def _load(module: str, config: BenchConfig) -> None:
    """Load what a process runs, which the bench itself need not."""
    remember(config)
    import_module(module).load(config)


def start_children(
    config: BenchConfig, folder: Path, forked_workers: dict[str, ForkedWorker] | None = None
) -> list[ChildProcess]:
    """Start the simulated hardware, where a node is simulated, and the twin; their logs go to `folder`."""
    waiting = {} if forked_workers is None else forked_workers
    if TWIN not in waiting:
        # Once, into the cache on disk: compiling takes longer than a process has to show itself on the bus.
        warm_up(config.machine, config.twin, config.shape, config.cycle_time_s)
    path = folder / "config.yaml"
    write_resolved(config, path)
    arguments = [str(path), "--pace", config.pace]
    children = []
    if config.simulated_drives:
        hardware = ["hilbench.hardware", *arguments]
        copy = waiting.pop(_HARDWARE, None)
        children.append(ChildProcess(_HARDWARE, hardware, folder / "hardware.log", copy=copy))
    twin = ["hilbench.twin", *arguments]
    children.append(ChildProcess(TWIN, twin, folder / "twin.log", copy=waiting.pop(TWIN, None)))
    return children


def _start_supervisor(
    config: BenchConfig, folder: Path, forked_workers: dict[str, ForkedWorker]
) -> ChildProcess | None:
    if not config.master.heartbeat_ms:
        return None
    # In lockstep the bench waits for its participants, and no heartbeat comes meanwhile.
    patience_s = config.safety.cycle_timeout_s if config.pace == "lockstep" else 0.0
    watch = Watch(config.bus_address, config.master.node_id, patience_s + config.safety.supervisor_timeout_s)
    return ChildProcess(
        _SUPERVISOR, watch.arguments(), folder / "supervisor.log", copy=forked_workers.pop(_SUPERVISOR, None)
    )


def _configure(
    config: BenchConfig, nodes: Nodes, master: Master, children: list[ChildProcess], participants: Participants
) -> dict[str, dict[tuple[int, int], bytes | None]]:
    """Configure each node once it has booted: drives first, while the twin loads; returns their objects before it."""
    # From its reset on the state of a node that is there already is known.
    present = participants is Participants.PRESENT
    there = {part.node.node_id for part in config.parts if present or not part.is_ours}
    for node_id in sorted(there):
        master.nmt(NmtCommand.RESET_NODE, node_id)
    if there:
        time.sleep(_RESET_S)

    def check() -> None:
        for child in children:
            child.check()

    def wait_until_prepared(name: str) -> None:
        """Wait for a process that may have to compile first, for longer than a node has to boot."""
        for child in children:
            if child.name == name:
                child.wait_until_prepared()

    timeout_s, twin = config.master.boot_timeout_s, list(config.virtual_nodes)
    drives = [part.node.node_id for part in config.parts if part.node.node_id not in twin]
    wait_until_prepared(_HARDWARE)
    master.wait_for_boot(drives, timeout_s, check, beside=twin)
    with _beside_each_other(len(config.parts), participants) as for_each_node:
        found = ask_all(master, config, for_each_node)
        nodes.configure_drives(master, for_each_node)
        wait_until_prepared(TWIN)
        master.wait_for_boot(twin, timeout_s, check)
        nodes.configure_twin(master, for_each_node)
    return found


@contextmanager
def _beside_each_other(most: int, participants: Participants) -> Iterator[ForEachNode]:
    """Map for SDO transfers to several nodes in parallel; serial in one process, where an answer is immediate."""
    if participants is Participants.IN_PROCESS:
        yield map
        return
    with ThreadPoolExecutor(most, "configuration") as threads:
        yield threads.map


@contextmanager
def _watched(link: Link, tap: FrameTap | None, sent: SentFrames) -> Iterator[None]:
    """Hand the frames of the configuration to the tap while the master is sending; `sent` records them."""
    failures: list[BaseException] = []

    def take(frames: list[Frame]) -> None:
        if any(frame.can_id == EMERGENCY_STOP_COB_ID for frame in frames):
            failures.append(EmergencyStopError("emergency stop (COB-ID 001h) on the bus during the start"))
        for frame in frames:
            sent.take(frame.can_id, frame.data)
        if frames and tap is not None:
            now_ns = time.time_ns()
            tap.write([frame._replace(time_ns=now_ns) for frame in frames])
            tap.end_cycle()

    def drain() -> None:
        try:
            take(link.receive(0.0))
        except BaseException as error:  # handed to the thread that waits for us
            failures.append(error)

    try:
        with meanwhile(drain, _LOOKS_S, "configuration-trace"):
            yield
    finally:
        drain()
    if failures:
        raise failures[0]
