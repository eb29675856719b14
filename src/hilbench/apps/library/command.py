"""`hilbench runs`: the runs in a folder, found, labelled, drawn over time, and cleared away."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from hilbench.apps.cli.options import JsonOption, RunsOption, print_json
from hilbench.errors import UnusableInputError, printable

if TYPE_CHECKING:
    from hilbench.apps.library.index import RunEntry
    from hilbench.apps.library.matrix import Matrix
    from hilbench.apps.library.query import Library
    from hilbench.results.run_folder import RunFolder
    from hilbench.runs.criteria import CriterionResult

app = typer.Typer(no_args_is_help=True, help="The runs in a folder: list, show, tag, note, trend, matrix, delete, gc.")


def _option(name: str, kind: Any, option: str, metavar: str | None, help: str) -> Parameter:
    annotation = Annotated[kind | None, Option(option, metavar=metavar, help=help)]
    return Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=annotation)


_STATES = "passed, failed, completed (nothing judged), fault, interrupted, unfinished or running; repeatable"
_ASKED_OF = "on metrics, keys that were set, and fields such as bench, seed, duration_s"
#: Options that find runs, by what `Query.parse` calls them.
_FILTERS = (
    _option("name", str, "--name", "PATTERN", "of the folder, with * and ?"),
    _option("bench", str, "--bench", "PATTERN", "name of the bench, with * and ?"),
    _option("results", list[str], "--result", None, _STATES),
    _option("tags", list[str], "--tag", None, "that it has; repeatable: all of them"),
    _option("since", str, "--since", "WHEN", "a date, or an age such as 7d"),
    _option("until", str, "--until", "WHEN", "a date, or an age such as 7d"),
    _option("where", str, "--where", "CONDITION", _ASKED_OF),
)
Filters = dict[str, Any]
OneRunArgument = Annotated[str, Argument(metavar="RUN", help="run folder, a name in --runs, or last")]
RunArguments = Annotated[list[str], Argument(metavar="RUN...", help="run folders, names in --runs, or last")]
_DIR = Path("runs")
#: Runs that a table shows unless asked for more.
_SHOWN = 50
_COLOURS = {
    **dict.fromkeys(("failed", "error", "fault"), "red"),
    **dict.fromkeys(("marginal", "completed", "interrupted", "unfinished", "not covered"), "yellow"),
    **{"passed": "green", "running": "cyan"},
}


def _with_filters(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that find runs, behind its `--runs`; its `filters` are what they say."""
    own = [each for each in signature(command, eval_str=True).parameters.values() if each.name != "filters"]
    at = 1 + [each.name for each in own].index("runs")

    @wraps(command)
    def filtered(**given: Any) -> None:
        command({each.name: given.pop(each.name) for each in _FILTERS}, **given)

    filtered.__signature__ = Signature([*own[:at], *_FILTERS, *own[at:]])  # type: ignore[attr-defined]
    return filtered


_announce = partial(typer.echo, err=True)


def _folder(run: str, runs: Path) -> RunFolder:
    from hilbench.apps.library.query import find_run

    return find_run(run, runs, _announce)


def _library(folder: Path) -> Library:
    from hilbench.apps.library.query import Library

    return Library(folder, _announce)


