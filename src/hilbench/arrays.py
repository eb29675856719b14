"""Types of NumPy arrays by what annotations call them; those of compiled functions are in `hilbench.compiled`. Runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  #: of any shape
Vector = NDArray[np.float64]  #: (n,)
Matrix = NDArray[np.float64]  #: (n, m)
Rows = NDArray[np.bool_]  #: (n,): which rows


def runs(rows: Rows) -> NDArray[np.int64]:
    """(runs, 2): first of the rows that follow one another, and the one after the last."""
    return np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]))).reshape(-1, 2)
