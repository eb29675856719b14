"""The dashboard of the monitor: a terminal program that reads its link a few times a second.

It sends nothing but what a key asks for and a second key confirms: an emergency stop, a change of the running bench,
yes or no to what it proposes, and to look ahead a question of its present values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from math import floor, log10
from textwrap import wrap
from typing import Any, ClassVar

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.css.query import NoMatches
from textual.screen import ModalScreen
from textual.validation import Number
from textual.widgets import DataTable, Footer, Input, Log, Sparkline, Static

from hilbench.apps.monitor.changes import ChangeRequests, OperatorJournal
from hilbench.apps.monitor.picture import BusPicture, Condition, NodePicture, Trend
from hilbench.can.link import Link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP, send_emergency_stop
from hilbench.errors import BusError, UnusableInputError
from hilbench.topology.main_quantities.quantity import MainQuantity

_READ_S = 0.05
_DRAW_S = 0.25
_COLUMNS = ("node", "part", "NMT", "drive", "statusword", "velocity rad/s", "torque N·m")


#: A trend that is never larger is written with more decimals.
_SMALL = 10.0

#: Columns in which a line is shown at least.
_NARROWEST = 20
_WHAT_IF_KEY = "w"
_STOP_KEY = "e"
_STOP_HINT = f"{_STOP_KEY}: EMERGENCY STOP"


class _Dialogue(ModalScreen[Any]):
    """Asks for one of some answers, each by its key; Esc gives none."""

    def __init__(self, text: str, answers: Mapping[str, object]) -> None:
        super().__init__()
        self._text = text
        for key, answer in {"escape": None, **answers}.items():
            self._bindings.bind(key, f"dismiss({answer!r})")

    def compose(self) -> ComposeResult:
        """The question."""
        yield Static(self._text, classes="dialogue")


class _StopQuestion(_Dialogue):
    """Confirmation of the emergency stop; the key that asked for it means yes as well."""

    def __init__(self) -> None:
        super().__init__(f"Stop every device on the bus?\ny or {_STOP_KEY}: STOP   n: no", {"y": True, "n": None})


class _Number(Input):
    """A field for a number, without an exponent: that letter is the emergency stop's here, too."""

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """True for keys that are text; the others' bindings act."""
        return key != _STOP_KEY and super().check_consume_key(key, character)