@app.command("list")
@_with_filters
def list_runs(
    filters: Filters,
    runs: RunsOption = _DIR,
    metric: Annotated[list[str] | None, Option(help="show it as a column; repeatable")] = None,
    sort: Annotated[str, Option(metavar="KEY", help="began, or a metric or field: largest first")] = "began",
    last: Annotated[
        int | None, Option(min=1, help="so many at most", show_default=f"{_SHOWN} in a table, otherwise all")
    ] = None,
    paths: Annotated[bool, Option("--paths", help="print the paths of the folders alone")] = False,
    html: Annotated[Path | None, Option(metavar="FILE", help="write a page to look through them")] = None,
    json: JsonOption = False,
) -> None:
    """List runs, the newest first: when, what, with which result, and what they measured.

    A condition is written as in Python: comparisons, and, or, not, in, + - * /, abs(). A run without a value that is
    asked for is not found.

    Example: hilbench runs list --result failed --since 7d

    Example: hilbench runs list --where 'E_time_to_1pct_s > 0.2'

    Example: hilbench runs list --bench 'web_*' --metric E_noise_pct --sort E_noise_pct --html runs.html
    """
    from hilbench.apps.library.query import FIELDS, Query, values_of

    query = Query.parse(**filters)
    # Metrics named in a condition are shown beside the runs that it finds.
    asked = [] if query.where is None else sorted(query.where.names - FIELDS.keys())
    found = _library(runs).runs(query, [*(metric or ()), sort])
    if sort != "began":
        values = {run.path: values_of(run, [sort]).get(sort) for run in found}
        found.sort(key=lambda run: _largest_first(values[run.path]))
    if html is not None:
        from hilbench.apps.library.runs_page import write_runs_page

        print(write_runs_page(runs, found, html))
    elif json:
        print_json({"folder": str(runs), "runs": [run.as_data() for run in found[:last]]})
    elif paths:
        for run in found[:last]:
            print(runs / run.path)
    else:
        _print_table(found[: last or _SHOWN], list(dict.fromkeys([*(metric or ()), *asked])))
        if last is None and len(found) > _SHOWN:
            typer.echo(f"{_SHOWN} of {len(found)} runs; --last {len(found)} shows all")


def _largest_first(value: object) -> tuple[int, float, str]:
    if isinstance(value, int | float):
        return 0, -float(value), ""
    return (2, 0.0, "") if value is None else (1, 0.0, str(value))


def _print_table(found: Sequence[RunEntry], metrics: Sequence[str]) -> None:
    from hilbench.apps.library.query import values_of

    if not found:
        typer.echo("no run is like that", err=True)
        return
    settings = any(run.settings for run in found)
    headings = ["run", "began", "result", "criteria", "duration", *metrics, "tags", *(["set"] if settings else [])]
    rows = []
    for run in found:
        values, duration = values_of(run, metrics), "" if run.duration_s is None else f"{run.duration_s:.1f} s"
        measured, tags = (_text(values.get(name)) for name in metrics), ", ".join(run.tags)
        given = [", ".join(f"{key}={_text(value)}" for key, value in run.settings.items())] if settings else []
        rows.append([run.path, run.began, run.state, run.held, duration, *measured, tags, *given])
    _print_rows(headings, rows, right={"criteria", "duration", *metrics}, coloured="result")


def _print_rows(headings: Sequence[str], rows: Sequence[Sequence[str]], *, right: set[str], coloured: str = "") -> None:
    """Columns as wide as they need, never cut: a table of thousands of rows takes rich longer than finding them."""
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for number, row in enumerate([headings, *rows]):
        cells = []
        for heading, width, cell in zip(headings, widths, row, strict=True):
            text = cell.rjust(width) if heading in right else cell.ljust(width)
            cells.append(typer.style(text, fg=_COLOURS.get(cell)) if number and heading == coloured else text)
        typer.echo("  ".join(cells).rstrip())


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _found(criterion: CriterionResult) -> str:
    """Value, unit and limit."""
    value = criterion.value
    known = criterion.reason or "no value" if value is None else f"{value:.5g} {criterion.unit}".strip()
    return f"{known} ({criterion.limit})"


