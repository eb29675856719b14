"""A cycle of the twin of two rollers and the span between them, compiled: `WebLineTwin.compare`, `listen`, the step of
its line and `published`, with the status that `TwinApplication` says with the next SYNC.

It goes by stages as `tracking_cycle.run` does: where something happens that is rare it returns the stage, Python does
its part, and calls it again from FINISH. All of it stands in vectors, by a table of where these are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, compiled, entry_point, floats, integers, table_of
from hilbench.estimation.web_line import torque_shift
from hilbench.estimation.web_line import tracking_cycle as cycle
from hilbench.estimation.web_line.synchronizers import changepoint
from hilbench.estimation.web_line.tracking import Tracking
from hilbench.estimation.web_line.tracking_cycle import run_vectors
from hilbench.plant import pairing
from hilbench.plant.pairing import Pairing, SteadyWay, comes_steadily, paired
from hilbench.plant.web_line import kernel, rig_cycle
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line import LineStep
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, MachineVectors
from hilbench.twin.virtual_io import TwinStatus

Places = NDArray[np.int64]

#: Where to go on behind what is Python's: with a measurement that was compared, or without; what `run` returns is one
#: of the stages of `tracking_cycle` that are Python's, or these.
_FINISH, _FINISH_WITHOUT, _UNPAIRED, _DONE, _LOOK = range(cycle.DONE + 1, cycle.DONE + 6)

# Rows of the table behind those of the tracking.
(
    _WAYS,
    _STEADY,
    _FIGURES,
    _SAID,
    _POSITIONS,
    _MEASURED,
    _ASKED,
    _SHOWN,
    _MOTORS,
    _SENSORS,
    _SILENCE,
    _VALUES,
    _WHOLE,
    _AT,
) = range(cycle.ROWS, cycle.ROWS + 14)
#: Figures: metres at the web per rad of each motor, by how much ways may differ, drive samples of a cycle; from which
#: deviation E counts as known; of a method that is Python's what it takes the strain upstream for beyond what is told,
#: and whether it tells all apart.
_M_PER_RAD_1, _M_PER_RAD_2, _LEAST_WAY_M, _SAMPLES, _KNOWN_PCT, _INPUT_STRAIN, _SEPARABLE = range(7)
#: What was said last: residual of the torque, shift of the torque and whether it is undecided as they were reported,
#: the status of the last SYNC.
_RESIDUAL_NM, _SHIFT_NM, _UNDECIDED, _STATUS = range(4)
#: Places in the values: strain upstream and tension downstream as told, then what is published; among the whole
#: numbers: number of the SYNC and status.
_STRAIN_PREV, _F_NEXT_N, _NUMBER, _STATUS_AT, _PUBLISHED = range(5)
_F_SIM_N, _E_SIM_PA, _E_DEVIATION_PA, _TORQUE_SIM_NM, _TORQUE_RESIDUAL_NM, _COUNT_PUBLISHED = range(6)
#: Of the second axis in what is measured, and in what its motor shows.
_TORQUE_2, _SHOWN_TORQUE_2 = 4 + 2, rig_cycle.SHOWN + 2
_NUMBERS = 0x10000
_RUNNING, _SYNCHRONIZED, _HOLDING, _REFUSED, _NOT_SEPARABLE = (
    int(bit)
    for bit in (
        TwinStatus.RUNNING,
        TwinStatus.SYNCHRONIZED,
        TwinStatus.HOLDING,
        TwinStatus.TRANSFER_REFUSED,
        TwinStatus.NOT_SEPARABLE,
    )
)


@compiled
def _status(t: Vector, known_pct: float, separable: bool) -> int:
    """`TwinApplication._status` of a machine that is released, with the model that it was configured with."""
    status = _RUNNING
    if cycle.is_synchronized(t, known_pct):
        status |= _SYNCHRONIZED
    if t[cycle.PROBLEM] != 0.0:
        status |= _HOLDING
    if t[cycle.REFUSED] != 0.0:
        status |= _REFUSED
    if not separable:
        status |= _NOT_SEPARABLE
    return status


@compiled
def _publish(t: Vector, tension_N: float, torque_Nm: float, residual_Nm: float, at: Places, values: Vector) -> None:
    """`WebLineTwin.published` of a line without effects on E."""
    factor = t[cycle.SERIES_FACTOR]
    values[at[_PUBLISHED + _F_SIM_N]] = tension_N
    values[at[_PUBLISHED + _E_SIM_PA]] = factor * t[cycle.MODULUS_PA]
    values[at[_PUBLISHED + _E_DEVIATION_PA]] = factor * t[cycle.DEVIATION_PA]
    values[at[_PUBLISHED + _TORQUE_SIM_NM]] = torque_Nm
    values[at[_PUBLISHED + _TORQUE_RESIDUAL_NM]] = residual_Nm


def _entry_point(sources: int) -> Callable[[int, Places], int]:
    """For Python; `sources` as in `compiled.number_of_sources`."""

    @entry_point(COUNT, TABLE)
    def run(stage: int, table: Places) -> int:
        if sources < 0 or stage < 0:
            return stage
        t, shift = floats(table, cycle.STATE_ROW, (1,)), floats(table, cycle.SHIFT_ROW, (1,))
        figures, said, values = floats(table, _FIGURES, (1,)), floats(table, _SAID, (1,)), floats(table, _VALUES, (1,))
        whole, at = integers(table, _WHOLE, (1,)), integers(table, _AT, (1,))
        shown, measured = floats(table, _SHOWN, (1,)), floats(table, _MEASURED, (1,))
        strain_prev, F_next_N = values[at[_STRAIN_PREV]], values[at[_F_NEXT_N]]
        if stage == cycle.COMPARE:
            steady, x_m = floats(table, _STEADY, (1,)), floats(table, _POSITIONS, (1,))
            for axis in range(2):
                x_m[axis] = measured[4 * axis] * figures[_M_PER_RAD_1 + axis]
            if not paired(floats(table, _WAYS, (1,)), x_m, figures[_LEAST_WAY_M]):
                steady[pairing.STEADY_MISSED] += 1.0
                return _UNPAIRED
            if not comes_steadily(steady, x_m[1]):
                return _UNPAIRED
            torque_Nm, torque_sim_Nm = measured[_TORQUE_2], shown[_SHOWN_TORQUE_2]
            said[_RESIDUAL_NM] = torque_Nm - t[cycle.SHIFT_NM] - torque_sim_Nm
            compared = x_m[0], x_m[1], torque_Nm, torque_sim_Nm, strain_prev, F_next_N, nan
            stage = run_vectors(cycle.COMPARE, compared, table)
            if stage != cycle.DONE:
                return stage
            stage = _FINISH
        p, s = floats(table, cycle.LINE_ROW, (1,)), floats(table, cycle.LINE_ROW + 1, (1,))
        u, work = floats(table, cycle.LINE_ROW + 2, (1,)), floats(table, cycle.LINE_ROW + 3, (1,))
        out, motors = floats(table, cycle.LINE_ROW + 4, (1,)), integers(table, _MOTORS, (1,))
        u[lay.U_STRAIN_PREV], u[lay.U_F_NEXT_N] = strain_prev + figures[_INPUT_STRAIN], F_next_N
        asked, sensors = floats(table, _ASKED, (1,)), floats(table, _SENSORS, (1,))
        silence = floats(table, _SILENCE, (1,))
        rig_cycle.step(p, s, u, work, out, motors, asked, int(figures[_SAMPLES]), sensors, silence, shown)
        tension_N = out[3 * int(p[lay.W_MOTORS])]
        _publish(t, tension_N, shown[_SHOWN_TORQUE_2], said[_RESIDUAL_NM], at, values)
        separable = figures[_SEPARABLE] != 0.0
        if t[cycle.BANK] != 0.0:
            inputs, out_of_bank = floats(table, cycle.BANK_INPUTS_ROW, (1,)), floats(table, cycle.BANK_OUT_ROW, (1, 2))
            separable = changepoint.separable(inputs, integers(table, cycle.BANK_PLACES_ROW, (1,)), out_of_bank)
        said[_STATUS] = whole[at[_STATUS_AT]]
        whole[at[_STATUS_AT]] = _status(t, figures[_KNOWN_PCT], separable)
        whole[at[_NUMBER]] = (whole[at[_NUMBER]] + 1) % _NUMBERS
        if stage == _FINISH_WITHOUT:
            return _UNPAIRED
        undecided = 1.0 if torque_shift.undecided(shift) else 0.0
        told = said[_SHIFT_NM] == t[cycle.SHIFT_NM] and said[_UNDECIDED] == undecided
        said[_SHIFT_NM], said[_UNDECIDED] = t[cycle.SHIFT_NM], undecided
        return _DONE if told and t[cycle.PROBLEM] == 0.0 and t[cycle.REFUSED] == 0.0 else _LOOK

    return run


_run = _entry_point(
    kernel.source_number(
        *(str(module.__file__) for module in (pairing, rig_cycle)),
        *cycle.SOURCES,
        __file__,
    )
)


def warm_up() -> None:
    """Compile, or load, before anybody waits for a cycle."""
    _run(-1, np.zeros((1, 1), np.int64))


class Residual(Protocol):
    """Who keeps the residual of the torque."""

    residual_Nm: float


class SpanInVectors:
    """A `WebLineTwin` of two rollers that goes on in vectors; see `machine.InVectors`.

    `metres_per_rad` (2,): at the web, of the motors; `keeps`: who is to have the residual afterwards.
    """

    def __init__(
        self,
        tracking: Tracking,
        pairing_of_axes: Pairing,
        steady: SteadyWay,
        line: LineStep,
        metres_per_rad: Sequence[float],
        least_way_m: float,
        keeps: Residual,
        vectors: MachineVectors,
    ) -> None:
        self._tracking, self._keeps, self._values = tracking, keeps, vectors.values
        ways, positions_m = pairing_of_axes.vectors(len(metres_per_rad))
        figures = [*metres_per_rad, least_way_m, float(line.samples), tracking.config.synchronized_pct, 0.0, 1.0]
        self._figures = np.array(figures)
        self._said = np.array([keeps.residual_Nm, nan, nan, 0.0])
        self._at = np.array(
            [vectors.told["strain_prev"], vectors.told["F_next_N"], vectors.number, vectors.status, *vectors.published],
            np.int64,
        )
        self._own = (
            *(ways, steady.state, self._figures, self._said, positions_m),
            *(vectors.measured, vectors.asked, vectors.shown, line.motors, line.sensors, line.silence),
            *(vectors.values, vectors.whole, self._at),
        )
        self._of, self._table = tracking.table, np.zeros((0, 0), np.int64)
        self._take_method()

    def _take_method(self) -> None:
        """The method, or what it consists of, may be another one."""
        tracking = self._tracking
        if self._of is not tracking.table or not len(self._table):
            self._of = tracking.table
            self._table = np.concatenate([self._of, table_of(self._own)])
        self._figures[_INPUT_STRAIN] = tracking.input_strain
        self._figures[_SEPARABLE] = tracking.separable

    def go_on(self, time_s: float) -> int:
        """See `machine.InVectors`."""
        stage = _run(cycle.COMPARE, self._table)
        if stage == _DONE:
            return WENT_ON
        if stage != _LOOK:
            stage = self._go_on_by_objects(stage, time_s)
        return LOOK if stage == _LOOK else MISSED if stage == _UNPAIRED else WENT_ON

    def _go_on_by_objects(self, stage: int, time_s: float) -> int:
        """A cycle of which a stage is Python's."""
        tracking = self._tracking
        tracking.has_gone_on()
        if stage == _UNPAIRED:
            tracking.miss()
        else:
            tracking.go_on_from(stage, time_s, self._values.item(self._at.item(_STRAIN_PREV)))
        self._take_method()
        return _run(_FINISH_WITHOUT if stage == _UNPAIRED else _FINISH, self._table)

    def give(self) -> int:
        """See `machine.InVectors`."""
        self._tracking.has_gone_on()
        self._keeps.residual_Nm = self._said.item(_RESIDUAL_NM)
        return int(self._said.item(_STATUS))
