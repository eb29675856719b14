"""What must hold before anything starts: EDS files, PDO maps, bus capacity, stability; errors name file and line."""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose

from hilbench.bench.tasks.imitated_web import imitated_web
from hilbench.bench.tasks.tension_loop import OperatingPoint, TensionLoop
from hilbench.can.load import BusLoad, cycle_load
from hilbench.cia402.configuration import lacking
from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes, declared_units, drive_settings
from hilbench.plant.effects import MachineKind
from hilbench.plant.sampled_shaft import imitation_delay_s
from hilbench.plant.servo_axis.stability import imitable_inertia_kg_m2
from hilbench.plant.servo_axis.stability import sampled_shaft as shaft_on_bus
from hilbench.plant.web_line.stability import (
    largest_stiffness_Nm_per_rad,
    sampled_shaft,
    web_stiffness_Nm_per_rad,
)
from hilbench.strict_yaml import Document, Location
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role

#: Web tension that one unit of a drive may stand for without a note, N.
_COARSE_N = 1.0
#: Relative difference of E that is none.
SAME_MODULUS = 0.01


@dataclass(frozen=True)
class CheckedBench:
    """What the check found."""

    load: BusLoad
    frames_per_cycle: float
    notes: list[str]  #: what can be run, and will not be good


def check_bench(config: BenchConfig, document: Document) -> CheckedBench:
    """Check a config as far as can be without a bus.

    Raises UnusableInputError with the place in the config when an EDS can't be used or lacks an object that is
    mapped, when the PDO set does not fit on the bus at worst, when the set-point is beyond its trip level, or when the
    loop through machine, drives, bus and twin is unstable from the start.
    """
    without_file = [
        UnusableInputError(document.place((*part.location, "eds")), f"no file {part.node.eds}, expected an EDS file")
        for part in config.parts
        if not part.node.eds.is_file()
    ]
    if without_file:
        raise UnusableInputError.of(without_file)
    try:
        nodes = Nodes(config)
    except (KeyError, ValueError) as error:
        raise UnusableInputError(document.place(("drives",)), f"PDO map: {error.args[0]!s}") from error
    except UnusableInputError as error:
        for part in config.parts:
            if error.place == part.label:
                raise UnusableInputError(document.place(part.location), error.problem) from error
        raise
    _check_drives(config, document, nodes)
    frames = nodes.cyclic_frames()
    load = cycle_load(frames, config.cycle_time_s, config.bus.bitrate)
    if load.fraction > 1.0:
        raise UnusableInputError(
            document.place(("bus", "bitrate")),
            f"the PDO set takes {load.bits:.0f} bit times of the {load.capacity_bits:.0f} in a cycle of "
            f"{config.cycle_time_s * 1e3:g} ms at {config.bus.bitrate} bit/s ({100 * load.fraction:.0f} %), "
            f"expected at most 100 %: a longer cycle, a higher bit rate or fewer PDOs",
        )
    notes: list[str] = []
    if config.machine_kind is MachineKind.SERVO_AXIS:
        place: Location = (
            ("load", "shaft", "inertia_kg_m2") if config.load.shaft.inertia_kg_m2 else ("machine", "shaft")
        )
        check_imitated_inertia(config, document, config.imitated_shaft().inertia_kg_m2, place)
    else:
        _check_set_point(config, document)
        check_stability(config, document, start_point(config), ("machine", "web"))
        notes = _coarse_units(config, nodes)
    return CheckedBench(load, sum(frame.per_cycle for frame in frames), notes)


def imitable_inertias_kg_m2(config: BenchConfig) -> tuple[float, float]:
    """The least and the largest inertia that the load motor of a servo axis imitates stably."""
    return imitable_inertia_kg_m2(shaft_on_bus(config.servo_rig_parameters(), config.cycle_time_s))


def check_imitated_inertia(config: BenchConfig, document: Document, inertia_kg_m2: float, where: Location) -> None:
    """Raise UnusableInputError at `where` when the loop of imitated inertia, shaft and bus is unstable with it."""
    least, largest = imitable_inertias_kg_m2(config)
    if not least < inertia_kg_m2 < largest:
        raise UnusableInputError(
            document.place(where),
            f"the load motor can't imitate an inertia of {inertia_kg_m2:.4g} kg·m² over a cycle of "
            f"{config.cycle_time_s * 1e3:g} ms: the loop of shaft and bus is stable from {least:.4g} to "
            f"{largest:.4g} kg·m², expected a shorter cycle or a heavier shaft on the stand",
        )


