"""Misfits between a bench config and its machine: each line states what is expected."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effect_problem, find_effect
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.blocks import LoadConfig, LoadShaftConfig, MachineParameters, TwinConfig
from hilbench.topology.parts import DeviceConfig, LoadMotorConfig, Part
from hilbench.topology.web_line_config import (
    ControllerConfig,
    LoadWebConfig,
    controller_misfits,
    estimate_misfits,
    line_misfits,
    rest_misfit,
)

#: Keys of `twin:` that every kind of machine has, and those of machines whose equations are known; the others say how
#: one kind finds what it estimates.
_OF_EVERY_TWIN = {"node", "synchronized_pct", "behind", "virtual_tpdo_every"}
_OF_EQUATIONS = {"prediction", "live_diagnosis"}
_OF_THE_SHAFT = {"inertia"}


def misfits(key: str, value: Any, machine: Any, loaded: Collection[int] | None) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this machine, and load motors on the shafts of the axes
    `loaded` (None: that is not known)."""
    kind: MachineKind = machine.machine_kind
    of_servo = kind is MachineKind.SERVO_AXIS
    if key == "load_motors" and of_servo and len(value) != 1:
        yield "one load motor: a servo axis has one shaft"
    if key == "controllers" and bool(value) is of_servo:
        yield "none: a servo axis follows its reference" if of_servo else "at least one"
    if key == "controllers" and not of_servo:
        yield from controller_misfits(value.values(), machine.span_count)
    if key == "twin" and not of_servo:
        yield from estimate_misfits(value, machine)
    sections = 0 if of_servo else machine.span_count
    if key == "load" and not of_servo:
        yield from value.web.misfits(sections)
    if key == "load" and value.fmu is not None:
        yield from _fmu_misfits(value, machine, None if loaded is None else len(loaded))
    if key == "load" and value.web != LoadWebConfig() and of_servo:
        yield "'shaft:' for a servo axis"
    if not of_servo and ((key == "load" and value.shaft != LoadShaftConfig()) or (key == "hardware" and value.shaft)):
        yield "no 'shaft:', which is of a servo axis (machine: {kind: servo_axis})"
    if key == "twin":
        default, names = TwinConfig(node=value.node), set(TwinConfig.model_fields) - _OF_EVERY_TWIN
        names -= set() if isinstance(machine, FmuAxisParameters) else _OF_EQUATIONS
        for name in sorted(names - _OF_THE_SHAFT if of_servo else _OF_THE_SHAFT):
            if getattr(value, name) != getattr(default, name):
                yield f"no '{name}:', which is of a twin of another kind of machine (this one is a {kind})"
    if key == "hardware" and isinstance(machine, FmuAxisParameters) and value.effects:
        yield "no 'effects:': what an FMU does is in its own equations"
    if key in ("hardware", "load"):
        for entry in value.effects:
            place = effect_problem(
                entry.effect, entry.axis, EffectPlace(key), machine.axis_count, loaded, kind,
                section=entry.section, sections=sections,
            )  # fmt: skip
            stations = {} if of_servo else machine.station_types
            of_station = find_effect(entry.effect, kind).station_problem(entry.section, stations) if not place else None
            yield from filter(None, [entry.problem(kind), place, of_station])


def one_node_misfit(part: Part, beside: Mapping[int, Part]) -> tuple[str, str]:
    """Reason why a part can't share its node with others, by their axes: the key, and what is expected there."""
    other = next(iter(beside.values()), None)
    if other is None:
        return "", ""
    node_id, node = part.node.node_id, part.node
    if part.node_axis in beside or not (isinstance(node, DeviceConfig) and isinstance(other.node, DeviceConfig)):
        both = f"{beside.get(part.node_axis, other).name} and {part.name} both have {node_id}"
        what = f", axis {part.node_axis}" if part.node_axis in beside else ""
        return "node_id", f"node ids that differ, or another 'axis:' of a node with two: {both}{what}"
    if node.eds != other.node.eds:
        return "eds", f"{other.node.eds}, the EDS file of {other.name}, which is on node {node_id} as well"
    if node.simulated is not other.node.simulated:
        return "simulated", f"{str(other.node.simulated).lower()}, as {other.name} on the same node {node_id} is"
    return "", ""


def whole_misfits(
    machine: MachineParameters,
    drives: Collection[str],
    load_motors: Mapping[str, LoadMotorConfig],
    controllers: Collection[ControllerConfig],
    load: LoadConfig,
    twin: TwinConfig,
) -> Iterator[str]:
    """Why a machine can't have all these together: `drives` by their names, load motors by theirs."""
    if isinstance(machine, ModelParameters):
        ahead = [key for key in ("prediction", "live_diagnosis", "splices") if getattr(twin, key)]
        names = {*drives, *load_motors}
        yield from line_misfits(machine, controllers, load.measured, "".join(ahead[:1]), names)
        yield from filter(None, [rest_misfit(twin, machine, controllers, load.measured)])
    elif machine.drives is None:
        yield "a machine with 'drives:'"
    elif load.measured:
        yield "no 'load.measured' on a servo axis, whose encoder is measured anyway"
    if machine.axis_count != len(drives):
        axes = "driven rollers" if machine.position_unit == "m" else "axes"
        yield (
            f"as many drives as the machine has {axes}: {len(drives)} under 'drives:', "
            f"{machine.axis_count} {axes.rpartition(' ')[2]}"
        )
    for name, motor in load_motors.items():
        if motor.shaft not in drives:
            yield f"the drive on whose shaft '{name}' sits: {', '.join(drives)}; '{motor.shaft}' is none"
    shafts = [motor.shaft for motor in load_motors.values()]
    if len(set(shafts)) < len(shafts):
        yield f"one load motor on a shaft: {', '.join(load_motors)} are on {', '.join(shafts)}"


def _fmu_misfits(load: LoadConfig, machine: Any, load_motors: int | None) -> Iterator[str]:
    """Why load motors can't emulate an FMU in the place of a machine."""
    assert load.fmu is not None
    without_options = LoadConfig(fmu=load.fmu)
    for name in ("web", "shaft", "effects", "measured"):
        if getattr(load, name) != getattr(without_options, name):
            yield f"no '{name}:' beside 'fmu:', which says by itself what is emulated"
    yield from load.fmu.problems(machine.axis_count, load_motors, machine.position_unit)
