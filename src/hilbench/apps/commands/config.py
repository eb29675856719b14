"""`hilbench config schema|new`: help with config files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from hilbench.apps.commands.new_bench import SERVO_AXIS, Place, Question
from hilbench.apps.commands.new_web_line import WEB_LINE
from hilbench.errors import UnusableInputError
from hilbench.files import write_whole
from hilbench.plant.effect import MachineKind

if TYPE_CHECKING:
    from hilbench.strict_yaml import Document

app = typer.Typer(help="Help with config files: JSON Schema for editors, a new config.", no_args_is_help=True)

#: Defaults without a question, by kind of machine.
_GIVEN = Path(__file__).with_name("new_benches")
#: Questions for every bench: text, place in the config, what is suggested.
_QUESTIONS: tuple[Question, ...] = (
    ("name of the bench", ("name",), "my_bench"),
    ("bus (embedded: of the folder; embedded:NAME, socketcan:can0, …)", ("bus", "address"), "embedded"),
    ("bit rate in bit/s", ("bus", "bitrate"), 1_000_000),
    ("pace (lockstep: reproducible; realtime: by the wall clock)", ("pace",), "lockstep"),
    ("cycle time in s", ("cycle_time_s",), 0.002),
)
#: Further ones by kind of machine, and the EDS file of the twin's virtual I/O.
_OF_KIND: Mapping[MachineKind, tuple[Sequence[Question], str]] = {
    MachineKind.WEB_LINE: (WEB_LINE, "hilbench_virtual_io.eds"),
    MachineKind.SERVO_AXIS: (SERVO_AXIS, "hilbench_virtual_io_servo_axis.eds"),
}


@app.command()
def schema(out: Annotated[Path | None, Option(help="file; standard output without it")] = None) -> None:
    """Write the JSON Schema of a bench config, with which an editor completes and checks keys.

    In the config's first line: # yaml-language-server: $schema=bench.schema.json

    Example: hilbench config schema --out bench_configs/bench.schema.json
    """
    from json import dumps

    from hilbench.runs.config_text import json_schema

    text = dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
    if out is None:
        print(text, end="")
    else:
        write_whole(out, text)


@app.command()
def new(
    path: Annotated[Path, Argument(metavar="FILE", help="config to write; must not exist")],
    eds: Annotated[
        Path | None,
        Option(
            help="folder with the EDS files of the simulated devices",
            show_default="eds; those of hilbench are copied there if need be",
        ),
    ] = None,
    kind: Annotated[MachineKind, Option(help="of the machine")] = MachineKind.WEB_LINE,
    defaults: Annotated[bool, Option("--defaults", help="ask nothing: what would be suggested")] = False,
) -> None:
    """Configuration wizard: write a checked bench of simulated drives, with a comment at every key that needs one.

    Each answer is checked as it is given, and asked for again when it can't be used; what is suggested fits the answers
    before.

    Example: hilbench config new my_bench.yaml
    """
    from hilbench import strict_yaml
    from hilbench.bench.check import check_bench
    from hilbench.runs.config import ExperimentConfig
    from hilbench.runs.config_text import commented_yaml

    if path.exists():
        raise UnusableInputError(path, "is there already, expected a new file")
    if not path.absolute().parent.is_dir():
        raise UnusableInputError(path, f"no folder {path.parent}, expected one to write into")
    of_kind, virtual_io = _OF_KIND[kind]
    given = strict_yaml.load(_GIVEN / f"{kind}.yaml").data
    document = _with_eds(strict_yaml.Document(path, given, {(): str(path)}), virtual_io, eds)
    questions, answered = (*_QUESTIONS, *of_kind), set[Place]()
    document = _with_suggestions(document, questions, answered)
    while True:
        if not defaults:
            document = _asked(document, questions, answered)
        config = strict_yaml.validate(document, ExperimentConfig)
        try:
            check_bench(config, document)
            break
        except UnusableInputError as error:
            if defaults:
                raise
            typer.echo(f"{error}\nOnce more; Return keeps an answer.", err=True)
    write_whole(path, commented_yaml(config, path.resolve().parent))
    print(f"{path}: usable; run it with: hilbench run {path}")


def _with_eds(document: Document, virtual_io: str, eds: Path | None) -> Document:
    """The document with the EDS files of its nodes, of the folder that was given."""
    from hilbench.runs.examples import EDS, copy_eds

    files = {place: virtual_io if place[0] == "twin" else "hilbench_servo.eds" for place in _nodes(document.data)}
    if eds is None:
        eds = Path(EDS)
        copy_eds(sorted(set(files.values())), Path())
    for place, name in files.items():
        if not (file := eds / name).is_file():
            raise UnusableInputError("--eds", f"no file {file}, expected the folder with the devices' EDS files")
        document = document.with_value((*place, "eds"), str(file.resolve()), "--eds")
    return document


def _nodes(data: Mapping[str, Any], at: Place = ()) -> Iterator[Place]:
    """Places of the nodes in a config."""
    if "node_id" in data:
        yield at
    for key, below in data.items():
        if isinstance(below, Mapping):
            yield from _nodes(below, (*at, key))


def _with_suggestions(document: Document, questions: Sequence[Question], answered: set[Place]) -> Document:
    """The document with what is suggested wherever nobody has answered, one after the other."""
    for question, location, suggested in questions:
        if location not in answered:
            value = suggested(document.value) if callable(suggested) else suggested
            document = document.with_value(location, value, question or str(document.path))
    return document


def _asked(document: Document, questions: Sequence[Question], answered: set[Place]) -> Document:
    """The document with an answer to every question, each added to `answered`; what it has already is suggested."""
    from hilbench import strict_yaml
    from hilbench.runs.config import ExperimentConfig

    for question, location, _ in questions:
        while question:
            suggested = document.value(location)
            value = _answer(question, suggested, type(suggested))
            tried = document.with_value(location, value, question)
            try:
                strict_yaml.validate(tried, ExperimentConfig)
            except UnusableInputError as error:
                typer.echo(str(error), err=True)
                continue
            answered.add(location)
            document = _with_suggestions(tried, questions, answered)
            break
    return document


def _answer(question: str, suggested: Any, kind: type) -> Any:
    try:
        return typer.prompt(question, default=suggested, type=kind)
    except typer.Abort as ended:  # the end of standard input, or Ctrl-C
        if isinstance(ended.__context__, KeyboardInterrupt):
            raise ended.__context__ from ended
        raise UnusableInputError(
            "standard input", f"ended at the question '{question}', expected an answer, or --defaults"
        ) from ended
