"""`hilbench diagnose`: what a model lacks, from a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hilbench.apps.cli.columns import report_unknown, reported_section
from hilbench.apps.cli.model_option import any_model_from, config_from
from hilbench.apps.cli.options import print_json
from hilbench.apps.cli.progress import ProgressDisplay
from hilbench.apps.cli.tables import table
from hilbench.apps.history.entries import keep_diagnosis
from hilbench.apps.report.chart import BLUE, VERMILLION, Chart, Curve, Mark
from hilbench.apps.report.page import number, write_page
from hilbench.apps.report.plots import DrawnAxes, Picture, drawn
from hilbench.apps.report.reduce import moving_average
from hilbench.arrays import runs
from hilbench.diagnosis.comparison import Run, compared
from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, Unobservable, diagnose
from hilbench.diagnosis.machines import AnyEmulation, emulation_beside, emulation_of
from hilbench.diagnosis.next_experiment import NextExperiment, Step, proposed, write_steps
from hilbench.diagnosis.web_line_bench_gap import LiveGap, live_gap, run_bench
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.files import make_folder
from hilbench.plant.model_file import Machine, write_model
from hilbench.results.recording import Recording, read_section
from hilbench.results.run import RunOutcome
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import LoadedConfig, write_config_over
from hilbench.topology.config import BenchConfig

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
        tied=[(effect.place.text, effect) for effect in found.effects if effect.tied_with],
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
                b.place.text,
                b.experiment,
                "never" if b.smallest_visible is None else f"{number(b.smallest_visible, 3)} {b.unit}",
            )
            for b in found.unobservable
        ],
        config=config,
    )


def _effects(found: Diagnosis, *, changes: bool) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for effect in found.effects:
        for name, value in effect.parameters.items():
            best, low, high = (number(each, value.digits) for each in (value.value, *value.ci95))
            was = ("" if value.before is None else number(value.before),) if changes else ()
            rows.append(
                (effect.place.text, name, "" if value.unit == "1" else value.unit, best, f"{low} to {high}", *was)
            )
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
    return [Mark(float(found.t_s[a]), float(found.t_s[b - 1]), "") for a, b in runs(found.held_out)]


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


#: Columns that the tables need; a narrower terminal wraps whole lines, it loses no figures.
_WIDTH = 100
#: Runs of the bench after the first, at most, until nothing is tied.
_MOST_ROUNDS = 3


def in_a_recording(source: Path, model_path: Path | None, progress: ProgressDisplay) -> Found:
    """Diagnose what a model lacks, by a recording. Raises UnusableInputError."""
    if model_path is None:
        raise UnusableInputError("--model", "missing, expected the model file that the recording is compared with")
    config, model = config_from(model_path), any_model_from(model_path)
    progress.announce("read the recording", 0.0)
    recording = _section_of(source)
    diagnosis = diagnose(recording, model, source, progress.announce, _emulation(source, config))
    return Found(diagnosis, None if config is None else model_path, proposed=proposed(diagnosis, recording, source))


def _section_of(source: Path) -> Recording:
    recording = reported_section(source)
    report_unknown(recording.channels, source)
    return recording


def show_and_keep(found: Found, source: Path, out: Path | None, next_experiment: Path | None, *, as_json: bool) -> None:
    """Print what was found, write page, extended model and extended config into `out`, and steps that would tell more
    to `next_experiment`. Raises UnusableInputError, and the fault of a run with the extended model when all is done."""
    files = {} if out is None else _write(found, source, out)
    if next_experiment is not None and found.proposed is not None:
        write_steps(next_experiment, found.proposed, found.config)
    written = next_experiment if found.proposed is not None else None
    data = as_data(found, files, written)
    _remember(found, source, data)
    if as_json:
        print_json(data)
    else:
        console = Console(highlight=False)
        console.width = max(console.width, _WIDTH)
        _show_all(console, found, files)
        if next_experiment is not None:
            console.print(_next_line(found, written), soft_wrap=True)
    if found.fault is not None:
        raise found.fault


def _remember(found: Found, source: Path, data: dict[str, Any]) -> None:
    """Put what was found of a stand's run into its folder and the history; of a change there is no value to keep."""
    run = RunFolder(found.live[0].run if found.live else source.parent)
    if found.against is None and run.config.is_file():
        try:
            keep_diagnosis(run, data)
        except UnusableInputError as error:  # what was found is shown all the same
            Console(stderr=True, highlight=False).print(f"not in the history: {error}", soft_wrap=True, markup=False)


def _next_line(found: Found, written: Path | None) -> str:
    if found.proposed is None:
        return "next experiment: none of the library would add information"
    shown_text = f"next experiment: {found.proposed.moves}, {found.proposed.duration_s:.1f} s: {written}"
    return shown_text if found.config is None else f"{shown_text}\nhilbench run {written}"


