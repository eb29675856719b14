"""Pages from the templates of the apps: one file each, and nothing in it is loaded from elsewhere.

Whatever comes from a file is escaped by the templates; only pictures and scripts of our own are markup. The page's
policy lets no other script run than those that make its pictures interactive.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from hilbench.apps.report.chart import Mark
from hilbench.apps.report.live import Program, interactive, policy, style
from hilbench.apps.report.live import scripts as reading_scripts
from hilbench.apps.report.plots import Picture
from hilbench.files import write_whole

#: What stands where there is no number.
DASH: Final = "–"
_POWER: Final = re.compile(r"(?<=\d)e([+-]\d+)")
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


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
    scripts = program.markup() if program else interactive(zoomable, marks)
    rules = policy(program.scripts() if program else reading_scripts())
    app, name = template.split("/")
    return _templates().get_template(f"{app}/templates/{name}.html.j2").render(scripts=scripts, policy=rules, **data)


@cache
def _templates() -> Environment:
    environment = Environment(
        loader=PackageLoader("hilbench.apps", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    own = resources.files("hilbench.apps").joinpath("report", "page.css").read_text(encoding="utf-8")
    environment.globals.update(style=f"{style()}\n{own}", zip=zip)
    environment.filters.update(number=number, quantity=quantity)
    return environment


def quantity(value: float | None, unit: str) -> str:
    """A number with the digits that matter in its unit: what matters of a web's velocity begins at the fifth."""
    return number(value, 7 if unit == "m/s" else 4)


def number(value: float | None, significant: int = 4) -> str:
    """A number for the eye: `significant` digits, but never fewer than stand before the decimal point."""
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
