"""The next experiment of a web machine: what moves of its speed and tension tell, by simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.next_experiment import (
    LONGEST_S,
    RAMP_S,
    START_S,
    STEEP_S,
    NextExperiment,
    Question,
    Step,
    best,
    duration_s,
    hold,
    questions_of,
    through,
)
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.results.recording import Recording

Array = NDArray[np.float64]

_SPEED, _TENSION = "line_speed_m_s", "tension_control.set_point_N"
#: Speeds between which steep ramps go, as shares of the top speed.
_LOW, _HIGH = 0.4, 0.7
_PERIOD_S: Final = 0.002


@dataclass(frozen=True)
class Reach:
    """Range that the machine has covered already, and may be asked for again."""

    top_m_s: float
    steepest_m_s2: float
    tension_N: float | None  #: usual set point; None where none may be set

    @classmethod
    def of(cls, recording: Recording, axes: int = 2, *, tension: bool = True) -> Reach:
        """By the commands of a recording of a web machine of some axes; of one span the tension is set as well."""
        speed, t = np.asarray(recording[f"v{axes}_cmd_m_s"], np.float64), recording.time_s
        apart = max(1, round(STEEP_S / float(np.median(np.diff(t)))))
        steepest = float(np.max(np.abs(speed[apart:] - speed[:-apart]))) / STEEP_S
        wanted = recording["F_ref_N"] if tension and "F_ref_N" in recording else None
        usual = None if wanted is None else float(np.median(np.asarray(wanted, np.float64)))
        return cls(float(np.max(np.abs(speed))), steepest, usual if usual and usual > 0.0 else None)


def _tension(to: float) -> Step:
    return {"set": {"path": _TENSION, "to": round(to, 3)}}


def moves(reach: Reach) -> dict[str, list[Step]]:
    """The library: each move from standstill to standstill, by what it is; those that take too long are left out."""
    levels: dict[str, list[tuple[float, float, float]]] = {
        "slowly forward and back": [(share, 0.5, 1.5) for share in (0.08, -0.08) * 2],
        "levels of speed": [(share, RAMP_S, 2.0) for share in (0.25, 0.5, 0.75, 1.0)],
        "creep": [(0.02, 0.6, 4.0), (0.1, 0.6, 3.0), (0.3, 0.6, 2.0)],
        "steep ramps": [(_LOW, RAMP_S, 1.0), *((share, 0.0, 1.0) for share in (_HIGH, _LOW) * 3)],
    }
    top, steepest = reach.top_m_s, reach.steepest_m_s2
    found = {name: through(_SPEED, top, steepest, each) for name, each in levels.items()}
    if reach.tension_N is not None:
        asked = [_tension(share * reach.tension_N) for share in (1.25, 0.8, 1.15, 1.0)]
        between = [step for one in asked for step in (one, hold(2.2))]
        found["steps of tension"] = through(_SPEED, top, steepest, [(0.6, RAMP_S, 1.5)], between)
    return {name: steps for name, steps in found.items() if START_S + duration_s(steps) <= LONGEST_S}


def propose(found: Diagnosis, reach: Reach) -> NextExperiment | None:
    """The move, or two, that would tell most of what `found` leaves open; None where no move would tell of it.

    Each is simulated with the model that was found, with and without what is asked; how far the predictions lie apart,
    in units of the noise and with the other explanation fitted, is what it would tell.
    """
    model = found.model
    if not isinstance(model, ModelParameters) or model.web is None:
        return None
    machine = model
    questions = list(
        questions_of(found, lambda axis: machine_sizes(machine, axis, top_speed_m_s=reach.top_m_s, torque_Nm=1.0))
    )
    noise = {gap.signal: gap.noise_floor for gap in found.gaps}
    return best(moves(reach), questions, lambda steps: _information(steps, found, machine, reach, questions, noise))


def _information(
    steps: list[Step],
    found: Diagnosis,
    model: ModelParameters,
    reach: Reach,
    questions: list[Question],
    noise: dict[str, float],
) -> Array:
    """Information of steps about each question."""
    data = _as_measured(steps, model, reach)
    predictor = FreeRun(model, data, found.emulation if isinstance(found.emulation, Emulation) else None)
    sigma = np.array([noise.get(name, 0.0) for name in predictor.names])
    sigma = np.where(sigma > 0.0, sigma, predictor.tolerances)
    kept = np.flatnonzero(sigma > 0.0)

    def predicted(question: Question) -> Array:
        models = [one for one in question.models if isinstance(one, ModelParameters)]
        rows = predictor.predict(np.array([lay.pack(one) for one in models]))
        return np.asarray((rows[:, kept] / sigma[kept, None])[:, :, predictor.rows].reshape(len(models), -1))

    return np.array([question.is_identified(predicted(question)) for question in questions])


def _as_measured(steps: list[Step], model: ModelParameters, reach: Reach) -> Measured:
    """Commands of a bench for the steps: speeds, and the strain of the tension set-point."""
    times, speeds, tensions = [0.0], [0.0], [reach.tension_N or model.boundary.upstream_tension_N]
    for step in steps:
        ((kind, what),) = step.items()
        if kind == "set":
            tensions[-1] = what["to"]
            continue
        times.append(times[-1] + what["duration_s"])
        speeds.append(what["to"] if kind == "ramp" else speeds[-1])
        tensions.append(tensions[-1])
    t = np.asarray(np.arange(round(times[-1] / _PERIOD_S)) * _PERIOD_S, np.float64)
    tension = np.array(tensions)[np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(tensions) - 1)]
    strains = [np.full_like(t, model.upstream_strain)]
    strains += [tension / model.stiffness_N(span) for span in range(1, model.span_count + 1)]
    strains.append(np.full_like(t, model.downstream_strain))
    of_axes = [np.interp(t, times, speeds)]
    for span in range(model.span_count, 0, -1):
        before, here, behind = strains[span - 1 : span + 2]
        entering = np.where(of_axes[-1] >= 0.0, here - before, behind - here)
        of_axes.append(of_axes[-1] * (1.0 - entering))
    n, axes = len(t), range(1, model.axis_count + 1)
    zero = np.zeros(n)
    return Measured(
        t_s=t,
        period_s=_PERIOD_S,
        commands_m_s=np.column_stack(of_axes[::-1]),
        boundary=np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (n, 1)),
        tau_Nm=dict.fromkeys(axes, zero),
        x_m=dict.fromkeys(axes, zero),
        v_m_s={},
    )
