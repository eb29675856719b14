"""Set-up of a drive over SDO before it is started: identity, units, mode, parameters, heartbeat, PDOs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Final

from canopen.objectdictionary import ObjectDictionary, ODVariable

from hilbench.canopen import eds
from hilbench.canopen.identifiers import COB_ID, INVALID, MAPPING, RPDO_INDICES, TPDO_INDICES
from hilbench.canopen.master import Master
from hilbench.canopen.pdo import PdoMap, received_by, sent_by
from hilbench.cia402 import objects
from hilbench.cia402.axis import axes, object_of, pdo_places, rpdo_identifier, tpdo_identifiers
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.units import DriveUnits, ObjectReader
from hilbench.errors import BenchFaultError, UnusableInputError

IDENTITY: Final = 0x1018
CONSUMER_HEARTBEAT: Final = 0x1016
PRODUCER_HEARTBEAT: Final = 0x1017
_MAPPINGS: Final = range(RPDO_INDICES.start + MAPPING, TPDO_INDICES.stop + MAPPING)

#: The object that each mode with a cyclic set point takes it from.
SETPOINT_OBJECTS: Final = {
    OperationMode.PROFILE_VELOCITY: objects.TARGET_VELOCITY,
    OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY: objects.TARGET_VELOCITY,
    OperationMode.TORQUE: objects.TARGET_TORQUE,
    OperationMode.CYCLIC_SYNCHRONOUS_TORQUE: objects.TARGET_TORQUE,
    OperationMode.CYCLIC_SYNCHRONOUS_POSITION: objects.TARGET_POSITION,
}
#: 6061h may lag behind 6060h: so often it is read before the mode counts as refused.
_MODE_READS: Final = 50


@dataclass(frozen=True)
class RpdoCopy:
    """A copy of RPDO1 for another device: its COB-ID, and what set points are multiplied by for that device's units."""

    cob_id: int
    factor: float = 1.0


@dataclass(frozen=True)
class DriveSettings:
    """Configuration settings of one drive."""

    name: str  #: for messages: "axis 1"
    node_id: int
    mode: OperationMode
    cycle_s: float
    has_velocity: bool = True  #: TPDO2 with 606Ch (axes); else velocity is taken from the position
    #: Overrides of `DriveUnits.from_objects`, for drives whose objects do not give their units.
    units: Mapping[str, float] = field(default_factory=dict)
    #: Objects written at configuration, in this order, by (index, sub), each as the node has it: option codes, ramps.
    parameters: Mapping[tuple[int, int], int | float] = field(default_factory=dict)
    #: (vendor-ID, product code) that the device must show; None: those of its EDS.
    identity: tuple[int, int] | None = None
    heartbeat_ms: int = 100  #: producer time of the drive; 0: none
    #: Heartbeat that the drive expects of the master: (node-ID, time-out in ms); None: none.
    master_heartbeat: tuple[int, int] | None = None
    #: COB-ID of another drive's RPDO1 that this drive listens to (a virtual axis that mirrors it), or None.
    listens_to: int | None = None
    copies: tuple[RpdoCopy, ...] = ()  #: who else gets RPDO1 in the same cycle
    tpdo_type: int | None = 1  #: transmission type of the TPDOs; None: the drive sends none
    time_out_s: float = 2.0  #: longest stay in one state on the way to a goal, s of cycle time
    ramp_time_out_s: float = 20.0  #: longest stay in a state that may end by a ramp
    axis: int = 1  #: of the node's axes (`hilbench.cia402.axis`)

    def object(self, index: int) -> int:
        """Index at the node of an object of this axis, named as that of the first one."""
        return object_of(self.axis, index)

    @property
    def place(self) -> str:
        """Node, and axis where it is not the first, for messages."""
        return place_of(self.node_id, self.axis)


def place_of(node_id: int, axis: int) -> str:
    """A drive's place on the bus, for messages."""
    return f"node {node_id}" if axis == 1 else f"node {node_id}, axis {axis}"


@dataclass(frozen=True)
class DrivePdos:
    """The PDOs of one drive."""

    rpdo: PdoMap  #: controlword, target
    tpdos: tuple[PdoMap, ...]  #: empty when the drive sends none

    @property
    def all(self) -> tuple[PdoMap, ...]:
        """RPDO, then TPDOs."""
        return self.rpdo, *self.tpdos


