"""Running FMU instance, through FMPy, in the process that loads its code: the peer of `process`.

Protocol of the connection: requests ``(name, arguments…)``, answers ``(problem, value, log)``, problem "" on success,
`log` the FMU's log messages since.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from shutil import rmtree
from typing import Any

References = Sequence[int]
Values = Sequence[float]

_LEVELS = ("ok", "warning", "discard", "error", "fatal", "pending")


class Instance:
    """Instance of the FMU in a folder. FMPy raises Exception with the function and its status."""

    def __init__(self, folder: str, version: int, identifier: str, token: str) -> None:
        self._version = version
        self._states: dict[int, Any] = {}
        self._next_state = 0
        self.log: list[str] = []
        if version == 2:
            from fmpy.fmi2 import FMU2Slave as Slave
        else:
            from fmpy.fmi3 import FMU3Slave as Slave
        self._new = partial(
            Slave, guid=token, unzipDirectory=folder, modelIdentifier=identifier, instanceName=identifier
        )
        self._fmu = self._new()
        self._instantiate()
        self._running = False

    def _instantiate(self) -> None:
        if self._version == 3:
            self._fmu.instantiate(loggingOn=True, logMessage=self._log3)
            return
        from ctypes import byref

        from fmpy import calloc, free
        from fmpy import fmi2 as api
        from fmpy.logging import addLoggerProxy

        callbacks = api.fmi2CallbackFunctions()
        callbacks.logger = api.fmi2CallbackLoggerTYPE(self._log2)
        callbacks.allocateMemory = api.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = api.fmi2CallbackFreeMemoryTYPE(free)
        addLoggerProxy(byref(callbacks))
        self._callbacks = callbacks
        self._fmu.instantiate(callbacks=callbacks, loggingOn=True)

    def _log2(self, _: Any, __: bytes, status: int, ___: bytes, message: bytes) -> None:
        self._keep(status, message)

    def _log3(self, _: Any, status: int, __: bytes, message: bytes) -> None:
        self._keep(status, message)

    def _keep(self, status: int, message: bytes | None) -> None:
        text = " ".join((message or b"").decode("utf-8", "replace").split())
        level = _LEVELS[status] if 0 <= status < len(_LEVELS) else str(status)
        self.log.append(text if level == "ok" else f"{level}: {text}")

    def start(self, time_s: float, references: References, values: Values) -> None:
        """Start (again) at a time, with values set before the start."""
        if self._running:
            self._begin_anew()
        self._set(references, values)
        if self._version == 2:
            self._fmu.setupExperiment(startTime=time_s)
            self._fmu.enterInitializationMode()
        else:
            self._fmu.enterInitializationMode(startTime=time_s)
        self._fmu.exitInitializationMode()
        self._running = True

    def _begin_anew(self) -> None:
        """Reset the FMU; one that can't be reset is loaded again."""
        try:
            self._fmu.reset()
        except Exception:  # FMPy has no narrower one
            self.end()
            self._fmu = self._new()
            self._instantiate()

    def put(self, references: References, values: Values) -> None:
        """Set variables from now on."""
        self._set(references, values)

    def get(self, references: References) -> list[float]:
        """Present values."""
        if not references:
            return []
        found: list[float] = (self._fmu.getReal if self._version == 2 else self._fmu.getFloat64)(references)
        return found

    def _set(self, references: References, values: Values) -> None:
        if references:
            (self._fmu.setReal if self._version == 2 else self._fmu.setFloat64)(references, values)

    def steps(
        self, references: References, values: Values, time_s: float, step_s: float, count: int, outputs: References
    ) -> list[float]:
        """Run `count` steps with inputs held; returns the outputs then."""
        self._set(references, values)
        for number in range(count):
            self._step(time_s + number * step_s, step_s, final=True)
        return self.get(outputs)

    def _step(self, time_s: float, step_s: float, *, final: bool) -> None:
        ended = self._fmu.doStep(time_s, step_s, final)
        if ended is not None and ended[1]:
            raise RuntimeError(f"it asks to end the simulation at t = {time_s:g} s")

    def attempt(
        self, references: References, values: Values, time_s: float, step_s: float, count: int, outputs: References
    ) -> list[list[float]]:
        """Run `steps` and roll back: returns the outputs after each step."""
        before = self._fmu.getFMUState()
        try:
            self._set(references, values)
            found = []
            for number in range(count):
                self._step(time_s + number * step_s, step_s, final=False)
                found.append(self.get(outputs))
            return found
        finally:
            self._fmu.setFMUState(before)
            self._fmu.freeFMUState(before)

    def take_state(self) -> int:
        """Save the present state; returns its number."""
        self._next_state += 1
        self._states[self._next_state] = self._fmu.getFMUState()
        return self._next_state

    def give_state(self, number: int) -> None:
        """Restore a saved state."""
        self._fmu.setFMUState(self._states[number])

    def drop_state(self, number: int) -> None:
        """Drop a saved state."""
        self._fmu.freeFMUState(self._states.pop(number))

    def end(self) -> None:
        """Terminate the FMU."""
        for number in list(self._states):
            self.drop_state(number)
        with suppress(Exception):  # an FMU that has failed may not be terminated
            self._fmu.terminate()
        self._fmu.freeInstance()


def serve(connection: Connection, folder: str, opened: Mapping[str, Any]) -> None:
    """Answer requests until the connection closes; the folder of the FMU is removed then."""
    instance: Instance | None = None
    try:
        while True:
            try:
                name, *arguments = connection.recv()
            except (EOFError, OSError):
                break
            problem, value = "", None
            try:
                if instance is None:
                    instance = Instance(folder, **opened)
                value = getattr(instance, name)(*arguments) if name != "open" else None
            except Exception as error:  # FMPy has no narrower one; reported to the bench as a line
                problem = " ".join(str(error).split()) or type(error).__name__
            log = instance.log if instance else []
            connection.send((problem, value, log))
            log.clear()
        if instance is not None:
            instance.end()
    finally:
        rmtree(Path(folder), ignore_errors=True)
        sys.stdout.flush()
        os._exit(0)  # don't wait for the FMU's threads or its library's destructors
