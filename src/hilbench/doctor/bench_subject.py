"""What an examination has to expect of a bench, from its config and EDS files."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil

import canopen

from hilbench.bench.config import BenchConfig
from hilbench.bench.nodes import Nodes
from hilbench.bench.startup import start_children
from hilbench.doctor.examination import Start, Subject
from hilbench.doctor.stations import ExpectedNode, MappedObject
from hilbench.fieldbus import eds
from hilbench.fieldbus.pdo import PdoMap, bit_length


def subject_of(config: BenchConfig) -> Subject:
    """The bench of a config. Raises UnusableInputError for an EDS file that cannot be used."""
    nodes = Nodes(config)
    return Subject(
        bus=config.bus_address,
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
    real = {part for part, node in nodes.config.nodes if not node.simulated}
    return [
        ExpectedNode(
            part=part,
            node_id=node.node_id,
            eds=node.eds,
            ours=part not in real or part.startswith("virtual"),
            device_type=_default(nodes.dictionary(part), 0x1000, 0),
            identity=_identity(nodes.dictionary(part)),
            mapped=_mapped(nodes.pdo_maps(part)),
        )
        for part, node in nodes.config.nodes
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


def _identity(od: canopen.ObjectDictionary) -> tuple[frozenset[int], ...]:
    device = od.device_information
    header = (device.vendor_number, device.product_number, device.revision_number)
    return tuple(
        frozenset(value for value in (given, _default(od, 0x1018, sub)) if value) for sub, given in enumerate(header, 1)
    )


def _default(od: canopen.ObjectDictionary, index: int, sub: int) -> int | None:
    try:
        value = eds.variable(od, index, sub).default
    except KeyError:
        return None
    return int(value) if isinstance(value, int) else None
