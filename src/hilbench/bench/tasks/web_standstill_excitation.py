"""Standstill excitation: a small movement of a line at rest that makes E and strain of unknown webs identifiable.

All rollers go forth and back together, so that dry friction acts in a known direction, and in addition pull
apart and release: where a drive holds its roller softly, it hardly moves by that, and the tensions of all spans go up
and down. `JointInitialization` of the twin separates the two for each span. No roller is further from its start
than the permitted travel, even where no web holds any.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, nan, pi
from typing import Any

import numpy as np

from hilbench.arrays import Array
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.sample import CycleSample

#: Of forth, and of back; of the change of speed in between.
_HALF_S, _EDGE_S = 0.4, 0.04
#: In which the pull goes from one size to the other, as the rollers turn back: evenly, or the webs would swing.
_PULL_S = 0.16
#: Shares of the permitted travel: amplitude of the joint movement to either side of the rollers'
#: start, and of the pull to either side, at most. The rest is for swings.
_FORTH, _PULL = 0.48, 0.62
#: Change of the tension either way, as a share of its set-point, with E as in the model.
_TENSION = 0.15

Positions = Callable[[CycleSample], Sequence[float]]


def _goal(half: float) -> float:
    """Pull in a half period: its sign changes as the rollers turn back for every other time."""
    if half < 0:
        return 0.0
    return -1.0 if half % 4 in (0, 3) else 1.0


def excitation_amplitudes_m(model: ModelParameters, set_points_N: Sequence[float], travel_m: float) -> Array:
    """Amplitude of each roller (N,) for the change of the tensions, or as much of it as the
    permitted travel allows; `set_points_N`: of the spans (N - 1,).

    The web of each span gets longer by its additional pull, and a roller gives way by what its drive's loop
    allows where the webs on its two sides pull differently. Where there is room the rollers then hardly move.
    """
    changes_N = _TENSION * np.asarray(set_points_N, np.float64)
    longer_m = [model.span_length_m(k) / model.stiffness_N(k) * dF for k, dF in enumerate(changes_N.tolist(), 1)]
    pulled_N = np.append(changes_N, 0.0) - np.insert(changes_N, 0, 0.0)  # forwards
    gives_way_m = [
        pulled / model.drive_stiffness_N_per_m(axis) if model.carries_web_load(axis) else 0.0
        for axis, pulled in enumerate(pulled_N.tolist(), 1)
    ]
    move_m = np.insert(np.cumsum(longer_m), 0, 0.0)
    known_m, most_m = move_m - gives_way_m, _PULL * travel_m
    least_m, largest_m = float(known_m.min()), float(known_m.max())
    if largest_m - least_m > 2.0 * most_m:
        return np.asarray(2.0 * most_m / (largest_m - least_m) * (known_m - 0.5 * (least_m + largest_m)), np.float64)
    return np.asarray(known_m - min(max(0.5 * move_m[-1], largest_m - most_m), least_m + most_m), np.float64)


class StandstillExcitation:
    """Runs one movement after the other; `positions_m` reads the positions of the axes at the web of a sample;
    `pulled_m` (N,): additional displacement of each for the highest tensions (`excitation_amplitudes_m`).

    It sets `creep_m_s` of `leader`, which all axes follow, and `pull_m_s` of each of the `axes` (N,) alone, nan while
    there is no movement: records of what is added to their speeds.
    """

    def __init__(
        self,
        leader: Any,
        axes: Sequence[Any],
        positions_m: Positions,
        travel_m: float,
        pulled_m: Array,
        cycle_s: float,
    ) -> None:
        self.travel_m = travel_m
        self._leader = leader
        self._axes = tuple(axes)
        self._positions_m = positions_m
        self._pulled_m = pulled_m.tolist()
        self._cycle_s = cycle_s
        self._stood_m: Sequence[float] = ()
        self._cycles = 0
        self._pull = 0.0  # present share of it

    def begin(self, sample: CycleSample) -> None:
        """Begin at the rollers' present positions."""
        self._stood_m = self._positions_m(sample)
        self._cycles, self._pull = 0, 0.0

    def is_beyond(self, sample: CycleSample) -> bool:
        """True if a roller is further from its start than permitted."""
        now_m = self._positions_m(sample)
        return max(abs(now - then) for now, then in zip(now_m, self._stood_m, strict=True)) > self.travel_m

    def go_on(self) -> None:
        """Speeds of the next cycle."""
        elapsed_s = self._cycles * self._cycle_s
        half, within_s = divmod(elapsed_s + 0.5 * _HALF_S, _HALF_S)  # from the middle of forth on
        since_s = elapsed_s if half == 0 else within_s
        self._cycles += 1
        speed_m_s = _FORTH * self.travel_m / (_HALF_S - _EDGE_S)
        share = min(1.0, min(since_s, _HALF_S - within_s) / _EDGE_S)
        self._leader.creep_m_s = speed_m_s * share * (1.0 if half % 2 == 0 else -1.0)
        before, goal = _goal(half - 1), _goal(half)
        pull = before + (goal - before) * 0.5 * (1.0 - cos(pi * min(1.0, since_s / _PULL_S)))
        step, self._pull = pull - self._pull, pull
        for axis, pulled_m in zip(self._axes, self._pulled_m, strict=True):
            axis.pull_m_s = step * pulled_m / self._cycle_s

    def end(self) -> None:
        """Stop the movement."""
        self._leader.creep_m_s = 0.0
        for axis in self._axes:
            axis.pull_m_s = nan
