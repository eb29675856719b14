"""A servo axis, as it is diagnosed while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.machines import AnyEmulation, emulation_of
from hilbench.diagnosis.measured import Measured
from hilbench.live.machine import SHORT, LiveMachine, Segment
from hilbench.live.window import Window
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import look
from hilbench.plant.servo_axis.sizes import machine_sizes
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.topology.config import BenchConfig

#: Effects that are a change of the inertia.
_OF_INERTIA: Final = ("inertia_mismatch", "inertia_step")
#: In which steps of its share the inertia's best value is looked for, and the largest of them at once.
_STEP: Final = 0.02
_MOST: Final = 0.5
#: Rows in a row that come late which push a shaft by more than noise, and for how long that shows, s.
_LATE, _PUSHED_S = 2, 0.15
#: Means that are followed before a gap is looked at, and those that the acceleration of one needs beside it.
_FOLLOWED, _NEIGHBOURS = 4, 2
#: A speed at which a shaft turns, rad/s.
_TURNS_RAD_S: Final = 20.0


def machine(config: BenchConfig) -> LiveShaft:
    """What a session diagnoses."""
    return LiveShaft(config.servo_axis, emulation_of(config) if config.load_motors else None, config.cycle_time_s)


def _inertia_factor(model: ServoAxisParameters, time_s: float) -> float:
    """Factor of a model's effects on its inertia at a time of theirs."""
    return float(look(lay.pack(model), time_s)[0])


class LiveShaft(LiveMachine[ServoAxisParameters]):
    """A `LiveMachine` whose twin estimates the inertia."""

    speeds = ("v1_rad_s",)
    needed = ("x1_rad", *speeds, "tau1_Nm")
    moves = 0.5  #: rad/s
    estimated = ("J_sim_kg_m2",)

    def __init__(self, model: ServoAxisParameters, emulation: AnyEmulation | None, cycle_s: float) -> None:
        super().__init__(model, emulation, cycle_s)
        self.usual_Nm = np.array([machine_sizes(model).force_N])

    def gap(self, model: ServoAxisParameters) -> ShaftGap:
        """Residual generator of one model."""
        return ShaftGap(model, self.cycle_s)

    def with_estimate(self, model: ServoAxisParameters, estimate: Array) -> ServoAxisParameters:
        """The model with another inertia (1,), its effects included: the shaft has what exceeds the motor's rotor."""
        behind = max(float(estimate[0]) / _inertia_factor(model, 0.0) - model.motor.inertia_kg_m2, 0.0)
        return model.model_copy(update={"shaft": model.shaft.model_copy(update={"inertia_kg_m2": behind})})

    def estimate_at(self, model: ServoAxisParameters, time_s: float) -> Array:
        """Inertia (1,) as the model's effects make it at a time of theirs."""
        return np.array([model.inertia_kg_m2 * _inertia_factor(model, time_s)])

    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of the inertia."""
        return effect_id in _OF_INERTIA

    def followed_from(self, window: Window, first: int) -> int:
        """Some means before it."""
        return max(first - _FOLLOWED * SHORT, window.first)

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first of the range that is kept: the shaft is where its commands are, whatever it does."""
        begin = max(first, window.first)
        return begin if begin < end else None

    def estimate_in(self, window: Window, model: ServoAxisParameters, known: Array, first: int, end: int) -> Array:
        """Inertia by the torques of its accelerations, fitted with a constant one and one in proportion to the
        speed."""
        segment = Segment.of(self, window, self.with_estimate(model, known), first, end, first)
        here, there = (segment.residual(self.with_estimate(model, known * (1.0 + share)))[0] for share in (0.0, _STEP))
        rows, speed = segment.predictor.rows, segment.data.commands_m_s[:, 0]
        columns = np.column_stack([(there - here) / _STEP, np.ones(len(here)), speed])[rows]
        share = -float(np.linalg.lstsq(columns, here[rows], rcond=None)[0][0])
        return np.asarray(known * (1.0 + float(np.clip(share, -_MOST, _MOST))))

    def data_of(self, window: Window, model: ServoAxisParameters, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, of a shaft, which has no memory of earlier ones. Raises UnusableInputError
        for what can't be diagnosed."""
        data = super().data_of(window, model, first, end, begun)
        return replace(data, left_out=data.left_out | self._pushed(window.measured(first, end)))

    def _pushed(self, measured: Rows) -> Rows:
        """(n,): several rows in a row that were not `measured` in time (n,), and those behind them. A load motor that
        does not hear from the bench goes on with the torque that it has, and pushes the shaft."""
        late = np.convolve(~measured, np.ones(_LATE), "valid") > _LATE - 0.5
        pushed = np.zeros(len(measured), bool)
        for row in np.flatnonzero(late):
            pushed[row : row + _LATE + round(_PUSHED_S / self.cycle_s)] = True
        return pushed

    def steady(self, chunk_s: float) -> tuple[float, dict[str, float]]:
        """A speed, rad/s: the shaft looks at any chunk."""
        return _TURNS_RAD_S, {}


class ShaftGap:
    """The gap of one model along a run of a servo axis: the drive's torque less the one that its motion requires, N·m.

    Motion and torque are means over `SHORT` cycles. The acceleration of a mean is that of its neighbours' positions, so
    it is known one mean later; the torque is weighted as that weights it.
    """

    def __init__(self, model: ServoAxisParameters, cycle_s: float) -> None:
        self._p = lay.pack(model)
        self._factor = _inertia_factor(model, 0.0)
        self._mean_s = SHORT * cycle_s
        self.restart()

    def restart(self) -> None:
        """The next rows are not those that follow the last."""
        self._kept = np.full((_NEIGHBOURS, 2), np.nan)  # position and torque of the last means

    def use_estimate(self, estimate: Array) -> None:
        """Inertia of the shaft (1,) from now on, kg·m²."""
        self._p[lay.P_INERTIA] = estimate[0] / self._factor

    def follow(self, channels: Mapping[str, Array], known: Rows) -> Array:
        """(n // SHORT, 1): of the next rows (n,) of x1_rad and tau1_Nm; n a multiple. Each is of the mean before.

        NaN where a row is not known."""
        rows = np.column_stack([channels["x1_rad"], channels["tau1_Nm"]])
        rows = np.where(known[:, None], rows, np.nan)
        means = np.concatenate([self._kept, rows.reshape(-1, SHORT, 2).mean(axis=1)])
        self._kept = means[-_NEIGHBOURS:]
        x, torque = means.T
        speed = (x[2:] - x[:-2]) / (2.0 * self._mean_s)
        acceleration = (x[2:] - 2.0 * x[1:-1] + x[:-2]) / self._mean_s**2
        required = np.empty(len(speed))
        required_torque_Nm(self._p, x[1:-1], speed, acceleration, self._mean_s, required)
        return np.asarray((torque[1:-1] - required)[:, None])
