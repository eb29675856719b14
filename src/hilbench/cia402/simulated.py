"""The simulated CiA-402 servo drive: power state machine, modes of operation, limits and faults.

It is the firmware only: it reads and writes the objects of a CANopen device and a `MotorPort`.
Controlwords act when they are written (by SDO, or by an RPDO when its SYNC comes), so that two of them in one
cycle are both obeyed; set points act at `sync`.

A state whose option code selects a ramp is left when the ramp has ended: a drive commanded to disable operation
(605Ch = 1) stays in OPERATION ENABLED until the motor is at rest, and so its power stage is on in the states of
`state_machine.POWERED` only.
"""

from __future__ import annotations

from collections.abc import Container
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final

from hilbench.canopen.device import SdoAbort
from hilbench.canopen.identifiers import NmtState
from hilbench.cia402 import objects
from hilbench.cia402.assumed import cell_of
from hilbench.cia402.axis import AxisDevice, also, object_of, objects_behind
from hilbench.cia402.firmware import Firmware
from hilbench.cia402.homing import NO_METHOD, PRESENT_POSITION, WITH_SWITCHES
from hilbench.cia402.mode import DebouncedCondition
from hilbench.cia402.modes import MODES
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_HALT,
    DESTINATION,
    POWERED,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    STATUS_TARGET_REACHED,
    STATUS_VOLTAGE_ENABLED,
    Command,
    State,
    Transition,
    commanded,
    decode_controlword,
)
from hilbench.cia402.stopping import QUICK_STOP_OPTIONS, Stop, StopKind
from hilbench.cia402.switches import Switches
from hilbench.cia402.touch_probe import TouchProbes
from hilbench.cia402.units import DriveUnits, ObjectReader
from hilbench.errors import UnusableInputError
from hilbench.plant.motor_port import MotorMode, MotorPort

if TYPE_CHECKING:
    from hilbench.canopen.device import Device

#: Error codes (603Fh, EMCY) that the drive itself raises.
ERROR_COMMUNICATION: Final = 0x8100
ERROR_OVERSPEED: Final = 0x84FF
ERROR_FOLLOWING: Final = 0x8611

#: Error register (1001h): generic, and communication or device profile.
REGISTER_COMMUNICATION: Final = 0x11
REGISTER_PROFILE: Final = 0x21

SIMULATED_FAULT: Final = 0x2001
#: How that object's name begins in our EDS files; at other makers' drives 2001h is something else.
_FAULT_ON_COMMAND: Final = "Simulated fault"
_ABORT_VALUE_RANGE: Final = 0x06090030

#: Option codes, and those that the drive knows (a maker's own are negative).
_OPTION_CODES: Final = {
    objects.ABORT_CONNECTION_OPTION_CODE: range(4),
    objects.QUICK_STOP_OPTION_CODE: range(9),
    objects.SHUTDOWN_OPTION_CODE: range(2),
    objects.DISABLE_OPERATION_OPTION_CODE: range(2),
    objects.HALT_OPTION_CODE: range(1, 5),
    objects.FAULT_REACTION_OPTION_CODE: range(5),
}
#: Target object (index, sub-index) of each mode.
_TARGETS: Final = {
    OperationMode.PROFILE_POSITION: (objects.TARGET_POSITION, 0),
    OperationMode.VELOCITY: (objects.VL_TARGET_VELOCITY, 0),
    OperationMode.PROFILE_VELOCITY: (objects.TARGET_VELOCITY, 0),
    OperationMode.TORQUE: (objects.TARGET_TORQUE, 0),
    OperationMode.HOMING: (objects.HOMING_METHOD, 0),
    OperationMode.INTERPOLATED_POSITION: (objects.INTERPOLATION_DATA_RECORD, 1),
    OperationMode.CYCLIC_SYNCHRONOUS_POSITION: (objects.TARGET_POSITION, 0),
    OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY: (objects.TARGET_VELOCITY, 0),
    OperationMode.CYCLIC_SYNCHRONOUS_TORQUE: (objects.TARGET_TORQUE, 0),
}
#: Modes in which nothing is remembered from one cycle to the next.
_FOLLOWING: Final = (OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY, OperationMode.CYCLIC_SYNCHRONOUS_TORQUE)
#: Transitions towards power, which take their time at a slow drive.
_DELAYED: Final = (
    Transition.T2_SHUTDOWN,
    Transition.T3_SWITCH_ON,
    Transition.T4_ENABLE_OPERATION,
    Transition.T16_ENABLE_OPERATION,
)
#: Transitions out of OPERATION ENABLED that an option code (1) puts behind a slow-down ramp.
_DISABLING: Final = {
    Transition.T5_DISABLE_OPERATION: objects.DISABLE_OPERATION_OPTION_CODE,
    Transition.T8_SHUTDOWN: objects.SHUTDOWN_OPTION_CODE,
}


