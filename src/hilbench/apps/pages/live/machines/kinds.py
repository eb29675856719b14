"""The page of a kind of machine."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.apps.pages.live.history import Array
from hilbench.apps.pages.live.machines import servo_axis, web_line
from hilbench.apps.pages.live.machines.panel import Panel
from hilbench.plant.effect import MachineKind
from hilbench.topology.config import BenchConfig


def panel_of(config: BenchConfig) -> Panel:
    """Panel of the page of a bench."""
    return servo_axis.panel(config) if config.machine_kind is MachineKind.SERVO_AXIS else web_line.panel(config)


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True if the emulation, simulated on the motion since the sample `first` (N,), is right in the sample `last`,
    whatever its initial state."""
    return config.machine_kind is MachineKind.SERVO_AXIS or web_line.settled(config, names, first, last)
