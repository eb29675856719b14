"""Prediction by a free run: the closed model, driven by the recorded commands."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.compiled import record_at
from hilbench.diagnosis.loop_check import Loop
from hilbench.diagnosis.measured import STANDSTILL_M_S, Before, Measured
from hilbench.diagnosis.predictor import Predictor
from hilbench.diagnosis.residual_analysis import Condition, of_motion
from hilbench.diagnosis.smooth_motion import without_slow
from hilbench.diagnosis.web_measurements import tension_names
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.driving_force import driving_force_N
from hilbench.plant.web_line.emulation import Emulation, simulate_emulated
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.offline import Simulation, simulate, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import section_model
from hilbench.plant.web_line.sizes import machine_sizes

#: Speed from which a recording counts as begun in motion.
_MOVES_M_S: Final = 10.0 * FRICTION_WIDTH_M_S
#: Positions are believed to this share of what the web in the span is stretched by: in a closed loop they show so much
#: that the rounding of a command would be found as an effect.
_TOLERANCE: Final = 0.007
#: The same on a bench of which it is not known what its drives make of a command.
_UNROUNDED_TOLERANCE: Final = 0.035
#: Web transports (L/v) until the guess of a strain in motion is forgotten.
_TRANSPORTS: Final = 6.0
#: Cycle in which commands of a coarser recording may have changed in truth.
_FINE_S: Final = 0.002
#: Least time over which the tension before a start is a mean, s, and places of a turn over which resistance is one.
_TURNS_S: Final = 0.5
_PLACES: Final = 40
#: Steps of the creep within which the slow mode is one, 1/N.
_CREEP_STEP: Final = 5e-8
#: A change of a torque by which its response is looked at, N·m.
_A_TORQUE_NM: Final = 0.01
#: The same of a position, m.
_SHORT_TRAVEL_M: Final = 1e-5
#: Share of a corner's bend by which the slopes of one side of it may differ.
_STRAIGHT: Final = 0.25


class FreeRun(Predictor):
    """The closed model run on the recorded commands; positions as their mean and the differences of neighbours.

    All encoders share the clock: their common error is not the one of their differences. With an `emulation` the web is
    the one that a load motor emulates: late, and without the noise of its sensors. With `loops` drives have those
    instead of the model's.
    """

    emulation: Emulation | None

    def __init__(
        self,
        model: ModelParameters,
        data: Measured,
        emulation: Emulation | None = None,
        loops: Sequence[Loop] = (),
    ) -> None:
        self._model = model
        self._loops = loops
        self.emulation = emulation
        self._cycle_s = _FINE_S if emulation is None else emulation.cycle_s
        self._boundary, self._forces_N = data.boundary, data.forces_N
        self._period_s = data.period_s
        self._commands = [data.commands_m_s if emulation is None else emulation.as_taken(data.commands_m_s)]
        self._torques = sorted(data.tau_Nm)
        names = [f"tau{axis}_Nm" for axis in self._torques]
        axes = range(1, model.axis_count + 1)
        self._all = set(axes) <= set(data.x_m)
        self._positions = sorted(data.x_m)
        if self._all:
            names += [f"x{axis}_m - x{axis + 1}_m" for axis in axes[:-1]]
            names.append(f"({' + '.join(f'x{axis}_m' for axis in axes)})/{len(axes)}")
        else:
            names += [f"x{axis}_m" for axis in self._positions]
        self.rows = self._usable(data)
        self._quick = without_slow(self.rows, data.period_s)
        self._speeds = [axis for axis in data.v_m_s if axis not in data.x_m]
        self._tensions, self._sensors = sorted(data.F_N), sorted(data.sensors_m)
        names += [f"v{axis}_m_s" for axis in self._speeds]
        names += tension_names(data.F_N)
        names += [data.sensors_m[name].channel for name in self._sensors]
        sensors_m = [data.sensors_m[name].measured_m for name in self._sensors]
        self.names = tuple(names)
        self.measured = np.array(self._of_signals(data.tau_Nm, data.x_m, data.v_m_s, data.F_N, sensors_m))
        unrounded = emulation is not None and emulation.resolution_m_s is None
        believed = _UNROUNDED_TOLERANCE if unrounded else _TOLERANCE
        self.tolerances = np.array([believed * self._stretch_m(name) for name in names])
        if self._sensors:
            self.tolerances[-len(self._sensors) :] = [data.sensors_m[name].known_to_m for name in self._sensors]
        if self._all:  # what is late is late for all axes, and their differences do not show it
            mean = len(data.tau_Nm) + model.axis_count - 1
            self.tolerances[mean] = np.hypot(self.tolerances[mean], data.put_off_m)
        self._start = self._start_state(data)
        self._before, self._more_Nm = data.before, np.zeros(model.axis_count)
        self._web_before = None if data.before is None else LineFollower(model)
        self._pushed = data.pushed
        self._pulled = [axis for axis in range(1, model.axis_count + 1) if model.carries_web_load(axis)]
        self._slow: dict[tuple[int, ...], tuple[Array, Array]] = {}  # by creep of each span, in steps
        if data.period_s > 1.5 * self._cycle_s:
            self._choose_hold(data)
        self._data = data

    @property
    def surrogate(self) -> FreeRun | None:
        """Free run of the machine itself, without the emulation, which is made to respond as the machine does."""
        if self.emulation is None or self._model.stations is not None:
            return None
        other = copy(self)
        other.emulation, other._slow = None, {}
        return other

    def with_force(self, force_N: float, time_s: float) -> FreeRun:
        """Free run with a force against the motion of the last roller from a time on."""
        other = copy(self)
        share = np.clip((self._data.t_s + self._period_s - time_s) / self._period_s, 0.0, 1.0)
        against = force_N * share * np.sign(self._data.commands_m_s[:, -1])
        other._boundary = self._boundary - np.outer(against, [0.0, 1.0])
        return other

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time, motion of the last axis, tensions and strain rates as simulated, angles."""
        data, run = self._data, self._run(parameters)
        speed, rates = data.commands_m_s[:, -1], [np.gradient(strain, data.period_s) for strain in run.strain.T]
        moved = of_motion(data.t_s, self._model.axis_count, "m", speed, np.gradient(speed, data.period_s))
        return moved + of_line(self._model, run.F_N, rates, data.x_m)

    def _usable(self, data: Measured) -> NDArray[np.bool_]:
        """Rows without the transients of a start in motion, and without standstill."""
        speed = abs(float(data.commands_m_s[0].mean()))
        usable = data.usable_in_motion(np.min(np.abs(data.commands_m_s), axis=1) < STANDSTILL_M_S)
        if speed > _MOVES_M_S:
            travel_m = remembered_m(self._model, _TRANSPORTS) if data.before is None else 0.0
            settle_s = travel_m / speed + 1.0
            usable[: int(settle_s / data.period_s)] = False
        return usable

    def _start_state(self, data: Measured) -> Array:
        parameters = lay.pack(self._model)
        state = start_state(parameters, self._model)
        layout = lay.Layout.of(parameters)
        y, n = layout.y(state), layout.axes
        moving = abs(float(data.commands_m_s[0].mean())) > _MOVES_M_S
        for axis in range(1, n + 1):
            x = data.x_m.get(axis)
            if x is not None and (moving or abs(x[0]) > 1e-3):
                y[axis - 1] = y[2 * n + axis - 1] = x[0]
            if moving:
                speed = float(data.commands_m_s[0, axis - 1])
                y[n + axis - 1] = y[3 * n + axis - 1] = speed
                torque = float(np.mean(data.tau_Nm[axis][:25])) if axis in data.tau_Nm else 0.0
                motor = layout.motor_states(state)[axis - 1]
                motor.torque_Nm = motor.command_Nm = motor.integral_Nm = torque
                motor.reference = speed * self._model.motor_rad_per_m(axis)
        return state

    def _begin_after(self, before: Before, parameters: Array, state: Array) -> None:
        """The web strained as it was by `parameters` on the motion before, and axes that it pulls at with the torque
        that they need.

        It is that of the mean tensions around them over the last whole turns.
        """
        layout = lay.Layout.of(parameters)
        y, n = layout.y(state), layout.axes
        assert self._web_before is not None, "there are rows before the first one"
        tension_N, strain = self._web_before.follow_on(
            parameters, before.x_m, before.boundary, self._period_s, before.strain
        )
        lay.set_strain(parameters, state, strain)
        entering_N = before.boundary[:, :1] * record_at(parameters, lay.WEB).upstream_stiffness_N
        around_N = np.column_stack([entering_N, tension_N, before.boundary[:, 1]])
        for axis in self._pulled:
            x, v = y.item(axis - 1), y.item(n + axis - 1)
            turn_m = 2.0 * np.pi * self._model.radius_m(axis)
            turn = turn_m / max(abs(v), 1e-9) / self._period_s
            rows = round(turn * np.ceil(_TURNS_S / self._period_s / turn))
            pull_N = float(np.mean(around_N[-rows:, axis - 1] - around_N[-rows:, axis]))
            places = x + np.arange(_PLACES) * (turn_m / _PLACES)
            idle_N, driven_N = (
                float(np.mean([driving_force_N(parameters, axis, torque, float(place), v) for place in places]))
                for torque in (0.0, 1.0)
            )
            motor, drive = layout.motor_rows(parameters)[axis - 1], layout.motor_states(state)[axis - 1]
            torque_Nm = laws.true_torque_Nm(motor, (pull_N - idle_N) / (driven_N - idle_N))
            torque_Nm += self._more_Nm.item(axis - 1)
            drive.torque_Nm = drive.command_Nm = drive.integral_Nm = torque_Nm

    def _choose_hold(self, data: Measured) -> None:
        """A recording coarser than the cycle: were commands held, or did they go on between its rows?"""
        whole = round(data.period_s / self._cycle_s)
        if abs(whole * self._cycle_s - data.period_s) > 1e-9 or whole < 2:
            return
        fine = between(self._commands[0], whole)
        held = self._commands if self.emulation is None else self._commands * whole
        options = [held, [np.ascontiguousarray(fine[:, k, :]) for k in range(whole)]]
        errors = []
        for option in options:
            self._commands = option
            residual = self.measured - self.predict(lay.pack(self._model)[None, :])[0]
            errors.append(float(np.sum(np.var(np.diff(residual, axis=-1), axis=-1) / np.var(self.measured, axis=-1))))
        self._commands = options[int(np.argmin(errors))]

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n), on all cores; with the slow modes that suit it best: of a begin under way, and of
        each push."""
        predicted = self._predicted(parameters)
        if self._before is not None or self._pushed:
            for one, found in zip(parameters, predicted, strict=True):
                modes, along = self._slow_modes(one)
                found += np.tensordot(np.tensordot(along, self.measured - found, 2), modes, 1)
        return predicted

    def _slow_modes(self, parameters: Array) -> tuple[Array, Array]:
        """(modes, signals, n) each: what another integral of the loop of each axis does that the web pulls at, at the
        start and from each push on, and what shows how much.

        With a stiff web the loop forgets that only over E·S/(v·ki·(i/r)²), which is seconds; and nobody knows
        it to better than the oscillation of the torque. Of what a model may lack only creep makes it much quicker.
        """
        creep = lay.Layout.of(parameters).span_rows(parameters).web_slip.creep_per_N
        key = tuple(np.round(creep / _CREEP_STEP).astype(int).tolist())
        if key not in self._slow:
            begun = self._pulled if self._before is not None else []
            others = [self._begun_with(_A_TORQUE_NM, axis) for axis in begun]
            others += [self._moved_on_at(row, axis) for row in self._pushed for axis in self._pulled]
            modes = np.array([one._predicted(parameters[None])[0] for one in [*others, self]])
            modes = modes[:-1] - modes[-1]
            floors = np.array([self.floor(k) for k in range(len(self.names))])
            weighted = np.where(self.rows, modes, 0.0) / np.hypot(floors, self.tolerances)[:, None] ** 2
            gram = np.tensordot(weighted, modes, ([1, 2], [1, 2]))
            self._slow[key] = modes, np.tensordot(np.linalg.pinv(gram, hermitian=True), weighted, 1)
        return self._slow[key]

    def _begun_with(self, more_Nm: float, axis: int) -> FreeRun:
        """Free run with another integral of the loop of an axis at the start."""
        other = copy(self)
        other._more_Nm = self._more_Nm.copy()
        other._more_Nm[axis - 1] = more_Nm
        return other

    def _moved_on_at(self, row: int, axis: int) -> FreeRun:
        """Free run of an axis commanded to be somewhat further from a row on, by which its integral differs."""
        other = copy(self)
        other._commands = [self._commands[0].copy(), *self._commands[1:]]
        other._commands[0][row, axis - 1] += _SHORT_TRAVEL_M / self._period_s
        return other

    def _predicted(self, parameters: Array) -> Array:
        run = self._run(np.atleast_2d(parameters))
        tau_Nm, x_m, v_m_s, F_N = (
            dict(enumerate(np.moveaxis(each, -1, 0), 1)) for each in (run.tau_Nm, run.x_m, run.v_m_s, run.F_N)
        )
        sensors_m = () if run.sensors_m is None else np.moveaxis(run.sensors_m, -1, 0)
        return np.stack(self._of_signals(tau_Nm, x_m, v_m_s, F_N, sensors_m), axis=1)

    def _of_signals(
        self,
        tau_Nm: Mapping[int, Array],
        x_m: Mapping[int, Array],
        v_m_s: Mapping[int, Array],
        F_N: Mapping[int, Array],
        sensors_m: Iterable[Array],
    ) -> list[Array]:
        """What is compared, in the order of the names, from what axes, spans and sensors have.

        Positions without what is slow in them: an encoder's zero, a quantized speed, add up without end.
        """
        x = [x_m[axis] for axis in self._positions]
        if self._all:
            x = [*(a - b for a, b in pairwise(x)), sum(x[1:], x[0]) / len(x)]
        return [
            *(tau_Nm[axis] for axis in self._torques),
            *map(self._quick, x),
            *(v_m_s[axis] for axis in self._speeds),
            *(F_N[span] for span in self._tensions),
            *sensors_m,
        ]

    def _with_loops(self, parameters: Array) -> Array:
        if not self._loops:
            return parameters
        changed = np.array(parameters)
        for one in np.atleast_2d(changed):
            rows = lay.Layout.of(one).motor_rows(one)
            for loop in self._loops:
                row = rows[loop.axis - 1]
                row.kp, row.ki, row.current_s = loop.kp_Nm_s_per_rad, loop.ki_Nm_per_rad, loop.lag_s
        return changed

    def _stretch_m(self, name: str) -> float:
        """Usual elongation of the web over that at rest in the span whose positions make up this row; 0 of other
        rows."""
        if not name.startswith(("x", "(")):
            return 0.0
        strain = machine_sizes(self._model, 1).strain
        model = section_model(self._model)
        lengths = [model.span_length_m(span) for span in range(1, model.span_count + 1)]
        first = self.names.index("x1_m - x2_m") if self._all else 0
        span = self.names.index(name) - first
        return strain * (lengths[span] if self._all and span < len(lengths) else max(lengths))

    def _run(self, parameters: Array) -> Simulation:
        """Run one parameter vector, or (B, P)."""
        parameters = self._with_loops(parameters)
        whole = len(self._commands)
        commands, boundary = self._commands[0], self._boundary
        if whole > 1:
            commands = np.stack(self._commands, axis=1).reshape(-1, commands.shape[1])
            boundary = np.repeat(boundary, whole, axis=0)
        if self.emulation is None:
            run = simulate(parameters, self._starts(parameters), commands, boundary, self._period_s / whole)
        else:
            start = self._starts(parameters) if self._model.stations is None else None
            forces_N = {name: np.repeat(commanded_N, whole) for name, commanded_N in self._forces_N.items()}
            given = self.emulation, self._model, parameters, commands, boundary
            run = simulate_emulated(*given, state=start, sensors=self._sensors, forces_N=forces_N)
        if whole == 1:
            return run
        rows = {name: getattr(run, name)[..., ::whole, :] for name in ("x_m", "v_m_s", "tau_Nm", "F_N", "strain")}
        sensors_m = None if run.sensors_m is None else run.sensors_m[..., ::whole, :]
        return Simulation(**rows, state=run.state, sensors_m=sensors_m)

    def _starts(self, parameters: Array) -> Array:
        """States with which the parameters, (P,) or (B, P), begin."""
        state = np.broadcast_to(self._start, (*parameters.shape[:-1], len(self._start))).copy()
        for one, start in zip(np.atleast_2d(parameters), np.atleast_2d(state), strict=True):
            if self._before is None:
                lay.set_strain(one, start, self._model.upstream_strain)
            else:
                self._begin_after(self._before, one, start)
            lay.refresh_modes(one, start)
        return state


def of_line(
    model: ModelParameters, F_N: Array, strain_rates: Sequence[Array], x_m: Mapping[int, Array]
) -> list[Condition]:
    """Tensions (n, spans), strain rates (n,) of each span, and angles by the positions (n,) of axes."""
    found = []
    for span, rate in enumerate(strain_rates, 1):
        where = f" of span {span}" if model.span_count > 1 else ""
        found.append(Condition(f"tension{where}", "N", F_N[:, span - 1]))
        found.append(Condition(f"strain rate{where}", "1/s", rate))
    for axis, x in sorted(x_m.items()):
        for what, rad_per_m in (("roller", 1.0 / model.radius_m(axis)), ("motor", model.motor_rad_per_m(axis))):
            name = f"angle of {what} {axis}"
            found.append(Condition(name, "rad", x * rad_per_m, period=2.0 * np.pi, spectral=True))
    return found


def remembered_m(model: ModelParameters, transports: float) -> float:
    """Travel of the web until a strain at the start is forgotten: so many lengths of a span, behind those before it."""
    lengths = [model.span_length_m(span) for span in range(1, model.span_count + 1)]
    return sum(lengths) + (transports - 1.0) * max(lengths)


def between(rows: Array, whole: int) -> Array:
    """Interpolate a piecewise linear signal (n, m), known at every `whole`-th time: (n, whole, m).

    A corner between two rows lies where the lines through the rows before and behind meet; it matters because a drive's
    position is the integral of its command. Without two straight pieces that meet in between, the rows are joined.
    """
    share = (np.arange(whole) / whole)[None, :, None]
    slopes = np.diff(rows, axis=0, prepend=rows[:1], append=rows[-1:])  # row k: from k - 1 to k
    further = np.concatenate([slopes, np.zeros((2, rows.shape[1]))])
    before, step, after = slopes[:-1], further[1:-2], further[2:-1]
    bend = after - before
    before_that = np.concatenate([before[:1], before[:-1]])
    straight = np.maximum(np.abs(before - before_that), np.abs(further[3:] - after)) < _STRAIGHT * np.abs(bend)
    corner = np.divide(after - step, bend, out=np.zeros_like(bend), where=straight)
    meet = (corner > 0.0) & (corner < 1.0)
    here, ahead = rows[:, None, :], (rows + step)[:, None, :]
    first, second = here + share * before[:, None, :], ahead - (1.0 - share) * after[:, None, :]
    broken = np.where(share < corner[:, None, :], first, second)
    return np.where(meet[:, None, :], broken, here + share * step[:, None, :])