@app.command()
def show(run: OneRunArgument = "last", runs: RunsOption = _DIR, json: JsonOption = False) -> None:
    """Show one run: its result, criteria, metrics, labels, and where its files are.

    Example: hilbench runs show last
    """
    from hilbench.apps.library.query import entry_of

    folder = _folder(run, runs)
    entry = entry_of(folder)
    files = {name: str(path) for name, path in folder.files().items()}
    if json:
        data = entry.as_data() | {"folder": str(folder.path), "files": files}
        data["verdicts"] = [
            {"criterion": each.name, "verdict": each.verdict, "verifies": list(each.verifies)}
            for each in entry.verdicts
        ]
        print_json(data)
        return
    typer.echo(f"{entry.name}  {typer.style(entry.state, fg=_COLOURS.get(entry.state))}")
    about = {
        "bench": entry.bench,
        "began": entry.began,
        "lasted": "" if entry.duration_s is None else f"{entry.duration_s:.1f} s of bus time",
        "what": " ".join(entry.description.split()),
        "config": entry.config,
        "commit": entry.commit,
        "host": entry.host,
        "set": entry.set_values,
        "fault": entry.fault,
        "tags": ", ".join(entry.tags),
        "size": f"{entry.size_bytes / 1e6:.1f} MB",
        "not read": entry.problem,
    }
    for heading, text in about.items():
        if text:
            typer.echo(f"  {heading:<9} {printable(text)}")
    for each in entry.notes:
        typer.echo(f"  note      {printable(each)}")
    if entry.state == "unfinished":
        typer.echo(f"  it was cut off: hilbench recover {folder.path} makes its result from the trace")
    if entry.verdicts:
        typer.echo()
        rows = [[each.name, each.verdict, _found(each), ", ".join(each.verifies)] for each in entry.verdicts]
        _print_rows(["criterion", "result", "found (limit)", "verifies"], rows, right=set(), coloured="result")
    if entry.metrics:
        typer.echo()
        _print_rows(
            ["metric", "value"], [[name, _text(value)] for name, value in entry.metrics.items()], right={"value"}
        )
    typer.echo()
    _print_rows(["file", "path"], [[name, path] for name, path in files.items()], right=set())


@app.command()
@_with_filters
def trend(
    filters: Filters,
    metric: Annotated[str, Argument(metavar="METRIC", help="a metric")],
    over: Annotated[
        str, Option(metavar="KEY", help="began, or another number: a key that was set, a metric")
    ] = "began",
    runs: RunsOption = _DIR,
    out: Annotated[Path | None, Option(metavar="FILE", help="draw it there: .svg or .png")] = None,
    json: JsonOption = False,
) -> None:
    """Show how a metric goes over runs, or over a value in which they differ, and draw it.

    Rising and falling are told where the rank correlation (Kendall) is significant at 1 %.

    Example: hilbench runs trend E_time_to_1pct_s --since 90d --out trend.svg

    Example: hilbench runs trend E_noise_pct --over machine.web.youngs_modulus_Pa --out noise.png
    """
    from dataclasses import asdict

    from hilbench.apps.library.query import Query
    from hilbench.apps.library.runs_picture import points_of, summary_of, write_runs_picture

    found = _library(runs).runs(Query.parse(**filters), [metric, over])
    points = points_of(found, metric, over)
    if not points:
        raise UnusableInputError(metric, f"no value in {_count(len(found))}, expected some to draw")
    summary, left_out = summary_of(points), len(found) - len(points)
    if out is not None:
        write_runs_picture(points, metric, over, out)
    if json:
        rows = [{"run": each.run.path, "result": each.run.state, over: each.x, metric: each.value} for each in points]
        print_json({**asdict(summary), "left_out": left_out, "points": rows})
        return
    typer.echo(
        f"{metric} of {_count(summary.runs)} over {over}: {summary.direction}, median {summary.median:.5g}, "
        f"{summary.least:.5g} to {summary.largest:.5g}, last {summary.newest:.5g}"
    )
    if left_out:
        typer.echo(f"{_count(left_out)} left out, without a value of {metric} or {over}")
    if out is not None:
        typer.echo(f"picture: {out}")


@app.command("tag")
def tag_runs(
    run: RunArguments,
    add: Annotated[list[str] | None, Option(metavar="TAG", help="repeatable")] = None,
    remove: Annotated[list[str] | None, Option(metavar="TAG", help="repeatable")] = None,
    runs: RunsOption = _DIR,
) -> None:
    """Give runs tags, or take them away; they stand in the run folder (labels.json) and go where it goes.

    Example: hilbench runs tag last --add golden --remove candidate
    """
    from hilbench.apps.library.labels import tag

    if not add and not remove:
        raise UnusableInputError("--add", "missing, expected a tag to add, or --remove with one to take away")
    for folder in [_folder(each, runs) for each in run]:
        print(f"{folder.name}: {', '.join(tag(folder, add or (), remove or ()).tags) or 'no tags'}")


