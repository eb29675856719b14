"""Compiled cycle of the twin of a servo axis: `ServoAxisTwin.compare`, the step of its shaft and `published`, with the
`TwinApplication` status for the next SYNC. All state is in vectors, addressed by a table."""

from __future__ import annotations

from math import isnan, nan
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Record,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    record_type,
)
from hilbench.estimation.bank import Places
from hilbench.estimation.plausibility import PLAUSIBILITY, find_problem
from hilbench.estimation.servo_axis import inertia
from hilbench.estimation.servo_axis.inertia import InertiaArrays
from hilbench.plant.motor_port import TORQUE
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.web_line import kernel, laws, records, rig_cycle
from hilbench.plant.web_line.line_vectors import arrays
from hilbench.twin.machines.machine import LOOK, WENT_ON
from hilbench.twin.virtual_io import HOLDING, NOT_SEPARABLE, RUNNING, SYNCHRONIZED

#: Torque residual, simulated torque (NaN: none); the `Problem`; estimated dry and viscous friction; the status of the
#: last SYNC; the problem of the previous cycle.
OUTPUTS: Final = record_type(
    *("residual_Nm", "before_Nm", "problem", "coulomb_Nm", "viscous_Nm_s_per_rad", "status", "problem_before")
)
#: Cycle time, drive samples of a cycle, share of the inertia up to which its deviation counts as known.
FIGURES: Final = record_type("cycle_s", "samples", "known")
#: Places in the integers of SYNC number and status; in the values of the outputs.
AT: Final = record_type("number", "status", of=np.int64)
PUBLISHED: Final = record_type(
    *("inertia_kg_m2", "coulomb_Nm", "deviation_kg_m2", "torque_sim_Nm", "torque_residual_Nm", "coulomb_sd_Nm"),
    *("viscous_Nm_s_per_rad", "viscous_sd"),
    of=np.int64,
)
#: Column of the mean torque in the kernel's report; offset of the position in the measurement.
_MEAN, _POSITION = 3, 0
_NUMBERS = 0x10000


class ShaftArrays(NamedTuple):
    """The simulated shaft, then the machine's own, and those of the estimator; `values`, `whole`, `measured`, `asked`
    and `shown` (of the rig) as of `MachineVectors`."""

    noisy: rig_cycle.NoisyRig
    figures: Annotated[Any, FIGURES]
    outputs: Annotated[Any, OUTPUTS]
    measured: Reals
    values: Reals
    whole: Wholes
    at: Annotated[Any, AT]
    published: Annotated[Any, PUBLISHED]
    plausibility: Annotated[Any, PLAUSIBILITY]
    estimator: InertiaArrays


@compiled
def _simulate(a: ShaftArrays, position_rad: float) -> None:
    """Compiled `ServoAxisTwin._simulate`."""
    s, outputs, stated, priors = a.noisy.rig.line.s, a.outputs, a.estimator.stated, a.estimator.inputs.u.priors
    if priors[1] > 0.0:
        outputs.viscous_Nm_s_per_rad = stated.viscous
    if priors[2] > 0.0:
        outputs.coulomb_Nm = stated.coulomb
    of = arrays(a.noisy.rig.line)
    axis, sample_s = records.axis(of, 0), records.web(of).sample_time_s
    axis.roller_mass_kg = stated.inertia_kg_m2 / laws.inertia_factor_at(axis, kernel.time_s(of), sample_s)
    axis.coulomb_N, axis.viscous_N_s_per_m = max(outputs.coulomb_Nm, 0.0), max(outputs.viscous_Nm_s_per_rad, 0.0)
    s[lay.S_X_BEHIND] = position_rad + (s[lay.S_X_BEHIND] - s[lay.S_X])
    s[lay.S_X], speed = position_rad, s[lay.S_V]
    s[lay.S_DIRECTION] = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else 0.0)
    kernel.observe(*a.noisy.rig.line)


@compiled
def _publish(a: ShaftArrays) -> None:
    """Compiled `ServoAxisTwin.published`."""
    values, at, stated, outputs = a.values, a.published, a.estimator.stated, a.outputs
    values[at.inertia_kg_m2] = stated.inertia_kg_m2
    values[at.coulomb_Nm] = outputs.coulomb_Nm
    values[at.deviation_kg_m2] = stated.deviation_kg_m2
    values[at.torque_sim_Nm] = a.noisy.rig.shown[TORQUE]
    values[at.torque_residual_Nm] = outputs.residual_Nm
    values[at.coulomb_sd_Nm] = stated.coulomb_sd
    values[at.viscous_Nm_s_per_rad] = outputs.viscous_Nm_s_per_rad
    values[at.viscous_sd] = stated.viscous_sd


@compiled
def _status(stated: Record, problem: float, known: float) -> int:
    """Compiled `TwinApplication._status` of a released machine with its configured model."""
    status = RUNNING
    if problem != 0.0:
        status |= HOLDING
    elif stated.deviation_kg_m2 <= known * stated.inertia_kg_m2:
        status |= SYNCHRONIZED
    if stated.separable == 0.0:
        status |= NOT_SEPARABLE
    return status


@entry_point(COUNT, TABLE)
def run(stage: int, table: Places) -> int:
    a = arrays_in(table, ShaftArrays)
    outputs, whole, at = a.outputs, a.whole, a.at
    position_rad, torque_Nm = a.measured[_POSITION], a.measured[TORQUE]
    simulated_Nm = a.noisy.rig.shown[TORQUE]
    outputs.residual_Nm, outputs.problem_before = torque_Nm - simulated_Nm, outputs.problem
    outputs.problem = find_problem(a.plausibility, torque_Nm, 1.0, position_rad)
    if outputs.problem != 0.0:
        outputs.before_Nm = nan
        inertia.hold(a.estimator, a.figures.cycle_s, False)
    else:
        # Excess of the simulated torque's mean over that of both ends of the cycle.
        before_Nm, outputs.before_Nm = outputs.before_Nm, simulated_Nm
        mean_Nm = a.noisy.rig.line.out[_MEAN]
        ripple_Nm = 0.0 if isnan(before_Nm) else mean_Nm - 0.5 * (before_Nm + simulated_Nm)
        inertia.update(a.estimator, position_rad, torque_Nm, ripple_Nm)
        _simulate(a, position_rad)
    rig_cycle.step_noisy(a.noisy, int(a.figures.samples))
    _publish(a)
    outputs.status = whole[at.status]
    whole[at.status] = _status(a.estimator.stated, outputs.problem, a.figures.known)
    whole[at.number] = (whole[at.number] + 1) % _NUMBERS
    return WENT_ON if outputs.problem == 0.0 and outputs.problem_before == 0.0 else LOOK
