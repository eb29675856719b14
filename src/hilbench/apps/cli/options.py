"""Options that several commands share, and how they print what `--json` asks for."""

from __future__ import annotations

from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from hilbench.errors import UnusableInputError

ConfigArgument = Annotated[Path, Argument(metavar="CONFIG", help="bench config (YAML)")]
ConfigOption = Annotated[
    Path | None, Option("--config", help="bench config (YAML): names of the nodes, their EDS files, the bus")
]
BusOption = Annotated[
    str | None,
    Option(
        "--bus",
        help="embedded:NAME, socketcan:vcan0, or another python-can interface:channel; embedded alone is the bus of "
        "the config's folder or, without a config, the only one that runs",
    ),
]
PaceOption = Annotated[str | None, Option("--pace", help="lockstep or realtime")]
PacedByOption = Annotated[
    str, Option("--pace", help="realtime: by the clock; lockstep: by SYNC of a bench in lockstep")
]
SetOption = Annotated[
    list[str] | None,
    Option("--set", metavar="KEY=VALUE", help="another value in the config, e.g. machine.web.width_m=0.6; repeatable"),
]
ModelOption = Annotated[
    Path | None,
    Option("--model", help="model file, or a bench config with the model in it (YAML); a bench has its own"),
]
JsonOption = Annotated[bool, Option("--json", help="print JSON on standard output, nothing else")]
EdsOption = Annotated[
    Path, Option("--eds", help="EDS file, or folder in which that of the device is found by its identity")
]
NodeArgument = Annotated[str, Argument(metavar="NODE", help="node id, or with --config its name: axis1, bench")]
ForceOption = Annotated[
    bool, Option("--force", help="also with another master on the bus (a running bench, foreign SYNC or NMT)")
]
#: Where no --timeout is given, s.
SDO_TIMEOUT_S = 1.0
TimeoutOption = Annotated[float, Option("--timeout", metavar="S", min=0.01, help="for the answer to each SDO request")]
OutOption = Annotated[Path, Option("--out", help="folder in which the run folder is made")]
RunsOption = Annotated[Path, Option("--runs", metavar="DIR", help="folder with the run folders")]
RunArgument = Annotated[Path, Argument(metavar="RUN", help="run folder")]


def key_and_number(option: str, text: str, expected: str) -> tuple[str, float]:
    """Key and number of ``KEY=NUMBER``. Raises UnusableInputError for another text, or a number that is not finite."""
    key, _, number = text.partition("=")
    with suppress(ValueError):
        if key.strip() and isfinite(value := float(number)):
            return key.strip(), value
    raise UnusableInputError(option, f"'{text}', expected {expected}")


def print_json(data: object, *, ensure_ascii: bool = True) -> None:
    """Print data as JSON on standard output, indented: dataclasses by their fields, bytes as hexadecimal digits, paths
    as texts; `ensure_ascii` is that of `json.dumps`."""
    from json import dumps

    print(dumps(data, indent=2, ensure_ascii=ensure_ascii, default=_plain))


def _plain(value: Any) -> Any:
    return value.hex() if isinstance(value, bytes) else str(value) if isinstance(value, Path) else vars(value)
