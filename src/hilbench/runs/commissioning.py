"""The experiment that commissions a stand: speeds, both directions, second set-points and steep ramps, from its config.

Nothing goes further than the config lets it: speeds up to those of its own steps (without any up to the usual line
speed of the twin's `model_errors`), nothing beyond the warning levels of `safety: limits`, ramps with a share of the
torque that the drives have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hilbench.bench.machines.ranges import operator_ranges
from hilbench.errors import UnusableInputError
from hilbench.machine_kinds import machine_part
from hilbench.plant.parameters import per_item
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.scenario import read_scenario
from hilbench.runs.steps import ExperimentStep
from hilbench.topology.quantities import SPEED

#: Share of a warning level that is used: a drive overshoots the corner of a ramp by less than a tenth.
OF_LIMIT: Final = 0.9
#: Share of a drive's torque that the steep ramps take, and the gentle ones: the rest is for friction and pull of web.
STEEP, GENTLE = 0.25, 0.1
#: The slowest level of speed, as a share of the highest, and the time at a level, s.
SLOW, HOLD_S = 0.15, 4.0
#: Longest process time of a commissioning, s.
LONGEST_S: Final = 120.0
#: Levels of speed above the slow one, as shares of the highest: friction from 1 to 7 of its speeds, and two between
#: which ramps are steep.
_MIDDLE, _FAST, _TOP = 0.5, 0.85, 1.0
#: Time at a second set-point and between steep ramps, s: the loops settle in half of the shorter.
_SECOND_S, _BETWEEN_S = 3.0, 0.8
#: Steep ramps up and down, in each direction.
_RAMPS: Final = 3
#: Top speed of a servo axis without steps that say one, as a share of the level at which its speed warns.
_OF_A_SHAFT: Final = 0.5


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


@dataclass(frozen=True)
class CommissioningPlan:
    """Steps from standstill to standstill, how long they take, and what they are, for a person."""

    steps: list[ExperimentStep]
    duration_s: float
    text: str


def commissioning_plan(config: ExperimentConfig, place: Path, *, forward_only: bool = False) -> CommissioningPlan:
    """The experiment for a bench; `place`: the config's file, for errors.

    Raises UnusableInputError, one line, for a machine that can't be commissioned, or within too tight limits.
    """
    reach: Reach = machine_part(config.machine.kind, "commissioning")(config, place)
    directions = (1.0,) if forward_only else (1.0, -1.0)
    steps = [*(step for sign in directions for step in _one_way(reach, sign))]
    duration_s = sum(each.get("duration_s", 0.0) for step in steps for each in step.values())
    if duration_s > LONGEST_S:
        raise UnusableInputError(
            place,
            f"its drives take {duration_s:.0f} s for speeds up to {reach.top:g} {reach.unit}, expected at most "
            f"{LONGEST_S:g} s: a lower speed in its steps, or drives with more torque",
        )
    which = "forward" if forward_only else "in both directions"
    beside = "".join(f", {path} {first:g} and {second:g} {unit}" for path, first, second, unit in reach.set_points)
    text = (
        f"speeds up to {reach.top:g} {reach.unit} {which}, ramps up to {reach.steep:.2g} {reach.unit}²"
        f"{beside}; {duration_s:.0f} s"
    )
    return CommissioningPlan([ExperimentStep.model_validate(step) for step in steps], duration_s, text)


def _one_way(reach: Reach, sign: float) -> Iterator[dict[str, Any]]:
    """Steps from standstill to standstill in one direction."""
    speed = 0.0

    def to(share: float, acceleration: float, stay_s: float) -> Iterator[dict[str, Any]]:
        nonlocal speed
        target = sign * share * reach.top
        takes_s = round(max(abs(target - speed) / acceleration, 0.1) + 5e-4, 3)
        yield {"ramp": {"path": reach.path, "to": round(target, 6), "duration_s": takes_s}}
        yield {"hold": {"duration_s": stay_s}}
        speed = target

    yield from to(SLOW, reach.gentle, HOLD_S)
    yield from to(_MIDDLE, reach.gentle, HOLD_S)
    for path, first, second, _ in reach.set_points:
        for value in (second, first):
            yield {"set": {"path": path, "to": value}}
            yield {"hold": {"duration_s": _SECOND_S}}
    for _ in range(_RAMPS):
        yield from to(_FAST, reach.steep, _BETWEEN_S)
        yield from to(_MIDDLE, reach.steep, _BETWEEN_S)
    yield from to(_TOP, reach.gentle, HOLD_S)
    yield from to(0.0, reach.gentle, 0.5)


def reach_of_shaft(config: ExperimentConfig, place: Path) -> Reach:
    """Range of the commissioning of a servo axis."""
    model = config.servo_axis
    if model.drives is None:
        raise UnusableInputError(place, "a machine without drives, expected a servo axis to commission")
    limit_rad_s = operator_ranges(config)[SPEED][1]
    top_rad_s = min(highest_of_steps(config, SPEED) or _OF_A_SHAFT * limit_rad_s, OF_LIMIT * limit_rad_s)
    fastest_rad_s2 = per_item(model.drives.torque_limit_Nm, 1) / model.inertia_kg_m2
    return Reach(SPEED, "rad/s", top_rad_s, STEEP * fastest_rad_s2, GENTLE * fastest_rad_s2)
