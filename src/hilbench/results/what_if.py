"""Predictions of what would come if something were commanded of a machine now: futures from a run's recording, from
what a run that still goes on has written, or from the last cycles received of a bench on a bus."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from types import SimpleNamespace
from typing import Final, Protocol, cast

import numpy as np

from hilbench.bench.machines.ranges import OPERATOR_OBJECTS
from hilbench.bench.operator.operator_objects import INDEX
from hilbench.bench.prediction.create import foreseeable, look_of
from hilbench.bench.prediction.task import Look
from hilbench.bench.prediction.window import CYCLES, Hindsight, Window
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.data_types import DataType
from hilbench.canopen.identifiers import SYNC
from hilbench.canopen.sdo_client import SdoAbortedError, SdoCommunicationError
from hilbench.errors import UnusableInputError
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.outlook import Outlook
from hilbench.prediction.plan import Asked, Move, Plan
from hilbench.results.recording import Recording, check_recording, read_section
from hilbench.results.recover import replay, replay_frames
from hilbench.results.run_folder import RunFolder
from hilbench.results.spool import read_running
from hilbench.topology import quantities
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample


@dataclass(frozen=True)
class Question:
    """Question to a prediction: values by path, SI, reached within `over_s` (None: the machine's reference at the rate
    at which the bench itself moves it, all else at once); how far and in how many futures to look; when (experiment
    time, s; None: as late as possible)."""

    values: Mapping[str, float]
    over_s: float | None = None
    horizon_s: float = 10.0
    futures: int = 64
    at_s: float | None = None


@dataclass(frozen=True)
class Answer:
    """The outlook with the commanded values, and those before, by path."""

    outlook: Outlook
    moves: tuple[Move, ...]
    before: Mapping[str, float]


def recorded(folder: RunFolder, config: BenchConfig, at_s: float | None) -> Recording:
    """The recording of a run around a time (None: its end), or what was recorded of it by now, else what its trace has.

    Raises UnusableInputError for a run that has none of them.
    """
    if folder.unfinished_recording.exists():
        return read_running(folder, config.signals)
    if not folder.recording.exists():
        return replay(config, folder).recording
    recording = read_section(folder.recording, inf if at_s is None else at_s)
    check_recording(recording, folder.recording)
    return recording


def what_if(config: BenchConfig, recording: Recording, question: Question, place: str) -> Answer:
    """Look ahead from a recording of a bench.

    Raises UnusableInputError for a machine that can't be predicted, a quantity that can't be asked for, and a time at
    which the present is not known well enough; `place` names the recording.
    """
    require_predictable(config, place)
    for path, value in question.values.items():
        check_asked(config, path, value)
    look = look_of(config, PredictionConfig(horizon_s=question.horizon_s, futures=question.futures))
    row = _row(look, recording, question.at_s, place)
    window = Window(look.signals)
    for at in range(row - CYCLES, row + 1):
        window.add(_sample(recording, at))
    now_s = float(recording.time_s[row])
    before = {path: float(recording[signal][row]) for path, signal in foreseeable(config).items()}
    unknown = [path for path, value in before.items() if not isfinite(value) and path in question.values]
    if unknown:
        raise UnusableInputError(place, f"nothing defines what {unknown[0]} is now, expected the journal of the run")
    before = {path: value for path, value in before.items() if isfinite(value)}
    moves = tuple(
        Move(path, now_s, now_s + _lasts_s(config, path, before[path], value, question.over_s), value)
        for path, value in question.values.items()
    )
    plan = Plan(tuple(each for move in moves for each in look.moves_of(move)))
    run, outlook = look.prepare(now_s, window, Hindsight(len(look.watched)), Asked(before, plan), config.seed, row)
    run()
    return Answer(outlook(), moves, before)


def require_predictable(config: BenchConfig, place: str) -> None:
    """Raise UnusableInputError for a machine whose futures nobody can run."""
    if not foreseeable(config):
        raise UnusableInputError(place, f"a machine of kind {config.machine.kind}, which brings no prediction")


def check_asked(config: BenchConfig, path: str, value: float) -> None:
    """Raise UnusableInputError for what is no quantity whose future is known, or a value that it can't have."""
    known = foreseeable(config)
    if path not in known:
        raise UnusableInputError("--set", f"'{path}', expected one of {', '.join(known)}")
    allowed = quantities.permitted(path)
    if not allowed.holds(value):
        raise UnusableInputError("--set", f"{path} is {value:g}, expected {allowed}")


