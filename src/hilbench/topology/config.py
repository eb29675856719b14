"""The bench config: everything the bench, the simulated hardware and the twin are built from.

The experiment and its criteria stand in the same file; `hilbench.runs.config` adds them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from hilbench.block import Block, problem_at
from hilbench.can.open import BusAddress
from hilbench.errors import UnusableInputError
from hilbench.machine_kinds import has, machine_part
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effect_problem, find_effect
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.parameters import DriveParameters, EffectEntry, per_item
from hilbench.plant.sampling import samples_per
from hilbench.plant.servo_axis.effects import ShaftEffect
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters
from hilbench.real_time import ProcessSettings
from hilbench.topology.blocks import (
    BusConfig,
    HardwareConfig,
    LoadConfig,
    MachineParameters,
    MasterConfig,
    Mirroring,
    Pace,
    RealtimeConfig,
    TwinConfig,
)
from hilbench.topology.parts import DeviceConfig, DriveConfig, LoadMotorConfig, Part, PartName, Role
from hilbench.topology.quantities import MODEL_CHANGE, fast_path_places, parse_effect_path, path_problem
from hilbench.topology.safety import SafetyConfig
from hilbench.topology.signal_kinds import Signal
from hilbench.topology.signals import Shape, signals_of
from hilbench.topology.web_line_config import (
    ControllerConfig,
    PositionControlConfig,
    ReelControlConfig,
    TensionControlConfig,
    loops_of,
    reel_axes,
    span_beside_reel,
)
from hilbench.topology.web_line_quantities import TENSION_PROBE

#: Parts that a kind of machine may lack, which are keys of `twin:`.
_OPTIONAL = ("prediction", "live_diagnosis")


def misfits(key: str, value: Any, machine: Any, loaded: Collection[int] | None) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this machine, and load motors on the shafts of the axes
    `loaded` (None: that is not known)."""
    kind: MachineKind = machine.machine_kind
    of_kind = machine_part(machine.kind, "topology")
    yield from of_kind.misfits(key, value, machine)
    if key == "load" and value.fmu is not None:
        yield from _fmu_misfits(value, machine, None if loaded is None else len(loaded))
    if key == "twin":
        default = TwinConfig(node=value.node)
        for name in sorted(set(TwinConfig.model_fields) - set(of_kind.TWIN_KEYS)):
            if getattr(value, name) == getattr(default, name) or (name in _OPTIONAL and has(machine.kind, name)):
                continue
            if name in _OPTIONAL:
                yield f"no '{name}:', which a machine of kind {machine.kind} does not bring"
            yield f"no '{name}:', which is of a twin of another kind of machine (this one is a {machine.kind})"
    if key == "hardware" and isinstance(machine, FmuAxisParameters) and value.effects:
        yield "no 'effects:': what an FMU does is in its own equations"
    if key in ("hardware", "load"):
        for entry in value.effects:
            place = effect_problem(
                entry.effect, entry.axis, EffectPlace(key), machine.axis_count, loaded, kind,
                section=entry.section, sections=machine.span_count,
            )  # fmt: skip
            stations = getattr(machine, "station_types", {})
            of_station = find_effect(entry.effect, kind).station_problem(entry.section, stations) if not place else None
            yield from filter(None, [entry.problem(kind), place, of_station])


def one_node_misfit(part: Part, beside: Mapping[int, Part]) -> tuple[str, str]:
    """Reason why a part can't share its node with others, by their axes: the key, and what is expected there."""
    other = next(iter(beside.values()), None)
    if other is None:
        return "", ""
    node_id, node = part.node.node_id, part.node
    if part.node_axis in beside or not (isinstance(node, DeviceConfig) and isinstance(other.node, DeviceConfig)):
        both = f"{beside.get(part.node_axis, other).name} and {part.name} both have {node_id}"
        what = f", axis {part.node_axis}" if part.node_axis in beside else ""
        return "node_id", f"node ids that differ, or another 'axis:' of a node with two: {both}{what}"
    if node.eds != other.node.eds:
        return "eds", f"{other.node.eds}, the EDS file of {other.name}, which is on node {node_id} as well"
    if node.simulated is not other.node.simulated:
        return "simulated", f"{str(other.node.simulated).lower()}, as {other.name} on the same node {node_id} is"
    return "", ""


