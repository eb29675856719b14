"""Compiled cycle of the twin of a servo axis: `ServoAxisTwin.compare`, the step of its shaft and `published`, with the
`TwinApplication` status for the next SYNC.

It runs in stages: it returns the stage of a rare event, the interpreter does its part, and calls it again from the
following stage. All state is in vectors, addressed by a table.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isnan, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, compiled, entry_point, floats, integers, table_of
from hilbench.cycle_program import CompiledStage
from hilbench.estimation.plausibility import Plausibility, find_problem
from hilbench.estimation.problems import PROBLEMS, Problem
from hilbench.estimation.servo_axis import balance, inertia
from hilbench.estimation.servo_axis.balance import ShaftSample
from hilbench.estimation.servo_axis.inertia import InertiaEstimator, take_next
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.shaft import ServoAxis
from hilbench.plant.web_line import kernel, laws, rig_cycle
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line.layout import Vector
from hilbench.twin.machines.machine import LOOK, WENT_ON, MachineVectors
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED

Places = NDArray[np.int64]

#: Stages: start of a cycle; results of `inertia.take_next` for the interpreter; unusable measurement; resume with the
#: estimate, or without; final codes.
_COMPARE, NOT_NEXT, _MISLED, HOLD, _SIMULATE, _FINISH, _DONE, _LOOK = range(8)
_STAGE_OF = {NOT_NEXT: inertia.NOT_NEXT, _MISLED: inertia.MISLED}
#: Machine result of each final code.
_ENDS = {_DONE: WENT_ON, _LOOK: LOOK}
# Rows of the table: those of `rig_cycle.step`, then the machine's own, then those of the estimator.
_P, _S, _U, _WORK, _OUT, _MOTORS, _SET_POINTS, _SENSORS, _SILENCE, _SHOWN = range(10)
_FIGURES, _OUTPUTS, _MEASURED, _VALUES, _WHOLE, _AT, _PLAUSIBILITY, _STATED, _INPUTS = range(10, 19)
#: Column of the mean torque in the kernel's report.
_MEAN = 3
_BANK = _INPUTS + len(balance.InputVectors._fields)
#: Figures: drive samples of a cycle, share of the inertia up to which its deviation counts as known.
_SAMPLES, _KNOWN = range(2)
#: Outputs: torque residual, simulated torque (NaN: none) and its ripple; the `Problem`; estimated dry and viscous
#: friction; the status of the last SYNC; the problem of the previous cycle.
RESIDUAL_NM, BEFORE_NM, _RIPPLE_NM, PROBLEM, COULOMB, VISCOUS, _STATUS, _PROBLEM_BEFORE = range(8)
#: Offsets: SYNC number and status in the integers; published values.
_NUMBER, _STATUS_AT, _PUBLISHED = range(3)
#: Offsets of position and torque in the measurement, and of the torque in the motor's feedback.
_POSITION, _TORQUE = 0, 2
_NUMBERS = 0x10000


@compiled
def _ripple_Nm(outputs: Vector, out: Vector, simulated_Nm: float) -> float:
    """Excess of the simulated torque's mean over that of both ends of the cycle."""
    before_Nm, outputs[BEFORE_NM] = outputs[BEFORE_NM], simulated_Nm
    return 0.0 if isnan(before_Nm) else out[_MEAN] - 0.5 * (before_Nm + simulated_Nm)


