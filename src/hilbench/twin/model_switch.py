"""Model switch of a running twin: the new model runs in parallel, then is taken over by bumpless transfer.

The changed model finds state and E of the running plant by itself, as a twin started on one does: it has the
measurements, set points and boundary inputs of the model in use. When it is synchronized, the virtual I/O's outputs go
from one to the other along a smooth curve, so that the tension loop, which works on them, follows without a step.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from math import copysign
from typing import Protocol

from hilbench.plant.interface import Plant
from hilbench.plant.motor_port import MotorPort
from hilbench.topology.blocks import MachineParameters
from hilbench.twin.estimated_errors import EstimatedModelError
from hilbench.twin.machines.machine import Measured, TwinMachine

#: Duration of the transfer of the outputs, and for which the changed model must have been synchronized before, s.
HAND_OVER_S, SYNCHRONIZED_S = 3.0, 0.5


def with_effects(model: MachineParameters, effects: str) -> MachineParameters:
    """Model with these effects (JSON: a list of {effect, axis, parameters}) in place of its own; "": unchanged.

    Raises ValueError for an invalid list, or one that does not fit this machine.
    """
    if not effects:
        return model
    return type(model).model_validate({**model.model_dump(), "effects": json.loads(effects)})


class PendingModel(Protocol):
    """Future of a machine that is being built."""

    def done(self) -> bool:
        """True if it is built."""

    def result(self) -> TwinMachine:
        """Machine, once it is built."""


Make = Callable[[], TwinMachine]


class ModelSwitcher:
    """`TwinMachine` whose model can be exchanged while it runs.

    `make`: factory of a machine of the model with these effects (JSON) in place of the configured ones; "": as
    configured. Until the first change all calls go straight to the configured machine. `beside`: executor that builds
    it in parallel to the cycle, which takes several cycles' time; None: it is built at once.
    """

    def __init__(
        self, make: Callable[[str], Make], cycle_s: float, beside: Callable[[Make], PendingModel] | None = None
    ) -> None:
        self._make, self._beside = make, beside
        self._cycle_s = cycle_s
        #: Machine whose model is in use.
        self._configured = self.in_use = make("")()
        self.ports: Sequence[MotorPort] = self._configured.ports
        self._pending: PendingModel | None = None
        self._candidate: TwinMachine | None = None
        self._effects = self._effects_beside = ""  # of the model in use, and of the candidate
        self._before: Sequence[Measured] | None = None  # while the candidate awaits its release
        self._released = False
        self._synchronized_cycles = self._cycles_over = 0
        self._share = 0.0
        self._fresh = True  # outputs are of a cycle with measurement
        self._cycles_since = 0  # model cycles since the last one
        self._apart: Sequence[float] = ()  # outputs, less those of the model in use alone
        self._shown: Sequence[float] = ()
        self._smooth = BumplessTransfer(self._configured.largest_steps)
        #: Largest step of each output from one cycle to the next by the last change; empty before.
        self.largest_steps: Sequence[float] = ()

    def change(self, effects: str) -> None:
        """Start a bumpless switch to the model with these effects ("" = configured). Cancels a pending switch.

        Raises ValueError for an invalid list of effects, RuntimeError during a transfer.
        """
        if self._share > 0.0:
            raise RuntimeError("a model is being taken over")
        make, self._effects_beside = self._make(effects), effects
        self._candidate, self._pending = None, None
        if self._beside is None:
            self._candidate = make()
            self._candidate.set_cycle_time(self._cycle_s)
        else:
            self._pending = self._beside(make)
        self._before, self._released = None, False
        self._synchronized_cycles = self._cycles_over = 0
        self._apart = self._shown = self.largest_steps = ()
        self._smooth = BumplessTransfer(self._configured.largest_steps)

    @property
    def changing(self) -> bool:
        """True while a changed model runs in parallel, or is being taken over."""
        return self._candidate is not None or self._pending is not None

    @property
    def changed(self) -> bool:
        """True if the model in use is not the configured one."""
        return self._effects != ""

    @property
    def only_plant(self) -> Plant | None:
        """Configured model if no other is in use or tried; it then drives the ports itself."""
        alone = not self.changing and self.in_use is self._configured and self._smooth.is_over
        return self._configured.plant if alone else None

    # -- a TwinMachine -----------------------------------------------------------------------------------

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze parameter adaptation while the SYNC period is uncertain."""
        for machine in self._machines:
            machine.freeze_adaptation(frozen=frozen)

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time of all models."""
        self._cycle_s = cycle_s
        for machine in self._machines:
            machine.set_cycle_time(cycle_s)

    def keep(self) -> None:
        """Take a checkpoint of all models."""
        for machine in self._machines:
            machine.keep()

    @property
    def _machines(self) -> list[TwinMachine]:
        """All existing machines."""
        found = [self._configured]
        for machine in (self.in_use, self._candidate):
            if machine is not None and machine is not self._configured:
                found.append(machine)
        return found

    def reset(self) -> None:
        """Reset to the configured model."""
        self._candidate, self.in_use, self._share = None, self._configured, 0.0
        self._pending, self._effects = None, ""
        self._smooth = BumplessTransfer(self._configured.largest_steps)
        self._configured.reset()

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release after the drives were enabled; False if the measurements are not coherent (of one instant)."""
        if self._candidate is not None and self._share > 0.0:
            self._take_over(self._candidate)
        self._pass_set_points(self.in_use)
        self._before, self._released = None, False
        return self.in_use.release(before, now, in_motion=in_motion)

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Take the axes' (N,) measurements.

        A candidate is released by two successive measurements that the model in use finds coherent.
        """
        self._fresh = self.in_use.compare(time_s, measured)
        candidate = self._candidate
        if candidate is not None:
            if self._released:
                candidate.compare(time_s, measured)
            elif self._fresh and self._before is not None:
                self._released = candidate.release(self._before, measured)
            self._before = measured if self._fresh else None
        return self._fresh

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        if self._candidate is not None:
            if self._released:
                self._candidate.miss()
            self._before = None
        self._fresh = False
        self.in_use.miss()

    def listen(self) -> None:
        """Read the boundary inputs."""
        if self._candidate is not None and self._released:
            self._candidate.listen()
        self.in_use.listen()

    def step(self, duration_s: float) -> None:
        """Step by the ports' set points."""
        plant = self.only_plant
        if plant is not None:
            plant.step(duration_s)
            return
        self._pass_set_points(self.in_use)
        self.in_use.plant.step(duration_s)
        if self._pending is not None and self._pending.done():
            self._candidate, self._pending = self._pending.result(), None
            self._candidate.set_cycle_time(self._cycle_s)
        candidate = self._candidate
        if candidate is not None and self._released:
            self._pass_set_points(candidate)
            candidate.plant.step(duration_s)
            self._cycles_since += 1
            self._go_over(candidate)
        if self.in_use is not self._configured:
            for shown, port in zip(self.ports, self.in_use.ports, strict=True):
                shown.feedback = port.feedback

    def use_method(self, number: int) -> None:
        """Switch to another method from the present estimate."""
        self.in_use.use_method(number)
        if self._candidate is not None:
            self._candidate.use_method(number)

    def found(self) -> Sequence[EstimatedModelError]:
        """Estimated errors of the model in use."""
        return self.in_use.found()

    def published(self) -> Sequence[float]:
        """Outputs of the virtual I/O, blended during a transfer."""
        shown = self.in_use.published()
        if self._candidate is None or self._share == 0.0:
            return shown if self._smooth.is_over else self._smooth.show(shown, shown, 1.0)
        both = self._smooth.show(shown, self._candidate.published(), self._share)
        self._note_steps([now - old for old, now in zip(shown, both, strict=True)], both)
        return both

    def _note_steps(self, apart: Sequence[float], shown: Sequence[float]) -> None:
        """Track how much more the outputs change in a cycle than those of the model in use alone, or less, where that
        one jumps and the changed one does not.

        After cycles without measurement the change is that of all of them.
        """
        if not self._fresh:
            return
        cycles = max(self._cycles_since, 1)
        more = _steps(self._apart or [0.0] * len(apart), apart)
        steps = [
            min(pair) / cycles for pair in zip(more, _steps(self._shown, shown) if self._shown else more, strict=True)
        ]
        self._cycles_since = 0
        self.largest_steps = [max(pair) for pair in zip(steps, self.largest_steps or steps, strict=True)]
        self._apart, self._shown = apart, shown

    # -- a change ----------------------------------------------------------------------------------------

    def _pass_set_points(self, machine: TwinMachine) -> None:
        if machine is self._configured:
            return
        for given, port in zip(self.ports, machine.ports, strict=True):
            port.mode, port.setpoint = given.mode, given.setpoint
            port.slope, port.torque_limit_Nm = given.slope, given.torque_limit_Nm

    def _go_over(self, candidate: TwinMachine) -> None:
        """Advance the transfer by a cycle, once the candidate has been synchronized for a while."""
        if self._share == 0.0 and self._synchronized_cycles * self._cycle_s < SYNCHRONIZED_S:
            self._synchronized_cycles = self._synchronized_cycles + 1 if candidate.synchronized else 0
            return
        self._cycles_over += 1
        passed = self._cycles_over * self._cycle_s / HAND_OVER_S
        if passed < 1.0:
            self._share = passed * passed * (3.0 - 2.0 * passed)
            return
        self._take_over(candidate)

    def _take_over(self, candidate: TwinMachine) -> None:
        self.in_use, self._candidate, self._share = candidate, None, 0.0
        self._effects = self._effects_beside


