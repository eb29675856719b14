"""Motion from sampled, noisy measurements: position, speed and acceleration without what is above a band.

Everything is done to the spectrum, where differentiation is exact up to the end of the band, whatever the sampling
period, and a finer grid costs nothing. And whether a motion is one steady sine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import upfirdn

from hilbench.arrays import Array, Rows

#: Length of a root-raised-cosine filter to either side, in rows that it leaves, and its roll-off.
_HALF_LENGTH = 10
ROLL_OFF = 0.2
#: What is slower than this, s, is not looked at where it would add up without end, or an offset be taken for a gain.
_WINDOW_S: Final = 2.0
#: Share of the speed's square that a sine has to explain; of a triangle the best one explains 0.986.
_PURE: Final = 0.995
#: Finer than the lines of the spectrum by, and tries between two of these.
_FINER, _BETWEEN = 8, 9
#: Waves over a stroke that a torque that goes with the position consists of.
_WAVES: Final = 5


def smoothed(values: Array, period_s: float, whole: int, band_Hz: tuple[float, float], order: int) -> list[Array]:
    """A measurement and its first `order` derivatives, on a grid `whole` times finer: ((n - 1)·whole + 1,) each.

    values (n,), a row every `period_s`. Up to the first of `band_Hz` nothing is lost, beyond the second nothing is
    left. Beyond its ends the measurement goes on point-symmetrically: value and slope are continuous there, the second
    derivative is not, and within some periods of the band's end near them it is not to be trusted.
    """
    n = len(values)
    duration = (n - 1) * period_s
    slope = (values[-1] - values[0]) / duration
    rest = values - values[0] - slope * period_s * np.arange(n)
    spectrum = np.fft.rfft(np.concatenate([rest, -rest[-2:0:-1]]))
    frequency = np.arange(len(spectrum)) / (2.0 * duration)
    spectrum = spectrum * _passed(frequency, band_Hz)
    fine = (n - 1) * whole + 1
    found = []
    for k in range(order + 1):
        of = spectrum * (2j * np.pi * frequency) ** k
        found.append(whole * np.fft.irfft(of, 2 * (fine - 1))[:fine])
    at = duration * np.linspace(0.0, 1.0, fine)
    found[0] += values[0] + slope * at
    if order > 0:
        found[1] += slope
    return found


def low_passed(values: Array, period_s: float, band_Hz: tuple[float, float]) -> Array:
    """Signals (…, n), a row every `period_s`, without what is above a band; as `smoothed`, even about their ends."""
    spectrum = np.fft.rfft(np.concatenate([values, values[..., -2:0:-1]], axis=-1))
    frequency = np.arange(spectrum.shape[-1]) / (2.0 * (values.shape[-1] - 1) * period_s)
    spectrum *= _passed(frequency, band_Hz)
    return np.asarray(np.fft.irfft(spectrum, 2 * (values.shape[-1] - 1))[..., : values.shape[-1]])


def _passed(frequency: Array, band_Hz: tuple[float, float]) -> Array:
    """Gain of the filter: 1 up to the first of `band_Hz`, 0 beyond the second."""
    low, high = band_Hz
    share = np.clip((frequency - low) / max(high - low, 1e-9), 0.0, 1.0)
    return np.asarray(np.cos(0.5 * np.pi * share) ** 2)


def without_slow(rows: Rows, row_s: float) -> Callable[[Array], Array]:
    """Function that takes what is slower than `_WINDOW_S` out of signals (…, n), by the rows that count (n,)."""
    window, weight = max(3, round(_WINDOW_S / row_s)), rows.astype(np.float64)
    share = np.maximum(uniform_filter1d(weight, window, mode="constant"), 1.0 / window)
    return lambda values: np.asarray(values - uniform_filter1d(values * weight, window, mode="constant") / share)


@dataclass(frozen=True)
class Thinning:
    """Low-pass and every so many rows of a signal, so that white noise stays white and of known size.

    A root-raised-cosine filter of half the rate of what is left: its squared magnitude folds to a constant.
    """

    every: int  #: rows of the recording per row that is left; with 1 nothing is done
    period_s: float  #: of the recording

    @property
    def corner_Hz(self) -> float:
        """Half the rate of the rows that are left."""
        return 0.5 / (self.every * self.period_s)

    @property
    def highest_Hz(self) -> float:
        """Above it nothing passes."""
        return self.corner_Hz * ((1.0 + ROLL_OFF) if self.every > 1 else 1.0)

    @property
    def reach_s(self) -> float:
        """Time before and after a row that its value depends on, s."""
        return _HALF_LENGTH * self.every * self.period_s if self.every > 1 else 0.0

    @property
    def noise_share(self) -> float:
        """Standard deviation of what white noise leaves, per that of the noise."""
        return float(np.sqrt(1.0 / self.every))

    def _taps(self, down: int) -> Array:
        t = np.arange(-_HALF_LENGTH * down, _HALF_LENGTH * down + 1) / down  # in rows that are left
        b = ROLL_OFF
        with np.errstate(divide="ignore", invalid="ignore"):
            taps = (np.sin(np.pi * t * (1.0 - b)) + 4.0 * b * t * np.cos(np.pi * t * (1.0 + b))) / (
                np.pi * t * (1.0 - (4.0 * b * t) ** 2)
            )
        taps[t == 0.0] = 1.0 - b + 4.0 * b / np.pi
        edge = np.abs(np.abs(t) - 0.25 / b) < 1e-9
        taps[edge] = (b / np.sqrt(2.0)) * (
            (1.0 + 2.0 / np.pi) * np.sin(0.25 * np.pi / b) + (1.0 - 2.0 / np.pi) * np.cos(0.25 * np.pi / b)
        )
        taps *= np.kaiser(len(taps), 3.0)
        return np.asarray(taps / np.sum(taps), np.float64)

    def apply(self, values: Array, whole: int = 1) -> Array:
        """(…, (n - 1)·whole + 1) to (…, rows that are left): a signal on a grid `whole` times that of the recording."""
        down = self.every * whole
        if self.every == 1:
            return np.asarray(values[..., ::down])
        half, count = _HALF_LENGTH * down, -(-values.shape[-1] // down)
        padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(half, half + down)], mode="edge")
        filtered = upfirdn(self._taps(down), padded, 1, down)
        return np.asarray(filtered[..., 2 * _HALF_LENGTH : 2 * _HALF_LENGTH + count])


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
