"""Force and motion of each of a line's rollers, and two rollers of a line as a line of their own.

The balances of the rollers after span k add up to one in which the tensions between them cancel (each roller with its
m, τ, R as in `hilbench.estimation.web_line.balance`):

    Σ m_j·v_j' = Σ (i/r)_j·τ_j − Σ R_j(v_j) + F_next − F_k,      j = k+1 … N

The left side is that of their centre of mass, exactly, however they swing against each other. So each span has a
balance of its own, which a change in no other span disturbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hilbench.compiled import Reals, Reals2, Vector, compiled
from hilbench.estimation.web_line.balance import mass_at_web_kg, measured_force_N
from hilbench.plant.parameters import DriveParameters, EffectEntry, per_item
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters


class RollerArrays(NamedTuple):
    """Rollers after the first of a line (M), for compiled callers."""

    p: Reals2  #: parameters of each roller and the one before it (M, P)
    masses_kg: Reals  #: at the web
    started: Reals  #: (1,): there are positions
    positions_m: Reals  #: at the web
    forces_N: Reals  #: of each motor there, less its roller's resistance


@compiled
def take(r: RollerArrays, x_m: Vector, torques_Nm: Vector, duration_s: float) -> None:
    """Take positions (N,) at the web and torques (N,) at the motors, `duration_s` after the last."""
    for j in range(len(r.masses_kg)):
        now_m = x_m[j + 1]
        before_m = r.positions_m[j] if r.started[0] != 0.0 else now_m
        r.positions_m[j] = now_m
        velocity_m_s = (now_m - before_m) / duration_s
        r.forces_N[j] = measured_force_N(r.p[j], torques_Nm[j + 1], now_m, velocity_m_s, 0.0)
    r.started[0] = 1.0


@compiled
def centre_m(r: RollerArrays, axis: int) -> float:
    """Position of the centre of mass of the roller of `axis`, from 2, and all after it, at the web."""
    moments, total_kg = 0.0, 0.0
    for j in range(axis - 2, len(r.masses_kg)):
        moments += r.masses_kg[j] * r.positions_m[j]
        total_kg += r.masses_kg[j]
    return moments / total_kg


class Rollers:
    """Rollers of a line after the first, on measured motion and torque.

    Raises ValueError for a model without a web.
    """

    def __init__(self, model: ModelParameters) -> None:
        rows = [lay.pack(two_rollers(model, axis - 1)) for axis in range(2, model.axis_count + 1)]
        masses_kg = np.array([mass_at_web_kg(p) for p in rows])
        #: For compiled callers.
        self.arrays = RollerArrays(np.array(rows), masses_kg, np.zeros(1), *np.zeros((2, len(rows))))

    def reset(self) -> None:
        """Take the next positions as the first."""
        self.arrays.started[0] = 0.0


def two_rollers(model: ModelParameters, span: int, masses_behind_kg: Sequence[float] = ()) -> ModelParameters:
    """Rollers `span` and `span + 1` of a line and the span between them, as a model of its own.

    `masses_behind_kg`: at the web, of further rollers downstream that turn with the second.
    """
    if model.axis_count == 2:
        return model
    around = (span, span + 1)
    behind_kg_m2 = sum(masses_behind_kg) * model.radius_m(span + 1) ** 2
    data = model.model_dump()
    data["web"] = {name: per_item(value, span) for name, value in model.required_web}
    for block in ("rollers", "motors", "drives"):
        values = getattr(model, block)
        for name, value in values or ():
            if isinstance(value, list):
                data[block][name] = [per_item(value, axis) for axis in around]
    inertia = [per_item(model.rollers.inertia_kg_m2, axis) for axis in around]
    data["rollers"]["inertia_kg_m2"] = [inertia[0], inertia[1] + behind_kg_m2]
    if model.drives is not None and masses_behind_kg:
        data["drives"]["torque_limit_Nm"] = _limits_Nm(model, model.drives, span)
    data["web_load"] = [model.carries_web_load(axis) for axis in around]
    data["boundary"] |= {"upstream_strain": model.upstream_strain, "downstream_strain": model.downstream_strain}
    data["effects"] = [
        _moved(entry, span).model_dump()
        for entry in model.effects
        if (entry.axis is None or entry.axis in around) and entry.span in (None, span)
    ]
    return ModelParameters.model_validate(data)


def _limits_Nm(model: ModelParameters, drives: DriveParameters, span: int) -> list[float]:
    """Torque limits before the span, and of all motors after it, at the first motor there."""
    behind = range(span + 1, model.axis_count + 1)
    force_N = sum(per_item(drives.torque_limit_Nm, axis) * model.motor_rad_per_m(axis) for axis in behind)
    return [per_item(drives.torque_limit_Nm, span), force_N / model.motor_rad_per_m(span + 1)]


def _moved(entry: EffectEntry, span: int) -> EffectEntry:
    axis = None if entry.axis is None else entry.axis - span + 1
    return entry.model_copy(update={"axis": axis, "span": None})
