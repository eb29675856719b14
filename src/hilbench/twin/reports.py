"""EMCY reports of the twin: unusable measurements, and the compensated torque shift."""

from __future__ import annotations

from struct import pack
from typing import Final

from hilbench.canopen.device import Device
from hilbench.estimation.problems import TORQUE_SHIFT, UNDECIDED, Problem
from hilbench.twin.model_switch import ModelSwitcher

#: Time for which a condition has to be absent for its alarm to end.
_QUIET_S = 0.5
#: Error register (1001h): generic and device profile.
PROFILE_SPECIFIC: Final = 0x21


class Reports:
    """Reports of `machine`, sent by the virtual I/O `device`; no alarm is active at the start."""

    def __init__(self, device: Device, machine: ModelSwitcher, cycle_s: float) -> None:
        self._device, self._machine = device, machine
        self._alarms = {part: Alarms(cycle_s) for part in machine.in_use.problems}
        self._forget()

    def _forget(self) -> None:
        self.quiet = True  #: no alarm is active
        self._reported_shift_Nm, self._reported_undecided = 0.0, False

    def reset(self) -> None:
        """Forget all alarms and reports."""
        for alarms in self._alarms.values():
            alarms.reset()
        self._forget()

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time."""
        for alarms in self._alarms.values():
            alarms.set_cycle_time(cycle_s)

    def update(self) -> None:
        """Report what has begun or ended; call it after each comparison."""
        self._report_problem()
        self._report_shift()

    def _report_problem(self) -> None:
        """Report by EMCY why a measurement is unusable, and when it is usable again."""
        if self.quiet and self._machine.in_use.problem is None:
            return
        for part, found in self._machine.in_use.problems.items():
            begun, ended = self._alarms[part].update(found)
            for problem in ended:
                self._device.clear_emergency(problem, part)
            for problem in begun:
                self._device.emergency(problem, PROFILE_SPECIFIC, _at(part), part)
        self.quiet = all(alarms.idle for alarms in self._alarms.values())

    def _report_shift(self) -> None:
        """Report by EMCY the compensated torque shift, and an undecided change."""
        machine = self._machine.in_use
        shift_Nm, undecided = machine.torque_shift_Nm, machine.torque_undecided
        if shift_Nm != self._reported_shift_Nm:
            self._device.clear_emergency(TORQUE_SHIFT)
            if shift_Nm != 0.0:
                info = pack("<f", shift_Nm) + _at(machine.shift_span)[-1:]
                self._device.emergency(TORQUE_SHIFT, PROFILE_SPECIFIC, info)
            self._reported_shift_Nm = shift_Nm
        if undecided is not self._reported_undecided:
            if undecided:
                self._device.emergency(UNDECIDED, PROFILE_SPECIFIC, _at(machine.shift_span))
            else:
                self._device.clear_emergency(UNDECIDED)
            self._reported_undecided = undecided


def _at(part: int) -> bytes:
    """Manufacturer's five bytes of an EMCY message: the span number in the last; 0: only one."""
    return bytes((0, 0, 0, 0, part))


class Alarms:
    """One alarm for each problem; an intermittent condition is one alarm."""

    def __init__(self, cycle_s: float) -> None:
        self.set_cycle_time(cycle_s)
        self._left: dict[Problem, int] = {}

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time."""
        self._quiet_cycles = max(1, round(_QUIET_S / cycle_s))

    def reset(self) -> None:
        """Forget active alarms."""
        self._left.clear()

    @property
    def idle(self) -> bool:
        """True if no alarm is active."""
        return not self._left

    def update(self, problem: Problem | None) -> tuple[list[Problem], list[Problem]]:
        """Take this cycle's problem; returns the alarms that begin and those that end."""
        begun = [problem] if problem is not None and problem not in self._left else []
        for known in self._left:
            self._left[known] -= 1
        if problem is not None:
            self._left[problem] = self._quiet_cycles
        ended = [known for known, cycles in self._left.items() if cycles <= 0]
        for known in ended:
            del self._left[known]
        return begun, ended
