"""Comparison of two recordings of one machine: both explained together, and what differs in the later one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis import axis_comparison, machines, web_comparison
from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.noise import rms
from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

Array = NDArray[np.float64]
Announce = Callable[[str, float], None]

#: How many times as large torques, or speeds, of one machine may be in one recording as in the other.
_ONE_MACHINE: Final = 100.0


@dataclass(frozen=True)
class Run:
    """A recording and its place for messages."""

    recording: Recording
    place: str | Path
    emulation: AnyEmulation | None = None  #: how web or shaft was emulated, if the recording is a bench's


def compared(
    after: Run, before: Run, model: Machine | None, announce: Announce = lambda text, share: None
) -> Diagnosis:
    """What changed from `before` to `after`: effects with the size of the change, beside `before` of each value.

    model: of the machine; None for a lone axis of which nothing is known: then its inertia comes from the recordings.
    Gaps and residuals are those of `after`, with the machine as it was before and as it is found now; so is the model.
    Raises UnusableInputError, one line, for recordings that can't be used or do not belong together.
    """
    announce("read both recordings", 0.02)
    if model is None:
        model = _lone_axis(after, before)
    now, then = (measured_from(run.recording, model, run.place) for run in (after, before))
    _check_together(now, then, after.place, before.place)
    if not machines.is_lone(model) or all(each.emulated and each.commands_m_s.size for each in (now, then)):
        found = web_comparison.changes(model, now, then, (after.emulation, before.emulation), announce)
    else:
        found = axis_comparison.changes(model, now, then, announce)
    repairs = [replace(repair, text=f"{before.place}: {repair.text}") for repair in then.repairs]
    return replace(found, repairs=[*now.repairs, *repairs])


def _check_together(now: Measured, then: Measured, place: str | Path, other: str | Path) -> None:
    """Check that two recordings can be of one machine. Raises UnusableInputError, one line."""
    for what, here, there in (("torque", now.tau_Nm, then.tau_Nm), ("position", now.x_m, then.x_m)):
        if set(here) != set(there):
            raise UnusableInputError(
                place, f"{what} of axes {sorted(here)} where {other} has {sorted(there)}, expected the same channels"
            )
    if now.emulated != then.emulated:
        made, other_made = ("with", "without") if now.emulated else ("without", "with")
        raise UnusableInputError(
            place, f"{made} a load motor and {other} {other_made} one, expected two recordings of one machine"
        )
    for axis in now.tau_Nm:
        torque = rms(now.tau_Nm[axis]), rms(then.tau_Nm[axis])
        speed = _top_speed(now, axis), _top_speed(then, axis)
        for what, unit, pair in (("torque", "N·m", torque), ("speed", "m/s or rad/s", speed)):
            if max(pair) > _ONE_MACHINE * min(pair):
                raise UnusableInputError(
                    place,
                    f"{what} of axis {axis} is {pair[0]:.3g} {unit} where it is {pair[1]:.3g} in {other}, expected two "
                    "recordings of one machine",
                )


def _top_speed(data: Measured, axis: int) -> float:
    """Between samples a tenth of a second apart; 1 where it is not known."""
    if axis not in data.x_m:
        return 1.0
    apart = max(1, round(0.1 / data.period_s))
    return float(np.max(np.abs(data.x_m[axis][apart:] - data.x_m[axis][:-apart]))) / (apart * data.period_s)


def _lone_axis(after: Run, before: Run) -> Machine:
    """A model of which only the inertia is known: the larger of what both recordings show (feed-forward hides some)."""
    inertia = 0.0
    for run in (after, before):
        if "x2_m" in run.recording:
            raise UnusableInputError("--model", "missing, expected the model file of a machine of several axes")
        data = measured_from(run.recording, _axis_of(1.0, run.recording), run.place)
        inertia = max(inertia, axis_comparison.inertia(data))
    return _axis_of(inertia, after.recording)


def _axis_of(inertia: float, recording: Recording) -> Machine:
    """One shaft, in the units of its recording: torque over acceleration of x1_rad, or of x1_m."""
    if "x1_rad" in recording or "v1_rad_s" in recording:
        return ServoAxisParameters(shaft=ShaftParameters(inertia_kg_m2=inertia))
    return ModelParameters.model_validate(
        {"rollers": {"radius_m": 1.0, "inertia_kg_m2": inertia, "gear_ratio": 1.0}, "motors": {"inertia_kg_m2": 0.0}}
    )
