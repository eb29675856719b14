"""What of the bench config the twin needs."""

from __future__ import annotations

from hilbench.canopen.eds import load_eds
from hilbench.exchange.device_clock import device_clock
from hilbench.exchange.nodes import declared_units
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from hilbench.twin.axis_listener import RealAxis, TwinNode
from hilbench.twin.process import TwinSetup


def twin_setup(config: BenchConfig) -> TwinSetup:
    """The twin's part of a bench config."""

    def node(part: Part) -> TwinNode:
        return TwinNode(part.node.node_id, part.node.eds)

    def axis(part: Part) -> RealAxis:
        od = load_eds(part.node.eds, part.node.node_id)
        return RealAxis(part.node.node_id, part.node.eds, declared_units(part, od))

    return TwinSetup(
        bus=config.bus_address,
        clock=device_clock(config),
        cycle_s=config.cycle_time_s,
        model=config.machine,
        shape=config.shape,
        twin=config.twin,
        real_axes=tuple(map(axis, config.parts_of(Role.AXIS))),
        virtual_axes=tuple(map(node, config.parts_of(Role.VIRTUAL_AXIS))),
        virtual_io=node(*config.parts_of(Role.VIRTUAL_IO)),
        process=config.process_settings("twin"),
    )
