"""The behaviour file of a simulated drive: its shaft, its switches, and what real drives do wrong.

Angles are in turns of the motor, times in seconds after power-on.
"""

from __future__ import annotations

from math import inf, pi
from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import Field, FiniteFloat, model_validator

from hilbench import strict_yaml
from hilbench.block import Block
from hilbench.cia402.axis import MOST_AXES
from hilbench.cia402.switches import Switches, Zone
from hilbench.plant.parameters import NotNegative, Positive
from hilbench.plant.servo_axis.parameters import ShaftParameters

_TURN_RAD = 2.0 * pi

Byte = Annotated[int, Field(ge=0, le=0xFF)]
Word = Annotated[int, Field(ge=0, le=0xFFFF)]


class Units(Block):
    """Factors that are not in the EDS file, at the motor shaft."""

    position_rad: Positive | None = Field(default=None, description="of a position unit (6064h)")
    velocity_rad_s: Positive | None = Field(default=None, description="of a velocity unit (606Ch, 60FFh)")
    rated_torque_Nm: Positive | None = Field(default=None, description="torques (6071h, 6077h) are thousandths of it")


class SwitchPlaces(Block):
    """Positions of the switches."""

    negative_limit: FiniteFloat = Field(default=-10.0, description="the negative limit switch is active up to there")
    positive_limit: FiniteFloat = Field(default=10.0, description="the positive limit switch is active from there on")
    home: tuple[FiniteFloat, FiniteFloat] = Field(default=(1.25, 1.75), description="home switch: active from, to")
    probe1: tuple[FiniteFloat, FiniteFloat] = Field(default=(0.25, 0.75), description="input of touch probe 1")
    probe2: tuple[FiniteFloat, FiniteFloat] = Field(default=(2.25, 2.75), description="input of touch probe 2")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for name, (low, high) in (
            ("negative_limit to positive_limit", (self.negative_limit, self.positive_limit)),
            *((name, getattr(self, name)) for name in ("home", "probe1", "probe2")),
        ):
            if not low < high:
                raise ValueError(f"{name}: from {low} to {high} turns, expected the lower one first")
        return self

    def switches(self) -> Switches:
        """Switches for the drive, in rad."""
        return Switches(
            negative_limit=Zone(-inf, self.negative_limit * _TURN_RAD),
            positive_limit=Zone(self.positive_limit * _TURN_RAD, inf),
            home=_zone(self.home),
            probes=(_zone(self.probe1), _zone(self.probe2)),
        )


def _zone(turns: tuple[float, float]) -> Zone:
    return Zone(turns[0] * _TURN_RAD, turns[1] * _TURN_RAD)


class RefusedWrite(Block):
    """An object that can't be written."""

    index: Word = Field(description="of the object, e.g. 0x6083")
    sub: Byte = Field(default=0, description="its sub-index")
    abort_code: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = Field(
        default=0x08000022, description="with which a write is answered (CiA 301, table 22)"
    )


class Emergency(Block):
    """An EMCY message that is no fault of the drive."""

    code: Word = Field(description="error code")
    register_bits: Byte = Field(default=1, description="bits of the error register 1001h")
    data: list[Byte] = Field(default=[], max_length=5, description="the maker's bytes")


#: What happens to one axis; all else is the node's.
OF_AN_AXIS: Final = ("fault", "encoder_jump_turns")


class Event(Block):
    """Something that happens once. One of what can happen is given."""

    at_s: NotNegative = Field(description="after power-on")
    axis: int = Field(default=1, ge=1, le=MOST_AXES, description="of a node with several: which one fails, or jumps")
    fault: Word | None = Field(default=None, description="the drive fails with this error code (603Fh, EMCY)")
    emergency: Emergency | None = Field(default=None, description="it sends an EMCY message and continues")
    emergency_over: Word | None = Field(default=None, description="that error is reset")
    encoder_jump_turns: FiniteFloat | None = Field(default=None, description="the encoder jumps by so much")
    no_heartbeat_s: Positive | None = Field(default=None, description="the heartbeat stays away so long")
    silent_s: Positive | None = Field(default=None, description="nothing at all is sent so long")
    reset: bool | None = Field(default=None, description="it resets itself, as after a dip of its supply")

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [name for name, value in self if name not in ("at_s", "axis") and value is not None]
        if len(given) != 1:
            raise ValueError(f"{len(given)} things happen at {self.at_s} s, expected one a row")
        if self.axis > 1 and given[0] not in OF_AN_AXIS:
            raise ValueError(f"{given[0]} of the whole node, expected no axis beside it")
        return self


class Behaviour(Block):
    """The whole file; everything in it may be left out."""

    shaft: ShaftParameters | None = Field(
        default=None, description="what the motor turns; without it one that 0.1 s of rated torque brings to 1000 rpm"
    )
    units: Units = Field(default=Units(), description="factors that the EDS file does not define")
    switches: SwitchPlaces = Field(default=SwitchPlaces(), description="limit, home and probe switches")
    boot_s: NotNegative = Field(default=0.0, description="from power-on to the boot-up message")
    state_change_s: NotNegative = Field(default=0.0, description="how long each transition towards power takes")
    refuse: list[RefusedWrite] = Field(default=[], description="objects that can't be written")
    events: list[Event] = Field(default=[], description="what happens, each once")


def load_behaviour(path: Path) -> Behaviour:
    """Read a behaviour file (YAML). Raises UnusableInputError (file, line, key, found, expected)."""
    return strict_yaml.validate(strict_yaml.load(path), Behaviour)
