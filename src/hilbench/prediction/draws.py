"""Random draws for futures: standard normal numbers that cover the whole distribution, however few they are."""

from __future__ import annotations

from functools import cache
from statistics import NormalDist

import numpy as np

from hilbench.arrays import Array


def normal_draws(futures: int, quantities: int, *key: int) -> Array:
    """Standard normal numbers (futures, quantities), the same for the same key.

    A Latin hypercube: each quantity has one number out of each of so many equally probable parts (McKay, Beckman,
    Conover, Technometrics 21(2), 1979), so that a mean or a share of few futures is nearer to that of very many.
    """
    random = np.random.default_rng(key)
    quantiles = _quantiles(futures)
    return np.stack([random.permutation(quantiles) for _ in range(quantities)], axis=1)


@cache
def _quantiles(count: int) -> Array:
    normal = NormalDist()
    return np.array([normal.inv_cdf((place + 0.5) / count) for place in range(count)])
