"""Check of the FMUs in a config: findings in them, and their consequences for the bench."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.config import FmuBlock, FmuLoadConfig
from hilbench.plant.fmu.description import Variable
from hilbench.plant.unit_names import unit_of_name
from hilbench.topology.config import BenchConfig

#: What a servo axis' twin finds.
_FOUND = ("inertia_kg_m2", "coulomb_friction_Nm", "viscous_friction_Nm_s_per_rad")


def fmu_findings(config: BenchConfig) -> list[str]:
    """Findings in the FMUs, a line each; empty for a bench without FMUs."""
    machine, load = config.machine, config.load.fmu
    lines = _of_axis(machine) if isinstance(machine, FmuAxisParameters) else []
    return lines if load is None else lines + _of_load(load, config)


def _of_axis(machine: FmuAxisParameters) -> list[str]:
    found, drives = machine.variables(), machine.drives
    motion = [found.torque, found.position, found.speed]
    texts = [variable for name, variable in found.parameters.items() if isinstance(machine.parameters[name], str)]
    lines = [
        machine.description().summary,
        f"machine: torque is {_names(motion[:1])}, position {_names(motion[1:2])}, speed {_names(motion[2:])}"
        + "".join(f"; {ours} is {theirs.name}" for ours, theirs in found.parameters.items()),
        *_unit_findings([*motion, *texts]),
        *(step_findings(machine, drives.sample_time_s) if drives else []),
    ]
    kept = [name for name in _FOUND if name not in found.parameters]
    if kept:
        lines.append(f"not the FMU's, so that the twin finds it and can't simulate it: {', '.join(kept)}")
    if not machine.description().can_roll_back:
        lines.append("its state can't be handed out: the twin begins anew where it would go back")
    return lines


def _of_load(load: FmuLoadConfig, config: BenchConfig) -> list[str]:
    found = load.variables(config.machine.position_unit)
    motion = [*found.positions, *found.speeds]
    named: Mapping[str, Variable] = found.outputs | found.parameters
    lines = [
        load.description().summary,
        f"load model: {_names(motion)} follow the motion, {_names(found.torques)} are emulated"
        + "".join(f"; {ours} is {theirs.name}" for ours, theirs in named.items()),
        *_unit_findings([*motion, *found.torques, *(named[ours] for ours in named if unit_of_name(ours) != "1")]),
        *step_findings(load, config.cycle_time_s),
    ]
    if not load.description().can_roll_back:
        lines.append(
            "its torques can't be predicted over the delay of the emulation: what it emulates acts later, and the loop "
            "of machine and shaft is less stable"
        )
    fixed = [f"{ours} ({theirs.name})" for ours, theirs in found.parameters.items() if not theirs.settable]
    if fixed:
        lines.append(f"fixed while it runs, so that no step can change it: {', '.join(fixed)}")
    return [*lines, "whether the loop of FMU, shaft and bus is stable is not known before it runs"]


def step_findings(block: FmuBlock, natural_s: float) -> list[str]:
    """Finding on an FMU's communication step, where it differs from its user's step."""
    step_s = block.communication_step_s(natural_s)
    if step_s is None or abs(step_s - natural_s) < 1e-9 * natural_s:
        return []
    return [
        f"communication steps of {step_s * 1e3:g} ms where {natural_s * 1e3:g} ms are asked for: what is left over is "
        "carried, and what it says is of the last step's end"
    ]


def _unit_findings(variables: Iterable[Variable]) -> list[str]:
    without = sorted({each.name for each in variables if not each.unit})
    return [f"without a unit, taken for what the bench expects: {', '.join(without)}"] if without else []


def _names(variables: Iterable[Variable]) -> str:
    return ", ".join(each.name + (f" [{each.unit}]" if each.unit else "") for each in variables)
