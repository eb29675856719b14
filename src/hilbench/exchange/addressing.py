"""Addressing and configuration of a bench's participants: PDOs of the virtual I/O, settings of the drives, clock."""

from __future__ import annotations

from dataclasses import dataclass

import canopen
from hilbench.canopen.clock import Clock, MonotonicClock, SyncClock
from hilbench.canopen.eds import shared_eds
from hilbench.canopen.identifiers import HEARTBEAT, RPDO_INDICES, RPDOS, TPDO_INDICES, TPDOS
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402 import objects
from hilbench.cia402.axis import object_of, rpdo_identifier
from hilbench.cia402.configuration import DriveSettings, RpdoCopy, default_reader
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.units import DriveUnits, ObjectReader
from hilbench.machine_kinds import machine_part
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from hilbench.topology.process_data.table import PER_PDO, STATUS_TPDO, IoPdo, ProcessData

_ABORT_BY_QUICK_STOP = 3
_QUICK_STOP_RAMP = 2


@dataclass(frozen=True)
class IoMaps:
    """PDOs of the virtual I/O; `hilbench.topology.process_data` defines the signals in them."""

    data: ProcessData
    sent: tuple[PdoMap, ...]  #: simulated and estimated signals with their uncertainties, in the order of `data.sent`
    status: PdoMap  #: TPDO3: SYNC counter of the data, age, status bits
    #: RPDO1 and following: boundary inputs of the twin, in the order of `data.boundary_inputs`.
    boundary: tuple[PdoMap, ...]

    @classmethod
    def of(cls, config: BenchConfig) -> IoMaps:
        """The maps by the EDS of the virtual I/O. Raises KeyError or ValueError for what it lacks."""
        data = machine_part(config.machine.kind, "topology").process_data(config.shape)
        (part,) = config.parts_of(Role.VIRTUAL_IO)
        od = dictionary_of(part)

        def pdo_map(cob_id: int, pdo: IoPdo, indices: range) -> PdoMap:
            names = [f"0x{signal.index:04X}sub{signal.sub:X}" for signal in pdo.signals]
            return PdoMap.from_names(od, cob_id, pdo.every, names, indices[pdo.number - 1])

        node_id = config.twin.node.node_id
        for pdo in data.sent:
            if (index := TPDO_INDICES[pdo.number - 1]) not in od:
                raise KeyError(
                    f"the virtual I/O has no TPDO{pdo.number} (object {index:04X}h), expected an EDS "
                    f"file with {len(data.sent) + 1} of them, such as hilbench_virtual_io_long.eds for up to 24 rollers"
                )
        if len(data.boundary) > len(RPDOS):
            raise ValueError(
                f"{len(data.boundary_inputs)} values for the twin, expected at most {PER_PDO * len(RPDOS)}"
            )
        status = [f"0x2100sub{n}" for n in (1, 2, 3)]
        return cls(
            data,
            tuple(pdo_map(_tpdo_id(config, pdo.number), pdo, TPDO_INDICES) for pdo in data.sent),
            PdoMap.from_names(od, _tpdo_id(config, STATUS_TPDO), 1, status, TPDO_INDICES[STATUS_TPDO - 1]),
            tuple(pdo_map(RPDOS[pdo.number - 1] + node_id, pdo, RPDO_INDICES) for pdo in data.boundary),
        )

    @property
    def tpdos(self) -> list[PdoMap]:
        """Every TPDO by its number."""
        return sorted([*self.sent, self.status], key=lambda pdo: pdo.communication)

    @property
    def all(self) -> list[PdoMap]:
        """All PDOs of the virtual I/O: TPDOs, then RPDOs."""
        return [*self.tpdos, *self.boundary]


def _tpdo_id(config: BenchConfig, number: int) -> int:
    """COB-ID of a TPDO of the virtual I/O.

    The predefined connection set gives a node four (CiA 301, 7.3.5). Further ones have the identifiers of the fourth
    TPDOs of the virtual axes, then of their third: the same process plays these, and sends nothing under them.
    """
    if number <= len(TPDOS):
        return TPDOS[number - 1] + config.twin.node.node_id
    axes = config.parts_of(Role.VIRTUAL_AXIS)
    function, axis = divmod(number - len(TPDOS) - 1, len(axes))
    return TPDOS[3 - function] + axes[axis].node.node_id


