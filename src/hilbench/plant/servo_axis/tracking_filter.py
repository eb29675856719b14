"""Motion from positions alone: position, speed, acceleration and jerk of a shaft, for what has to follow from them.

An observer of a shaft with constant jerk between two samples, its four poles at exp(-T/T_f): what it says of a motion
with constant jerk has no lag, whatever T_f is; T_f trades noise against how fast the jerk may change.
"""

from __future__ import annotations

from functools import lru_cache
from math import exp, factorial

import numpy as np

from hilbench.plant.servo_axis.layout import Vector

#: Position, speed, acceleration, jerk.
ORDER = 4


@lru_cache(64)
def transition(duration_s: float) -> Vector:
    """(4, 4): the motion `duration_s` later, with constant jerk."""
    rows = range(ORDER)
    return np.array([[duration_s ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in rows] for i in rows])


@lru_cache(64)
def gains(duration_s: float, filter_s: float) -> Vector:
    """(4,): how much of the deviation of a position goes into the motion.

    The fading-memory filter of third degree (N. Morrison, Introduction to Sequential Smoothing and Prediction, 1969),
    whose four poles are all where they are wanted.
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
    """The observer; `motion` (4,) is what it says: rad, rad/s, rad/s², rad/s³."""

    def __init__(self, filter_s: float) -> None:
        self.motion: Vector = np.zeros(ORDER)
        self._filter_s = filter_s

    def reset(self, position_rad: float, speed_rad_s: float = 0.0) -> None:
        """At this position, with this even speed."""
        self.motion = np.array([position_rad, speed_rad_s, 0.0, 0.0])

    def update(self, position_rad: float, duration_s: float) -> None:
        """The shaft is at `position_rad`, `duration_s` after the last."""
        ahead = transition(duration_s) @ self.motion
        self.motion = ahead + gains(duration_s, self._filter_s) * (position_rad - ahead[0])

    def predicted(self, lead_s: float) -> Vector:
        """(4,): the motion `lead_s` later, with constant jerk."""
        return np.asarray(transition(lead_s) @ self.motion)
