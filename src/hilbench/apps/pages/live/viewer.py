"""Connection of one viewer: new data are sent when he has taken the last ones, and nothing else waits for him."""

from __future__ import annotations

import asyncio
import json
import secrets
import struct
from collections import deque
from collections.abc import Mapping
from typing import Any, Final, Protocol

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from hilbench.apps.pages.live.controls import ControlAnswer, ControlLock, Viewer
from hilbench.apps.pages.live.history import LEVELS, Stretches
from hilbench.apps.pages.live.listener import Listener, panel_data
from hilbench.machine_kinds import machine_part

#: How often stretches are sent, and the state, s.
_TICK_S: Final = 0.05
_STATE_S: Final = 0.1
_MOST_VIEWERS: Final = 32
#: Requests of one viewer that are not answered yet; those beyond are let go, but for an emergency stop.
_MOST_ASKED: Final = 8
#: Ended connections whose viewers may come back as who they were.
_MOST_KNOWN: Final = 256
#: What a connection begins with comes within this time, s.
_HELLO_S: Final = 10.0
#: Points of a part of the past that is requested.
_MOST_POINTS: Final = 4000
_HEAD: Final = struct.Struct("<4I")
#: The third of the levels in a message: a part of the past.
PAST: Final = len(LEVELS)


def packed(level: int, generation: int, stretches: Stretches) -> bytes:
    """A message: level, generation, stretches and signals as uint32, the times as float64, then least and largest
    values, signal after signal, as float32; little-endian."""
    head = _HEAD.pack(level, generation, len(stretches), len(stretches.low))
    values = (np.ascontiguousarray(part, "<f4").tobytes() for part in (stretches.low, stretches.high))
    return b"".join([head, stretches.t_s.astype("<f8").tobytes(), *values])


class Asked(Protocol):
    """Handler of viewers' requests."""

    control_lock: ControlLock

    def as_data(self) -> dict[str, Any]:
        """Possible requests, as data for the page."""

    async def do(self, viewer: Viewer, asked: Mapping[str, Any]) -> ControlAnswer:
        """Execute a request and return its result."""


