"""The noise of a recording, from the data itself: how large, and which colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from hilbench.arrays import Array

#: Standard deviations on either side of which 95 % of a normal variable lies.
NORMAL_95: Final = 1.96
#: Order of the autoregressive model of a signal's noise.
ORDER: Final = 24
#: Share of the variance added to it as white noise: keeps the model from trusting a few samples of a smooth signal.
_WHITE_SHARE: Final = 1e-4
#: Sum of the squares of the binomials 1 4 6 4 1, and the median of |x| of a standard normal variable.
_GAIN, _MEDIAN = 70.0, 0.6744897501960817
#: Differences beyond so many standard deviations are no noise.
_CALM = 4.5


def rms(values: Array) -> float:
    """Root of the mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def floor(values: Array) -> float:
    """Standard deviation of the white noise on a signal: from fourth differences, which smooth motion hardly has.

    Where something jumps they are left out; the median alone would round with a quantized signal.
    """
    differences = np.diff(values, 4)
    typical = float(np.median(np.abs(differences))) / _MEDIAN
    calm = differences[np.abs(differences) <= _CALM * typical]
    return float(np.sqrt(np.mean(calm**2) / _GAIN)) if len(calm) else 0.0


@dataclass(frozen=True)
class Whitening:
    """A filter for each signal that makes its noise white, of variance 1."""

    filters: Array  #: (signals, ORDER + 1), or (signals, 1) where noise is white

    def apply(self, values: Array) -> Array:
        """Filter (…, signals, n) along its last axis."""
        out = np.empty_like(values)
        if out.size == 0:
            return out
        for k, taps in enumerate(self.filters):
            if len(taps) == 1:
                out[..., k, :] = taps[0] * values[..., k, :]
                continue
            out[..., k, :] = lfilter(taps, [1.0], values[..., k, :], axis=-1)
        return out


def scaling(deviations: Array) -> Whitening:
    """Whitening of noise that is white already, with these standard deviations (signals,)."""
    return Whitening(1.0 / np.asarray(deviations)[:, None])


def whitening(residuals: Array) -> Whitening:
    """Whitening filters from residuals (signals, n) that hold noise alone, by Yule and Walker's equations."""
    filters = np.zeros((len(residuals), ORDER + 1))
    for k, values in enumerate(residuals):
        values = values - values.mean()
        n = len(values)
        size = 1 << (2 * n - 1).bit_length()
        power = np.abs(np.fft.rfft(values, size)) ** 2
        covariance = np.fft.irfft(power, size)[: ORDER + 1] / n
        covariance[0] *= 1.0 + _WHITE_SHARE
        if covariance[0] <= 0.0:
            filters[k, 0] = 1.0
            continue
        taps = np.concatenate([[1.0], -solve_toeplitz(covariance[:-1], covariance[1:])])
        filters[k] = taps / max(float(np.std(lfilter(taps, [1.0], values)[ORDER:])), 1e-300)
    return Whitening(filters)


def repeats(values: Array) -> float:
    """Number of samples of coloured noise that count as one: 1 + 2·Σρ, up to where the correlation is first lost."""
    values = values - values.mean()
    size = 1 << (2 * len(values) - 1).bit_length()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[: len(values) // 4]
    correlation /= max(float(correlation[0]), 1e-300)
    lost = np.flatnonzero(correlation < 0.0)
    return 1.0 + 2.0 * float(np.sum(correlation[1 : int(lost[0]) if len(lost) else None]))
