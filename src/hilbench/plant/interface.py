"""Interface of a machine to simulated hardware, load model, twin and diagnosis.

Three kinds of object implement it. A closed model (`Plant`) has drives and mechanics, is driven by set points at its
motor ports, and is simulated by a twin. Simulated hardware is a `Plant` too: shafts with load motors and sensors,
without the machine that the load motors emulate. A `Follower` is that emulated machine: measured positions of the
driven axes go in, torques for the load motors come out.

Names are those of the part and its number, with the unit last: `x1_m`, `v2_m_s`, `tau1_Nm`, `F1_N`, `strain1`; a rotary
machine has `x1_rad`, `v1_rad_s`. A ratio has the unit "1".
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
    """Quantity of a machine: name, SI unit ("1" for a ratio) and meaning."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Motor:
    """Motor of a machine, in the order of its ports.

    Axis motors come first, motor k on axis k; further ones are load motors, each on the shaft of any axis.
    """

    axis: int  #: axis of its shaft, counted from 1
    rad_per_unit: float  #: turn of its shaft per unit of the axis's position: i/r in rad/m, i in rad/rad


@dataclass(frozen=True, slots=True)
class PlantDescription:
    """Description of a machine, with all names of its quantities."""

    kind: str  #: as in a config: "web_line", "servo_axis", …
    position_unit: Literal["m", "rad"]  #: of its axes' positions; speeds are per second
    axes: int  #: driven axes
    motors: tuple[Motor, ...]  #: those of the axes, then load motors; a follower has none
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameters: tuple[Quantity, ...]
    effects: tuple[str, ...]  #: ids of those it can be given at run time


@dataclass(frozen=True, slots=True)
class PlantState:
    """State of a machine at one instant, from which an equal machine continues bit for bit.

    Parameters, effects and inputs are not included.
    """

    values: Mapping[str, float]  #: the states of the description, by name
    memory: object  #: unnamed state (control loops, past torques, sensors), private to machines of the kind


@runtime_checkable
class Machine(Protocol):
    """Common interface of closed models, simulated hardware and followers.

    An unknown name or an impossible value raises ValueError with one line: found, expected.
    """

    def describe(self) -> PlantDescription:
        """Description; constant."""

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""

    def outputs(self) -> dict[str, float]:
        """Present outputs of the description, true values (without sensors)."""

    def get_state(self) -> PlantState:
        """Present state."""

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal machine, exactly; or transfer the given states by name: the others stay."""

    def parameter(self, name: str) -> float:
        """Present value of a parameter, without effects."""

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on; the state stays."""

    def set_input(self, name: str, value: float) -> None:
        """Set an input (a boundary) from now on."""

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect's parameters from now on; the states stay.

        `axis`, counted from 1, for effects of an axis; `section`, from 1, for those between two axes (None:
        everywhere); `slot` for effects that can be given several times.
        """

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Make an effect neutral from now on."""


@runtime_checkable
class Steps(Protocol):
    """Simulation driven by motors."""

    def step(self, duration_s: float) -> None:
        """Step by this duration with the motors' present set points."""


@runtime_checkable
class StepsInModes(Protocol):
    """Simulation without ports, while no motor changes its mode."""

    def steps_in_modes(
        self, set_points: NDArray[np.float64], duration_s: float, shown: NDArray[np.float64]
    ) -> CompiledStage | None:
        """Compiled stage of a step with set points (M,); `shown`, (5 M,): position, velocity, torque, reference, torque
        limited. None for a machine without one."""


class Plant(Machine, Protocol):
    """Machine driven by the set points of its motor ports: a closed model, or simulated hardware."""

    @property
    def ports(self) -> tuple[MotorPort, ...]:
        """Port of each motor of the description; empty if every motor is off for good."""

    def lock_to(self, duration_s: float) -> None:
        """Set the drives' sample time to the nearest to the model's of which `duration_s` is a multiple, as of drives
        whose loops lock to a cycle."""

    def step(self, duration_s: float) -> None:
        """Step with the ports' set points held, and write the feedback to the ports.

        Raises ValueError for a duration that is no multiple of the drives' sample time.
        """


@runtime_checkable
class Follower(Machine, Protocol):
    """Machine emulated by load motors: it follows measured positions of the driven axes.

    Positions (N,) and speeds (N,) are of all driven axes, in the machine's unit and that per second.
    """

    def reset(self, positions: Sequence[float]) -> None:
        """Restart at these positions, at rest, in the initial state; parameters and time stay."""

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """Move the axes to `positions`, `duration_s` (above 0) after the last call."""

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque at the shaft of a load motor on each of `axes` (counted from 1) that emulates the machine there.

        `speeds` are the measured ones of all axes. The machine is predicted by `lead_s`, with the axes' motion of the
        last cycle: the dead time from the measurement to the torque.
        """


def checked_name(kind: str, name: str, known: Iterable[Quantity]) -> str:
    """Check a name against `known`. Raises ValueError: `kind` ("parameter", …), what was found and expected."""
    names = [quantity.name for quantity in known]
    if name not in names:
        expected = expected_one_of(name, names) if names else ", expected none: the machine has no such quantity"
        raise ValueError(f"unknown {kind} '{name}'{expected}")
    return name
