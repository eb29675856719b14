"""Closed model: drives, rollers and web of a line, advanced in step with the bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from hilbench.compiled import Vector, record_at
from hilbench.plant.effect import Domain
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.interface import Quantity, checked_name
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line import laws, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.modes import needed_substeps
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import (
    KIND,
    YOUNGS_MODULUS,
    CarriagePush,
    FurtherState,
    SimulatedLine,
    checked_positive,
    moduli_by_name,
    modulus_names,
)
from hilbench.plant.web_line.splices import WHOLE, SplicedSpan, has_pieces, spliced_spans
from hilbench.plant.web_line.stations import Reel, force_input, reel_name


class Line(SimulatedLine):
    """N driven rollers and all else that the web runs over, with spans of web between; motor k drives roller k by port
    k.

    Starts at rest, with every span strained as the web that enters. `step` takes the set points from the ports and
    writes the feedback to them; without ports every motor is off. Parameters may change between calls; a change of E
    leaves the strains, so the tensions jump. `substeps`: integration steps per sample time of the drives; by default as
    many as the line needs.

    Raises ValueError for ports that do not fit, or ports on a model without drives.
    """

    def __init__(
        self, parameters: ModelParameters, ports: Sequence[MotorPort] | None = None, *, substeps: int | None = None
    ):
        if ports is not None and (parameters.drives is None or len(ports) != parameters.axis_count):
            raise ValueError(f"{len(ports)} ports, expected a model with drives and {parameters.axis_count} axes")
        self.parameters = parameters
        p = lay.pack(parameters, needed_substeps(parameters) if substeps is None else substeps)
        lay.check_play(p)
        effects = [effect for effect in effects_of(KIND) if parameters.web is not None or effect.per_axis]
        super().__init__(
            p,
            start_state(p, parameters),
            ports or (),
            "m",
            [effect.id for effect in effects],
            _values(parameters),
            _further_states(parameters),
            _radii(parameters),
            _forces(parameters),
        )
        self._moduli = moduli_by_name(self._p)
        self.set_boundary(parameters.upstream_strain, parameters.boundary.downstream_tension_N)
        self.changes_elasticity = any(_acts_on_elasticity(entry.effect) for entry in parameters.effects)
        self._observe()

    @property
    def moduli(self) -> Vector:
        """Parameter index of E of each span (K,)."""
        layout = self._layout
        places = layout.first_span + lay.SP_SIZE * np.arange(layout.spans, dtype=float)
        return np.asarray(places + lay.column(lay.SPAN, "modulus_Pa"))

    @property
    def moduli_Pa(self) -> Vector:
        """View of E of each span (K,), without effects: a change acts at once, outputs follow with the next call."""
        return self._moduli[YOUNGS_MODULUS.name]

    @property
    def further_places(self) -> list[int]:
        """Indices of the states of parts without a motor (positions and speeds) in the integrated quantities."""
        return [each.place for each in self._further]

    def set_boundary(self, strain_prev: float, F_next_N: float) -> None:
        """Set the boundary inputs of these names from now on."""
        self._inputs[0], self._inputs[1] = strain_prev, F_next_N

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        modulus_Pa = self._moduli.get(name)
        return super().parameter(name) if modulus_Pa is None else float(modulus_Pa.item(0))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        modulus_Pa = self._moduli.get(name)
        if modulus_Pa is not None:  # in every cycle of a twin
            modulus_Pa[:] = checked_positive(name, value, "Pa")
            return
        checked_name("parameter", name, self._description.parameters)
        axis = list(self._parameters).index(name) + 1  # the inertias come first
        self._set_inertia(name, value, axis, value / self.parameters.radius_m(axis) ** 2)

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect's parameters from now on; strain and motion stay. Raises as `SimulatedLine`."""
        super().set_effect(effect_id, axis, section=section, slot=slot, **parameters)
        self.changes_elasticity |= _acts_on_elasticity(effect_id)

    def elasticity_factor(self, span: int) -> float:
        """Present factor on E of a span (from 1) by effects, including a splice in it; 1 without any."""
        if not self.changes_elasticity:
            return 1.0
        return elasticity_factor(self._p, span, self.time_s) * self.spliced_spans[span - 1].factor

    @property
    def spliced_spans(self) -> list[SplicedSpan]:
        """Effect of the pieces of other web on each span (K,)."""
        n, k, y = self._layout.axes, self._layout.spans, self._layout.y(self._state)
        if not has_pieces(self._state):
            return [WHOLE] * k
        web, first = record_at(self._p, lay.WEB), self._layout.axis_rows(self._p)[0]
        stretch = 1.0 + float(laws.upstream_strain(web, self._inputs[0], self.time_s))
        travel_m = float(reels.web_travel_m(first, y[0]))
        return spliced_spans(self._state, travel_m, stretch, y[4 * n : 4 * n + k].tolist())

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,), with the present E."""
        self._refresh()
        return self._out[self._layout.columns["F_N"]].copy()

    @property
    def shown_tensions_N(self) -> list[float]:
        """Tensions (K,) at the motors' last feedback, after a step or a change of the state."""
        tensions_N: list[float] = self._out[self._layout.columns["F_N"]].tolist()
        return tensions_N

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,)."""
        return self._out[self._layout.columns["strain"]].copy()

    @property
    def x_m(self) -> Vector:
        """Motor positions at the web (N,): angle × nominal radius / gear ratio."""
        return self._out[self._layout.columns["x_m"]][list(self._driven)]

    @property
    def v_m_s(self) -> Vector:
        """Motor speeds at the web (N,)."""
        return self._out[self._layout.columns["v_m_s"]][list(self._driven)]


def _values(parameters: ModelParameters) -> dict[Quantity, float]:
    """Changeable parameters with their values: the rollers' inertias, then E where there is a web."""
    inertia = parameters.rollers.inertia_kg_m2
    values = {
        Quantity(f"roller_inertia{k}_kg_m2", "kg·m²", f"of roller {k} about its own shaft"): per_item(inertia, k)
        for k in range(1, parameters.axis_count + 1)
    }
    if parameters.web is not None:
        moduli = moduli_by_name(lay.pack(parameters))
        values |= {known: moduli[known.name].item(0) for known in modulus_names(parameters.span_count)}
    return values


