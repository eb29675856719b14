"""Time in whole samples of the drives, and simulations shared out among the cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise

import numpy as np

#: Share of a sample time by which a duration may miss a multiple of it.
_WHOLE = 1e-6


@lru_cache(64)
def samples_per(duration_s: float, sample_time_s: float) -> int:
    """Number of drive samples in a duration. Raises ValueError unless it is a whole, positive number."""
    samples = round(duration_s / sample_time_s)
    if samples < 1 or abs(samples * sample_time_s - duration_s) > _WHOLE * sample_time_s:
        raise ValueError(f"{duration_s!r} s, expected a multiple of the drives' sample time {sample_time_s!r} s")
    return samples


def locked_sample_time_s(duration_s: float, sample_time_s: float) -> float:
    """Nearest sample time of which a duration is a multiple, as of loops that lock to a cycle."""
    samples = max(1, round(duration_s / sample_time_s))
    whole = abs(samples * sample_time_s - duration_s) <= _WHOLE * sample_time_s
    return sample_time_s if whole else duration_s / samples


def on_all_cores(run: Callable[[slice], None], count: int) -> None:
    """Call `run` with slices of `count` items, one for each core; it has to release the GIL."""
    workers = min(len(os.sched_getaffinity(0)), count)
    shares = [slice(*edges) for edges in pairwise(np.linspace(0, count, workers + 1, dtype=int))]
    if len(shares) == 1:
        run(shares[0])
    else:
        with ThreadPoolExecutor(len(shares)) as pool:
            list(pool.map(run, shares))
