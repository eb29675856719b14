"""The page of a diagnosis: verdict, effects, the gap before and after, where the model disagreed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.apps.report.chart import BLUE, VERMILLION, Chart, Curve, Mark
from hilbench.apps.report.page import number, write_page
from hilbench.apps.report.plots import DrawnAxes, Picture, drawn
from hilbench.apps.report.reduce import moving_average
from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, Unobservable
from hilbench.diagnosis.next_experiment import NextExperiment
from hilbench.diagnosis.web_line_bench_gap import LiveGap
from hilbench.errors import BenchFaultError

_SENTENCES = {
    "complete": "nothing is missing that these data can show",
    "named": "the effects below close the gap on data that no fit has seen",
    "unknown": "something is missing that no effect of the vocabulary explains",
}
_CHANGES = {
    "complete": "nothing changed that these data can show",
    "named": "the effects below changed, by the values below",
    "unknown": "something changed, or is missing, that no effect of the vocabulary explains",
}
#: Residuals are averaged over this time in the pictures, s: the noise of single samples would hide what is left.
_SMOOTHING_S = 0.2


@dataclass
class Found:
    """A diagnosis, and what the bench showed of it."""

    diagnosis: Diagnosis
    config: Path | None  #: bench config with the model in it, where there is one
    live: list[LiveGap] = field(default_factory=list)  #: with the original and with the extended model
    not_compared: str = ""  #: why the second run is not among them
    fault: BenchFaultError | None = None  #: of the second run
    against: Path | None = None  #: the recording before, where changes were looked for
    proposed: NextExperiment | None = None  #: what would tell more
    changes: Sequence[str] = ()  #: of the bench config, by --set
    rounds: list[str] = field(default_factory=list)  #: what was run after the first run, and what it was to tell

    @property
    def sentence(self) -> str:
        """Meaning of the verdict."""
        return (_SENTENCES if self.against is None else _CHANGES)[self.diagnosis.verdict]


def write_diagnosis_page(shown: Found, title: str, path: Path, config: Path | None) -> Path:
    """Write the page; `config`: the bench config that was written with the extended model in it, where there is one.
    Raises UnusableInputError if it cannot be written."""
    found, changes = shown.diagnosis, shown.against is not None
    residuals = _residuals(found)
    return write_page(
        path,
        "diagnose/diagnosis",
        [residuals],
        _held_out(found),
        title=title,
        found=found,
        sentence=f"{shown.sentence[0].upper()}{shown.sentence[1:]}.",
        changes=changes,
        proposed=shown.proposed,
        rounds=shown.rounds,
        effects=_effects(found, changes=changes),
        tied=[(_place(effect), effect) for effect in found.effects if effect.tied_with],
        gaps=[
            (g.signal, *map(number, (g.before, g.after, g.noise_floor)), number(g.after / g.noise_floor, 3))
            for g in found.gaps
        ],
        residuals=residuals,
        profiles=_profiles(found) if found.profiles else None,
        live=[
            (each[0].text, *(number(figure.value) for figure in each))
            for each in zip(*(gap.figures for gap in shown.live), strict=True)
        ],
        not_compared=shown.not_compared,
        where=[(w.signal, w.condition, w.when, f"{100.0 * w.share_of_gap:.0f} %") for w in found.where],
        left=[(m.signal, m.condition, m.detail, number(m.excess, 3)) for m in found.unexplained],
        blind=[
            (
                _place(b),
                b.experiment,
                "never" if b.smallest_visible is None else f"{number(b.smallest_visible, 3)} {b.unit}",
            )
            for b in found.unobservable
        ],
        config=config,
    )


def _place(effect: NamedEffect | Unobservable) -> str:
    return effect.place.text


def _effects(found: Diagnosis, *, changes: bool) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for effect in found.effects:
        for name, value in effect.parameters.items():
            best, low, high = (number(each, value.digits) for each in (value.value, *value.ci95))
            was = ("" if value.before is None else number(value.before),) if changes else ()
            rows.append((_place(effect), name, "" if value.unit == "1" else value.unit, best, f"{low} to {high}", *was))
    return rows


def _residuals(found: Diagnosis) -> Picture:
    width = max(1, round(_SMOOTHING_S / float(np.median(np.diff(found.t_s)))))
    charts = []
    for k, name in enumerate(found.names):
        if name.startswith("tau"):
            before, after = (moving_average(r[k], width) for r in (found.before, found.after))
            curves = [Curve("before", found.t_s, before, BLUE, 0.9), Curve("after", found.t_s, after, VERMILLION, 0.9)]
            charts.append(Chart(f"{name.removesuffix('_Nm')} in N·m", curves))
    caption = (
        f"Measured less simulated torque, averaged over {_SMOOTHING_S:g} s, with the original model and with the "
        "effects that were found; grey: held out of every fit."
    )
    return drawn(Picture("diagnosis", "Torque residuals", caption, charts), _held_out(found))


def _held_out(found: Diagnosis) -> list[Mark]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], found.held_out.astype(int), [0]])))
    return [Mark(float(found.t_s[a]), float(found.t_s[b - 1]), "") for a, b in edges.reshape(-1, 2)]


def _profiles(found: Diagnosis) -> Picture:
    rows = (len(found.profiles) + 1) // 2

    def draw(figure: Any) -> list[DrawnAxes]:
        figure.subplots_adjust(right=0.985, hspace=0.62, wspace=0.3)
        grid = np.atleast_1d(figure.subplots(rows, 2)).ravel()
        for axes in grid[len(found.profiles) :]:
            axes.set_visible(False)
        for axes, profile in zip(grid, found.profiles, strict=False):
            axes.plot(profile.at, profile.before, "o-", color=BLUE, markersize=3.0)
            axes.plot(profile.at, profile.after, "o-", color=VERMILLION, markersize=3.0)
            axes.set_xlabel(f"{profile.condition}, {profile.unit}")
        grid[0].set_ylabel(f"{found.profiles[0].signal.removesuffix('_Nm')}, N·m")
        return []

    title = "Mean torque residual over states"
    caption = (
        "Mean of measured less simulated torque over the states on which it depended most: blue with the original "
        "model, orange with the effects that were found."
    )
    return Picture("profiles", title, caption, draw=draw, height_in=2.3 * rows)