@compiled
def _simulate(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    out: Vector,
    outputs: Vector,
    stated: Vector,
    figures: Vector,
    position_rad: float,
) -> None:
    """Compiled `ServoAxisTwin._simulate`; `figures`: those of the bank."""
    if figures[inertia.PRIORS + 1] > 0.0:
        outputs[VISCOUS] = stated[inertia.VISCOUS]
    if figures[inertia.PRIORS + 2] > 0.0:
        outputs[COULOMB] = stated[inertia.COULOMB]
    time_s = s[line.S_COUNT] * p[lay.P_SAMPLE_TIME_S]
    p[lay.P_INERTIA] = stated[inertia.INERTIA] / laws.inertia_factor_at(p, lay.AXIS, time_s)
    p[lay.P_COULOMB], p[lay.P_VISCOUS] = max(outputs[COULOMB], 0.0), max(outputs[VISCOUS], 0.0)
    s[lay.S_X_BEHIND] = position_rad + (s[lay.S_X_BEHIND] - s[lay.S_X])
    s[lay.S_X], speed = position_rad, s[lay.S_V]
    s[lay.S_DIRECTION] = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    kernel.observe(p, s, u, w, out)


@compiled
def _publish(values: Vector, at: Places, stated: Vector, outputs: Vector, torque_Nm: float) -> None:
    """Compiled `ServoAxisTwin.published`."""
    values[at[_PUBLISHED]] = stated[inertia.INERTIA]
    values[at[_PUBLISHED + 1]] = outputs[COULOMB]
    values[at[_PUBLISHED + 2]] = stated[inertia.DEVIATION]
    values[at[_PUBLISHED + 3]] = torque_Nm
    values[at[_PUBLISHED + 4]] = outputs[RESIDUAL_NM]
    values[at[_PUBLISHED + 5]] = stated[inertia.COULOMB_SD]
    values[at[_PUBLISHED + 6]] = outputs[VISCOUS]
    values[at[_PUBLISHED + 7]] = stated[inertia.VISCOUS_SD]


@compiled
def _status(stated: Vector, problem: float, known: float) -> int:
    """Compiled `TwinApplication._status` of a released machine with its configured model."""
    status = RUNNING
    if problem != 0.0:
        status |= HOLDING
    elif stated[inertia.DEVIATION] <= known * stated[inertia.INERTIA]:
        status |= SYNCHRONIZED
    if stated[inertia.SEPARABLE] == 0.0:
        status |= NOT_SEPARABLE
    return status


@entry_point(COUNT, TABLE)
def _run(stage: int, table: Places) -> int:
    if stage < 0:
        return stage
    out, shown = floats(table, _OUT, (1,)), floats(table, _SHOWN, (1,))
    measured, outputs, stated = (
        floats(table, _MEASURED, (1,)),
        floats(table, _OUTPUTS, (1,)),
        floats(table, _STATED, (1,)),
    )
    figures, whole, at = floats(table, _FIGURES, (1,)), integers(table, _WHOLE, (1,)), integers(table, _AT, (1,))
    position_rad, torque_Nm = measured[_POSITION], measured[_TORQUE]
    if stage == _COMPARE:
        outputs[RESIDUAL_NM], outputs[_PROBLEM_BEFORE] = torque_Nm - shown[_TORQUE], outputs[PROBLEM]
        outputs[PROBLEM] = find_problem(floats(table, _PLAUSIBILITY, (1,)), torque_Nm, 1.0, position_rad)
        if outputs[PROBLEM] != 0.0:
            return HOLD
        outputs[_RIPPLE_NM] = _ripple_Nm(outputs, out, shown[_TORQUE])
        inputs, of_bank = balance.of_table(table, _INPUTS), inertia.of_table(table, _BANK)
        found = take_next(inputs, of_bank, position_rad, torque_Nm, outputs[_RIPPLE_NM], stated)
        if found != inertia.TAKEN:
            return NOT_NEXT if found == inertia.NOT_NEXT else _MISLED
        stage = _SIMULATE
    p, s, u, w = floats(table, _P, (1,)), floats(table, _S, (1,)), floats(table, _U, (1,)), floats(table, _WORK, (1,))
    if stage == _SIMULATE:
        _simulate(p, s, u, w, out, outputs, stated, floats(table, _BANK + 7, (1,)), position_rad)
    rig_cycle.step(
        p, s, u, w, out, integers(table, _MOTORS, (1,)), floats(table, _SET_POINTS, (1,)), int(figures[_SAMPLES]),
        floats(table, _SENSORS, (1,)), floats(table, _SILENCE, (1,)), shown,
    )  # fmt: skip
    _publish(floats(table, _VALUES, (1,)), at, stated, outputs, shown[_TORQUE])
    outputs[_STATUS] = whole[at[_STATUS_AT]]
    whole[at[_STATUS_AT]] = _status(stated, outputs[PROBLEM], figures[_KNOWN])
    whole[at[_NUMBER]] = (whole[at[_NUMBER]] + 1) % _NUMBERS
    return _DONE if outputs[PROBLEM] == 0.0 and outputs[_PROBLEM_BEFORE] == 0.0 else _LOOK


