"""The page of a kind of machine: its live panels, and its drawing as SVG.

In the drawing an element with ``data-part`` is that of a part, and has the state of its drive as a class; the text of
one with ``data-signal`` is the signal's value in ``data-unit``, of ``data-per`` SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hilbench.apps.report.chart import VARIABLES
from hilbench.apps.report.panel import Interval, Panel, Series, panels_of
from hilbench.topology.config import BenchConfig


def live_panels(config: BenchConfig) -> list[Panel]:
    """Panels of the page of a bench, with those of their series whose signals it has."""
    names = {signal.name for signal in config.signals}
    may_be_unknown = config.shape.has_stations
    found = []
    for panel in panels_of(config.machine.kind, config.shape).panels:
        series = [each for each in panel.series if each.signal in names]
        if not may_be_unknown:
            series = [replace(each, deviation="") for each in series if each.estimated]
        bands = [each for each in panel.bands if names.issuperset(filter(None, (each.signal, each.deviation)))]
        if panel.live and series and names.issuperset(panel.needs):
            found.append(replace(panel, series=series, bands=bands))
    return found


def signals_of(panels: Sequence[Panel]) -> list[str]:
    """Signals that panels show, each once."""
    shown = [(each.signal, each.deviation) for panel in panels for each in panel.series]
    shown += [(each.signal, each.deviation) for panel in panels for each in panel.bands]
    return list(dict.fromkeys(name for names in shown for name in names if name))


def panel_data(panel: Panel, config: BenchConfig) -> dict[str, Any]:
    """A panel for the page, with the levels of its limits."""
    limits = getattr(config.safety.limits, panel.limits) if panel.limits else None
    levels = {} if limits is None else {"warning": limits.warning, "trip": limits.trip}
    return {
        **{name: getattr(panel, name) for name in ("name", "title", "unit", "least", "least_share")},
        "scale": panel.si_per_unit,
        "limits": {name: level / panel.si_per_unit for name, level in levels.items() if level is not None},
        "series": [_data(each, "name", "width", "dash", "estimated") for each in panel.series],
        "bands": [_data(each, "share", "alpha") for each in panel.bands],
    }


def _data(shown: Series | Interval, *further: str) -> dict[str, Any]:
    known = {name: getattr(shown, name) for name in ("signal", "deviation", *further)}
    return {**known, "colour": VARIABLES[shown.colour]}
