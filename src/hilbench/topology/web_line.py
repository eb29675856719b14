"""A web line: its shape, signals, quantities and process data (part `topology` of a kind of machine)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any, Final

from hilbench.estimation.web_line.config import METHODS as METHODS
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.web_line.parameters import LARGEST_MODULUS_Pa, LEAST_MODULUS_Pa, ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans, first_spans
from hilbench.plant.web_line.stations import ONLY_DRIVEN, Accumulator, Dancer, Idler, Reel, reel_name
from hilbench.topology.blocks import LoadShaftConfig, TwinConfig
from hilbench.topology.main_quantities.web_line import SMALLEST as SMALLEST
from hilbench.topology.main_quantities.web_line import main_quantities as main_quantities
from hilbench.topology.process_data.web_line import process_data as process_data
from hilbench.topology.quantities import LINE_SPEED, MODEL_CHANGE, Permitted
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import (
    CarriageForceConfig,
    CompensationConfig,
    ControllerConfig,
    PositionControlConfig,
    ReelControlConfig,
    TensionControlConfig,
    controller_misfits,
    estimate_misfits,
    forces_ahead,
    load_cells,
    loops_of,
    reel_axes,
    rest_misfit,
    span_beside_reel,
    station_names,
)
from hilbench.topology.web_line_quantities import TENSION_PROBE, TENSION_SET_POINT, WEB_BROKEN, YOUNGS_MODULUS
from hilbench.topology.web_line_signals import WEB_LINE

if TYPE_CHECKING:
    from hilbench.topology.config import BenchConfig


def web_line_shape(
    machine: ModelParameters,
    load_motors: tuple[str, ...],
    twin: EstimationConfig,
    controllers: Iterable[ControllerConfig],
    measured: Sequence[str],
) -> Shape:
    """Shape of a line with these load motors, this twin, these controllers, and sensors of these stations."""
    given = tuple(controllers)
    controlled = tuple(sorted(each.span for each in loops_of(TensionControlConfig, given)))
    if machine.stations is None:
        spans = machine.span_count
        return Shape(machine.axis_count, load_motors, spans, tuple(twin.by_span(spans)), controlled)
    positioned = tuple(each.station for each in loops_of(PositionControlConfig, given))
    torqued = tuple(sorted(reel_axes(machine).get(each.reel, 1) for each in loops_of(ReelControlConfig, given)))
    controlled = tuple(sorted({*controlled, *(span_beside_reel(machine, axis) for axis in torqued)}))
    shape = _with_stations(machine, load_motors, controlled, torqued, measured)
    return replace(shape, positioned=positioned, pushed=tuple(forces_ahead(given)))


def sensors_at_start(machine: ModelParameters, shape: Shape) -> dict[str, float]:
    """Sensor values of carriages and reels, m, and load cells, N, in the line's initial state, by signal."""
    found = {carriage.station.name: carriage.station.position_m for carriage in machine.carriages}
    for row, roller in enumerate(machine.line_rollers):
        if isinstance(roller.station, Reel) and roller.axis is not None:
            found[reel_name(roller.station)] = machine.radius_m(roller.axis)
        elif isinstance(roller.station, Idler):
            stiffness_N = [machine.stiffness_N(span) for span in (row, row + 1)]
            found[roller.station.name] = machine.upstream_strain * sum(stiffness_N) / 2.0
    return {signal: found[name] for name, signal in shape.sensors}


def forces_at_start(machine: ModelParameters, shape: Shape) -> dict[str, float]:
    """Initial force on the carriages whose force is sent ahead, before any is sent, N, by signal."""
    found = {carriage.station.name: carriage.station.force_N for carriage in machine.carriages}
    return {signal: found[name] for name, signal in shape.forces}