def _further_states(parameters: ModelParameters) -> list[FurtherState]:
    """States of speeds of rollers without a motor, and position and speed of carriages, in the direction of the web."""
    rollers, carriages = parameters.line_rollers, parameters.carriages
    axes = len(rollers) + len(carriages)
    found = [
        FurtherState(Quantity(f"v_{roller.name}_m_s", "m/s", f"speed of {roller.name} at the web"), axes + row)
        for row, roller in enumerate(rollers)
        if roller.axis is None
    ]
    for row, carriage in enumerate(carriages, len(rollers)):
        name = carriage.station.name
        where = "position of the carriage, positive where it lengthens the web"
        found.append(FurtherState(Quantity(f"x_{name}_m", "m", f"{where}: {name}"), row))
        found.append(FurtherState(Quantity(f"v_{name}_m_s", "m/s", f"speed of the carriage: {name}"), axes + row))
    return found


def _radii(parameters: ModelParameters) -> dict[Quantity, Callable[[Vector], float]]:
    """Radius outputs of the reels."""
    found: dict[Quantity, Callable[[Vector], float]] = {}
    rows = lay.Layout.of(p := lay.pack(parameters)).axis_rows(p)
    for row, roller in enumerate(parameters.line_rollers):
        if isinstance(roller.station, Reel):
            quantity = Quantity(f"r_{reel_name(roller.station)}_m", "m", f"radius of the {roller.station.type}")
            found[quantity] = partial(_radius_m, rows[row].copy(), row)
    return found


def _radius_m(reel: Any, place: int, y: Vector) -> float:
    """Radius of a reel by the row of its axis and its position at `place` of the integrated quantities."""
    return float(reel.radius_m * reels.radius_ratio(reel, y[place]))


def _forces(parameters: ModelParameters) -> dict[Quantity, CarriagePush]:
    """Force inputs of the carriages, with the force that an effect adds."""
    found, rollers = {}, len(parameters.line_rollers)
    rows = lay.Layout.of(p := lay.pack(parameters)).axis_rows(p)
    for row, carriage in enumerate(parameters.carriages, rollers):
        station = carriage.station
        quantity = Quantity(force_input(station.name), "N", f"that pushes the carriage: {station.name}")
        place = lay.W_SIZE + row * lay.A_SIZE + lay.column(lay.AXIS, "force_N")
        found[quantity] = CarriagePush(place, float(rows[row].force_N) - station.force_N)
    return found


def _acts_on_elasticity(effect_id: str) -> bool:
    return find_effect(effect_id).domain is Domain.ELASTICITY


def elasticity_factor(p: Vector, span: int, time_s: float) -> float:
    """Factor on E of a span, from 1, at a time by the effects in a parameter vector (P,), without a splice."""
    row = lay.Layout.of(p).span_rows(p)[span - 1]
    factor = laws.step_factor(row, time_s, p[lay.W_SAMPLE_TIME_S])
    return float(laws.elasticity_factor(row, time_s, factor))
