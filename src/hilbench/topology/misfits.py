"""Misfits between a bench config and its machine: each line states what is expected."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from hilbench.machine_kinds import has, machine_part
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effect_problem, find_effect
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.topology.blocks import LoadConfig, TwinConfig
from hilbench.topology.parts import DeviceConfig, Part

#: Parts that a kind of machine may lack, which are keys of `twin:`.
_OPTIONAL = ("prediction", "live_diagnosis")


def misfits(key: str, value: Any, machine: Any, loaded: Collection[int] | None) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this machine, and load motors on the shafts of the axes
    `loaded` (None: that is not known)."""
    kind: MachineKind = machine.machine_kind
    of_kind = machine_part(machine.kind, "topology")
    yield from of_kind.misfits(key, value, machine)
    if key == "load" and value.fmu is not None:
        yield from _fmu_misfits(value, machine, None if loaded is None else len(loaded))
    if key == "twin":
        default = TwinConfig(node=value.node)
        for name in sorted(set(TwinConfig.model_fields) - set(of_kind.TWIN_KEYS)):
            if getattr(value, name) == getattr(default, name) or (name in _OPTIONAL and has(machine.kind, name)):
                continue
            if name in _OPTIONAL:
                yield f"no '{name}:', which a machine of kind {machine.kind} does not bring"
            yield f"no '{name}:', which is of a twin of another kind of machine (this one is a {machine.kind})"
    if key == "hardware" and isinstance(machine, FmuAxisParameters) and value.effects:
        yield "no 'effects:': what an FMU does is in its own equations"
    if key in ("hardware", "load"):
        for entry in value.effects:
            place = effect_problem(
                entry.effect, entry.axis, EffectPlace(key), machine.axis_count, loaded, kind,
                section=entry.section, sections=machine.span_count,
            )  # fmt: skip
            stations = getattr(machine, "station_types", {})
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


def whole_misfits(config: Any) -> Iterator[str]:
    """Why a bench can't have all that it has together."""
    machine, drives, load_motors = config.machine, config.drives, config.load_motors
    yield from machine_part(machine.kind, "topology").whole_misfits(config)
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
