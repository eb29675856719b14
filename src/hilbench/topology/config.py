"""The bench config: everything the bench, the simulated hardware and the twin are built from.

The experiment and its criteria stand in the same file; `hilbench.runs.config` adds them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, FiniteFloat, Tag, ValidationInfo, field_validator, model_validator

from hilbench.block import Block
from hilbench.can.open import BusAddress
from hilbench.errors import UnusableInputError
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.effects import EffectPlace, MachineKind, effect_problem, find_effect
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.parameters import DriveParameters, EffectEntry, NotNegative, Positive, per_item
from hilbench.plant.sampling import samples_per
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.effects import ShaftEffect
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.plant.servo_axis.rig import ServoRigParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters
from hilbench.prediction.config import PredictionConfig
from hilbench.real_time import ProcessSettings
from hilbench.topology.live_config import LiveDiagnosisConfig
from hilbench.topology.parts import DriveConfig, LoadMotorConfig, NodeConfig, Part, PartName, Role
from hilbench.topology.quantities import MODEL_CHANGE, path_problem, plain_paths
from hilbench.topology.safety import SafetyConfig, TimeOut
from hilbench.topology.signal_kinds import Signal
from hilbench.topology.signals import Shape, signals_of
from hilbench.topology.web_line_config import (
    ControllerConfig,
    LoadWebConfig,
    PositionControlConfig,
    TensionControlConfig,
    controller_misfits,
    estimate_misfits,
    loops_misfit,
    measured_misfit,
    position_loops,
    stations_misfit,
    tension_loops,
)
from hilbench.topology.web_line_shape import web_line_shape

Pace = Literal["lockstep", "realtime"]
Mirroring = Literal["listen", "copy"]
#: The machine, by its `kind`; without one it is a web line.
MachineParameters = Annotated[
    Annotated[ModelParameters, Tag("web_line")]
    | Annotated[ServoAxisParameters, Tag("servo_axis")]
    | Annotated[FmuAxisParameters, Tag("fmu")],
    Discriminator(
        lambda value: (
            value.get("kind", "web_line") if isinstance(value, Mapping) else getattr(value, "kind", "web_line")
        ),
        custom_error_type="kind",
        custom_error_message="kind: web_line, servo_axis or fmu",
    ),
]


class BusConfig(Block):
    """Which bus: `embedded`, or any python-can interface and channel such as `socketcan:vcan0`."""

    address: str = Field(
        default="embedded",
        description="embedded: the bus of the config's folder; embedded:NAME; or a python-can interface and channel: "
        "socketcan:vcan0",
    )
    bitrate: int = Field(default=1_000_000, ge=10_000, le=1_000_000, description="bit/s")

    @field_validator("address")
    @classmethod
    def _parses(cls, value: str) -> str:
        try:
            BusAddress.parse(value)
        except UnusableInputError as error:  # the place is this key's, which pydantic tells
            raise ValueError(error.problem.partition("expected ")[2] or error.problem) from error
        return value


class MasterConfig(Block):
    """The bench's own part on the bus."""

    node_id: int = Field(default=127, ge=1, le=127, description="the bench's own, for its heartbeat")
    heartbeat_ms: int = Field(default=100, ge=0, le=32767, description="the bench's own heartbeat; 0: none")
    node_heartbeat_ms: int = Field(default=100, ge=0, le=32767, description="heartbeat that the nodes produce")
    boot_timeout_s: TimeOut = Field(default=20.0, description="how long nodes may take to show themselves on the bus")
    sdo_timeout_s: TimeOut = Field(default=1.0, description="how long a node may take to answer an SDO request")


class HiddenEffect(EffectEntry):
    """An effect as any kind of machine has it: which one's it has to be says the whole config."""

    @model_validator(mode="after")
    def _known(self) -> HiddenEffect:
        problems = [_effect_problem(self, kind) for kind in MachineKind]
        if all(problems):
            raise ValueError(problems[0])
        return self


def _effect_problem(entry: EffectEntry, kind: MachineKind) -> str | None:
    try:
        effect = find_effect(entry.effect, kind)
    except KeyError as error:
        return str(error.args[0])
    return effect.axis_problem(entry.axis) or effect.section_problem(entry.section) or effect.problem(entry.parameters)


def _place_problem(entry: EffectEntry, place: EffectPlace, kind: MachineKind) -> str | None:
    return effect_problem(entry.effect, entry.axis, place, None, None, kind, section=entry.section)


