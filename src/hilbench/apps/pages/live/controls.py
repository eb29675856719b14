"""Requests of viewers to a bench: the same, in the same ranges, as the terminal's monitor makes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field, FiniteFloat, StringConstraints, TypeAdapter, ValidationError

from hilbench.apps.monitor.changes import SHOWN_UNITS, Answered, ChangeRequests
from hilbench.apps.pages.live.listener import Listener
from hilbench.block import Strict
from hilbench.errors import HilbenchError
from hilbench.prediction.outlook import Outlook
from hilbench.pydantic_messages import expected

#: The seat is free again after this time without an action, and after this time without a connection, s.
IDLE_S: Final = 120.0
LOST_S: Final = 10.0
#: Points of a course at most; each is of a stretch, and has the least and largest value in it.
_MOST_POINTS: Final = 120
_DIGITS: Final = 5
_NAME: Final = r"^[^\x00-\x1f\x7f<>]{1,32}$"
Name = Annotated[str, StringConstraints(pattern=_NAME, strip_whitespace=True)]
Key = Annotated[str, Field(max_length=8)]
Number = Annotated[FiniteFloat, Field(strict=True)]


@dataclass
class _Holder:
    viewer: str
    name: str
    until_s: float
    elapsed_s: float | None = None


class ControlLock:
    """The seat of one bench; `viewer` is what only that viewer knows, `name` what others are shown of him."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._holder: _Holder | None = None

    def _taken(self) -> _Holder | None:
        holder, now_s = self._holder, self._now()
        lost = holder is not None and holder.elapsed_s is not None and now_s - holder.elapsed_s > LOST_S
        if holder is not None and (lost or now_s > holder.until_s):
            self._holder = holder = None
        return holder

    @property
    def name(self) -> str:
        """Name of the controlling viewer; "" without one."""
        holder = self._taken()
        return "" if holder is None else holder.name

    @property
    def left_s(self) -> float | None:
        """Time until the control lock is free unless its holder does something; None while it is."""
        holder = self._taken()
        return None if holder is None else holder.until_s - self._now()

    def is_of(self, viewer: str) -> bool:
        """True if that viewer controls."""
        holder = self._taken()
        return holder is not None and holder.viewer == viewer

    def take(self, viewer: str, name: str) -> bool:
        """Take or keep control; False where another viewer has it."""
        holder = self._taken()
        if holder is not None and holder.viewer != viewer:
            return False
        self._holder = _Holder(viewer, name, self._now() + IDLE_S)
        return True

    def use(self, viewer: str) -> bool:
        """Something is done by who controls; False where that is not this viewer."""
        return self.is_of(viewer) and self._holder is not None and self.take(viewer, self._holder.name)

    def give_back(self, viewer: str) -> bool:
        """Release the lock; False for who does not hold it."""
        if not self.is_of(viewer):
            return False
        self._holder = None
        return True

    def leaves(self, viewer: str) -> None:
        """Note that a viewer's connection is lost; he may come back."""
        if self._holder is not None and self._holder.viewer == viewer:
            self._holder.elapsed_s = self._now()

    def comes(self, viewer: str) -> None:
        """A viewer has a connection (again)."""
        if self._holder is not None and self._holder.viewer == viewer:
            self._holder.elapsed_s = None


def courses(outlook: Outlook) -> list[dict[str, Any]]:
    """Band of nine measurements in ten of each tension (N) and torque (N·m), its middle, and levels; `t_s`: from
    now."""
    t_s = outlook.times_s - outlook.now_s
    edges = np.linspace(0, len(t_s), min(len(t_s), _MOST_POINTS), endpoint=False).astype(int)
    shown = []
    for place, watched in enumerate(outlook.watched):
        if watched.unit not in SHOWN_UNITS:
            continue
        low, median, high = outlook.band(place)
        low, high = np.minimum.reduceat(low, edges), np.maximum.reduceat(high, edges)
        course = {"t_s": t_s[edges], "low": low, "median": median[edges], "high": high}
        levels = {"warning": watched.warning, "trip": watched.trip}
        about = {"name": watched.name, "unit": watched.unit, "levels": levels}
        shown.append(
            {**about, **{name: [float(f"{v:.{_DIGITS}g}") for v in values] for name, values in course.items()}}
        )
    return shown


class Named(Strict):
    """Emergency stop, which anybody who sees the page may ask for; or control, or to hold it longer."""

    do: Literal["stop", "take"]
    name: Name


class Give(Strict):
    """Control back."""

    do: Literal["give"]


class Valued(Strict):
    """Another value of a quantity, in its unit; or the outcome of one, which moves nothing."""

    do: Literal["set", "what_if"]
    key: Key
    value: Number


class Answer(Strict):
    """Yes or no to a probe or a proposed model."""

    do: Literal["answer"]
    key: Key
    yes: bool


