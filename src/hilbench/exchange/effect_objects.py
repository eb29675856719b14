"""Effects of the simulated hardware as CANopen objects.

The object index of an effect stands in its row of the vocabulary, its parameters are the sub-indices in order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hilbench.canopen.device import Cell, Device
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effects_of, find_effect


def effect_object(effect_id: str, parameter: str, kind: MachineKind = MachineKind.WEB_LINE) -> tuple[int, int]:
    """Index and sub-index of an effect's parameter. Raises KeyError for what a machine of that kind does not have."""
    effect = find_effect(effect_id, kind)
    for sub, known in enumerate(effect.parameters, 1):
        if known.name == parameter:
            return effect.object_index, sub
    raise KeyError(f"{effect_id}.{parameter}")


def bind_effect_objects(
    device: Device, apply: Callable[[str, dict[str, float]], None], kind: MachineKind = MachineKind.WEB_LINE
) -> None:
    """Give the effect objects of a device their neutral values, and let writes act: `apply(effect id, all its
    parameters)`."""
    for effect in effects_of(kind):
        index = effect.object_index
        if not effect.enters(EffectPlace.HARDWARE) or not device.has(index, 1):
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
