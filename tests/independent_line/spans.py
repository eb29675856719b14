"""The independent line with several spans: pieces of web that wander from one span into the next.

    line = LineOfSpans(lengths_m=(1.2, 2.5, 1.8), hidden=[effect("splice", time_s=9.0, relative_change=0.3)])
    line.record("identification", seed=1).channels["tau3_Nm"]

An effect of a span says which (`at_span`); without, it is in all of them. Each span is the queue of pieces of
`tests.independent_line.physics`, and what leaves one is laid into the next with its own compliance: a splice passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.independent_line.line import PROFILES, Courses, Hidden, Line, Loops, Record

Array = NDArray[np.float64]


def at_span(item: Hidden, span: int | None) -> Hidden:
    """An effect in one span (None: in all of them)."""
    return {**item, "span": span}


def of_drives(kp: tuple[float, ...], ki: tuple[float, ...], lag_s: tuple[float, ...]) -> Loops:
    """Loops of as many drives, each sampled every millisecond and told at once."""
    return Loops(kp, ki, lag_s, (1e-3,) * len(kp), (0.0,) * len(kp))


@dataclass(frozen=True)
class LineOfSpans(Line):
    """A line of as many driven rollers as spans and one."""

    lengths_m: Sequence[float] = (1.2, 2.5, 1.8)
    loops: Loops = field(default_factory=lambda: of_drives((1.0,) * 4, (1.0,) * 4, (1e-3,) * 4))

    @property
    def rollers(self) -> int:
        """Driven ones."""
        return len(self.lengths_m) + 1

    @property
    def model(self) -> dict[str, Any]:
        """What a model file knows of this line."""
        known = super().model
        return {**known, "web": {**known["web"], "span_length_m": list(self.lengths_m)}}

    def record(self, profile: str = "identification", seed: int = 0, duration_s: float | None = None) -> Record:
        """Run a profile from rest, each tension with set points and a controller of its own."""
        duration_s = PROFILES[profile] if duration_s is None else duration_s
        rng = np.random.default_rng([seed, 17])
        each = [self._experiment(profile, duration_s, rng) for _ in self.lengths_m]
        of_spans = [np.array([one[k] for one in each]) for k in (1, 2, 3)]
        return self._run(each[-1]._replace(**dict(zip(Courses._fields[1:4], of_spans, strict=True))), rng)

    @property
    def _numbers(self) -> Sequence[str]:
        return [str(span) for span in range(1, self.rollers)]

    def _webs(self) -> Array:
        return np.array([self._of_span(span) for span in range(1, self.rollers)])

    def _noise(self, rng: np.random.Generator, rows: int) -> Array:
        return rng.standard_normal((self.rollers, 3, rows)).swapaxes(0, 1)

    def _of_span(self, span: int) -> Array:
        """What `physics` knows of a web, for one span."""
        here = [
            {key: value for key, value in item.items() if key != "span"}
            for item in self.hidden
            if item.get("span") in (None, span)
        ]
        return replace(self, length_m=self.lengths_m[span - 1], hidden=here)._web()
