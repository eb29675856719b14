"""Futures of a servo axis from its present estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import table_of
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.parameters import per_item
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.emulation import steepest_Nm_s_per_rad
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.shaft import look as look_at
from hilbench.plant.servo_axis.stability import sampled_shaft
from hilbench.plant.web_line import layout as line
from hilbench.prediction.futures import Futures, Offsets, Prepared, Tally, normal_draws, whole_step_s
from hilbench.prediction.outlook import WatchedQuantity
from hilbench.prediction.servo_axis import kernel

#: Inertia of a future is at least this share of the estimate.
_LEAST_INERTIA_SHARE: Final = 0.05
#: Longest step, s.
_LONGEST_STEP_S: Final = 0.00625
#: Deviations of its speed from zero within which a shaft counts as at rest.
_STANDSTILL: Final = 3.0


@dataclass(frozen=True)
class ShaftPresent:
    """Present estimate of a servo axis, at the motor shaft, SI.

    `speed_sd_rad_s`: deviation of the speed. Inertia and friction by the twin, with their stated deviations;
    `command_rad_s`: as the drive follows it from now on; `error_rad_s`: speed error at the last sample of its velocity
    loop.
    """

    now_s: float
    position_rad: float
    speed_rad_s: float
    speed_sd_rad_s: float
    torque_Nm: float
    command_rad_s: float
    error_rad_s: float
    inertia_kg_m2: float
    inertia_sd_kg_m2: float
    dry_friction_Nm: float
    dry_friction_sd_Nm: float
    viscous_friction_Nm_s_per_rad: float
    viscous_friction_sd_Nm_s_per_rad: float


@dataclass(frozen=True)
class ShaftCourses:
    """Set points at each of T times (T,): speed, rad/s; inertia of the emulated shaft over the present one; its dry
    friction beyond the present one, N·m."""

    speed_rad_s: Array
    inertia_factor: Array
    dry_friction_Nm: Array


#: Courses at times (T,), s of experiment time; set points act a cycle later.
CoursesAt = Callable[[Array], ShaftCourses]


class ShaftFutures(Futures[ShaftPresent, CoursesAt]):
    """Futures of one servo axis, drawn and simulated.

    `watched`: its quantities in the kernel's order; `real`: the rig as assumed, on which the load motor emulates;
    `cycle_s`: between two measurements. The result of `prepare` may be run by any thread. Raises ValueError for a model
    without drives.
    """

    def __init__(
        self,
        model: ServoAxisParameters,
        real: ServoRigParameters,
        watched: Sequence[WatchedQuantity],
        *,
        cycle_s: float,
        horizon_s: float,
        futures: int,
    ) -> None:
        if model.drives is None:
            raise ValueError("the model has no drives, expected 'drives'")
        super().__init__(watched)
        self._futures, self._horizon_s, self._cycle_s = futures, horizon_s, cycle_s
        self._p = lay.pack(model)
        kp = per_item(model.drives.velocity_kp_Nm_s_per_rad, 1)
        self._kp = kp * (1.0 + self._p.item(lay.place("drive_gain")))
        self._real = lay.pack(real.axis, real.load_motor)
        self._steepest = steepest_Nm_s_per_rad(self._real, emulation_delay_s(sampled_shaft(real, cycle_s)))
        self._layout = line.Layout.of(self._p)
        self._inputs = self._layout.new_inputs()
        self._layout.motor_inputs(self._inputs).mode = MotorMode.VELOCITY

    def prepare(self, present: ShaftPresent, courses_at: CoursesAt, offsets: Offsets, *key: int) -> Prepared:
        """Prepare a prediction; see `Futures`."""
        step_s, courses = self._courses(present, courses_at)
        z = normal_draws(self._futures, 4 + self.quantities, *key)
        p = self._p.copy()
        p[lay.P_SAMPLE_TIME_S] = step_s
        shaft = self._drawn(p, present, z)
        start = self._start(p, present, z[:, 3])
        tally = Tally.of(self.watched, offsets, z[:, 4:], step_s, len(courses))

        layout, figures = self._layout, np.array([self._steepest, step_s / self._cycle_s, tally.every])
        room = self._inputs.copy(), layout.new_work(), np.zeros(layout.output_size), np.zeros(self.quantities)
        given = p, self._real, start, shaft, courses
        of = kernel.ShaftFuture(*given, lay.new_state(p), *room, tally.vectors, figures)

        def run() -> None:
            kernel.run_futures(0, table_of(of))

        return run, lambda: tally.outlook(present.now_s)

    def at_rest(self) -> tuple[ShaftPresent, CoursesAt]:
        """Present and courses of a shaft at rest that stays at rest."""
        inertia, dry, viscous = (self._p.item(at) for at in (lay.P_INERTIA, lay.P_COULOMB, lay.P_VISCOUS))
        return (
            ShaftPresent(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, inertia, 0.0, dry, 0.0, viscous, 0.0),
            lambda times_s: ShaftCourses(np.zeros(len(times_s)), np.ones(len(times_s)), np.zeros(len(times_s))),
        )

    @property
    def step_s(self) -> float:
        """Step of futures with the model's inertia."""
        return self._step_s(self._p.item(lay.P_INERTIA))

    def _step_s(self, inertia_kg_m2: float) -> float:
        """Longest step allowed by the drive's velocity loop on this inertia; a twisting shaft has steps of its own."""
        return whole_step_s(self._kp / inertia_kg_m2, self._horizon_s, _LONGEST_STEP_S)

    def _courses(self, present: ShaftPresent, courses_at: CoursesAt) -> tuple[float, Array]:
        """Step allowed by the lightest future shaft, and the courses in it, (T, `kernel.COURSES`)."""
        lightest = max(
            present.inertia_kg_m2 - 3.0 * present.inertia_sd_kg_m2, _LEAST_INERTIA_SHARE * present.inertia_kg_m2
        )
        step_s = self._step_s(lightest)
        times_s = self._times_s(present.now_s, step_s)
        found = courses_at(times_s)
        least = float(np.min(found.inertia_factor))
        if least < 1.0:
            step_s = self._step_s(least * lightest)
            times_s = self._times_s(present.now_s, step_s)
            found = courses_at(times_s)
        speed_rad_s = np.where(times_s < present.now_s, present.command_rad_s, found.speed_rad_s)
        columns = (speed_rad_s, found.inertia_factor, found.dry_friction_Nm)
        return step_s, np.ascontiguousarray(np.stack(columns, axis=1))

    def _times_s(self, now_s: float, step_s: float) -> Array:
        """Times of the set points that the drive follows in each step: a cycle earlier."""
        steps = round(self._horizon_s / step_s)
        return np.asarray(now_s - self._cycle_s + step_s * np.arange(steps), np.float64)

    def _drawn(self, p: Array, present: ShaftPresent, z: Array) -> Array:
        """Inertia and friction of each future (B, `kernel.DRAWN`), without the model's effects."""
        share = present.inertia_sd_kg_m2 / present.inertia_kg_m2
        inertia = present.inertia_kg_m2 * np.maximum(1.0 + share * z[:, 0], _LEAST_INERTIA_SHARE)
        dry = present.dry_friction_Nm + present.dry_friction_sd_Nm * z[:, 1]
        viscous = present.viscous_friction_Nm_s_per_rad + present.viscous_friction_sd_Nm_s_per_rad * z[:, 2]
        # The estimate includes the effect of the model's effects on the inertia.
        return np.ascontiguousarray(np.stack((inertia / look_at(p, present.now_s)[0], dry, viscous), axis=1))

    def _start(self, p: Array, present: ShaftPresent, z: Array) -> Array:
        """States (B, S): the shaft at its speed in the drive's loop; z (B,): draws of the speed."""
        state = lay.new_state(p, present.position_rad)
        state[line.S_COUNT] = round(present.now_s / p[lay.P_SAMPLE_TIME_S])  # effects follow the experiment's time
        past = self._layout.first_drive + line.DRIVE_SIZE
        state[past : past + line.RING] = present.torque_Nm
        (motor,) = self._layout.motor_states(state)
        motor.mode, motor.reference = MotorMode.VELOCITY, present.command_rad_s
        motor.torque_Nm = motor.command_Nm = present.torque_Nm
        motor.integral_Nm = present.torque_Nm - self._kp * present.error_rad_s
        states = np.tile(state, (self._futures, 1))
        at_standstill = abs(present.speed_rad_s) <= _STANDSTILL * present.speed_sd_rad_s
        speeds = present.speed_rad_s + present.speed_sd_rad_s * z
        states[:, lay.S_V] = states[:, lay.S_V_BEHIND] = 0.0 if at_standstill else speeds
        states[:, lay.S_DIRECTION] = np.sign(states[:, lay.S_V])
        return states
