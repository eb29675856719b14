"""Effects in the simulated hardware, which an experiment changes by SDO."""

from __future__ import annotations

from hilbench.exchange.nodes import Nodes


class HardwareEffects:
    """Parameters of effects in the simulated drives, by ``hardware.effects…`` paths."""

    def __init__(self, nodes: Nodes) -> None:
        self._nodes = nodes

    def owns(self, path: str) -> bool:
        """True if it is an effect in the hardware."""
        return path.startswith("hardware.")

    def value(self, path: str) -> float:
        """Present value as the drive has it."""
        return self._nodes.hardware_effect(path)

    def set(self, path: str, value: float) -> None:
        """Write another value."""
        self._nodes.set_hardware_effect(path, value)
