"""Effects of the simulated hardware as CANopen objects.

The object index of an effect is in its row of the vocabulary, its parameters are the sub-indices in order; a second
axis of a node has its own at an offset of 800h, as for all its objects. From
2000h on objects are manufacturer-specific: one is an effect's only if the EDS file names its entries as here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from hilbench.canopen.device import Cell, Device
from hilbench.cia402.axis import objects_behind
from hilbench.errors import UnusableValueError
from hilbench.exchange.addressing import dictionary_of
from hilbench.plant.effect import Effect, EffectPlace, MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role
from hilbench.topology.quantities import parse_effect_path


def effect_object(effect_id: str, parameter: str, kind: MachineKind = MachineKind.WEB_LINE) -> tuple[int, int]:
    """Index and sub-index of an effect's parameter. Raises KeyError for what a machine of that kind does not have."""
    effect = find_effect(effect_id, kind)
    for sub, known in enumerate(effect.parameters, 1):
        if known.name == parameter:
            return effect.object_index, sub
    raise KeyError(f"{effect_id}.{parameter}")


def effect_place(config: BenchConfig, path: str) -> tuple[int, int, int]:
    """Node, index and sub-index of an effect in the simulated hardware, by a ``hardware.effects…`` path.

    Raises UnusableValueError where the axis is a real drive, or where its EDS file does not have the effect.
    """
    problem = config.path_problem(path)
    if problem:
        raise UnusableValueError(f"path {path!r}, expected {problem}")
    of = parse_effect_path(path, config.machine.machine_kind)
    assert of.axis is not None, "effects of the hardware are effects of an axis"
    part = config.parts_of(Role.AXIS)[of.axis - 1]
    index, sub = effect_object(of.effect, of.parameter, config.machine.machine_kind)
    index += objects_behind(part.node_axis)
    od = dictionary_of(part)
    if not _is_effect(od.get(index), find_effect(of.effect, config.machine.machine_kind)):
        found = repr(od[index].name) if index in od else "nothing"
        raise UnusableValueError(
            f"path {path!r}, expected an EDS file of {part.label} with '{of.effect}' as {index:04X}h, "
            f"{part.node.eds.name} has {found} there"
        )
    return part.node.node_id, index, sub


def _is_effect(entries: ODRecord | ODArray | ODVariable | None, effect: Effect) -> bool:
    """True if the object at the index of an effect has the names of that effect's parameters."""
    if not isinstance(entries, ODRecord | ODArray):
        return False
    names = [entries[sub].name.partition(" [")[0] for sub in entries if sub > 0]
    return names == [parameter.name for parameter in effect.parameters]


def bind_effect_objects(
    device: Device,
    apply: Callable[[str, dict[str, float]], None],
    kind: MachineKind = MachineKind.WEB_LINE,
    node_axis: int = 1,
) -> None:
    """Give the effect objects of an axis of a device their neutral values, and let writes act: `apply(effect id, all
    its parameters)`."""
    for effect in effects_of(kind):
        index = effect.object_index + objects_behind(node_axis)
        if not effect.enters(EffectPlace.HARDWARE) or not device.has(index, 1):
            continue
        if not _is_effect(device.cell(index, 1).variable.parent, effect):
            continue
        cells = {parameter.name: device.cell(index, sub) for sub, parameter in enumerate(effect.parameters, 1)}
        for parameter in effect.parameters:
            cells[parameter.name].start_with(parameter.neutral)
        for name, cell in cells.items():
            cell.on_write = partial(_written, apply, effect.id, cells, name)


def _written(
    apply: Callable[[str, dict[str, float]], None], effect_id: str, cells: dict[str, Cell], name: str, value: float
) -> None:
    apply(effect_id, {**{key: float(cell.value) for key, cell in cells.items()}, name: value})
