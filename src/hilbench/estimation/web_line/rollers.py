"""What the torques of a line say of each of its rollers by itself, and two rollers of a line as a line of their own.

The balances of the rollers behind span k add up to one in which the tensions between them cancel (each roller with its
m, τ, R as in `hilbench.estimation.web_line.balance`):

    Σ m_j·v_j' = Σ (i/r)_j·τ_j − Σ R_j(v_j) + F_next − F_k,      j = k+1 … N

The left side is that of their centre of mass, exactly, however they swing against each other. So each span has a
balance of its own, which a change in no other span disturbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hilbench.estimation.web_line.balance import mass_at_web_kg, web_force_N
from hilbench.plant.parameters import DriveParameters, EffectEntry, per_item
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.parameters import ModelParameters


@dataclass(frozen=True, slots=True)
class _Roller:
    p: Vector  #: of the roller and the one before it
    mass_kg: float  #: at the web


class Rollers:
    """The rollers of a line behind the first, on measured motion and torque.

    Raises ValueError for a model without a web.
    """

    def __init__(self, model: ModelParameters) -> None:
        self._rollers = []
        for axis in range(2, model.axis_count + 1):
            p = lay.pack(two_rollers(model, axis - 1))
            self._rollers.append(_Roller(p, mass_at_web_kg(p)))
        self._positions_m: list[float] | None = None
        self._forces_N = [0.0] * len(self._rollers)

    def reset(self) -> None:
        """The next positions are the first."""
        self._positions_m = None

    def update(self, positions_m: Sequence[float], torques_Nm: Sequence[float], duration_s: float) -> None:
        """The rollers are at these positions (N,) at the web, with these torques (N,) at the motors, `duration_s`
        after the last."""
        x_m = list(positions_m[1:])
        before_m = self._positions_m or x_m
        self._positions_m = x_m
        self._forces_N = [
            float(web_force_N(roller.p, torque_Nm, x, (x - before) / duration_s, 0.0))
            for roller, x, before, torque_Nm in zip(self._rollers, x_m, before_m, torques_Nm[1:], strict=True)
        ]

    def masses_behind_kg(self, axis: int) -> list[float]:
        """At the web, of the rollers behind that of `axis`, from 2."""
        return [roller.mass_kg for roller in self._rollers[axis - 1 :]]

    def force_behind_N(self, axis: int) -> float:
        """Force at the web of the motors behind that of `axis`, from 2, less their rollers' resistance."""
        return sum(self._forces_N[axis - 1 :])

    def centre_m(self, axis: int) -> float:
        """Position of the centre of mass of the roller of `axis`, from 2, and all behind it, at the web."""
        assert self._positions_m is not None, "asked for before the first positions"
        moments, total_kg = 0.0, 0.0
        for roller, x_m in zip(self._rollers[axis - 2 :], self._positions_m[axis - 2 :], strict=True):
            moments += roller.mass_kg * x_m
            total_kg += roller.mass_kg
        return moments / total_kg


def two_rollers(model: ModelParameters, span: int, masses_behind_kg: Sequence[float] = ()) -> ModelParameters:
    """Rollers `span` and `span + 1` of a line and the span between them, as a model of its own.

    `masses_behind_kg`: at the web, of rollers further behind that turn with the second.
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
    data["boundary"]["upstream_strain"] = model.upstream_strain
    data["effects"] = [
        _moved(entry, span).model_dump()
        for entry in model.effects
        if (entry.axis is None or entry.axis in around) and entry.span in (None, span)
    ]
    return ModelParameters.model_validate(data)


def _limits_Nm(model: ModelParameters, drives: DriveParameters, span: int) -> list[float]:
    """Torque limits before the span, and of all that is behind it, at the first motor there."""
    behind = range(span + 1, model.axis_count + 1)
    force_N = sum(per_item(drives.torque_limit_Nm, axis) * model.motor_rad_per_m(axis) for axis in behind)
    return [per_item(drives.torque_limit_Nm, span), force_N / model.motor_rad_per_m(span + 1)]


def _moved(entry: EffectEntry, span: int) -> EffectEntry:
    axis = None if entry.axis is None else entry.axis - span + 1
    return entry.model_copy(update={"axis": axis, "span": None})