Action = Named | Give | Valued | Answer
_ACTION: Final[TypeAdapter[Action]] = TypeAdapter(Annotated[Action, Field(discriminator="do")])


@dataclass(frozen=True)
class Viewer:
    """Identity of a viewer: what only that viewer knows, and from where."""

    secret: str
    address: str

    def named(self, name: str) -> str:
        """Name of the viewer in the journal."""
        return f"{name} ({self.address})"


class ControlAnswer(NamedTuple):
    """Result of a request: in a line, whether it was done, and forecasts."""

    text: str
    done: bool
    courses: Sequence[dict[str, Any]] = ()


class Controls:
    """Execute viewers' requests, report the result, and write who it was into the journal."""

    def __init__(self, listener: Listener, changes: ChangeRequests) -> None:
        self.control_lock = ControlLock()
        self._listener = listener
        self._changes = changes
        self._looking = asyncio.Lock()

    def as_data(self) -> dict[str, Any]:
        """Possible requests, as data for the page."""
        quantities = [
            {"key": key, "title": quantity.title, "signal": quantity.signal, "unit": quantity.in_unit}
            | dict(zip(("low", "high"), self._changes.range_of(quantity), strict=True))
            | {"foreseeable": key in self._changes.foreseeable, "scale": quantity.si_per_shown}
            for key, quantity in self._changes.changeable.items()
        ]
        switches = [vars(switch) for switch in self._changes.switches.values()]
        return {"quantities": quantities, "switches": switches}

    async def do(self, viewer: Viewer, asked: Mapping[str, Any]) -> ControlAnswer:
        """Execute a request and return its result."""
        try:
            action = _ACTION.validate_python(asked)
        except ValidationError as error:
            first = error.errors()[0]
            return ControlAnswer(
                f"not understood: {'.'.join(map(str, first['loc']))}: expected {expected(first)}", False
            )
        try:
            return await self._do(viewer, action)
        except HilbenchError as error:
            return ControlAnswer(str(error), False)

    async def _do(self, viewer: Viewer, action: Action) -> ControlAnswer:
        if isinstance(action, Named):
            if action.do == "stop":
                return await asyncio.to_thread(self._stop, viewer, action.name)
            return self._take(viewer, action.name)
        if isinstance(action, Valued) and action.do == "what_if":
            return await self._look_ahead(action)
        if isinstance(action, Give):
            name = self.control_lock.name
            if not self.control_lock.give_back(viewer.secret):
                return ControlAnswer("control is not yours to give back", False)
            self._listener.note(viewer.named(name), "control given back")
            return ControlAnswer("control given back", True)
        if not self.control_lock.use(viewer.secret):
            return ControlAnswer(
                f"control is with {self.control_lock.name}" if self.control_lock.name else "take control first", False
            )
        return await self._change(viewer.named(self.control_lock.name), action)

    def _stop(self, viewer: Viewer, name: str) -> ControlAnswer:
        try:
            self._listener.stop_everything()
        except HilbenchError as error:
            return ControlAnswer(f"EMERGENCY STOP NOT SENT: {error}", False)
        self._listener.note(viewer.named(name), "emergency stop")
        return ControlAnswer("emergency stop sent", True)

    def _take(self, viewer: Viewer, name: str) -> ControlAnswer:
        held = self.control_lock.is_of(viewer.secret)
        if not self.control_lock.take(viewer.secret, name):
            return ControlAnswer(f"control is with {self.control_lock.name}", False)
        if not held:
            self._listener.note(viewer.named(name), "control taken")
        return ControlAnswer("you control", True)

    async def _change(self, who: str, action: Valued | Answer) -> ControlAnswer:
        known = self._changes.changeable if isinstance(action, Valued) else self._changes.switches
        if action.key not in known:
            return ControlAnswer(f"'{action.key}', expected one of {', '.join(known)}", False)
        note = partial(self._listener.note, who)
        if isinstance(action, Valued):
            future = self._changes.ask(self._changes.changeable[action.key], action.value, note)
        else:
            future = self._changes.send(self._changes.switches[action.key], action.yes, note)
        answer = await self._ended(future)
        return ControlAnswer(answer, answer.endswith(": set"))

    async def _look_ahead(self, action: Valued) -> ControlAnswer:
        if action.key not in self._changes.foreseeable:
            return ControlAnswer(f"'{action.key}', expected one of {', '.join(self._changes.foreseeable)}", False)
        quantity = self._changes.foreseeable[action.key]
        async with self._looking:  # who leaves before his turn has asked for nothing
            asked = self._changes.look_ahead(quantity, action.value, self._listener.recent_frames())
            foreseen = await self._ended(asked)
        return ControlAnswer(foreseen.text, True, () if foreseen.outlook is None else courses(foreseen.outlook))

    async def _ended(self, future: Future[Answered]) -> Answered:
        answer = await asyncio.wrap_future(future)
        self._changes.ended()  # each is answered to who has asked
        return answer