def device_clock(config: BenchConfig) -> Clock:
    """The time base of simulated devices and virtual axes: SYNC in lockstep, else the monotonic clock."""
    if config.pace != "lockstep":
        return MonotonicClock()
    return SyncClock(config.cycle_ns, kept_by=HEARTBEAT + config.master.node_id if config.master.heartbeat_ms else None)


def drive_settings(config: BenchConfig, part: Part) -> DriveSettings:
    """Settings with which the bench configures a drive, real or virtual."""
    assert part.axis is not None, "the virtual I/O is no drive"
    od = dictionary_of(part)
    node, virtual, load = part.node, part.role is Role.VIRTUAL_AXIS, part.role is Role.LOAD_MOTOR
    torqued = load or part.axis in config.shape.torqued
    rad_per_unit = config.machine.motor_rad_per_unit(part.axis)
    units = declared_units(part)
    deceleration = round(config.quick_stop_per_s2 * rad_per_unit / units.acceleration_rad_s2)
    values = {
        objects.QUICK_STOP_DECELERATION: deceleration,
        objects.QUICK_STOP_OPTION_CODE: _QUICK_STOP_RAMP,
        objects.ABORT_CONNECTION_OPTION_CODE: _ABORT_BY_QUICK_STOP,
    }
    parameters = {(object_of(part.node_axis, index), 0): value for index, value in values.items()}
    real = config.parts_of(Role.AXIS)[part.axis - 1]
    listened = rpdo_identifier(real.node.node_id, real.node_axis)
    copies: tuple[RpdoCopy, ...] = ()
    if config.mirroring == "copy" and not virtual and not load:
        copies = (_copy_for(config.parts_of(Role.VIRTUAL_AXIS)[part.axis - 1], units, torqued=torqued),)
    return DriveSettings(
        name=part.label,
        node_id=node.node_id,
        mode=OperationMode.CYCLIC_SYNCHRONOUS_TORQUE if torqued else OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY,
        cycle_s=config.cycle_time_s,
        has_velocity=not load,
        units=node.unit_overrides,
        parameters={**node.writes, **{key: value for key, value in parameters.items() if key[0] in od}},
        heartbeat_ms=config.master.node_heartbeat_ms,
        master_heartbeat=_master_heartbeat(config, virtual),
        listens_to=listened if virtual and config.mirroring == "listen" else None,
        copies=copies,
        tpdo_type=(config.twin.virtual_tpdo_every or None) if virtual else 1,
        time_out_s=config.safety.drive_timeout_s,
        axis=part.node_axis,
    )


def _copy_for(virtual: Part, units: DriveUnits, *, torqued: bool) -> RpdoCopy:
    """The copy of an axis' RPDO for its virtual axis, whose units may be others."""
    theirs = declared_units(virtual)
    factor = units.torque_Nm / theirs.torque_Nm if torqued else units.velocity_rad_s / theirs.velocity_rad_s
    return RpdoCopy(rpdo_identifier(virtual.node.node_id, virtual.node_axis), factor)


def dictionary_of(part: Part) -> canopen.ObjectDictionary:
    """Object dictionary of a part by its EDS file, shared and not to be changed. Raises UnusableInputError."""
    return shared_eds(part.node.eds, part.node.node_id)


def declared_objects(part: Part) -> ObjectReader:
    """Reader of a drive's objects by its EDS file and the config."""
    return default_reader(dictionary_of(part), part.node.writes, part.node_axis)


def declared_units(part: Part) -> DriveUnits:
    """Units of a drive by its EDS file and the config; the device itself is read when it is configured."""
    return DriveUnits.from_objects(declared_objects(part), part.node.unit_overrides, part.name)


def _master_heartbeat(config: BenchConfig, virtual: bool) -> tuple[int, int] | None:
    """Heartbeat consumer entry of a real drive for the bench: (node id, time in ms = three periods)."""
    period_ms = config.master.heartbeat_ms
    return (config.master.node_id, 3 * period_ms) if period_ms and not virtual else None