@app.command("note")
def note_run(
    run: OneRunArgument,
    text: Annotated[str, Argument(metavar="TEXT", help="what is to be known of it")],
    runs: RunsOption = _DIR,
) -> None:
    """Add a note to a run, with the time and who wrote it.

    Example: hilbench runs note last 'new belt on axis 2'
    """
    from hilbench.apps.library.labels import note

    folder = _folder(run, runs)
    print(f"{folder.name}: {len(note(folder, text).notes)} notes")


@app.command()
@_with_filters
def delete(
    filters: Filters,
    run: Annotated[list[str] | None, Argument(metavar="[RUN...]", help="run folders, or names in --runs")] = None,
    runs: RunsOption = _DIR,
    yes: Annotated[bool, Option("--yes", help="don't ask")] = False,
) -> None:
    """Delete runs, those named or all that are found, after a question. What is no run folder is refused.

    Example: hilbench runs delete --result fault --until 30d

    Example: hilbench runs delete web_section_step-20260101-120000 --yes
    """
    from hilbench.apps.library.query import Query
    from hilbench.apps.library.retention import check_deletable

    query = Query.parse(**filters)
    if bool(run) == query.asks:
        raise UnusableInputError(
            "RUN", "expected either runs, or options that find some (--result, --until, --where …)"
        )
    library = _library(runs)
    if run:
        # A path is taken as it is, so that a folder which is no run's is reported as such.
        given = [path if os.path.lexists(path := Path(each)) else library.find(each).path for each in run]
        for path in given:
            check_deletable(path)
        _delete([(path, "") for path in given], yes=yes)
    else:
        found = [each for each in library.runs(query) if each.state != "running"]
        _delete([(runs / each.path, each.state) for each in found], yes=yes)


def _delete(given: Sequence[tuple[Path, str]], *, yes: bool) -> None:
    from hilbench.apps.library.retention import delete_all

    for path, why in given:
        typer.echo(f"{path}  {why}".rstrip(), err=True)
    if not given:
        print("no run to delete")
        return
    if not yes:
        if not sys.stdin.isatty():
            raise UnusableInputError("--yes", "missing, expected where nobody can be asked")
        typer.confirm(f"Delete {_count(len(given))} for good?", abort=True, err=True)
    left = delete_all([path for path, _ in given])
    print(f"{_count(len(given) - len(left))} deleted")
    if left:
        raise UnusableInputError.of([*left.values()])


def _count(runs: int) -> str:
    return f"{runs} run{'' if runs == 1 else 's'}"


