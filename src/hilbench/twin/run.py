"""The twin of a bench config, as a process runs it."""

from __future__ import annotations

from hilbench.canopen.mastery import nodes_of_ours
from hilbench.processes import log, started_by_bench, stop_request
from hilbench.topology.config import BenchConfig
from hilbench.twin.process import run_twin
from hilbench.twin.setup import twin_setup


def run(config: BenchConfig) -> int | None:
    """Run virtual axes, virtual I/O and synchronizer until SIGTERM, SIGINT or the end of the bench.

    Returns how many frames were lost because they were not read in time (None: the bus cannot tell). Raises
    UnusableInputError when a node with one of their ids is there already.
    """
    stop = stop_request()
    with nodes_of_ours(config.bus_address, config.virtual_nodes, "twin", by_bench=started_by_bench()):
        return run_twin(twin_setup(config), stop, log)