def _steps(before: Sequence[float], now: Sequence[float]) -> list[float]:
    """Absolute change of each value."""
    return [abs(new - old) for old, new in zip(before, now, strict=True)]


class BumplessTransfer:
    """Bumpless transfer of outputs from one model to another.

    Two models of the same web differ, and their difference jumps where they take a late sample, or some cycles without
    measurement, differently, or where the old one diverges. Common changes of both are followed at once, the rest by no
    more than `largest_steps` per cycle (one of each value; others are unlimited). A difference that oscillates with a
    roller changes by less than that, and is output unchanged.
    """

    def __init__(self, largest_steps: Sequence[float]) -> None:
        self._largest = tuple(largest_steps)
        self._old: Sequence[float] = ()
        self._new: Sequence[float] = ()
        self._shown: Sequence[float] = ()
        self.is_over = True  #: the output equals the models' blend

    def show(self, old: Sequence[float], new: Sequence[float], share: float) -> list[float]:
        """Outputs of a cycle with this share of the new model in place of the old one."""
        wanted = [then + share * (now - then) for then, now in zip(old, new, strict=True)]
        shown = list(wanted)
        if self._shown:
            for at, largest in enumerate(self._largest):
                alone, both = new[at] - self._new[at], old[at] - self._old[at]
                if share != 1.0:  # the common part of both changes
                    alone = 0.0 if alone * both <= 0.0 else min(alone, both, key=abs)
                follows = self._shown[at] + alone
                if abs(wanted[at] - follows) > largest:
                    shown[at] = follows + copysign(largest, wanted[at] - follows)
        self._old, self._new, self._shown = old, new, shown
        self.is_over = shown == wanted
        return shown
