"""Checks of a web line before anything starts: set-points, stability, resolution of the drives' units in tension."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from hilbench.bench.tasks.emulated_web import emulated_web
from hilbench.bench.tasks.tension_loop import Moduli, OperatingPoint, TensionLoop
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import declared_units
from hilbench.exchange.nodes import Nodes
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.plant.web_line.stability import largest_stiffness_Nm_per_rad, sampled_shaft
from hilbench.strict_yaml import Document, Location
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role

#: Share of the usual tension that one unit of a drive may represent without a note.
_COARSE = 0.0125
#: Relative difference of E that is negligible.
SAME_MODULUS = 0.01


def check_web_line(config: BenchConfig, document: Document, nodes: Nodes) -> list[str]:
    """Notes of what can be run, and will not be good.

    Raises UnusableInputError for a set-point beyond its trip level, or a loop that is unstable from the start.
    """
    _check_set_point(config, document)
    check_stability(config, document, start_point(config), ("machine", "web"))
    return [*_coarse_units(config, nodes), *_unmatched_loads(config), *_slow_stop(config)]


def _check_set_point(config: BenchConfig, document: Document) -> None:
    """A set-point that no run can reach."""
    trip_N = config.safety.limits.tension_N.trip
    for span, control in config.set_point_controls.items():
        name = config.controller_of(span)
        if trip_N is not None and control.set_point_N > trip_N:
            raise UnusableInputError(
                document.place(("controllers", name, "set_point_N")),
                f"set_point_N is {control.set_point_N:g}, expected less than the trip level of the tension, "
                f"{trip_N:g} N",
            )


def _slow_stop(config: BenchConfig) -> list[str]:
    """Note on the axis that keeps a line from stopping as fast as configured."""
    asked, found = config.safety.quick_stop_m_s2, config.quick_stop_per_s2
    if not found < asked:
        return []
    slowest = min(range(1, config.shape.axes + 1), key=config.fastest_m_s2)
    return [
        f"axis {slowest} has not the torque for a quick stop by {asked:g} m/s²: all axes stop together by "
        f"{found:.3g} m/s²"
    ]


def _unmatched_loads(config: BenchConfig) -> list[str]:
    """Axes of the simulated hardware at which the twin's machine and the stand differ in whether the web pulls.

    Of two rollers the first alone is needed to keep a tension; its load is left out more often than not.
    """
    notes, loaded = [], config.loaded_axes
    for part in config.parts_of(Role.AXIS):
        axis = part.axis or 1
        pulled = config.web_line.carries_web_load(axis)
        if part.is_simulated and pulled and axis not in loaded:
            notes.append(
                f"{part.name}: by machine: web_load the web loads axis {axis}, and no load motor on its shaft "
                f"emulates that: the twin simulates a load that is not there"
            )
        if axis in loaded and not pulled:
            notes.append(
                f"{part.name}: the load motor on its shaft has no web to emulate, as machine: web_load says that the "
                f"web does not load axis {axis}"
            )
    return notes


def _coarse_units(config: BenchConfig, nodes: Nodes) -> list[str]:
    """Notes on axes whose unit of position or velocity is coarse in web tension, compared to the usual one."""
    model, notes = config.web_line, []
    for part in config.parts_of(Role.AXIS):
        axis = part.axis or 1
        units = declared_units(part)
        rad_per_m = model.motor_rad_per_m(axis)
        beside, coarse_N = spans_beside(model, axis), _COARSE * machine_sizes(model, axis).force_N
        stiffest_N_per_m = max(model.stiffness_N(span) / model.span_length_m(span) for span in beside)
        position_N = stiffest_N_per_m * units.position_rad / rad_per_m
        if position_N > coarse_N:
            notes.append(f"{part.name}: one unit of position (6064h) stands for {position_N:.3g} N of web tension")
        # Steady tension changes by E·S·Δv/v; the slowest that the line is meant to run at would be worse than 1 m/s.
        velocity_N = max(map(model.stiffness_N, beside)) * units.velocity_rad_s / rad_per_m
        if velocity_N > coarse_N:
            notes.append(
                f"{part.name}: one unit of velocity (60FFh) moves the web tension by {velocity_N:.3g} N at 1 m/s"
            )
    return notes


def start_point(config: BenchConfig) -> OperatingPoint:
    """The tension loop when the drives are enabled, with the E that the twin begins with."""
    model, spans = config.web_line, range(1, config.shape.spans + 1)
    web = emulated_web(model, config.load)
    moduli_Pa, estimates_Pa = (tuple(map(of.youngs_modulus_Pa, spans)) for of in (web, model))
    return OperatingPoint(moduli_Pa, 0.0, (1.0,) * len(spans), estimates_Pa)


def check_stability(config: BenchConfig, document: Document, point: OperatingPoint, where: Location) -> None:
    """Raise UnusableInputError at `where` in the config when web, drives, bus and twin are unstable at this point."""
    cycle = f"a cycle of {config.cycle_time_s * 1e3:g} ms"
    if config.shape.has_stations:
        _check_stiffness(config, document, point, where)
        return
    if not TensionLoop(config, point, closed=False).stable:
        share = min(stiffness_reserves(config, point).values(), default=inf)
        raise UnusableInputError(
            document.place(where),
            f"the load motor can't emulate so stiff a web over {cycle} ({operating_point_text(point)}): the loop of "
            f"web and sampled shaft is by itself stable up to {100 * share:.0f} % of it, expected a shorter cycle, a "
            f"heavier axis {' or '.join(map(str, config.loaded_axes))}, or a softer or longer web",
        )
    if not TensionLoop(config, point).stable:
        span, fastest = max(config.tension_controls.items(), key=lambda entry: entry[1].bandwidth_rad_per_s)
        name = config.controller_of(span)
        raise UnusableInputError(
            document.place(("controllers", name, "bandwidth_rad_per_s")),
            f"the tension loop is unstable with {fastest.bandwidth_rad_per_s:g} rad/s over {cycle} at "
            f"{operating_point_text(point)}, expected a smaller bandwidth_rad_per_s, more swing_damping_ratio or a "
            f"shorter cycle",
        )


def operating_point_text(point: OperatingPoint) -> str:
    """An operating point as a message names it."""
    text = f"E {_moduli_text(point.moduli_Pa)} N/mm²"
    if not alike(point.estimates_Pa, point.moduli_Pa):
        text += f" (believed: {_moduli_text(point.estimates_Pa)})"
    return f"{text}, {point.line_speed_m_s:g} m/s"


def alike(some: Moduli, others: Moduli) -> bool:
    """True if E of the spans differs only negligibly."""
    return all(abs(one / other - 1.0) <= SAME_MODULUS for one, other in zip(some, others, strict=True))


def _moduli_text(moduli_Pa: Moduli) -> str:
    """Text of the moduli; a single number where all spans have the same."""
    return ", ".join(dict.fromkeys(f"{modulus * 1e-6:.4g}" for modulus in moduli_Pa))


def _check_stiffness(config: BenchConfig, document: Document, point: OperatingPoint, where: Location) -> None:
    """Check each load motor by itself, with the rollers next to its own held: the stiffest case."""
    for axis, reserve in stiffness_reserves(config, point).items():
        if reserve < 1.0:
            raise UnusableInputError(
                document.place(where),
                f"the load motor of axis {axis} can't emulate so stiff a web over a cycle of "
                f"{config.cycle_time_s * 1e3:g} ms ({operating_point_text(point)}): it is stable up to "
                f"{100 * reserve:.0f} % of it where adjacent rollers are at standstill, expected a shorter cycle, a "
                f"heavier axis {axis}, or a softer or longer adjacent web",
            )


def stiffness_reserves(config: BenchConfig, point: OperatingPoint) -> dict[int, float]:
    """Stiffness reserve by axis: largest web stiffness that its load motor emulates stably, over the emulated one.

    Of driven rollers alone, which swing against each other, each is held by the stiffness of their stiffest mode; with
    other rollers between them by the spans next to it. Empty without load motors.
    """
    model = config.web_line
    loaded = [axis for axis in config.loaded_axes if model.carries_web_load(axis)]
    if not loaded:
        return {}
    stiffness_N_per_m = _stiffness_of_spans(config, point)
    if config.shape.has_stations:
        held_N_per_m = {axis: sum(stiffness_N_per_m[span - 1] for span in spans_beside(model, axis)) for axis in loaded}
    else:
        stiffest_per_s2 = _stiffest_mode_per_s2(model, loaded, stiffness_N_per_m)
        held_N_per_m = {axis: stiffest_per_s2 * model.mass_kg(axis) for axis in loaded}
    reserves = {}
    for axis in loaded:
        shaft = sampled_shaft(model, axis, cycle_s=config.cycle_time_s)
        asked_Nm_per_rad = held_N_per_m[axis] / model.motor_rad_per_m(axis) ** 2
        reserves[axis] = largest_stiffness_Nm_per_rad(shaft, emulation_delay_s(shaft)) / asked_Nm_per_rad
    return reserves


def spans_beside(model: ModelParameters, axis: int) -> tuple[int, ...]:
    """The spans, from 1, that end at the roller of a driven axis."""
    row = next(row for row, roller in enumerate(model.line_rollers) if roller.axis == axis)
    return tuple(span for span in (row, row + 1) if 1 <= span <= model.span_count)


def _stiffness_of_spans(config: BenchConfig, point: OperatingPoint) -> list[float]:
    """E·S/L of each emulated span, N/m."""
    web = emulated_web(config.web_line, config.load)
    return [
        modulus_Pa * web.section_m2(span) / (web.span_length_m(span) * factor)
        for span, (modulus_Pa, factor) in enumerate(zip(point.moduli_Pa, point.length_factors, strict=True), 1)
    ]


def _stiffest_mode_per_s2(model: ModelParameters, loaded: Sequence[int], stiffness_N_per_m: Sequence[float]) -> float:
    """Square of the fastest angular frequency of the loaded rollers on their spans, with the others held."""
    between = np.zeros((model.axis_count, model.axis_count))
    for span, stiffness in enumerate(stiffness_N_per_m):
        between[span : span + 2, span : span + 2] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    at = [axis - 1 for axis in loaded]
    per_root_kg = np.array([model.mass_kg(axis) ** -0.5 for axis in loaded])
    return float(np.linalg.eigvalsh(per_root_kg[:, None] * between[np.ix_(at, at)] * per_root_kg)[-1])
