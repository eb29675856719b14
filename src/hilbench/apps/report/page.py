"""Pages from the templates of the apps: one file each, and nothing in it is loaded from elsewhere.

Whatever comes from a file is escaped by the templates; only pictures and scripts of our own are markup. The page's
policy lets no other script run than those that make its pictures interactive on the screen: zoom, cursor and live
values, by uPlot, inside the page. A signal is reduced to the least and the largest value of each stretch of samples, at
full resolution around the steps: no spike is lost. Without a script, and on paper, the drawn pictures are there as
they are.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from hilbench.apps.report.chart import VARIABLES, Band, Curve, Mark
from hilbench.apps.report.plots import ZOOM_AFTER_S, Picture
from hilbench.apps.report.reduce import reduced, reduced_times, stretches
from hilbench.arrays import Array
from hilbench.files import write_whole

#: Values of all signals of a page together; 4 bytes each, a third more as text.
_VALUES: Final = 120_000
_LEAST_POINTS: Final = 1_000
#: What is kept at full resolution around each step, s.
_FINE_BEFORE_S: Final = 0.2
_FINE_AFTER_S: Final = 2.0
_MOST_FINE: Final = 50
#: What a button zooms to around a step, s.
_ZOOM_BEFORE_S: Final = 0.3
#: Buttons for steps; of a run with more the first.
_MOST_BUTTONS: Final = 20
#: Text where there is no number.
DASH: Final = "–"
_POWER: Final = re.compile(r"(?<=\d)e([+-]\d+)")
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass
class _Table:
    """The signals of one time base."""

    t_s: Array
    edges: NDArray[np.int_]
    columns: list[str] = field(default_factory=list)

    def add(self, values: Array) -> int:
        """Its column."""
        self.columns.append(_text(reduced(values, self.edges), "<f4"))
        return len(self.columns) - 1


@dataclass(frozen=True)
class Program:
    """A script of our own (a file of the apps), with its data."""

    file: str
    data: Any

    def markup(self) -> str:
        """Markup at the end of the page."""
        text = json.dumps(self.data, separators=(",", ":"), allow_nan=False)
        inert = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
        programs = "".join(f"<script>{each}</script>\n" for each in scripts(self.file))
        return f'<script type="application/json" id="hilbench-data">{inert}</script>\n{programs}'


@cache
def _read(path: str) -> str:
    return resources.files("hilbench.apps").joinpath(path).read_text(encoding="utf-8")


def scripts(file: str = "report/live.js") -> tuple[str, ...]:
    """The scripts of a page, of pictures or another program: uPlot as it was published, and what draws with it."""
    return tuple(map(_read, ("report/uplot/uPlot.iife.min.js", "report/axes.js", file)))


@cache
def policy(code: tuple[str, ...]) -> str:
    """Content security policy of a page: these scripts run and no others, and nothing is loaded."""
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in code)
    allowed = " ".join(f"'sha256-{text}'" for text in hashes)
    return f"default-src 'none'; style-src 'unsafe-inline'; script-src {allowed}"


def _page_data(pictures: Sequence[Picture], marks: Sequence[Mark]) -> dict[str, Any]:
    charts = [chart for picture in pictures for chart in picture.charts]
    signals = list[Curve | Band](chain.from_iterable((*chart.curves, *chart.bands) for chart in charts))
    bases = {id(signal.t_s): signal.t_s for signal in signals}
    columns = sum(2 if isinstance(signal, Band) else 1 for signal in signals)
    points = max(_LEAST_POINTS, _VALUES // max(columns, 1))
    steps = [mark for mark in marks if mark.number][:_MOST_FINE]
    fine = [(mark.start_s - _FINE_BEFORE_S, mark.end_s + _FINE_AFTER_S) for mark in steps]
    tables = {key: _Table(t_s, stretches(t_s, fine, points)) for key, t_s in bases.items()}
    numbers = {key: number for number, key in enumerate(tables)}

    def shown(each: Curve | Band, values: Mapping[str, Array]) -> dict[str, Any]:
        table = tables[id(each.t_s)]
        columns = {name: table.add(column) for name, column in values.items()}
        return {"table": numbers[id(each.t_s)], **columns, "colour": VARIABLES[each.colour], "alpha": each.alpha}

    plots = [
        {
            "picture": picture.name,
            "y": chart.y_label,
            "least": chart.least,
            "curves": [
                {"label": each.name, "width": each.width, "dash": list(each.dash)}
                | shown(each, {"column": each.values})
                for each in chart.curves
            ],
            "bands": [shown(each, {"low": each.low, "high": each.high}) for each in chart.bands],
        }
        for picture in pictures
        for chart in picture.charts
    ]
    return {
        "tables": [
            {"x": _text(reduced_times(table.t_s, table.edges), "<f8"), "columns": table.columns}
            for table in tables.values()
        ],
        "plots": plots,
        "marks": [
            {"from": mark.start_s, "to": mark.end_s if mark.lasts else mark.start_s}
            | {"text": mark.text, "n": mark.number}
            for mark in marks
        ],
        "zooms": [
            {"text": f"{mark.number}: {mark.text}"}
            | {"from": mark.start_s - _ZOOM_BEFORE_S, "to": mark.end_s + ZOOM_AFTER_S}
            for mark in marks
            if mark.number
        ][:_MOST_BUTTONS],
    }


def _text(values: Array, kind: str) -> str:
    return base64.b64encode(np.asarray(values, kind).tobytes()).decode("ascii")


def write_page(
    path: Path, template: str, zoomable: Sequence[Picture] = (), marks: Sequence[Mark] = (), **data: Any
) -> Path:
    """Write `page_text` to `path`, where the page appears complete or not at all; returns it.

    Raises UnusableInputError if it cannot be written.
    """
    write_whole(path, page_text(template, zoomable, marks, **data))
    return path


def page_text(
    template: str,
    zoomable: Sequence[Picture] = (),
    marks: Sequence[Mark] = (),
    *,
    program: Program | None = None,
    **data: Any,
) -> str:
    """Fill the template ``APP/NAME`` with `data`; the pictures `zoomable`, with their marks, become interactive, and
    `program` runs."""
    shown = [picture for picture in zoomable if picture.charts]
    program = program or Program("report/live.js", _page_data(shown, marks) if shown else None)
    markup, rules = "" if program.data is None else program.markup(), policy(scripts(program.file))
    return filled(template, scripts=markup, policy=rules, **data)


def filled(template: str, **data: Any) -> str:
    """Fill the template ``APP/NAME``."""
    app, name = template.split("/")
    return _templates().get_template(f"{app}/templates/{name}.html.j2").render(**data)


@cache
def _templates() -> Environment:
    environment = Environment(
        loader=PackageLoader("hilbench.apps", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = f"{_read('report/uplot/uPlot.min.css')}\n{_read('report/page.css')}"
    environment.globals.update(style=style, zip=zip)
    environment.filters.update(number=number, quantity=quantity)
    return environment


def quantity(value: float | None, unit: str) -> str:
    """A number with the digits that matter in its unit: what matters of a web's velocity begins at the fifth."""
    return number(value, 7 if unit == "m/s" else 4)


def number(value: float | None, significant: int = 4) -> str:
    """A number for the eye: `significant` digits, but never fewer than before the decimal point."""
    if value is None:
        return DASH
    if value == 0:
        return "0"
    whole = len(str(int(abs(value))))
    return typeset(f"{value:.{max(significant, whole)}g}")


def typeset(text: str) -> str:
    """Numbers in a text as one prints them: powers of ten and a minus sign."""
    powers = _POWER.sub(lambda found: f"·10{str(int(found[1])).translate(_SUPERSCRIPT)}", text)
    return powers.replace("-", "−")
