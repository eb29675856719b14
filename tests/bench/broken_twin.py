"""A twin whose estimator is broken on purpose: from a moment on E, and the tension of a web of that E, are wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hilbench.twin.machines.web_line import WebLineTwin

#: By how much E is wrong, from the time since it broke (s) and what it would be right (Pa).
Fault = Callable[[float, float], float]
#: Values that a twin of a line shows of a span at which E is found: tension, E, its deviation, torque, residual.
_OF_A_SPAN = 5


@contextmanager
def broken(fault: Fault, first_cycle: int, cycles: int = 1 << 30) -> Iterator[None]:
    """Twins that are started in this process meanwhile: broken from the first of their cycles for so many."""
    published, counted = WebLineTwin.published, dict[int, int]()

    def wrong(twin: WebLineTwin) -> tuple[float, ...]:
        values, cycle = list(published(twin)), counted.get(id(twin), 0)
        counted[id(twin)] = cycle + 1
        if first_cycle <= cycle < first_cycle + cycles:
            for k in range(0, len(values), _OF_A_SPAN):
                factor = fault((cycle - first_cycle) * twin._cycle_s, values[k + 1])
                values[k], values[k + 1] = factor * values[k], factor * values[k + 1]
        return tuple(values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WebLineTwin, "published", wrong)
        # In vectors it would not be asked.
        patch.setattr(WebLineTwin, "runs_in_vectors", property(lambda twin: False))
        yield
