"""Checks before anything starts: EDS files, PDO maps, bus capacity, stability; errors name file and line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isclose

from hilbench.bench.bus_options import BusOptions, bus_options
from hilbench.bench.schedule import Slot, schedule
from hilbench.can.load import BusLoad, cycle_load
from hilbench.cia402.axis import axes, object_of, of_first_axis
from hilbench.cia402.configuration import lacking
from hilbench.cia402.objects import CONTROLWORD
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import declared_units, dictionary_of, drive_settings
from hilbench.exchange.nodes import Nodes
from hilbench.machine_kinds import machine_part
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.config import FmuBlock, FmuLoadConfig
from hilbench.plant.fmu.description import Variable
from hilbench.plant.unit_names import unit_of_name
from hilbench.strict_yaml import Document
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role


@dataclass(frozen=True)
class CheckedBench:
    """Result of the check."""

    load: BusLoad
    frames_per_cycle: float
    notes: list[str]  #: what can be run, but not well
    options: BusOptions  #: load of the PDO set on the bench's wire, and on other bus layouts
    fmus: list[str]  #: findings in FMUs
    schedule: list[Slot]  #: worst-case schedule of a cycle


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
    _check_axes(config, document)
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
    options = bus_options(config, nodes)
    if load.fraction > 1.0:
        one, *others = options
        elsewhere = ", ".join(f"on {option.layout} {option.least_lockstep_s * 1e3:g} ms" for option in others)
        raise UnusableInputError(
            document.place(("bus", "bitrate")),
            f"the PDO set takes {load.bits:.0f} bit times of the {load.capacity_bits:.0f} in a cycle of "
            f"{config.cycle_time_s * 1e3:g} ms at {config.bus.bitrate} bit/s ({100 * load.fraction:.0f} %), "
            f"expected at most 100 %: a cycle of {one.least_lockstep_s * 1e3:g} ms or more ({elsewhere}, which a bench "
            f"can't use yet), a higher bit rate or fewer PDOs",
        )
    notes: list[str] = []
    least_s = options.one_wire.least_realtime_s
    if config.pace == "realtime" and config.cycle_time_s < least_s:
        notes.append(
            f"the PDO set takes {100 * load.fraction:.0f} % of a cycle at worst: set points or answers may come too "
            f"late in real time, expected a cycle of {least_s * 1e3:g} ms or more"
        )
    notes += machine_part(config.machine.kind, "check")(config, document, nodes)
    slots = schedule(frames, config.cycle_time_s, config.bus.bitrate)
    return CheckedBench(load, sum(frame.per_cycle for frame in frames), notes, options, fmu_findings(config), slots)


def _of_axis(entry: int) -> tuple[int, int]:
    """A mapping entry, whichever axis of a node it is of: the object that the first one has, sub-index and length."""
    return of_first_axis(entry >> 16), entry & 0xFFFF


def _check_axes(config: BenchConfig, document: Document) -> None:
    """The EDS file of each drive has the axis of the node that it is."""
    for part in config.stand_drives:
        there = axes(dictionary_of(part).__contains__)
        if part.node_axis > 1 and part.node_axis not in there:
            raise UnusableInputError(
                document.place((*part.location, "axis")),
                f"axis is {part.node_axis}, expected one that {part.node.eds.name} has: "
                f"{', '.join(map(str, there)) or 'none'} ({object_of(part.node_axis, CONTROLWORD):X}h is not in it)",
            )


def _check_drives(config: BenchConfig, document: Document, nodes: Nodes) -> None:
    """Check that every drive has the objects needed, and that a virtual axis can decode its axis's RPDOs."""
    for part in config.parts:
        if part.role is not Role.VIRTUAL_IO and (missing := lacking(drive_settings(config, part), dictionary_of(part))):
            raise UnusableInputError(document.place(part.location), f"the EDS lacks {'; '.join(missing)}")
    if config.mirroring != "listen":
        return
    for real, virtual in zip(config.parts_of(Role.AXIS), config.parts_of(Role.VIRTUAL_AXIS), strict=True):
        ours, theirs = (declared_units(part).velocity_rad_s for part in (real, virtual))
        mapped, received_back = (
            [_of_axis(entry) for entry in nodes.pdo_maps(part.name)[0].mapping] for part in (real, virtual)
        )
        same_layout = mapped == received_back
        if not same_layout or not isclose(ours, theirs, rel_tol=1e-9):
            raise UnusableInputError(
                document.place(real.location),
                f"its velocity unit is {ours:.6g} rad/s and that of {virtual.name}, which listens to its RPDO, "
                f"{theirs:.6g} rad/s, expected one unit and one PDO layout, or mirroring: copy",
            )


