"""Recovery of a run that was cut off (``kill -9``, power, a full disk), from what it left.

Its samples are in its folder, to the last (`hilbench.results.spool`). Where they are lost they are rebuilt from the
trace: it has every frame up to the last cycle or two, so what was measured and commanded is decoded from it as the
bench did, by the same nodes, and the tasks of the machine run on it again: what the load motor emulated is computed
anew from the measured motion. What no frame says (when the experiment began, set-points, changes of the emulated
machine) is in the journal. Commands come back in the resolution of the drives' units; all else is
exactly what the run had.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import nan
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.task import Outputs
from hilbench.can.frame import Frame
from hilbench.can.wire import frame_bits
from hilbench.canopen.identifiers import HEARTBEAT, SDO_ANSWER, SYNC, node_of
from hilbench.cia402.configuration import DriveSettings, default_reader
from hilbench.cia402.state_machine import State
from hilbench.cia402.units import DriveUnits
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.files import usable
from hilbench.machine_kinds import machine_part
from hilbench.results.journal import read_journal
from hilbench.results.junit import write_junit
from hilbench.results.recording import LEAST_SAMPLES, Recording, read_recording, write_pieces, write_recording
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.results.result import Environment, Fault, Result, Timing
from hilbench.results.run_folder import RunFolder
from hilbench.results.spool import SpooledPieces
from hilbench.results.trace import TraceReader
from hilbench.runs.config import ExperimentConfig, load
from hilbench.runs.criteria import evaluate
from hilbench.runs.events import journal_events
from hilbench.runs.metrics import judge
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import sample_type
from hilbench.topology.signal_kinds import TIME

_NANOSECOND = 1e-9


@dataclass
class CycleFrames:
    """The frames of one cycle: what the bench sent and received before its SYNC, and what it received after it."""

    sent: list[Frame] = field(default_factory=list)
    late: list[Frame] = field(default_factory=list)
    sync: Frame | None = None
    received: list[Frame] = field(default_factory=list)
    elapsed_cycles: int = 0  #: SYNCs until then for which there was no cycle


@dataclass(frozen=True)
class Recovery:
    """What was found of a run, beside its samples unless they are rebuilt."""

    started: datetime  #: time of the first SYNC
    samples: int
    missed: int
    bus_load_pct: float
    last_s: float
    source: str  #: where the samples are from
    fault: str = ""  #: what ended the run as far as its frames show it


@dataclass(frozen=True)
class Replayed(Recovery):
    """A rebuilt recording, and what was found with it."""

    recording: Recording = field(kw_only=True)


def recover_run(folder: RunFolder) -> list[Path]:
    """Write the recording and the result that a run folder lacks; returns what was written.

    Raises UnusableInputError when there is nothing to recover, or nothing to recover it from.
    """
    if folder.recording.exists():
        raise UnusableInputError(folder.recording, "there already, expected a run without recording")
    _require_ended(folder.trace)
    config, _ = load(folder.config)
    if folder.unfinished_recording.exists():
        ended: Recovery = _finish_recording(folder, config)
    else:
        ended = replay(config, folder)
        write_recording(ended.recording, folder.recording)
    written = [folder.recording]
    if not folder.result.exists():
        result = _result(config, folder, ended, read_journal(folder.journal) if folder.journal.exists() else [])
        result.write(folder.result)
        write_junit(result, config.name, ended.started, folder.junit)
        written += [folder.result, folder.junit]
    return written


def _finish_recording(folder: RunFolder, config: ExperimentConfig) -> Recovery:
    """Put what was not written yet into the recording. Raises UnusableInputError where that are less than two
    samples."""
    left, pieces = folder.unfinished_recording, SpooledPieces(folder, config.signals)
    samples, bits, last_s = pieces.rows, 0, 0.0
    if samples < LEAST_SAMPLES:
        raise UnusableInputError(left, f"{samples} sample(s), expected at least {LEAST_SAMPLES}")

    def counted() -> Iterator[Mapping[str, NDArray[Any]]]:
        nonlocal bits, last_s
        for piece in pieces:
            bits += int(np.sum(piece["bus_bits"]))
            last_s = float(piece[TIME][-1])
            yield piece

    write_pieces(pieces, counted(), folder.recording)
    left.unlink()
    for path in folder.waiting_rows():
        path.unlink()
    always = config.recording.full_rate == "always"
    cycles = round(last_s / config.cycle_time_s) + 1
    load_pct = 100.0 * bits / (config.bus.bitrate * config.cycle_time_s * samples)
    return Recovery(pieces.start, cycles, cycles - samples if always else 0, load_pct, last_s, "its samples")


def _require_ended(trace: Path) -> None:
    with usable(trace, "read", "a trace"), open(trace, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UnusableInputError(trace, "still being written, expected the trace of a run that has ended") from None


def _result(config: ExperimentConfig, folder: RunFolder, ended: Recovery, changes: list[Change]) -> Result:
    channels = read_recording(folder.recording).channels
    judged = judge(channels, journal=journal_events(changes, config.cycle_time_s))
    metrics = judged.metrics()
    timing = Timing.of(config, ended.samples, ended.missed, bus_load_pct=ended.bus_load_pct)
    text = f"the run was cut off; recovered from {ended.source}" + (f"; {ended.fault}" if ended.fault else "")
    fault = Fault(time_s=ended.last_s, source="bench", text=text)
    criteria = evaluate(config.criteria, metrics, judged)
    return Result.of(
        criteria, metrics, timing, [fault], Environment.here(config.seed), judged=judged, began=ended.started
    )


def replay(config: BenchConfig, folder: RunFolder) -> Replayed:
    """Decode the frames of a run as its bench did. Raises UnusableInputError for a trace that shows no two cycles."""
    changes = read_journal(folder.journal) if folder.journal.exists() else None
    return replay_frames(config, TraceReader(folder.trace), changes, folder.trace)


def replay_frames(
    config: BenchConfig,
    frames: Iterable[Frame],
    changes: list[Change] | None,
    place: str | Path,
    *,
    begun: bool = False,
) -> Replayed:
    """Decode the frames of a bench, in the order in which it saw them.

    `changes`: what no frame shows (None: not known); `begun`: the first frames are not those of the start.
    Raises UnusableInputError, which names the `place`, for frames that show no two cycles.
    """
    nodes = Nodes(config)
    cycles = _cycles(frames, nodes)
    configuration = next(cycles, CycleFrames())
    if config.pace == "realtime":
        cycles = _run_by_the_bench(cycles, nodes)
    take_units(nodes, configuration.received)
    rows = RecordingBuilder([signal.name for signal in config.signals])
    decoder = Decoder(config, nodes, changes, rows.append, begun=begun)
    bits, count, missed, last_ns, first_ns = 0, 0, 0, 0, 0
    fault = ""
    for cycle in _complete(cycles, nodes):
        assert cycle.sync is not None, "only the configuration has none"
        count += 1
        gap = round((cycle.sync.time_ns - last_ns) * _NANOSECOND / config.cycle_time_s) if last_ns else 1
        missed += max(0, gap - 1)
        last_ns = cycle.sync.time_ns
        first_ns = first_ns or last_ns
        try:
            bits += decoder.take(cycle)
        except BenchFaultError as error:
            fault = str(error)
            break
    fault = fault or decoder.fault
    if len(rows) < LEAST_SAMPLES:
        found = f"{len(rows)} cycle(s) with enabled drives"
        raise UnusableInputError(place, f"{found}, expected at least {LEAST_SAMPLES}")
    started = datetime.fromtimestamp(first_ns * _NANOSECOND, UTC)
    recording = rows.recording(started, config.description)
    load_pct = 100.0 * bits / (config.bus.bitrate * config.cycle_time_s * count)
    last_s = float(recording.time_s[-1])
    return Replayed(started, len(recording), missed, load_pct, last_s, "trace.log", fault, recording=recording)


class CycleSplitter:
    """Puts frames into cycles: first what came before the cyclic path (its last frames are the first cycle's), then
    cycle after cycle. `current` is what is not complete yet.

    What the bench sends for a cycle begins with the first RPDO of the first axis.
    """

    def __init__(self, nodes: Nodes) -> None:
        master_id = nodes.config.master.node_id
        self._own = {HEARTBEAT + master_id, SDO_ANSWER + master_id, *(pdo.cob_id for pdo in nodes.io.boundary)}
        self._own |= {cob_id for drive in nodes.drives for cob_id in drive.rpdo_cob_ids}
        self._first = nodes.axes[0].pdos.rpdo.cob_id
        self.current = CycleFrames()

    def take(self, frame: Frame) -> CycleFrames | None:
        """The next frame, in the order in which the bench saw it; the cycle that its SYNC has ended."""
        if frame.can_id != SYNC:
            self.current.received.append(frame)
            return None
        ended, received = self.current, self.current.received
        at = next((at for at in reversed(range(len(received))) if received[at].can_id == self._first), len(received))
        self.current = CycleFrames(sync=frame)
        for before in received[at:]:
            (self.current.sent if before.can_id in self._own else self.current.late).append(before)
        del received[at:]
        return ended


def _cycles(frames: Iterable[Frame], nodes: Nodes) -> Iterator[CycleFrames]:
    splitter = CycleSplitter(nodes)
    yield from (cycle for frame in frames if (cycle := splitter.take(frame)) is not None)
    yield splitter.current


def _run_by_the_bench(cycles: Iterator[CycleFrames], nodes: Nodes) -> Iterator[CycleFrames]:
    """Cycles that the bench ran: by the clock SYNC goes out without it, too. It sends set points with each that it
    runs a cycle for; what came at the others it has read as late in its next cycle."""
    set_points = nodes.axes[0].pdos.rpdo.cob_id
    late: list[Frame] = []
    elapsed_cycles = 0
    for cycle in cycles:
        if cycle.sent or any(frame.can_id == set_points for frame in cycle.received):
            cycle.late[:0], late, cycle.elapsed_cycles = late, [], elapsed_cycles
            yield cycle
        else:
            late += [*cycle.late, *cycle.received]
            elapsed_cycles += 1


def _complete(cycles: Iterator[CycleFrames], nodes: Nodes) -> Iterator[CycleFrames]:
    """Cycles without a last one that lacks the drives' answers."""
    needed = {pdo.cob_id for pdo in nodes.expected_pdos() if pdo.every == 1 and pdo.vital}
    before: CycleFrames | None = None
    for cycle in cycles:
        if before is not None:
            yield before
        before = cycle
    if before is not None and needed <= {frame.can_id for frame in before.received}:
        yield before


def take_units(nodes: Nodes, frames: Iterable[Frame]) -> None:
    """Units as the drives stated them by SDO when they were configured (expedited uploads); else by their EDS."""
    values: dict[tuple[int, int, int], bytes] = {}
    for can_id, data, _ in frames:
        node_id = node_of(can_id, SDO_ANSWER)
        if node_id and len(data) == 8 and data[0] & 0xE2 == 0x42:
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            values[node_id, int.from_bytes(data[1:3], "little"), data[3]] = data[4 : 4 + size]
    for drive in nodes.drives:
        settings, default = drive.settings, default_reader(drive.od, axis=drive.settings.axis)

        def read(
            index: int, sub: int, settings: DriveSettings = settings, default: object = default
        ) -> int | float | None:
            data = values.get((settings.node_id, settings.object(index), sub))
            return default(index, sub) if data is None else int.from_bytes(data, "little")  # type: ignore[operator]

        drive.units = DriveUnits.from_objects(read, drive.settings.units, drive.settings.name)


class Decoder:
    """Takes cycle after cycle; `keep` gets a row of all signals for each sample of the enabled bench.

    `changes` may grow meanwhile; `cycles`: how many there were before the first that is taken. Frames are read by the
    bench's own nodes, and the tasks of the machine run on them as they did on the bench: what they make of the same
    samples and the same changes is the same again.
    """

    def __init__(
        self,
        config: BenchConfig,
        nodes: Nodes,
        changes: Sequence[Change] | None,
        keep: Callable[[Sequence[float]], None],
        *,
        begun: bool = False,
        cycles: int = 0,
    ) -> None:
        names = [signal.name for signal in config.signals]
        self._keep = keep
        self.fault = ""  #: what a watch of the machine found
        self._row = attrgetter(*names)
        self._nodes = nodes
        self._changes = changes
        self._next_change = 0
        self._state = BenchState(config.cycle_time_s, sample_type(config.signals)(), _nobody, _nobody)
        self._state.sample.cycle = cycles
        self._machine: MachineTasks = machine_part(config.machine.kind, "tasks")(config, self._state)
        self._machine.warm_up()
        self._watches = list(self._machine.watches)
        unit = config.machine.position_unit
        self._commands = [
            (axis, f"v{number}_cmd_{unit}_s", 1.0 / config.machine.motor_rad_per_unit(number))
            for number, axis in enumerate(nodes.axes, 1)
        ]
        shown = {*nodes.filled, *(name for _, name, _ in self._commands)}
        #: What nobody knows without the journal: it follows from what the experiment has changed.
        self._unknown = [
            signal.name
            for signal in config.signals
            if signal.group == "truth"
            or (signal.group in ("command", "load") and not signal.integer and signal.name not in shown)
        ]
        self._first: int | None = None
        self._joins_twin = begun  # which counts SYNCs from before the first frame

    def take(self, cycle: CycleFrames) -> int:
        """Decode one cycle; returns the bits on the bus. Raises BenchFaultError as the bench did."""
        state, nodes = self._state, self._nodes
        sample = state.sample
        self._apply_changes(sample.cycle)
        outputs = Outputs()
        for task in self._machine.control:
            (task.before if state.enabled else task.rest)(sample, outputs)
        if self._first is not None:
            self._take_commands(cycle.sent)
        sample.cycle += 1
        nodes.decode([*cycle.late, *cycle.received], len(cycle.late), cycle.elapsed_cycles)
        nodes.fill(sample)
        if self._joins_twin and nodes.twin_reported_cycle:
            state.twin.started_cycle, self._joins_twin = nodes.twin_started(nodes.twin_reported_cycle), False
        sample.twin_age_cycles = nodes.twin_age(sample.cycle - state.twin.started_cycle)
        sync = cycle.sync
        sample.bus_bits = sum(map(frame_bits, [*cycle.sent, *cycle.late, *cycle.received, *([sync] if sync else [])]))
        if state.enabled:
            sample.t_s = state.experiment_time_s(sample.cycle)
            self._follow()
        elif (
            self._changes is None
            and self._first is None
            and all(drive.feedback.state is State.OPERATION_ENABLED for drive in nodes.drives)
        ):
            self._enable(sample.cycle)
        return sample.bus_bits

    def _enable(self, cycle: int) -> None:
        """The experiment begins with the cycle after this one."""
        self._first = self._state.first_cycle = cycle + 1
        self._state.enabled = True

    def _apply_changes(self, cycle: int) -> None:
        """Apply what the bench did before the cycle after `cycle`."""
        changes = self._changes or []
        while self._next_change < len(changes) and changes[self._next_change].cycle <= cycle:
            self._apply(changes[self._next_change])
            self._next_change += 1

    def _apply(self, change: Change) -> None:
        twin = self._state.twin
        if change.what == "enabled":
            self._enable(change.cycle)
        elif change.what == "stopping":
            self._state.enabled = False
        elif change.what == "twin_lost":
            twin.away = True
            self._nodes.twin_is_away()
        elif change.what == "twin_back":
            twin.away, twin.back_cycle = False, change.cycle
            twin.started_cycle = round(change.value) or change.cycle
            self._nodes.twin_is_back()
        elif change.what == "set":
            owner = next((each for each in self._machine.quantities if each.owns(change.path)), None)
            if owner is not None:  # an effect of the simulated hardware shows in its frames
                owner.set(change.path, change.value)

    def _take_commands(self, sent: Iterable[Frame]) -> None:
        """Commands as they were sent to the drives."""
        data = {frame.can_id: frame.data for frame in sent}
        for axis, name, units_per_rad in self._commands:
            content = data.get(axis.pdos.rpdo.cob_id)
            if content is not None and len(content) == axis.pdos.rpdo.size:
                _, target = axis.pdos.rpdo.unpack(content)
                setattr(self._state.sample, name, target * axis.units.velocity_rad_s * units_per_rad)

    def _follow(self) -> None:
        """The tasks on a sample of the experiment, and its row."""
        sample = self._state.sample
        for task in self._machine.control:
            task.after(sample, self._nodes)
        try:
            for watch in self._watches:
                watch.after(sample, self._nodes)
        except BenchFaultError as error:  # the bench stopped the drives; the journal says from which cycle on
            self.fault, self._watches = str(error), []
        if self._changes is None:
            for name in self._unknown:
                setattr(sample, name, nan)
        self._keep(self._row(sample))


def _nobody(_: object) -> None:
    """Nobody listens: what a bench announces and notes was said when it ran."""
