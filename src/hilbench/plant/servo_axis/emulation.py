"""Emulation of a shaft by a load motor, from the measured position of the real one.

    τ_load = −(J_i − J_r)·a − R_i(v) + R_r(v) + U_i(φ) − U_r(φ)

makes a shaft of inertia J_r, friction R_r and unbalance U_r behave like one of J_i, R_i and U_i. The torque acts later
than the motion was measured, so position, speed and acceleration are predicted over that lead. The stability limit of
emulated inertia is in `hilbench.plant.servo_axis.stability`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    COUNT,
    MATRIX,
    REAL,
    TABLE,
    compiled,
    entry_point,
    floats,
    inlined,
    integers,
    table_of,
)
from hilbench.plant.in_step import CompiledInStep
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.measured_motion import HasFollowed, MeasuredMotion, ahead_s, elapsed_s
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.effects import IDS, emulated_effect_problem
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.shaft import Shaft
from hilbench.plant.servo_axis.tracking_filter import TrackingFilter, gains, later, transition
from hilbench.plant.servo_axis.tracking_filter import follow as follow_position
from hilbench.plant.web_line import laws
from hilbench.plant.web_line.layout import Vector

#: Time constant of the acceleration filter, in bus cycles: longer ones allow more inertia, and emulate it worse.
FILTER_CYCLES = 2.5
#: Slope of dry friction over its sign change, as a share of J_r/lead: a torque that is late by `lead` can damp with π/2
#: times that before it oscillates.
_SLOPE_SHARE = 0.25
_LEAST_LEAD_S = 1e-3

Table = NDArray[np.int64]
Matrix = NDArray[np.float64]

# Rows of the table: parameters of the emulated shaft and of the real one, inputs of the first, its filtered motion, and
# its own figures; of a shaft on measured motion then those of that, `transition` and `gains` of a cycle, `transition`
# over the lead, torques of the load motors (M,), and the process image's values and offsets.
_EMULATED, _REAL, _INPUTS, _FILTERED, _OWN = range(5)
_MOTION, _TRAVELS, _POSITIONS, _SPEEDS, _FORWARD, _GAINS, _FORWARD_AHEAD, _TORQUES, _VALUES, _AT = range(5, 15)
#: Own figures: its time, the largest possible acceleration; a cycle, and the usual lead of the torques; the elapsed
#: time where it was another.
_TIME_S, _MOST_RAD_S2, _CYCLE_S, _LEAD_S, _ELAPSED_S, _OWN_SIZE = range(6)
#: Results of `follow`: nothing to follow; followed; only counted, as elapsed time or lead are not those of a normal
#: cycle.
NOTHING, FOLLOWED, ANOTHER_TIME = range(3)


@inlined
def load_torque_Nm(
    emulated: Vector, real: Vector, time_s: float, x: float, v: float, a: float, steepest: float
) -> float:
    """Load torque that makes the real shaft, at x, v, a at a time, behave as the emulated one.

    steepest: N·m·s/rad, slope of the dry friction at standstill.
    """
    inertia = laws.mass_kg(emulated, lay.AXIS, time_s) - laws.mass_kg(real, lay.AXIS, time_s)
    smooth = laws.smooth_resistance_N(emulated, lay.AXIS, v) - laws.smooth_resistance_N(real, lay.AXIS, v)
    smooth += laws.drag_N(emulated, lay.AXIS, v) - laws.drag_N(real, lay.AXIS, v)
    dry = laws.dry_friction_N(emulated, lay.AXIS, v) - laws.dry_friction_N(real, lay.AXIS, v)
    limited = min(max(steepest * v, -abs(dry)), abs(dry)) * (1.0 if dry > 0.0 else -1.0)
    unbalance = laws.unbalance_N(emulated, lay.AXIS, x) - laws.unbalance_N(real, lay.AXIS, x)
    return unbalance - inertia * a - smooth - limited


@compiled
def _torque_ahead_Nm(table: Table, forward: Matrix, lead_s: float, speed_rad_s: float) -> float:
    """Compiled `EmulatedShaft.load_torques_Nm`; `forward` (4, 4): the `transition` over the lead."""
    emulated, real, inputs = floats(table, _EMULATED, (1,)), floats(table, _REAL, (1,)), floats(table, _INPUTS, (1,))
    motion, own = floats(table, _FILTERED, (1,)), floats(table, _OWN, (1,))
    position, a, jerk = later(motion, forward, 0), later(motion, forward, 2), later(motion, forward, 3)
    # Largest possible acceleration: more is a sample of another instant than assumed.
    a = min(max(a, -own[_MOST_RAD_S2]), own[_MOST_RAD_S2])
    v = speed_rad_s + lead_s * (a - 0.5 * lead_s * jerk)
    steepest = _SLOPE_SHARE * real[lay.P_INERTIA] / max(lead_s, _LEAST_LEAD_S)
    return float(load_torque_Nm(emulated, real, own[_TIME_S], position, v, a, steepest) + inputs[lay.U_TORQUE_NM])


@entry_point(TABLE, MATRIX, REAL, REAL)
def _torque_Nm(table: Table, forward: Matrix, lead_s: float, speed_rad_s: float) -> float:
    return _torque_ahead_Nm(table, forward, lead_s, speed_rad_s)


@entry_point(COUNT, TABLE)
def _follow(late: int, table: Table) -> int:
    if len(table) == 0:
        return NOTHING
    counted, travels, x = floats(table, _MOTION, (1,)), floats(table, _TRAVELS, (1,)), floats(table, _POSITIONS, (1,))
    speeds, values, at = floats(table, _SPEEDS, (1,)), floats(table, _VALUES, (1,)), integers(table, _AT, (1,))
    own, torques = floats(table, _OWN, (1,)), floats(table, _TORQUES, (1,))
    x[0], speeds[0] = values[at[0]], values[at[1]]
    duration_s = elapsed_s(counted, travels, x, speeds, late != 0)
    if not duration_s > 0.0:
        return NOTHING
    lead_s = ahead_s(counted)
    if duration_s != own[_CYCLE_S] or lead_s != own[_LEAD_S]:
        own[_ELAPSED_S] = duration_s
        return ANOTHER_TIME
    follow_position(floats(table, _FILTERED, (1,)), floats(table, _FORWARD, (1, 2)), floats(table, _GAINS, (1,)), x[0])
    own[_TIME_S] += duration_s
    torque_Nm = _torque_ahead_Nm(table, floats(table, _FORWARD_AHEAD, (1, 2)), lead_s, speeds[0])
    for k in range(len(torques)):
        values[at[2 + k]] = torques[k] = torque_Nm
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
        self._machine = Shaft(emulated.model_copy(update={"effects": of_shaft}), None, (), 1)
        self._real = lay.pack(known, real.load_motor)
        self._filter = TrackingFilter(filter_cycles * cycle_s)
        self._cycle_s = cycle_s
        self._own = np.zeros(_OWN_SIZE)
        self._own[_MOST_RAD_S2] = most_rad_s2(real)
        #: Vectors of the first rows of the table.
        machine = self._machine.vectors
        self._kept = machine.p, self._real, machine.u, self._filter.motion, self._own
        self._table = table_of(self._kept)
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
        return self._own.item(_TIME_S)

    def reset(self, positions: Sequence[float]) -> None:
        """Reset to rest at `positions` (1,)."""
        self._filter.reset(positions[0])

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """Follow the shaft to `positions` (1,), `duration_s` (above 0) after the last call."""
        self._filter.update(positions[0], duration_s)
        self._own[_TIME_S] += duration_s
        self._stale = False

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque of the load motor, acting `lead_s` after the motion was measured; `speeds` (1,) are measured.

        Raises ValueError for other axes than the one.
        """
        if any(axis != 1 for axis in axes):
            raise ValueError(f"load motors on axes {list(axes)}, expected axis 1: a servo axis has one shaft")
        return [_torque_Nm(self._table, transition(lead_s), float(lead_s), float(speeds[0]))] * len(axes)

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> ShaftInStep:
        """Compiled follower with load motors on `axes`; see `hilbench.plant.measured_motion.FollowsInStep`."""
        return ShaftInStep(self, motion, len(axes))

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
                self._filter.motion[:], self._own[_TIME_S] = motion, time_s
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


