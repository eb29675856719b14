"""`hilbench commission`: a guided run that measures friction, inertia, offset, ripple and eccentricity of a stand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.console import Console
from rich.table import Table
from typer import Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import (
    BusOption,
    ConfigArgument,
    ForceOption,
    JsonOption,
    OutOption,
    PaceOption,
    SetOption,
    print_json,
)
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_INTERRUPTED, UnusableInputError

if TYPE_CHECKING:
    from hilbench.diagnosis.commissioning import Commissioned

#: Columns that the table needs; a narrower terminal wraps whole lines.
_WIDTH: Final = 120
_NORMAL_95: Final = 1.959964


def commission(
    config: ConfigArgument,
    bus: BusOption = None,
    pace: PaceOption = None,
    out: OutOption = Path("runs"),
    changes: SetOption = None,
    forward_only: Annotated[
        bool,
        Option(
            "--forward-only",
            help="never turn back: dry friction and torque offset are tied then, and known as little as before",
        ),
    ] = False,
    known_pct: Annotated[
        float,
        Option(
            "--modulus-known",
            min=0.01,
            max=100.0,
            metavar="PCT",
            help="standard deviation of E, %: what is tied with E is known no better",
        ),
    ] = 20.0,
    yes: Annotated[bool, Option("--yes", help="move real drives without asking")] = False,
    in_process: Annotated[
        bool, Option("--in-process", help="simulated hardware and twin in this process, as of run")
    ] = False,
    json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Commission a stand: measure friction, inertia, torque offset, torque ripple and eccentricity of each axis.

    A run of at most 2 min (speeds of the config's steps, both directions, two tensions, steep ramps, within
    safety: limits) and a fit of its recording. What is measured goes with its standard deviations into the run folder
    (commissioning.json) and the history of the stand, and the twin of every later run of it begins with that. The
    config needs a name of the stand (stand:).

    Exit code: 0 measured, 2 unusable input, 3 bench fault, 130 interrupted or not wanted.

    Example: hilbench commission CONFIG --set stand=pilot_line

    Example: hilbench commission CONFIG --set stand=pilot_line --forward-only --modulus-known 1
    """
    from hilbench.apps.cli.progress import ProgressDisplay
    from hilbench.apps.history.entries import keep_commissioning
    from hilbench.bench.lifecycle.participants import Participants
    from hilbench.diagnosis.commissioning import commissioned
    from hilbench.diagnosis.machines import emulation_of
    from hilbench.diagnosis.web_line_bench_gap import completed
    from hilbench.results.recording import read_recording
    from hilbench.results.run import run_experiment
    from hilbench.runs.commissioning import commissioning_plan
    from hilbench.topology.parts import Role

    loaded = load_config(config, bus=bus, pace=pace, changes=changes or ())
    if loaded.config.stand is None:
        raise UnusableInputError(
            config, "no 'stand', expected the name that all configs of the stand share: --set stand=NAME"
        )
    plan = commissioning_plan(loaded.config, config, forward_only=forward_only)
    real = [part.name for part in loaded.config.parts_of(Role.AXIS) if not part.is_simulated]
    if not json:
        print(f"{loaded.config.stand}: {plan.text}")
    if real and not yes:
        if json:
            raise UnusableInputError(config, f"{', '.join(real)} would move, expected --yes with --json")
        if not typer.confirm(f"{', '.join(real)} will move. Go on?"):
            raise typer.Exit(EXIT_INTERRUPTED)
    experiment = {"steps": plan.steps, "criteria": [], "name": f"{loaded.config.name}_commissioning"}
    with ProgressDisplay(Console(stderr=True, highlight=False), quiet=json) as progress:
        observer, announce = progress.of_run("run", 0.0, loaded.config.cycle_time_s)
        bench = loaded.config.model_copy(update=experiment)
        outcome = run_experiment(
            type(loaded)(bench, loaded.document),
            out,
            observers=[observer],
            participants=Participants.IN_PROCESS if in_process else Participants.STARTED,
            announce=announce,
            force=force,
        )
        folder, errors = completed(outcome).folder, bench.twin.model_errors
        progress.announce("fit the recording", 0.5)
        recording, emulation = read_recording(folder.recording), emulation_of(bench)
        found = commissioned(recording, bench.machine, folder.recording, emulation, errors, known_pct)
    quantities = keep_commissioning(folder, found)
    if json:
        data = {"stand": loaded.config.stand, "run": str(folder.path.resolve()), "plan": plan.text}
        print_json(data | {"quantities": [vars(each) for each in quantities]})
        return
    console = Console(highlight=False)
    console.width = max(console.width, _WIDTH)
    console.print(_table(found))
    console.print(f"in the history of {loaded.config.stand}; run: {folder.path}", soft_wrap=True, markup=False)


def _table(found: list[Commissioned]) -> Table:
    from hilbench.diagnosis.commissioning import MEASURED

    rows = []
    for one in sorted(found, key=lambda one: (one.axis or 0, list(MEASURED).index(one.effect))):
        name = MEASURED[one.effect] + ("" if one.order is None else f", {one.order:.4g} per motor turn")
        place = str(one.axis or "") if one.section is None else f"span {one.section}"
        half = f"{_NORMAL_95 * one.deviation:.2g}"
        rows.append((name, place, f"{one.value:.4g}", half, one.unit, ", ".join(one.tied_with)))
    columns, caption = ("", "axis", ">value", ">± 95 %", "unit", "tied with"), "with what the model has already"
    return table(columns, rows, ("",), framed=True, caption=caption, caption_justify="left")
