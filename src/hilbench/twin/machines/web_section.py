"""What of a line shows E of one of its spans: the roller before it, and all that is behind it as one roller.

The balances of the rollers behind span k add up to one in which the tensions between them cancel (each roller with its
m, τ, R as in `hilbench.estimation.web_line.balance`):

    Σ m_j·v_j' = Σ (i/r)_j·τ_j − Σ R_j(v_j) + F_next − F_k,      j = k+1 … N

They are accelerated alike but for what the strains change by, so that together they are a roller of mass Σ m_j at
roller k+1, with a motor that has the torques of all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import DriveParameters, EffectEntry, per_item
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import YOUNGS_MODULUS


class WebSection:
    """Rollers `span` and those behind it of a line, as a line of two rollers (see `TrackedLine`, `SimulatedMotor`).

    `ports` (N,): of the line's motors. Of a line of two rollers it is the line as it is. Raises ValueError for a model
    without a web.
    """

    def __init__(self, model: ModelParameters, line: Line, ports: Sequence[MotorPort], span: int) -> None:
        self._line = line
        self._span = span
        per_m = model.motor_rad_per_m(span + 1)
        #: The motors behind the span: port, torque at the first of them per torque at each.
        self._motors = [
            (port, model.motor_rad_per_m(axis) / per_m) for axis, port in enumerate(ports, 1) if axis > span
        ]
        #: The balances of the rollers behind the first of them; the first one's is that of the section.
        self._balances = [
            MeasuredBalance(two_rollers(model, axis - 1)) for axis in range(span + 2, model.axis_count + 1)
        ]
        self._per_m = per_m
        own_Pa = model.youngs_modulus_Pa(span)
        #: E of each span over that of the section, by the model: the web changes as one.
        self._moduli = {
            f"span{k}.youngs_modulus_Pa": model.youngs_modulus_Pa(k) / own_Pa for k in range(1, model.span_count + 1)
        }
        self.model = two_rollers(model, span, [balance.mass_kg for balance in self._balances])

    def reset(self) -> None:
        """The next measured torques start anew."""
        for balance in self._balances:
            balance.reset()

    def measured_torque_Nm(
        self, positions_m: Sequence[float], torques_Nm: Sequence[float], strain: float, cycle_s: float
    ) -> float:
        """The torque of all motors behind the span, as if the first had it.

        `positions_m` (N,) at the web, `torques_Nm` (N,), as measured; `strain`: of the web, about.
        """
        total_Nm = torques_Nm[self._span]
        for at, balance in enumerate(self._balances, self._span + 1):
            found = balance.update(positions_m[at - 1], positions_m[at], torques_Nm[at], strain, 0.0, cycle_s)
            total_Nm += found.force_N / self._per_m
        return total_Nm

    @property
    def torque_Nm(self) -> float:
        """The same of the simulated motors, without the resistance of the rollers behind the first."""
        return sum(port.torque_Nm * share for port, share in self._motors)

    def parameter(self, name: str) -> float:
        """Of the line; E is that of the section's span."""
        if name == YOUNGS_MODULUS.name and len(self._moduli) > 1:
            name = f"span{self._span}.youngs_modulus_Pa"
        return self._line.parameter(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Of the line; E is that of the section's span, and the other spans' goes with it."""
        if name == YOUNGS_MODULUS.name and len(self._moduli) > 1:
            for of_span, ratio in self._moduli.items():
                self._line.set_parameter(of_span, ratio * value)
        else:
            self._line.set_parameter(name, value)

    def set_state(self, state: Mapping[str, float]) -> None:
        """States of the section, by the names that they have in a line of two rollers."""
        names = {"strain1": f"strain{self._span}"}
        for part in (1, 2):
            axis = self._span + part - 1
            names |= {f"x{part}_m": f"x{axis}_m", f"v{part}_m_s": f"v{axis}_m_s"}
        self._line.set_state({names[name]: value for name, value in state.items()})

    @property
    def strain(self) -> Vector:
        """Of the span (1,)."""
        return self._line.strain[self._span - 1 : self._span]

    @property
    def x_m(self) -> Vector:
        """Of the rollers around the span (2,)."""
        return self._line.x_m[self._span - 1 : self._span + 1]

    @property
    def v_m_s(self) -> Vector:
        """Of the rollers around the span (2,)."""
        return self._line.v_m_s[self._span - 1 : self._span + 1]


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
