"""Expectations of an examination of a bench, from its config and EDS files."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil

from hilbench.apps.canopen_tools.eds_match import default, identity
from hilbench.apps.doctor.check_stations import ExpectedNode, MappedObject
from hilbench.apps.doctor.examination import Start, Subject
from hilbench.bench.lifecycle.startup import start_children
from hilbench.canopen.pdo import PdoMap, bit_length
from hilbench.exchange.nodes import Nodes
from hilbench.topology.config import BenchConfig


def subject_of(config: BenchConfig) -> Subject:
    """The bench of a config. Raises UnusableInputError for an EDS file that cannot be used."""
    nodes = Nodes(config)
    return Subject(
        bus=config.bus_address.as_it_runs(),
        realtime=config.pace == "realtime",
        cycle_s=config.cycle_time_s,
        frames_per_cycle=sum(ceil(frame.per_cycle) for frame in nodes.cyclic_frames()),
        master_id=config.master.node_id,
        sdo_timeout_s=config.master.sdo_timeout_s,
        boot_timeout_s=config.master.boot_timeout_s,
        nodes=expected_nodes(nodes),
    )


def starter(config: BenchConfig) -> Start:
    """Starts what `hilbench run` starts."""
    return lambda folder: start_children(config, folder)


def expected_nodes(nodes: Nodes) -> list[ExpectedNode]:
    """The nodes of a bench with what their EDS files promise."""
    return [
        ExpectedNode(
            part=part.name,
            node_id=part.node.node_id,
            eds=part.node.eds,
            ours=part.is_ours,
            device_type=default(nodes.dictionary(part.name), 0x1000, 0),
            identity=identity(nodes.dictionary(part.name)),
            mapped=_mapped(nodes.pdo_maps(part.name)),
        )
        for part in nodes.config.parts
    ]


def _mapped(maps: Iterable[PdoMap]) -> tuple[MappedObject, ...]:
    found = {
        (variable.index, variable.subindex): MappedObject(
            variable.index, variable.subindex, variable.name, bit_length(variable)
        )
        for pdo in maps
        for variable in pdo.variables
    }
    return tuple(found[key] for key in sorted(found))