def whole_misfits(config: Any) -> Iterator[str]:
    """Why a bench can't have all that it has together."""
    machine, drives, load_motors = config.machine, config.drives, config.load_motors
    yield from machine_part(machine.kind, "topology").whole_misfits(config)
    if machine.axis_count != len(drives):
        axes = "driven rollers" if machine.position_unit == "m" else "axes"
        yield (
            f"as many drives as the machine has {axes}: {len(drives)} under 'drives:', "
            f"{machine.axis_count} {axes.rpartition(' ')[2]}"
        )
    for name, motor in load_motors.items():
        if motor.shaft not in drives:
            yield f"the drive on whose shaft '{name}' sits: {', '.join(drives)}; '{motor.shaft}' is none"
    shafts = [motor.shaft for motor in load_motors.values()]
    if len(set(shafts)) < len(shafts):
        yield f"one load motor on a shaft: {', '.join(load_motors)} are on {', '.join(shafts)}"


def _fmu_misfits(load: LoadConfig, machine: Any, load_motors: int | None) -> Iterator[str]:
    """Why load motors can't emulate an FMU in the place of a machine."""
    assert load.fmu is not None
    without_options = LoadConfig(fmu=load.fmu)
    for name in ("web", "shaft", "effects", "measured"):
        if getattr(load, name) != getattr(without_options, name):
            yield f"no '{name}:' beside 'fmu:', which says by itself what is emulated"
    yield from load.fmu.problems(machine.axis_count, load_motors, machine.position_unit)


#: Share of a drive's torque limit that a quick stop may take: the rest is for friction and the pull of the web.
_STOPPING_SHARE = 0.8


def _loaded(drives: Mapping[str, DriveConfig], motors: Mapping[str, LoadMotorConfig]) -> tuple[int, ...]:
    """The axes on whose shaft a load motor is, from 1, in the order of the motors."""
    axes = {name: axis for axis, name in enumerate(drives, 1)}
    return tuple(axes[motor.shaft] for motor in motors.values() if motor.shaft in axes)


def _of_shaft(entries: Sequence[EffectEntry]) -> list[ShaftEffect]:
    return [ShaftEffect.model_validate(entry.model_dump()) for entry in entries]


def _default_controllers(machine: Any) -> dict[str, ControllerConfig]:
    return {"tension_control": TensionControlConfig()} if isinstance(machine, ModelParameters) else {}