class Viewers:
    """Viewers of one bench: all connections to it."""

    def __init__(self, listener: Listener, controls: Asked) -> None:
        self._listener = listener
        self._controls = controls
        self._secrets: deque[str] = deque(maxlen=_MOST_KNOWN)  # of viewers that may come back
        self._present: dict[str, int] = {}
        self._connections = 0

    async def serve(self, socket: WebSocket) -> None:
        """One connection, until it ends."""
        await socket.accept()
        if self._connections >= _MOST_VIEWERS:
            await socket.close(1013, f"{_MOST_VIEWERS} viewers, expected no more; `hilbench estop` stops the machine")
            return
        self._connections += 1
        try:
            hello = await asyncio.wait_for(_received(socket), _HELLO_S)
            if hello is not None:
                await self._serve(socket, hello.get("viewer"))
        except TimeoutError:
            return
        finally:
            self._connections -= 1

    async def _serve(self, socket: WebSocket, before: object) -> None:
        if isinstance(before, str) and before in self._secrets:
            secret = before
        else:
            self._secrets.append(secret := secrets.token_hex(16))
        self._present[secret] = self._present.get(secret, 0) + 1
        self._controls.control_lock.comes(secret)
        tasks = {asyncio.create_task(self._send(socket, secret))}
        try:
            await self._receive(socket, Viewer(secret, socket.client.host if socket.client else "?"), tasks)
        finally:
            for task in tasks:
                task.cancel()
            self._present[secret] -= 1
            if not self._present[secret]:
                del self._present[secret]
                self._controls.control_lock.leaves(secret)

    async def _receive(self, socket: WebSocket, viewer: Viewer, tasks: set[asyncio.Task[None]]) -> None:
        """`tasks`: what is done for the viewer, the sending of what is new among it."""
        while (asked := await _received(socket)) is not None:
            number = asked.pop("number", None)
            # Done whatever else was requested, and whether answers are taken or not.
            stopped = await self._controls.do(viewer, asked) if asked.get("do") == "stop" else None
            if len(tasks) > _MOST_ASKED + (stopped is not None):
                continue
            # An answer of the bench takes its time; later requests do not wait for that.
            task = asyncio.create_task(self._answer(socket, viewer, asked, number, stopped))
            tasks.add(task)
            task.add_done_callback(tasks.discard)

    async def _answer(
        self, socket: WebSocket, viewer: Viewer, asked: dict[str, Any], number: object, stopped: ControlAnswer | None
    ) -> None:
        if asked.get("do") == "past":
            await self._past(socket, asked)
            return
        reply = stopped or await self._controls.do(viewer, asked)
        answer = {"kind": "said", "number": number, "to": asked.get("do"), **reply._asdict()}
        await _sent(socket, json.dumps(answer))

    async def _past(self, socket: WebSocket, asked: dict[str, Any]) -> None:
        try:
            from_s, to_s = float(asked["from_s"]), float(asked["to_s"])
        except (KeyError, TypeError, ValueError, OverflowError):
            return
        history = self._listener.history
        with self._listener.lock:
            stretches, generation = history.window(from_s, to_s, _MOST_POINTS), history.generation
        await _sent(socket, packed(PAST, generation, stretches))

    def _layout(self, secret: str) -> dict[str, Any]:
        listener = self._listener
        config = listener.config
        return {
            "kind": "layout",
            "viewer": secret,
            "name": config.name,
            "description": config.description,
            "bus": config.bus.address,
            "cycle_s": config.cycle_time_s,
            "signals": listener.history.names,
            "plots": [panel_data(panel, config) for panel in listener.panels],
            "drawing": machine_part(config.machine.kind, "page").drawing(config),
            "parts": {
                part.name: "virtual" if part.is_virtual else "simulated" if part.is_simulated else "real"
                for part in config.parts
            },
            "levels": [length_s for length_s, _ in LEVELS],
            **self._controls.as_data(),
        }

    async def _send(self, socket: WebSocket, secret: str) -> None:
        """Send new data, as fast as this viewer takes them."""
        listener, history = self._listener, self._listener.history
        if not await _sent(socket, json.dumps(self._layout(secret))):
            return
        generation, numbers, events, ticks = -1, [0] * len(LEVELS), 0, 0
        each = round(_STATE_S / _TICK_S)
        while True:
            with listener.lock:
                if history.generation != generation:
                    generation, numbers = history.generation, [0] * len(LEVELS)
                new = [history.since(level, number) for level, number in enumerate(numbers)]
                happened, count = listener.events.since(events), listener.events.number
            for level, stretches in enumerate(new):
                numbers[level] = stretches.first + len(stretches)
                if len(stretches) and not await _sent(socket, packed(level, generation, stretches)):
                    return
            if happened or ticks % each == 0:
                events = count
                state = {"kind": "state", "generation": generation, **self._state(secret), "events": happened}
                if not await _sent(socket, json.dumps(state, allow_nan=False)):
                    return
            ticks += 1
            await asyncio.sleep(_TICK_S)

    def _state(self, secret: str) -> dict[str, Any]:
        control_lock = self._controls.control_lock
        control = {"name": control_lock.name, "mine": control_lock.is_of(secret), "left_s": control_lock.left_s}
        return {**self._listener.state(), "control": control, "viewers": len(self._present)}


async def _received(socket: WebSocket) -> dict[str, Any] | None:
    """Next message; None once the connection is lost, or for an invalid one: no JSON, or deeper than Python goes."""
    try:
        message = await socket.receive_json()
    except (WebSocketDisconnect, RuntimeError, ValueError, KeyError):  # RuntimeError: as below, and RecursionError
        return None
    return message if isinstance(message, dict) else None


async def _sent(socket: WebSocket, message: str | bytes) -> bool:
    """Send a message; False once the connection is lost."""
    try:
        await (socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message))
    except (WebSocketDisconnect, RuntimeError):  # starlette's word for a connection that was closed meanwhile
        return False
    return True
