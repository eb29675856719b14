"""Effects of the simulated hardware as CANopen objects.

The n-th effect of the table (from 0) is object 2200h + n, its parameters are the sub-indices in order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from hilbench.canopen.device import Cell, Device
from hilbench.plant.effects import EFFECTS, RIG_DOMAINS

EFFECTS_INDEX: Final = 0x2200


def effect_object(effect_id: str, parameter: str) -> tuple[int, int]:
    """Index and sub-index of an effect's parameter. Raises KeyError for what the table does not have."""
    for position, effect in enumerate(EFFECTS):
        if effect.id == effect_id:
            for sub, known in enumerate(effect.parameters, 1):
                if known.name == parameter:
                    return EFFECTS_INDEX + position, sub
    raise KeyError(f"{effect_id}.{parameter}")


def bind_effect_objects(device: Device, apply: Callable[[str, dict[str, float]], None]) -> None:
    """Give the effect objects of a device their neutral values, and let writes act: `apply(effect id, all its
    parameters)`."""
    for position, effect in enumerate(EFFECTS):
        index = EFFECTS_INDEX + position
        if effect.domain not in RIG_DOMAINS or not device.has(index, 1):
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
