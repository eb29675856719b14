"""State of a bench by the frames on its bus; fed by a listener, sends nothing.

No outdated value is shown: while the bench does not run, and of a silent node, there is none.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
from itertools import chain
from math import isinf, nan
from typing import Any

import numpy as np

from hilbench.apps.canopen_tools.bus_scan import nmt_states
from hilbench.can.frame import EXTENDED_FLAG, Frame
from hilbench.can.wire import frame_bits
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.canopen.identifiers import EMERGENCY, HEARTBEAT, NMT, SYNC, NmtCommand, node_of
from hilbench.cia402 import objects
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.object_units import si_unit
from hilbench.cia402.state_machine import State, decode_statusword
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.addressing import declared_units
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.timeliness import Timeliness
from hilbench.machine_kinds import machine_part
from hilbench.topology.config import BenchConfig
from hilbench.topology.main_quantities.of_kind import main_quantities
from hilbench.topology.main_quantities.quantity import OF_THE_MODEL
from hilbench.topology.parts import Role
from hilbench.topology.signals import Shape, unit_of
from hilbench.twin.virtual_io import TwinStatus

_POINTS = 240
#: Cycles over which bus load and jitter are counted.
_WINDOW = 500
#: Cycles without an answer after which a node is not late, but silent.
_SILENT_CYCLES = 50
_FAULTS_KEPT = 100
#: Times in a row that a PDO or heartbeat may stay away before what it said is old.
_MISSED = 25
_HEARTBEATS_MISSED = 4
#: Share of late answers from which on a participant is shown.
_WORTH_SHOWING = 0.005
#: Cycles whose frames are kept: so many say what would come if (`hilbench.results.what_if.SYNCS`).
_RECENT = 200
#: Name of the twin's status among its values.
_STATUS = "twin_status"


_ALL = 0
#: With it a bench begins.
START_ALL = bytes((NmtCommand.START, _ALL))
#: NMT commands with which a bench lets its nodes go: stop, enter PRE-OPERATIONAL.
_LET_GO = (NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL)
#: Wall time without a SYNC, or without anything of a node, after which what it said is old.
SILENCE_S = 1.0


class Condition(Enum):
    """Condition of a bench in the words of the monitor."""

    NOT_RECEIVED = "not received"
    RUNNING = "running"
    STALE = "STALE"
    ENDED = "ENDED"
    EMERGENCY_STOP = "E-STOP"


@dataclass
class Trend:
    """One signal of the twin: its name in a recording, and its title for display."""

    signal: str
    title: str
    unit: str
    si_per_unit: float = 1.0
    deviation: str = ""  #: the signal of its standard deviation, of an estimate
    stated: float = nan  #: that, as the twin last stated it, SI
    values: deque[float] = field(default_factory=lambda: deque(maxlen=_POINTS))  #: SI

    @property
    def is_of_the_model(self) -> bool:
        """True if the value is the model's, as it is not identifiable (infinite deviation)."""
        return isinf(self.stated)

    @property
    def heading(self) -> str:
        """The title with what it is, where it is no estimate."""
        return f"{self.title} {OF_THE_MODEL}" if self.is_of_the_model else self.title

    @property
    def shown(self) -> list[float]:
        """The values in the unit."""
        return [value / self.si_per_unit for value in self.values]


def trends_of(kind: str, shape: Shape) -> list[Trend]:
    """Trends of the signals that a machine's twin sends with every SYNC, in the order of its PDOs."""
    known = {each.twin_signal: each for each in main_quantities(kind, shape) if each.twin_signal}
    trends = []
    for carried in machine_part(kind, "topology").process_data(shape).state:
        name, quantity = carried.name, known.get(carried.name)
        if quantity is None:
            trends.append(Trend(name, name, unit_of(name)))
        else:
            title, unit = quantity.of or quantity.short, quantity.in_unit
            trends.append(Trend(name, title, unit, quantity.si_per_shown, quantity.twin_deviation))
    return trends


@dataclass
class NodePicture:
    """One participant as it last showed itself; SI, drives at the motor shaft."""

    part: str
    node_id: int
    nmt_state: str | None = None
    drive_state: str | None = None
    statusword: int | None = None
    velocity_rad_s: float | None = None
    torque_Nm: float | None = None
    position_rad: float | None = None
    stale: bool = False  #: it has been received, and is not any more

    def forget(self) -> None:
        """Discard the last values, which are outdated."""
        self.drive_state = self.statusword = None
        self.velocity_rad_s = self.torque_Nm = self.position_rad = None