def changed_since(before: Path, source: Path, model_path: Path | None, progress: ProgressDisplay) -> Found:
    """Diagnose what changed from one recording to another."""
    config = None if model_path is None else config_from(model_path)
    model = None if model_path is None else any_model_from(model_path)
    runs = []
    for path in (source, before):
        progress.announce(f"read {path}", 0.0)
        runs.append(Run(_section_of(path), path, _emulation(path, config)))
    return Found(compared(runs[0], runs[1], model, progress.announce), model_path if config else None, against=before)


def _emulation(recording: Path, config: BenchConfig | None) -> AnyEmulation | None:
    """Emulation of web or shaft, if a bench made the recording: by the config of its run, else the model's."""
    return emulation_beside(recording) or (None if config is None else emulation_of(config))


def found_on_the_bench(
    loaded: LoadedConfig,
    config: Path,
    model_path: Path | None,
    out: Path | None,
    progress: ProgressDisplay,
    *,
    until_clear: bool,
) -> Found:
    """Run, diagnose, and run again with what was found.

    until_clear: first with further steps as well, each time those that would tell most, until nothing is tied.
    """
    runs, steps, rounds = (out or Path()) / "runs", list[Step](), list[str]()
    emulation, cycle_s = emulation_of(loaded.config), loaded.config.cycle_time_s
    model = loaded.config.machine if model_path is None else any_model_from(model_path)

    def run(what: str, share: float, model: Machine) -> RunOutcome:
        observer, announce = progress.of_run(what, share, cycle_s)
        return run_bench(loaded, model, runs, more_steps=steps, observers=[observer], announce=announce)

    def diagnosed(what: str) -> Found:
        outcome = run(what, 0.0, model)
        gap, path = live_gap(outcome), outcome.folder.recording
        recording = read_section(path)
        diagnosis = diagnose(recording, model, path, progress.announce, emulation)
        return Found(diagnosis, config, [gap], proposed=proposed(diagnosis, recording, path), rounds=rounds)

    found = diagnosed("run the bench")
    while until_clear and found.proposed is not None and len(rounds) < _MOST_ROUNDS:
        if not any(effect.tied_with for effect in found.diagnosis.effects):
            break
        steps += found.proposed.steps
        rounds.append(f"{found.proposed.moves} ({'; '.join(found.proposed.reasons)})")
        found = diagnosed(f"run the bench with {found.proposed.moves}")
    diagnosis, (before,) = found.diagnosis, found.live
    if not diagnosis.effects:
        return found
    try:
        after = live_gap(run("run the bench with the extended model", 0.97, diagnosis.model))
    except BenchFaultError as fault:
        found.not_compared, found.fault = f"the run with the extended model ended early: {fault}", fault
        return found
    if after.cycles != before.cycles:
        found.not_compared = (
            f"the run with the extended model took {after.cycles} cycles, the first one {before.cycles}: "
            "they are not the same experiment"
        )
        return found
    found.live.append(after)
    return found


def _write(found: Found, source: Path, out: Path) -> dict[str, Path]:
    """Files that were written: page, model, and config where there is one."""
    make_folder(out)
    files = {"page": out / "diagnosis.html", "model": out / "model_extended.yaml"}
    write_model(files["model"], found.diagnosis.model)
    if found.config is not None:
        files["config"] = out / "config_extended.yaml"
        write_config_over(files["config"], [found.config, files["model"]], found.changes)
    title = f"Diagnosis of {source.name}" + ("" if found.against is None else f" against {found.against.name}")
    write_diagnosis_page(found, title, files["page"], files.get("config"))
    return files


def _show_all(console: Console, found: Found, files: Mapping[str, Path]) -> None:
    _show(console, found)
    for line in found.rounds:
        console.print(f"ran as well: {line}", soft_wrap=True)
    if found.live:
        console.print(_live_table(found.live))
    if found.not_compared:
        console.print(f"not compared: {found.not_compared}", soft_wrap=True)
    if files:
        console.print(f"page: {files['page']}\nextended model: {files['model']}", soft_wrap=True)
    if "config" in files:
        console.print(f"bench with the extended model: hilbench run {files['config']}", soft_wrap=True)


def as_data(shown: Found, files: Mapping[str, Path], next_experiment: Path | None = None) -> dict[str, Any]:
    """Data that `--json` prints (design, section 6)."""
    found = shown.diagnosis
    return {
        "verdict": found.verdict,
        "against": None if shown.against is None else str(shown.against),
        "effects": [_effect(effect) for effect in found.effects],
        "nuisance": [_effect(effect) for effect in found.nuisance],
        "gap": {"metric": "rms", **asdict(found.gap), "held_out": True},
        "where": [asdict(w) for w in found.where],
        "unexplained": [
            {name: getattr(m, name) for name in ("signal", "when", "condition", "detail", "points")}
            for m in found.unexplained
        ],
        "proposed_laws": [{**asdict(one), "text": one.text} for one in found.laws],
        "blind_to": [_placed(blind) for blind in found.unobservable],
        "repairs": [asdict(repair) for repair in found.repairs],
        "missing_channels": found.missing_channels,
        "predicted_on": found.predicted_on,
        "emulation_cycle_s": None if found.emulation is None else found.emulation.cycle_s,
        "next_experiment": None if next_experiment is None else str(next_experiment),
        "rounds": shown.rounds,
        "live": [
            {"run": str(gap.run), "cycles": gap.cycles} | {each.name: each.value for each in gap.figures}
            for gap in shown.live
        ],
        "not_compared": shown.not_compared or None,
        **{name: str(files[name]) if name in files else None for name in ("model", "config")},
    }