def _with_stations(
    machine: ModelParameters,
    load_motors: tuple[str, ...],
    controlled: tuple[int, ...],
    torqued: tuple[int, ...],
    measured: Sequence[str],
) -> Shape:
    """Shape of a line with more than driven rollers: the twin publishes one tension of each section, and of each
    controller."""
    before, rollers = axes_before_spans(machine), machine.line_rollers
    of_controls = {before[span - 1] for span in controlled}
    others = [span for span in first_spans(machine) if before[span - 1] not in of_controls]
    return Shape(
        machine.axis_count,
        load_motors,
        machine.span_count,
        controlled,
        controlled,
        axes_before=before,
        listed=tuple(sorted([*controlled, *others])),
        carriages=tuple(carriage.station.name for carriage in machine.carriages),
        reels=tuple(reel_name(roller.station) for roller in rollers if isinstance(roller.station, Reel)),
        measured=tuple(measured),
        torqued=torqued,
        cells=tuple(name for name in load_cells(machine) if name in measured),
        winds=isinstance(rollers[-1].station, Reel),
    )


SIGNALS: Final = WEB_LINE
QUANTITIES: Final = {
    LINE_SPEED: Permitted(-100.0, 100.0, "m/s"),
    TENSION_SET_POINT: Permitted(0.0, 1e5, "N"),
    YOUNGS_MODULUS: Permitted(LEAST_MODULUS_Pa, LARGEST_MODULUS_Pa, "Pa"),
    WEB_BROKEN: Permitted(0.0, 1.0, "1", only_ends=True),
    TENSION_PROBE: Permitted(0.0, 1.0, "1", only_ends=True),
    MODEL_CHANGE: Permitted(0.0, 1.0, "1", only_ends=True),
}
TWIN_KEYS: Final = frozenset(TwinConfig.model_fields) - {"inertia", "prediction", "live_diagnosis"}


def boundary(machine: ModelParameters, shape: Shape) -> Mapping[str, float]:
    """Web that comes in and goes out, sensors, forces on carriages."""
    of_web = {"strain_prev": machine.upstream_strain, "F_next_N": machine.boundary.downstream_tension_N}
    return of_web | sensors_at_start(machine, shape) | forces_at_start(machine, shape)


def shape(config: BenchConfig) -> Shape:
    """Spans, and which of them are estimated and controlled; stations."""
    twin, controllers = config.twin, config.controllers.values()
    return web_line_shape(config.web_line, tuple(config.load_motors), twin, controllers, config.load.measured)


def build(config: BenchConfig) -> None:
    """Build hardware and emulated machine. Raises ValueError for what can't be built."""
    config.rig_parameters()


def misfits(key: str, value: Any, machine: Any) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this line."""
    if key == "controllers":
        if not value:
            yield "at least one"
        yield from controller_misfits(value.values(), machine.span_count)
    if key == "twin":
        yield from estimate_misfits(value, machine)
    if key == "load":
        yield from value.web.misfits(machine.span_count)
    if (key == "load" and value.shaft != LoadShaftConfig()) or (key == "hardware" and value.shaft):
        yield "no 'shaft:', which is of a servo axis (machine: {kind: servo_axis})"


def whole_misfits(config: BenchConfig) -> Iterator[str]:
    """Why a line can't have these controllers, sensors, and this twin."""
    machine, measured = config.web_line, config.load.measured
    if machine.drives is None or machine.web is None:
        yield "a machine with 'web:' and 'drives:'"
    yield from filter(None, [None if machine.stations is None else _stations_misfit(config)])
    yield from filter(None, [_measured_misfit(measured, machine)])
    yield from filter(None, [_loops_misfit(config)])
    yield from filter(None, [rest_misfit(config.twin, machine, config.controllers.values(), measured)])


