"""Findings of a run folder about the machine: estimates of the twin, effects found by a diagnosis of its recording.

Only what was estimated from measurements enters, never a value that a config gives: of a twin, what it held when it was
last in step with the machine; of a diagnosis, the parameters of the effects that it named, with the names of those that
its data could not distinguish from them; of a commissioning all that it measured.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from hilbench.apps.history.store import COMMISSIONING, Entry, History, Quantity, history_of
from hilbench.diagnosis.commissioning import Commissioned
from hilbench.errors import UnusableInputError, one_line
from hilbench.files import write_whole
from hilbench.json_file import JsonFile
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load
from hilbench.topology.config import BenchConfig
from hilbench.topology.signals import unit_of
from hilbench.twin.virtual_io import TwinStatus

#: What is estimated, by its symbol in the names of channels; E is of a web, with the number of the span where there are
#: several, all others are of a shaft.
_ESTIMATED: Final = {
    "E": "youngs_modulus",
    "J": "inertia",
    "coulomb": "coulomb_friction",
    "viscous": "viscous_friction",
}
_CHANNEL: Final = re.compile(rf"({'|'.join(_ESTIMATED)})([1-9]\d*)?_sim_(\w+)")
TWIN: Final = "twin"
DIAGNOSIS: Final = "diagnosis"
_NORMAL_95: Final = 1.959964
#: Parameters that say when or where in a turn, and not how much.
_PLACES: Final = ("phase_rad", "time_s", "duration_s")


class Commissioning(JsonFile):
    """File of a commissioning in its run folder."""

    described: ClassVar[str] = "what 'hilbench commission' has written"

    quantities: list[Quantity]


def place(effect: Mapping[str, Any]) -> str:
    """Place of an effect as a diagnosis writes it, in the path of a quantity."""
    if effect.get("axis"):
        return f"axis{effect['axis']}"
    return f"span{effect['span']}" if effect.get("span") else "web"


def remember(folder: RunFolder) -> Path | None:
    """Add a run's findings to the history of its stand; returns the file, None where nothing was found.

    Raises UnusableInputError for a folder that can't be read, or a history that can't be written.
    """
    config = load(folder.config)[0]
    found = list(entries_of(folder, config))
    if not found:
        return None
    path = history_of(config, folder.path.resolve().parent)
    History(path).add(*found)
    return path


def rebuild(path: Path, stand: str | None, runs: Path) -> list[str]:
    """Make a history, or one stand's part of it, from the run folders in `runs`.

    Returns a line for each folder that could not be read. Raises UnusableInputError for no folder `runs`.
    """
    if not runs.is_dir():
        raise UnusableInputError(runs, "no such folder, expected that in which the run folders are")
    entries: list[Entry] = []
    problems = []
    for config_file in sorted(runs.glob("*/config.yaml")):
        folder = RunFolder(config_file.parent)
        if not folder.recording.is_file():
            continue
        try:
            config = load(folder.config)[0]
            if stand is None or config.stand_name == stand:
                entries += entries_of(folder, config)
        except UnusableInputError as error:
            problems.append(str(error))
    History(path).replace_all(stand, entries)
    return problems


def entries_of(folder: RunFolder, config: BenchConfig) -> Iterator[Entry]:
    """Entries of a run: one for each source that found something. Raises UnusableInputError."""
    recording = read_recording(folder.recording)
    began = recording.start_time or datetime.fromtimestamp(folder.config.stat().st_mtime, UTC)
    followed = list(_of_twin(recording))
    # Of a twin that has never been in step with its machine nothing is believed.
    sources = {
        TWIN: [*followed, *(_beside(folder) if followed else ())],
        DIAGNOSIS: list(_of_diagnosis(folder)),
        COMMISSIONING: Commissioning.read(folder.commissioning).quantities if folder.commissioning.is_file() else [],
    }
    for source, quantities in sources.items():
        if quantities:
            yield Entry(config.stand_name, folder.name, source, began, folder.path.resolve(), quantities)


def keep_diagnosis(folder: RunFolder, diagnosis: Mapping[str, Any]) -> None:
    """Put a diagnosis of a run's recording (the object of `diagnose --json`) into its folder, and into the history.

    Raises UnusableInputError for what can't be written.
    """
    write_whole(folder.diagnosis, json.dumps(diagnosis, indent=2) + "\n")
    remember(folder)


def keep_commissioning(folder: RunFolder, found: Iterable[Commissioned]) -> list[Quantity]:
    """Put what a commissioning has measured into its run folder, and into the history; returns the quantities.

    Raises UnusableInputError for what can't be written.
    """
    quantities = [_quantity(one) for one in found]
    Commissioning(quantities=quantities).write(folder.commissioning)
    remember(folder)
    return quantities


def _quantity(one: Commissioned) -> Quantity:
    name = f"{place({'axis': one.axis, 'span': one.section})}.{one.effect}.{one.parameter}"
    return Quantity(name, one.value, one.deviation, one.unit, ", ".join(one.tied_with))


def _of_twin(recording: Recording) -> Iterator[Quantity]:
    """The estimates that the twin held when it was last synchronized."""
    if "twin_status" not in recording:
        return
    status = np.asarray(recording["twin_status"]).astype(np.int64)
    good = (status & int(TwinStatus.SYNCHRONIZED) != 0) & (
        status & int(TwinStatus.NOT_SEPARABLE | TwinStatus.HOLDING) == 0
    )
    if not good.any():
        return
    last = int(np.flatnonzero(good)[-1])
    for name in recording.channels:
        match = _CHANNEL.fullmatch(name)
        if match is None or (deviation := f"{match[1]}{match[2] or ''}_sd_{match[3]}") not in recording:
            continue
        values = np.asarray(recording[name], np.float64)
        sd = np.asarray(recording[deviation], np.float64)[last]
        if np.isfinite(values[last]) and np.isfinite(sd) and np.ptp(values[good]) > 0.0:
            of = place({"span": match[2]}) if match[1] == "E" else "shaft"
            estimated = f"{of}.{_ESTIMATED[match[1]]}_{match[3]}"
            yield Quantity(estimated, float(values[last]), float(sd), unit_of(name))


def _beside(folder: RunFolder) -> Iterator[Quantity]:
    """Errors of its model that the twin has found and could distinguish, from the result of a run."""
    if not folder.result.is_file():
        return
    for each in Result.read(folder.result).estimated or ():
        if each.separable:
            sd = (each.ci95[1] - each.ci95[0]) / (2.0 * _NORMAL_95)
            tied = ", ".join(each.tied_with)
            yield Quantity(f"{each.place}.{each.effect}.{each.parameter}", each.value, sd, each.unit, tied)


def _of_diagnosis(folder: RunFolder) -> Iterator[Quantity]:
    """The parameters of the effects that were named, from the diagnosis in a run folder."""
    if not folder.diagnosis.is_file():
        return
    try:
        found = json.loads(folder.diagnosis.read_text(encoding="utf-8"))
        for effect in [*found["effects"], *found["nuisance"]]:
            where, tied = place(effect), ", ".join(effect["tied_with"])
            for name, parameter in effect["parameters"].items():
                low, high = parameter["ci95"]
                sd, value = (float(high) - float(low)) / (2.0 * _NORMAL_95), float(parameter["value"])
                if name not in _PLACES and np.isfinite([sd, value]).all() and sd >= 0.0:
                    yield Quantity(f"{where}.{effect['effect']}.{name}", value, sd, str(parameter["unit"]), tied)
    except (OSError, ValueError, KeyError, TypeError) as error:
        text = f"is no diagnosis ({one_line(error)}), expected what diagnose has written"
        raise UnusableInputError(folder.diagnosis, text) from error
