"""The next experiment of a lone axis: what moves of its speed tell, by the torque that they need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.next_experiment import (
    RAMP_S,
    STEEP_S,
    NextExperiment,
    Question,
    Step,
    best,
    questions_of,
    through,
)

Array = NDArray[np.float64]

#: Of the axis' speed, by the unit of its position.
_SPEED: Final = {"rad": "speed_rad_s", "m": "line_speed_m_s"}
#: Speeds between which steep ramps go, as shares of the top speed.
_LOW, _HIGH = 0.4, 0.8
_PERIOD_S: Final = 0.002
#: How long a drive takes to follow a corner of its command, s.
_FOLLOWS_S: Final = 0.01
#: Share of the top speed below which the axis stands, where dry friction is not one law but many.
_STANDSTILL: Final = 0.01
#: What is left on measured motion is not white: so far apart are samples that count as one each, s.
_APART_S: Final = 0.05


@dataclass(frozen=True)
class AxisReach:
    """Range that the axis has covered already, and may be asked for again; in its unit of position per s and s²."""

    top: float
    steepest: float
    torque_Nm: float  #: usual, rms

    @classmethod
    def of(cls, data: Measured) -> AxisReach:
        """By how it moved."""
        apart = max(1, round(STEEP_S / data.period_s))
        x = data.x_m[1]
        speed = (x[apart:] - x[:-apart]) / (apart * data.period_s)
        steepest = float(np.max(np.abs(speed[apart:] - speed[:-apart]))) / STEEP_S
        return cls(float(np.max(np.abs(speed))), steepest, float(np.sqrt(np.mean(data.tau_Nm[1] ** 2))))


def moves(reach: AxisReach, path: str) -> dict[str, list[Step]]:
    """The library: each move from standstill to standstill, by what it is."""
    both = [(sign * share, RAMP_S, 0.8) for sign in (1.0, -1.0) for share in (0.25, 0.5, 0.75, 1.0)]
    levels: dict[str, list[tuple[float, float, float]]] = {
        "forward and back": [(share, RAMP_S, 1.5) for share in (0.5, -0.5)],
        "slowly forward and back": [(share, 0.5, 1.5) for share in (0.08, -0.08) * 2],
        "levels of speed in both directions": both,
        "creep": [(0.02, 0.6, 3.0), (0.1, 0.6, 2.0), (0.3, 0.6, 1.0)],
        "steep ramps": [(_LOW, RAMP_S, 0.5), *((share, 0.0, 0.5) for share in (_HIGH, _LOW) * 3)],
        "a slow ramp": [(1.0, 10.0, 0.5)],
    }
    return {name: through(path, reach.top, reach.steepest, each) for name, each in levels.items()}


def propose(found: Diagnosis, reach: AxisReach) -> NextExperiment | None:
    """The move, or two, that would tell most of what `found` leaves open; None where no move would tell of it.

    The torque of each is that which its motion needs by the model that was found, with and without what is asked.
    """
    model, kind = found.model, machines.of_kind(found.model)
    questions = list(questions_of(found, lambda axis: kind.sizes(model, axis, reach.top, reach.torque_Nm, _PERIOD_S)))
    exact = found.emulation is not None
    noise_Nm = found.gap.noise_floor if exact else max(found.gap.noise_floor, found.gap.after)
    every = 1 if exact else round(_APART_S / _PERIOD_S)

    def is_identified(steps: list[Step]) -> Array:
        x, v, a = _motion(steps)
        rows = np.flatnonzero(np.abs(v) > _STANDSTILL * reach.top)[::every]

        def predicted(question: Question) -> Array:
            torques = np.empty((len(question.models), len(v)))
            for one, out in zip(question.models, torques, strict=True):
                kind.required_torque_Nm(kind.pack(one), x, v, a, _PERIOD_S, out)
            return np.asarray(torques[:, rows] / max(noise_Nm, 1e-300))

        return np.array([question.is_identified(predicted(question)) for question in questions])

    return best(moves(reach, _SPEED[model.position_unit]), questions, is_identified)


def _motion(steps: list[Step]) -> Array:
    """(3, n): position, speed and acceleration of an axis that follows the steps."""
    times, speeds = [0.0], [0.0]
    for step in steps:
        ((kind, what),) = step.items()
        times.append(times[-1] + what["duration_s"])
        speeds.append(what["to"] if kind == "ramp" else speeds[-1])
    t = np.arange(round(times[-1] / _PERIOD_S)) * _PERIOD_S
    v = gaussian_filter1d(np.interp(t, times, speeds), _FOLLOWS_S / _PERIOD_S)
    return np.array([np.cumsum(v) * _PERIOD_S, v, np.gradient(v, _PERIOD_S)])
