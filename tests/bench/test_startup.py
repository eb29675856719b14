"""How a bench starts: beside simulated hardware that somebody else has started, and with several nodes at once."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from tests.bench.whole_runs import config
from tests.cia402.stand_in import served

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.startup import check_that_they_wait
from hilbench.can.memory import MemoryBus
from hilbench.can.open import open_link, starting
from hilbench.canopen.eds import load_eds
from hilbench.canopen.identifiers import NmtCommand
from hilbench.canopen.master import Master
from hilbench.canopen.pdo import PdoMap
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.hardware.simulation import hardware
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig


@contextmanager
def started(path: Path, pace: str) -> Iterator[tuple[BenchConfig, Master]]:
    """The config of a bench, and its master beside hardware of this pace, started (NMT)."""
    bus = MemoryBus()
    devices, clock, application = hardware(load_with_overrides(path, pace=pace).config)
    bench = load_with_overrides(path).config
    with served(bus.open_link(), devices, clock, application):
        master = Master(bus.open_python_can(), sdo_timeout_s=5.0)
        try:
            for part in bench.parts:
                if part.is_simulated:
                    node_id = part.node.node_id
                    master.add(node_id, load_eds(part.node.eds, node_id), part.name)
                    master.sdo_write(node_id, 0x1017, bench.master.node_heartbeat_ms)
            master.nmt(NmtCommand.START)
            master.responding_within(0.1)
            yield bench, master
            master.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        finally:
            master.close()


def test_hardware_that_goes_by_the_clock_is_refused_by_name(tmp_path: Path) -> None:
    with started(config(tmp_path), "realtime") as (bench, master):
        with pytest.raises(UnusableInputError, match=r"axis1 \(node 1\), axis2 \(node 2\).* went by the clock") as said:
            check_that_they_wait(bench, master)
        assert "--pace lockstep" in str(said.value)


def test_hardware_that_waits_for_sync_is_taken(tmp_path: Path) -> None:
    with started(config(tmp_path), "lockstep") as (bench, master):
        check_that_they_wait(bench, master)


def test_nodes_are_configured_beside_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is held up until the others are being configured as well: one after the other they would never be done."""
    bench = load_with_overrides(config(tmp_path)).config
    ids = {part.node.node_id for part in bench.parts}
    drives, of_twin = ids - bench.virtual_nodes.keys(), ids & bench.virtual_nodes.keys()
    met = {
        node_id: together
        for each in (drives, of_twin)
        for together in [threading.Barrier(len(each))]
        for node_id in each
    }
    write, begun = Master.write_pdo, set[int]()

    def write_once_all_are_there(master: Master, node_id: int, pdo: PdoMap) -> None:
        if node_id not in begun:
            begun.add(node_id)
            met[node_id].wait(10.0)
        write(master, node_id, pdo)

    monkeypatch.setattr(Master, "write_pdo", write_once_all_are_there)
    with Bench(bench) as running:
        running.run(0.1)
    assert begun == ids


def test_the_first_node_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(master: Master, node_id: int, pdo: PdoMap) -> None:
        raise BenchFaultError(f"node {node_id} refuses")

    monkeypatch.setattr(Master, "write_pdo", refuse)
    with pytest.raises(BenchFaultError, match="node 1 refuses"), Bench(load_with_overrides(config(tmp_path)).config):
        pass


def test_a_bus_that_nobody_has_joined_yet_goes_as_the_first_one_says(tmp_path: Path) -> None:
    """A bench lets the hub start before it joins: drives that are not there are missing, not at another pace."""
    bus = load_with_overrides(config(tmp_path), bus=f"embedded:alone{os.getpid()}").config.bus_address
    assert bus.timing == "virtual"
    with starting(bus):
        assert bus.as_it_runs() == bus
        with closing(open_link(replace(bus, timing="real"))):
            assert bus.as_it_runs().timing == "real"
