"""The index of the runs in a folder: one JSON file of what the run folders say, made again whenever it can't be used.

Nothing is only there: all data of a run are in its folder, tags and notes as well. A folder is opened again when it,
its result or its labels have changed; otherwise a listing looks at three times of change a run. Several processes may
use it at a time: the file is replaced as a whole, and what the last one did not know is read again. Where the folder
can't be written, nothing is kept.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, get_args

import yaml
from pydantic import Field, ValidationError

from hilbench.block import Strict
from hilbench.errors import UnusableInputError, one_line
from hilbench.files import content, written_whole
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import CriterionResult, RunVerdict, verdict_of

State = RunVerdict | Literal["unfinished", "running"]
STATES: Final[tuple[State, ...]] = (*get_args(RunVerdict), "unfinished", "running")
_TIME_IN_NAME: Final = re.compile(r"-(\d{8}-\d{6})(?:-\d+)?$")
_TOP_LEVEL: Final = re.compile(r"^(name|description|stand|seed|pace):.*\n(?:[ \t].*\n)*", re.MULTILINE)
_LARGEST_SEED: Final = 2**63
#: A time that has a date, s since 1970.
_LATEST_S: Final = 250e9
#: Bytes of a file in a run folder, at most.
_MOST_BYTES: Final = 16_000_000
_LOADER: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class RunEntry(Strict):
    """A run. `path`: of its folder, from the library's; `began_s`: since 1970, UTC; `size_bytes` of all its files.

    `state`: passed; failed (a criterion); completed (nothing was judged); fault; interrupted; unfinished (it was cut
    off before it had a result), or running. `met` of `criteria` criteria. `settings`: what options gave in place of the
    config's own values. `problem`: what could not be read.
    """

    path: str = Field(serialization_alias="run")
    bench: str
    began_s: float = Field(serialization_alias="began")
    state: State = Field(default="unfinished", serialization_alias="result")
    met: int = Field(default=0, serialization_alias="criteria_met")
    criteria: int = 0
    duration_s: float | None = None
    description: str = ""
    stand: str = ""
    pace: str = ""
    seed: int | None = None
    config: str = ""
    host: str = ""
    commit: str = ""
    fault: str = ""
    size_bytes: int = 0
    has_report: bool = Field(default=False, serialization_alias="report")
    tags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""
    metrics: dict[str, float] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)
    verdicts: tuple[CriterionResult, ...] = ()

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.path.rpartition("/")[2]

    @property
    def began(self) -> str:
        """Local time at which it began: ``2026-11-22 18:51:05``."""
        return datetime.fromtimestamp(self.began_s).strftime("%Y-%m-%d %H:%M:%S")

    @property
    def verifies(self) -> bool:
        """True if any of its criteria verifies a requirement."""
        return any(each.verifies for each in self.verdicts)

    @property
    def held(self) -> str:
        """Number of its criteria that held, "" of none: ``2/3``."""
        return f"{self.met}/{self.criteria}" if self.criteria else ""

    @property
    def set_values(self) -> str:
        """Settings by options: ``seed=7, pace=lockstep``."""
        return ", ".join(f"{key}={value}" for key, value in self.settings.items())

    def as_data(self) -> dict[str, Any]:
        """Data for a program; times in ISO 8601, UTC."""
        began = datetime.fromtimestamp(self.began_s, UTC).isoformat(timespec="seconds")
        return self.model_dump(mode="json", by_alias=True, exclude={"verdicts"}) | {"began": began}


def read_entry(base: Path, path: str) -> RunEntry:
    """The run in the folder `base`/`path`. What can't be read is a `problem` of the entry: never raises for it."""
    folder = RunFolder(base / path)
    problems = [] if folder.path.is_dir() else ["there is no folder of this name, or its name is no UTF-8"]
    about = _mapping(folder.config, _top_of_config, problems)
    result, labels = (_mapping(path, json.loads, problems, optional=True) for path in (folder.result, folder.labels))
    known = {
        "path": path,
        "bench": str(about.get("name") or folder.path.name),
        "began_s": min(max(_began_s(folder, result), 0.0), _LATEST_S),
        "description": str(about.get("description") or ""),
        "stand": str(about.get("stand") or about.get("name") or ""),
        "pace": str(about.get("pace") or ""),
        "seed": seed if isinstance(seed := about.get("seed"), int) and abs(seed) < _LARGEST_SEED else None,
        "size_bytes": _size(folder.path),
        "has_report": folder.report.exists(),
    }
    try:
        labelled = {
            "tags": tuple(map(str, labels.get("tags", ()))),
            "notes": tuple(f"{note['time']} {note['by']}: {note['text']}" for note in labels.get("notes", ())),
        }
        of_result = _of_result(result) if result else {}
        return RunEntry.model_validate({**known, **labelled, **of_result, "problem": "; ".join(problems)})
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        problems.append(f"not understood ({one_line(error)})")
        return RunEntry.model_validate({**known, "problem": "; ".join(problems)})


def _top_of_config(read: bytes) -> Any:
    """The few values at the top of a config that distinguish runs: the rest of it takes long to parse."""
    return yaml.load("".join(match[0] for match in _TOP_LEVEL.finditer(read.decode(errors="replace"))), _LOADER)