@dataclass
class _Received:
    """Last reception: in which cycle, and at which time of the monotonic clock, s."""

    cycle: int
    time_s: float
    within_cycles: float  #: in so many the next one should be received


@dataclass(frozen=True)
class FaultNote:
    """A fault: in which cycle (SYNCs received so far), where, what."""

    cycle: int
    part: str
    text: str


@dataclass
class BusPicture:
    """Picture of one bench; `take` adds received frames."""

    config: BenchConfig
    cycles: int = 0  #: SYNCs received of this run
    faults: deque[FaultNote] = field(default_factory=lambda: deque(maxlen=_FAULTS_KEPT))
    every: int = 25  #: cycles between two points of a trend

    def __post_init__(self) -> None:
        nodes = Nodes(self.config)
        self.trends = trends_of(self.config.machine.kind, self.config.shape)  #: what the twin says
        contents = zip(nodes.io.sent, nodes.io.data.sent, strict=True)
        #: What the twin sends, with the names of the values in it; and the last values by these.
        self._twin = {pdo.cob_id: (pdo, [signal.name for signal in content.signals]) for pdo, content in contents}
        self._twin[nodes.io.status.cob_id] = nodes.io.status, ["", "", _STATUS]
        self._said: dict[str, float] = {}
        self._tpdos: dict[int, tuple[NodePicture, Any, tuple[int, ...], DriveUnits]] = {}
        parts = self.config.parts
        self.nodes = {part.name: NodePicture(part.name, part.node.node_id) for part in parts}
        for part in parts:
            if part.role is Role.VIRTUAL_IO:
                continue
            units = declared_units(part)
            for pdo in nodes.pdo_maps(part.name)[1:]:  # what it sends
                self._tpdos[pdo.cob_id] = (self.nodes[part.name], pdo, mapped_objects(pdo), units)
        self._answers = {
            part.name: nodes.pdo_maps(part.name)[1].cob_id
            for part in parts
            if part.role in (Role.AXIS, Role.LOAD_MOTOR)
        }
        self._answers["virtual_io"] = nodes.io.status.cob_id
        self._ages = dict.fromkeys(self._answers, 0)
        self.timeliness = Timeliness(tuple(self._answers), self.config.cycle_time_s)
        self._answered: set[int] = set()  # since the last SYNC
        self._bits: deque[int] = deque([0], maxlen=_WINDOW)
        self._sync_ns: deque[int] = deque(maxlen=_WINDOW)
        self._recent: deque[list[Frame]] = deque([[]], maxlen=_RECENT)  # from one SYNC to the next
        self._new_faults: deque[FaultNote] = deque(maxlen=_FAULTS_KEPT)
        self._bench_heartbeat = HEARTBEAT + self.config.master.node_id
        self._now_s = time.monotonic()
        self._sync_s: float | None = None  # when the last SYNC was received, and anything of the bench, s
        self._master_s: float | None = None
        self._ended: Condition | None = None
        self._received: dict[
            tuple[int | str, str], _Received
        ] = {}  # by node, and what: PDOs, heartbeat, the twin's answer
        self._heartbeat_cycles = self.config.master.node_heartbeat_ms * 1e-3 / self.config.cycle_time_s

    # -- received messages -----------------------------------------------------------------------------------

    def take(self, frames: Iterable[Frame], now_s: float | None = None) -> None:
        """Add frames in the order of reception, at `now_s` of the monotonic clock (now, if not given)."""
        self._now_s = time.monotonic() if now_s is None else now_s
        last: dict[int, bytes] = {}
        heartbeats: list[Frame] = []
        for frame in frames:
            self._bits[-1] += frame_bits(frame)
            if frame.can_id == SYNC:
                self._recent.append([])
            self._recent[-1].append(frame)
            if frame.can_id & EXTENDED_FLAG:
                continue
            if frame.can_id == NMT and len(frame.data) == 2:
                self._command(*frame.data)
            elif frame.can_id == EMERGENCY_STOP_COB_ID:
                self._ended = Condition.EMERGENCY_STOP
            elif frame.can_id == SYNC:
                self._sync(frame)
            elif node_of(frame.can_id, EMERGENCY):
                self._emergency(frame)
            elif frame.can_id > HEARTBEAT:
                heartbeats.append(frame)
                if frame.can_id == self._bench_heartbeat:
                    self._master_s = self._now_s
            else:
                self._answered.add(frame.can_id)
                last[frame.can_id] = frame.data
                if frame.can_id in self._twin:
                    self._take_twin(frame)
        self._decode(last)
        for node_id, state in nmt_states(heartbeats).items():
            self._mark_received(node_id, "heartbeat", _HEARTBEATS_MISSED * self._heartbeat_cycles)
            self._nmt(node_id, state)
        self._look_for_silence()

    def _command(self, command: int, node_id: int) -> None:
        if command == NmtCommand.START:
            self._ended = None
            if node_id == _ALL:  # a bench begins
                self.cycles = 0
                self._received.clear()
        elif command in _LET_GO and node_id == _ALL and self._ended is None and self._sync_s is not None:
            self._ended = Condition.ENDED

    def recent_frames(self) -> list[Frame]:
        """Frames of the last cycles, in the order in which they were received."""
        return list(chain.from_iterable(self._recent))

    def _take_twin(self, frame: Frame) -> None:
        """Take values of the twin; a batch of frames may end between them and the SYNC after them."""
        pdo, names = self._twin[frame.can_id]
        if len(frame.data) == pdo.size:
            self._said.update(zip(names, pdo.unpack(frame.data), strict=True))
            if pdo.period == 1 and _STATUS not in names:
                self._mark_received(self.config.twin.node.node_id, "PDO", _MISSED)
            for trend in self.trends:
                trend.stated = self._said.get(trend.deviation, nan)

    @property
    def model(self) -> str:
        """Model of the twin, where it is another than the configured one (2100h sub 3)."""
        status = int(self._said.get(_STATUS, 0))
        changed = "model with what was found" if status & TwinStatus.MODEL_CHANGED else ""
        return "another model is evaluated" if status & TwinStatus.MODEL_CHANGING else changed

    def _mark_received(self, who: int | str, what: str, within_cycles: float) -> None:
        """Note that a message was received. `who`: a node by its id, or a part by its name."""
        self._received[who, what] = _Received(self.cycles, self._now_s, within_cycles)

    def _look_for_silence(self) -> None:
        """Discard the values of nodes that are silent."""
        running = self.condition is Condition.RUNNING
        for part, node in self.nodes.items():
            said = {what: received for (who, what), received in self._received.items() if who in (part, node.node_id)}
            silent = {what for what, received in said.items() if self._is_silent(received, running=running)}
            node.stale = bool(silent)
            if not running or "PDO" in silent:
                node.forget()
            if "heartbeat" in silent:
                node.nmt_state = None

    def _is_silent(self, received: _Received, *, running: bool) -> bool:
        """True if a sender is silent by the clock, and while SYNC runs by cycles as well: in lockstep these may be
        slow."""
        if self._now_s - received.time_s <= SILENCE_S:
            return False
        return not running or self.cycles - received.cycle > received.within_cycles

    @property
    def condition(self) -> Condition:
        """Condition of the bench when frames were last taken."""
        if self._ended is not None:
            return self._ended
        if self._sync_s is None:
            return Condition.NOT_RECEIVED
        return Condition.RUNNING if self._now_s - self._sync_s <= SILENCE_S else Condition.STALE

    @property
    def condition_text(self) -> str:
        """The condition with what is known of it."""
        alive = self._master_s is not None and self._now_s - self._master_s <= SILENCE_S
        why = "the bench pauses" if alive else "nothing of the bench either"
        known = {
            Condition.EMERGENCY_STOP: ": an emergency stop was received, nodes are not started again yet",
            Condition.ENDED: ": the bench has let its nodes go",
            Condition.STALE: f": no SYNC for {self._now_s - (self._sync_s or 0.0):.0f} s, {why}",
            Condition.NOT_RECEIVED: ": no SYNC on this bus yet (a run --in-process is on none)",
        }
        return f"{self.condition.value}{known.get(self.condition, '')}"

    @property
    def twin_is_alive(self) -> bool:
        """True if the twin's values are current."""
        received = self._received.get((self.config.twin.node.node_id, "PDO"))
        running = self.condition is Condition.RUNNING
        return running and received is not None and not self._is_silent(received, running=running)

    def _sync(self, frame: Frame) -> None:
        self._sync_s = self._now_s
        if self._ended is Condition.ENDED:
            self._ended = None  # another master released nodes: the bench goes on
        if self.cycles:
            self._look_at_answers()
        self.cycles += 1
        self._bits.append(0)
        self._sync_ns.append(frame.time_ns)
        if self.cycles % self.every == 0 and all(trend.signal in self._said for trend in self.trends):
            for trend in self.trends:
                trend.values.append(self._said[trend.signal])

    def _look_at_answers(self) -> None:
        """Update the age of each node's answer to SYNC; a node that sends nothing at all is not late."""
        for part, cob_id in self._answers.items():
            if cob_id in self._answered:
                self._ages[part] = 0
            elif self._ages[part] < _SILENT_CYCLES:
                self._ages[part] += 1
        self.timeliness.update(tuple(age % _SILENT_CYCLES for age in self._ages.values()))
        self._answered.clear()

    def _decode(self, last: dict[int, bytes]) -> None:
        for cob_id, (node, pdo, indices, units) in self._tpdos.items():
            data = last.get(cob_id)
            if data is not None and len(data) == pdo.size:
                self._mark_received(node.part, "PDO", _MISSED * pdo.period)
                self._show(node, dict(zip(indices, pdo.unpack(data), strict=True)), units)

    def _show(self, node: NodePicture, raw: dict[int, int | float], units: DriveUnits) -> None:
        def si(index: int, before: float | None) -> float | None:
            unit = si_unit(index, units)
            return raw[index] * unit[0] if index in raw and unit is not None else before

        node.torque_Nm = si(objects.TORQUE_ACTUAL_VALUE, node.torque_Nm)
        node.velocity_rad_s = si(objects.VELOCITY_ACTUAL_VALUE, node.velocity_rad_s)
        node.position_rad = si(objects.POSITION_ACTUAL_VALUE, node.position_rad)
        if objects.STATUSWORD in raw:
            node.statusword = int(raw[objects.STATUSWORD])
            state = decode_statusword(node.statusword)
            label = state.label if state is not None else "unknown"
            if state in (State.FAULT, State.FAULT_REACTION_ACTIVE) and label != node.drive_state:
                self._note(node.part, label)
            node.drive_state = label

    def _emergency(self, frame: Frame) -> None:
        node_id = frame.can_id - EMERGENCY
        if len(frame.data) >= 3:
            code = int.from_bytes(frame.data[:2], "little")
            part = " and ".join(node.part for node in self._on(node_id)) or f"node {node_id}"
            self._note(part, f"EMCY {code:04X}h, register {frame.data[2]:02X}h" if code else "EMCY: no error any more")

    def _nmt(self, node_id: int, state: str) -> None:
        for node in self._on(node_id):
            if node.nmt_state == "OPERATIONAL" and state != "OPERATIONAL":
                self._note(node.part, f"left OPERATIONAL: {state}")
                node.forget()  # it sends no PDOs any more
            node.nmt_state = state

    def _on(self, node_id: int) -> list[NodePicture]:
        """The parts of a node."""
        return [node for node in self.nodes.values() if node.node_id == node_id]

    def _note(self, part: str, text: str) -> None:
        self.faults.append(FaultNote(self.cycles, part, text))
        self._new_faults.append(self.faults[-1])

    def new_faults(self) -> list[FaultNote]:
        """Faults since the last call, as far as they are kept."""
        new = [*self._new_faults]
        self._new_faults.clear()
        return new

    # -- figures ---------------------------------------------------------------------------------------------

    @property
    def bus_load(self) -> float | None:
        """Share of the wire's time that the last whole cycles took; None before there were any."""
        whole = list(self._bits)[1:-1]
        capacity_bits = self.config.bus.bitrate * self.config.cycle_time_s
        return float(np.mean(whole)) / capacity_bits if whole else None

    def jitter_us(self) -> tuple[float, float] | None:
        """99th percentile and largest deviation of the time between two SYNCs from the cycle; None in lockstep."""
        if self.config.pace == "lockstep" or len(self._sync_ns) < 2:
            return None
        late_us = np.abs(np.diff(np.array(self._sync_ns, np.int64)) - self.config.cycle_ns) / 1000.0
        return float(np.percentile(late_us, 99)), float(late_us.max())

    def late_pct(self) -> dict[str, float]:
        """Share of recent cycles in which each part was late, %, where worth showing."""
        return {part: 100 * each.lately for part, each in self.timeliness.of.items() if each.lately > _WORTH_SHOWING}

    def as_data(self) -> dict[str, Any]:
        """The picture for machines."""
        jitter = self.jitter_us()
        return {
            "condition": self.condition.value,
            "condition_text": self.condition_text,
            "cycles": self.cycles,
            "bus_load_pct": None if self.bus_load is None else 100 * self.bus_load,
            "jitter_p99_us": jitter and jitter[0],
            "jitter_max_us": jitter and jitter[1],
            "late_samples_pct": self.late_pct(),
            "model": self.model or "as configured",
            "of_the_model": [trend.signal for trend in self.trends if trend.is_of_the_model],
            **{
                trend.signal: trend.values[-1] if trend.values and self.twin_is_alive else None for trend in self.trends
            },
            "nodes": [vars(node) for node in self.nodes.values()],
            "faults": [vars(note) for note in self.faults],
        }