def _check_drives(config: BenchConfig, document: Document, nodes: Nodes) -> None:
    """Every drive has what it is configured by, and a virtual axis understands the frames that it listens to."""
    for part in config.parts:
        od = nodes.dictionary(part.name)
        missing = lacking(drive_settings(config, part, od), od) if part.role is not Role.VIRTUAL_IO else []
        if missing:
            raise UnusableInputError(document.place(part.location), f"the EDS lacks {'; '.join(missing)}")
    if config.mirroring != "listen":
        return
    for real, virtual in zip(config.parts_of(Role.AXIS), config.parts_of(Role.VIRTUAL_AXIS), strict=True):
        ours, theirs = (declared_units(part, nodes.dictionary(part.name)).velocity_rad_s for part in (real, virtual))
        same_layout = nodes.pdo_maps(real.name)[0].mapping == nodes.pdo_maps(virtual.name)[0].mapping
        if not same_layout or not isclose(ours, theirs, rel_tol=1e-9):
            raise UnusableInputError(
                document.place(real.location),
                f"its velocity unit is {ours:.6g} rad/s and that of {virtual.name}, which listens to its RPDO, "
                f"{theirs:.6g} rad/s, expected one unit and one PDO layout, or mirroring: copy",
            )


def _check_set_point(config: BenchConfig, document: Document) -> None:
    """A set-point that no run can reach."""
    trip_N, set_point_N = config.safety.limits.tension_N.trip, config.tension_control.set_point_N
    if trip_N is not None and set_point_N > trip_N:
        raise UnusableInputError(
            document.place(("controllers", next(iter(config.controllers)), "set_point_N")),
            f"set_point_N is {set_point_N:g}, expected less than the trip level of the tension, {trip_N:g} N",
        )


def _coarse_units(config: BenchConfig, nodes: Nodes) -> list[str]:
    """What one unit of an axis' position or velocity is in web tension, where that is more than 1 N."""
    web, notes = config.web_line.required_web, []
    for part in config.parts_of(Role.AXIS):
        axis = part.axis or 1
        units = declared_units(part, nodes.dictionary(part.name))
        rad_per_m, span_m = config.web_line.motor_rad_per_m(axis), config.web_line.span_length_m(1)
        position_N = web.stiffness_N * units.position_rad / rad_per_m / span_m
        if position_N > _COARSE_N:
            notes.append(f"{part.name}: one unit of position (6064h) stands for {position_N:.3g} N of web tension")
        # Steady tension changes by E·S·Δv/v; the slowest that the line is meant to run at would be worse than 1 m/s.
        velocity_N = web.stiffness_N * units.velocity_rad_s / rad_per_m
        if velocity_N > _COARSE_N:
            notes.append(
                f"{part.name}: one unit of velocity (60FFh) moves the web tension by {velocity_N:.3g} N at 1 m/s"
            )
    return notes


def start_point(config: BenchConfig) -> OperatingPoint:
    """The tension loop when the drives are enabled, with the E that the twin begins with."""
    web = imitated_web(config.web_line, config.load)
    modulus_Pa, length_m = web.required_web.youngs_modulus_Pa, web.span_length_m(1)
    return OperatingPoint(modulus_Pa, 0.0, length_m, config.web_line.required_web.youngs_modulus_Pa)


def check_stability(config: BenchConfig, document: Document, point: OperatingPoint, where: Location) -> None:
    """Raise UnusableInputError at `where` in the config when web, drives, bus and twin are unstable at this point."""
    cycle = f"a cycle of {config.cycle_time_s * 1e3:g} ms"
    if not TensionLoop(config, point, closed=False).stable:
        share = stiffness_reserve(config, point.youngs_modulus_Pa / point.span_length_m)
        raise UnusableInputError(
            document.place(where),
            f"the load motor can't imitate so stiff a web over {cycle} ({operating_point_text(point)}): the loop of "
            f"web and sampled shaft is by itself stable up to {100 * share:.0f} % of it, expected a shorter cycle, a "
            f"heavier axis 2, or a softer or longer web",
        )
    if not TensionLoop(config, point).stable:
        raise UnusableInputError(
            document.place(("controllers", next(iter(config.controllers)), "bandwidth_rad_per_s")),
            f"the tension loop is unstable with {config.tension_control.bandwidth_rad_per_s:g} rad/s over {cycle} at "
            f"{operating_point_text(point)}, expected a smaller bandwidth_rad_per_s, more swing_damping_ratio or a "
            f"shorter cycle",
        )


def operating_point_text(point: OperatingPoint) -> str:
    """An operating point as a message names it."""
    text = f"E {point.youngs_modulus_Pa * 1e-6:.4g} N/mm²"
    if not abs(point.estimate_Pa / point.youngs_modulus_Pa - 1.0) <= SAME_MODULUS:
        text += f" (believed: {point.estimate_Pa * 1e-6:.4g})"
    return f"{text}, {point.line_speed_m_s:g} m/s"


def stiffness_reserve(config: BenchConfig, modulus_Pa_per_m: float) -> float:
    """Largest stiffness of a web that the load motor imitates stably by itself, over that of one with this E/L."""
    shaft = sampled_shaft(config.web_line, cycle_s=config.cycle_time_s)
    asked_Nm_per_rad = web_stiffness_Nm_per_rad(config.web_line, modulus_Pa_per_m=modulus_Pa_per_m)
    return largest_stiffness_Nm_per_rad(shaft, imitation_delay_s(shaft)) / asked_Nm_per_rad
