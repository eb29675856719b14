"""Asks a running bench to change a quantity, and what would come if: SDO transfers with its node
(`hilbench.bench.operator.operator_objects`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, Final, TypeVar

from hilbench.apps.library.labels import user_name
from hilbench.apps.library.live_run import LiveRun
from hilbench.bench.machines.ranges import OPERATOR_OBJECTS, operator_ranges
from hilbench.bench.operator.operator_objects import INDEX
from hilbench.bench.prediction.create import foreseeable
from hilbench.bench.reports.change import Change
from hilbench.can.frame import Frame
from hilbench.canopen.data_types import DataType
from hilbench.canopen.object_store import PRESENT_STATE, VALUE_TOO_HIGH, VALUE_TOO_LOW
from hilbench.canopen.sdo_client import SdoAbortedError, SdoClient, SdoCommunicationError
from hilbench.errors import BusError, HilbenchError
from hilbench.prediction.outlook import Outlook
from hilbench.results.journal import append_to_journal
from hilbench.results.what_if import Question, from_frames, what_if
from hilbench.topology.config import BenchConfig
from hilbench.topology.main_quantities.of_kind import find_quantity
from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.quantities import MODEL_CHANGE
from hilbench.topology.web_line_quantities import TENSION_PROBE

#: How long the bench may take, s; in lockstep it answers with its next cycle.
PATIENCE_S: Final = 3.0
#: Probability from which a crossing to come is shown.
_LIKELY: Final = 0.5
#: Of all that is foreseen, tensions and torques are shown.
SHOWN_UNITS: Final = ("N", "N·m")

Answered = TypeVar("Answered", str, "Foreseen")


@dataclass(frozen=True)
class Switch:
    """Yes-or-no switch of a bench: path, key in the monitor, title, and the meaning of yes and no."""

    path: str
    key: str
    title: str
    yes: str
    no: str


PROBE: Final = Switch(TENSION_PROBE, "p", "probe", "move the tension a little, or allow it", "end or refuse it")
MODEL: Final = Switch(MODEL_CHANGE, "c", "model change", "the twin takes over the proposed model", "refuse it")


def switches(config: BenchConfig) -> Iterator[Switch]:
    """Switches of this bench."""
    if any(control.probes.mode != "off" for control in config.tension_controls.values()):
        yield PROBE
    if config.twin.live_diagnosis is not None:
        yield MODEL


class OperatorJournal:
    """Notes them in the run on a bus, where its folder is among `runs` on this machine; `channel` is the bus' name in a
    trace, `cycle_ns` the bench's cycle."""

    def __init__(self, runs: Path, channel: str, cycle_ns: int) -> None:
        self._runs, self._channel, self._cycle_ns = runs, channel, cycle_ns
        self._run: LiveRun | None = None
        self.who = f"{user_name('somebody')} (terminal)"

    def note(self, text: str, value: float = 0.0) -> None:
        """Somebody has done this now; without a run that is known it is nowhere noted.

        Raises UnusableInputError for a journal that can't be written.
        """
        if self._run is None or not self._run.continues:
            self._run = LiveRun.on(self._runs, self._channel)
        if (run := self._run) is not None:
            cycle = run.cycles(time.time_ns(), self._cycle_ns)
            append_to_journal(run.folder.journal, Change(cycle, "asked", text, value, who=self.who))


@dataclass(frozen=True)
class Foreseen:
    """Predicted outcome of a change: in a line, and its forecasts where it can be predicted."""

    text: str
    outlook: Outlook | None = None

    def __str__(self) -> str:
        return self.text


#: Notes what somebody has asked for, with its answer, and the value.
Note = Callable[[str, float], None]


def _nowhere(text: str, value: float) -> None:
    """Note nothing."""


