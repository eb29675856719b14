"""The bench by the wall clock: lateness of SYNC beside a bare timer loop, who needs how much of a cycle."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lockstep_profile import cpu_s, pids_of

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.startup import sync_producer, wire_first
from hilbench.can.load import CyclicFrame, cycle_load
from hilbench.can.open import open_link, open_python_can
from hilbench.canopen.identifiers import SYNC, NmtCommand
from hilbench.canopen.master import Master
from hilbench.canopen.object_store import ObjectStore
from hilbench.cia402.drive import DriveGoal
from hilbench.errors import BenchFaultError
from hilbench.exchange.addressing import dictionary_of
from hilbench.exchange.exchange import Exchange
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.pacing import Pacing
from hilbench.processes import ChildProcess
from hilbench.real_time import ProcessSettings, kept_ready
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import write_resolved
from performance.drives_alone import drives_alone
from performance.table import Section

_PATIENCE_CYCLES = 10_000
_FAST_S = 0.001
#: What was said while drives were configured waits in the hub for who has not read it, and is taken within this time.
_SAID_BEFORE_S = 1.0
_PRIORITY = 20
#: In a process of its own, as the bench is.
_BARE_LOOP = """
import json, os, sys
from hilbench.exchange.pacing import bare_loop
cycle_ns, cycles, priority = map(int, sys.argv[1:])
if priority:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
state = bare_loop(cycle_ns, cycles)
print(json.dumps([state.lateness_ns.tolist(), state.missed]))
"""


def measure(config_path: Path, seconds: float) -> list[Section]:
    """The whole bench at the config's cycle, without a priority and, where that is permitted, with one."""
    config = _patient(config_path)
    return [_whole_bench(each, seconds) for each in (config, *_with_priority(config))]


def measure_fast(config_path: Path, seconds: float) -> list[Section]:
    """Three drives at 1 ms, with a priority where that is permitted: each with the PDOs that a bench maps, and each
    with one TPDO, which leaves the wire free for as long as the drives need to answer."""
    config = _patient(config_path)
    config = next(iter(_with_priority(config)), config)
    return [_three_drives(config, seconds, velocity=velocity) for velocity in (True, False)]


def _patient(config_path: Path) -> BenchConfig:
    """On a machine that others use as well answers stay away; what is measured here is when SYNC goes out."""
    config = load_with_overrides(config_path, bus=f"embedded:jitter{os.getpid()}", pace="realtime").config
    patient = config.safety.model_copy(update={"missing_cycles": _PATIENCE_CYCLES})
    return config.model_copy(update={"safety": patient})


def _with_priority(config: BenchConfig) -> list[BenchConfig]:
    """The config with a priority; none where that is not permitted."""
    first = config.model_copy(update={"realtime": config.realtime.model_copy(update={"priority": _PRIORITY})})
    return [first] if _may_come_first() else []


def _may_come_first() -> bool:
    told: list[str] = []
    with kept_ready(ProcessSettings(_PRIORITY, lock_memory=False), told.append):
        return not told


def _whole_bench(config: BenchConfig, seconds: float) -> Section:
    section = Section(
        f"Real time at {1e3 * config.cycle_time_s:g} ms{_priority_of(config)}",
        f"{seconds:g} s of the bench of the demo, enabled, at standstill, on {config.bus_address}: lateness of SYNC; a "
        "bare loop on the same deadlines half of that time before and half behind. Missed: cycles late by a whole "
        "period. Then who needs how much of a cycle, the wire among them.",
    )
    bare = [_bare(config, seconds / 2)]
    with Bench(config) as bench:
        bench.run(1.0)
        assert bench.exchange is not None
        pids = pids_of(bench)
        spent_s = {name: cpu_s(pid) for name, pid in pids.items()}
        timing = bench.exchange.timing
        bits, cycles = timing.bits, timing.cycles
        sent = _sent(section, bench.exchange.pacing, lambda: bench.run(seconds))
        bits, cycles = timing.bits - bits, timing.cycles - cycles
        used_us = {name: 1e6 * (cpu_s(pid) - spent_s[name]) / cycles for name, pid in pids.items()}
    _add_lateness(section, [*bare, _bare(config, seconds / 2)], sent)
    period_us = 1e6 * config.cycle_time_s
    for name, value in used_us.items():
        section.add(f"CPU of {name}", value, "µs per cycle", value / period_us, "the period")
    _add_wire(section, config, bits / cycles, Nodes(config).cyclic_frames())
    return section


def _priority_of(config: BenchConfig) -> str:
    return "" if config.realtime.priority is None else f", priority {config.realtime.priority}"


