"""Futures of a web line from its present estimate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import interpreted, record_at, table_of
from hilbench.control.web_line.feed_forward import ROLLER
from hilbench.control.web_line.strain_trajectory import TRAJECTORY
from hilbench.control.web_line.swing_damping import DAMPING
from hilbench.control.web_line.tension import CONTROLLER, gains_at
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.prediction.futures import Futures, Offsets, Prepared, Tally, normal_draws, whole_step_s
from hilbench.prediction.outlook import WatchedQuantity
from hilbench.prediction.web_line import kernel

#: Longest step, s: the drives' loops act once in it, and with more the torques where a ramp begins are off by more than
#: 2 % of the control action.
_LONGEST_STEP_S: Final = 0.007
#: Response of the twin's E, which the controllers use, to a change: dead time in bus cycles; the share of the change
#: that follows soon, with a time constant in cycles times the root of the number of rollers whose torques are summed;
#: and that of the rest, s. (Of its default method, from runs of one and two spans with steps by 10 and 20 %, at 1 to 3
#: m/s.)
_UNSEEN_CYCLES: Final = 4
_SOON_SHARE: Final = 0.8
_SOON_CYCLES: Final = 15
_LATER_S: Final = 0.15
#: Least E of a future, as a share of the estimate.
_LEAST_MODULUS_SHARE: Final = 0.05


@dataclass(frozen=True)
class LinePresent:
    """Present estimate of a line: N axes, K spans, L load motors; at the web but for torques (motor side), SI.

    For noisy measurements the deviation of one sample is included. `modulus_Pa`: by the twin, `modulus_sd_Pa` its
    stated deviation; `tensions_N`: as simulated by the twin; `commands_m_s`: of the drives from now on,
    `commands_before_m_s` until now.
    """

    now_s: float
    speeds_m_s: Array
    speeds_sd_m_s: Array
    torques_Nm: Array
    commands_m_s: Array
    commands_before_m_s: Array
    tensions_N: Array
    set_points_N: Array
    modulus_Pa: float
    modulus_sd_Pa: float
    upstream_strain: float
    downstream_tension_N: float
    line_speed_m_s: float
    line_speed_before_m_s: float


@dataclass(frozen=True)
class LineCourses:
    """Set points at the start of each of T steps: line speed (T,), m/s; set points (T, K), N; E of the emulated web in
    each span over the present one (T, K)."""

    line_speed_m_s: Array
    set_points_N: Array
    modulus_factor: Array


class LineControl:
    """Controllers of a line of N axes at a step: rows of zeros where there is none, and the pairs behind a `DAMPING` as
    many as the longest has. `loops`: controller, damping and trajectory by span."""

    def __init__(self, rollers: Sequence[Array], loops: Mapping[int, tuple[Array, Array, Array | None]]) -> None:
        spans = len(rollers) - 1
        damping = max((len(of_span[1]) for of_span in loops.values()), default=DAMPING.itemsize // 8)
        sizes = CONTROLLER.itemsize // 8, damping, TRAJECTORY.itemsize // 8
        self.vector = np.zeros(spans * sum(sizes) + sum(map(len, rollers)))
        ends = np.cumsum([spans * size for size in sizes])
        *of_spans, self.rollers = np.split(self.vector, ends)
        self.tensions, self.dampings, self.trajectories = (
            part.reshape(spans, size) for part, size in zip(of_spans, sizes, strict=True)
        )
        self.rollers[:] = np.concatenate(rollers)
        for span, given in loops.items():
            for rows, vector in zip((self.tensions, self.dampings, self.trajectories), given, strict=True):
                if vector is not None:
                    rows[span - 1, : len(vector)] = vector

    @property
    def arrays(self) -> kernel.LineControl:
        """Arrays of `kernel.run_futures`."""
        rows = (self.tensions, CONTROLLER), (self.trajectories, TRAJECTORY), (self.rollers, ROLLER)
        tensions, trajectories, rollers = (vector.reshape(-1).view(kind) for vector, kind in rows)
        return kernel.LineControl(tensions, self.dampings, trajectories, rollers)


def step_s(model: ModelParameters, horizon_s: float) -> float:
    """Step of futures: as long as the fastest motion of the line allows, and a whole part of the horizon.

    That is a roller's oscillation between its spans, or its velocity loop. Raises ValueError for a model without web or
    drives.
    """
    if model.drives is None:
        raise ValueError("the model has no drives, expected 'drives'")
    fastest_per_s = 0.0
    for axis in range(1, model.axis_count + 1):
        around = [span for span in (axis - 1, axis) if 1 <= span <= model.span_count]
        spring_N_per_m = sum(model.stiffness_N(span) / model.span_length_m(span) for span in around)
        carried = spring_N_per_m if model.carries_web_load(axis) else 0.0
        fastest_per_s = max(fastest_per_s, sqrt(carried / model.mass_kg(axis)), model.velocity_loop_per_s(axis))
    return whole_step_s(fastest_per_s, horizon_s, _LONGEST_STEP_S)


class LineFutures(Futures[LinePresent, LineCourses]):
    """Futures of one line, drawn and simulated.

    `control`: controllers at a step, s; `watched`: its quantities in the kernel's order; `load_axes`: axis (from 1) of
    each load motor; `span`: that of the twin's estimate of E, the others follow it by the model; `cycle_s`: between two
    measurements. The result of `prepare` may be run by any thread, one at a time.
    """

    def __init__(
        self,
        model: ModelParameters,
        control: Callable[[float], LineControl],
        watched: Sequence[WatchedQuantity],
        load_axes: Sequence[int],
        *,
        span: int,
        cycle_s: float,
        horizon_s: float,
        futures: int,
    ) -> None:
        super().__init__(watched)
        self.step_s = step_s(model, horizon_s)
        self.steps = round(horizon_s / self.step_s)
        self._model, self._futures, self._span = model, futures, span
        self._start_control, self._control = control(self.step_s), control(self.step_s)
        self._p = lay.pack(model)
        self._p[lay.W_SAMPLE_TIME_S] = self.step_s
        self._layout = lay.Layout.of(self._p)
        rows = self._layout.span_rows(self._p)
        self._moduli = rows.modulus_Pa / model.youngs_modulus_Pa(span)
        self._sections_m2 = rows.section_m2.copy()
        self._load_axes = np.array([axis - 1 for axis in load_axes], np.int64)
        self._samples = self.step_s / cycle_s
        self._found = _found_after(self.step_s, self.steps, cycle_s, model)
        self._work, self._state = self._layout.new_work(), np.zeros(self._layout.state_size)
        self._inputs = self._layout.new_inputs()
        self._layout.motor_inputs(self._inputs).mode = MotorMode.VELOCITY

    def times_s(self, now_s: float) -> Array:
        """Start times of the T steps."""
        return np.asarray(now_s + self.step_s * np.arange(self.steps), np.float64)

    def prepare(self, present: LinePresent, courses: LineCourses, offsets: Offsets, *key: int) -> Prepared:
        """Prepare a prediction; see `Futures`."""
        n, q = self._layout.axes, self.quantities
        z = normal_draws(self._futures, 1 + n + q, *key)
        scale = np.maximum(1.0 + present.modulus_sd_Pa / present.modulus_Pa * z[:, 0], _LEAST_MODULUS_SHARE)
        start = self._start(present, z[:, 1 : 1 + n])
        moduli = present.modulus_Pa * self._moduli
        factor = self._as_found(courses.modulus_factor)
        known = np.ascontiguousarray(moduli * self._sections_m2 * factor)
        stated_Pa = present.modulus_Pa * factor[:, self._span - 1]  # all controllers use the same one
        control = self._controllers(present)
        tally = Tally.of(self.watched, offsets, z[:, 1 + n :], self.step_s, self.steps)
        u = self._inputs.copy()
        u[0], u[1] = present.upstream_strain, present.downstream_tension_N

        figures = np.array([present.line_speed_before_m_s, self._samples, tally.every])
        lead, set_point, factor = (
            np.ascontiguousarray(course)
            for course in (courses.line_speed_m_s, courses.set_points_N, courses.modulus_factor)
        )
        look = kernel.Look(
            self._p.copy(), self._state, u, self._work, start, scale, self._control.arrays, control,
            self._control.vector, np.zeros(q), moduli, lead, set_point, factor, known, np.ascontiguousarray(stated_Pa),
            np.zeros(n), self._load_axes, tally.vectors, figures,
        )  # fmt: skip

        def run() -> None:
            kernel.run_futures(0, table_of(look))

        return run, lambda: tally.outlook(present.now_s)

    def at_rest(self) -> tuple[LinePresent, LineCourses]:
        """Present and courses of a line at rest that stays at rest, strained as the web that enters."""
        steps, n, k = self.steps, self._layout.axes, self._layout.spans
        tension_N = np.array([self._model.upstream_strain * self._model.stiffness_N(span + 1) for span in range(k)])
        rest = np.zeros(n)
        present = LinePresent(
            now_s=0.0,
            speeds_m_s=rest,
            speeds_sd_m_s=rest,
            torques_Nm=rest,
            commands_m_s=rest,
            commands_before_m_s=rest,
            tensions_N=tension_N,
            set_points_N=tension_N,
            modulus_Pa=self._model.youngs_modulus_Pa(self._span),
            modulus_sd_Pa=0.0,
            upstream_strain=self._model.upstream_strain,
            downstream_tension_N=self._model.boundary.downstream_tension_N,
            line_speed_m_s=0.0,
            line_speed_before_m_s=0.0,
        )
        return present, LineCourses(np.zeros(steps), np.tile(tension_N, (steps, 1)), np.ones((steps, k)))

    def _start(self, present: LinePresent, z: Array) -> Array:
        """States (B, S): axes at the web's speed in their control loops; z (B, N): draws of the speeds."""
        layout, n = self._layout, self._layout.axes
        strain = self._strains(present)
        state = start_state(self._p, self._model, strain)
        state[lay.S_COUNT] = round(present.now_s / self.step_s)  # effects follow the experiment's time
        rows, motors = layout.motor_rows(self._p), layout.motor_states(state)
        motors.mode, motors.reference = MotorMode.VELOCITY, present.commands_m_s * rows.rad_per_m
        motors.torque_Nm = motors.command_Nm = present.torques_Nm
        error = (present.commands_before_m_s - present.speeds_m_s) * rows.rad_per_m
        motors.integral_Nm = present.torques_Nm - rows.kp * error
        state[lay.S_Y + n : lay.S_Y + 2 * n] = present.speeds_m_s
        lay.refresh_modes(self._p, state)
        states = np.tile(state, (self._futures, 1))
        speeds = present.speeds_m_s + present.speeds_sd_m_s * z
        states[:, lay.S_Y + n : lay.S_Y + 2 * n] = states[:, lay.S_Y + 3 * n : lay.S_Y + 4 * n] = speeds
        return states

    def _controllers(self, present: LinePresent) -> Array:
        """State of the controllers: the integrals are those of the present commands."""
        control, strains = self._start_control, self._strains(present)
        error_N = present.set_points_N - present.tensions_N
        commands = np.append(present.commands_m_s[:-1], present.line_speed_m_s)
        around = commands[1:].copy()
        ahead = control.trajectories.view(TRAJECTORY)["per_s"][:, 0] > 0.0
        # On a set point's trajectory it is taken as reached: its progress is not known otherwise.
        error_N[ahead] = 0.0
        wanted = present.tensions_N / (present.modulus_Pa * self._sections_m2)
        entering = np.concatenate(([present.upstream_strain], strains[:-1]))
        entering_back = interpreted(laws.downstream_strain)(record_at(self._p, lay.WEB), present.downstream_tension_N)
        behind = np.append(strains[1:], entering_back)
        ratios = np.where(around >= 0.0, (1.0 + entering) / (1.0 + wanted), (1.0 + wanted) / (1.0 + behind))
        around[ahead] *= ratios[ahead]
        for span, speed_m_s in enumerate(commands[1:]):
            c = record_at(control.tensions[span], CONTROLLER)
            if c.bandwidth_rad_per_s > 0.0:
                kp, _ = gains_at(c, speed_m_s, present.modulus_Pa)
                c.integral_m_s = around[span] - commands[span] - kp * error_N[span]
                record_at(control.dampings[span], DAMPING).strain = strains[span]
                record_at(control.trajectories[span], TRAJECTORY).strain = wanted[span]
        return control.vector.copy()

    def _strains(self, present: LinePresent) -> Array:
        """Strains of the spans (K,), which the twin transfers from the axes."""
        return np.asarray(present.tensions_N / (present.modulus_Pa * self._moduli * self._sections_m2), np.float64)

    def _as_found(self, factor: Array) -> Array:
        """Stated E of the twin over the present one (T, K), for a true `factor`."""
        stated = factor.copy()
        for span in np.flatnonzero((factor != 1.0).any(axis=0)):
            changes = np.diff(factor[:, span], prepend=1.0)
            stated[:, span] = 1.0 + np.convolve(changes, self._found[span])[: len(factor)]
        return stated


def _found_after(step_s: float, steps: int, cycle_s: float, model: ModelParameters) -> Array:
    """Share of a change of E in span k that the twin has followed so many steps after it, (K, T)."""
    rollers = model.axis_count - np.arange(1, model.span_count + 1)
    unseen = round(_UNSEEN_CYCLES * cycle_s / step_s)
    passed_s = step_s * np.maximum(np.arange(1, steps + 1) - unseen, 0)
    soon_s = cycle_s * _SOON_CYCLES * np.sqrt(rollers)
    left = _SOON_SHARE * np.exp(-passed_s / soon_s[:, np.newaxis]) + (1.0 - _SOON_SHARE) * np.exp(-passed_s / _LATER_S)
    return np.asarray(1.0 - left, np.float64)