class ChangeRequests:
    """Makes one request after the other, in a thread of its own; what each returns, and `ended`, says how it ended.

    Looking ahead takes a moment, and is done in another thread: no change waits for it. The bus is joined, by
    `open_client`, with the first request: until then a monitor only listens.
    """

    def __init__(self, config: BenchConfig, open_client: Callable[[], SdoClient]) -> None:
        self._config = config
        self._open_client = open_client
        self._client: SdoClient | None = None
        self._thread, self._ahead = ThreadPoolExecutor(1, "changes"), ThreadPoolExecutor(1, "ahead")
        self._on_bus = Lock()  # one transfer at a time: both threads have the same channel to the bench
        self._requests: list[Future[Any]] = []
        self._ranges = operator_ranges(config)
        known = map(find_quantity, self._ranges)
        self.changeable = {quantity.key: quantity for quantity in known if quantity is not None}  #: by key
        self.switches = {switch.key: switch for switch in switches(config)}  #: by key
        #: Those whose futures can be looked at, by key.
        self.foreseeable = {
            key: quantity for key, quantity in self.changeable.items() if quantity.path in foreseeable(config)
        }

    def ask(self, quantity: MainQuantity, value: float, note: Note = _nowhere) -> Future[str]:
        """Ask for a value, in the quantity's unit, as soon as those before it have been answered."""
        (low, high), unit = self.range_of(quantity), quantity.in_unit
        asked, expected = f"{quantity.title} {value:g} {unit}", f"{low:g} to {high:g} {unit}"
        set_si = value * quantity.si_per_shown
        return self._noted(self._submit(self._thread, self._write, quantity.path, asked, set_si, expected), value, note)

    def send(self, switch: Switch, on: bool, note: Note = _nowhere) -> Future[str]:
        """Answer yes or no, as soon as the request before has been answered."""
        asked = f"{switch.title}: {'yes' if on else 'no'}"
        return self._noted(
            self._submit(self._thread, self._write, switch.path, asked, float(on), "0 or 1"), float(on), note
        )

    @staticmethod
    def _noted(future: Future[str], value: float, note: Note) -> Future[str]:
        """The request, noted with its answer, also of who has left meanwhile."""
        future.add_done_callback(lambda ended: None if ended.cancelled() else note(ended.result(), value))
        return future

    def look_ahead(self, quantity: MainQuantity, value: float, frames: Sequence[Frame]) -> Future[Foreseen]:
        """Predict the outcome if the quantity went to a value, from the last frames received; nothing moves."""
        return self._submit(self._ahead, self._looked_ahead, quantity, value, frames)

    def _submit(self, thread: ThreadPoolExecutor, request: Callable[..., Answered], *values: Any) -> Future[Answered]:
        future = thread.submit(request, *values)
        self._requests.append(future)
        return future

    def ended(self) -> list[str]:
        """A line for each request that has ended since the last call."""
        done = [request for request in self._requests if request.done()]
        self._requests = [request for request in self._requests if request not in done]
        return [str(request.result()) for request in done if not request.cancelled()]

    def range_of(self, quantity: MainQuantity) -> tuple[float, float]:
        """Range that the bench accepts by its config, in the quantity's unit."""
        low, high = self._ranges[quantity.path]
        return low / quantity.si_per_shown, high / quantity.si_per_shown

    def close(self) -> None:
        """Leave the bus; what was not asked yet is not asked any more."""
        for thread in (self._thread, self._ahead):
            thread.shutdown(cancel_futures=True)
        if self._client is not None:
            self._client.close()

    def _write(self, path: str, asked: str, value: float, expected: str) -> str:
        """SI; `asked` and `expected`: how the value and what may be asked for are called."""
        node_id, data = self._config.master.node_id, DataType.REAL32.encode(value)
        try:
            with self._on_bus:
                self._joined().download(node_id, INDEX, OPERATOR_OBJECTS[path][0], data)
        except SdoAbortedError as error:
            return f"{asked}: refused, {_reason(error.code, expected)} (abort {error.code:08X}h)"
        except SdoCommunicationError:
            return f"{asked}: no answer from the bench (node {node_id})"
        except BusError as error:
            return f"{asked}: NOT SENT: {error}"
        return f"{asked}: set"

    def _looked_ahead(self, quantity: MainQuantity, value: float, frames: Sequence[Frame]) -> Foreseen:
        asked = f"what if {quantity.title} {value:g} {quantity.in_unit}"
        question = Question({quantity.path: value * quantity.si_per_shown})
        try:
            recording = from_frames(self._config, frames, self)
            outlook = what_if(self._config, recording, question, "now").outlook
        except HilbenchError as error:
            return Foreseen(f"{asked}: {error}")
        return Foreseen(f"{asked}: {wording(outlook)}", outlook)

    def upload(self, node_id: int, index: int, sub: int) -> bytes:
        """The content of an object (`hilbench.results.what_if.Reader`)."""
        with self._on_bus:
            return self._joined().upload(node_id, index, sub)

    def _joined(self) -> SdoClient:
        if self._client is None:
            self._client = self._open_client()
        return self._client


def wording(outlook: Outlook) -> str:
    """Tensions and torques to come, and the limits that are crossed more likely than not, in a line."""
    seconds = outlook.times_s[-1] - outlook.now_s
    parts = []
    for place, watched in enumerate(outlook.watched):
        if watched.unit in SHOWN_UNITS:
            low, _, high = outlook.band(place)
            parts.append(f"{watched.name} {low.min():.3g} to {high.max():.3g} {watched.unit}")
    parts += [crossing.expected_from(outlook.now_s) for crossing in outlook.crossings(_LIKELY)]
    return f"within {seconds:.3g} s {', '.join(parts)}"


def _reason(code: int, expected: str) -> str:
    if code in (VALUE_TOO_HIGH, VALUE_TOO_LOW):
        return f"expected {expected}"
    if code == PRESENT_STATE:
        return "the experiment moves it just now, or does not run"
    return str(SdoAbortedError.CODES.get(code, "unknown code"))