def _three_drives(config: BenchConfig, seconds: float, *, velocity: bool) -> Section:
    """The bench's own cyclic path and the simulated drives, without the twin: its PDOs don't fit into 1 ms as well."""
    config = config.model_copy(update={"cycle_time_s": _FAST_S})
    nodes = drives_alone(config, velocity=velocity)
    expected, drives = nodes.expected_pdos(), len(nodes.drives)
    section = Section(
        f"Real time at {1e3 * _FAST_S:g} ms{_priority_of(config)}, {len(expected)} TPDOs of {drives} drives",
        f"The same for {seconds:g} s of the cyclic path with {drives} simulated drives, enabled, "
        + ("each with the PDOs of the demo" if velocity else "each with one RPDO and one TPDO")
        + f", on {config.bus_address}; the twin's PDOs would need the rest of the wire.",
    )
    bare = [_bare(config, seconds / 2)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as resources:
        link = open_link(config.bus_address)
        resources.callback(link.close)
        _start_drives(config, nodes, {pdo.cob_id for pdo in expected}, Path(folder), resources)
        resources.enter_context(kept_ready(config.process_settings("bench"), print))
        wire_first(config)
        producer = sync_producer(config, link)
        if producer is not None:
            resources.callback(producer.close)
        said_before_s = time.monotonic() + _SAID_BEFORE_S
        while time.monotonic() < said_before_s:
            link.receive(0.02)
        exchange = Exchange(nodes, link, ObjectStore(dictionary_of(config.parts[0])), producer=producer)

        def run(duration_s: float = seconds) -> None:
            for _ in range(round(duration_s / _FAST_S)):
                exchange.cycle({})

        run(0.3)
        for drive in nodes.drives:
            drive.request(DriveGoal.ENABLED)
        run(1.0)
        timing = exchange.timing
        late, bits, cycles = timing.missing_pdos, timing.bits, timing.cycles
        sent = _sent(section, exchange.pacing, run)
        late, bits, cycles = timing.missing_pdos - late, timing.bits - bits, timing.cycles - cycles
    _add_lateness(section, [*bare, _bare(config, seconds / 2)], sent)
    section.add("answers that came too late", late, f"of {cycles * len(expected)} PDOs")
    on_wire = {
        SYNC,
        *(pdo.cob_id for pdo in expected),
        *(each for drive in nodes.drives for each in drive.rpdo_cob_ids),
    }
    _add_wire(section, config, bits / cycles, [frame for frame in nodes.cyclic_frames() if frame.can_id in on_wire])
    return section


def _start_drives(
    config: BenchConfig, nodes: Nodes, tpdos: Collection[int], folder: Path, resources: ExitStack
) -> None:
    """The simulated hardware, its drives configured as a bench does it but for other TPDOs, and started (NMT)."""
    write_resolved(config, folder / "config.yaml")
    words = ["hilbench.hardware", str(folder / "config.yaml"), "--pace", config.pace]
    child = ChildProcess("simulated hardware", words, folder / "hardware.log")
    resources.callback(child.end)
    with ExitStack() as configuring:
        master = Master(open_python_can(config.bus_address), config.master.sdo_timeout_s)
        configuring.callback(master.close)
        nodes.introduce(master)
        ids = [drive.settings.node_id for drive in nodes.drives]
        master.wait_for_boot(ids, config.master.boot_timeout_s, child.check)
        for drive in nodes.drives:
            drive.configure(master)
            for pdo in drive.pdos.tpdos:
                if pdo.cob_id not in tpdos:
                    master.disable_pdo(drive.settings.node_id, pdo.communication)
        for node_id in ids:
            master.nmt(NmtCommand.START, node_id)
            master.read(node_id, 0x1000)  # answered once it has started


def _add_wire(section: Section, config: BenchConfig, bits: float, frames: Sequence[CyclicFrame]) -> None:
    """How much of a period the wire was taken, and would be if every possible bit were stuffed."""
    period_us = 1e6 * config.cycle_time_s
    wire_us = bits / config.bus.bitrate * 1e6
    section.add("the wire, as measured", wire_us, "µs per cycle", wire_us / period_us, "the period")
    worst = cycle_load(frames, config.cycle_time_s, config.bus.bitrate)
    section.add("the wire, at worst", worst.fraction * period_us, "µs per cycle", worst.fraction, "the period")


@dataclass(frozen=True)
class _Lateness:
    """Of so many cycles, µs each; those that were skipped count as missed."""

    late_us: np.ndarray
    missed: int


def _sent(section: Section, pacing: Pacing, run: Callable[[], None]) -> _Lateness:
    """Of the SYNCs that go out while `run` runs."""
    first, missed_before = len(pacing.lateness_ns), pacing.missed
    try:
        run()
    except BenchFaultError as error:  # too little of the processor is left: the figures until then say how little
        section.how += f" The run ended early: {error}."
    return _Lateness(np.array(pacing.lateness_ns[first:]) / 1e3, pacing.missed - missed_before)


def _bare(config: BenchConfig, seconds: float) -> _Lateness:
    cycles = round(seconds * 1e9) // config.cycle_ns
    wanted = [config.cycle_ns, cycles, config.realtime.priority or 0]
    command = [sys.executable, "-c", _BARE_LOOP, *map(str, wanted)]
    lateness, missed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return _Lateness(np.array(lateness) / 1e3, int(missed))


def _add_lateness(section: Section, bare: Sequence[_Lateness], sent: _Lateness) -> None:
    floor_us = np.concatenate([loop.late_us for loop in bare])
    for name, share in (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9)):
        least, ours = float(np.percentile(floor_us, share)), float(np.percentile(sent.late_us, share))
        section.add(f"bare loop, {name}", least, "µs")
        section.add(f"bench, {name}", ours, "µs", ours / least, "bare loop")
    section.add("bare loop, missed", sum(loop.missed for loop in bare), f"of {len(floor_us)} cycles")
    section.add("bench, missed", sent.missed, f"of {len(sent.late_us)} cycles")
