"""Emulation of a shaft by a load motor, from the measured position of the real one; the law is in
`hilbench.plant.web_line.shaft_load`. The stability limit of emulated inertia is in
`hilbench.plant.servo_axis.stability`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, Reals, Vector, Wholes, arrays_in, entry_point, record_at, table_of
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.measured_motion import (
    HasFollowed,
    InStep,
    MeasuredMotion,
    MotionVectors,
    ahead_s,
    elapsed_s,
    publish,
    take,
)
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import IDS, emulated_effect_problem
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.shaft import Shaft
from hilbench.plant.servo_axis.tracking_filter import ORDER, TrackingFilter, gains, transition
from hilbench.plant.web_line.shaft_load import LAW, ShaftLoad, follow, put_torque

#: Time constant of the acceleration filter, in bus cycles: longer ones allow more inertia, and emulate it worse.
FILTER_CYCLES = 2.5
#: Slope of dry friction over its sign change, as a share of J_r/lead: a torque that is late by `lead` can damp with π/2
#: times that before it oscillates.
_SLOPE_SHARE = 0.25
_LEAST_LEAD_S = 1e-3


class ShaftCycle(NamedTuple):
    """Emulated shaft on measured motion: time that has elapsed (1,) in s, where it was no cycle; torques of the load
    motors (M,), the process image's values and the offsets in it."""

    load: ShaftLoad
    motion: MotionVectors
    speeds: Reals
    elapsed_s: Reals
    torques: Reals
    values: Reals
    at: Wholes


#: What `_follow` does: a cycle with a sample that is on time, or late; the load torque only.
_ON_TIME, _LATE, _PULL = 0, 1, 2
#: Results of `_follow`: nothing to follow; followed; only counted, as elapsed time or lead are not those of a normal
#: cycle.
NOTHING, FOLLOWED, ANOTHER_TIME = 0, 1, 2


@entry_point(COUNT, TABLE, allocates=False)
def _follow(what: int, table: NDArray[np.int64]) -> int:
    if len(table) == 0:
        return NOTHING
    if what == _PULL:
        load = arrays_in(table, ShaftLoad)
        put_torque(load, 0, load.law.speed_rad_s)
        return FOLLOWED
    cycle = arrays_in(table, ShaftCycle)
    load, motion, speeds, torques = cycle.load, cycle.motion, cycle.speeds, cycle.torques
    take(cycle.values, cycle.at, motion.positions, speeds)
    duration_s = elapsed_s(motion.state, motion.travels, motion.positions, speeds, what == _LATE)
    if not duration_s > 0.0:
        return NOTHING
    if duration_s != load.law.cycle_s or ahead_s(motion.state) != load.law.lead_s:
        cycle.elapsed_s[0] = duration_s
        return ANOTHER_TIME
    follow(load.motion, load.forward, load.gain, motion.positions[0])
    load.time_s[0] += duration_s
    put_torque(load, 0, speeds[0])
    for k in range(len(torques)):
        torques[k] = load.law.torque_Nm
    publish(cycle.values, cycle.at[2:], torques, torques)
    return FOLLOWED


def most_rad_s2(real: ServoRigParameters) -> float:
    """Largest acceleration of the rig's shaft by its motors."""
    drives = real.axis.drives
    torque_Nm = real.load_motor.torque_limit_Nm + (per_item(drives.torque_limit_Nm, 1) if drives else inf)
    return torque_Nm / real.inertia_kg_m2


def steepest_Nm_s_per_rad(real: Vector, lead_s: float) -> float:
    """Slope of the emulated dry friction at standstill on the rig with these parameters (P,)."""
    return _SLOPE_SHARE * real.item(lay.P_INERTIA) / max(lead_s, _LEAST_LEAD_S)


