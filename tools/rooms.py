"""Draw the rooms of hilbench by the layers of the import contracts: ``python tools/rooms.py docs/images/rooms.svg``."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
APPS, DATA, CYCLE, BUS, MACHINE = "#f1f1f1", "#f7ebf3", "#fdf3e3", "#eef3f8", "#e8f4ec"
#: Colour of a room of the core, and what it is about. Apps are many in a row: their names say it.
ROOMS: Final = {
    "live": (DATA, "diagnosis while the bench runs"),
    "diagnosis": (DATA, "what a model lacks: predict, propose, select, verdict"),
    "results": (DATA, "trace, journal, recording, result, run folder, recovery"),
    "runs": (DATA, "experiment files: steps, tables, criteria, metrics"),
    "bench": (CYCLE, "lifecycle, cycle, tasks"),
    "in_process_cycle": (CYCLE, "cycles without events in one process, compiled"),
    "hardware": (CYCLE, "simulated drives on their plant"),
    "twin": (CYCLE, "virtual axes, virtual I/O, estimation"),
    "fast_path": (CYCLE, "such a cycle on arrays; its part in each process"),
    "exchange": (CYCLE, "SYNC, set points out, measurements in"),
    "topology": (CYCLE, "config, parts, signals, quantities"),
    "cia402": (BUS, "drive objects, simulated drive"),
    "estimation": (MACHINE, "balances, filters, detectors"),
    "prediction": (MACHINE, "futures, limits to come"),
    "control": (MACHINE, "control laws of bench and prediction"),
    "canopen": (BUS, "device runtime, master, PDO codec"),
    "plant": (MACHINE, "machines, effects, motors, sensors"),
    "can": (BUS, "embedded bus, SocketCAN, python-can"),
}
_NOT_DRAWN: Final = {"__main__", "apps"}
_LEFT, _WIDTH, _HEIGHT, _GAP = 20, 780, 48, 10
_BELOW: Final = "A room imports only from rooms below it. The machine (green) knows nothing of a bus. Grey: apps."


def layers(container: str) -> Iterator[list[str]]:
    """Rooms of a container by layer, from the top; the single modules below all are left out."""
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = config["tool"]["importlinter"]["contracts"]
    for layer in next(each["layers"] for each in contracts if each.get("containers") == [container]):
        if ":" not in layer and layer not in _NOT_DRAWN:
            yield layer.split(" | ")


def picture() -> str:
    """The drawing as SVG: a row of boxes a layer."""
    rows = [*layers("hilbench.apps"), *layers("hilbench")]
    height = _GAP + len(rows) * (_HEIGHT + _GAP) + 40
    boxes = "\n".join(box for at, row in enumerate(rows) for box in _row(row, _GAP + at * (_HEIGHT + _GAP)))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 820 {height}" width="820" height="{height}" '
        'font-family="sans-serif" font-size="13"><title>The rooms of hilbench: each imports only from those below it'
        f'</title><rect width="820" height="{height}" fill="white"/>\n{boxes}\n'
        f'<text x="{_LEFT}" y="{height - 16}" font-size="12" fill="#39424c">{_BELOW}</text></svg>\n'
    )


def _row(names: list[str], top: int) -> Iterator[str]:
    width = (_WIDTH - _GAP * (len(names) - 1)) / len(names)
    for at, name in enumerate(names):
        left = _LEFT + at * (width + _GAP)
        colour, about = ROOMS.get(name, (APPS, ""))
        middle, line = f'x="{left + width / 2:g}" text-anchor="middle"', top + (20 if about else 29)
        yield (
            f'<rect x="{left:g}" y="{top}" width="{width:g}" height="{_HEIGHT}" rx="4" fill="{colour}" '
            f'stroke="#4a5560"/><text {middle} y="{line}" font-weight="bold">{name}</text>'
            + (f'<text {middle} y="{top + 37}" font-size="11.5" fill="#39424c">{escape(about)}</text>' if about else "")
        )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(), encoding="utf-8")
