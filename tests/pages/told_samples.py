"""What a page tells its viewers of the samples, as the browser reads it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def keep(samples: dict[str, list[float]], names: Sequence[str], data: bytes) -> None:
    """Add the highest values of the finest level in a message to the samples of signals with these names."""
    level, _, count, columns = np.frombuffer(data, "<u4", 4)
    values = np.frombuffer(data, "<f4", offset=16 + 8 * int(count)).reshape(2, columns, count)
    if level == 0:
        for name, row in zip(names, values[1], strict=True):
            samples.setdefault(name, []).extend(row)
