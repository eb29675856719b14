"""A web line: the estimate of E, how the tension is held, the velocities that mass conservation asks for."""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from hilbench.runs.figures import SPEED_BAND, mean_velocity
from hilbench.runs.machines.machine import NO_STEP, Estimate, MachineMetrics, nothing_to_judge, speed_metrics
from hilbench.runs.stretch import Array, Figure, Metric, Stretch, UnknownFigureError, after_a_step, after_a_step_of
from hilbench.topology.main_quantities.web_line import MODULUS, SET_POINT, SPEED

Number = TypeVar("Number", float, NDArray[np.float64])

#: Half width of the band the tension has to come back to, N.
TENSION_BAND_N: Final = 1.0

_NOTHING: Final = nothing_to_judge("line")


def expected_v1_m_s(v2_m_s: Number, strain_prev: Number, strain: Number) -> Number:
    """Steady state of mass conservation in the span, v1/(1+ε_prev) = v2/(1+ε) (design 5); numbers or arrays."""
    return v2_m_s * (1 + strain_prev) / (1 + strain)


def _tension_error(stretch: Stretch) -> Array:
    return stretch.error("F_true_N", "F_ref_N")


def _v1_m_s(stretch: Stretch) -> tuple[float, float]:
    """Mean velocity of roller 1, and what mass conservation asks of it."""
    command = np.abs(stretch.get("v2_cmd_m_s"))
    x1_m, x2_m, strain_prev, strain = map(stretch.get, ("x1_m", "x2_m", "strain_prev", "strain_true"))
    part = stretch.settled(strain)
    if command[part].max() == 0:
        raise UnknownFigureError("the line stands still")
    if np.ptp(command[part]) > SPEED_BAND * command[part].max():
        raise UnknownFigureError("the line speed changes")
    t_s = stretch.t_s[part]
    v2_m_s = mean_velocity(t_s, x2_m[part])
    asked_m_s = expected_v1_m_s(v2_m_s, float(np.mean(strain_prev[part])), float(np.mean(strain[part])))
    return mean_velocity(t_s, x1_m[part]), asked_m_s


def _v1_deviation(stretch: Stretch) -> Figure:
    v1_m_s, asked_m_s = _v1_m_s(stretch)
    return Figure(v1_m_s - asked_m_s)


_TENSION: Final = {
    "tension_recovery_s": Metric(
        "s",
        f"time from a step until the true tension stays within {TENSION_BAND_N:g} N of its set-point",
        NO_STEP,
        lambda s: s.time_in_band(_tension_error(s), TENSION_BAND_N, f"{TENSION_BAND_N:g} N"),
        after_a_step,
    ),
    "tension_overshoot_pct": Metric(
        "%",
        "largest excess of the true tension over a new set-point beyond noise, of the step",
        "the tension set-point did not step, or F_true_N is not recorded",
        lambda s: s.overshoot("F_true_N", "F_ref_N", s.height_of(SET_POINT)),
        after_a_step_of(SET_POINT),
    ),
    "tension_rms_error_N": Metric(
        "N", "rms of true tension minus set-point since the step", _NOTHING, lambda s: s.rms(_tension_error(s))
    ),
    "tension_peak_error_N": Metric(
        "N", "largest true tension error since the step", _NOTHING, lambda s: s.peak(_tension_error(s))
    ),
    "tension_final_error_N": Metric(
        "N", "size of the mean true tension error, settled part", _NOTHING, lambda s: s.final(_tension_error(s))
    ),
    "tension_sim_deviation_N": Metric(
        "N",
        "largest simulated tension error since the step",
        _NOTHING,
        lambda s: s.peak(s.error("F_sim_N", "F_ref_N")),
    ),
}
_MASS: Final = {
    "v1_final_m_s": Metric(
        "m/s",
        "mean velocity of roller 1, settled part of the strain",
        _NOTHING,
        lambda s: Figure(_v1_m_s(s)[0]),
    ),
    "v1_expected_m_s": Metric(
        "m/s",
        "v2·(1+ε_prev)/(1+ε), what mass conservation asks of v1",
        _NOTHING,
        lambda s: Figure(_v1_m_s(s)[1]),
    ),
    "v1_deviation_m_s": Metric("m/s", "v1_final_m_s minus v1_expected_m_s", _NOTHING, _v1_deviation),
}

METRICS: Final = MachineMetrics(
    SPEED,
    {**Estimate(MODULUS, "line").metrics(), **_TENSION, **_MASS, **speed_metrics(SPEED, "v2", "v2_m_s")},
    together=tuple(_MASS),
)