#: What a servo axis' twin finds.
_FOUND = ("inertia_kg_m2", "coulomb_friction_Nm", "viscous_friction_Nm_s_per_rad")


def fmu_findings(config: BenchConfig) -> list[str]:
    """Findings in the FMUs, a line each; empty for a bench without FMUs."""
    machine, load = config.machine, config.load.fmu
    lines = _of_fmu_axis(machine) if isinstance(machine, FmuAxisParameters) else []
    return lines if load is None else lines + _of_fmu_load(load, config)


def _of_fmu_axis(machine: FmuAxisParameters) -> list[str]:
    found, drives = machine.variables(), machine.drives
    motion = [found.torque, found.position, found.speed]
    texts = [variable for name, variable in found.parameters.items() if isinstance(machine.parameters[name], str)]
    lines = [
        machine.description().summary,
        f"machine: torque is {_names(motion[:1])}, position {_names(motion[1:2])}, speed {_names(motion[2:])}"
        + "".join(f"; {ours} is {theirs.name}" for ours, theirs in found.parameters.items()),
        *_unit_findings([*motion, *texts]),
        *(step_findings(machine, drives.sample_time_s) if drives else []),
    ]
    kept = [name for name in _FOUND if name not in found.parameters]
    if kept:
        lines.append(f"not the FMU's, so that the twin finds it and can't simulate it: {', '.join(kept)}")
    if not machine.description().can_roll_back:
        lines.append("its state can't be handed out: the twin begins anew where it would go back")
    return lines


def _of_fmu_load(load: FmuLoadConfig, config: BenchConfig) -> list[str]:
    found = load.variables(config.machine.position_unit)
    motion = [*found.positions, *found.speeds]
    named: Mapping[str, Variable] = found.outputs | found.parameters
    lines = [
        load.description().summary,
        f"load model: {_names(motion)} follow the motion, {_names(found.torques)} are emulated"
        + "".join(f"; {ours} is {theirs.name}" for ours, theirs in named.items()),
        *_unit_findings([*motion, *found.torques, *(named[ours] for ours in named if unit_of_name(ours) != "1")]),
        *step_findings(load, config.cycle_time_s),
    ]
    if not load.description().can_roll_back:
        lines.append(
            "its torques can't be predicted over the delay of the emulation: what it emulates acts later, and the loop "
            "of machine and shaft is less stable"
        )
    fixed = [f"{ours} ({theirs.name})" for ours, theirs in found.parameters.items() if not theirs.settable]
    if fixed:
        lines.append(f"fixed while it runs, so that no step can change it: {', '.join(fixed)}")
    return [*lines, "whether the loop of FMU, shaft and bus is stable is not known before it runs"]


def step_findings(block: FmuBlock, natural_s: float) -> list[str]:
    """Finding on an FMU's communication step, where it differs from its user's step."""
    step_s = block.communication_step_s(natural_s)
    if step_s is None or abs(step_s - natural_s) < 1e-9 * natural_s:
        return []
    return [
        f"communication steps of {step_s * 1e3:g} ms where {natural_s * 1e3:g} ms are asked for: what is left over is "
        "carried, and what it says is of the last step's end"
    ]


def _unit_findings(variables: Iterable[Variable]) -> list[str]:
    without = sorted({each.name for each in variables if not each.unit})
    return [f"without a unit, taken for what the bench expects: {', '.join(without)}"] if without else []


def _names(variables: Iterable[Variable]) -> str:
    return ", ".join(each.name + (f" [{each.unit}]" if each.unit else "") for each in variables)