def warm_up() -> None:
    """Compile, or load, the cycle in advance."""
    _run(-1, np.zeros((1, 1), np.int64))


class ShaftInVectors:
    """Runner of a `ServoAxisTwin` in vectors; see `machine.InVectors`.

    `outputs`: initial outputs by RESIDUAL_NM and so on; `keeps`: callback that takes the outputs over, at the end and
    when a problem appears or ends.
    """

    def __init__(
        self,
        estimator: InertiaEstimator,
        of_torque: Plausibility,
        plant: ServoAxis,
        cycle_s: float,
        known: float,
        outputs: dict[int, float],
        keeps: Callable[[Vector], None],
        vectors: MachineVectors,
        fallback: Callable[[int], bool],
    ) -> None:
        self._fallback = fallback
        self._estimator, self._cycle_s, self._keeps = estimator, cycle_s, keeps
        self._measured = vectors.measured
        self._outputs = np.zeros(_PROBLEM_BEFORE + 1)
        for place, value in outputs.items():
            self._outputs[place] = value
        at = np.array([vectors.number, vectors.status, *vectors.published], np.int64)
        step = plant.step_in_vectors(cycle_s)
        self._own: tuple[NDArray[Any], ...] = (
            *(*plant.vectors, step.motors, vectors.asked, step.sensors, step.silence, vectors.shown),
            *(np.array([float(step.samples), known]), self._outputs, vectors.measured, vectors.values, vectors.whole),
            *(at, of_torque.state, estimator.stated),
        )
        self._take_table()

    def _take_table(self) -> None:
        """Update the table after a change of the estimator's vectors."""
        self._of = self._estimator.table
        self._table = np.concatenate([table_of(self._own), self._of])
        self.piece = CompiledStage(
            _run, _COMPARE, self._own, continues=_DONE, fallback=self._fallback, table=self._table
        )

    def has_ended(self, code: int) -> bool:
        """True if the cycle was completed; see `machine.InVectors`."""
        return code in _ENDS

    def go_on_from(self, code: int) -> int:
        """Run the rest of a cycle; see `machine.InVectors`."""
        if code not in _ENDS:
            code = self._go_on_by_objects(code)
        if code == _LOOK:
            self._keeps(self._outputs)
        return _ENDS[code]

    def _go_on_by_objects(self, stage: int) -> int:
        """Run an interpreted stage, then the compiled ones after it."""
        if stage == HOLD:
            self._outputs[BEFORE_NM] = nan
            self._estimator.hold(self._cycle_s)
        else:
            position_rad, torque_Nm = self._measured.item(_POSITION), self._measured.item(_TORQUE)
            sample = ShaftSample(self._cycle_s, position_rad, torque_Nm, self._outputs.item(_RIPPLE_NM))
            self._estimator.go_on_from(_STAGE_OF[stage], sample)
        if self._of is not self._estimator.table:
            self._take_table()
        return _run(_FINISH if stage == HOLD else _SIMULATE, self._table)

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        self._keeps(self._outputs)
        return int(self._outputs.item(_STATUS))


def problem_of(outputs: Vector) -> Problem | None:
    """Reason why the last measurement could not be used, if any."""
    return PROBLEMS[int(outputs.item(PROBLEM))]
