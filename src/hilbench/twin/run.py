"""Process of the twin of a bench config."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.clock import SyncClock
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.master_guard import nodes_of_ours
from hilbench.fast_path.host import FastPathHost, PacketRun, run_devices, warm_up_packets
from hilbench.fast_path.host_cycle import SyncAnswers
from hilbench.processes import log, started_by_bench, stop_request
from hilbench.topology.config import BenchConfig
from hilbench.twin.fast_path_run import TwinFastCycle
from hilbench.twin.machines.kinds import warm_up
from hilbench.twin.process import TwinApplication, twin


def run(config: BenchConfig) -> int | None:
    """Run virtual axes, virtual I/O and synchronizer until SIGTERM, SIGINT or the end of the bench.

    Returns the number of frames lost because they were not read in time (None: unknown on this bus). Raises
    UnusableInputError when a node with one of their ids is there already.
    """
    stop = stop_request()
    with nodes_of_ours(config.bus_address, config.virtual_nodes, "twin", by_bench=started_by_bench()):
        hosted = twin(config)
        fast_path = partial(fast_path_host, hosted=hosted)
        return run_devices(config.bus_address, hosted, fast_path, config.process_settings("twin"), stop, log)


def load(config: BenchConfig) -> None:
    """Compile, or load, the functions of the twin of a bench on the embedded bus."""
    warm_up(config.machine, config.twin, config.shape, config.cycle_time_s)
    if config.pace == "lockstep":
        warm_up_packets()


def fast_path_host(host: DeviceHost, link: Link, hosted: HostedDevices) -> FastPathHost | None:
    """Fast-path host of the twin's devices on the embedded bus in lockstep, else None."""
    devices, clock, application = hosted.devices, hosted.clock, hosted.application
    if not isinstance(link, EmbeddedLink) or not isinstance(clock, SyncClock):
        return None
    assert isinstance(application, TwinApplication), "as `twin` makes it"
    drives = application.drives

    def begin(expected: Sequence[Frame]) -> PacketRun:
        cycle_ns = round(application.cycle_s * 1e9)
        return TwinFastCycle(SyncAnswers(link, devices, drives, clock, expected, cycle_ns), application)

    return FastPathHost(host, link, application, begin)