def drive_pdos(settings: DriveSettings, od: ObjectDictionary) -> DrivePdos:
    """The PDO layout (design section 4) with the types of the EDS.

    RPDO1: controlword and target; TPDO1: statusword, 6077h, 6064h; TPDO2 (axes): 606Ch; of a second axis RPDO65, TPDO65
    and TPDO66, or RPDO2, TPDO3 and TPDO4 where the EDS has no others. Raises UnusableInputError when the mode has no
    target object, or the EDS lacks an object that is mapped.
    """
    if settings.mode not in SETPOINT_OBJECTS:
        expected = ", ".join(str(int(mode)) for mode in SETPOINT_OBJECTS)
        raise UnusableInputError(settings.name, f"mode of operation {int(settings.mode)}, expected one of {expected}")
    node_id, axis = settings.node_id, settings.axis
    mapped: list[tuple[int, ...]] = [(objects.CONTROLWORD, SETPOINT_OBJECTS[settings.mode])]
    if settings.tpdo_type is not None:
        mapped += [(objects.STATUSWORD, objects.TORQUE_ACTUAL_VALUE, objects.POSITION_ACTUAL_VALUE)]
        mapped += [(objects.VELOCITY_ACTUAL_VALUE,)] if settings.has_velocity else []
    received = settings.listens_to if settings.listens_to is not None else rpdo_identifier(node_id, axis)
    of_each = zip(mapped, (received, *tpdo_identifiers(node_id, axis)), pdo_places(axis), strict=False)
    rpdo, *tpdos = (_pdo_map(settings, od, *each) for each in of_each)
    return DrivePdos(rpdo, tuple(tpdos))


def _pdo_map(
    settings: DriveSettings, od: ObjectDictionary, indices: tuple[int, ...], cob_id: int, places: tuple[int, int]
) -> PdoMap:
    """Map of objects of the axis, as the first of the PDOs at `places` that the EDS has."""
    own = [settings.object(index) for index in indices]
    received, sent = (received_by, "received", 1), (sent_by, "sent", settings.tpdo_type or 1)
    allows, done, kind = received if objects.CONTROLWORD in indices else sent
    communication = next((index for index in places if eds.known(od, index, 1)), places[0])
    try:
        pdo = PdoMap.from_names(od, cob_id, kind, own, communication)
    except KeyError:
        missing = next(index for index in own if index not in od)
        raise UnusableInputError(
            settings.name, f"the EDS lacks {missing:04X}h, expected it: it is mapped into a PDO"
        ) from None
    except ValueError as error:
        raise UnusableInputError(settings.name, str(error)) from error
    for variable in pdo.variables:
        if not allows(variable):
            raise UnusableInputError(
                settings.name,
                f"{variable.index:04X}h ('{variable.name}') is {variable.access_type} by its EDS, expected an access "
                f"by which it can be {done} in a PDO",
            )
    return pdo


def configure(master: Master, settings: DriveSettings, od: ObjectDictionary, pdos: DrivePdos) -> None:
    """Configure a drive in PRE-OPERATIONAL for its role; blocks.

    Raises BenchFaultError when the device is another one or does not take a value, UnusableInputError when the
    configuration asks for what its EDS does not have.
    """
    node_id = settings.node_id
    check_identity(master, settings, od)
    for (index, sub), value in settings.parameters.items():
        _write(master, settings, od, index, sub, value)
    set_mode(master, settings, od)
    _set_interpolation_period(master, settings, od)
    if eds.known(od, PRODUCER_HEARTBEAT, 0):  # without it the drive is watched by its TPDOs alone
        _write(master, settings, od, PRODUCER_HEARTBEAT, 0, settings.heartbeat_ms)
    if settings.master_heartbeat is not None:
        master_id, time_out_ms = settings.master_heartbeat
        _write(master, settings, od, CONSUMER_HEARTBEAT, 1, master_id << 16 | time_out_ms)
    unused = {*chain(*pdo_places(settings.axis))} - {pdo.communication for pdo in pdos.all}
    for communication in sorted(unused):  # by default they may have the identifiers that the others get
        if eds.known(od, communication, 1):
            master.disable_pdo(node_id, communication)
    for communication in _of_no_axis(od):
        master.disable_pdo(node_id, communication)
    for pdo in pdos.all:
        master.write_pdo(node_id, pdo)


def _of_no_axis(od: ObjectDictionary) -> list[int]:
    """PDOs that none of the node's axes takes, and its EDS has valid: they would send what nobody reads, under COB-IDs
    that may be another node's. Communication parameters."""
    declared = default_reader(od)
    taken = {index for axis in axes(od.__contains__) for both in pdo_places(axis) for index in both}
    free = (index for index in (*RPDO_INDICES, *TPDO_INDICES) if index not in taken)
    return [index for index in free if not int(declared(index, 1) or INVALID) & INVALID]


