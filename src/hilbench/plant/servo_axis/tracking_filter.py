"""Motion observer from positions alone: position, speed, acceleration and jerk of a shaft.

An observer of a shaft with constant jerk between two samples, its four poles at exp(-T/T_f): its estimate of a motion
with constant jerk has no lag, whatever T_f is; T_f trades noise against how fast the jerk may change.
"""

from __future__ import annotations

from functools import lru_cache
from math import exp, factorial

import numpy as np

from hilbench.compiled import Vector
from hilbench.plant.web_line.shaft_load import follow

#: Position, speed, acceleration, jerk.
ORDER = 4


@lru_cache(64)
def transition(duration_s: float) -> Vector:
    """Transition matrix (4, 4) of the motion over `duration_s`, with constant jerk."""
    rows = range(ORDER)
    return np.array([[duration_s ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in rows] for i in rows])


@lru_cache(64)
def gains(duration_s: float, filter_s: float) -> Vector:
    """Observer gains (4,) from the deviation of a position to the motion.

    The fading-memory filter of third degree (N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969),
    with four equal poles.
    """
    pole = exp(-duration_s / filter_s)
    left = 1.0 - pole
    return np.array(
        [
            1.0 - pole**4,
            left**2 * (11.0 + 14.0 * pole + 11.0 * pole**2) / (6.0 * duration_s),
            2.0 * left**3 * (1.0 + pole) / duration_s**2,
            left**4 / duration_s**3,
        ]
    )


class TrackingFilter:
    """Observer of a shaft's motion; `motion` (4,): rad, rad/s, rad/s², rad/s³."""

    def __init__(self, filter_s: float) -> None:
        self.motion: Vector = np.zeros(ORDER)
        self.filter_s = filter_s

    def reset(self, position_rad: float, speed_rad_s: float = 0.0) -> None:
        """Reset to this position, with constant speed."""
        self.motion[:] = position_rad, speed_rad_s, 0.0, 0.0

    def update(self, position_rad: float, duration_s: float) -> None:
        """Update by a position, `duration_s` after the previous one."""
        follow(self.motion, transition(duration_s), gains(duration_s, self.filter_s), position_rad)