class BenchConfig(Block):
    """One bench. Keys that carry a unit say so in their name."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", description="names the run folder")
    description: str = Field(default="", description="shown in report and recording")
    seed: int = Field(default=1, ge=0, description="of every random number of the run")
    pace: Pace = Field(
        default="lockstep",
        description="lockstep: the next SYNC when everybody has answered, reproducible; realtime: by the wall clock",
    )
    cycle_time_s: float = Field(default=0.002, ge=0.0005, le=0.1, description="SYNC period, whole microseconds")
    mirroring: Mirroring = Field(
        default="listen",
        description="listen: virtual axes receive the real axes' RPDOs; copy: they get RPDOs of their own",
    )
    bus: BusConfig = BusConfig()
    master: MasterConfig = MasterConfig()
    machine: MachineParameters = Field(description="the twin's model of the machine")
    drives: dict[PartName, DriveConfig] = Field(
        min_length=1, description="of the machine's driven axes, in the order of the machine, by the names they get"
    )
    load_motors: dict[PartName, LoadMotorConfig] = Field(
        default={}, description="motors that emulate the machine's pull, by the names they get"
    )
    hardware: HardwareConfig = HardwareConfig()
    load: LoadConfig = LoadConfig()
    twin: TwinConfig
    controllers: dict[PartName, ControllerConfig] = Field(
        default_factory=lambda given: _default_controllers(given.get("machine")),
        description="what keeps a quantity of the machine at its set-point, by the names they get: of a web line the "
        "tension of a span, or the position of a dancer or accumulator; of a servo axis none",
    )
    safety: SafetyConfig = SafetyConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    stand: str | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="name of the stand in its history, the same in all configs that run on it; the bench's name unless "
        "given",
    )
    history: Path | None = Field(
        default=None,
        description="SQLite file with what runs have found of the machine; a relative path is taken from the config "
        "file's folder; history.sqlite beside the folder of the runs unless given",
    )
    wear_limits: dict[str, FiniteFloat] = Field(
        default={},
        description="values of quantities of the history of which it is asked when they are reached: "
        "{shaft.coulomb_friction_Nm: 0.05}",
    )

    @field_validator("load_motors", "hardware", "load", "twin", "controllers")
    @classmethod
    def _of_this_machine(cls, value: Any, info: ValidationInfo) -> Any:
        machine, drives, motors = (info.data.get(key) for key in ("machine", "drives", "load_motors"))
        if machine is not None:  # else the machine's own error is the one to report
            loaded = None if drives is None or motors is None else _loaded(drives, motors)
            problem = next(misfits(str(info.field_name), value, machine, loaded), None)
            if problem:
                raise ValueError(problem)
        return value

    @model_validator(mode="after")
    def _parts_differ(self) -> BenchConfig:
        on_node: dict[int, dict[int, Part]] = {}
        names: set[str] = set()
        for part in self.parts:
            if part.name in names:
                raise ValueError(f"names that differ: there are two parts named {part.name}")
            names.add(part.name)
            axes = on_node.setdefault(part.node.node_id, {})
            key, expected = one_node_misfit(part, axes)
            if key:
                found = getattr(part.node, key)
                shown = str(found) if key == "eds" else found
                raise problem_at(type(self), (*part.location, key), expected, shown)
            axes[part.node_axis] = part
        return self

    @model_validator(mode="after")
    def _fits_the_machine(self) -> BenchConfig:
        machine = self.machine
        problem = next(whole_misfits(self), None)
        if problem:
            raise ValueError(problem)
        machine_part(machine.kind, "topology").build(self)  # raises ValueError for what can't be built
        samples_per(self.cycle_time_s, self.drive_parameters.sample_time_s)  # raises ValueError for what is no multiple
        return self

    @property
    def stand_name(self) -> str:
        """Name of the stand in its history."""
        return self.stand or self.name

    # -- the machine -------------------------------------------------------------------------------------

    @property
    def web_line(self) -> ModelParameters:
        """The machine, which is a web line. Raises UnusableInputError for one of another kind."""
        if isinstance(self.machine, ModelParameters):
            return self.machine
        raise UnusableInputError("machine", f"a {self.machine.kind}, expected one of kind: web_line")

    @property
    def servo_axis(self) -> ServoAxisParameters:
        """The machine, which is a servo axis. Raises UnusableInputError for one of another kind."""
        if isinstance(self.machine, ServoAxisParameters):
            return self.machine
        raise UnusableInputError("machine", f"a {self.machine.kind}, expected one of kind: servo_axis")

    @property
    def drive_parameters(self) -> DriveParameters:
        """The control loops of the machine's drives."""
        assert self.machine.drives is not None, "a bench's machine has drives"
        return self.machine.drives

    @property
    def quick_stop_per_s2(self) -> float:
        """Deceleration of a quick stop, in the machine's unit of position per s².

        On a line of several spans one for all rollers, that of the slowest of them: rollers that stop at different
        rates tear the web.
        """
        machine = self.machine
        if machine.position_unit == "rad":
            return self.safety.quick_stop_rad_s2
        if not self.stops_together:
            return self.safety.quick_stop_m_s2
        axes = range(1, machine.axis_count + 1)
        return min(self.safety.quick_stop_m_s2, *(_STOPPING_SHARE * self.fastest_m_s2(axis) for axis in axes))

    @property
    def stops_together(self) -> bool:
        """True if the axes are brought to rest in the ratio of their speeds."""
        return self.machine.span_count > 1

    def fastest_m_s2(self, axis: int) -> float:
        """Largest acceleration of the drive of a web line's axis, by its torque limit and all that it turns."""
        model = self.web_line
        limit_N = per_item(self.drive_parameters.torque_limit_Nm, axis) * model.motor_rad_per_m(axis)
        return limit_N / model.mass_kg(axis)

    def rig_parameters(self) -> RigParameters:
        """The simulated hardware of a web line: its axes without their effects, with those hidden in the hardware.

        Raises UnusableInputError for a machine of another kind.
        """
        hardware = self.hardware
        load_motors = [
            CoupledMotor(axis=axis, motor=motor.motor)
            for axis, motor in zip(self.loaded_axes, self.load_motors.values(), strict=True)
        ]
        return RigParameters.matching(self.web_line, load_motors, hardware.sensors, hardware.effects)

    def servo_rig_parameters(self, effects: Sequence[ShaftEffect] | None = None) -> ServoRigParameters:
        """The simulated hardware of a servo axis, with the effects hidden in it unless others are given.

        Raises UnusableInputError for a machine of another kind.
        """
        hardware = self.hardware
        (load_motor,) = self.load_motors.values()
        given = hardware.effects if effects is None else effects
        return ServoRigParameters.matching(
            self.servo_axis, hardware.shaft, load_motor.motor, hardware.sensors, _of_shaft(given)
        )

    def emulated_shaft(self) -> ServoAxisParameters:
        """Servo axis that the load motor emulates: the model's, with the changes and effects of `load:` in place of its
        own.

        Raises ValueError for less inertia than the motor's rotor has.
        """
        model, changes = self.servo_axis, self.load.shaft.model_dump(exclude_none=True)
        if "inertia_kg_m2" in changes:
            changes["inertia_kg_m2"] -= model.motor.inertia_kg_m2
            if changes["inertia_kg_m2"] < 0.0:
                raise ValueError(
                    f"'load.shaft.inertia_kg_m2' of all that turns, at least the rotor's {model.motor.inertia_kg_m2:g}"
                )
        shaft = model.shaft.model_copy(update=changes)
        return model.model_copy(update={"shaft": shaft, "effects": tuple(_of_shaft(self.load.effects))})

    @property
    def parts(self) -> tuple[Part, ...]:
        """All nodes: the drives, the load motors, the virtual axes, the virtual I/O."""
        return tuple(part for role in Role for part in self.parts_of(role))

    @property
    def stand_drives(self) -> tuple[Part, ...]:
        """The drives of the stand itself, not the twin's nodes: of the axes, then the load motors."""
        return (*self.parts_of(Role.AXIS), *self.parts_of(Role.LOAD_MOTOR))

    def parts_of(self, role: Role) -> tuple[Part, ...]:
        """The nodes of one role, in the order of the config."""
        if role is Role.VIRTUAL_IO:
            return (Part("virtual_io", role, self.twin.node, None, ("twin", "node")),)
        if role is Role.LOAD_MOTOR:
            axes = {name: axis for axis, name in enumerate(self.drives, 1)}
            return tuple(
                Part(name, role, node, axes.get(node.shaft), ("load_motors", name))
                for name, node in self.load_motors.items()
            )
        drives = enumerate(self.drives.items(), 1)
        if role is Role.AXIS:
            return tuple(Part(name, role, node, axis, ("drives", name)) for axis, (name, node) in drives)
        return tuple(
            Part(f"virtual_{name}", role, node.virtual, axis, ("drives", name, "virtual"))
            for axis, (name, node) in drives
        )

    @property
    def shape(self) -> Shape:
        """Multiplicities of the machine's parts."""
        shape: Shape = machine_part(self.machine.kind, "topology").shape(self)
        return shape

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Signals of a sample of this bench, in recording order."""
        return signals_of(self.machine.kind, self.shape)

    @property
    def loaded_axes(self) -> tuple[int, ...]:
        """The axis, from 1, on whose shaft each load motor is."""
        return _loaded(self.drives, self.load_motors)

    def load_motor_of(self, axis: int) -> str:
        """The name of the load motor on the shaft of an axis. Raises KeyError for none."""
        return dict(zip(self.loaded_axes, self.load_motors, strict=True))[axis]

    @property
    def tension_controls(self) -> dict[int, TensionControlConfig]:
        """The controllers of tensions by the span whose tension they keep, in the order of the spans."""
        found = loops_of(TensionControlConfig, self.controllers.values())
        return {control.span: control for control in sorted(found, key=lambda each: each.span)}

    @property
    def position_controls(self) -> dict[str, PositionControlConfig]:
        """The controllers of dancers and accumulators by the name of the station."""
        return {control.station: control for control in loops_of(PositionControlConfig, self.controllers.values())}

    @property
    def reel_controls(self) -> dict[int, ReelControlConfig]:
        """The controllers of reels in torque mode by the axis of the reel."""
        found = {control.reel: control for control in loops_of(ReelControlConfig, self.controllers.values())}
        axes = sorted(reel_axes(self.web_line).items(), key=lambda entry: entry[1]) if found else ()
        return {axis: found[reel] for reel, axis in axes if reel in found}

    @property
    def set_point_controls(self) -> dict[int, TensionControlConfig | ReelControlConfig]:
        """The controllers of tensions, by speeds or torques, by the span whose tension they keep, in the order of
        these."""
        reels = {span_beside_reel(self.web_line, axis): control for axis, control in self.reel_controls.items()}
        kept: dict[int, TensionControlConfig | ReelControlConfig] = {**self.tension_controls, **reels}
        return dict(sorted(kept.items()))

    @property
    def fast_path_places(self) -> tuple[str, ...]:
        """The quantities of this bench that can be set, without those of effects."""
        known = fast_path_places(self.machine.kind, self.shape)
        return tuple(path for path in known if self.path_problem(path) is None)

    def path_problem(self, path: str) -> str | None:
        """Why this bench has no such quantity that can be set, in one line, or None."""
        if path == MODEL_CHANGE and self.twin.live_diagnosis is None:
            return f"'twin: {{live_diagnosis: {{}}}}' for '{path}': nothing proposes changes of the model"
        if path == TENSION_PROBE and self.reel_controls and not self.tension_controls:
            return f"a loop by speeds for '{path}': loops of torques are not probed"
        problem = path_problem(path, self.machine, self.shape, self.loaded_axes)
        if problem or not path.startswith("hardware."):
            return problem
        axis = parse_effect_path(path, self.machine.machine_kind).axis
        part = self.parts_of(Role.AXIS)[(axis or 1) - 1]
        return None if part.is_simulated else f"an axis of the simulated hardware, '{part.name}' is a real drive"

    def controller_of(self, span: int) -> str:
        """The name of the controller that keeps the tension of a span. Raises KeyError for none."""
        wanted = self.set_point_controls[span]
        return next(name for name, control in self.controllers.items() if control is wanted)

    @field_validator("cycle_time_s")
    @classmethod
    def _whole_microseconds(cls, value: float) -> float:
        if abs(value * 1e6 - round(value * 1e6)) > 1e-6:
            raise ValueError("whole microseconds (1006h, communication cycle period)")
        return value

    @property
    def parts_by_node(self) -> dict[int, list[Part]]:
        """All parts by node id; two axes of a node have it in common."""
        found: dict[int, list[Part]] = {}
        for part in self.parts:
            found.setdefault(part.node.node_id, []).append(part)
        return found

    @property
    def simulated_drives(self) -> dict[int, str]:
        """Parts that the simulated hardware plays, by node id; of a node with two axes the last."""
        return {part.node.node_id: part.name for part in self.parts if part.is_simulated}

    @property
    def virtual_nodes(self) -> dict[int, str]:
        """Parts that the twin plays, by node id."""
        return {part.node.node_id: part.name for part in self.parts if part.is_virtual}

    def process_settings(self, part: Literal["bench", "hardware", "twin"]) -> ProcessSettings | None:
        """Operating-system settings of a part's process; None in lockstep."""
        if self.pace == "lockstep":
            return None
        wanted = self.realtime
        priority = None if wanted.priority is None else wanted.priority - (part != "bench")
        return ProcessSettings(priority, getattr(wanted.cores, part), wanted.lock_memory)

    def units_of(self, node_id: int, axis: int = 1) -> dict[str, float]:
        """Units that the config gives for an axis of a node; none for one that is not the bench's."""
        wanted = (node_id, axis)
        parts = (part for part in self.parts if (part.node.node_id, part.node_axis) == wanted)
        return next((part.node.unit_overrides for part in parts), {})

    @property
    def bus_address(self) -> BusAddress:
        """The bus with its bitrate; an embedded bus takes its timing from the pace."""
        timing = "virtual" if self.pace == "lockstep" else "real"
        return BusAddress.parse(self.bus.address, bitrate=self.bus.bitrate, timing=timing)

    @property
    def cycle_ns(self) -> int:
        """The SYNC period in ns."""
        return round(self.cycle_time_s * 1e6) * 1000
