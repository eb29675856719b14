"""What of the bench config the twin needs."""

from __future__ import annotations

from hilbench.canopen.eds import load_eds
from hilbench.exchange.device_clock import device_clock
from hilbench.exchange.nodes import declared_units
from hilbench.topology.config import BenchConfig, NodeConfig
from hilbench.twin.axis_listener import RealAxis, TwinNode
from hilbench.twin.process import TwinSetup


def twin_setup(config: BenchConfig) -> TwinSetup:
    """The twin's part of a bench config."""
    nodes = config.nodes

    def node(part: NodeConfig) -> TwinNode:
        return TwinNode(part.node_id, part.eds)

    def axis(name: str) -> RealAxis:
        part: NodeConfig = getattr(nodes, name)
        od = load_eds(part.eds, part.node_id)
        return RealAxis(part.node_id, part.eds, declared_units(config, name, od))

    return TwinSetup(
        bus=config.bus_address,
        clock=device_clock(config),
        cycle_s=config.cycle_time_s,
        model=config.model,
        twin=config.twin,
        real_axes=(axis("axis1"), axis("axis2")),
        virtual_axes=(node(nodes.virtual_axis1), node(nodes.virtual_axis2)),
        virtual_io=node(nodes.virtual_io),
        process=config.process_settings("twin"),
    )
