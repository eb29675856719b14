"""Plain cycles of bench, hardware and twin on the embedded bus (`hilbench.fast_path`) against the interpreted ones: the
same samples, frames, objects and endings, bit by bit, whatever comes between."""

from __future__ import annotations

import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, given, settings
from tests.bench.whole_runs import frames_by_cycle
from tests.fast_path_runs import (
    CONFIGS,
    OPTIONS,
    Change,
    How,
    Samples,
    between,
    chained_as,
    ending_of,
    events_on_a_line,
    notices_of,
    objects_of,
    sets,
)

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.can import hub_client
from hilbench.can.frame import Frame
from hilbench.can.open import open_link
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.fast_path.exchange import FastPathExchange, PacketCycle
from hilbench.fast_path.host import FastPathHost
from hilbench.fast_path.host_cycle import RigFastCycle
from hilbench.hardware.simulation import fast_path_host, hardware
from hilbench.results.trace import TraceWriter
from hilbench.runs.config import load_with_overrides
from hilbench.twin.fast_path_run import TwinFastCycle
from hilbench.twin.process import twin
from hilbench.twin.run import fast_path_host as twins_plain_host

#: Errors after which SYNC goes on without waiting for every drive: how far the drives come until they are at rest
#: depends on who is faster, interpreted, too. `tests/in_process_cycle` has them in one process.
STOPPED_UNFOLLOWED = ("NoAnswerError", "EmergencyStopError")
#: Until what somebody has sent is answered, and the answer is there.
A_MOMENT_S = 0.05


@dataclass
class Left:
    """What a run left behind."""

    fast_path: int = 0  #: cycles of the bench
    chained: int = 0  #: those of them that went without Python
    of_hosts: Counter[type] = field(default_factory=Counter)  #: SYNCs that hardware and twin have answered on arrays
    samples: list[bytes] = field(default_factory=list)
    notices: list[tuple[float, str, str, int]] = field(default_factory=list)
    trace: list[Counter[str]] = field(default_factory=list)
    objects: list[object] = field(default_factory=list)
    ending: str = ""


@contextmanager
def served(loaded: Any, *, compiled: bool) -> Iterator[list[HostedDevices]]:
    """Hardware and twin on the embedded bus, each in a thread of its own."""
    config, stop = loaded.config, threading.Event()
    all_hosted = [hardware(config), twin(config)]
    links = [open_link(config.bus_address) for _ in all_hosted]
    threads = []
    for hosted, link in zip(all_hosted, links, strict=True):
        host = DeviceHost(link, *hosted)
        of_twin = hosted is all_hosted[1]
        fast = twins_plain_host(host, link, hosted) if of_twin else fast_path_host(host, link, hosted, config)
        arguments = (stop.is_set, fast.serve if compiled and fast is not None else None)
        threads.append(threading.Thread(target=host.run, args=arguments, daemon=True))
    try:
        for thread in threads:
            thread.start()
        yield all_hosted
    finally:
        stop.set()
        for thread in threads:
            thread.join(10.0)
        for link in links:
            link.close()


def run(folder: Path, loaded: Any, changes: Sequence[tuple[int, Change]], cycles: int, how: How) -> Left:
    """A bench that runs for so many cycles, with what is done in between, by cycle."""
    left, samples, compiled = Left(), Samples(), how is not How.INTERPRETED
    cycle, fast, serve = FastPathExchange.cycle, PacketCycle.cycle, FastPathHost.serve

    def compiled_or_not(self: FastPathExchange, outputs: Any) -> bool:
        return compiled and cycle(self, outputs)

    def counted(self: PacketCycle, outputs: Any) -> bool:
        done = fast(self, outputs)
        left.fast_path += done
        return done

    def counted_by_host(self: FastPathHost, timeout_s: float) -> None:
        serve(self, timeout_s)
        if isinstance(self._run, RigFastCycle | TwinFastCycle):
            kind, cycles = type(self._run), self._run._answers.cycles
            left.of_hosts[kind] = max(left.of_hosts[kind], cycles)

    trace = folder / f"trace-{uuid.uuid4().hex}.log"
    with (
        patch.object(FastPathExchange, "cycle", compiled_or_not),
        patch.object(PacketCycle, "cycle", counted),
        chained_as(how) as chained,
        patch.object(FastPathHost, "serve", counted_by_host),
        TraceWriter(trace, "can0") as tap,
        served(loaded, compiled=compiled) as all_hosted,
    ):
        bench = Bench(loaded.config, observers=[samples], tap=tap, participants=Participants.PRESENT)
        left.ending = ending_of(bench, cycles, changes, together=how is How.CHAINED)
    left.chained = chained()
    left.fast_path += left.chained
    left.samples = samples.kept
    left.notices = notices_of(bench)
    # While the drives are stopped nobody waits for the twin.
    left.trace = frames_by_cycle(trace)[: len(samples.kept) - 1]
    left.objects = objects_of(all_hosted)
    return left


