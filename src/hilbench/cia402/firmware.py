"""What the parts of a simulated drive's firmware share: its objects as bound cells, its motor port, its settings."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Final

from hilbench.cia402 import objects
from hilbench.cia402.units import RPM, DriveUnits, wrap_int32
from hilbench.plant.motor_port import MotorMode, MotorPort

if TYPE_CHECKING:
    from hilbench.canopen.device import Device

#: Fault "overspeed" at so much of 6080h: a loop that settles at the limit itself is no fault.
OVERSPEED_RATIO: Final = 1.1
#: 6065h: no supervision.
NO_WINDOW: Final = 0xFFFF_FFFF

_INT16_MAX: Final = 0x7FFF


class Firmware:
    """Cells, port, units and the settings derived from the parameter objects (SI, motor side).

    Settings are recomputed by `refresh` only after a parameter was written (`stale`).
    """

    def __init__(self, device: Device, port: MotorPort, units: DriveUnits) -> None:
        self.port = port
        self.units = units
        cell = device.cell
        self.controlword = cell(objects.CONTROLWORD)
        self.target_velocity = cell(objects.TARGET_VELOCITY)
        self.velocity_offset = cell(objects.VELOCITY_OFFSET)
        self.target_torque = cell(objects.TARGET_TORQUE)
        self.torque_offset = cell(objects.TORQUE_OFFSET)
        self.target_position = cell(objects.TARGET_POSITION)
        self.home_offset = cell(objects.HOME_OFFSET)

        self.position_actual = cell(objects.POSITION_ACTUAL_VALUE)
        self.position_demand = cell(objects.POSITION_DEMAND_VALUE)
        self.following_error = cell(objects.FOLLOWING_ERROR_ACTUAL_VALUE)
        self.velocity_actual = cell(objects.VELOCITY_ACTUAL_VALUE)
        self.velocity_demand = cell(objects.VELOCITY_DEMAND_VALUE)
        self.torque_actual = cell(objects.TORQUE_ACTUAL_VALUE)
        self.torque_demand = cell(objects.TORQUE_DEMAND)

        self._max_torque = cell(objects.MAX_TORQUE)
        self._max_motor_speed = cell(objects.MAX_MOTOR_SPEED)
        self._max_profile_velocity = cell(objects.MAX_PROFILE_VELOCITY)
        self._acceleration = cell(objects.PROFILE_ACCELERATION)
        self._deceleration = cell(objects.PROFILE_DECELERATION)
        self._quick_stop_deceleration = cell(objects.QUICK_STOP_DECELERATION)
        self._torque_slope = cell(objects.TORQUE_SLOPE)
        self._following_window = cell(objects.FOLLOWING_ERROR_WINDOW)
        self._following_time = cell(objects.FOLLOWING_ERROR_TIME_OUT)
        self._velocity_window = cell(objects.VELOCITY_WINDOW)
        self._velocity_window_time = cell(objects.VELOCITY_WINDOW_TIME)
        self._velocity_threshold = cell(objects.VELOCITY_THRESHOLD)
        self._velocity_threshold_time = cell(objects.VELOCITY_THRESHOLD_TIME)
        self._period_value = cell(objects.INTERPOLATION_TIME_PERIOD, 1)
        self._period_index = cell(objects.INTERPOLATION_TIME_PERIOD, 2)
        for parameter in (
            *(self._max_torque, self._max_motor_speed, self._max_profile_velocity),
            *(self._acceleration, self._deceleration, self._quick_stop_deceleration, self._torque_slope),
            *(self._following_window, self._following_time),
            *(self._velocity_window, self._velocity_window_time),
            *(self._velocity_threshold, self._velocity_threshold_time),
            *(self._period_value, self._period_index),
        ):
            parameter.on_write = self._parameter_written

        #: Position units between the encoder's zero and the application's (set by homing).
        self.position_origin = 0
        #: The encoder's reading in position units, not wrapped, without the origin.
        self.encoder_count = 0
        self._shown_mode = MotorMode.OFF
        self.refresh()

    def _parameter_written(self, _value: object) -> None:
        self.stale = True

    def refresh(self) -> None:
        """Derive the settings from the parameter objects."""
        self.stale = False
        units = self.units
        self.motor_speed_limit_rad_s = int(self._max_motor_speed.value) * RPM or inf
        profile_limit = int(self._max_profile_velocity.value) * units.velocity_rad_s or inf
        self.velocity_limit_rad_s = min(self.motor_speed_limit_rad_s, profile_limit)
        self.overspeed_rad_s = self.motor_speed_limit_rad_s * OVERSPEED_RATIO
        self.torque_limit_Nm = int(self._max_torque.value) * units.torque_Nm
        self.acceleration_rad_s2 = int(self._acceleration.value) * units.acceleration_rad_s2
        self.deceleration_rad_s2 = int(self._deceleration.value) * units.acceleration_rad_s2
        self.quick_stop_deceleration_rad_s2 = int(self._quick_stop_deceleration.value) * units.acceleration_rad_s2
        self.torque_slope_Nm_s = int(self._torque_slope.value) * units.torque_Nm
        window = int(self._following_window.value)
        self.following_window = inf if window == NO_WINDOW else window
        self.following_time_s = int(self._following_time.value) / 1000.0
        self.velocity_window_rad_s = int(self._velocity_window.value) * units.velocity_rad_s
        self.velocity_window_time_s = int(self._velocity_window_time.value) / 1000.0
        self.standstill_rad_s = int(self._velocity_threshold.value) * units.velocity_rad_s
        self.standstill_time_s = int(self._velocity_threshold_time.value) / 1000.0
        self.interpolation_period_s = int(self._period_value.value) * 10.0 ** int(self._period_index.value)
        self.port.torque_limit_Nm = self.torque_limit_Nm

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
        self._show_demands(position)

    def _show_demands(self, position: int) -> None:
        """Demand of the loop that is closed; the others show no demand (position: the actual one)."""
        port, units, mode = self.port, self.units, self.port.mode
        if mode is not self._shown_mode:
            self._shown_mode = mode
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

    def set_home(self, position: int) -> None:
        """Let the present position be `position` (position units)."""
        self.position_origin = position - self.encoder_count
        self.position_actual.value = wrap_int32(position)