class ShaftInStep(CompiledInStep):
    """Compiled step of an `EmulatedShaft` on measured motion; see `hilbench.plant.measured_motion.InStep`. It publishes
    no outputs: only parameters are read of it."""

    def __init__(self, shaft: EmulatedShaft, motion: MeasuredMotion, motors: int) -> None:
        self._shaft, self._motion, torques_Nm = shaft, motion, np.zeros(motors)
        shaft._own[_CYCLE_S], shaft._own[_LEAD_S] = shaft._cycle_s, motion.ahead_s
        forward, gain = transition(shaft._cycle_s), gains(shaft._cycle_s, shaft._filter.filter_s)
        of_motion = motion.state, motion.travels, motion.positions, motion.speeds
        kept = *shaft._kept, *of_motion, forward, gain, transition(motion.ahead_s), torques_Nm
        super().__init__(_follow, FOLLOWED, torques_Nm, kept)

    @property
    def usable(self) -> bool:
        """Always True."""
        return True

    @property
    def is_shown(self) -> bool:
        """True if nothing was changed since the last step."""
        return not self._shaft._stale

    def has_followed(self, code: int) -> HasFollowed:
        """Result of a step by its return code; see `InStep`."""
        if code == NOTHING:
            return HasFollowed.NOT
        if code == ANOTHER_TIME:
            self._follow_for(self._shaft._own.item(_ELAPSED_S))
        self._shaft._stale = False
        return HasFollowed.ALL

    def _follow_for(self, duration_s: float) -> None:
        assert self._on is not None, "followed before"
        (values, places), shaft, motion = self._on, self._shaft, self._motion
        shaft.follow(motion.positions.tolist(), duration_s)
        self._torques[:] = shaft.load_torques_Nm([1] * len(self._torques), motion.speeds.tolist(), motion.ahead_s)
        values[places[2:]] = self._torques
