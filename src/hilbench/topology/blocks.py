"""The blocks of a bench config: bus, machine, hardware, load, twin, and what each process asks of the system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal, Union

from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator

from hilbench.block import Block
from hilbench.can.open import BusAddress
from hilbench.errors import UnusableInputError
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.machine_kinds import DEFAULT, importable, kinds, problems
from hilbench.plant.effect import EffectPlace, MachineKind
from hilbench.plant.effects import effect_problem, find_effect
from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry, NotNegative, Positive
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.parameters import ShaftParameters
from hilbench.prediction.config import PredictionConfig
from hilbench.topology.parts import NodeConfig
from hilbench.topology.safety import TimeOut
from hilbench.topology.web_line_config import LoadWebConfig


class LiveDiagnosisConfig(Block):
    """A process of its own that compares model and measurement while the bench runs, and names what the model lacks."""

    model_changes: Literal["propose", "apply"] | None = Field(
        default=None,
        description="apply: the twin switches to the model that was found; propose: an operator approves first; "
        "where it is not given, propose on real drives and apply on simulated ones",
    )
    window_s: float = Field(
        default=12.0,
        ge=6.0,
        le=120.0,
        description="data after an effect has begun that it is named from; where they do not suffice, twice as much",
    )
    trial_s: float = Field(
        default=6.0, ge=5.0, le=60.0, description="new data on which a changed model has to be better than the old one"
    )
    memory_s: float = Field(default=180.0, ge=60.0, le=3600.0, description="samples that are kept")


Pace = Literal["lockstep", "realtime"]
Mirroring = Literal["listen", "copy"]
#: The machine, by its `kind`; without one it is a web line.
if TYPE_CHECKING:
    MachineParameters = Machine
else:
    *_others, _last = kinds()
    MachineParameters = Annotated[
        Union[tuple(Annotated[block, Tag(kind)] for kind, block in importable("parameters").items())],  # noqa: UP007
        Discriminator(
            lambda value: value.get("kind", DEFAULT) if isinstance(value, Mapping) else getattr(value, "kind", DEFAULT),
            custom_error_type="kind",
            custom_error_message="; ".join([f"kind: {', '.join(_others)} or {_last}", *problems()]),
        ),
    ]


class BusConfig(Block):
    """Address of the bus: `embedded`, or any python-can interface and channel such as `socketcan:vcan0`."""

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
        except UnusableInputError as error:  # pydantic adds the place, this key
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
    """Effect of any kind of machine; the whole config decides of which kind it has to be."""

    @model_validator(mode="after")
    def _known(self) -> HiddenEffect:
        problems = [self.problem(kind) for kind in MachineKind]
        if all(problems):
            raise ValueError(problems[0])
        return self

    def problem(self, kind: MachineKind) -> str | None:
        """Why this kind of machine has no such effect, in one line, or None."""
        try:
            effect = find_effect(self.effect, kind)
        except KeyError as error:
            return str(error.args[0])
        return effect.axis_problem(self.axis) or effect.section_problem(self.section) or effect.problem(self.parameters)


def _possible_at(place: EffectPlace) -> AfterValidator:
    """Check that there is a kind of machine that can have each entry; which one it is, the whole config decides."""

    def check(entries: list[HiddenEffect]) -> list[HiddenEffect]:
        for entry in entries:
            at = entry.effect, entry.axis, place, None, None
            problems = [effect_problem(*at, kind, section=entry.section) for kind in MachineKind]
            if all(problems):
                raise ValueError(problems[0])
        return entries

    return AfterValidator(check)


class HardwareConfig(Block):
    """The simulated hardware: the machine's axes as motors with flywheels, and the load motors on their shafts."""

    shaft: ShaftParameters | None = Field(
        default=None,
        description="of a servo axis: the shaft that is really there, with its motor and the load motor beside it; "
        "the machine's unless given",
    )
    sensors: SensorParameters = SensorParameters(torque_noise_Nm=0.05, velocity_noise_rad_s=0.002)
    effects: Annotated[list[HiddenEffect], _possible_at(EffectPlace.HARDWARE)] = Field(
        default=[], description="hidden in the simulated axes"
    )


class LoadShaftConfig(Block):
    """Deviations of the emulated shaft from the model; what is not given is as in `machine:`."""

    inertia_kg_m2: Positive | None = Field(default=None, description="of all that turns, the motor's rotor included")
    coulomb_friction_Nm: NotNegative | None = Field(default=None, description="dry friction")
    viscous_friction_Nm_s_per_rad: NotNegative | None = Field(
        default=None, description="friction in proportion to the speed"
    )
    unbalance_Nm: NotNegative | None = Field(default=None, description="amplitude of the torque of what is unbalanced")


class LoadConfig(Block):
    """The load-model task: the machine that the load motor emulates."""

    web: LoadWebConfig = LoadWebConfig()
    shaft: LoadShaftConfig = LoadShaftConfig()
    effects: Annotated[list[HiddenEffect], _possible_at(EffectPlace.LOAD)] = Field(
        default=[], description="hidden in the emulated mechanics"
    )
    fmu: FmuLoadConfig | None = Field(
        default=None, description="an FMU that the load motors emulate, in the place of what `machine:` describes"
    )
    measured: list[str] = Field(
        default=[],
        description="dancers and accumulators, by their names, with a sensor of their position, reels with one of "
        "their radius, idlers that are load cells: emulated as the machine is, its value is the signal x_NAME_meas_m, "
        "r_NAME_meas_m or F_NAME_meas_N",
    )


class CoresConfig(Block):
    """Core that each process is pinned to; null: none."""

    bench: int | None = Field(default=None, ge=0, le=4095, description="the bench's cyclic loop")
    hardware: int | None = Field(default=None, ge=0, le=4095, description="the simulated hardware")
    twin: int | None = Field(default=None, ge=0, le=4095, description="the twin")


class RealtimeConfig(Block):
    """Settings asked of the operating system at pace `realtime`; what is not permitted is a warning."""

    priority: int | None = Field(
        default=None,
        ge=2,
        le=99,
        description="SCHED_FIFO priority of the bench; simulated hardware, twin one below, an embedded bus one above",
    )
    lock_memory: bool | None = Field(
        default=None, description="keep memory from being paged out; null: where permitted"
    )
    cores: CoresConfig = CoresConfig()


class TwinConfig(EstimationConfig):
    """The twin: its virtual I/O, what it assumes and how it keeps in step with the bench."""

    node: NodeConfig = Field(description="the virtual I/O: boundary inputs and outputs of the twin")
    commissioned: Literal["use", "ignore"] = Field(
        default="use",
        description="the newest commissioning in the history of the stand gives the `priors`, where the config has "
        "none; or not",
    )
    inertia: InertiaConfig = InertiaConfig()
    prediction: PredictionConfig | None = Field(
        default=None, description="look ahead while the bench runs; null: it does not"
    )
    live_diagnosis: LiveDiagnosisConfig | None = Field(
        default=None, description="name what the model lacks while the bench runs; without it nothing is looked for"
    )
