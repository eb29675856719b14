"""Runs whose fast-path and interpreted cycles are compared: what is done between cycles, and what a run leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hypothesis import strategies as st

from hilbench.bench.bench import Bench
from hilbench.bench.cycle import CompiledCycles
from hilbench.bench.tasks.task import CompiledStages
from hilbench.can.frame import Frame
from hilbench.canopen.host import HostedDevices
from hilbench.compiled import COUNT, TABLE, entry_point
from hilbench.cycle_program import CompiledStage
from hilbench.errors import HilbenchError
from hilbench.topology.sample import CycleSample

CONFIGS = Path(__file__).resolve().parents[1] / "bench_configs"
NMT, SDO = 0x000, 0x600

Change = Callable[[Bench], None]


class How(Enum):
    """The ways in which cycles are run."""

    INTERPRETED = 0
    ONE_BY_ONE = 1  #: compiled
    CHAINED = 2


@entry_point(COUNT, TABLE)
def _to_python(_: int, table: Any) -> int:
    return 1


class Samples:
    """Keeps the bits of every sample of a bench."""

    def __init__(self) -> None:
        self.kept: list[bytes] = []

    def sample(self, sample: CycleSample) -> None:
        self.kept.append(sample.reals.tobytes() + sample.wholes.tobytes())

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        def keep(_: int) -> bool:
            self.sample(sample)
            return True

        return CompiledStages(after=[CompiledStage(_to_python, 0, (), fallback=keep)])


@contextmanager
def chained_as(how: How) -> Iterator[Callable[[], int]]:
    """Benches chain their cycles only where that is `how`; how many they have chained."""
    run, at_once, done = CompiledCycles._run, CompiledCycles.run, 0

    def at_once_or_not(self: CompiledCycles, most: int) -> int:
        return at_once(self, most) if how is How.CHAINED else 0

    def counted(self: CompiledCycles, *arguments: Any) -> tuple[int, bool]:
        nonlocal done
        found = run(self, *arguments)
        done += found[0]
        return found

    with patch.object(CompiledCycles, "_run", counted), patch.object(CompiledCycles, "run", at_once_or_not):
        yield lambda: done


def ending_of(bench: Bench, cycles: int, changes: Sequence[tuple[int, Change]], *, together: bool = False) -> str:
    """Run so many cycles, with what is done in between, by cycle; the error that has ended it, or nothing. `together`:
    all cycles up to the next change are asked for at once."""
    ends = sorted({*(at for at, _ in changes if 0 < at < cycles), cycles}) if together else range(1, cycles + 1)
    try:
        with bench:
            cycle = 0
            for end in ends:
                for at, change in changes:
                    if at == cycle:
                        change(bench)
                bench.run((end - cycle) * bench.config.cycle_time_s) if together else bench.cycle()
                cycle = end
    except HilbenchError as error:
        return f"{type(error).__name__}: {error}"
    return ""


def notices_of(bench: Bench) -> list[tuple[float, str, str, int]]:
    return [(each.time_s, each.source, each.text, each.count) for each in bench.notices]


def objects_of(all_hosted: Iterable[HostedDevices]) -> list[object]:
    """Every object of every device, with its value."""
    return [
        (device.node_id, hex(cell.variable.index), cell.variable.subindex, repr(cell.value))
        for hosted in all_hosted
        for device in hosted.devices
        for cell in device._store
    ]


def download(node_id: int, index: int, value: int, size: int, sub: int = 0) -> Frame:
    """What asks a node to write an object (SDO, expedited)."""
    head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + bytes((sub,))
    return Frame(SDO + node_id, head + value.to_bytes(4, "little"))


def sets(path: str, value: float) -> Change:
    return lambda bench: bench.set(path, value)


def events_on_a_line(sends: Callable[..., Change]) -> list[Change]:
    """What may come between cycles of the demonstrator; `sends` is how somebody else on its bus sends frames."""
    writes = [
        download(1, 0x2001, 0x7305, 2),  # axis 1 fails
        download(18, 0x2001, 0x7305, 2),  # a virtual axis does
        download(2, 0x6072, 5, 2),  # hardly any torque
        download(2, 0x6080, 1, 4),  # overspeed
        download(1, 0x1017, 30, 2),  # heartbeats more often
        download(32, 0x1017, 0, 2),  # and none
        download(3, 0x60B2, 10, 2),  # torque offset
    ]
    others = [
        Frame(0x182, bytes(8)),
        Frame(NMT, bytes((0x80, 1))),
        Frame(0x001, b""),
        Frame(0x123, b"abc"),
        Frame(0x67F, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0))),
    ]
    return [
        sets("line_speed_m_s", 0.4),
        sets("tension_control.set_point_N", 90.0),
        sets("load.web.youngs_modulus_Pa", 10.5e9),
        sets("hardware.effects.viscous_friction.axis2.coefficient_N_s_per_m", 3.0),
        *map(sends, [*writes, *others]),
    ]


#: Changes of the config that cycles on arrays follow.
OPTIONS = st.builds(
    lambda seed, mirroring, heartbeat_ms, every: [
        f"seed={seed}",
        f"mirroring={mirroring}",
        f"master.heartbeat_ms={heartbeat_ms}",
        f"twin.virtual_tpdo_every={every}",
    ],
    st.integers(0, 99),
    st.sampled_from(["listen", "copy"]),
    st.sampled_from([0, 37, 100]),
    st.sampled_from([0, 1, 3]),
)


def between(events: list[Change]) -> st.SearchStrategy[list[tuple[int, Change]]]:
    """A few of them, with the cycle in which each comes."""
    return st.lists(st.tuples(st.integers(5, 140), st.sampled_from(events)), max_size=3)
