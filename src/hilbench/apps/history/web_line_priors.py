"""Priors of a run's twin from the newest commissioning of its stand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from hilbench.apps.history.store import COMMISSIONING, History, Row, history_of
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.config import Prior
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.runs.config import LoadedConfig

#: The quantities of a prior by effect and parameter, as a history names them.
_PRIORS: Final = {
    ("torque_offset", "offset_Nm"): "torque_offset_Nm",
    ("coulomb_friction", "force_N"): "dry_friction_N",
    ("viscous_friction", "coefficient_N_s_per_m"): "viscous_friction_N_s_per_m",
    ("torque_scale", "relative_change"): "torque_scale",
    ("inertia_mismatch", "relative_change"): "inertia_share",
    ("web_slip", "creep_per_N"): "creep_per_N",
}
_PLACE: Final = re.compile(r"(axis|span|web)(\d*)")


def with_commissioned(loaded: LoadedConfig, runs: Path, warn: Callable[[str], None]) -> LoadedConfig:
    """Config with the priors of the newest commissioning of its stand, beyond its model.

    runs: the folder in which run folders are made. Unchanged where there is no commissioning, where the config has
    priors of its own or `commissioned: ignore`, and of a machine other than a web line; where the history can't be
    read the run goes on without, and `warn` gets a line.
    """
    config, path = loaded.config, history_of(loaded.config, runs)
    model, twin = config.machine, config.twin
    if twin.priors or twin.commissioned == "ignore" or not isinstance(model, ModelParameters) or not path.is_file():
        return loaded
    try:
        rows = [row for row in History(path).rows(config.stand_name) if row.source == COMMISSIONING]
    except UnusableInputError as error:
        warn(f"without what was commissioned: {error}")
        return loaded
    newest_s = max((row.time_s for row in rows), default=0.0)
    priors = list(filter(None, (_prior(row, model) for row in rows if row.time_s == newest_s)))
    changed = twin.model_copy(update={"priors": priors})
    return replace(loaded, config=config.model_copy(update={"twin": changed})) if priors else loaded


def _prior(row: Row, model: ModelParameters) -> Prior | None:
    """Prior of an axis beyond the model, from a row; None for what a twin has no prior of, or of no axis of this
    one."""
    place, effect, parameter = row.quantity.name.split(".")
    quantity, found = _PRIORS.get((effect, parameter)), _PLACE.fullmatch(place)
    if quantity is None or found is None or row.quantity.sd <= 0.0:
        return None
    number = int(found[2] or 1)
    axis = number if found[1] == "axis" else number + 1
    if axis > model.axis_count:
        return None
    known = [one.parameters[parameter] for one in model.effects if one.effect == effect and _is_at(one, axis)]
    return Prior.model_validate(
        {
            "quantity": quantity,
            "axis": axis,
            "value": row.quantity.value - sum(known),
            "deviation": row.quantity.sd,
            "measured_at": datetime.fromtimestamp(row.time_s, UTC),
        }
    )


def _is_at(effect: EffectEntry, axis: int) -> bool:
    """True if an effect of an axis, or of the span before it, is at this one."""
    if effect.axis is not None:
        return effect.axis == axis
    return effect.section in (None, axis - 1)