def check_identity(master: Master, settings: DriveSettings, od: ObjectDictionary) -> None:
    """Raise BenchFaultError unless vendor-ID and product code (1018h) are those of the settings or the EDS.

    An EDS that leaves one of them open (0) allows any.
    """
    declared = default_reader(od)
    expected = settings.identity or (declared(IDENTITY, 1), declared(IDENTITY, 2))
    for sub, name, value in zip((1, 2), ("vendor-ID", "product code"), expected, strict=True):
        if value:
            found = int(master.sdo_read(settings.node_id, IDENTITY, sub))
            if found != value:
                raise _fault(settings, f"{name} (1018h:{sub}) is {found:08X}h, expected {int(value):08X}h")


def set_mode(master: Master, settings: DriveSettings, od: ObjectDictionary) -> None:
    """Write 6060h and see it in 6061h. Raises BenchFaultError when 6502h does not offer it or it is not taken."""
    node_id, mode = settings.node_id, settings.mode
    request, display, modes = map(
        settings.object,
        (objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY, objects.SUPPORTED_DRIVE_MODES),
    )
    if modes in od:
        supported = int(master.sdo_read(node_id, modes))
        if not supported & mode.supported_bit:
            raise _fault(
                settings, f"supported drive modes ({modes:X}h) are {supported:08X}h, expected mode {int(mode)} in it"
            )
    master.sdo_write(node_id, request, int(mode))
    for _ in range(_MODE_READS):
        shown = master.sdo_read(node_id, display)
        if shown == mode:
            return
    raise _fault(
        settings,
        f"mode of operation display ({display:X}h) is {shown!r}, expected {int(mode)} as written to {request:X}h",
    )


def read_units(
    master: Master, node_id: int, od: ObjectDictionary, overrides: Mapping[str, float], place: str, axis: int = 1
) -> DriveUnits:
    """Units of an axis as its objects give them now, and `overrides` where they don't (see `DriveUnits`).

    Raises UnusableInputError, at `place`, for a factor that is not given.
    """

    def read(index: int, sub: int) -> int | float | None:
        index = object_of(axis, index)
        value = master.sdo_read(node_id, index, sub) if eds.known(od, index, sub) else None
        return value if isinstance(value, int | float) else None

    return DriveUnits.from_objects(read, overrides, place)


def default_reader(
    od: ObjectDictionary, written: Mapping[tuple[int, int], int | float] | None = None, axis: int = 1
) -> ObjectReader:
    """Read the default values of an EDS for an axis, and what will have been `written` by (index, sub)."""
    known = written or {}

    def read(index: int, sub: int) -> int | float | None:
        index = object_of(axis, index)
        if (index, sub) in known and eds.known(od, index, sub):
            return known[(index, sub)]
        default = getattr(eds.known(od, index, sub), "default", None)
        return default if isinstance(default, int | float) else None

    return read


def lacking(settings: DriveSettings, od: ObjectDictionary) -> list[str]:
    """Objects that `configure` will need and the EDS lacks, one line each; empty for a drive that can be used."""
    written: dict[tuple[int, int], tuple[int | float, str]] = {
        (settings.object(objects.MODES_OF_OPERATION), 0): (int(settings.mode), "the mode is written to it"),
    }
    if eds.known(od, PRODUCER_HEARTBEAT, 0):
        written[PRODUCER_HEARTBEAT, 0] = settings.heartbeat_ms, "the drive's heartbeat is set by it"
    if settings.master_heartbeat is not None:
        master_id, time_out_ms = settings.master_heartbeat
        why = "the drive watches the bench by it (master: heartbeat_ms: 0 does without)"
        written[CONSUMER_HEARTBEAT, 1] = master_id << 16 | time_out_ms, why
    for key, value in settings.parameters.items():
        written[key] = value, "the config or the bench writes it"
    display = settings.object(objects.MODES_OF_OPERATION_DISPLAY)
    needed = {(display, 0): "it shows the mode"}
    if settings.identity is not None:
        needed[IDENTITY, 1] = "it tells the device"
    read, found = default_reader(od, axis=settings.axis), list[str]()
    for pdo in drive_pdos(settings, od).all:
        communication = pdo.communication
        needed[communication, 1] = "a PDO is set up by it"
        found += _other_cob_id(od, communication, pdo.cob_id)
        written[communication, 2] = pdo.transmission_type, "a PDO is set up by it"
        for sub, value in enumerate((len(pdo.mapping), *pdo.mapping)):
            written[communication + MAPPING, sub] = value, "a PDO is mapped by it"
    needed |= {key: why for key, (_, why) in written.items()}
    found += [
        f"{index:04X}h:{sub} ({why})" for (index, sub), why in needed.items() if eds.known(od, index, sub) is None
    ]
    for (index, sub), (value, why) in written.items():
        variable = eds.known(od, index, sub)
        if variable is not None and not _takes(variable, value, read(index, sub)):
            shown = f"{value:08X}h" if index in _MAPPINGS and sub else str(value)
            found.append(f"{index:04X}h:{sub} that takes {shown} ({why}), which {_range_text(variable)}")
    supported = read(objects.SUPPORTED_DRIVE_MODES, 0)
    if supported and not int(supported) & settings.mode.supported_bit:
        modes = settings.object(objects.SUPPORTED_DRIVE_MODES)
        found.append(f"mode {int(settings.mode)} in {modes:X}h ({int(supported):08X}h)")
    if interpolation_period(settings, od, read) is None:
        period = settings.object(objects.INTERPOLATION_TIME_PERIOD)
        variables = (eds.variable(od, period, sub) for sub in (1, 2))
        ranges = (f"{period:X}h:{each.subindex} {_range_text(each)}" for each in variables)
        found.append(f"{period:X}h that takes a cycle of {settings.cycle_s * 1e3:g} ms: {', '.join(ranges)}")
    return found