class SimulatedDrive:
    """A CiA-402 slave, or one `axis` (from 1) of one, on `device` that commands the motor behind `port`.

    The host's application calls `sync` once per cycle (or tick) before the plant advances and `publish` after it.
    """

    def __init__(
        self,
        device: Device,
        port: MotorPort,
        units: DriveUnits | None = None,
        *,
        axis: int = 1,
        switches: Switches | None = None,
        state_change_s: float = 0.0,
    ) -> None:
        """Take over the CiA-402 objects of `device`; `units` default to those its objects give.

        `switches`: along the motor's travel; `state_change_s`: duration of a commanded transition. Raises
        UnusableInputError for a device without controlword and statusword.
        """
        for index in (objects.CONTROLWORD, objects.STATUSWORD):
            if not device.has(object_of(axis, index)):
                raise UnusableInputError(
                    f"EDS of node {device.node_id}",
                    f"object {object_of(axis, index):04X}h is missing, expected that of a CiA-402 drive",
                )
        self._device = own = AxisDevice(device, axis)
        self.firmware = Firmware(own, port, units or DriveUnits.from_objects(object_reader(own)))
        self.firmware.switches = switches
        probed = own.has(objects.TOUCH_PROBE_FUNCTION)
        self._probes = TouchProbes(own, self.firmware) if probed else None
        self._stop = Stop(self.firmware)
        supported = supported_modes(own)
        if own.has(objects.SUPPORTED_DRIVE_MODES) and not own.cell(objects.SUPPORTED_DRIVE_MODES).value:
            own.cell(objects.SUPPORTED_DRIVE_MODES).on_read = lambda: supported
        self._modes = {
            code: kind(self.firmware)
            for code, kind in MODES.items()
            if code is OperationMode.NONE or supported & code.supported_bit
        }
        cell = partial(cell_of, own, self.firmware.units)
        self.statusword = own.cell(objects.STATUSWORD)  #: the object 6041h
        self._error_code = cell(objects.ERROR_CODE)
        self._mode_request = cell(objects.MODES_OF_OPERATION)
        self._mode_display = cell(objects.MODES_OF_OPERATION_DISPLAY)
        self._options = {index: cell(index) for index in _OPTION_CODES}
        for index, codes in _OPTION_CODES.items():
            self._options[index].on_write = partial(_only, codes)
        self._state_change_s = state_change_s
        self._pending: tuple[Transition, float] | None = None
        self.firmware.controlword.on_write = self._controlword_written
        self._mode_request.on_write = self._mode_written
        methods = PRESENT_POSITION if switches is None else WITH_SWITCHES
        self.firmware.homing_method.on_write = partial(_only, {NO_METHOD, *methods})
        failing = SIMULATED_FAULT + objects_behind(axis)
        if device.has(failing) and device.cell(failing).variable.name.startswith(_FAULT_ON_COMMAND):
            device.cell(failing).on_write = self._simulated_fault_written
        device.on_nmt = also(device.on_nmt, self._nmt_changed)
        device.on_communication_error = also(device.on_communication_error, self._connection_lost)
        device.on_emergency_stop = also(device.on_emergency_stop, self._emergency_stop)
        self._operational = False
        #: Error codes of active EMCY messages.
        self._reported: list[int] = []
        self._power_on()

    def _power_on(self) -> None:
        """Transitions 0 and 1: the drive as after power-on, on the objects' present values."""
        self._controlword = 0
        self._dt_s = 0.0
        self._outside_window = DebouncedCondition()
        self._error_code.value = 0
        self._reported.clear()
        self.firmware.refresh()
        self._apply(Transition.T0_START)
        stored = int(self._mode_request.value)
        self._requested_mode = OperationMode(stored) if stored in self._modes else OperationMode.NONE
        self._take_mode()
        self._apply(Transition.T1_SELF_TEST_DONE)
        self._show_status(0.0)

    def follows(self, controlword: int) -> bool:
        """True if it is in OPERATION ENABLED by this controlword and follows a cyclic velocity or torque: then only
        its target and its feedback change until something is written, or a fault comes."""
        return (
            self.state is State.OPERATION_ENABLED
            and self._controlword == controlword
            and self._pending is None
            and not self._stop.active
            and self._requested_mode is self._mode_code
            and self._mode_code in _FOLLOWING
            and self.firmware.port.mode is self.mode.motor_mode is self.firmware.shown_mode
            and not self.firmware.stale
            and self.firmware.switches is None
            and (self._probes is None or self._probes.idle)
        )

    @property
    def following_bits(self) -> int:
        """Statusword of a drive that follows, except its internal limit bit."""
        return self._state_bits | self.mode.status(self._dt_s)

    def published_until(self, encoder_count: int, *, limited: bool) -> None:
        """Account for feedback published by the fast path: the encoder in position units, and whether a limit cut
        the set point."""
        self.firmware.encoder_count = encoder_count
        self.mode.limited = limited
        if self._probes is not None:
            self._probes.update()

    # --- once per cycle ----------------------------------------------------------------------------------------------

    def sync(self, dt_s: float) -> None:
        """Take this cycle's targets as set points of the motor; the plant advances by `dt_s` (seconds) after it."""
        self._dt_s = self.firmware.dt_s = dt_s
        if self.firmware.stale:
            self.firmware.refresh()
        if not self._powered:
            return
        if self._requested_mode is not self._mode_code and self._stop.then is None:
            self._take_mode()
        if self._stop.active:
            self._stop.command()
        else:
            self.mode.command()

    def publish(self) -> None:
        """Show the motor's feedback in the objects, supervise it, and bring the statusword up to date."""
        self.firmware.show()
        if self._probes is not None:
            self._probes.update()
        if self._pending is not None:
            self._wait_for_transition()
        if self._powered:
            self._supervise()
            if self._stop.active and self._stop.check_rest() and self._stop.then is not None:
                self._apply(self._stop.then)
        self._show_status(self._dt_s)

    def _supervise(self) -> None:
        firmware, mode = self.firmware, self.mode
        if not abs(firmware.port.velocity_rad_s) <= firmware.overspeed_rad_s:  # no number is too fast as well
            self.fault(ERROR_OVERSPEED)
        if mode.follows_position:
            mode.outside_window = abs(int(firmware.following_error.value)) > firmware.following_window
            if self._outside_window.update(mode.outside_window, self._dt_s, firmware.following_time_s):
                self.fault(ERROR_FOLLOWING)

    def _show_status(self, dt_s: float) -> None:
        """`dt_s`: time since the last one, for bits that need a condition to hold."""
        bits = self._state_bits
        if self._powered:
            if self._stop.active:
                bits |= STATUS_TARGET_REACHED if self._stop.at_rest else 0
            else:
                bits |= self.mode.status(dt_s)
            if self.mode.limited or self.firmware.port.torque_limited:
                bits |= STATUS_INTERNAL_LIMIT
        self.statusword.value = bits

    # --- power state machine -----------------------------------------------------------------------------------------

    def _controlword_written(self, controlword: int) -> None:
        previous, self._controlword = self._controlword, controlword
        transition = commanded(self.state, controlword, previous)
        if transition in _DELAYED and self._state_change_s > 0.0:
            if self._pending is None or self._pending[0] is not transition:
                self._pending = transition, self._state_change_s
            return
        self._pending = None
        self._obey(transition, controlword, previous)

    def _wait_for_transition(self) -> None:
        """A commanded transition that takes its time: one more cycle has passed."""
        assert self._pending is not None, "somebody waits"
        transition, left_s = self._pending
        self._pending = transition, left_s - self._dt_s
        if left_s - self._dt_s <= 0.0:
            self._pending = None
            self._perform(transition)
            following = commanded(self.state, self._controlword, self._controlword)
            if following in _DELAYED:
                self._pending = following, self._state_change_s

    def _obey(self, transition: Transition | None, controlword: int, previous: int) -> None:
        while transition is not None and self._perform(transition):
            transition = commanded(self.state, controlword, previous)
        if self.state is State.OPERATION_ENABLED:
            self._follow(controlword, previous)
        if controlword != previous:
            self._show_status(0.0)

    def _perform(self, transition: Transition) -> bool:
        """Carry out a commanded transition; whether a further one may follow by the same controlword."""
        if transition in _DISABLING and self._options[_DISABLING[transition]].value:
            self._begin_stop(StopKind.SLOW_DOWN_RAMP, then=transition)
            return False
        if transition is Transition.T11_QUICK_STOP:
            self._quick_stop()
            return False
        if transition is Transition.T16_ENABLE_OPERATION and not self._quick_stop_option()[1]:
            return False
        if transition is Transition.T15_FAULT_RESET and not self._clear_fault():
            return False
        self._apply(transition)
        return True

    def _apply(self, transition: Transition) -> None:
        """Enter the state that the transition leads to."""
        self.state = state = DESTINATION[transition]
        self._state_bits = state.value | STATUS_VOLTAGE_ENABLED | STATUS_REMOTE
        self._powered = state in POWERED
        if not self._powered:
            self._stop.end()
            self._switch_off()
        elif state is State.OPERATION_ENABLED:
            self._stop.end()
            self.mode.enter()

    def _switch_off(self) -> None:
        port = self.firmware.port
        port.mode = MotorMode.OFF
        port.setpoint = 0.0
        port.slope = inf

    def _follow(self, controlword: int, previous: int) -> None:
        """Act in OPERATION ENABLED: cancel a ramp towards disabling, halt, and the mode's own bits."""
        stop = self._stop
        disabling = stop.then is not None
        if disabling and decode_controlword(controlword) is not Command.ENABLE_OPERATION:
            return
        halt = bool(controlword & CONTROLWORD_HALT)
        if halt and (disabling or not stop.active):
            self._begin_halt()
        elif stop.active and not halt:
            stop.end()
            if disabling:
                self.mode.enter()
            else:
                self.mode.resume()
        if not halt:
            self.mode.follow_controlword(controlword, previous)

    def _begin_stop(self, kind: StopKind, then: Transition | None) -> None:
        self._stop.begin(kind, self.mode.motor_mode is MotorMode.TORQUE, then)

    def _begin_halt(self) -> None:
        self._begin_stop(StopKind(self._options[objects.HALT_OPTION_CODE].value), then=None)

    def _quick_stop_option(self) -> tuple[StopKind, bool]:
        return QUICK_STOP_OPTIONS[int(self._options[objects.QUICK_STOP_OPTION_CODE].value)]

    def _quick_stop(self) -> None:
        kind, stays = self._quick_stop_option()
        self._apply(Transition.T11_QUICK_STOP)
        if kind is StopKind.COAST:
            self._apply(Transition.T12_QUICK_STOP_DONE)
        else:
            self._begin_stop(kind, then=None if stays else Transition.T12_QUICK_STOP_DONE)

    # --- modes of operation ------------------------------------------------------------------------------------------

    def _mode_written(self, code: int) -> None:
        if code not in self._modes:
            raise SdoAbort(_ABORT_VALUE_RANGE)
        self._requested_mode = OperationMode(code)
        if not self._powered:
            self._take_mode()

    def _take_mode(self) -> None:
        self._mode_code = self._requested_mode
        self.mode = self._modes[self._mode_code]
        self._mode_display.value = int(self._mode_code)
        if self._stop.active:  # halted: continue with the stop of the new mode
            self._begin_halt()
        self.mode.enter()

    # --- faults ------------------------------------------------------------------------------------------------------

    def fault(self, code: int) -> None:
        """Fail with error code `code` (603Fh, EMCY): transition 13, then the reaction selected by 605Eh.

        A fault during a fault is not noted.
        """
        if self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self._report(code, REGISTER_PROFILE)
            self._fail(code)

    def _report(self, code: int, register: int) -> None:
        self._reported.append(code)
        self._device.emergency(code, register)

    def _take_back(self, code: int) -> None:
        if code in self._reported:
            self._reported.remove(code)
            self._device.clear_emergency(code)

    def _fail(self, code: int) -> None:
        reaction = StopKind(self._options[objects.FAULT_REACTION_OPTION_CODE].value)
        brakes = self._powered and reaction is not StopKind.COAST
        self._error_code.value = code
        # FAULT is an error situation, and one is signalled in 1001h at least as generic error (CiA 301, 7.5.2.2): the
        # error of a drive in FAULT ends with the fault reset (CiA 402, transition 15), not when its cause goes.
        self._device.keep_emergency(code)
        self._apply(Transition.T13_FAULT)
        if brakes:
            self._begin_stop(reaction, then=Transition.T14_FAULT_REACTION_DONE)
        else:
            self._apply(Transition.T14_FAULT_REACTION_DONE)
        self._show_status(0.0)

    def _clear_fault(self) -> bool:
        """End the fault if its cause has vanished; true if it ended."""
        code = int(self._error_code.value)
        firmware = self.firmware
        if code == ERROR_OVERSPEED and abs(firmware.port.velocity_rad_s) > firmware.motor_speed_limit_rad_s:
            return False
        self._error_code.value = 0
        self._outside_window = DebouncedCondition()
        # The device's runtime clears the errors that it reported (a lost heartbeat): at once if the cause has vanished.
        self._device.acknowledge_emergency(code)
        for reported in list(self._reported):
            self._take_back(reported)
        return True

    def _simulated_fault_written(self, code: int) -> None:
        if code:
            self.fault(code)

    # --- the connection to the master --------------------------------------------------------------------------------

    def _emergency_stop(self) -> None:
        """Quick stop at once, independent of 6007h: the command does not come from a connection that was lost."""
        if self.state is State.OPERATION_ENABLED:
            self._quick_stop()
            self._show_status(0.0)

    def _nmt_changed(self, state: NmtState) -> None:
        if state is NmtState.INITIALISING:
            # The objects are reset after this: power off now, start anew when the device boots.
            self._apply(Transition.T0_START)
            self._operational = False
            return
        if self.state is State.NOT_READY_TO_SWITCH_ON:
            self._power_on()
        left = self._operational and state is not NmtState.OPERATIONAL
        self._operational = state is NmtState.OPERATIONAL
        if self._operational and self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self._take_back(ERROR_COMMUNICATION)  # by 6007h it was no fault
        if left and self.state is State.OPERATION_ENABLED:
            # Set points come no more: an enabled drive would run on with the last one.
            self._report(ERROR_COMMUNICATION, REGISTER_COMMUNICATION)
            self._connection_lost(ERROR_COMMUNICATION)

    def _connection_lost(self, code: int) -> None:
        """React to a lost connection by 6007h: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop."""
        option = self._options[objects.ABORT_CONNECTION_OPTION_CODE].value
        if self.state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return
        if option == 1:
            self._fail(code)
        elif option == 2:
            self._apply(Transition.T9_DISABLE_VOLTAGE)
        elif option == 3 and self.state is State.OPERATION_ENABLED:
            self._quick_stop()
        self._show_status(0.0)


def _only(codes: Container[int], code: int) -> None:
    if code not in codes:
        raise SdoAbort(_ABORT_VALUE_RANGE)


def supported_modes(device: AxisDevice) -> int:
    """6502h; where the file names none, the modes whose target object the device has."""
    named = int(device.cell(objects.SUPPORTED_DRIVE_MODES).value) if device.has(objects.SUPPORTED_DRIVE_MODES) else 0
    if named:
        return named
    targets = {code: device.has(*target) for code, target in _TARGETS.items()}
    return sum(code.supported_bit for code, there in targets.items() if there)


def object_reader(device: AxisDevice) -> ObjectReader:
    """Read the device's own objects; None for those it lacks."""

    def read(index: int, sub: int) -> float | None:
        value = device.cell(index, sub).value if device.has(index, sub) else None
        return value if isinstance(value, int | float) else None

    return read