def _lasts_s(config: BenchConfig, path: str, before: float, to: float, over_s: float | None) -> float:
    if over_s is not None:
        return over_s
    return abs(to - before) / config.quick_stop_per_s2 if path in (quantities.LINE_SPEED, quantities.SPEED) else 0.0


def _sample(recording: Recording, row: int) -> CycleSample:
    values = {name: recording[name][row].item() for name in recording.channels}
    return cast("CycleSample", SimpleNamespace(**values))


#: So many of the last cycles are looked through for one in which the present is known.
_MOST_BACK: Final = 30_000


def _row(look: Look, recording: Recording, at_s: float | None, place: str) -> int:
    """The cycle to look ahead from: the one at a time, or the last one possible."""
    time_s = recording.time_s
    if at_s is not None and not time_s[0] <= at_s <= time_s[-1]:
        raise UnusableInputError("--at", f"{at_s:g} s, expected a time of the run: {time_s[0]:g} to {time_s[-1]:g} s")
    last = len(time_s) - 1 if at_s is None else int(np.searchsorted(time_s, at_s, side="right")) - 1
    least = CYCLES if at_s is None else max(CYCLES, last)
    for row in range(last, max(least, last - _MOST_BACK) - 1, -1):
        if all(look.ready(_sample(recording, at)) for at in (row, row - CYCLES)):
            return row
    when = "in this run" if at_s is None else f"at t = {at_s:g} s"
    raise UnusableInputError(place, f"{look.unready} {when}, expected a time at which the present is known")


#: SYNCs that are listened to, and for how long at most, s.
SYNCS: Final = 200
_LONGEST_S: Final = 5.0
_READ_S: Final = 0.05


class Reader(Protocol):
    """Reader of objects of other nodes (`hilbench.canopen.sdo_client.SdoClient`)."""

    def upload(self, node_id: int, index: int, sub: int) -> bytes:
        """The content of an object."""


def received(config: BenchConfig, link: Link, reader: Reader) -> Recording:
    """The last cycles of the bench that runs on this bus; its set points are read from its node.

    Raises UnusableInputError where none runs, or its drives are not enabled.
    """
    frames: list[Frame] = []
    syncs, until_s = 0, time.monotonic() + _LONGEST_S
    while syncs <= SYNCS and time.monotonic() < until_s:
        new = link.receive(_READ_S)
        frames += new
        syncs += sum(frame.can_id == SYNC for frame in new)
    return from_frames(config, frames, reader)


def from_frames(config: BenchConfig, frames: Sequence[Frame], reader: Reader) -> Recording:
    """Last cycles from frames received already, in their order. Raises as `received`."""
    place = f"bus {config.bus.address}"
    if not any(frame.can_id == SYNC for frame in frames):
        raise UnusableInputError(place, f"no SYNC within {_LONGEST_S:g} s, expected a bench that runs")
    return _with_asked(config, replay_frames(config, frames, None, place, begun=True).recording, reader)


def _with_asked(config: BenchConfig, recording: Recording, reader: Reader) -> Recording:
    """The recording with what no frame shows: set-points, E of the emulated web."""
    channels = dict(recording.channels)
    for path, signal in foreseeable(config).items():
        if path in OPERATOR_OBJECTS and np.isnan(channels[signal][-1]):
            try:
                data = reader.upload(config.master.node_id, INDEX, OPERATOR_OBJECTS[path][0])
            except (SdoAbortedError, SdoCommunicationError):
                continue  # the caller of such a signal gets the reason
            channels[signal] = np.full(len(recording.time_s), DataType.REAL32.decode(data))
    return Recording(channels)
