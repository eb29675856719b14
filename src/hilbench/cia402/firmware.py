"""Shared state of a simulated drive's firmware: its objects as bound cells, its motor port, its settings."""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final

from hilbench.canopen.object_store import Cell
from hilbench.cia402 import objects
from hilbench.cia402.assumed import cell_of
from hilbench.cia402.switches import Switches
from hilbench.cia402.units import RPM, DriveUnits, wrap_int32
from hilbench.plant.motor_port import MotorMode, MotorPort

if TYPE_CHECKING:
    from hilbench.cia402.axis import AxisDevice

#: Fault "overspeed" at so much of 6080h: a loop that settles at the limit itself is no fault.
OVERSPEED_RATIO: Final = 1.1
#: 6065h: no supervision.
NO_WINDOW: Final = 0xFFFF_FFFF

_INT16_MAX: Final = 0x7FFF


class Firmware:
    """Cells, port, units and the settings derived from the parameter objects (SI, motor side).

    Settings are recomputed by `refresh` only after a parameter was written (`stale`).
    """

    def __init__(self, device: AxisDevice, port: MotorPort, units: DriveUnits) -> None:
        self.port = port
        self.units = units
        cell = partial(cell_of, device, units)
        self.controlword = device.cell(objects.CONTROLWORD)
        self.target_velocity = cell(objects.TARGET_VELOCITY)
        self.velocity_offset = cell(objects.VELOCITY_OFFSET)
        self.target_torque = cell(objects.TARGET_TORQUE)
        self.torque_offset = cell(objects.TORQUE_OFFSET)
        self.target_position = cell(objects.TARGET_POSITION)
        self.interpolated_target = cell(objects.INTERPOLATION_DATA_RECORD, 1)
        self.vl_target = cell(objects.VL_TARGET_VELOCITY)
        self.home_offset = cell(objects.HOME_OFFSET)
        self.homing_method = cell(objects.HOMING_METHOD)

        self.position_actual = cell(objects.POSITION_ACTUAL_VALUE)
        self.position_demand = cell(objects.POSITION_DEMAND_VALUE)
        self.following_error = cell(objects.FOLLOWING_ERROR_ACTUAL_VALUE)
        self.velocity_actual = cell(objects.VELOCITY_ACTUAL_VALUE)
        self.velocity_demand = cell(objects.VELOCITY_DEMAND_VALUE)
        self.torque_actual = cell(objects.TORQUE_ACTUAL_VALUE)
        self.torque_demand = cell(objects.TORQUE_DEMAND)
        self.vl_demand = cell(objects.VL_VELOCITY_DEMAND)
        self.vl_actual = cell(objects.VL_VELOCITY_ACTUAL_VALUE)
        self.shows_vl = device.has(objects.VL_VELOCITY_ACTUAL_VALUE)
        self.digital_inputs = cell(objects.DIGITAL_INPUTS)

        self._device = device
        self._parameters: dict[tuple[int, int], Cell] = {}
        #: Inputs in addition to the encoder; None: none.
        self.switches: Switches | None = None
        #: Time until the plant has advanced by this cycle's set points (s).
        self.dt_s = 0.0
        #: Position units between the encoder's zero and the application's (set by homing).
        self.position_origin = 0
        #: The encoder's reading in position units, not wrapped, without the origin.
        self.encoder_count = 0
        self.shown_mode = MotorMode.OFF  #: mode whose demand the objects show
        self.refresh()

    def _value(self, index: int, sub: int = 0) -> int:
        """Value of a parameter, whose change makes the settings stale."""
        parameter = self._parameters.get((index, sub))
        if parameter is None:
            parameter = self._parameters[index, sub] = cell_of(self._device, self.units, index, sub)
            parameter.on_write = self._parameter_written
        return int(parameter.value)

    def _parameter_written(self, _value: object) -> None:
        self.stale = True

    def angle_rad(self, position: int) -> float:
        """Angle of an encoder position (position units); 32-bit counts wrap, and the nearest one is meant."""
        distance = wrap_int32(position - self.encoder_count - self.position_origin)
        return (self.encoder_count + distance) * self.units.position_rad

    def refresh(self) -> None:
        """Derive the settings from the parameter objects."""
        self.stale = False
        units, value = self.units, self._value
        self.motor_speed_limit_rad_s = value(objects.MAX_MOTOR_SPEED) * RPM or inf
        profile_limit = value(objects.MAX_PROFILE_VELOCITY) * units.velocity_rad_s or inf
        self.velocity_limit_rad_s = min(self.motor_speed_limit_rad_s, profile_limit)
        self.overspeed_rad_s = self.motor_speed_limit_rad_s * OVERSPEED_RATIO
        self.torque_limit_Nm = value(objects.MAX_TORQUE) * units.torque_Nm
        self.profile_velocity_rad_s = value(objects.PROFILE_VELOCITY) * units.velocity_rad_s
        self.end_velocity_rad_s = value(objects.END_VELOCITY) * units.velocity_rad_s
        self.acceleration_rad_s2 = value(objects.PROFILE_ACCELERATION) * units.acceleration_rad_s2
        self.deceleration_rad_s2 = value(objects.PROFILE_DECELERATION) * units.acceleration_rad_s2
        self.quick_stop_deceleration_rad_s2 = value(objects.QUICK_STOP_DECELERATION) * units.acceleration_rad_s2
        self.torque_slope_Nm_s = value(objects.TORQUE_SLOPE) * units.torque_Nm
        window = value(objects.FOLLOWING_ERROR_WINDOW)
        self.following_window = inf if window == NO_WINDOW else window
        self.following_time_s = value(objects.FOLLOWING_ERROR_TIME_OUT) / 1000.0
        window = value(objects.POSITION_WINDOW)
        self.position_window = inf if window == NO_WINDOW else window
        self.position_window_time_s = value(objects.POSITION_WINDOW_TIME) / 1000.0
        low, high = (value(objects.SOFTWARE_POSITION_LIMIT, sub) for sub in (1, 2))
        #: 607Dh in position units; None: both are 0, or the lower is not below the upper.
        self.software_limits = (low, high) if low < high else None
        self.velocity_window_rad_s = value(objects.VELOCITY_WINDOW) * units.velocity_rad_s
        self.velocity_window_time_s = value(objects.VELOCITY_WINDOW_TIME) / 1000.0
        self.standstill_rad_s = value(objects.VELOCITY_THRESHOLD) * units.velocity_rad_s
        self.standstill_time_s = value(objects.VELOCITY_THRESHOLD_TIME) / 1000.0
        period, power = (value(objects.INTERPOLATION_TIME_PERIOD, sub) for sub in (1, 2))
        self.interpolation_period_s = period * 10.0**power
        fast, slow = (value(objects.HOMING_SPEEDS, sub) * units.velocity_rad_s for sub in (1, 2))
        self.homing_switch_speed_rad_s, self.homing_zero_speed_rad_s = fast, slow
        self.homing_acceleration_rad_s2 = value(objects.HOMING_ACCELERATION) * units.acceleration_rad_s2
        slowest, fastest = (value(objects.VL_VELOCITY_MIN_MAX_AMOUNT, sub) * RPM for sub in (1, 2))
        self.vl_slowest_rad_s, self.vl_fastest_rad_s = slowest, min(fastest or inf, self.motor_speed_limit_rad_s)
        self.vl_acceleration_rad_s2 = self._ramp_rad_s2(objects.VL_VELOCITY_ACCELERATION)
        self.vl_deceleration_rad_s2 = self._ramp_rad_s2(objects.VL_VELOCITY_DECELERATION)
        self.port.torque_limit_Nm = self.torque_limit_Nm

    def _ramp_rad_s2(self, index: int) -> float:
        """A ramp of the velocity mode: delta speed in rpm by delta time in s; without a time, at once."""
        speed, time_s = self._value(index, 1), self._value(index, 2)
        return speed * RPM / time_s if time_s else inf

    def show(self) -> None:
        """Write the port's feedback and demands into the objects, in device units.

        A plant that has run away beyond all numbers leaves the objects as they were.
        """
        try:
            self._show()
        except (OverflowError, ValueError):
            return

    def _show(self) -> None:
        port, units = self.port, self.units
        count = round(port.position_rad / units.position_rad)
        velocity = wrap_int32(round(port.velocity_rad_s / units.velocity_rad_s))
        torque = round(port.torque_Nm / units.torque_Nm)
        self.encoder_count = count
        position = wrap_int32(count + self.position_origin)
        self.position_actual.value = position
        self.velocity_actual.value = velocity
        self.torque_actual.value = max(-_INT16_MAX, min(_INT16_MAX, torque))
        if self.shows_vl:
            self.vl_actual.value = max(-_INT16_MAX, min(_INT16_MAX, round(port.velocity_rad_s / RPM)))
        if self.switches is not None:
            self.digital_inputs.value = self.switches.inputs(port.position_rad)
        self._show_demands(position)

    def _show_demands(self, position: int) -> None:
        """Demand of the loop that is closed; the others show no demand (position: the actual one)."""
        port, units, mode = self.port, self.units, self.port.mode
        if mode is not self.shown_mode:
            self.shown_mode = mode
            self.following_error.value = self.velocity_demand.value = self.torque_demand.value = 0
        if mode is MotorMode.POSITION:
            demand = round(port.reference / units.position_rad)
            self.following_error.value = wrap_int32(demand - self.encoder_count)
            position = wrap_int32(demand + self.position_origin)
        elif mode is MotorMode.VELOCITY:
            self.velocity_demand.value = wrap_int32(round(port.reference / units.velocity_rad_s))
        elif mode is MotorMode.TORQUE:
            self.torque_demand.value = round(port.reference / units.torque_Nm)
        self.position_demand.value = position

    def set_home(self, position: int, at_count: int | None = None) -> None:
        """Set `position` (position units) as that at the encoder count `at_count` (None: the present one)."""
        self.position_origin = position - (self.encoder_count if at_count is None else at_count)
        self.position_actual.value = wrap_int32(self.encoder_count + self.position_origin)
