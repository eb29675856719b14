"""Range of a machine's commissioning, and the bounds of every kind of machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hilbench.runs.config import ExperimentConfig
from hilbench.runs.scenario import read_scenario

#: Share of a warning level that is used: a drive overshoots the corner of a ramp by less than a tenth.
OF_LIMIT: Final = 0.9
#: Share of a drive's torque that the steep ramps take, and the gentle ones: the rest is for friction and pull of web.
STEEP, GENTLE = 0.25, 0.1
#: The slowest level of speed, as a share of the highest, and the time at a level, s.
SLOW, HOLD_S = 0.15, 4.0


@dataclass(frozen=True)
class Reach:
    """Range of the plan: highest speed and steepest ramps in the machine's unit of position per s and s²; of each
    set-point other than the speed its path, the two values, and their unit."""

    path: str
    unit: str
    top: float
    steep: float
    gentle: float
    set_points: Sequence[tuple[str, float, float, str]] = ()


def highest_of_steps(config: ExperimentConfig, path: str) -> float:
    """The highest speed that the config's own steps and tables ask for; 0 where none does."""
    moves = (each for step in config.steps for each in (step.ramp, step.set, step.step) if each is not None)
    asked = [each.to for each in moves if each.path == path]
    for table in (read_scenario(step.table.file) for step in config.steps if step.table is not None):
        asked += [value for moved in (table.ramps, table.jumps) for _, value in moved.get(path, ())]
    return max(map(abs, asked), default=0.0)
