"""The page of a kind of machine."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.apps.pages.live.history import Array
from hilbench.apps.pages.live.machines.panel import Panel
from hilbench.machine_kinds import machine_part
from hilbench.topology.config import BenchConfig


def panel_of(config: BenchConfig) -> Panel:
    """Panel of the page of a bench."""
    panel: Panel = machine_part(config.machine.kind, "page").panel(config)
    return panel


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True if the emulation, simulated on the motion since the sample `first` (N,), is right in the sample `last`,
    whatever its initial state."""
    return bool(machine_part(config.machine.kind, "page").settled(config, names, first, last))
