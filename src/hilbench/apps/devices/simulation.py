"""Drives by EDS files: each a CANopen device with a CiA-402 firmware and a motor that turns a shaft of its own."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hilbench.apps.devices.application import CYCLE_S, SAMPLE_S, SERIAL_NUMBER, DrivesApplication, SimulatedNode
from hilbench.apps.devices.behaviour import Behaviour, RefusedWrite
from hilbench.canopen.clock import Clock, MonotonicClock
from hilbench.canopen.data_types import data_type
from hilbench.canopen.device import Device
from hilbench.canopen.eds import all_variables, load_eds, variable
from hilbench.canopen.host import HostedDevices
from hilbench.canopen.object_store import SdoAbort, Value
from hilbench.cia402.assumed import assumed_units
from hilbench.cia402.axis import AxisDevice, axes, of_first_axis
from hilbench.cia402.configuration import IDENTITY
from hilbench.cia402.simulated import SimulatedDrive as Cia402Drive
from hilbench.cia402.simulated import object_reader
from hilbench.cia402.units import RPM, DriveUnits
from hilbench.errors import UnusableInputError
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.parameters import DriveParameters, LoadMotorParameters
from hilbench.plant.sensors import SensorParameters
from hilbench.plant.servo_axis.parameters import (
    MotorParameters,
    ServoAxisParameters,
    ServoRigParameters,
    ShaftParameters,
)
from hilbench.plant.servo_axis.shaft import ServoRig

if TYPE_CHECKING:
    from canopen import ObjectDictionary

#: Objects of CiA 402 that a drive calculates with.
_INTEGERS = (*range(0x6040, 0x6100), 0x6502)
#: Name of the device as it says it itself (CiA 301).
_DEVICE_NAME = 0x1008
#: The motor that is behind a drive unless its behaviour says otherwise: rated torque brings it to 1000 rpm in 0.1 s.
_RUN_UP_RAD_S, _RUN_UP_S = 1000.0 * RPM, 0.1
_MOST_NAMED = 5  # objects in one line
_PEAK_TORQUE = 3.0  # of the rated one
_LOOP_RAD_S, _POSITION_LOOP_PER_S = 150.0, 40.0


def simulated_axes(
    eds: Path, node_id: int, clock: Clock, behaviour: Behaviour | None = None, *, serial_number: int | None = None
) -> list[SimulatedNode]:
    """The drive of an EDS or DCF file, axis by axis; `serial_number` in place of the file's (1018h sub 4).

    Raises UnusableInputError for a file that is none of a CiA-402 drive.
    """
    behaviour = behaviour or Behaviour()
    od = load_eds(eds, node_id)
    _fill_in_header_objects(od)
    odd = _odd_entries(od)
    if serial_number is not None:
        _give_serial_number(eds, od, serial_number)
    name = od.device_information.product_name or eds.stem
    try:
        device = Device(od, node_id, clock)
        there = axes(device.has) or [1]
        beyond = [event.axis for event in behaviour.events if event.axis not in there]
        if beyond:
            known = ", ".join(map(str, there))
            raise UnusableInputError("", f"an event of axis {beyond[0]}, expected one of those that it has: {known}")
        found = [_simulated_axis(device, axis, behaviour, name, eds, odd) for axis in there]
    except UnusableInputError as error:
        raise UnusableInputError(str(eds), error.problem) from error
    for refused in behaviour.refuse:
        _refuse(device, refused)
    return found


def _simulated_axis(
    device: Device, axis: int, behaviour: Behaviour, name: str, eds: Path, odd: Sequence[str]
) -> SimulatedNode:
    units, assumptions = assumed_units(
        object_reader(AxisDevice(device, axis)), behaviour.units.model_dump(exclude_none=True), str(eds)
    )
    port, switches = MotorPort(), behaviour.switches.switches()
    drive = Cia402Drive(device, port, units, axis=axis, switches=switches, state_change_s=behaviour.state_change_s)
    rig = _rig(units, behaviour.shaft, port)
    notes = [*assumptions, *odd, *device.left_out.values()]
    return SimulatedNode(device, drive, port, rig, units, behaviour, notes, name, axis)


def _odd_entries(od: ObjectDictionary) -> list[str]:
    """What is not taken as the file has it, in a line; CiA 402's objects that are no integers are left out."""
    for each in all_variables(od):
        code = each.data_type or 0
        if of_first_axis(each.index) in _INTEGERS and not data_type(code).is_integer:
            each.description = f"data type {code:04X}h, not as in CiA 402, left out"
    found = [each for each in all_variables(od) if each.description]
    for index in {each.index for each in found if of_first_axis(each.index) in _INTEGERS and "CiA" in each.description}:
        del od[index]
    named = ", ".join(f"{each.index:04X}h:{each.subindex} ({each.description})" for each in found[:_MOST_NAMED])
    more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
    return [f"not as the file has it: {named}{more}"] if found else []