def _other_cob_id(od: ObjectDictionary, communication: int, cob_id: int) -> list[str]:
    """The COB-ID of a PDO that is read-only and another one than the bench gives it."""
    variable, has = eds.known(od, communication, 1), default_reader(od)(communication, 1)
    if variable is None or variable.writable or has is None or int(has) & (INVALID | COB_ID) == cob_id:
        return []
    return [f"{communication:04X}h:1 that takes {cob_id:X}h (a PDO is set up by it), which {_range_text(variable)}"]


def _takes(variable: ODVariable | None, value: int | float, now: int | float | None) -> bool:
    """True if a variable can be written with a value, or has it for good; `now`: its value, None: unknown."""
    if variable is None or not variable.writable:
        return now in (None, value)
    return (variable.min is None or value >= variable.min) and (variable.max is None or value <= variable.max)


def _range_text(variable: ODVariable) -> str:
    if not variable.writable:
        return f"is read-only and has {variable.default}"
    limits = ((word, limit) for word, limit in (("from", variable.min), ("to", variable.max)) if limit is not None)
    return " ".join(("goes", *(f"{word} {limit}" for word, limit in limits)))


def interpolation_period(settings: DriveSettings, od: ObjectDictionary, read: ObjectReader) -> dict[int, int] | None:
    """60C2h:1 and :2 for the cycle, of what the drive lets be written or has (`read`); empty without that object, None
    where it can't express the cycle."""
    variables = [eds.known(od, settings.object(objects.INTERPOLATION_TIME_PERIOD), sub) for sub in (1, 2)]
    if variables[1] is None:
        return {}
    has = [
        None if variable is None or variable.writable else read(objects.INTERPOLATION_TIME_PERIOD, sub)
        for sub, variable in enumerate(variables, 1)
    ]
    for exponent in (-3, -4, -5, -6):
        value = settings.cycle_s / 10.0**exponent
        wanted = (round(value), exponent)
        fits = abs(value - round(value)) < 1e-6 and 0 < round(value) < 256
        if fits and all(map(_takes, variables, wanted, has)):
            return dict(enumerate(wanted, 1))
    return None


def _set_interpolation_period(master: Master, settings: DriveSettings, od: ObjectDictionary) -> None:
    """60C2h: the cycle, in a unit in which it fits UNSIGNED8 without loss; what is read-only is compared."""

    def read(index: int, sub: int) -> int:
        return int(master.sdo_read(settings.node_id, settings.object(index), sub))

    wanted, period = interpolation_period(settings, od, read), settings.object(objects.INTERPOLATION_TIME_PERIOD)
    if wanted is None:
        has = " and ".join(str(read(period, sub)) for sub in (1, 2))
        raise _fault(settings, f"{period:X}h has {has}, expected what says a cycle of {settings.cycle_s:g} s")
    for sub, number in wanted.items():
        if eds.variable(od, period, sub).writable:
            master.sdo_write(settings.node_id, period, number, sub)


def _write(
    master: Master, settings: DriveSettings, od: ObjectDictionary, index: int, sub: int, value: int | float
) -> None:
    variable = eds.known(od, index, sub)
    if variable is None:
        raise UnusableInputError(
            settings.name, f"the EDS lacks {index:04X}h:{sub}, expected it: it is to be set to {value}"
        )
    if variable.writable:
        master.configure(settings.node_id, {(index, sub): value})
    elif (found := master.sdo_read(settings.node_id, index, sub)) != value:
        raise _fault(settings, f"{index:04X}h:{sub} is read-only by its EDS and has {found!r}, expected {value!r}")


def _fault(settings: DriveSettings, problem: str) -> BenchFaultError:
    return BenchFaultError(f"{settings.name} ({settings.place}): {problem}")