class _NewValue(_Dialogue):
    """Asks for a number."""

    def __init__(self, text: str, low: float, high: float, unit: str) -> None:
        super().__init__(f"{text} in {unit} ({low:g} to {high:g}); Esc leaves it", {})
        self._range = Number(low, high)

    def compose(self) -> ComposeResult:
        """The field."""
        with Vertical(classes="dialogue"):
            yield Static(f"{self._text}\n{_STOP_HINT}")
            yield _Number(type="number", validators=[self._range], valid_empty=True)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Return ends it where the value may be asked for; an empty field changes nothing."""
        if not event.value:
            self.dismiss(None)
        elif event.validation_result is None or event.validation_result.is_valid:
            self.dismiss(float(event.value))


class Dashboard(App[None]):
    """Trends of the twin's signals, the nodes with their decoded states, bus load, jitter and faults."""

    CSS = """
    #condition { height: 1; padding: 0 1; background: $error; text-style: bold; }
    #condition.running { display: none; }
    #figures { height: 1; background: $panel; padding: 0 1; }
    #trends { height: 9; }
    #trends Vertical { width: 1fr; padding: 0 1; }
    Sparkline { height: 6; }
    #nodes { height: 9; }
    #faults { height: 1fr; border-top: solid $panel; }
    ModalScreen { align: center middle; }
    .dialogue { width: 70; max-width: 100%; height: auto; padding: 1 2; background: $panel; border: solid $warning; }
    """
    TITLE = "hilbench monitor"
    ENABLE_COMMAND_PALETTE = False  # a dialogue that would take the key of the emergency stop for text
    #: The first is what a narrow footer still shows; with priority it comes before every dialogue and field.
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(_STOP_KEY, "emergency_stop", "EMERGENCY STOP", priority=True),
        ("q", "quit", "quit"),
    ]

    def __init__(
        self, picture: BusPicture, link: Link, changes: ChangeRequests, operator_journal: OperatorJournal
    ) -> None:
        super().__init__()
        self._operator_journal = operator_journal
        self._picture = picture
        self._link = link
        self._changes = changes
        for key, quantity in changes.changeable.items():
            self.bind(key, f"change('{key}')", description=quantity.title)
        for key, switch in changes.switches.items():
            self.bind(key, f"switch('{key}')", description=switch.title)
        if changes.foreseeable:
            self.bind(_WHAT_IF_KEY, "what_if", description="what if")

    def compose(self) -> ComposeResult:
        """The widgets."""
        yield Static(id="condition")
        yield Static(id="figures")
        with Horizontal(id="trends"):
            for trend in self._picture.trends:
                with Vertical():
                    yield Static(id=f"{trend.signal}-value")
                    yield Sparkline([], id=trend.signal)
        yield DataTable(id="nodes", show_cursor=False)
        yield Log(id="faults")
        yield Footer()

    def on_mount(self) -> None:
        """Columns, and what is done again and again."""
        self.query_one("#nodes", DataTable).add_columns(*_COLUMNS)
        self.set_interval(_READ_S, self._read)
        self.set_interval(_DRAW_S, self._draw)
        self._draw()

    # -- what keys ask for ---------------------------------------------------------------------------------

    def action_emergency_stop(self) -> None:
        """Stop everything on the bus, once it is confirmed; a dialogue that is open gives way."""
        while isinstance(self.screen, ModalScreen):
            if isinstance(self.screen, _StopQuestion):
                self.screen.dismiss(True)
                return
            self.screen.dismiss(None)
        self._ask(_StopQuestion(), self._stop)

    def action_change(self, key: str) -> None:
        """Ask for a new value, and whether it is meant."""
        quantity = self._changes.changeable[key]
        self._ask(self._new_value(quantity, quantity.title), partial(self._confirm, quantity))

    def _ask(self, dialogue: _Dialogue, act: Callable[[Any], object]) -> None:
        """Show a dialogue; its answer, unless it has none, goes to `act`."""

        def answered(answer: object) -> None:
            if answer is not None:
                act(answer)

        self.push_screen(dialogue, answered)

    def _new_value(self, quantity: MainQuantity, text: str) -> _NewValue:
        return _NewValue(text, *self._changes.range_of(quantity), quantity.in_unit)

    def _confirm(self, quantity: MainQuantity, value: float) -> None:
        text = f"Set {quantity.title} to {value:g} {quantity.in_unit}?\ny: yes   n: no   {_STOP_HINT}"
        answers = {"y": True, "n": None}
        self._ask(_Dialogue(text, answers), lambda _: self._changes.ask(quantity, value, self._note))

    def action_switch(self, key: str) -> None:
        """Ask for yes or no, and send it to the bench."""
        switch = self._changes.switches[key]
        text = f"{switch.title}?\ny: {switch.yes}\nn: {switch.no}\nEsc leaves it   {_STOP_HINT}"
        answers = {"y": True, "n": False}
        self._ask(_Dialogue(text, answers), lambda on: self._changes.send(switch, on, self._note))

    def action_what_if(self) -> None:
        """Ask of what, and for which value, to look ahead; nothing is sent that moves anything."""
        lines = [f"{key}: {quantity.title}" for key, quantity in self._changes.foreseeable.items()]
        text = "\n".join(["What if another", *lines, f"Esc leaves it   {_STOP_HINT}"])
        self._ask(_Dialogue(text, {key: key for key in self._changes.foreseeable}), self._of_what)

    def _of_what(self, key: str) -> None:
        quantity = self._changes.foreseeable[key]
        dialogue = self._new_value(quantity, f"What if {quantity.title} went to a value")
        self._ask(dialogue, lambda value: self._changes.look_ahead(quantity, value, self._picture.recent_frames()))

    def _stop(self, _: object) -> None:
        try:
            send_emergency_stop(self._link)
            self._picture.take(EMERGENCY_STOP)  # a link does not receive what it sends
            self._notify("emergency stop sent")
        except BusError as error:
            self._notify(f"EMERGENCY STOP NOT SENT: {error}")
            return
        self.run_worker(partial(self._note, "emergency stop"), thread=True)

    def _note(self, text: str, value: float = 0.0) -> None:
        """Into the journal; not in the dashboard's own thread, a trace may be long."""
        try:
            self._operator_journal.note(text, value)
        except UnusableInputError as error:
            self.call_from_thread(self._notify, str(error))

    def _notify(self, text: str) -> None:
        self._write([f"cycle {self._picture.cycles}  monitor: {text}"])

    def _write(self, texts: Iterable[str]) -> None:
        """Whole, however narrow the terminal is."""
        log = self.query_one("#faults", Log)
        width = max(log.scrollable_content_region.width, _NARROWEST)
        log.write_lines([line for text in texts for line in wrap(text, width, subsequent_indent="  ")])

    # -- received frames -----------------------------------------------------------------------------------

    def _read(self) -> None:
        self._picture.take(self._link.receive(0.0))
        for text in self._changes.ended():
            self._notify(text)

    def _draw(self) -> None:
        with suppress(NoMatches):  # when the program ends, its widgets go before its timers
            self._draw_widgets()

    def _draw_widgets(self) -> None:
        picture = self._picture
        condition = self.query_one("#condition", Static)
        condition.set_class(picture.condition is Condition.RUNNING, "running")
        condition.update(picture.condition_text)
        self.query_one("#figures", Static).update(_figures(picture, self._link.dropped))
        for trend in picture.trends:
            self._draw_trend(trend)
        nodes = self.query_one("#nodes", DataTable)
        nodes.clear()
        for node in picture.nodes.values():
            nodes.add_row(*_row(node, picture.condition))
        self._write(f"cycle {note.cycle}  {note.part}: {note.text}" for note in picture.new_faults())

    def _draw_trend(self, trend: Trend) -> None:
        # A sparkline starts at 0: what matters is how the signal moves above its least value.
        values = trend.shown
        least = min(values, default=0.0)
        self.query_one(f"#{trend.signal}", Sparkline).data = [value - least for value in values]
        picture = self._picture
        if not values:
            now = Condition.NOT_RECEIVED.value
        elif picture.twin_is_alive:
            largest = max(map(abs, values))
            form = f".{1 if largest >= _SMALL or largest == 0.0 else 2 - floor(log10(largest))}f"
            now = f"{values[-1]:{form}} {trend.unit}  ({least:{form}} to {max(values):{form}})"
        else:
            now = (Condition.STALE if picture.condition is Condition.RUNNING else picture.condition).value
        self.query_one(f"#{trend.signal}-value", Static).update(f"{trend.heading}: {now}")