@app.command()
def gc(
    runs: RunsOption = _DIR,
    older_than: Annotated[str | None, Option(metavar="AGE", help="runs go, such as 90d or 12h")] = None,
    max_size: Annotated[
        str | None, Option(metavar="SIZE", help="the oldest go until all take at most, e.g. 20GB")
    ] = None,
    keep_last: Annotated[int, Option(min=0, help="the newest of each bench stay, so many")] = 0,
    keep_labelled: Annotated[bool, Option(help="runs with a tag or a note stay")] = True,
    dry_run: Annotated[bool, Option("--dry-run", help="only list what would be deleted")] = False,
    yes: Annotated[bool, Option("--yes", help="don't ask")] = False,
    json: JsonOption = False,
) -> None:
    """Clear old runs away, by age or by the size of all; runs with a tag or a note, and those that go on, stay.

    Example: hilbench runs gc --older-than 90d --keep-last 5 --dry-run

    Example: hilbench runs gc --max-size 20GB --yes
    """
    import time

    from hilbench.apps.library.query import seconds_of
    from hilbench.apps.library.retention import Keep, delete_all, to_clear

    if older_than is None and max_size is None:
        raise UnusableInputError("--older-than", "missing, expected --older-than or --max-size")
    keep = Keep(
        None if older_than is None else seconds_of("--older-than", older_than),
        None if max_size is None else _bytes(max_size),
        keep_last,
        keep_labelled,
    )
    known = _library(runs).runs()
    deletions = [(runs / run.path, why, run) for run, why in to_clear(known, keep, time.time())]
    if json:
        if not dry_run and not yes and deletions:
            raise UnusableInputError("--yes", "missing, expected with --json, or --dry-run")
        left = {} if dry_run else delete_all([path for path, _, _ in deletions])
        gone = [(why, run) for path, why, run in deletions if path not in left]
        freed, kept = sum(run.size_bytes for _, run in gone), len(known) - len(gone)
        rows = [{"run": run.path, "why": why, "size_bytes": run.size_bytes} for why, run in gone]
        print_json({"deleted": not dry_run, "freed_bytes": freed, "kept": kept, "runs": rows})
        if left:
            raise UnusableInputError.of([*left.values()])
        return
    freed = sum(run.size_bytes for _, _, run in deletions)
    size = f"{_count(len(deletions))}, {freed / 1e6:.1f} MB; {len(known) - len(deletions)} stay"
    if dry_run:
        for path, why, _ in deletions:
            typer.echo(f"{path}  {why}")
        print(f"would go: {size}")
        return
    typer.echo(f"to go: {size}", err=True)
    _delete([(path, why) for path, why, _ in deletions], yes=yes)


def _bytes(text: str) -> int:
    from pydantic import ByteSize, TypeAdapter, ValidationError

    try:
        return TypeAdapter(ByteSize).validate_python(text)
    except ValidationError as error:
        raise UnusableInputError("--max-size", f"'{text}', expected a size such as 500MB or 20GB") from error


@app.command()
@_with_filters
def matrix(
    filters: Filters,
    runs: RunsOption = _DIR,
    last: Annotated[int, Option(min=1, help="runs at most, the newest")] = 10,
    reqif: Annotated[Path | None, Option(metavar="FILE", help="specification: titles, and what nothing covers")] = None,
    html: Annotated[Path | None, Option(metavar="FILE", help="write a page")] = None,
    json: JsonOption = False,
) -> None:
    """Show requirements by runs: what the criteria of each run (`verifies`) say of each requirement.

    Exit code: 0, 1 where a requirement is not covered, or its newest result is not passed.

    Example: hilbench runs matrix --last 5

    Example: hilbench runs matrix --reqif specification.reqif --html matrix.html
    """
    from hilbench.apps.library.matrix import matrix_of, read_reqif, write_matrix_page
    from hilbench.apps.library.query import Query
    from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED

    specified = [] if reqif is None else read_reqif(reqif)
    query = Query.parse(**filters)
    made = matrix_of([run for run in _library(runs).runs(query) if run.verifies][:last], specified)
    if html is not None:
        typer.echo(write_matrix_page(made, runs, html))
    elif json:
        print_json(made.as_data())
    else:
        _print_matrix(made)
    raise typer.Exit(EXIT_PASSED if made.fulfilled else EXIT_CRITERION_FAILED)


def _print_matrix(made: Matrix) -> None:
    """Runs by letters, so that many fit beside each other."""
    if not made.rows:
        typer.echo("no criterion of these runs verifies a requirement (verifies: [REQ-1])")
        return
    letters = [str(number) for number in range(1, len(made.runs) + 1)]
    for letter, run in zip(letters, made.runs, strict=True):
        typer.echo(f"{letter:>3}  {run.path}  {run.state}")
    typer.echo()
    rows = [
        [row.requirement.id, row.requirement.title, row.newest if row.covered else "not covered", *row.cells]
        for row in made.rows
    ]
    _print_rows(["requirement", "title", "newest", *letters], rows, right=set(), coloured="newest")
