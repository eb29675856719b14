"""Effects of the simulated hardware as CANopen objects: the n-th effect of the table is 2200h + n, its parameters the sub-indices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hilbench.fieldbus.device import Device
from hilbench.web.effects import EFFECTS, STAND_DOMAINS

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
    """Let writes to the effect objects of a device act: `apply(effect id, all its parameters)`."""
    for position, effect in enumerate(EFFECTS):
        index = EFFECTS_INDEX + position
        if effect.domain not in STAND_DOMAINS or not device.has(index, 1):
            continue
        cells = {parameter.name: device.cell(index, sub) for sub, parameter in enumerate(effect.parameters, 1)}

        for name, cell in cells.items():

            def written(value: float, effect_id: str = effect.id, name: str = name, cells: dict = cells) -> None:
                apply(effect_id, {**{key: float(each.value) for key, each in cells.items()}, name: value})

            cell.on_write = written