def _placed(found: NamedEffect | Unobservable) -> dict[str, Any]:
    """Its fields, with a span by its number or a station by its name."""
    data = asdict(found)
    section = data.pop("section")
    return data | ({"span": None, "station": section} if isinstance(section, str) else {"span": section})


def _effect(effect: NamedEffect) -> dict[str, Any]:
    parameters = {
        name: {key: each for key, each in asdict(value).items() if key != "before" or each is not None}
        for name, value in effect.parameters.items()
    }
    return _placed(effect) | {"parameters": parameters}


def _show(console: Console, shown: Found) -> None:
    found, against = shown.diagnosis, shown.against
    console.print(f"{found.verdict}: {shown.sentence}", soft_wrap=True)
    console.print(f"predicted on {found.predicted_on}", soft_wrap=True)
    for effect in found.nuisance:
        sizes = [f"{k} {v.value:.3g} ({v.ci95[0]:.3g} to {v.ci95[1]:.3g})" for k, v in effect.parameters.items()]
        what = f"{effect.effect} of axis {effect.axis}: {', '.join(sizes)}"
        console.print(f"not the model's, and corrected for: {what}", soft_wrap=True)
    if found.emulation is not None:
        every = f"every {1e3 * found.emulation.cycle_s:g} ms"
        console.print(f"a bench's recording: {found.emulation.part} emulated by a load motor, {every}")
    if found.effects:
        console.print(_effects_table(found, changes=against is not None))
        for effect in found.effects:
            if effect.tied_with:
                others = ", ".join(effect.tied_with)
                console.print(f"{effect.effect} is tied with {others}; distinguished by: {effect.told_apart_by}")
    gaps = [(gap.signal, *(f"{rms:.4g}" for rms in (gap.before, gap.after, gap.noise_floor))) for gap in found.gaps]
    title = "torque residual, rms on held-out data, N·m"
    console.print(table(("signal", ">before", ">after", ">noise floor"), gaps, framed=True, title=title))
    _show_where(console, found)
    for blind in found.unobservable:
        place = blind.place.text
        if against is None:
            console.print(f"these data could hardly show {place}; next experiment: {blind.experiment}")
        elif blind.smallest_visible is not None:
            least = f"{blind.smallest_visible:.3g} {blind.unit}"
            console.print(f"a change of {place} of less than {least} could not be detected", soft_wrap=True)
    for repair in found.repairs:
        console.print(f"mended: {repair.text}", soft_wrap=True)
    if found.missing_channels:
        console.print(f"channels not recorded: {', '.join(found.missing_channels)}")


def _effects_table(found: Diagnosis, *, changes: bool) -> Table:
    columns = ("effect", "place", "parameter", ">change" if changes else ">value", ">95 %", "unit")
    rows = []
    for effect in found.effects:
        for k, (name, value) in enumerate(effect.parameters.items()):
            first = (effect.effect, effect.place.where) if k == 0 else ("", "")
            shown_text, low, high = (f"{each:.{value.digits}g}" for each in (value.value, *value.ci95))
            was = ("" if value.before is None else f"{value.before:.5g}",) if changes else ()
            rows.append((*first, name, shown_text, f"{low} to {high}", value.unit, *was))
    return table((*columns, *((">before",) if changes else ())), rows, ("effect", ">95 %"), framed=True)


def _live_table(live: list[LiveGap]) -> Table:
    figures = zip(*(gap.figures for gap in live), strict=True)
    rows = [(each[0].text, *(f"{figure.value:.4g}" for figure in each)) for each in figures]
    columns = ("", ">original model", ">extended model")[: 1 + len(live)]
    return table(columns, rows, ("",), framed=True, title="the twin on the bench")


def _show_where(console: Console, found: Diagnosis) -> None:
    if found.verdict == "unknown":
        for misfit in found.unexplained[:5]:
            console.print(f"left in {misfit.signal}: {misfit.condition}, {misfit.detail}")
        for one in found.laws:
            console.print(f"a law that explains {100.0 * one.share:.0f} % of it: {one.text}", soft_wrap=True)
    elif found.where:
        rows = [(row.signal, row.condition, f"{100 * row.share_of_gap:.0f} %") for row in found.where[:5]]
        title = "where the original model disagreed"
        console.print(table(("signal", "condition", "share of gap"), rows, framed=True, title=title))
