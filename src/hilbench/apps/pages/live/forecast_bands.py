"""Courses to come, as a page draws them: bands of what may become of tensions and torques."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hilbench.apps.monitor.changes import SHOWN_UNITS
from hilbench.prediction.outlook import Outlook

#: Points of a course at most; each stands for a stretch, and has the least and largest value in it.
_MOST_POINTS: Final = 120
_DIGITS: Final = 5


def courses(outlook: Outlook) -> list[dict[str, Any]]:
    """Band of nine measurements in ten of each tension (N) and torque (N·m), its middle, and levels; `t_s`: from
    now."""
    t_s = outlook.times_s - outlook.now_s
    edges = np.linspace(0, len(t_s), min(len(t_s), _MOST_POINTS), endpoint=False).astype(int)
    shown = []
    for place, watched in enumerate(outlook.watched):
        if watched.unit not in SHOWN_UNITS:
            continue
        low, median, high = outlook.band(place)
        shown.append(
            {
                "name": watched.name,
                "unit": watched.unit,
                "levels": {"warning": watched.warning, "trip": watched.trip},
                "t_s": _rounded(t_s[edges]),
                "low": _rounded(np.minimum.reduceat(low, edges)),
                "median": _rounded(median[edges]),
                "high": _rounded(np.maximum.reduceat(high, edges)),
            }
        )
    return shown


def _rounded(values: np.ndarray[Any, Any]) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]
