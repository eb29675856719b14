"""A line of driven rollers, as it is diagnosed while it runs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.compiled import record_at
from hilbench.diagnosis import machines
from hilbench.diagnosis.machines import AnyEmulation, emulation_of
from hilbench.diagnosis.measured import Before, Measured
from hilbench.diagnosis.predictor import choice, deviations_of
from hilbench.diagnosis.web_line.free_run import remembered_m
from hilbench.live.machine import SHORT, LiveMachine, Segment
from hilbench.live.window import Window
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.driving_force import driving_force_N
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.line import elasticity_factor
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.topology.config import BenchConfig

#: Cycles after one in which the plant was not measured in which what is emulated still catches up.
_CATCHES_UP = 4
#: Lengths of the longest span after which the web that was found in it, of unknown strain, has left: exp(-5) of it is
#: less than what a level may be off by.
_EXCHANGED: Final = 5.0


def exchanged_m(model: ModelParameters) -> float:
    """Travel of the web after which nothing is left of that which was in the spans."""
    return remembered_m(model, _EXCHANGED)


class ModelGap:
    """The gap of one model along a run of a line of N rollers, N·m at the motor of each; E is estimated in `spans`.

    It is the residual of the momentum balance of each roller, cycle by cycle, cheaply:

        r_k = (i/r)·τ_k − R_k(v_k) + F_k − F_(k−1) − m_k·v_k'        (0 but for noise where the model is right)

    Motion and torques are measured, the tension follows from the measured motion by the model (`LineFollower`), effects
    included. The residual is averaged over `SHORT` cycles, whose accelerations are differences of positions.
    """

    def __init__(self, model: ModelParameters, spans: Sequence[int], cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._axes = model.axis_count
        self._p = lay.pack(model)
        layout = Layout.of(self._p)
        rows, motors = layout.axis_rows(self._p), layout.motor_rows(self._p)
        self._mass_kg = (rows.motor_mass_kg + rows.roller_mass_kg) * (1.0 + rows.inertia_mismatch.relative_change)
        self._per_m, self._web_load = motors.rad_per_m[: self._axes].copy(), rows.web_load.copy()
        self._upstream_stiffness_N = float(record_at(self._p, lay.WEB).upstream_stiffness_N)
        self._follower = LineFollower(model)
        several = model.span_count > 1
        self._moduli = [f"span{span}.youngs_modulus_Pa" if several else "youngs_modulus_Pa" for span in spans]
        self._exchanged_m = exchanged_m(model)
        self.restart()

    def restart(self) -> None:
        """The next rows are not those that follow the last."""
        self._last: Array | None = None
        self._last_forces = np.empty((0, 2 * self._axes + 1))
        self._last_around = np.empty((0, 2))
        self._last_known = np.empty(0, bool)
        self._came_m = 0.0  # of web, since then

    def use_estimate(self, estimate: Array) -> None:
        """E of the web in the spans in which it is estimated (M,), from now on, Pa."""
        for name, modulus_Pa in zip(self._moduli, estimate.tolist(), strict=True):
            self._follower.set_parameter(name, modulus_Pa)

    def follow(self, channels: Mapping[str, Array], known: Rows) -> Array:
        """Residuals (n // SHORT, N) of the next rows (n,) of x{k}_m, tau{k}_Nm, strain_prev and F_next_N; n a multiple.

        NaN where a row is not known, or follows one; and until the web of the first row, of unknown strain, has left.
        """
        axes = range(1, self._axes + 1)
        x = np.column_stack([channels[f"x{k}_m"] for k in axes])
        torque = np.column_stack([channels[f"tau{k}_Nm"] for k in axes])
        around = np.column_stack([channels["strain_prev"], channels["F_next_N"]])
        forces = np.column_stack([torque, self._tensions(x, around)])
        # What acts while the speed goes from that before a row to that before the row so many further on.
        acting = np.concatenate([self._last_forces if len(self._last_forces) else forces[:1], forces])
        self._last_forces = forces[-1:]
        before = x[:1] if self._last is None else self._last
        known = np.concatenate([np.ones(len(before), bool) if self._last is None else self._last_known, known])
        self._last, self._last_known = x[-SHORT - 1 :], known[-SHORT - 1 :]
        positions = np.concatenate([before, x])
        lead = len(before)
        count = len(x) // SHORT
        result = np.empty((count, self._axes))
        for j in range(count):
            end = lead + (j + 1) * SHORT - 1
            self._came_m += abs(float(positions[end, -1] - positions[max(end - SHORT, 0), -1]))
            if self._came_m < self._exchanged_m or not np.all(known[max(end - SHORT - _CATCHES_UP, 0) : end + 1]):
                result[j] = np.nan
                continue
            result[j] = self._of(positions, end, acting[j * SHORT : (j + 1) * SHORT].mean(0))
        return result

    def _tensions(self, x: Array, around: Array) -> Array:
        """(n, N + 1): before, between and behind the rollers."""
        before = x[:0] if self._last is None else self._last[-1:]
        if self._last is None:
            self._follower.reset(x[0], strain=[around.item(0, 0)] * (self._axes - 1))
        rows, limits = np.concatenate([before, x]), np.concatenate([self._last_around, around])
        between = self._follower.follow_rows(rows, limits, self._cycle_s)[len(before) :]
        self._last_around = around[-1:]
        return np.column_stack([around[:, 0] * self._upstream_stiffness_N, between, around[:, 1]])

    def _of(self, positions: Array, end: int, forces: Array) -> Array:
        """Residual of the SHORT cycles up to row `end` of positions, with the means of torques and tensions (2 N +
        1,)."""
        first = end - SHORT
        if first < 1:
            return np.full(self._axes, np.nan)
        now, was = positions[end] - positions[end - 1], positions[first] - positions[first - 1]
        speed = (positions[end] - positions[first]) / (SHORT * self._cycle_s)
        acceleration = (now - was) / (SHORT * self._cycle_s**2)
        torque_Nm, tension_N = forces[: self._axes], forces[self._axes :]
        gap = np.empty(self._axes)
        for k in range(self._axes):
            driven_N = driving_force_N(self._p, k + 1, float(torque_Nm[k]), float(positions[end, k]), float(speed[k]))
            web_N = self._web_load[k] * (tension_N[k + 1] - tension_N[k])
            gap[k] = (driven_N + web_N - self._mass_kg[k] * acceleration[k]) / float(self._per_m[k])
        return gap


_SHIFT: Final = "elasticity_shift"
_SHARE: Final = "relative_change"
#: Signals of what is around the line: strain of the web that comes, and tension behind it.
_AROUND: Final = ("strain_prev", "F_next_N")
#: For how long before a start a candidate follows the web at least, and for how long before that the model, s; and
#: for how many lengths of the longest span the candidate.
_SHOWN_S, _KNOWN_S, _SHOWN_LENGTHS = 3.0, 5.0, 2.0
#: Rows by which the last position before it is smoothed.
_SMOOTHED = 40
#: For how long before it nothing much happens, s; how far the speed may change meanwhile.
_QUIET_S, _QUIET_M_S = 0.5, 0.01
#: Speed from which a line runs, m/s.
_MOVES_M_S = 0.05
#: The same of a mean tension, from that time to the one before, as a share of it.
_QUIET_SHARE = 0.006
#: Signals that show how far the web is stretched.
_AWAY = re.compile(r"x\d+_m - x\d+_m")
#: Rows over which a travel bends that is left at once, and behind a late one within which it does; how far, in
#: deviations of what a right model leaves.
_PUSH, _PUSH_AFTER, _PUSHED = 10, 60, 3.0


def machine(config: BenchConfig) -> LiveLine:
    """What a session diagnoses."""
    emulation = emulation_of(config) if config.load_motors else None
    return LiveLine(config.web_line, emulation, config.cycle_time_s, config.shape.estimated)


class LiveLine(LiveMachine[ModelParameters]):
    """A `LiveMachine` whose twin estimates E, in `spans` (None: in all of them). Data of what began during the run
    start at a moment when little happens."""

    moves = 0.05  #: m/s

    def __init__(
        self, model: ModelParameters, emulation: AnyEmulation | None, cycle_s: float, spans: Sequence[int] | None = None
    ) -> None:
        super().__init__(model, emulation, cycle_s)
        self._line = model
        axes, all_spans = range(1, model.axis_count + 1), range(1, model.span_count + 1)
        self._spans = tuple(all_spans if spans is None else spans)
        self._positions, self.speeds, torques = (
            tuple(form.format(axis) for axis in axes) for form in ("x{}_m", "v{}_m_s", "tau{}_Nm")
        )
        self._commands = [f"v{axis}_cmd_m_s" for axis in axes]
        self.needed = (*self._positions, *self.speeds, *torques, *_AROUND)
        number = {span: str(span) if model.span_count > 1 else "" for span in all_spans}
        self._tensions = [f"F{number[span]}_sim_N" for span in all_spans]
        self.estimated = tuple(f"E{number[span]}_sim_Pa" for span in self._spans)
        self.usual_Nm = np.array([machine_sizes(model, k).force_N / model.motor_rad_per_m(k) for k in axes])

    def gap(self, model: ModelParameters) -> ModelGap:
        """Residual generator of one model."""
        return ModelGap(model, self._spans, self.cycle_s)

    def estimate_of(self, model: ModelParameters) -> Array:
        """E of each span in which it is estimated (M,) as the model has it, Pa."""
        return np.array([model.youngs_modulus_Pa(span) for span in self._spans])

    def with_estimate(self, model: ModelParameters, estimate: Array) -> ModelParameters:
        """The model with another E in these spans (M,); what is around them stays."""
        shares = dict[int, float]()
        for entry in model.effects:
            if entry.effect == _SHIFT:
                spans = range(1, model.span_count + 1) if entry.span is None else (entry.span,)
                shares |= dict.fromkeys(spans, entry.parameters[_SHARE])
        for span, modulus_Pa in zip(self._spans, estimate.tolist(), strict=True):
            shares[span] = modulus_Pa / model.youngs_modulus_Pa(span) - 1.0
        kept = [entry for entry in model.effects if entry.effect != _SHIFT]
        shifts = [
            EffectEntry(effect=_SHIFT, span=span if model.span_count > 1 else None, parameters={_SHARE: share})
            for span, share in shares.items()
        ]
        return machines.with_effects(model, [*kept, *shifts])

    def estimate_at(self, model: ModelParameters, time_s: float) -> Array:
        """E in these spans (M,) as the model's effects make it at a time of theirs."""
        p = lay.pack(model)
        return np.array([model.youngs_modulus_Pa(k) * elasticity_factor(p, k, time_s) for k in self._spans])

    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of E."""
        return find_effect(effect_id).domain is Domain.ELASTICITY and effect_id not in ("web_damping", "strain_offset")

    def followed_from(self, window: Window, first: int) -> int:
        """Until all of its web is another one."""
        return first - self._rows_of_travel(window, first, exchanged_m(self._line)) - SHORT

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first cycle before which, for a while, neither speeds nor tensions change; None where there is none."""
        before = round(_QUIET_S / self.cycle_s)
        rows = window.rows(first - 2 * before, end)
        if len(rows) <= 2 * before:
            return None
        speeds = window.columns(rows, self._commands)[before:]
        moved = np.abs(speeds[before:] - speeds[:-before]).max(axis=1)
        total = np.cumsum(window.columns(rows, self._tensions), axis=0)
        pulls = (total[before:] - total[:-before]) / before
        steady = np.all(np.abs(pulls[before:] - pulls[:-before]) < _QUIET_SHARE * np.abs(pulls[:-before]), axis=1)
        quiet = np.flatnonzero((moved < _QUIET_M_S) & (np.abs(speeds[before:, -1]) > _MOVES_M_S) & steady)
        return None if len(quiet) == 0 else end - len(moved) + int(quiet[0])

    def data_of(self, window: Window, model: ModelParameters, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, of what has begun in cycle `begun`: until then the web was strained as by
        the model. Raises UnusableInputError for what can't be diagnosed."""
        data, measured = super().data_of(window, model, first, end, begun), window.measured(first, end)
        put_off_m = _put_off_m(data.commands_m_s, measured, self.cycle_s)
        data = replace(data, before=self._before(window, model, begun, first), put_off_m=put_off_m)
        if np.all(measured):
            return data
        pushed = self._pushed(data, model, measured)
        left_out = data.left_out.copy()
        left_out[list(pushed)] = True
        return replace(data, pushed=pushed, left_out=left_out)

    def _pushed(self, data: Measured, model: ModelParameters, measured: Rows) -> tuple[int, ...]:
        """Rows at which rollers are pushed off their trajectory at once, after rows that were not `measured` in time
        (n,): a load motor holds its torque as long as it receives nothing from the bench, and that pushes the
        rollers."""
        predictor = choice(model, data, self.emulation).predictor
        away = [place for place, name in enumerate(predictor.names) if _AWAY.fullmatch(name)]
        if not away:  # on measured motion: whatever made the rollers move so
            return ()
        residual = Segment(data, predictor).residual(model)[away]
        bend = np.abs(residual[:, 2 * _PUSH :] - 2.0 * residual[:, _PUSH:-_PUSH] + residual[:, : -2 * _PUSH])
        late = np.convolve(~measured, np.ones(_PUSH_AFTER), "full")[: residual.shape[1]] > 0.5
        usual = deviations_of(predictor)[away, None]
        odd = np.flatnonzero(np.any(bend > _PUSHED * usual, axis=0) & late[_PUSH:-_PUSH])
        if not len(odd):
            return ()
        begins = np.concatenate([[True], np.diff(odd) > _PUSH_AFTER])
        return tuple(int(row) + _PUSH for row in odd[begins])

    def _before(self, window: Window, model: ModelParameters, begun: int, cycle: int) -> Before:
        """How the rollers turned until a cycle, at the earliest from that in which it began. The strain at the
        beginning of that is the model's, on what was before."""
        shown = self._rows_of_travel(window, cycle, remembered_m(model, _SHOWN_LENGTHS))
        shown = max(min(max(shown, round(_SHOWN_S / self.cycle_s)), cycle - begun), 1)
        exchanged = self._rows_of_travel(window, cycle - shown, exchanged_m(model))
        rows = window.rows(cycle - shown - max(exchanged, round(_KNOWN_S / self.cycle_s)), cycle + 1)
        x, boundary = window.columns(rows, self._positions), window.columns(rows, _AROUND)
        x[-1] = _smooth_end(x)
        split = max(len(rows) - shown, 0)
        strain = np.full(model.span_count, model.upstream_strain)
        if split > 1:
            follower = LineFollower(model)
            _, strain = follower.follow_on(lay.pack(model), x[:split], boundary[:split], self.cycle_s, strain)
        return Before(x[max(split - 1, 0) :], boundary[max(split - 1, 0) :], strain)

    def _rows_of_travel(self, window: Window, end: int, travel_m: float) -> int:
        """Rows until a cycle, as far as they are kept, in which the web has gone so far."""
        x = window.columns(window.rows(window.first, end), self._positions[-1:])[:, 0]
        if not len(x):
            return 0
        nearer = np.abs(x - x[-1]) < travel_m
        return len(x) if np.all(nearer) else int(np.argmin(nearer[::-1]))

    def steady(self, chunk_s: float) -> tuple[float, dict[str, float]]:
        """A speed, m/s, at which all of its web is another one with the second chunk."""
        around = self._line.upstream_strain, self._line.boundary.downstream_tension_N
        return exchanged_m(self._line) / chunk_s, dict(zip(_AROUND, around, strict=True))


def _put_off_m(commands_m_s: Array, measured: Rows, cycle_s: float) -> float:
    """Largest displacement error of a line that takes commands (n, axes) a cycle late whose rows were not
    `measured` in time (n,), or follow one: where drives answer late, the next commands leave late."""
    doubted = ~measured[1:] | ~measured[:-1]
    changes_m_s = np.abs(np.diff(commands_m_s, axis=0))[doubted]
    return cycle_s * float(np.max(np.sum(changes_m_s, axis=0)))


def _smooth_end(x: Array) -> Array:
    """(N,): the last of positions (n, N), without the noise of a single one."""
    rows = x[-min(_SMOOTHED, len(x)) :]
    at = np.arange(len(rows)) - (len(rows) - 1.0)
    return np.array([np.polyfit(at, column - column[-1], 2)[-1] + column[-1] for column in rows.T])
