"""Twin setup from a bench config."""

from __future__ import annotations

from hilbench.canopen.eds import shared_eds
from hilbench.estimation.web_line.config import KnownChangeConfig
from hilbench.exchange.addressing import declared_units, device_clock
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from hilbench.twin.axis_listener import AxisNode, TwinNode
from hilbench.twin.process import TwinSetup

#: Deviation of a simulated drive's loop gains from the model's, %.
_SIMULATED_LOOP_PCT = 0.2


def twin_setup(config: BenchConfig) -> TwinSetup:
    """Twin setup from a bench config."""

    def axis(part: Part) -> AxisNode:
        od = shared_eds(part.node.eds, part.node.node_id)
        return AxisNode(part.node.node_id, part.node.eds, declared_units(part, od), part.node_axis)

    (virtual_io,) = config.parts_of(Role.VIRTUAL_IO)
    return TwinSetup(
        bus=config.bus_address,
        clock=device_clock(config),
        cycle_s=config.cycle_time_s,
        model=config.machine,
        shape=config.shape,
        twin=_twin(config),
        real_axes=tuple(map(axis, config.parts_of(Role.AXIS))),
        virtual_axes=tuple(map(axis, config.parts_of(Role.VIRTUAL_AXIS))),
        virtual_io=TwinNode(virtual_io.node.node_id, virtual_io.node.eds),
        process=config.process_settings("twin"),
    )


def _twin(config: BenchConfig) -> TwinConfig:
    """Twin config, with probing-step evaluation if the bench makes probes."""
    twin = config.twin
    probes = any(control.probes.mode != "off" for control in config.tension_controls.values())
    if not probes or twin.known_change is not None:
        return twin
    alone, behind = config.shape.spans == 1, list(config.drives.values())[1]
    deviation_pct = _SIMULATED_LOOP_PCT if alone and behind.simulated else None
    return twin.model_copy(update={"known_change": KnownChangeConfig(loop_gain_deviation_pct=deviation_pct)})
