"""Multiplicities of the parts of a web line's bench."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans, first_spans
from hilbench.plant.web_line.stations import Idler, Reel, reel_name
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import (
    ControllerConfig,
    PositionControlConfig,
    ReelControlConfig,
    TensionControlConfig,
    forces_ahead,
    load_cells,
    loops_of,
    reel_axes,
    span_beside_reel,
)


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
