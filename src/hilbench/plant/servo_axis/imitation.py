"""The shaft that a load motor imitates, from the measured position of the one that there is.

    τ_load = −(J_i − J_r)·a − R_i(v) + R_r(v) + U_i(φ) − U_r(φ)

makes a shaft of inertia J_r, friction R_r and unbalance U_r behave like one of J_i, R_i and U_i. The torque acts later
than the motion was measured, so position, speed and acceleration are predicted over that lead. How much inertia can be
imitated is a question of stability: `hilbench.plant.servo_axis.stability`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point, inlined
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import kernel, laws
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import IDS, imitated_effect_problem
from hilbench.plant.servo_axis.layout import Vector
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.shaft import Shaft
from hilbench.plant.servo_axis.tracking_filter import TrackingFilter

#: Time constant of the filter of the acceleration, in bus cycles: longer ones allow more inertia, and imitate it worse.
FILTER_CYCLES = 2.5
#: Dry friction changes its sign over so much speed that its slope is this share of J_r/lead: a torque that is late by
#: `lead` can damp with π/2 times that before it swings.
_SLOPE_SHARE = 0.25
_LEAST_LEAD_S = 1e-3

Torque = Callable[[Vector, Vector, float, float, float, float, float], float]


@inlined
def load_torque_Nm(
    imitated: Vector, real: Vector, time_s: float, x: float, v: float, a: float, steepest: float
) -> float:
    """Torque that makes the real shaft, at x, v, a at a time, the imitated one.

    steepest: N·m·s/rad, slope of the dry friction at standstill.
    """
    inertia = laws.inertia_kg_m2(imitated, time_s) - laws.inertia_kg_m2(real, time_s)
    smooth = laws.smooth_friction_Nm(imitated, v) - laws.smooth_friction_Nm(real, v)
    dry = laws.dry_friction_Nm(imitated, v) - laws.dry_friction_Nm(real, v)
    limited = min(max(steepest * v, -abs(dry)), abs(dry)) * (1.0 if dry > 0.0 else -1.0)
    unbalance = laws.unbalance_Nm(imitated, x) - laws.unbalance_Nm(real, x)
    return unbalance - inertia * a - smooth - limited


def _compiled_torque(sources: int) -> Torque:
    """The function that is called from Python; `sources` as in the kernel."""

    @entry_point(VECTOR, VECTOR, REAL, REAL, REAL, REAL, REAL)
    def torque_Nm(
        imitated: Vector, real: Vector, time_s: float, x: float, v: float, a: float, steepest: float
    ) -> float:
        return float(load_torque_Nm(imitated, real, time_s, x, v, a, steepest)) if sources >= 0 else 0.0

    return torque_Nm


_torque_Nm = _compiled_torque(kernel.source_number(__file__))


def most_rad_s2(real: ServoRigParameters) -> float:
    """The acceleration beyond which no motor of the stand turns its shaft."""
    drives = real.axis.drives
    torque_Nm = real.load_motor.torque_limit_Nm + (per_item(drives.torque_limit_Nm, 1) if drives else inf)
    return torque_Nm / real.inertia_kg_m2


def steepest_Nm_s_per_rad(real: Vector, lead_s: float) -> float:
    """Slope of the imitated dry friction at standstill on the stand with these parameters (P,)."""
    return _SLOPE_SHARE * real.item(lay.P_INERTIA) / max(lead_s, _LEAST_LEAD_S)


class ImitatedShaft:
    """A `Follower`: measured positions of the shaft in, torque of the load motor on it out.

    imitated: the machine that is not there, its drive aside. real: the stand as it is believed to be; what is hidden
    in the real one is not known here, so `effects` of the stand do not count.
    """

    def __init__(
        self,
        imitated: ServoAxisParameters,
        real: ServoRigParameters,
        cycle_s: float,
        *,
        filter_cycles: float = FILTER_CYCLES,
    ) -> None:
        of_shaft = tuple(e for e in imitated.effects if imitated_effect_problem(e.effect, e.axis) is None)
        known = real.axis.model_copy(update={"effects": ()})
        self._machine = Shaft(imitated.model_copy(update={"effects": of_shaft}), None, (), 1)
        self._real = lay.pack(known, real.load_motor)
        self._filter = TrackingFilter(filter_cycles * cycle_s)
        # No motor turns the shaft faster: more is a sample of another instant than it was taken for.
        self._most_rad_s2 = most_rad_s2(real)
        self._time_s = 0.0

    def describe(self) -> PlantDescription:
        """Kind and parameters of a servo axis; what it says of the motion, instead of what it does."""
        motion = (
            Quantity("x1_rad", "rad", "position of the shaft"),
            Quantity("v1_rad_s", "rad/s", "speed of the shaft"),
            Quantity("a1_rad_s2", "rad/s²", "acceleration of the shaft"),
        )
        effects = tuple(effect_id for effect_id in IDS if imitated_effect_problem(effect_id, 1) is None)
        of_machine = self._machine.describe()
        return PlantDescription(
            kind=of_machine.kind,
            position_unit=of_machine.position_unit,
            axes=of_machine.axes,
            motors=(),
            states=motion,
            inputs=of_machine.inputs,
            outputs=motion,
            parameters=of_machine.parameters,
            effects=effects,
        )

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self._time_s

    def reset(self, positions: Sequence[float]) -> None:
        """The shaft is at rest at `positions` (1,)."""
        self._filter.reset(positions[0])

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """The shaft is at `positions` (1,), `duration_s` (above 0) after the last call."""
        self._filter.update(positions[0], duration_s)
        self._time_s += duration_s

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque of the load motor that acts `lead_s` after the motion was measured; `speeds` (1,) are measured.

        Raises ValueError for other axes than the one.
        """
        if any(axis != 1 for axis in axes):
            raise ValueError(f"load motors on axes {list(axes)}, expected axis 1: a servo axis has one shaft")
        position, _, acceleration, jerk = self._filter.predicted(lead_s).tolist()
        acceleration = min(max(acceleration, -self._most_rad_s2), self._most_rad_s2)
        speed = speeds[0] + lead_s * (acceleration - 0.5 * lead_s * jerk)
        steepest = steepest_Nm_s_per_rad(self._real, lead_s)
        torque = _torque_Nm(self._machine.packed, self._real, self._time_s, position, speed, acceleration, steepest)
        return [torque + self._machine.external_torque_Nm] * len(axes)

    def outputs(self) -> dict[str, float]:
        """Motion of the shaft, as the filter has it."""
        return dict(zip(("x1_rad", "v1_rad_s", "a1_rad_s2"), self._filter.motion.tolist(), strict=False))

    def get_state(self) -> PlantState:
        """The filtered motion now."""
        return PlantState(self.outputs(), (self._filter.motion.copy(), self._time_s))

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Go on from a state of an equal machine, or transfer the states given by name. Raises ValueError."""
        if isinstance(state, PlantState):
            self._restore(state.memory)
            return
        names = self.describe().states
        for name, value in state.items():
            place = [quantity.name for quantity in names].index(checked_name("state", name, names))
            self._filter.motion[place] = value

    def _restore(self, memory: object) -> None:
        match memory:
            case (np.ndarray() as motion, float() as time_s):
                self._filter.motion, self._time_s = motion.copy(), time_s
            case _:
                raise ValueError("a state of another machine, expected one of an equal imitated shaft")

    def parameter(self, name: str) -> float:
        """Present value of what is imitated. Raises ValueError for an unknown name."""
        return self._machine.parameter(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Imitate another value from now on. Raises ValueError for an unknown name or an impossible value."""
        self._machine.set_parameter(name, value)

    def set_input(self, name: str, value: float) -> None:
        """Torque from outside that is imitated as well. Raises as `Shaft.set_input`."""
        self._machine.set_input(name, value)

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Imitate an effect of the shaft from now on. Raises ValueError, also for effects of drive and motor."""
        self._check(effect_id, axis)
        self._machine.set_effect(effect_id, axis, section=section, slot=slot, **parameters)

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Imitate it no more. Raises as `set_effect`."""
        self._check(effect_id, axis)
        self._machine.clear_effect(effect_id, axis, section=section, slot=slot)

    def _check(self, effect_id: str, axis: int | None) -> None:
        problem = imitated_effect_problem(effect_id, axis)
        if problem:
            raise ValueError(problem)
