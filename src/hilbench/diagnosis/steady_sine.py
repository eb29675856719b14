"""Detection of a motion that is one steady sine, and its components that repeat or go with the position."""

from __future__ import annotations

from typing import Final

import numpy as np

from hilbench.arrays import Array

#: Share of the speed's square that a sine has to explain; of a triangle the best one explains 0.986.
_PURE: Final = 0.995
#: Finer than the lines of the spectrum by, and tries between two of these.
_FINER, _BETWEEN = 8, 9
#: Waves over a stroke that a torque that goes with the position consists of.
_WAVES: Final = 5


def frequency_of_sine(speed: Array, period_s: float) -> float | None:
    """Frequency of a speed (n,), at this row period, that is one sine about standstill, Hz; None of any other."""
    n = len(speed)
    t_s = np.linspace(0.0, period_s * (n - 1), n)
    spectrum = np.abs(np.fft.rfft(speed * np.hanning(n), _FINER * n))
    step_Hz = 1.0 / (_FINER * n * period_s)
    peak = int(np.argmax(spectrum))
    if peak < 2 * _FINER:  # the window alone is as wide: a speed that hardly changes
        return None
    tried = [step_Hz * (peak + part / _BETWEEN) for part in range(-_BETWEEN, _BETWEEN + 1)]
    left = [_left_by_a_sine(speed, t_s, frequency_Hz) for frequency_Hz in tried]
    if min(left) >= (1.0 - _PURE) * float(np.sum(speed**2)):
        return None
    return tried[int(np.argmin(left))]


def _left_by_a_sine(values: Array, t_s: Array, frequency_Hz: float) -> float:
    """Sum of squares of values (n,) that a sine of this frequency leaves."""
    columns: Array = np.exp(2j * np.pi * frequency_Hz * t_s).view(np.float64).reshape(-1, 2)
    theta, *_ = np.linalg.lstsq(columns, values, rcond=None)
    return float(np.sum((values - columns @ theta) ** 2))


def evenly_with(position: Array) -> Array:
    """(waves, n): what goes with a position (n,) that oscillates about its middle, and is the same on both sides of it;
    what is not the same goes with the acceleration, as an inertia does, or changes its sign as friction does."""
    low, high = float(np.min(position)), float(np.max(position))
    angle = np.arccos(np.clip((2.0 * position - low - high) / max(high - low, 1e-300), -1.0, 1.0))
    return np.asarray(np.cos(2.0 * np.outer(np.arange(_WAVES), angle)))


def harmonics(frequency_Hz: float, highest_Hz: float, t_s: Array) -> Array:
    """(1 + 2·H, n): all that repeats itself so often, up to a frequency, at times (n,)."""
    turned = 2.0 * np.pi * np.outer(frequency_Hz * np.arange(1, int(highest_Hz / frequency_Hz) + 1), t_s)
    return np.concatenate([np.ones((1, len(t_s))), np.cos(turned), np.sin(turned)])