def _mapping(
    path: Path, parse: Callable[[bytes], object], problems: list[str], *, optional: bool = False
) -> dict[str, Any]:
    """Content of a file, where it can be kept and shown: escapes may be of characters that no text has."""
    try:
        found = parse(content(path, _MOST_BYTES, kept=True))
    except (OSError, UnusableInputError, yaml.YAMLError, ValueError, RecursionError) as error:
        if not (optional and isinstance(error, FileNotFoundError)):
            problems.append(f"{path.name}: {one_line(error)}")
        return {}
    try:
        json.dumps(found, ensure_ascii=False, default=str).encode()
    except (ValueError, RecursionError):  # among them UnicodeEncodeError
        problems.append(f"{path.name}: characters that UTF-8 does not have")
        return {}
    return found if isinstance(found, dict) else {}


def _of_result(result: Mapping[str, Any]) -> dict[str, Any]:
    criteria, faults = result["criteria"], result["faults"]
    provenance, timing = result.get("provenance") or {}, result["timing"]
    return {
        "state": verdict_of(faults[0]["source"] if faults else None, judged=bool(criteria), passed=result["passed"]),
        "duration_s": timing["cycles"] * timing["cycle_us"] * 1e-6,
        "met": sum(bool(each["passed"]) for each in criteria),
        "criteria": len(criteria),
        "config": str(provenance.get("config") or ""),
        "host": str(provenance.get("host") or ""),
        "commit": f"{git['commit']}{'+' if git['changed'] else ''}" if (git := provenance.get("git")) else "",
        "fault": str(faults[0]["text"]) if faults else "",
        "metrics": {
            name: float(value) for name, value in result["metrics"].items() if value is not None and isfinite(value)
        },
        "settings": {each["key"]: each["value"] for each in provenance.get("overridden", ())},
        "verdicts": criteria,
    }


def _began_s(folder: RunFolder, result: Mapping[str, Any]) -> float:
    """Start time by the result; of older runs, and those without one, the time in the name, or of the config's file."""
    try:
        return datetime.fromisoformat(result["began"]).timestamp()
    except (KeyError, TypeError, ValueError, OverflowError, OSError):
        pass
    found = _TIME_IN_NAME.search(folder.path.name)
    try:
        return datetime.strptime(found[1], "%Y%m%d-%H%M%S").timestamp() if found else folder.config.stat().st_mtime
    except (ValueError, OverflowError, OSError):
        return 0.0


def _size(path: Path) -> int:
    """Size of all files in a folder, bytes."""
    total = 0
    with suppress(OSError):  # somebody removes it now
        for below, _, names in os.walk(path):
            for name in names:
                total += os.lstat(f"{below}/{name}").st_size
    return total


#: Its name in the folder of the runs.
FILE: Final = ".runs.json"
#: Folders below that of the runs in which runs are looked for (sweeps have theirs deeper).
_DEEPEST: Final = 4
#: From so many folders that are to be read on, a line announces that it takes a while.
_MANY: Final = 300


class _Kept(NamedTuple):
    """A run as its folder had it when it had this stamp."""

    stamp: str
    entry: RunEntry


class _Runs(Strict):
    """Content of the file: the runs by their paths."""

    version: Literal[4] = 4  #: another one with each change of `RunEntry`
    runs: dict[str, _Kept] = Field(default_factory=dict)


def runs_in(base: Path, announce: Callable[[str], None]) -> list[RunEntry]:
    """Runs in a folder as they are now, the newest first. `announce` gets a line when many folders are to be read."""
    known = _read(base / FILE)
    found = dict(_run_folders(base, known))
    kept = {path: known[path] for path, stamp in found.items() if path in known and known[path].stamp == stamp}
    changed = found.keys() - kept.keys()
    if len(changed) >= _MANY:
        announce(f"{base}: reading {len(changed)} runs into the index")
    kept |= {path: _Kept(found[path], read_entry(base, path)) for path in changed}
    if changed or known.keys() - found.keys():
        with suppress(UnusableInputError), written_whole(base / FILE) as partial:
            partial.write_bytes(_Runs(runs=kept).model_dump_json().encode())
    return sorted((each.entry for each in kept.values()), key=lambda run: (run.began_s, run.path), reverse=True)


def _read(path: Path) -> dict[str, _Kept]:
    with suppress(OSError, ValidationError):
        return _Runs.model_validate_json(path.read_bytes()).runs
    return {}


def _run_folders(base: Path, known: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Path and stamp of each run folder below `base`; links are not followed."""
    waiting = [("", 1)]
    known = {*known}
    while waiting:
        below, depth = waiting.pop()
        try:
            with os.scandir(base / below) as found:
                entries = list(found)
        except OSError:  # it has gone, or is somebody else's
            continue
        for entry in entries:
            if entry.name.startswith(".") or not entry.is_dir(follow_symlinks=False):
                continue
            path = f"{below}{entry.name}"
            shown = os.fsencode(path).decode(errors="backslashreplace")  # what is no UTF-8 can't be kept
            if shown in known or is_run(entry.path):
                stamp = _stamp(entry.path)
                if stamp is not None:
                    yield shown, stamp
            elif depth < _DEEPEST:
                waiting.append((f"{path}/", depth + 1))


def is_run(path: str | Path) -> bool:
    """True if a folder is that of a run: a config, and something that only a run leaves."""
    return os.path.isfile(f"{path}/config.yaml") and any(
        os.path.isfile(f"{path}/{name}") for name in ("trace.log", "result.json", "journal.log", "recording.mf4")
    )


def _stamp(path: str) -> str | None:
    """Changes when the run folder has changed; None when it is none any more."""
    try:
        stamp = str(os.stat(path).st_mtime_ns)
    except OSError:
        return None
    for name in ("result.json", "labels.json"):
        try:
            found = os.stat(f"{path}/{name}")
        except OSError:
            stamp += ",-"
        else:
            stamp += f",{found.st_mtime_ns}.{found.st_size}"
    return stamp