def _possible_effects(entries: list[HiddenEffect], place: EffectPlace) -> list[HiddenEffect]:
    """The entries, if there is a kind of machine that can have each of them: which it is the whole config says."""
    for entry in entries:
        problems = [_place_problem(entry, place, kind) for kind in MachineKind]
        if all(problems):
            raise ValueError(problems[0])
    return entries


class HardwareConfig(Block):
    """The simulated hardware: the machine's axes as motors with flywheels, and the load motors on their shafts."""

    shaft: ShaftParameters | None = Field(
        default=None,
        description="of a servo axis: the shaft that is really there, with its motor and the load motor beside it; "
        "the machine's unless given",
    )
    sensors: SensorParameters = SensorParameters(torque_noise_Nm=0.05, velocity_noise_rad_s=0.002)
    effects: list[HiddenEffect] = Field(default=[], description="hidden in the simulated axes")

    @field_validator("effects")
    @classmethod
    def _of_axes(cls, entries: list[HiddenEffect]) -> list[HiddenEffect]:
        return _possible_effects(entries, EffectPlace.HARDWARE)


class LoadShaftConfig(Block):
    """Where the imitated shaft differs from the model; what is not given is as in `machine:`."""

    inertia_kg_m2: Positive | None = Field(default=None, description="of all that turns, the motor's rotor included")
    coulomb_friction_Nm: NotNegative | None = Field(default=None, description="dry friction")
    viscous_friction_Nm_s_per_rad: NotNegative | None = Field(
        default=None, description="friction in proportion to the speed"
    )
    unbalance_Nm: NotNegative | None = Field(default=None, description="amplitude of the torque of what is unbalanced")


class LoadConfig(Block):
    """The load-model task: the machine that the load motor imitates."""

    web: LoadWebConfig = LoadWebConfig()
    shaft: LoadShaftConfig = LoadShaftConfig()
    effects: list[HiddenEffect] = Field(default=[], description="hidden in the imitated mechanics")
    fmu: FmuLoadConfig | None = Field(
        default=None, description="an FMU that the load motors imitate, in the place of what `machine:` describes"
    )
    measured: list[str] = Field(
        default=[],
        description="dancers and accumulators, by their names, with a sensor of their position, reels with one of "
        "their radius: imitated as the machine is, its value is the signal x_NAME_meas_m or r_NAME_meas_m",
    )

    @field_validator("effects")
    @classmethod
    def _imitable(cls, entries: list[HiddenEffect]) -> list[HiddenEffect]:
        return _possible_effects(entries, EffectPlace.LOAD)


class CoresConfig(Block):
    """Which core each process is pinned to; null: none."""

    bench: int | None = Field(default=None, ge=0, le=4095, description="the bench's cyclic loop")
    hardware: int | None = Field(default=None, ge=0, le=4095, description="the simulated hardware")
    twin: int | None = Field(default=None, ge=0, le=4095, description="the twin")


class RealtimeConfig(Block):
    """What the processes ask of the operating system at pace `realtime`; what is not permitted is a warning."""

    priority: int | None = Field(
        default=None, ge=2, le=99, description="SCHED_FIFO priority of the bench, simulated hardware and twin one below"
    )
    lock_memory: bool | None = Field(
        default=None, description="keep memory from being paged out; null: where permitted"
    )
    cores: CoresConfig = CoresConfig()


class TwinConfig(EstimationConfig):
    """The twin: its virtual I/O, what it assumes and how it keeps in step with the bench."""

    node: NodeConfig = Field(description="the virtual I/O: what the twin is told and what it tells")
    inertia: InertiaConfig = InertiaConfig()
    prediction: PredictionConfig | None = Field(
        default=None, description="look ahead while the bench runs; null: it does not"
    )
    live_diagnosis: LiveDiagnosisConfig | None = Field(
        default=None, description="name what the model lacks while the bench runs; without it nothing is looked for"
    )


#: Keys of `twin:` that every kind of machine has; the others say how one kind finds what it estimates.
_OF_EVERY_TWIN = {"node", "synchronized_pct", "behind", "virtual_tpdo_every"}
_OF_THE_SHAFT = {"inertia"}
#: Share of a drive's torque limit that a quick stop may take: the rest is for friction and the pull of the web.
_STOPPING_SHARE = 0.8
_SERVO = "no 'load.measured' on a servo axis, whose encoder is measured anyway"


