"""`hilbench drift`: changes of a stand since its last run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from typer import Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import BusOption, ConfigArgument, JsonOption, SetOption, print_json
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED, UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.doctor.drift import Drift
    from hilbench.apps.doctor.drive_answers import LastRun


def drift(
    config: ConfigArgument,
    bus: BusOption = None,
    changes: SetOption = None,
    runs: Annotated[Path, Option(help="folder with the run folders of the stand")] = Path("runs"),
    start: Annotated[bool, Option(help="start simulated drives when none of them is there, as run does")] = True,
    in_process: Annotated[
        bool, Option("--in-process", help="simulated drives in this process, as run --in-process")
    ] = False,
    write: Annotated[
        list[str] | None,
        Option(metavar="KEY", help="write a node's present value into the config, by its key; all; repeatable"),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare config, EDS files and what the drives say with the last run of the stand, and with each other.

    Writes nothing to any device. Of a stand without a run that kept it, drives and EDS files are compared.

    Exit code: 0 nothing has drifted, 1 something has, 2 unusable input (nobody answers, another master is at work).

    Example: hilbench drift bench_configs/web_section_step.yaml --in-process

    Example: hilbench drift bench_configs/web_section_step.yaml --bus socketcan:can0 --json
    """
    from hilbench.apps.canopen_tools.attach import left_out
    from hilbench.apps.canopen_tools.eds_match import eds_files
    from hilbench.apps.doctor.drift import drifts
    from hilbench.apps.doctor.drive_answers import last_run, read_stand
    from hilbench.bench.check import check_bench

    loaded = load_config(config, bus=bus, changes=changes or ())
    bench = loaded.config
    check_bench(bench, loaded.document)
    if in_process and not start:
        raise typer.BadParameter("--in-process and --no-start exclude each other")
    last, problems = last_run(runs, bench.stand_name)
    console = Console(stderr=True, highlight=False)
    answers, fresh = read_stand(
        bench,
        start=start,
        in_process=in_process,
        announce=lambda text: None if json else console.print(f"{text} ...", markup=False),
    )
    folders = dict.fromkeys(part.node.eds.parent for part in bench.stand_drives)
    found = drifts(
        bench,
        answers,
        None if last is None else last.data,
        None if last is None else last.config,
        fresh=fresh,
        files=[file for folder in folders for file in eds_files(folder, left_out)],
    )
    written = _write(config, found, write or ())
    if json:
        drifts_as_data = [
            {**vars(each), "write": {".".join(location): value for location, value in each.write.items()}}
            for each in found
        ]
        known = {"last_run": None if last is None else last.folder.path, "drifted": bool(found)}
        print_json({**known, "drifts": drifts_as_data, "written": written, "notes": problems})
    else:
        _show(found, last, problems, written)
    raise typer.Exit(EXIT_CRITERION_FAILED if found else EXIT_PASSED)


def _write(config: Path, found: Sequence[Drift], keys: Sequence[str]) -> list[str]:
    """Write the commanded outputs; returns a line for each change."""
    from hilbench.runs.config_text import write_value

    possible = {each.key: each for each in found if each.write}
    for key in keys:
        if key != "all" and key not in possible:
            known = ", ".join(possible) or "none"
            raise UnusableInputError(
                "--write", f"'{key}' is nothing that can be written, expected one of: {known}, all"
            )
    chosen = possible.values() if "all" in keys else [possible[key] for key in keys]
    changes = {location: value for each in chosen for location, value in each.write.items()}
    return [f"{write_value(config, at, value)}: {'.'.join(at)} is {value} now" for at, value in changes.items()]


def _show(found: Sequence[Drift], last: LastRun | None, problems: Sequence[str], written: Sequence[str]) -> None:
    for problem in problems:
        print(f"not read: {problem}")
    print("no run to compare with" if last is None else f"compared with {last.folder.path}")
    for each in found:
        print(f"{each.kind:9} {each}" + (f"   (--write {each.key})" if each.write and not written else ""))
    for line in written:
        print(line)
    print("nothing has drifted" if not found else f"{len(found)} drifted")
