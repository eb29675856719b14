"""Elapsed cycles by the axes' travel, which is more reliable than a clock that may have jumped."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.sample_coherence import cycles_elapsed, play
from hilbench.topology.blocks import MachineParameters


class CycleCountFromPosition:
    """Cycle counter by the axes' travel between two measurements and their usual travel per cycle."""

    def __init__(self, model: MachineParameters, cycle_s: float) -> None:
        of_a_cycle = play(model.position_unit, cycle_s)
        self._plays = [of_a_cycle * model.motor_rad_per_unit(axis) for axis in range(1, model.axis_count + 1)]
        self.reset()

    def reset(self) -> None:
        """Forget the axes' positions."""
        self._last: Sequence[float] | None = None
        self._usual: Sequence[float] | None = None
        self._cycles = 0  # since the last

    def gone(self, positions_rad: Sequence[float], reported: int) -> int:
        """Cycles elapsed up to these positions, where a clock has `reported` so many."""
        if self._last is None or self._usual is None:
            return reported
        travels = [now - last for now, last in zip(positions_rad, self._last, strict=True)]
        found = cycles_elapsed(travels, self._usual, self._plays, self._cycles + reported)
        return reported if found is None else found - self._cycles

    def update(self, positions_rad: Sequence[float] | None, cycles: int) -> None:
        """Take the positions of all axes (N,), so many cycles after the previous ones; None: unknown."""
        self._cycles += cycles
        if positions_rad is None:
            return
        if self._last is not None and self._cycles > 0:
            self._usual = [(now - last) / self._cycles for now, last in zip(positions_rad, self._last, strict=True)]
        self._last, self._cycles = positions_rad, 0
