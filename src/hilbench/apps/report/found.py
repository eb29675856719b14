"""What the diagnosis beside a run found, as a picture: how far measurement and model parted, until the model had it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.chart import GREEN, INK, VERMILLION
from hilbench.apps.report.page import number
from hilbench.apps.report.plots import Drawing, DrawnAxes, Picture
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.results.result import FoundRecord, GapHistory, Result

Array = NDArray[np.float64]

_TITLE: Final = "Gap between measurement and model"
_CAPTION: Final = (
    "How far the measured torque is from what the model in the twin says, without what is noise: red while an effect "
    "that the model lacks is there, green while there is none or the model has it. Dashed: the same of the model as it "
    "was configured."
)
#: Columns of the table of what was found.
COLUMNS: Final = (
    *(">Since, s", "What", "Where", "Size"),
    *(">Named after, s", ">In the model after, s", ">Gap, N·m", "Could also be"),
)
#: Heights in the picture, as shares: up to which lines go, of the arrow between two of them, and of the words above.
_LINES, _ARROW, _BECAME, _WHAT = 0.77, 0.73, 0.79, 0.87


#: Columns of the table of what the twin found of errors of its model.
ESTIMATED_COLUMNS: Final = ("Effect", "Where", "Parameter", ">Value", ">95 %", "Unit", "Could also be")


def estimated_rows(result: Result) -> list[tuple[str, ...]]:
    """A row for each parameter that the data tell, as `ESTIMATED_COLUMNS`."""
    return [
        (
            each.effect.replace("_", " "),
            each.place,
            each.parameter,
            f"{each.value:.3g}",
            f"{each.ci95[0]:.3g} to {each.ci95[1]:.3g}",
            each.unit,
            ", ".join(each.tied_with).replace("_", " "),
        )
        for each in result.estimated or []
        if each.separable
    ]


def found_pictures(result: Result) -> list[Picture]:
    """The picture, where something looked for effects while the bench ran."""
    if result.gap_history is None or not result.gap_history.t_s:
        return []
    history, found = result.gap_history, result.found or []
    drawing = Drawing(lambda figure: _draw(figure, history, found), 3.4, "found", _TITLE)
    return [Picture("found", _TITLE, _CAPTION, drawing=drawing)]


def found_rows(result: Result) -> list[tuple[str, ...]]:
    """A row for each effect, as `COLUMNS`."""
    return [tuple(_row(each)) for each in result.found or []]


def _row(found: FoundRecord) -> Iterator[str]:
    yield number(found.t_s, 6)
    yield ("no longer " if found.gone else "") + found.effect.replace("_", " ")
    yield found.part
    yield ", ".join(
        f"{name} {each.value:.4g}" + (f" ({each.ci95[0]:.4g} to {each.ci95[1]:.4g})" if not found.gone else "")
        for name, each in found.parameters.items()
    )
    yield number(found.named_after_s)
    never = "refused" if found.refused else "–"
    yield number(found.applied_after_s) if found.applied_after_s is not None else never
    yield "" if found.gap is None else f"{found.gap.before:.3g} → {found.gap.after:.3g}"
    yield ", ".join(found.tied_with).replace("_", " ")


def _draw(figure: Any, history: GapHistory, found: Sequence[FoundRecord]) -> list[DrawnAxes]:
    axes = figure.subplots()
    t_s, in_use, configured = (_array(values) for values in (history.t_s, history.in_use, history.configured))
    parts = _parts(t_s, found)
    axes.fill_between(t_s, 0.0, in_use, where=~parts, color=GREEN, alpha=0.55, linewidth=0, step="pre")
    axes.fill_between(t_s, 0.0, in_use, where=parts, color=VERMILLION, alpha=0.55, linewidth=0, step="pre")
    axes.step(t_s, configured, color=INK, linewidth=1.0, linestyle=(0, (3, 2)), alpha=0.7, where="pre")
    axes.set_ylim(0.0, 1.45 * float(np.nanmax([*in_use, *configured, 1e-9])))
    axes.set_xlim(t_s[0], t_s[-1])
    axes.set_xlabel("time in s")
    axes.set_ylabel(f"gap of {history.signal} in {history.unit}")
    for begun_s, together in groupby(found, key=lambda each: each.t_s):
        _mark(axes, begun_s, list(together))
    return [DrawnAxes(axes)]


def _mark(axes: Any, t_s: float, found: Sequence[FoundRecord]) -> None:
    """When it came, and from when on the model had it, joined by an arrow; above the lines what it was."""
    top = axes.get_ylim()[1]
    axes.axvline(t_s, ymax=_LINES, color=VERMILLION, linewidth=1.0)
    after_s = found[0].applied_after_s
    if after_s is not None:
        axes.axvline(t_s + after_s, ymax=_LINES, color=GREEN, linewidth=1.0)
        style = {"arrowstyle": "->", "color": INK, "linewidth": 0.8}
        axes.annotate("", (t_s + after_s, _ARROW * top), (t_s, _ARROW * top), arrowprops=style)
        words = "out of the model" if found[0].gone else "in the model"
        axes.text(t_s + after_s, _BECAME * top, words, va="bottom", ha="right", fontsize=8, color=GREEN)
    axes.text(t_s, _WHAT * top, "\n".join(map(_words, found)), va="bottom", ha="left", fontsize=8)


def _words(found: FoundRecord) -> str:
    where = f", {found.part}" if found.part else ""
    size = "" if found.gone else f": {_size(found)}"
    return f"{'no ' if found.gone else ''}{found.effect.replace('_', ' ')}{where}{size}"


def _size(found: FoundRecord) -> str:
    """Its strength, in a unit that is read easily."""
    each = next(iter(found.parameters.values()))
    for kind in MachineKind:
        with suppress(KeyError):
            each = found.parameters[find_effect(found.effect, kind).strength[0]]
    if each.unit == "m":
        return f"{1e6 * each.value:.3g} µm"
    return f"{each.value:.3g} {'' if each.unit == '1' else each.unit}".strip()


def _parts(t_s: Array, found: Sequence[FoundRecord]) -> NDArray[np.bool_]:
    """(n,): from when something came until the model had it."""
    parts = np.zeros(len(t_s), bool)
    for each in found:
        until_s = np.inf if each.applied_after_s is None else each.t_s + each.applied_after_s
        parts |= (t_s > each.t_s) & (t_s <= until_s)
    return parts


def _array(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])