def _misfits(key: str, value: Any, machine: Any, loaded: Collection[int] | None) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this machine, and load motors on the shafts of the axes
    `loaded` (None: that is not known)."""
    kind: MachineKind = machine.machine_kind
    of_servo = kind is MachineKind.SERVO_AXIS
    if key == "load_motors" and of_servo and len(value) != 1:
        yield "one load motor: a servo axis has one shaft"
    if key == "controllers" and bool(value) is of_servo:
        yield "none: a servo axis follows its reference" if of_servo else "at least one"
    if key == "controllers" and not of_servo:
        yield from controller_misfits(value.values(), machine.span_count)
    if key == "twin" and not of_servo:
        yield from estimate_misfits(value, machine)
    sections = 0 if of_servo else machine.span_count
    for name, of_sections in value.web if key == "load" and not of_servo else ():
        if isinstance(of_sections, list) and len(of_sections) != sections:
            yield f"'web.{name}' as one number or {sections}"
    if key == "load" and value.fmu is not None:
        yield from _fmu_misfits(value, machine, None if loaded is None else len(loaded))
    if key == "load" and value.web != LoadWebConfig() and of_servo:
        yield "'shaft:' for a servo axis"
    if not of_servo and ((key == "load" and value.shaft != LoadShaftConfig()) or (key == "hardware" and value.shaft)):
        yield "no 'shaft:', which is of a servo axis (machine: {kind: servo_axis})"
    if key == "twin":
        default, names = TwinConfig(node=value.node), set(TwinConfig.model_fields) - _OF_EVERY_TWIN
        for name in sorted(names - _OF_THE_SHAFT if of_servo else _OF_THE_SHAFT):
            if getattr(value, name) != getattr(default, name):
                yield f"no '{name}:', which is of a twin of another kind of machine (this one is a {kind})"
    if key == "hardware" and isinstance(machine, FmuAxisParameters) and value.effects:
        yield "no 'effects:': what an FMU does is in its own equations"
    if key in ("hardware", "load"):
        for entry in value.effects:
            place = effect_problem(
                entry.effect, entry.axis, EffectPlace(key), machine.axis_count, loaded, kind,
                section=entry.section, sections=sections,
            )  # fmt: skip
            yield from filter(None, [_effect_problem(entry, kind), place])


def _fmu_misfits(load: LoadConfig, machine: Any, load_motors: int | None) -> Iterator[str]:
    """Why load motors can't imitate an FMU in the place of a machine."""
    assert load.fmu is not None
    plain = LoadConfig(fmu=load.fmu)
    for name in ("web", "shaft", "effects", "measured"):
        if getattr(load, name) != getattr(plain, name):
            yield f"no '{name}:' beside 'fmu:', which says by itself what is imitated"
    yield from load.fmu.problems(machine.axis_count, load_motors, machine.position_unit)


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
    description: str = Field(default="", description="stands in report and recording")
    seed: int = Field(default=1, ge=0, description="of every random number of the run")
    pace: Pace = Field(
        default="lockstep",
        description="lockstep: the next SYNC when everybody has answered, reproducible; realtime: by the wall clock",
    )
    cycle_time_s: float = Field(default=0.002, ge=0.0005, le=0.1, description="SYNC period, whole microseconds")
    mirroring: Mirroring = Field(
        default="listen",
        description="listen: virtual axes hear the real axes' RPDOs; copy: they get RPDOs of their own",
    )
    bus: BusConfig = BusConfig()
    master: MasterConfig = MasterConfig()
    machine: MachineParameters = Field(description="what the twin believes of the machine")
    drives: dict[PartName, DriveConfig] = Field(
        min_length=1, description="of the machine's driven axes, in the order of the machine, by the names they get"
    )
    load_motors: dict[PartName, LoadMotorConfig] = Field(
        default={}, description="motors that imitate the machine's pull, by the names they get"
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
            problem = next(_misfits(str(info.field_name), value, machine, loaded), None)
            if problem:
                raise ValueError(problem)
        return value

    @model_validator(mode="after")
    def _parts_differ(self) -> BenchConfig:
        ids: dict[int, str] = {}
        names: set[str] = set()
        for part in self.parts:
            if part.name in names:
                raise ValueError(f"names that differ: there are two parts named {part.name}")
            names.add(part.name)
            if part.node.node_id in ids:
                raise ValueError(
                    f"node ids that differ: {ids[part.node.node_id]} and {part.name} both have {part.node.node_id}"
                )
            ids[part.node.node_id] = part.name
        return self

    @model_validator(mode="after")
    def _fits_the_machine(self) -> BenchConfig:
        machine = self.machine
        if machine.drives is None or (isinstance(machine, ModelParameters) and machine.web is None):
            needs = "'web:' and 'drives:'" if isinstance(machine, ModelParameters) else "'drives:'"
            raise ValueError(f"a machine with {needs}")
        if isinstance(machine, ModelParameters) and machine.stations is not None:
            ahead = [key for key in ("prediction", "live_diagnosis", "splices") if getattr(self.twin, key)]
            names = {*self.drives, *self.load_motors}
            problem = stations_misfit(machine, self.controllers.values(), "".join(ahead[:1]), names)
            if problem:
                raise ValueError(problem)
        if isinstance(machine, ModelParameters) or self.load.measured:
            problem = measured_misfit(self.load.measured, machine) if isinstance(machine, ModelParameters) else _SERVO
            if problem:
                raise ValueError(problem)
        if isinstance(machine, ModelParameters):
            problem = loops_misfit(machine, self.controllers.values(), self.load.measured)
            if problem:
                raise ValueError(problem)
        if machine.axis_count != len(self.drives):
            axes = "driven rollers" if machine.position_unit == "m" else "axes"
            raise ValueError(
                f"as many drives as the machine has {axes}: {len(self.drives)} under 'drives:', "
                f"{machine.axis_count} {axes.rpartition(' ')[2]}"
            )
        for name, motor in self.load_motors.items():
            if motor.shaft not in self.drives:
                raise ValueError(
                    f"the drive on whose shaft '{name}' sits: {', '.join(self.drives)}; '{motor.shaft}' is none"
                )
        shafts = [motor.shaft for motor in self.load_motors.values()]
        if len(set(shafts)) < len(shafts):
            raise ValueError(f"one load motor on a shaft: {', '.join(self.load_motors)} are on {', '.join(shafts)}")
        if isinstance(machine, ModelParameters):
            self.rig_parameters()  # raises ValueError for a load motor that is too heavy
        else:
            self.servo_rig_parameters(), self.imitated_shaft()  # raise ValueError for what can't be built
        samples_per(self.cycle_time_s, machine.drives.sample_time_s)  # raises ValueError for what is no multiple
        return self

    @property
    def stand_name(self) -> str:
        """Of the stand in its history."""
        return self.stand or self.name

    # -- the machine -------------------------------------------------------------------------------------

    @property
    def machine_kind(self) -> MachineKind:
        """What kind of machine it is."""
        return self.machine.machine_kind

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
        if not isinstance(machine, ModelParameters):
            return self.safety.quick_stop_rad_s2
        if not self.stops_together:
            return self.safety.quick_stop_m_s2
        axes = range(1, machine.axis_count + 1)
        return min(self.safety.quick_stop_m_s2, *(_STOPPING_SHARE * self.fastest_m_s2(axis) for axis in axes))

    @property
    def stops_together(self) -> bool:
        """Whether the axes are brought to rest in the ratio of their speeds."""
        return isinstance(self.machine, ModelParameters) and self.machine.span_count > 1

    def fastest_m_s2(self, axis: int) -> float:
        """How fast the drive of an axis of a web line changes its speed, by its torque limit and all that it turns."""
        model = self.web_line
        limit_N = per_item(self.drive_parameters.torque_limit_Nm, axis) * model.motor_rad_per_m(axis)
        return limit_N / model.mass_kg(axis)

    def rig_parameters(self) -> RigParameters:
        """The simulated hardware of a web line: its axes without their effects, with those hidden in the hardware.

        Raises UnusableInputError for a machine of another kind.
        """
        hardware = self.hardware
        axes = {name: axis for axis, name in enumerate(self.drives, 1)}
        load_motors = [CoupledMotor(axis=axes[motor.shaft], motor=motor.motor) for motor in self.load_motors.values()]
        return RigParameters.matching(self.web_line, load_motors, hardware.sensors, hardware.effects)

    def servo_rig_parameters(self, effects: Sequence[ShaftEffect] | None = None) -> ServoRigParameters:
        """The simulated hardware of a servo axis, with the effects hidden in it unless others are given.

        Raises UnusableInputError for a machine of another kind.
        """
        hardware = self.hardware
        (load_motor,) = self.load_motors.values()
        given = hardware.effects if effects is None else effects
        hidden = [ShaftEffect.model_validate(entry.model_dump()) for entry in given]
        return ServoRigParameters.matching(self.servo_axis, hardware.shaft, load_motor.motor, hardware.sensors, hidden)

    def imitated_shaft(self) -> ServoAxisParameters:
        """The truth of a run: the servo axis without the model's effects, with what `load:` changes and hides.

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
        return (
            *self.parts_of(Role.AXIS),
            *self.parts_of(Role.LOAD_MOTOR),
            *self.parts_of(Role.VIRTUAL_AXIS),
            *self.parts_of(Role.VIRTUAL_IO),
        )

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

    def part(self, name: str) -> Part:
        """The node of a name. Raises KeyError for none."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(name)

    @property
    def shape(self) -> Shape:
        """What there are several of."""
        machine, motors = self.machine, tuple(self.load_motors)
        if not isinstance(machine, ModelParameters):
            return Shape(machine.axis_count, motors)
        return web_line_shape(machine, motors, self.twin, self.controllers.values(), self.load.measured)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """What a sample of this bench has, in recording order."""
        return signals_of(self.machine_kind, self.shape)

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
        found = tension_loops(self.controllers.values())
        return {control.span: control for control in sorted(found, key=lambda each: each.span)}

    @property
    def position_controls(self) -> dict[str, PositionControlConfig]:
        """The controllers of dancers and accumulators by the name of the station."""
        return {control.station: control for control in position_loops(self.controllers.values())}

    @property
    def plain_paths(self) -> tuple[str, ...]:
        """The quantities of this bench that can be set, without those of effects."""
        known = plain_paths(self.machine_kind, self.shape)
        return tuple(path for path in known if self.path_problem(path) is None)

    def path_problem(self, path: str) -> str | None:
        """Why this bench has no such quantity that can be set, in one line, or None."""
        if path == MODEL_CHANGE and self.twin.live_diagnosis is None:
            return f"'twin: {{live_diagnosis: {{}}}}' for '{path}': nothing proposes changes of the model"
        return path_problem(path, self.machine_kind, self.shape, self.loaded_axes)

    def controller_of(self, span: int) -> str:
        """The name of the controller that keeps the tension of a span. Raises KeyError for none."""
        wanted = self.tension_controls[span]
        return next(name for name, control in self.controllers.items() if control is wanted)

    @field_validator("cycle_time_s")
    @classmethod
    def _whole_microseconds(cls, value: float) -> float:
        if abs(value * 1e6 - round(value * 1e6)) > 1e-6:
            raise ValueError("whole microseconds (1006h, communication cycle period)")
        return value

    @property
    def simulated_drives(self) -> dict[int, str]:
        """Parts that the simulated hardware plays, by node id."""
        return {part.node.node_id: part.name for part in self.parts if part.is_simulated}

    @property
    def virtual_nodes(self) -> dict[int, str]:
        """Parts that the twin plays, by node id."""
        return {part.node.node_id: part.name for part in self.parts if part.is_virtual}

    def process_settings(self, part: Literal["bench", "hardware", "twin"]) -> ProcessSettings | None:
        """What the process of a part asks of the operating system; None in lockstep."""
        if self.pace == "lockstep":
            return None
        wanted = self.realtime
        below = 0 if part == "bench" else 1
        priority = None if wanted.priority is None else wanted.priority - below
        return ProcessSettings(priority, getattr(wanted.cores, part), wanted.lock_memory)

    def units_of(self, node_id: int) -> dict[str, float]:
        """Units that the config gives for a node; none for one that is not the bench's."""
        return next((part.node.unit_overrides for part in self.parts if part.node.node_id == node_id), {})

    @property
    def bus_address(self) -> BusAddress:
        """The bus with its bitrate; an embedded bus takes its timing from the pace."""
        timing = "virtual" if self.pace == "lockstep" else "real"
        return BusAddress.parse(self.bus.address, bitrate=self.bus.bitrate, timing=timing)

    @property
    def cycle_ns(self) -> int:
        """The SYNC period in ns."""
        return round(self.cycle_time_s * 1e6) * 1000