def _figures(picture: BusPicture, dropped: int | None) -> str:
    parts = [f"{picture.config.name}  {picture.config.bus.address}", f"cycle {picture.cycles}"]
    if picture.condition is not Condition.RUNNING:  # load and jitter are those of a running bench
        return "   ".join(parts)
    if picture.bus_load is not None:
        parts.append(f"bus load {100 * picture.bus_load:.0f} %")
    jitter = picture.jitter_us()
    parts.append("lockstep" if picture.config.pace == "lockstep" else "no SYNC" if jitter is None else "")
    if jitter is not None:
        parts.append(f"jitter {jitter[0]:.0f} µs (p99), {jitter[1]:.0f} µs (largest)")
    late = picture.late_pct()
    if late:
        parts.append("late samples: " + ", ".join(f"{share:.0f} % of {part}" for part, share in late.items()))
    if picture.model:
        parts.append(f"twin: {picture.model}")
    if dropped:
        parts.append(f"{dropped} frames not read in time")
    return "   ".join(part for part in parts if part)


def _row(node: NodePicture, condition: Condition) -> tuple[str, ...]:
    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    statusword = "-" if node.statusword is None else f"{node.statusword:04X}h"
    over = condition not in (Condition.RUNNING, Condition.NOT_RECEIVED)
    instead = condition.value if over else Condition.STALE.value if node.stale else "-"
    states = (node.nmt_state or (Condition.STALE.value if node.stale else "-"), node.drive_state or instead, statusword)
    return (str(node.node_id), node.part, *states, number(node.velocity_rad_s), number(node.torque_Nm))
