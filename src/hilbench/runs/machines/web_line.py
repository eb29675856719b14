"""A web line: the estimate of E, how the tension is held, the velocities that mass conservation asks for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.runs.figures import SPEED_BAND, mean_velocity
from hilbench.runs.machines.machine import NO_STEP, Estimate, MachineMetrics, nothing_to_judge, speed_metrics
from hilbench.runs.segment import (
    Figure,
    Metric,
    Segment,
    UnknownFigureError,
    after_a_step,
    after_a_step_of,
)
from hilbench.topology.main_quantities.web_line import SMALLEST, line_speed, modulus, set_point
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_signals import tension_loop_words

Number = TypeVar("Number", float, NDArray[np.float64])

#: Half width of the band the tension has to come back to, N.
TENSION_BAND_N: Final = 1.0

_OF_SPAN: Final = re.compile(r"(E|tension|v)(\d*)_")
_DISTURBANCE: Final = "_disturbance_pct"
_NOTHING: Final = nothing_to_judge("line")


def expected_v1_m_s(v2_m_s: Number, strain_prev: Number, strain: Number) -> Number:
    """Steady state of mass conservation in a span, v1/(1+ε_prev) = v2/(1+ε) (design 5), v1 that of the roller before
    it; numbers or arrays. Forward: in reverse web comes in at roller 2."""
    return v2_m_s * (1 + strain_prev) / (1 + strain)


def _needs_loop(segment: Segment, number: str) -> None:
    """Raise UnknownFigureError for the tension of a span whose loop was open for long."""
    loop = tension_loop_words(number)
    if loop in segment.open_loops:
        raise UnknownFigureError(f"the {loop} was open for long, see the warnings")


def _tension(number: str) -> dict[str, Metric]:
    """Tension metrics of the span of that number, as names have it (`Shape.numbered`)."""
    quantity = set_point(number)
    true, simulated, goal = f"F{number}_true_N", quantity.twin_signal, quantity.signal

    def error(segment: Segment, tension: str = true) -> Array:
        _needs_loop(segment, number)
        return segment.error(tension, goal)

    def overshoot(segment: Segment) -> Figure:
        _needs_loop(segment, number)
        return segment.overshoot(true, goal, segment.height_of(quantity))

    return {
        f"tension{number}_recovery_s": Metric(
            "s",
            f"time from a step until the true tension stays within {TENSION_BAND_N:g} N of its set-point",
            NO_STEP,
            lambda s: s.time_in_band(error(s), TENSION_BAND_N, f"{TENSION_BAND_N:g} N"),
            after_a_step,
        ),
        f"tension{number}_overshoot_pct": Metric(
            "%",
            "largest excess of the true tension over a new set-point beyond noise, % of the step",
            f"the tension set-point did not step, or {true} is not recorded",
            overshoot,
            after_a_step_of(quantity),
        ),
        f"tension{number}_rms_error_N": Metric(
            "N", "rms of true tension minus set-point since the step", _NOTHING, lambda s: s.rms(error(s))
        ),
        f"tension{number}_peak_error_N": Metric(
            "N", "largest true tension error since the step", _NOTHING, lambda s: s.peak(error(s))
        ),
        f"tension{number}_final_error_N": Metric(
            "N", "size of the mean true tension error, settled part", _NOTHING, lambda s: s.final(error(s))
        ),
        f"tension{number}_sim_deviation_N": Metric(
            "N",
            "largest deviation of the simulated tension from its set-point since the step",
            _NOTHING,
            lambda s: s.peak(error(s, simulated)),
        ),
        f"tension{number}_sim_error_N": Metric(
            "N",
            "largest deviation of the simulated tension from the true one since the step",
            _NOTHING,
            lambda s: s.peak(s.error(simulated, true)),
        ),
    }


def _disturbance(number: str) -> dict[str, Metric]:
    """Disturbance metrics of the span of that number."""
    true = f"F{number}_true_N"

    def largest_pct(segment: Segment) -> Figure:
        _needs_loop(segment, number)
        tension_N, before_N = segment.get(true), segment.before(true)
        if not before_N > 0.0:
            raise UnknownFigureError(f"{true} is not above 0 before the step")
        return Figure(float(np.max(np.abs(tension_N / before_N - 1.0)) * 100.0))

    what = "largest change of the true tension since the step, of what it was right before it"
    return {f"tension{number}{_DISTURBANCE}": Metric("%", what, _NOTHING, largest_pct)}


def _mass(span: int, shape: Shape) -> dict[str, Metric]:
    """Mass-conservation metrics of a span and the roller before it."""
    command = line_speed(shape).signal
    entering = "strain_prev" if span == 1 else f"strain{shape.numbered(span - 1)}_true"
    signals = (f"x{span}_m", f"x{span + 1}_m", entering, f"strain{shape.numbered(span)}_true")

    def velocities_m_s(segment: Segment) -> tuple[float, float]:
        """Mean velocity of the roller before the span, and what mass conservation asks of it."""
        speed = np.abs(segment.get(command))
        before_m, behind_m, strain_prev, strain = map(segment.get, signals)
        part = segment.settled(strain)
        if speed[part].max() == 0:
            raise UnknownFigureError("the line stands still")
        if np.ptp(speed[part]) > SPEED_BAND * speed[part].max():
            raise UnknownFigureError("the line speed changes")
        t_s = segment.t_s[part]
        behind_m_s = mean_velocity(t_s, behind_m[part])
        if behind_m_s < 0.0:
            raise UnknownFigureError("the line runs in reverse")
        asked_m_s = expected_v1_m_s(behind_m_s, float(np.mean(strain_prev[part])), float(np.mean(strain[part])))
        return mean_velocity(t_s, before_m[part]), asked_m_s

    def deviation(segment: Segment) -> Figure:
        is_m_s, asked_m_s = velocities_m_s(segment)
        return Figure(is_m_s - asked_m_s)

    v, behind = f"v{span}", f"v{span + 1}"
    return {
        f"{v}_final_m_s": Metric(
            "m/s",
            f"mean velocity of roller {span}, settled part of the strain",
            _NOTHING,
            lambda s: Figure(velocities_m_s(s)[0]),
        ),
        f"{v}_expected_m_s": Metric(
            "m/s",
            f"{behind}·(1+ε_prev)/(1+ε), what mass conservation asks of {v}",
            _NOTHING,
            lambda s: Figure(velocities_m_s(s)[1]),
        ),
        f"{v}_deviation_m_s": Metric("m/s", f"{v}_final_m_s minus {v}_expected_m_s", _NOTHING, deviation),
    }


@cache
def metrics_of(shape: Shape) -> MachineMetrics:
    """Metrics of a line, with the number of the span in the names where there are several.

    Of one span all are looked for, whatever is recorded: a run then reports what it lacks.
    """
    if shape.spans < 2:
        shape = SMALLEST
    speed, metrics, together = line_speed(shape), dict[str, Metric](), list[tuple[str, ...]]()
    for span in shape.estimated:
        metrics |= Estimate(modulus(shape.numbered(span)), "line").metrics()
    for span in shape.controlled:
        metrics |= _tension(shape.numbered(span))
    for span in range(1, shape.spans + 1):
        metrics |= _disturbance(shape.numbered(span))
    for span in range(1, shape.spans + 1) if not shape.has_stations else ():
        of_mass = _mass(span, shape)
        metrics |= of_mass
        together.append(tuple(of_mass))
    if not shape.winds:
        metrics |= speed_metrics(speed, f"v{shape.axes}", f"v{shape.axes}_m_s")
    return MachineMetrics(speed, metrics, tuple(together))


def metrics_of_number(number: int) -> Mapping[str, Metric]:
    """Step metrics of the shortest line that has a span of this number, of several."""
    spans = tuple(range(1, max(number, 2) + 1))
    return metrics_of(Shape(len(spans) + 1, (), len(spans), spans, spans)).metrics


def shape_of_figures(names: Iterable[str]) -> Shape:
    """The line whose steps have metrics with these names; a span is estimated or controlled that has them for it."""
    numbers: dict[str, set[int]] = {"E": set(), "tension": set(), "v": set(), _DISTURBANCE: set()}
    for name in names:
        found = _OF_SPAN.match(name)
        if found is not None:
            numbers[_DISTURBANCE if name.endswith(_DISTURBANCE) else found[1]].add(int(found[2] or 1))
    spans = max(numbers[_DISTURBANCE], default=0)
    return Shape(spans + 1, (), spans, tuple(sorted(numbers["E"])), tuple(sorted(numbers["tension"])))
