"""The one interface behind which a machine stands: what simulated hardware, load model, twin and diagnosis know of it.

Three kinds of object speak it. A closed model (`Plant`) has drives and mechanics, turns with set points at its motor
ports, and is what a twin simulates. Simulated hardware is a `Plant` too: shafts with load motors and sensors, without
the machine that the load motors emulate. A `Follower` is that emulated machine: measured positions of the driven axes
go in, torques for the load motors come out.

Names are those of the part and its number, with the unit last: `x1_m`, `v2_m_s`, `tau1_Nm`, `F1_N`, `strain1`;
a rotary machine has `x1_rad`, `v1_rad_s`. A ratio has the unit "1".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hilbench.did_you_mean import expected_one_of
from hilbench.plant.motor_port import MotorPort

if TYPE_CHECKING:  # numba, which a check of a config does not need
    from hilbench.cycle_program import CompiledStage


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value that a machine has: its name, its SI unit ("1" for a ratio) and what it means."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Motor:
    """A motor of a machine, in the order of its ports.

    Axis motors come first, motor k on axis k; further ones are load motors, each on the shaft of any axis.
    """

    axis: int  #: on whose shaft it is, counted from 1
    rad_per_unit: float  #: turn of its shaft per unit of the axis' position: i/r in rad/m, i in rad/rad


@dataclass(frozen=True, slots=True)
class PlantDescription:
    """What a machine is, and every name that can be asked for."""

    kind: str  #: as in a config: "web_line", "servo_axis", …
    position_unit: Literal["m", "rad"]  #: of its axes' positions; speeds are per second
    axes: int  #: driven axes
    motors: tuple[Motor, ...]  #: those of the axes, then load motors; a follower has none
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameters: tuple[Quantity, ...]
    effects: tuple[str, ...]  #: ids of those it can be given while it runs


@dataclass(frozen=True, slots=True)
class PlantState:
    """The state of a machine at one instant, from which an equal machine goes on bit for bit.

    Parameters, effects and inputs are none of it.
    """

    values: Mapping[str, float]  #: the states of the description, by name
    memory: object  #: what is not named (control loops, past torques, sensors): only a machine of the kind reads it


@runtime_checkable
class Machine(Protocol):
    """What closed models, simulated hardware and followers have in common.

    An unknown name, and a value that cannot be, raise ValueError with one line: what was found, what was expected.
    """

    def describe(self) -> PlantDescription:
        """What it is; the same for as long as it is there."""

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""

    def outputs(self) -> dict[str, float]:
        """The outputs of the description as they are now, true (without sensors)."""

    def get_state(self) -> PlantState:
        """The state as it is now."""

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Go on from a state of an equal machine, exactly; or transfer the given states by name: the others stay."""

    def parameter(self, name: str) -> float:
        """Present value of a parameter, without what effects make of it."""

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on; the state stays."""

    def set_input(self, name: str, value: float) -> None:
        """What the neighbourhood does to it (a boundary) from now on."""

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Give it an effect with these parameters from now on; the states stay.

        `axis`, counted from 1, for effects of an axis; `section`, from 1, for those of what is between two axes (None:
        everywhere); `slot` for effects that can be given several times.
        """

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Make an effect neutral from now on."""


@runtime_checkable
class Steps(Protocol):
    """What motors turn."""

    def step(self, duration_s: float) -> None:
        """Go on for so long with the set points that the motors have."""


@runtime_checkable
class StepsInModes(Protocol):
    """The same without ports, while no motor changes its mode."""

    def steps_in_modes(
        self, set_points: NDArray[np.float64], duration_s: float, shown: NDArray[np.float64]
    ) -> CompiledStage | None:
        """What lets it go on with set points (M,); `shown`, (5 M,): position, velocity, torque, reference, torque
        limited. None for a machine that can't."""


class Plant(Machine, Protocol):
    """A machine that turns with the set points of its motor ports: a closed model, or simulated hardware."""

    @property
    def ports(self) -> tuple[MotorPort, ...]:
        """One for each motor of the description; empty if every motor is off for good."""

    def lock_to(self, duration_s: float) -> None:
        """Let the drives' sample time be the nearest to the model's of which `duration_s` is a multiple, as that of
        drives whose loops lock to a cycle."""

    def step(self, duration_s: float) -> None:
        """Go on with the ports' set points held, and write the feedback to the ports.

        Raises ValueError for a duration that is no multiple of the drives' sample time.
        """


@runtime_checkable
class Follower(Machine, Protocol):
    """A machine that is not there, emulated by load motors: it follows measured positions of the driven axes.

    Positions (N,) and speeds (N,) are of all driven axes, in the machine's unit and that per second.
    """

    def reset(self, positions: Sequence[float]) -> None:
        """Start again at these positions, at rest, as the machine is at the start; parameters and time stay."""

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """The axes are now at `positions`, `duration_s` (above 0) after the last call."""

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque at the shaft of a load motor on each of `axes` (counted from 1) that emulates the machine there.

        `speeds` are the measured ones of all axes. The machine is predicted by `lead_s`, with the axes going on as in
        the last cycle: the torque acts so much later than the motion was measured.
        """


def checked_name(kind: str, name: str, known: Iterable[Quantity]) -> str:
    """The name, if one of `known` has it. Raises ValueError: `kind` ("parameter", …), what was found and expected."""
    names = [quantity.name for quantity in known]
    if name not in names:
        expected = expected_one_of(name, names) if names else ", expected none: the machine has no such quantity"
        raise ValueError(f"unknown {kind} '{name}'{expected}")
    return name
