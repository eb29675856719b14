"""The rest that a fit leaves, as noise: its spectrum, and what that makes of the errors of the fitted coordinates.

On a real axis something is always left, and it is never white: friction that wanders, a drive's ripple, what the model
lacks. A coordinate is as uncertain as the rest is strong at the frequencies at which its response acts. The spectrum is
estimated in bands, each corrected for what the fit itself has taken out of it (as in restricted maximum likelihood,
Patterson and Thompson 1971); its uncertainty gives the degrees of freedom of each error (Satterthwaite 1946).

How often the intervals hold: tests/diagnosis/test_measured_axis.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, stdtrit

from hilbench.arrays import Array

#: Share of a line of the spectrum that a fit takes at most: of one that it takes whole nothing is known.
_MOST_TAKEN: Final = 0.95
#: Ratio of the upper to the lower edge of a band, and degrees of freedom that a fit has to leave in each.
_WIDTH: Final = 1.5
_LEAST_FREEDOM: Final = 8.0
#: Share of its response that others have to leave of something for a search to see how large it is.
_IDENTIFIABLE: Final = 0.25
#: Size of a column that is none: its square is still a number.
_NOTHING: Final = 1e-150


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of fitted coordinates (J,), with the spectrum of the residual as noise."""

    covariance: Array  #: (J, J)
    freedom: Array  #: (J,) degrees of freedom of each variance

    @property
    def deviations(self) -> Array:
        """Standard deviations (J,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def quantiles(self, probability: float) -> Array:
        """Two-sided quantiles of each coordinate's error, in its standard deviations (J,)."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * probability))

    def chance(self, part: slice, moved: Array) -> float:
        """Probability that coordinates that are neutral are found this far (p,) from there: Wald's statistic."""
        wald = float(moved @ np.linalg.pinv(self.covariance[part, part]) @ moved) / len(moved)
        return float(fdtrc(len(moved), float(np.min(self.freedom[part])), wald))


