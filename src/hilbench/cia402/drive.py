"""The master's side of one CiA-402 drive: axis or load motor, SI units at the motor shaft outside, PDOs inside.

Once per cycle: `Drive.decode` takes the drive's frames, advances the drive's own state machine by one step and returns
the feedback; `Drive.encode` gives the frames to send. Nothing here waits: time is counted in cycles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import EMERGENCY
from hilbench.cia402 import objects
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.configuration import SETPOINT_OBJECTS, DriveSettings, configure, drive_pdos, read_units
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    POWERED,
    STATUS_TARGET_REACHED,
    Command,
    State,
    controlword_towards_disabled,
    controlword_towards_enabled,
    decode_statusword,
)
from hilbench.cia402.units import DriveUnits, UnwrappingCounter, wrap_int32
from hilbench.errors import BenchFaultError

if TYPE_CHECKING:
    import canopen
    from hilbench.canopen.master import Master

#: A reset bit that does not act is released and raised again after so many cycles.
_RESET_HALF_PERIOD: Final = 10

_RAW_LIMIT: Final = {objects.TARGET_VELOCITY: 2**31 - 1, objects.TARGET_TORQUE: 2**15 - 1}


class DriveGoal(Enum):
    """Wanted state of a drive; the value is its name in messages."""

    ENABLED = "OPERATION ENABLED"
    DISABLED = "SWITCH ON DISABLED"  #: by "disable operation", with the ramp of 605Ch
    QUICK_STOP = "standstill by quick stop"
    COAST = "power off"  #: "disable voltage": at once, without a ramp
    FAULT_RESET = "SWITCH ON DISABLED by fault reset"


@dataclass(slots=True)
class DriveFeedback:
    """Feedback of a drive in a cycle; SI, motor side."""

    position_rad: float = 0.0  #: unwrapped, from the first reading on
    velocity_rad_s: float = 0.0
    torque_Nm: float = 0.0
    state: State | None = None  #: None before the first statusword
    statusword: int = 0
    fault_code: int = 0  #: of the last EMCY (as 603Fh), 0 when none is active
    fresh: bool = False  #: every PDO expected in this cycle was there

    @property
    def powered(self) -> bool:
        """True if the power stage is, or may be, on."""
        return self.state is None or self.state in POWERED


class Drive:
    """Master-side drive object.

    `setpoint` (rad/s, N·m or rad, by the mode) is sent while the drive is enabled; before and after, the target
    is zero (a position mode's target: where the motor is).
    """

    def __init__(self, settings: DriveSettings, od: canopen.ObjectDictionary) -> None:
        """Drive whose EDS is `od`. Raises UnusableInputError for settings that its EDS does not allow."""
        self.settings = settings
        self.od = od
        self.pdos = drive_pdos(settings, od)
        self._tpdos = tuple((pdo.cob_id, pdo, mapped_objects(pdo)) for pdo in self.pdos.tpdos)
        self.tpdo_period_s = (settings.tpdo_type or 1) * settings.cycle_s  #: time between two of its TPDOs
        self.feedback = DriveFeedback()
        self.setpoint = 0.0
        self.goal = DriveGoal.COAST
        self.reached = False
        self.controlword = 0
        self._sent_controlword = 0
        self._failed = True  # nothing to report before the first request
        self._waited_cycles = 0
        self._waiting_in: State | None = None
        self.counter = UnwrappingCounter()  #: position counter in position units
        self._target = SETPOINT_OBJECTS[settings.mode]
        self._position_mode = self._target == objects.TARGET_POSITION
        #: Last value of each object that the TPDOs bring.
        self._raw: dict[int, int | float] = {}
        self._emergency_cob_id = EMERGENCY + settings.node_id
        self.units = DriveUnits(nan, nan, nan)

    def configure(self, master: Master) -> None:
        """Configure the drive in PRE-OPERATIONAL so that it can be started and enabled: see `configuration`.

        Blocks (SDO). Raises BenchFaultError when the device is not the one expected or does not take a value.
        """
        configure(master, self.settings, self.od, self.pdos)
        settings = self.settings
        self.units = read_units(master, settings.node_id, self.od, settings.units, settings.name, settings.axis)

    @property
    def rpdo_cob_ids(self) -> tuple[int, ...]:
        """COB-ID of RPDO1, and those of its copies."""
        return self.pdos.rpdo.cob_id, *(copy.cob_id for copy in self.settings.copies)

    @property
    def units(self) -> DriveUnits:
        """Device units of this drive; not numbers before `configure`."""
        return self._units

    @units.setter
    def units(self, units: DriveUnits) -> None:
        self._units = units
        self.set_point_unit = {
            objects.TARGET_VELOCITY: units.velocity_rad_s,
            objects.TARGET_TORQUE: units.torque_Nm,
            objects.TARGET_POSITION: units.position_rad,
        }[self._target]

    # --- once per cycle ----------------------------------------------------------------------------------------------

    def decode(self, frames: Mapping[int, bytes]) -> DriveFeedback:
        """Take this cycle's frames (data by COB-ID; others' are ignored) and go one step towards the goal.

        Raises BenchFaultError, once per request, when the drive hangs on its way, refuses it by a fault, or leaves
        the goal ENABLED by itself.
        """
        self._read_feedback(frames)
        emergency = frames.get(self._emergency_cob_id, b"")
        if len(emergency) >= 2:
            self.feedback.fault_code = int.from_bytes(emergency[:2], "little")
        self._advance()
        return self.feedback

    @property
    def fits_fast_path(self) -> bool:
        """True if it is enabled as wanted and follows a velocity or a torque: a cycle changes only that and its
        feedback, as long as its statusword shows it."""
        state = self.feedback.state
        return (
            self.goal is DriveGoal.ENABLED
            and self.reached
            and not self._failed
            and state is State.OPERATION_ENABLED
            and self._waiting_in is state
            and self.controlword == self._sent_controlword == Command.ENABLE_OPERATION.value
            and not self._position_mode
            and self.feedback.fresh
            and self.counter.value is not None
            and objects.STATUSWORD in self._raw
        )

    @property
    def most_raw(self) -> int:
        """Largest size of the target object's value."""
        return _RAW_LIMIT[self._target]

    def decoded_until(self, raw: Mapping[int, int | float]) -> None:
        """Account for TPDOs taken by the fast path: the last value of each mapped object."""
        self._raw.update(raw)

    def request(self, goal: DriveGoal) -> None:
        """Head for `goal` from the next `encode` on; a repeated request restarts its time-outs.

        The controlword goes with the set point: an enabled drive with a zero set point for one cycle before its quick
        stop would brake as hard as it can.
        """
        self.goal = goal
        self.controlword = self._next_controlword(self.feedback.state)
        self.reached = False
        self._failed = False
        self._waited_cycles = 0

    def encode(self) -> list[Frame]:
        """RPDO1 of this cycle, and its copies.

        Raises BenchFaultError when the set point is no number or does not fit its object.
        """
        self._sent_controlword = self.controlword
        raw, rpdo = self._raw_setpoint(), self.pdos.rpdo
        frames = [Frame(rpdo.cob_id, rpdo.pack((self.controlword, raw)))]
        for copy in self.settings.copies:
            # Of one unit: the very same bits, so that a virtual axis cannot differ by a rounding.
            copied = raw if copy.factor == 1.0 else self._in_range(round(raw * copy.factor), "set point of the copy")
            frames.append(Frame(copy.cob_id, rpdo.pack((self.controlword, copied))))
        return frames

    def _raw_setpoint(self) -> int:
        """Set point in device units; where the motor is not enabled, the one that causes no motion."""
        enabled = self.goal is DriveGoal.ENABLED and self.feedback.state is State.OPERATION_ENABLED
        if not enabled:
            return int(self._raw.get(objects.POSITION_ACTUAL_VALUE, 0)) if self._position_mode else 0
        if not isfinite(self.setpoint):
            raise self._error(f"set point is {self.setpoint}, expected a number")
        raw = round(self.setpoint / self.set_point_unit)
        if self._position_mode:
            return wrap_int32(raw)
        return self._in_range(raw, "set point")

    def _in_range(self, raw: int, what: str) -> int:
        limit = _RAW_LIMIT[self._target]
        if not -limit <= raw <= limit:
            most = limit * self.set_point_unit
            target = self.settings.object(self._target)
            raise self._error(f"{what} is {self.setpoint:g}, expected at most {most:g} (range of {target:X}h)")
        return raw

    # --- feedback ----------------------------------------------------------------------------------------------------

    def _read_feedback(self, frames: Mapping[int, bytes]) -> None:
        feedback, raw = self.feedback, self._raw
        feedback.fresh = True
        for cob_id, pdo, indices in self._tpdos:
            data = frames.get(cob_id)
            if data is None:
                feedback.fresh = False
            else:
                raw.update(zip(indices, pdo.unpack(data), strict=True))
        if objects.STATUSWORD in raw:
            self._show(raw)

    def _show(self, raw: Mapping[int, int | float]) -> None:
        feedback, units = self.feedback, self._units
        feedback.statusword = statusword = int(raw[objects.STATUSWORD])
        feedback.state = decode_statusword(statusword)
        feedback.torque_Nm = raw[objects.TORQUE_ACTUAL_VALUE] * units.torque_Nm
        first = self.counter.value is None
        position_rad = self.counter.update(int(raw[objects.POSITION_ACTUAL_VALUE])) * units.position_rad
        if self.settings.has_velocity:
            feedback.velocity_rad_s = raw.get(objects.VELOCITY_ACTUAL_VALUE, 0) * units.velocity_rad_s
        elif feedback.fresh and not first:
            feedback.velocity_rad_s = (position_rad - feedback.position_rad) / self.tpdo_period_s
        feedback.position_rad = position_rad

    # --- state transitions to the goal -------------------------------------------------------------------------------

    def _advance(self) -> None:
        state = self.feedback.state
        if state is not self._waiting_in:
            self._waiting_in = state
            self._waited_cycles = 0
        self.controlword = self._next_controlword(state)
        arrived = self._arrived(state)
        if self._failed:
            return
        if self.goal is DriveGoal.ENABLED and not arrived:
            self._check_still_enabling(state)
        self.reached = arrived
        if not arrived:
            self._waited_cycles += 1
            self._check_time(state)

    def _next_controlword(self, state: State | None) -> int:
        if state is None:
            return Command.DISABLE_VOLTAGE.value
        if self.goal is DriveGoal.ENABLED:
            return controlword_towards_enabled(state)
        if self.goal is DriveGoal.DISABLED:
            return controlword_towards_disabled(state)
        if self.goal is DriveGoal.QUICK_STOP:
            return Command.QUICK_STOP.value
        if self.goal is DriveGoal.FAULT_RESET and state is State.FAULT:
            raised = self._waited_cycles // _RESET_HALF_PERIOD % 2
            # The first cycles show the bit cleared, so that raising it is an edge whatever was sent before.
            return CONTROLWORD_FAULT_RESET if raised else Command.DISABLE_VOLTAGE.value
        return Command.DISABLE_VOLTAGE.value

    def _arrived(self, state: State | None) -> bool:
        if state is None:
            return False
        if self.goal is DriveGoal.ENABLED:
            return state is State.OPERATION_ENABLED
        if self.goal is DriveGoal.DISABLED:
            return state in (State.SWITCH_ON_DISABLED, State.FAULT)
        if self.goal is DriveGoal.FAULT_RESET:
            return state is State.SWITCH_ON_DISABLED
        if self.goal is DriveGoal.QUICK_STOP and state is State.QUICK_STOP_ACTIVE:
            return bool(self.feedback.statusword & STATUS_TARGET_REACHED)
        return state not in POWERED

    def _check_still_enabling(self, state: State | None) -> None:
        if state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            raise self._fail(f"is in {state.label}, wanted {self.goal.value}")
        if self.reached:
            raise self._fail(f"left {self.goal.value}, is in {_label(state)}")

    def _check_time(self, state: State | None) -> None:
        settings = self.settings
        ramping = state in POWERED and self.goal is not DriveGoal.COAST
        time_out_s = settings.ramp_time_out_s if ramping else settings.time_out_s
        if self._waited_cycles * settings.cycle_s > time_out_s:
            raise self._fail(f"hung in {_label(state)} for {time_out_s:g} s, wanted {self.goal.value}")

    def _fail(self, problem: str) -> BenchFaultError:
        self._failed = True
        error = self._error(problem)
        if self.goal is DriveGoal.ENABLED:
            self.goal = DriveGoal.QUICK_STOP  # never enable a drive again that failed
        return error

    def _error(self, problem: str) -> BenchFaultError:
        settings = self.settings
        return BenchFaultError(
            f"{settings.name} ({settings.place}): {problem}; controlword sent {self._sent_controlword:04X}h, "
            f"statusword {self.feedback.statusword:04X}h, error code ({settings.object(objects.ERROR_CODE):X}h) "
            f"{self.feedback.fault_code:04X}h"
        )


def _label(state: State | None) -> str:
    return state.label if state is not None else "no known state (no statusword)"