def check(folder: Path, options: Sequence[str], changes: Sequence[tuple[int, Change]], **what: Any) -> Left:
    """All kinds of cycles make the same; `least`: so many of them are fast-path cycles at least, on each side; half as
    many are chained where they can be (`chains`)."""
    name, cycles, least = what.get("name", "web_section_step"), what.get("cycles", 150), what.get("least", 60)
    chain = what.get("chains", True)
    kinds = []
    for how in How:
        bus = f"embedded:p{uuid.uuid4().hex[:10]}"
        loaded = load_with_overrides(CONFIGS / f"{name}.yaml", changes=[f"bus.address={bus}", *options])
        kinds.append(run(folder, loaded, changes, cycles, how))
    reference, one_by_one, chained = kinds
    assert (reference.fast_path, reference.of_hosts.total()) == (0, 0)
    assert chained.chained >= least // 2 * chain
    for left in (one_by_one, chained):
        assert min(left.fast_path, left.of_hosts[RigFastCycle], left.of_hosts[TwinFastCycle]) >= least
        assert left.ending == reference.ending
        assert left.samples == reference.samples
        assert left.notices == reference.notices
        assert left.trace == reference.trace
        if not reference.ending.startswith(STOPPED_UNFOLLOWED):
            assert left.objects == reference.objects
    return chained


# -- what comes between ----------------------------------------------------------------------------------------------


def sends(*frames: Frame) -> Change:
    """Somebody else on the bus sends something, and goes."""

    def change(bench: Bench) -> None:
        bus = bench.config.bus_address
        with closing(open_link(bus)) as link:
            link.send(frames)
            hub_client.statistics(bus.channel)  # the hub has read them
            time.sleep(A_MOMENT_S)

    return change


#: Not a SYNC of somebody else, nor a virtual axis that starts anew: there it depends on who is faster what comes of it,
#: interpreted, too. `tests/in_process_cycle` has them in one process.
LINE = events_on_a_line(sends)
FRICTION, OVERSPEED, TORQUE_OFFSET = 3, 7, 10


@pytest.mark.slow
def test_a_line_runs_alike_with_set_points_an_effect_and_a_fault(tmp_path: Path) -> None:
    changes = [(10, LINE[0]), (30, LINE[2]), (50, LINE[FRICTION]), (120, LINE[TORQUE_OFFSET]), (200, LINE[OVERSPEED])]
    left = check(tmp_path, [], changes, cycles=240, least=50)
    assert "axis2 (node 2): is in FAULT" in left.ending


@pytest.mark.slow
@given(changes=between(LINE), options=OPTIONS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_line_runs_alike_whatever_comes_between(
    tmp_path: Path, changes: list[tuple[int, Change]], options: list[str]
) -> None:
    check(tmp_path, options, changes, least=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "path", "options"),
    [
        ("line_three_spans", "line_speed_m_s", []),
        ("line_with_dancer", "line_speed_m_s", []),
        ("line_with_dancer", "line_speed_m_s", ["controllers.dancer_position.force={}"]),
        ("web_section_step_pid", "line_speed_m_s", []),
        ("servo_axis", "speed_rad_s", []),
    ],
)
def test_every_kind_of_bench_runs_alike(tmp_path: Path, name: str, path: str, options: list[str]) -> None:
    changes = [(10, sets(path, 0.05)), (80, sets(path, 0.1))]
    check(tmp_path, options, changes, name=name, chains=name != "line_with_dancer")  # its position loop is Python's
