"""`hilbench diagnose`: what a model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hilbench.apps.cli.options import BusOption, JsonOption, ModelOption, SetOption
from hilbench.errors import UnusableInputError


def diagnose(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="recording (.mf4, .csv, .csv.gz) or run folder, or a bench config (.yaml) to run and diagnose",
        ),
    ],
    model: ModelOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="folder for the page, the extended model (model_extended.yaml) and bench (config_extended.yaml)",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            "--against",
            metavar="RECORDING",
            help="recording of the same machine before: name what changed since; a lone axis needs no --model for that",
        ),
    ] = None,
    next_experiment: Annotated[
        Path | None,
        typer.Option(
            "--next-experiment",
            metavar="FILE",
            help="write steps of at most 30 s that would separate tied effects, or excite what was not (YAML)",
        ),
    ] = None,
    until_clear: Annotated[
        bool,
        typer.Option("--until-clear", help="of a bench config: run on with such steps until nothing is tied"),
    ] = False,
    bus: BusOption = None,
    changes: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, and add it to the model.

    What is found in a run of a bench goes into its folder (diagnosis.json) and the history of its stand. --bus and
    --set are those of hilbench run, for a bench config that is run.

    Exit code: 0 diagnosed, whatever the verdict; 2 unusable input; 3 a run of the bench faulted, 130 interrupted.

    Example: hilbench diagnose runs/web_section_step-20260101-120000/recording.mf4 --model model.yaml --out diagnosis

    Example: hilbench diagnose bench_configs/hidden_friction.yaml --out found

    Example: hilbench diagnose bench_configs/hidden_friction.yaml --until-clear --out found

    Example: hilbench diagnose after.csv --against before.csv --out changed
    """
    from rich.console import Console

    from hilbench.apps.cli.progress import ProgressDisplay
    from hilbench.apps.diagnose.diagnose import changed_since, found_on_the_bench, in_a_recording, show_and_keep
    from hilbench.results.run_folder import RunFolder
    from hilbench.runs.config import load_with_overrides

    if source.is_dir():
        run = RunFolder.open(source)
        source, model = run.recording, model or run.config
    is_config = source.suffix in (".yaml", ".yml")
    if (changes or bus is not None) and (not is_config or against is not None):
        option = "--bus" if not changes else f"--set {changes[0]}"
        raise UnusableInputError(option, "with a recording, expected a bench config that is run")
    if is_config and against is not None:
        raise UnusableInputError(source, "a bench config, expected with --against the recording after the change")
    if until_clear and against is None and not is_config:
        raise UnusableInputError(source, "a recording, expected with --until-clear a bench config that can be run")
    with ProgressDisplay(Console(stderr=True, highlight=False), quiet=json) as progress:
        if against is not None:
            found = changed_since(against, source, model, progress)
        elif is_config:
            loaded = load_with_overrides(source, bus=bus, changes=changes or ())
            found = found_on_the_bench(loaded, source, model, out, progress, until_clear=until_clear)
            found.changes = changes or ()
        else:
            found = in_a_recording(source, model, progress)
    show_and_keep(found, source, out, next_experiment, as_json=json)
