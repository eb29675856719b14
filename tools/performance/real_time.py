"""The bench by the wall clock: lateness of SYNC beside a bare timer loop, who needs how much of a cycle."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lockstep_profile import cpu_s, pids_of

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.startup import start_children, sync_producer
from hilbench.can.frame import Frame
from hilbench.can.load import cycle_load
from hilbench.can.open import open_link
from hilbench.canopen.identifiers import HEARTBEAT, NMT, NmtCommand
from hilbench.errors import BenchFaultError
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.pacing import Pacing
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.real_time import ProcessSettings, kept_ready
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig
from performance.table import Section

_PATIENCE_CYCLES = 10_000
_FAST_S = 0.001
_BOOT_S = 60.0
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
    """The whole bench at the config's cycle, without a priority and, where that is permitted, with one; then three
    drives at 1 ms."""
    config = load_with_overrides(config_path, bus=f"embedded:jitter{os.getpid()}", pace="realtime").config
    # On a machine that others use as well answers stay away; what is measured here is when SYNC goes out.
    patient = config.safety.model_copy(update={"missing_cycles": _PATIENCE_CYCLES})
    config = config.model_copy(update={"safety": patient})
    if not _may_come_first():
        return [_whole_bench(config, seconds), _three_drives(config, seconds)]
    first = config.model_copy(update={"realtime": config.realtime.model_copy(update={"priority": _PRIORITY})})
    return [_whole_bench(config, seconds), _whole_bench(first, seconds), _three_drives(first, seconds)]


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
    wire_us = bits / cycles / config.bus.bitrate * 1e6
    section.add("the wire, as measured", wire_us, "µs per cycle", wire_us / period_us, "the period")
    worst = cycle_load(Nodes(config).cyclic_frames(), config.cycle_time_s, config.bus.bitrate)
    section.add("the wire, at worst", worst.fraction * period_us, "µs per cycle", worst.fraction, "the period")
    return section


def _priority_of(config: BenchConfig) -> str:
    return "" if config.realtime.priority is None else f", priority {config.realtime.priority}"


def _three_drives(config: BenchConfig, seconds: float) -> Section:
    """The bench's own cyclic path and the simulated drives; the PDO set of the whole demo does not fit into 1 ms."""
    section = Section(
        f"Real time at {1e3 * _FAST_S:g} ms{_priority_of(config)}",
        f"The same for {seconds:g} s of the cyclic path with three drives that answer, on {config.bus_address}; the "
        "PDOs of the whole demo need more than a cycle on the wire then.",
    )
    config = config.model_copy(update={"cycle_time_s": _FAST_S})
    nodes = Nodes(config)
    drives = {nodes.sender(drive) for drive in nodes.drives}
    bare = [_bare(config, seconds / 2)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as resources:
        link = open_link(config.bus_address)
        resources.callback(link.close)
        resources.enter_context(kept_ready(config.process_settings("bench"), print))
        producer = sync_producer(config, link)
        if producer is not None:
            resources.callback(producer.close)
        for child in start_children(config, Path(folder)):
            resources.callback(child.end)
        ids = [drive.settings.node_id for drive in nodes.drives]
        _wait_for_boot(link.receive, ids)
        link.send([Frame(NMT, NmtCommand.START.to(node_id)) for node_id in ids])
        exchange = SyncCycle(
            link,
            cycle_ns=config.cycle_ns,
            bitrate=config.bus.bitrate,
            lockstep=False,
            expected=[pdo for pdo in nodes.expected_pdos() if pdo.sender in drives],
            timeout_s=config.safety.cycle_timeout_s,
            missing_limit=_PATIENCE_CYCLES,
            producer=producer,
        )

        def run(duration_s: float = seconds) -> None:
            for _ in range(round(duration_s / _FAST_S)):
                setpoints = [frame for drive in nodes.drives for frame in drive.encode()]
                nodes.decode(exchange.exchange(setpoints), exchange.before_sync, exchange.gone_by)

        run(1.0)
        late = exchange.timing.missing_pdos
        sent = _sent(section, exchange.pacing, run)
        late = exchange.timing.missing_pdos - late
    _add_lateness(section, [*bare, _bare(config, seconds / 2)], sent)
    section.add("answers that came too late", late, "PDOs")
    return section


def _wait_for_boot(receive: Callable[[float], Sequence[Frame]], node_ids: Sequence[int]) -> None:
    """Raises TimeoutError when a node does not say boot-up."""
    missing = {HEARTBEAT + node_id for node_id in node_ids}
    deadline_s = time.monotonic() + _BOOT_S
    while missing:
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"no boot-up from {', '.join(f'{cob_id:03X}h' for cob_id in sorted(missing))}")
        missing -= {frame.can_id for frame in receive(0.1)}


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
