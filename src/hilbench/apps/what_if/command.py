"""`hilbench what-if`: what would come if something were asked of a machine, before it is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import BusOption, JsonOption, key_and_number, print_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hilbench.results.recording import Recording
    from hilbench.results.what_if import Answer
    from hilbench.runs.config import ExperimentConfig


def what_if(
    run: Annotated[
        Path,
        Argument(
            metavar="RUN",
            help="run folder, of a run that has ended or still goes on; or the config (YAML) of a bench that runs",
        ),
    ],
    asked: Annotated[
        list[str],
        Option(
            "--set",
            metavar="PATH=VALUE",
            help="what is asked for: line_speed_m_s, a set-point, E of the web; repeatable",
        ),
    ],
    over: Annotated[
        float | None,
        Option(metavar="S", min=0.0, help="reached within so long; else the speed as the bench moves it by itself"),
    ] = None,
    horizon: Annotated[float, Option(metavar="S", min=0.5, max=60.0, help="how far to look")] = 10.0,
    at: Annotated[float | None, Option(metavar="S", help="from this time of the run on; else from its end")] = None,
    futures: Annotated[int, Option(min=16, max=1024, help="how many to draw")] = 64,
    out: Annotated[Path | None, Option(help="page with all courses (HTML)")] = None,
    bus: BusOption = None,
    json: JsonOption = False,
) -> None:
    """Predict tension, torques and speeds by Monte Carlo if something were asked for, with bands; nothing is moved.

    The futures start from what the run's recording has, or the trace of a run that still goes on; of a config, from
    what is received on the bus of the bench that runs by it, whose folder may be elsewhere. The rest of the experiment
    is not in them.

    Exit code: 0 looked, whatever is seen; 2 unusable input.

    Example: hilbench what-if runs/web_section_step-20260101-120000 --set line_speed_m_s=5 --horizon 10

    Example: hilbench what-if runs/web_section_step-20260101-120000 --set line_speed_m_s=5 --out page.html

    Example: hilbench what-if bench_configs/web_section_step.yaml --set line_speed_m_s=5
    """
    from hilbench.results.what_if import Question
    from hilbench.results.what_if import what_if as answer_to

    wanted = dict(key_and_number("--set", text, "PATH=NUMBER such as line_speed_m_s=5") for text in asked)
    question = Question(wanted, over, horizon, futures, at)
    name, config, recording = _running(run, bus, at) if run.is_file() else _run(run, bus, at)
    answer = answer_to(config, recording, question, str(run))
    texts = lines(answer)
    if out is not None:
        from hilbench.apps.what_if.page import write_what_if_page

        write_what_if_page(answer, texts, name, out)
    if json:
        print_json(_as_object(answer))
        return
    _print(answer, texts, "now" if run.is_file() else f"t = {answer.outlook.now_s:.3f} s")
    if out is not None:
        print(f"page: {out}")


def _run(run: Path, bus: str | None, at: float | None) -> tuple[str, ExperimentConfig, Recording]:
    """Name, config and recording of a run folder."""
    from hilbench.errors import UnusableInputError
    from hilbench.results.run_folder import RunFolder
    from hilbench.results.what_if import recorded
    from hilbench.runs.config import load

    if bus is not None:
        raise UnusableInputError("--bus", f"{bus} beside a run folder, expected the config of a bench that runs")
    folder = RunFolder.open(run)
    config, _ = load(folder.config)
    return folder.name, config, recorded(folder, config, at)


def _running(path: Path, bus: str | None, at_s: float | None) -> tuple[str, ExperimentConfig, Recording]:
    """Recording of a bench that runs, as it is received on its bus."""
    from contextlib import closing

    from hilbench.apps.monitor.changes import PATIENCE_S
    from hilbench.can.open import open_link, open_python_can
    from hilbench.canopen.sdo_client import SDO_ANSWERS, SdoClient
    from hilbench.errors import UnusableInputError
    from hilbench.results.what_if import received, require_predictable

    if at_s is not None:
        raise UnusableInputError("--at", f"{at_s:g} s of a bench that runs, expected none: it is asked now")
    config = load_config(path, bus=bus).config
    require_predictable(config, str(path))
    address = config.bus_address.as_it_runs()
    with closing(open_link(address)) as link, SdoClient(open_python_can(address, SDO_ANSWERS), PATIENCE_S) as client:
        return config.name, config, received(config, link, client)


def lines(answer: Answer) -> list[str]:
    """Commanded moves, a text each."""
    texts = []
    for move in answer.moves:
        lasts = f" within {move.end_s - move.start_s:.3g} s" if move.end_s > move.start_s else ""
        texts.append(f"{move.path} {answer.before[move.path]:.6g} → {move.to:.6g}{lasts}")
    return texts


def _print(answer: Answer, texts: Sequence[str], when: str) -> None:
    from rich.console import Console

    from hilbench.apps.cli.tables import table
    from hilbench.apps.what_if.page import levels_of, rows_of, text_chart

    outlook, console = answer.outlook, Console(highlight=False)
    seconds = outlook.times_s[-1] - outlook.now_s
    console.print(f"what if, from {when} on: {', '.join(texts)}", soft_wrap=True)
    futures = outlook.rows.shape[1]
    console.print(f"{seconds:.3g} s in {futures} futures; bands hold 90 % of what would be measured", soft_wrap=True)
    columns, rows = ("quantity", ">largest", ">of 90 %", ">at the end", ">limits", ">probability"), []
    for watched, largest, end, probability in rows_of(outlook):
        limits = " / ".join(f"{level:g}" for level in levels_of(watched))
        between = f"{largest[1]:.4g} … {largest[2]:.4g}"
        share = f"{100 * probability:.0f} %" if limits else ""
        rows.append((f"{watched.name}, {watched.unit}", f"{largest[0]:.4g}", between, f"{end[0]:.4g}", limits, share))
    console.print(table(columns, rows))
    for place, watched in enumerate(outlook.watched):
        if watched.unit in ("N", "N·m"):
            console.print(f"\n{watched.name}, {watched.unit}")
            for line in text_chart(outlook.times_s, outlook.band(place), levels_of(watched)):
                console.print(line, soft_wrap=True)
    for crossing in outlook.crossings(0.5):
        console.print(crossing.expected_from(outlook.now_s), soft_wrap=True)


def _as_object(answer: Answer) -> dict[str, Any]:
    outlook = answer.outlook
    courses = {}
    for place, watched in enumerate(outlook.watched):
        low, median, high = outlook.band(place)
        courses[watched.signal] = {
            "unit": watched.unit,
            "median": median.tolist(),
            "low": low.tolist(),
            "high": high.tolist(),
            "largest": float(outlook.largest[:, place].max()),
        }
    return {
        "t_s": outlook.now_s,
        "asked": [
            {"path": move.path, "before": answer.before[move.path], "to": move.to, "end_s": move.end_s}
            for move in answer.moves
        ],
        "times_s": outlook.times_s.tolist(),
        "courses": courses,
        "crossings": [
            {"signal": each.watched.signal, "quantity": each.watched.name, "level": each.level, "limit": each.limit}
            | {"unit": each.watched.unit, "probability": each.probability}
            | {name: getattr(each, name) for name in ("expected_s", "earliest_s", "latest_s")}
            for each in outlook.crossings()
        ],
    }
