"""Panel of a machine's page: plots of signals over time, and the drawing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from hilbench.apps.report.chart import VARIABLES
from hilbench.topology.safety import Limit


@dataclass(frozen=True)
class Trace:
    """One signal in a plot: its name beside it, and how it is drawn; of a noisy one the area between its extremes.

    `deviation`: the signal of its standard deviation where it is shown only while that is a number (`told`), or only
    while it is infinite.
    """

    signal: str
    name: str
    colour: str
    width: float = 1.4
    dash: tuple[float, ...] = ()
    deviation: str = ""
    told: bool = True


@dataclass(frozen=True)
class Spread:
    """A band of two standard deviations around a signal."""

    signal: str
    deviation: str
    colour: str


@dataclass(frozen=True)
class Plot:
    """One set of axes over time, in a unit of so many SI units; `least`: the height that is shown at least, in it."""

    name: str
    title: str
    unit: str
    traces: Sequence[Trace]
    spreads: Sequence[Spread] = ()
    si_per_unit: float = 1.0
    least: float = 0.0
    limits: Limit | None = None

    @property
    def signals(self) -> Iterator[str]:
        """All that it needs."""
        yield from (trace.signal for trace in self.traces)
        yield from (trace.deviation for trace in self.traces if trace.deviation)
        yield from (spread.deviation for spread in self.spreads)

    def as_data(self) -> dict[str, Any]:
        """For the page."""
        levels = {} if self.limits is None else {"warning": self.limits.warning, "trip": self.limits.trip}
        return {
            "name": self.name,
            "title": self.title,
            "unit": self.unit,
            "scale": self.si_per_unit,
            "least": self.least,
            "limits": {name: level / self.si_per_unit for name, level in levels.items() if level is not None},
            "traces": [
                {
                    "signal": trace.signal,
                    "name": trace.name,
                    "colour": VARIABLES[trace.colour],
                    "width": trace.width,
                    "dash": list(trace.dash),
                    "deviation": trace.deviation,
                    "told": trace.told,
                }
                for trace in self.traces
            ],
            "spreads": [
                {"signal": spread.signal, "deviation": spread.deviation, "colour": VARIABLES[spread.colour]}
                for spread in self.spreads
            ],
        }


@dataclass(frozen=True)
class Panel:
    """Panel of one machine: its plots, and its drawing as SVG.

    In the drawing an element with ``data-part`` is that of a part, and has the state of its drive as a class; the text
    of one with ``data-signal`` is the signal's value in ``data-unit``, of ``data-per`` SI units.
    """

    plots: Sequence[Plot]
    drawing: str = field(repr=False)
    further: Sequence[str] = ()  #: signals that only the drawing shows

    @property
    def signals(self) -> list[str]:
        """All that is shown, each once."""
        plotted = (signal for plot in self.plots for signal in plot.signals)
        return list(dict.fromkeys([*plotted, *self.further]))
