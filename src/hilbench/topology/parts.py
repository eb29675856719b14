"""The parts of a bench: CANopen nodes, what each is for, and their place in the topology."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

from pydantic import Field, PositiveFloat, field_validator

from hilbench.block import Block
from hilbench.plant.parameters import LoadMotorParameters

PartName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=32)]


class UnitsConfig(Block):
    """Units of a drive that its own objects do not state (608Fh, 60A9h, 6076h); motor side."""

    position_rad: PositiveFloat | None = Field(default=None, description="rad per unit of 6064h")
    velocity_rad_s: PositiveFloat | None = Field(default=None, description="rad/s per unit of 60FFh and 606Ch")
    rated_torque_Nm: PositiveFloat | None = Field(default=None, description="N·m that 1000 units of 6077h are")


def parse_object(key: str) -> tuple[int, int]:
    """Index and sub-index of ``60A9h`` or ``60C2h:1``. Raises ValueError."""
    match = re.fullmatch(r"([0-9A-Fa-f]{4})h(?::([0-9]{1,3}))?", key)
    if match is None:
        raise ValueError(f"an object such as 60A9h or 60C2h:1, '{key}' is none")
    return int(match[1], 16), int(match[2] or 0)


class NodeConfig(Block):
    """One CANopen node of the bench."""

    node_id: int = Field(ge=1, le=127, description="CANopen node id; two axes of one node have it in common")
    eds: Path = Field(description="EDS or DCF file; a relative path is taken from the config file's folder")
    units: UnitsConfig = Field(
        default=UnitsConfig(), description="a drive's units where its objects do not define them"
    )
    parameters: dict[str, int | float] = Field(
        default={}, description="objects written to a drive at configuration, device units: {60A9h: 0xFAB44700}"
    )

    @field_validator("parameters")
    @classmethod
    def _name_objects(cls, value: dict[str, int | float]) -> dict[str, int | float]:
        for key in value:
            parse_object(key)
        return value

    @property
    def writes(self) -> dict[tuple[int, int], int | float]:
        """`parameters` by index and sub-index."""
        return {parse_object(key): value for key, value in self.parameters.items()}

    @property
    def unit_overrides(self) -> dict[str, float]:
        """The units that the config gives, as `DriveUnits.from_objects` takes them."""
        return self.units.model_dump(exclude_none=True)


class DeviceConfig(NodeConfig):
    """A node that is a real device, or one of the simulated hardware."""

    simulated: bool = Field(default=True, description="part of the simulated hardware; false: a real device")
    axis: int = Field(
        default=1,
        ge=1,
        le=2,
        description="of a node with two axes the first, with objects from 6000h on, or the second, from 6800h on",
    )


class DriveConfig(DeviceConfig):
    """The drive of one driven axis of the machine, and its virtual axis in the twin."""

    virtual: NodeConfig = Field(description="the virtual axis: the twin's drive of this axis")


class LoadMotorConfig(DeviceConfig):
    """A load motor: it emulates the machine's pull on the shaft of an axis."""

    shaft: str = Field(description="the drive, by its name under `drives:`, on whose shaft the motor sits")
    motor: LoadMotorParameters = LoadMotorParameters(inertia_kg_m2=0.0005)


class Role(Enum):
    """Purpose of a node."""

    AXIS = "axis"
    LOAD_MOTOR = "load motor"
    VIRTUAL_AXIS = "virtual axis"
    VIRTUAL_IO = "virtual io"


@dataclass(frozen=True)
class Part:
    """A node of the bench with its place in the topology.

    `name` is its name in messages and commands; `axis` the number of the driven axis it turns, simulates, or (a load
    motor) sits on, None for the virtual I/O; `location` its place in the config.
    """

    name: str
    role: Role
    node: NodeConfig
    axis: int | None
    location: tuple[str, ...]

    @property
    def label(self) -> str:
        """The name as it is written in messages."""
        return self.name.replace("_", " ")

    @property
    def node_axis(self) -> int:
        """Number of its axis in its node, from 1."""
        return self.node.axis if isinstance(self.node, DeviceConfig) else 1

    @property
    def is_simulated(self) -> bool:
        """True if the simulated hardware emulates it."""
        return isinstance(self.node, DeviceConfig) and self.node.simulated

    @property
    def is_virtual(self) -> bool:
        """True if the twin emulates it."""
        return self.role in (Role.VIRTUAL_AXIS, Role.VIRTUAL_IO)

    @property
    def is_ours(self) -> bool:
        """True if the simulated hardware or the twin emulates it: no real device."""
        return self.is_simulated or self.is_virtual