def _loops_misfit(config: BenchConfig) -> str | None:
    """Why positions and tensions of a line can't be kept by its controllers, in one line, or None."""
    machine, measured, given = config.web_line, config.load.measured, config.controllers.values()
    carriages = {carriage.station.name: carriage for carriage in machine.carriages}
    before, tensions = axes_before_spans(machine), loops_of(TensionControlConfig, given)
    sections = [before[control.span - 1] for control in tensions]
    for control in loops_of(PositionControlConfig, given):
        carriage = carriages.get(control.station)
        if carriage is None:
            known = ", ".join(carriages) or "none here"
            return f"the position of a dancer or accumulator ({known}), '{control.station}' is none"
        if control.station not in measured:
            return f"'load: {{measured: [{control.station}]}}' for the loop of its position"
        station = carriage.station
        lowest_m = -inf if station.lower_stop_m is None else station.lower_stop_m
        highest_m = inf if station.upper_stop_m is None else station.upper_stop_m
        if control.set_point_m is not None and not lowest_m < control.set_point_m < highest_m:
            ends = f"{lowest_m:g} to {highest_m:g} m"
            return f"a set-point between the stops of '{control.station}', {ends}, not {control.set_point_m:g} m"
        if (misfit := _force_misfit(station, control.force)) is not None:
            return misfit
        sections.append(before[carriage.first_span - 1])
    axes = reel_axes(machine)
    for torqued in loops_of(ReelControlConfig, given):
        if torqued.reel not in axes:
            return f"a reel in torque mode ({', '.join(axes) or 'none here'}), '{torqued.reel}' is none"
        cells = [cell for cell in load_cells(machine) if cell in measured]
        if torqued.load_cell not in cells:
            return (
                f"an idler with 'load: {{measured: [{torqued.load_cell}]}}' as the load cell of '{torqued.reel}' "
                f"({', '.join(cells) or 'none here'}), '{torqued.load_cell}' is none"
            )
        sections.append(before[span_beside_reel(machine, axes[torqued.reel]) - 1])
    if len(set(sections)) < len(sections):
        return "one controller between two driven rollers: one axis can keep one tension, or one position"
    kept = {before[control.span - 1] for control in tensions}
    for roller in machine.line_rollers:
        if isinstance(roller.station, Reel) and kept & {roller.axis, (roller.axis or 0) - 1}:
            name = reel_name(roller.station)
            if name not in measured:
                return f"'load: {{measured: [{name}]}}' for the loop of the tension beside it: its radius changes"
    return None


def _force_misfit(station: Dancer | Accumulator, force: CarriageForceConfig | None) -> str | None:
    """Reason why a force can't be sent ahead to a carriage, in one line, or None."""
    if force is None:
        return None
    tension_N = force.tension_N(station)
    if not tension_N > 0.0:
        return (
            f"'set_point_N' in the 'force' of '{station.name}', or a 'force_N' of the machine that keeps a tension, "
            f"not {station.force_N:g} N"
        )
    held_N = station.held_by_N(tension_N, station.position_m)
    if held_N < 0.0 or (force.limit_N is not None and held_N > force.limit_N):
        most = "" if force.limit_N is None else f" to {force.limit_N:g}"
        return (
            f"a 'force' of '{station.name}' from 0{most} N for a tension of {tension_N:g} N, which takes {held_N:g} N"
        )
    return None


def _stations_misfit(config: BenchConfig) -> str | None:
    """Why a bench can't have the stations of its machine, in one line, or None."""
    rollers, controllers = config.web_line.line_rollers, config.controllers.values()
    if rollers[0].axis is None or rollers[-1].axis is None:
        return "'stations' that begin and end with a driven roller or reel"
    ahead = [key for key in ("prediction", "live_diagnosis", "splices") if getattr(config.twin, key)]
    if ahead:
        return f"no '{ahead[0]}' on a line with 'stations:', or {ONLY_DRIVEN}"
    probes = [control.probes for control in loops_of(TensionControlConfig, controllers)]
    if any(probing.mode != "off" or probing.at_rest_mm for probing in probes):
        return f"no 'probing' on a line with 'stations:', or {ONLY_DRIVEN}"
    if loops_of(CompensationConfig, controllers):
        return f"no 'compensate' on a line with 'stations:', or {ONLY_DRIVEN}"
    twice = [name for name in station_names(config.web_line) if name in {*config.drives, *config.load_motors}]
    return f"names that differ: a station and another part are both named {twice[0]}" if twice else None


def _measured_misfit(measured: Sequence[str], machine: ModelParameters) -> str | None:
    """Why a line can't have sensors of these stations, or None."""
    known = (*station_names(machine), *load_cells(machine))
    unknown = [name for name in measured if name not in known]
    if not unknown:
        return None
    expected = f"'load.measured' of dancers, accumulators, reels and idlers ({', '.join(known) or 'none here'})"
    return f"{expected}, not {unknown[0]}"