def _fill_in_header_objects(od: ObjectDictionary) -> None:
    """Identity and name of the device where their objects have no value: makers leave them to [DeviceInfo]."""
    header = od.device_information
    defaults: dict[tuple[int, int], Any] = {
        (IDENTITY, 1): header.vendor_number,
        (IDENTITY, 2): header.product_number,
        (IDENTITY, 3): header.revision_number,
        (_DEVICE_NAME, 0): header.product_name,
    }
    for (index, sub), value in defaults.items():
        with suppress(KeyError):
            found = variable(od, index, sub)
            if value and found.default is None and found.value is None:
                found.default = value


def _give_serial_number(eds: Path, od: ObjectDictionary, serial_number: int) -> None:
    try:
        found = variable(od, *SERIAL_NUMBER)
    except KeyError:
        raise UnusableInputError(eds, "it has no serial number (1018h sub 4), expected one to be given") from None
    found.default = found.value = serial_number


def hosted(nodes: Sequence[SimulatedNode], clock: Clock) -> tuple[HostedDevices, DrivesApplication]:
    """Devices of a host, and the application through which a test acts on the drives."""
    application = DrivesApplication(nodes, clock.now_ns)
    return HostedDevices(list(dict.fromkeys(node.device for node in nodes)), clock, application), application


def new_clock() -> Clock:
    """Clock of drives that no master waits for."""
    return MonotonicClock(stall_s=1.5 * CYCLE_S)


def _rig(units: DriveUnits, shaft: ShaftParameters | None, port: MotorPort) -> ServoRig:
    rated_Nm = 1000.0 * units.torque_Nm
    behind = shaft or ShaftParameters(inertia_kg_m2=rated_Nm * _RUN_UP_S / _RUN_UP_RAD_S)
    inertia = behind.inertia_kg_m2
    kp = inertia * _LOOP_RAD_S
    drives = DriveParameters(
        velocity_kp_Nm_s_per_rad=kp,
        velocity_ki_Nm_per_rad=kp * _LOOP_RAD_S / 5.0,
        position_kp_per_s=_POSITION_LOOP_PER_S,
        torque_limit_Nm=_PEAK_TORQUE * rated_Nm,
        sample_time_s=SAMPLE_S,
    )
    axis = ServoAxisParameters(shaft=behind, motor=MotorParameters(), drives=drives)
    sensors = SensorParameters(encoder_rad_per_count=min(units.position_rad, 2.0 * pi))
    parameters = ServoRigParameters(axis=axis, load_motor=LoadMotorParameters(), sensors=sensors)
    # A first one off the bus, so that compiling is over before the device boots.
    ServoRig(parameters, (MotorPort(), MotorPort())).step(SAMPLE_S)
    return ServoRig(parameters, (port, MotorPort()))


def _refuse(device: Device, refused: RefusedWrite) -> None:
    if not device.has(refused.index, refused.sub):
        raise UnusableInputError(
            "behaviour", f"refuse: {refused.index:04X}h sub {refused.sub} is not in the EDS file, expected one that is"
        )

    def refuse(_value: Value) -> None:
        raise SdoAbort(refused.abort_code)

    device.cell(refused.index, refused.sub).on_write = refuse