def uncertainty(
    columns: Array, residual: Array, precision: Array | None = None, least_noise: float = 0.0
) -> Uncertainty:
    """Uncertainty of the coordinates that least squares finds with these columns.

    columns: (J, signals, n), derivatives of the prediction by the coordinates; residual: (signals, n), what the fit
    left; both in the units in which the sum of squares was least. Rows are taken as adjacent in time. precision (J,
    J): inverse prior covariance of the coordinates, where the fit used it; least_noise: least variance of the white
    noise: a fit with many columns takes much of it up at the frequencies at which they act.
    """
    count, signals, n = columns.shape
    if count == 0:
        return Uncertainty(np.empty((0, 0)), np.empty(0))
    flat = columns.reshape(count, -1)
    before = np.zeros((count, count)) if precision is None else precision
    size = np.sqrt(np.maximum(np.einsum("ij,ij->i", flat, flat) + np.diag(before), 1e-300))
    flat, before = flat / size[:, None], before / np.outer(size, size)
    inverse = np.linalg.pinv(flat @ flat.T + before, rcond=1e-12, hermitian=True)
    covariance, squares = inverse @ before @ inverse, np.zeros(count)
    weights = np.full(n // 2 + 1, 2.0 / n)
    weights[0] = 1.0 / n
    if n % 2 == 0:
        weights[-1] = 1.0 / n
    for signal in range(signals):
        spectra = np.fft.rfft(flat.reshape(count, signals, n)[:, signal], axis=-1)
        power = np.abs(np.fft.rfft(residual[signal])) ** 2 * weights
        taken = np.real(np.einsum("jf,jk,kf->f", spectra.conj(), inverse, spectra)) * weights
        free = n * weights - taken
        edges = _edges(free)
        for low, high in pairwise(edges):
            left = max(float(np.sum(free[low:high])), 1.0)
            band = spectra[:, low:high]
            part = inverse @ np.real((band * weights[low:high]) @ band.conj().T) @ inverse
            part *= max(float(np.sum(power[low:high])) / left, least_noise)
            covariance += part
            squares += np.diag(part) ** 2 / left
    freedom = np.diag(covariance) ** 2 / np.maximum(squares, 1e-300)
    return Uncertainty(covariance / np.outer(size, size), np.maximum(freedom, 1.0))


def with_doubts(
    known: Uncertainty, columns: Array, residual: Array, shapes: Array, doubted: NDArray[np.bool_]
) -> Uncertainty:
    """Widen an uncertainty by what the prediction may be off by beside the noise, for some of the coordinates (J,).

    columns, residual: as in `uncertainty`; shapes (K, signals, n): by what it may be off, each to one standard
    deviation before anything was recorded; the estimate of each by the recording, and its certainty, count as well. Of
    a motion that repeats itself, whose rest is lines, each line is a noise of its own.
    """
    count = len(columns)
    wide = np.concatenate([columns, shapes])
    variances = np.maximum(np.diag(uncertainty(wide, residual).covariance), _variances_by_lines(wide, residual))
    moved = _moved(columns, residual, shapes, variances[count:])
    moved[~doubted] = 0.0
    larger = _variances_by_lines(columns, residual) / np.maximum(np.diag(known.covariance), 1e-300)
    wider = np.where(doubted, np.sqrt(np.maximum(larger, 1.0)), 1.0)
    return Uncertainty(known.covariance * np.outer(wider, wider) + moved @ moved.T, known.freedom)


def with_shapes(known: Uncertainty, columns: Array, residual: Array, shapes: Array) -> Uncertainty:
    """Widen an uncertainty by what the prediction may be off by, as far as the recording does not show it."""
    wide = np.concatenate([columns, shapes])
    moved = _moved(columns, residual, shapes, np.diag(uncertainty(wide, residual).covariance)[len(columns) :])
    return Uncertainty(known.covariance + moved @ moved.T, known.freedom)


def _moved(columns: Array, residual: Array, shapes: Array, variance: Array) -> Array:
    """(J, K): by how much each shape, which the recording shows with a variance (K,), moves each coordinate."""
    found = _least_squares(np.concatenate([columns, shapes]), residual.reshape(1, -1))[len(columns) :, 0]
    off = np.sqrt((found / (1.0 + variance)) ** 2 + variance / (1.0 + variance))
    return _least_squares(columns, shapes.reshape(len(shapes), -1)) * off


def with_guess(known: Uncertainty, columns: Array, residual: Array, guess: Array) -> Uncertainty:
    """Widen an uncertainty by a quantity that was taken as known, is a guess, and would hardly be seen if it were
    wrong: the columns nearly make up for it.

    columns, residual: as in `uncertainty`; guess (1, signals, n): what all of it makes. The coordinates are off by what
    they make up of it as far as it is off. The recording shows that, but for what is left: where it is a hand that
    moves the axis, it goes with what the axis does, however long the recording is.
    """
    making_up = _least_squares(columns, guess.reshape(1, -1))
    own = float(np.sum((guess[0] - np.tensordot(making_up[:, 0], columns, 1)) ** 2))
    if own >= _IDENTIFIABLE * float(np.sum(guess**2)):
        return known
    wide = np.concatenate([columns, guess])
    variance = float(uncertainty(wide, residual).covariance[-1, -1])
    found = float(_least_squares(wide, residual.reshape(1, -1))[-1, 0])
    pushed = max(variance, float(np.sum(residual**2)) / max(own, 1e-300))
    moved = making_up * float(np.sqrt((found / (1.0 + variance)) ** 2 + pushed / (1.0 + pushed)))
    return Uncertainty(known.covariance + moved @ moved.T, known.freedom)


def by_waves(columns: Array, residual: Array, shapes: Array, waves: Array) -> Uncertainty:
    """Uncertainty for a periodic motion, whose residual is periodic as well, so that few numbers are left.

    columns (J, n), residual (n,); shapes (K, n): possible errors of the prediction, each to one standard deviation;
    waves (W, n): all that repeats itself as the motion does, each of which may be left as much as any other.
    """
    known, _ = np.linalg.qr(waves.T)
    repeated, left, off = columns @ known, residual @ known, shapes @ known
    freedom = float(max(known.shape[1] - len(columns), 1))
    size, scaled, inverse = _scaled(repeated)
    solving = inverse @ scaled / size[:, None]
    covariance = solving @ (np.eye(known.shape[1]) * float(left @ left) / freedom + off.T @ off) @ solving.T
    return Uncertainty(covariance, np.full(len(columns), freedom))


def with_noisy_columns(
    known: Uncertainty, columns: Array, residual: Array, noisy: Array, explained: Array
) -> Uncertainty:
    """Widen an uncertainty of the last coordinates (J,) of columns, of which the first are measured with noise: it
    pulls their coefficients to zero, and moves those of the others.

    columns (C + J, n), residual (n,); noisy (K, C, n): what a unit of each noise makes of the first columns; explained
    (K, n): of what they explain together. Any share of the residual may be each of the noises: none, all, and what is
    between are as likely.
    """
    size, _, inverse = _scaled(columns)
    count = noisy.shape[1]
    variance = np.sum(residual**2) / np.maximum(np.sum(explained**2, axis=-1), 1e-300)
    together = variance[:, None] * np.einsum("kcn,kn->kc", noisy, explained)
    moved = (inverse[count:, :count] @ (together / size[:count]).T).T / size[count:]
    of_all = np.sum(moved, axis=0)
    shares = (len(noisy) + 1) * (len(noisy) + 2)  # second moments of the uniform distribution over what sums to one
    return Uncertainty(known.covariance + (moved.T @ moved + np.outer(of_all, of_all)) / shares, known.freedom)


def _least_squares(columns: Array, values: Array) -> Array:
    """Coordinates (J, K) of values (K, signals·n) by columns (J, signals, n)."""
    size, scaled, inverse = _scaled(columns.reshape(len(columns), -1))
    return np.asarray(inverse @ (scaled @ values.T) / size[:, None])


def _scaled(columns: Array) -> tuple[Array, Array, Array]:
    """Sizes (J,) of columns (J, n), the columns of size 1 that they are a multiple of, and the inverse of their Gram
    matrix."""
    size = np.maximum(np.linalg.norm(columns, axis=1), _NOTHING)
    scaled = columns / size[:, None]
    return size, scaled, np.linalg.pinv(scaled @ scaled.T, rcond=1e-12, hermitian=True)


def _variances_by_lines(columns: Array, residual: Array) -> Array:
    """(J,): variances of least squares, with what is left at each frequency as the noise there, as if the fit had not
    seen it (MacKinnon and White 1985)."""
    count, _, n = columns.shape
    size, scaled, inverse = _scaled(columns.reshape(count, -1))
    spectra = np.fft.rfft(scaled.reshape(columns.shape), axis=-1)
    weights = np.full(n // 2 + 1, 2.0 / n)
    weights[0] = 1.0 / n
    taken = 0.5 * n * weights * np.real(np.einsum("jsf,jk,ksf->sf", spectra.conj(), inverse, spectra)) * weights
    noise = np.abs(np.fft.rfft(residual, axis=-1)) ** 2 / n / (1.0 - np.minimum(taken, _MOST_TAKEN)) ** 2
    middle = np.real(np.einsum("jsf,sf,ksf->jk", spectra, noise * weights, spectra.conj()))
    return np.asarray(np.diag(inverse @ middle @ inverse) / size**2)


def _edges(free: Array) -> list[int]:
    """Edges of bands over the bins of a spectrum, from how many degrees of freedom (bins,) the fit has left in each."""
    edges, total = [0], np.concatenate([[0.0], np.cumsum(free)])
    while edges[-1] < len(free):
        first = edges[-1]
        enough = int(np.searchsorted(total, total[first] + _LEAST_FREEDOM))
        edges.append(max(enough, int(_WIDTH * first), first + 1))
    edges[-1] = len(free)
    if len(edges) > 2 and total[-1] - total[edges[-2]] < _LEAST_FREEDOM:
        del edges[-2]
    return edges
