"""The closed model: drives, rollers and web of a line, advanced in step with the bus."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.effects import Domain, effects_of, find_effect
from hilbench.plant.interface import Quantity, checked_name
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import KIND, SimulatedLine, modulus_names, modulus_Pa, set_modulus


class Line(SimulatedLine):
    """N driven rollers with N-1 spans of web between them; motor k drives roller k through port k.

    Starts at rest, with every span strained as the web that enters. `step` takes the set points from the ports
    and writes the feedback to them; without ports every motor is off. Parameters may change between calls; a change of
    E leaves the strains, so the tensions jump.
    Raises ValueError for ports that do not fit, or ports on a model without drives.
    """

    def __init__(self, parameters: ModelParameters, ports: Sequence[MotorPort] | None = None, *, substeps: int = 1):
        if ports is not None and (parameters.drives is None or len(ports) != parameters.axis_count):
            raise ValueError(f"{len(ports)} ports, expected a model with drives and {parameters.axis_count} axes")
        self.parameters = parameters
        p = lay.pack(parameters, substeps)
        effects = [effect for effect in effects_of(KIND) if parameters.web is not None or effect.per_axis]
        super().__init__(
            p, start_state(p, parameters), ports or (), "m", [effect.id for effect in effects], _values(parameters)
        )
        self._inputs[lay.U_STRAIN_PREV] = parameters.upstream_strain
        self._inputs[lay.U_F_NEXT_N] = parameters.boundary.downstream_tension_N
        self._elastic = any(_acts_on_elasticity(entry.effect) for entry in parameters.effects)
        self._observe()

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on. Raises ValueError for an unknown name or an impossible value."""
        names = [quantity.name for quantity in self._description.parameters]
        axis = names.index(checked_name("parameter", name, self._description.parameters)) + 1
        if axis <= self._layout.axes:
            self._set_inertia(name, value, axis, value / self.parameters.radius_m(axis) ** 2)
        else:
            set_modulus(self._p, name, value)
            self._parameters |= {
                known.name: modulus_Pa(self._p, known.name) for known in modulus_names(self._layout.spans)
            }

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, span: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Give an effect these parameters from now on; strain and motion stay. Raises as `SimulatedLine`."""
        super().set_effect(effect_id, axis, span=span, slot=slot, **parameters)
        self._elastic |= _acts_on_elasticity(effect_id)

    def elasticity_factor(self, span: int) -> float:
        """What the effects on E make of it now in a span (counted from 1); 1 without any."""
        if not self._elastic:
            return 1.0
        sample_s, time_s, row = self._p[lay.W_SAMPLE_TIME_S], self.time_s, self._layout.first_span
        row += (span - 1) * lay.SP_SIZE
        return float(laws.elasticity_factor(self._p, row, time_s, laws.step_factor(self._p, row, time_s, sample_s)))

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,), with the present E."""
        self._refresh()
        return self._out[self._layout.columns["F_N"]].copy()

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,)."""
        return self._out[self._layout.columns["strain"]].copy()

    @property
    def x_m(self) -> Vector:
        """Motor positions at the web (N,): angle × nominal radius / gear ratio."""
        return self._out[self._layout.columns["x_m"]].copy()

    @property
    def v_m_s(self) -> Vector:
        """Motor speeds at the web (N,)."""
        return self._out[self._layout.columns["v_m_s"]].copy()


def _values(parameters: ModelParameters) -> dict[Quantity, float]:
    """What can be changed while the line runs, with its values: the rollers' inertias, then E where there is a web."""
    inertia = parameters.rollers.inertia_kg_m2
    values = {
        Quantity(f"roller_inertia{k}_kg_m2", "kg·m²", f"of roller {k} about its own shaft"): per_item(inertia, k)
        for k in range(1, parameters.axis_count + 1)
    }
    if parameters.web is not None:
        p = lay.pack(parameters)
        values |= {known: modulus_Pa(p, known.name) for known in modulus_names(parameters.span_count)}
    return values


def _acts_on_elasticity(effect_id: str) -> bool:
    return find_effect(effect_id).domain is Domain.ELASTICITY
