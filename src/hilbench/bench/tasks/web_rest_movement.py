"""A small movement of a line of one span at rest, which shows E and strain of a web that nothing is known of.

Both rollers go forth and back together, so that dry friction goes with a direction that is known, and the one behind
the span pulls more and less beside that: where its drive holds it softly, it hardly moves by that, and the tension goes
up and down. `FoundRunning` of the twin tells the two apart. Nobody is further from where it stood than the way that
is permitted, even where no web holds anybody.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

#: Of forth, and of back; of the change of speed in between.
_HALF_S, _EDGE_S = 0.4, 0.04
#: In which the pull goes from one size to the other, amidst forth and back.
_PULL_S = 0.2
#: Shares of the permitted way that are asked for: of going forth, and of the pull to either side, at most.
_FORTH, _PULL = 0.48, 0.48
#: Change of the tension either way, as a share of its set-point, with E as in the model.
_TENSION = 0.15

Positions = Callable[[CycleSample], tuple[float, float]]


class MovedAxis(Protocol):
    """The axis behind the span, whom the one before it follows."""

    creep_m_s: float  #: of both
    pull_m_s: float  #: of this one alone


def pull_m(model: ModelParameters, set_point_N: float) -> float:
    """By how much the roller behind the span is told to go further for the change of the tension; it gives way by what
    its drive's loop allows, as that before the span does where the web pulls it."""
    gives_way = sum(1.0 / model.drive_stiffness_N_per_m(axis) for axis in (1, 2) if model.carries_web_load(axis))
    return _TENSION * set_point_N * (model.span_length_m(1) / model.stiffness_N(1) + gives_way)


class RestMovement:
    """One movement after the other; `positions_m`: of both rollers at the web, in a sample."""

    def __init__(self, axis: MovedAxis, positions_m: Positions, way_m: float, pulled_m: float, cycle_s: float) -> None:
        self.way_m = way_m
        self._axis = axis
        self._positions_m = positions_m
        self._pulled_m = min(pulled_m, _PULL * way_m)
        self._cycle_s = cycle_s
        self._stood_m: tuple[float, float] = (0.0, 0.0)
        self._cycles = 0
        self._pull_m = 0.0

    def begin(self, sample: CycleSample) -> None:
        """From where the rollers stand."""
        self._stood_m = self._positions_m(sample)
        self._cycles, self._pull_m = 0, 0.0

    def is_beyond(self, sample: CycleSample) -> bool:
        """Whether a roller is further from where it stood than is permitted."""
        now_m = self._positions_m(sample)
        return max(abs(now - then) for now, then in zip(now_m, self._stood_m, strict=True)) > self.way_m

    def go_on(self) -> None:
        """Speeds of the next cycle."""
        half, within_s = divmod(self._cycles * self._cycle_s, _HALF_S)
        self._cycles += 1
        speed_m_s = _FORTH * self.way_m / (_HALF_S - _EDGE_S)
        share = min(1.0, min(within_s, _HALF_S - within_s) / _EDGE_S)
        self._axis.creep_m_s = speed_m_s * share * (1.0 if half % 2 == 0 else -1.0)
        more = (half % 2 == 0) == (within_s >= 0.5 * _HALF_S)  # more in the second part of forth, the first of back
        first = half == 0 and not more  # from where it stood it first pulls more
        goal_m = 0.0 if first else self._pulled_m if more else -self._pulled_m
        most_m = 2.0 * self._pulled_m * self._cycle_s / _PULL_S
        step_m = min(max(goal_m - self._pull_m, -most_m), most_m)
        self._pull_m += step_m
        self._axis.pull_m_s = step_m / self._cycle_s

    def end(self) -> None:
        """Stand."""
        self._axis.creep_m_s = self._axis.pull_m_s = 0.0
