"""Subject of an examination: the bench of a config with its EDS files, a bus without one, or the machine alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from hilbench.apps.canopen_tools.eds_match import default, identity
from hilbench.can.open import BusAddress
from hilbench.canopen.pdo import PdoMap, bit_length
from hilbench.processes import ChildProcess

if TYPE_CHECKING:  # the models take their time to import; an examination without a config does not need them
    from hilbench.exchange.nodes import Nodes
    from hilbench.topology.config import BenchConfig

#: Starts what `hilbench run` starts, with a folder for its files.
Start = Callable[[Path], list[ChildProcess]]


@dataclass(frozen=True)
class MappedObject:
    """An object that the bench maps into a PDO, with its length by the EDS in bits."""

    index: int
    sub: int
    name: str
    bits: int


@dataclass(frozen=True)
class ExpectedNode:
    """A node of the config, as its EDS file has it; None where the file does not state it."""

    part: str
    node_id: int
    eds: Path
    ours: bool  #: `hilbench run` starts it: simulated hardware or twin
    device_type: int | None = None
    #: Vendor id, product code and revision: for each, what [DeviceInfo] and 1018h give (0: nothing).
    identity: tuple[frozenset[int], ...] = (frozenset(), frozenset(), frozenset())
    mapped: tuple[MappedObject, ...] = ()

    @property
    def subject(self) -> str:
        """Name of the node in findings."""
        return f"{self.part.replace('_', ' ')} (node {self.node_id})"


@dataclass(frozen=True)
class Subject:
    """Subject of an examination; the defaults are those of a bench config, for one without a config."""

    bus: BusAddress | None  #: None: the machine alone
    realtime: bool  #: False: in lockstep only the result counts, not when it comes
    cycle_s: float = 0.002
    frames_per_cycle: int = 16  #: that may wait in the transmit queue at a time
    bitrate_source: str = "as bus: bitrate: in the config"  #: why it is that one, for the finding
    master_id: int = 127
    sdo_timeout_s: float = 1.0
    boot_timeout_s: float = 20.0
    nodes: Sequence[ExpectedNode] = ()
    start: Start | None = None  #: for the nodes that a run starts, when none of them is there

    @classmethod
    def of_bus(cls, bus: BusAddress | None) -> Subject:
        """A bus of which nothing else is known, or none: this machine."""
        return cls(
            bus,
            realtime=bus is not None and bus.interface != "embedded",
            bitrate_source="which is a bench's when its config names none",
        )

    @classmethod
    def of_bench(cls, config: BenchConfig, *, start: bool) -> Subject:
        """The bench of a config. Raises UnusableInputError for an EDS file that cannot be used."""
        from hilbench.bench.lifecycle.startup import start_children
        from hilbench.exchange.nodes import Nodes

        nodes = Nodes(config)
        return cls(
            bus=config.bus_address.as_it_runs(),
            realtime=config.pace == "realtime",
            cycle_s=config.cycle_time_s,
            frames_per_cycle=sum(ceil(frame.per_cycle) for frame in nodes.cyclic_frames()),
            master_id=config.master.node_id,
            sdo_timeout_s=config.master.sdo_timeout_s,
            boot_timeout_s=config.master.boot_timeout_s,
            nodes=expected_nodes(nodes),
            start=partial(start_children, config) if start else None,
        )

    @property
    def bitrate(self) -> int:
        """Of its bus, bit/s."""
        return (self.bus or BusAddress()).bitrate

    @property
    def on_socketcan(self) -> bool:
        """True for an interface of the kernel."""
        return self.bus is not None and self.bus.interface == "socketcan"


def expected_nodes(nodes: Nodes) -> list[ExpectedNode]:
    """The nodes of a bench with what their EDS files promise."""
    from hilbench.exchange.addressing import dictionary_of

    return [
        ExpectedNode(
            part=part.name,
            node_id=part.node.node_id,
            eds=part.node.eds,
            ours=part.is_ours,
            device_type=default(dictionary_of(part), 0x1000, 0),
            identity=identity(dictionary_of(part)),
            mapped=_mapped(nodes.pdo_maps(part.name)),
        )
        for part in nodes.config.parts
    ]


def _mapped(maps: Iterable[PdoMap]) -> tuple[MappedObject, ...]:
    found = {(each.index, each.subindex): each for pdo in maps for each in pdo.variables}
    return tuple(MappedObject(*key, found[key].name, bit_length(found[key])) for key in sorted(found))