class EmulatedShaft:
    """Emulated shaft as a `Follower`: measured positions of the shaft in, torque of the load motor on it out.

    emulated: the emulated machine, without its drive. real: the rig as assumed; hidden properties of the real one are
    unknown here, so `effects` of the rig do not count.
    """

    def __init__(
        self,
        emulated: ServoAxisParameters,
        real: ServoRigParameters,
        cycle_s: float,
        *,
        filter_cycles: float = FILTER_CYCLES,
    ) -> None:
        of_shaft = tuple(e for e in emulated.effects if emulated_effect_problem(e.effect, e.axis) is None)
        known = real.axis.model_copy(update={"effects": ()})
        self._machine = Shaft(emulated.model_copy(update={"effects": of_shaft}), None, ())
        self._real = lay.pack(known, real.load_motor)
        self._filter = TrackingFilter(filter_cycles * cycle_s)
        machine, law, size = self._machine.vectors, np.zeros(LAW.itemsize // 8), (ORDER, ORDER)
        record_at(law, LAW).most_rad_s2, record_at(law, LAW).cycle_s = most_rad_s2(real), cycle_s
        motion, forward, gain = self._filter.motion, transition(cycle_s), gains(cycle_s, self._filter.filter_s)
        shaft = machine.p[np.newaxis]
        self.load = ShaftLoad(shaft, machine.u, np.zeros(1), self._real, motion, law, np.zeros(size), forward, gain)
        self._table = table_of(self.load)
        self._stale = True  # something was changed since the last step

    def describe(self) -> PlantDescription:
        """Description: kind and parameters of a servo axis; states and outputs are the shaft's motion."""
        motion = (
            Quantity("x1_rad", "rad", "position of the shaft"),
            Quantity("v1_rad_s", "rad/s", "speed of the shaft"),
            Quantity("a1_rad_s2", "rad/s²", "acceleration of the shaft"),
        )
        effects = tuple(effect_id for effect_id in IDS if emulated_effect_problem(effect_id, 1) is None)
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
        return self.load.time_s.item(0)

    def reset(self, positions: Sequence[float]) -> None:
        """Reset to rest at `positions` (1,)."""
        self._filter.reset(positions[0])

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """Follow the shaft to `positions` (1,), `duration_s` (above 0) after the last call."""
        self._filter.update(positions[0], duration_s)
        self.load.time_s[0] += duration_s
        self._stale = False

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque of the load motor, acting `lead_s` after the motion was measured; `speeds` (1,) are measured.

        Raises ValueError for other axes than the one.
        """
        if any(axis != 1 for axis in axes):
            raise ValueError(f"load motors on axes {list(axes)}, expected axis 1: a servo axis has one shaft")
        law = self.lead(self.load, lead_s)
        law.speed_rad_s = speeds[0]
        _follow(_PULL, self._table)
        return [float(law.torque_Nm)] * len(axes)

    def lead(self, load: ShaftLoad, lead_s: float) -> Any:
        """Law of a load whose torque acts `lead_s` after the motion was measured."""
        law = record_at(load.law, LAW)
        law.lead_s, law.steepest = lead_s, steepest_Nm_s_per_rad(self._real, lead_s)
        load.ahead[:] = transition(lead_s)
        return law

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> ShaftInStep | None:
        """Compiled follower with load motors on `axes`, as of `FollowsInStep`; None of a subclass."""
        return ShaftInStep(self, motion, len(axes)) if type(self) is EmulatedShaft else None

    def outputs(self) -> dict[str, float]:
        """Filtered motion of the shaft."""
        return dict(zip(("x1_rad", "v1_rad_s", "a1_rad_s2"), self._filter.motion.tolist(), strict=False))

    def get_state(self) -> PlantState:
        """State of the filtered motion."""
        return PlantState(self.outputs(), (self._filter.motion.copy(), self.time_s))

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal machine, or transfer the states given by name. Raises ValueError."""
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
                self._filter.motion[:], self.load.time_s[0] = motion, time_s
            case _:
                raise ValueError("a state of another machine, expected one of an equal emulated shaft")

    def parameter(self, name: str) -> float:
        """Present value of an emulated parameter. Raises ValueError for an unknown name."""
        return self._machine.parameter(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Emulate another value from now on. Raises ValueError for an unknown name or an impossible value."""
        self._stale = True
        self._machine.set_parameter(name, value)

    def set_input(self, name: str, value: float) -> None:
        """Set the external torque that is emulated as well. Raises as `Shaft.set_input`."""
        self._stale = True
        self._machine.set_input(name, value)

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Emulate an effect of the shaft from now on. Raises ValueError, also for effects of drive and motor."""
        self._check(effect_id, axis)
        self._stale = True
        self._machine.set_effect(effect_id, axis, section=section, slot=slot, **parameters)

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Stop emulating an effect. Raises as `set_effect`."""
        self._check(effect_id, axis)
        self._stale = True
        self._machine.clear_effect(effect_id, axis, section=section, slot=slot)

    def _check(self, effect_id: str, axis: int | None) -> None:
        problem = emulated_effect_problem(effect_id, axis)
        if problem:
            raise ValueError(problem)


class ShaftInStep(InStep):
    """Compiled step of an `EmulatedShaft` on measured motion; see `hilbench.plant.measured_motion.InStep`. It publishes
    no outputs: only parameters are read of it."""

    def __init__(self, shaft: EmulatedShaft, motion: MeasuredMotion, motors: int) -> None:
        self._shaft, self._motion, torques_Nm = shaft, motion, np.zeros(motors)
        load = shaft.load._replace(law=shaft.load.law.copy(), ahead=shaft.load.ahead.copy())
        shaft.lead(load, motion.ahead_s)
        nothing = np.zeros(0), np.zeros(0, np.int64)
        cycle = ShaftCycle(load, motion.vectors, motion.speeds, np.zeros(1), torques_Nm, *nothing)
        super().__init__(_follow, FOLLOWED, torques_Nm, cycle)

    @property
    def is_shown(self) -> bool:
        """True if nothing was changed since the last step."""
        return not self._shaft._stale

    def has_followed(self, code: int) -> HasFollowed:
        """Result of a step by its return code."""
        if code == NOTHING:
            return HasFollowed.NOT
        if code == ANOTHER_TIME:
            self._follow_for(self._arrays.elapsed_s.item(0))
        self._shaft._stale = False
        return HasFollowed.ALL

    def _follow_for(self, duration_s: float) -> None:
        shaft, motion = self._shaft, self._motion
        shaft.follow(motion.vectors.positions.tolist(), duration_s)
        self._torques[:] = shaft.load_torques_Nm([1] * len(self._torques), motion.speeds.tolist(), motion.ahead_s)
        self._arrays.values[self._arrays.at[2:]] = self._torques
