"""Write the EDS files of the simulated devices (CiA 306) from the tables below: ``python tools/make_eds.py``.

The tables are the one description of the devices' objects. A REAL32 has default 0 or none: CiA 306 wants the
hexadecimal digits of the IEEE 754 representation, as Lely's tools read it, and many others read a decimal number; 0 is
the same to all of them. A device has other values of its own in such objects from the start.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from canopen.objectdictionary import ODRecord, ODVariable

from hilbench.bench.operator import operator_objects
from hilbench.machine_kinds import machine_part
from hilbench.plant.effect import Effect, EffectPlace, MachineKind
from hilbench.plant.effects import effects_of
from hilbench.topology.process_data.table import STATUS_TPDO
from hilbench.topology.signals import Shape, smallest_shapes

EDS_FOLDER = Path(__file__).resolve().parent.parent / "eds"

#: Data types of CiA 301 by their short names.
TYPES = {
    "I8": 0x02, "I16": 0x03, "I32": 0x04, "U8": 0x05, "U16": 0x06, "U32": 0x07, "REAL32": 0x08, "STRING": 0x09,
}  # fmt: skip
VAR, ARRAY, RECORD = 7, 8, 9
FIRST_DEVICE_OBJECT = 0x2000  #: below it stands the communication profile

Default = int | float | str | None


@dataclass(frozen=True)
class Entry:
    """One value: a whole object, or a sub-index of one."""

    name: str
    type: str
    access: str
    default: Default = None
    mappable: bool = False
    low: int | None = None
    high: int | None = None


@dataclass(frozen=True)
class Object:
    """One object: a variable (one entry, no sub-indices) or an array or record (entries by sub-index)."""

    index: int
    name: str
    kind: int
    entries: dict[int, Entry]


@dataclass(frozen=True)
class DeviceDescription:
    """All that one EDS file says."""

    file_name: str
    description: str
    product_name: str
    product_number: int
    device_type: int
    rpdos: int
    tpdos: int
    objects: tuple[Object, ...]


# --- building blocks -------------------------------------------------------------------------------------------------


def var(
    index: int, name: str, type_: str, access: str, default: Default = None, flags: str = "", **limits: int
) -> Object:
    """A simple variable; `flags` "map" makes it mappable into PDOs."""
    entry = Entry(name, type_, access, default, flags == "map", **limits)
    return Object(index, name, VAR, {0: entry})


def compound(index: int, name: str, kind: int, entries: dict[int, Entry], count_access: str = "const") -> Object:
    """An array or record: sub-index 0 holds the highest sub-index."""
    count = Entry("Highest sub-index supported", "U8", count_access, max(entries))
    return Object(index, name, kind, {0: count, **entries})


def pair(index: int, name: str, first: tuple[str, int], second: tuple[str, int]) -> Object:
    """A ratio of two UNSIGNED32."""
    entries = {sub: Entry(text, "U32", "rw", value) for sub, (text, value) in enumerate((first, second), 1)}
    return compound(index, name, ARRAY, entries)


@dataclass(frozen=True)
class Pdo:
    """Defaults of one PDO: valid or not, transmission type, mapped (index, sub, bits)."""

    valid: bool = False
    transmission_type: int = 1
    mapping: tuple[tuple[int, int, int], ...] = ()


NO_REMOTE_REQUEST = 0x4000_0000
INVALID = 0x8000_0000


def of_second_axis(item: Object) -> Object:
    """The same object of the second axis of a node: 800h further on, one's own objects as well."""
    return replace(item, index=item.index + 0x800, name=f"{item.name}, axis 2")


def pdo_objects(number: int, pdo: Pdo, transmit: bool) -> list[Object]:
    """Communication and mapping parameter of PDO `number`, the first four with their COB-IDs of the predefined
    connection set, further ones with none."""
    cob_id = (0x180 if transmit else 0x200) + 0x100 * (number - 1) if number <= 4 else 0
    cob_id |= (0 if pdo.valid else INVALID) | (NO_REMOTE_REQUEST if transmit else 0)
    communication = {
        1: Entry("COB-ID", "U32", "rw", f"$NODEID+0x{cob_id:X}" if number <= 4 else cob_id),
        2: Entry("Transmission type", "U8", "rw", pdo.transmission_type),
        3: Entry("Inhibit time", "U16", "rw", 0),
        5: Entry("Event timer", "U16", "rw", 0),
    }
    if transmit:
        communication[6] = Entry("SYNC start value", "U8", "rw", 0, high=240)
    mapped = [index << 16 | sub << 8 | bits for index, sub, bits in pdo.mapping] + [0] * (8 - len(pdo.mapping))
    mapping = {sub: Entry(f"Mapped object {sub}", "U32", "rw", value) for sub, value in enumerate(mapped, 1)}
    base, word = (0x1800, "TPDO") if transmit else (0x1400, "RPDO")
    count = Entry("Number of mapped objects", "U8", "rw", len(pdo.mapping))
    return [
        compound(base + number - 1, f"{word}{number} communication parameter", RECORD, communication),
        Object(base + 0x200 + number - 1, f"{word}{number} mapping parameter", RECORD, {0: count, **mapping}),
    ]


def communication_objects(
    device_type: int, product_number: int, product_name: str, rpdos: Sequence[Pdo], tpdos: Sequence[Pdo]
) -> list[Object]:
    """The communication profile area (CiA 301) of all devices."""
    objects = [
        var(0x1000, "Device type", "U32", "const", device_type),
        var(0x1001, "Error register", "U8", "ro", 0, "map"),
        Object(
            0x1003,
            "Pre-defined error field",
            ARRAY,
            {
                0: Entry("Number of errors", "U8", "rw", 0),
                **{n: Entry(f"Standard error field {n}", "U32", "ro", 0) for n in range(1, 9)},
            },
        ),
        var(0x1005, "COB-ID SYNC message", "U32", "rw", 0x80),
        var(0x1006, "Communication cycle period", "U32", "rw", 0),
        var(0x1007, "Synchronous window length", "U32", "rw", 0),
        var(0x1008, "Manufacturer device name", "STRING", "const", product_name),
        var(0x1009, "Manufacturer hardware version", "STRING", "const", "simulated"),
        var(0x100A, "Manufacturer software version", "STRING", "const", "1.0"),
        _by_group(0x1010, "Store parameters", "Save"),
        _by_group(0x1011, "Restore default parameters", "Restore"),
        var(0x1014, "COB-ID EMCY", "U32", "rw", "$NODEID+0x80"),
        var(0x1015, "Inhibit time EMCY", "U16", "rw", 0),
        compound(
            0x1016,
            "Consumer heartbeat time",
            ARRAY,
            {n: Entry(f"Consumer heartbeat time {n}", "U32", "rw", 0) for n in range(1, 5)},
        ),
        var(0x1017, "Producer heartbeat time", "U16", "rw", 0),
        compound(
            0x1018,
            "Identity object",
            RECORD,
            {
                1: Entry("Vendor-ID", "U32", "const", 0),
                2: Entry("Product code", "U32", "const", product_number),
                3: Entry("Revision number", "U32", "const", 0x0001_0000),
                4: Entry("Serial number", "U32", "ro", 0),
            },
        ),
        var(0x1019, "Synchronous counter overflow value", "U8", "rw", 0, high=240),
        compound(0x1029, "Error behaviour", ARRAY, {1: Entry("Communication error", "U8", "rw", 0, high=2)}),
        compound(
            0x1200,
            "SDO server parameter",
            RECORD,
            {
                1: Entry("COB-ID client to server", "U32", "ro", "$NODEID+0x600"),
                2: Entry("COB-ID server to client", "U32", "ro", "$NODEID+0x580"),
            },
        ),
    ]
    return objects + all_pdo_objects(rpdos, tpdos)


def all_pdo_objects(rpdos: Sequence[Pdo], tpdos: Sequence[Pdo], first: int = 1) -> list[Object]:
    """Those of PDOs that are numbered from `first` on."""
    of_both = ((False, rpdos), (True, tpdos))
    return [each for way, pdos in of_both for k, pdo in enumerate(pdos) for each in pdo_objects(first + k, pdo, way)]


def _by_group(index: int, name: str, verb: str) -> Object:
    groups = ("all parameters", "communication parameters", "application parameters")
    return compound(
        index, name, ARRAY, {sub: Entry(f"{verb} {group}", "U32", "rw", 1) for sub, group in enumerate(groups, 1)}
    )


# --- effects of the simulated hardware -------------------------------------------------------------------------------


def effect_objects(place: EffectPlace) -> list[Object]:
    """One record per effect that enters there, of every kind of machine; sub-indices: its parameters, REAL32."""
    effects: dict[int, Effect] = {}
    for kind in MachineKind:
        effects |= {effect.object_index: effect for effect in effects_of(kind) if effect.enters(place)}
    return [
        compound(
            index,
            effect.id if effect in effects_of(MachineKind.WEB_LINE) else f"{effect.id} (rotary)",
            RECORD,
            {
                sub: Entry(
                    f"{parameter.name} [{_ascii(parameter.unit)}]",
                    "REAL32",
                    "rw",
                    0.0 if parameter.neutral == 0.0 else None,
                )
                for sub, parameter in enumerate(effect.parameters, 1)
            },
        )
        for index, effect in sorted(effects.items())
    ]


def _ascii(unit: str) -> str:
    return (unit or "1").replace("·", " ").replace("²", "2").replace("³", "3")


# --- the devices -----------------------------------------------------------------------------------------------------

RPM = 10_000  #: one rpm in velocity units (0.0001 rpm)

DRIVE_OBJECTS = (
    var(0x2001, "Simulated fault: error code to fail with", "U16", "rw", 0),
    var(0x6007, "Abort connection option code", "I16", "rw", 1, low=0, high=3),
    var(0x603F, "Error code", "U16", "ro", 0, "map"),
    var(0x6040, "Controlword", "U16", "rww", 0, "map"),
    var(0x6041, "Statusword", "U16", "ro", 0, "map"),
    var(0x605A, "Quick stop option code", "I16", "rw", 2, low=0, high=8),
    var(0x605B, "Shutdown option code", "I16", "rw", 0, low=0, high=1),
    var(0x605C, "Disable operation option code", "I16", "rw", 1, low=0, high=1),
    var(0x605D, "Halt option code", "I16", "rw", 1, low=1, high=4),
    var(0x605E, "Fault reaction option code", "I16", "rw", 2, low=0, high=4),
    var(0x6060, "Modes of operation", "I8", "rww", 0, "map"),
    var(0x6061, "Modes of operation display", "I8", "ro", 0, "map"),
    var(0x6062, "Position demand value", "I32", "ro", 0, "map"),
    var(0x6064, "Position actual value", "I32", "ro", 0, "map"),
    var(0x6065, "Following error window", "U32", "rw", 1 << 20),
    var(0x6066, "Following error time out", "U16", "rw", 10),
    var(0x606B, "Velocity demand value", "I32", "ro", 0, "map"),
    var(0x606C, "Velocity actual value", "I32", "ro", 0, "map"),
    var(0x606D, "Velocity window", "U16", "rw", 1 * RPM),
    var(0x606E, "Velocity window time", "U16", "rw", 10),
    var(0x606F, "Velocity threshold", "U16", "rw", 5 * RPM),
    var(0x6070, "Velocity threshold time", "U16", "rw", 10),
    var(0x6071, "Target torque", "I16", "rww", 0, "map"),
    var(0x6072, "Max torque", "U16", "rww", 3000, "map"),
    var(0x6074, "Torque demand", "I16", "ro", 0, "map"),
    var(0x6075, "Motor rated current", "U32", "rw", 4000),
    var(0x6076, "Motor rated torque", "U32", "rw", 5000, low=1),
    var(0x6077, "Torque actual value", "I16", "ro", 0, "map"),
    var(0x6079, "DC link circuit voltage", "U32", "ro", 320_000, "map"),
    var(0x607A, "Target position", "I32", "rww", 0, "map"),
    var(0x607C, "Home offset", "I32", "rw", 0),
    var(0x607F, "Max profile velocity", "U32", "rww", 3000 * RPM, "map"),
    var(0x6080, "Max motor speed", "U32", "rww", 3000, "map"),
    var(0x6083, "Profile acceleration", "U32", "rww", 1000 * RPM, "map", low=1),
    var(0x6084, "Profile deceleration", "U32", "rww", 1000 * RPM, "map", low=1),
    var(0x6085, "Quick stop deceleration", "U32", "rww", 3000 * RPM, "map", low=1),
    var(0x6087, "Torque slope", "U32", "rww", 10_000, "map", low=1),
    pair(0x608F, "Position encoder resolution", ("Encoder increments", 1 << 20), ("Motor revolutions", 1)),
    pair(0x6091, "Gear ratio", ("Motor revolutions", 1), ("Shaft revolutions", 1)),
    var(0x6098, "Homing method", "I8", "rw", 37),
    var(0x60A8, "SI unit position", "U32", "const", 0x00B5_0000),  # increments
    var(0x60A9, "SI unit velocity", "U32", "const", 0xFCB4_4700),  # 0.0001 rpm
    var(0x60B1, "Velocity offset", "I32", "rww", 0, "map"),
    var(0x60B2, "Torque offset", "I16", "rww", 0, "map"),
    compound(
        0x60C2,
        "Interpolation time period",
        RECORD,
        {
            1: Entry("Interpolation time period value", "U8", "rw", 2),
            2: Entry("Interpolation time index", "I8", "rw", -3, low=-6, high=0),
        },
    ),
    var(0x60F4, "Following error actual value", "I32", "ro", 0, "map"),
    var(0x60FD, "Digital inputs", "U32", "ro", 0, "map"),
    var(0x60FF, "Target velocity", "I32", "rww", 0, "map"),
    # Profile velocity, torque, homing, cyclic synchronous position, velocity, torque.
    var(0x6502, "Supported drive modes", "U32", "const", 1 << 2 | 1 << 3 | 1 << 5 | 1 << 7 | 1 << 8 | 1 << 9),
    var(0x67FF, "Single device type", "U32", "const", 0x0002_0192),
)

#: Spans of the longest line whose twin the virtual I/O has objects for.
MOST_SPANS = 16
#: Of the longest one with an estimate at each span, for a file of its own: every other bench would read it in vain.
MOST_SPANS_OF_LONG = 23
#: Dancers, accumulators and reels, each with a sensor, carriages each with a force that is fed forward.
MOST_STATIONS = 6


SERVO_RPDOS = (Pdo(True, 1, ((0x6040, 0, 16), (0x60FF, 0, 32))), Pdo(), Pdo(), Pdo())
SERVO_TPDOS = (
    Pdo(True, 1, ((0x6041, 0, 16), (0x6077, 0, 16), (0x6064, 0, 32))),
    Pdo(True, 1, ((0x606C, 0, 32),)),
    Pdo(),
    Pdo(),
)


def servo() -> DeviceDescription:
    """The CiA-402 servo drive: axes, load motor and virtual axes."""
    name, product, device_type = "hilbench servo", 0x0402, 0x0002_0192
    return DeviceDescription(
        "hilbench_servo.eds",
        "Simulated CiA-402 servo drive: axis, load motor, virtual axis",
        name,
        product,
        device_type,
        len(SERVO_RPDOS),
        len(SERVO_TPDOS),
        (
            *communication_objects(device_type, product, name, SERVO_RPDOS, SERVO_TPDOS),
            *effect_objects(EffectPlace.HARDWARE),
            *DRIVE_OBJECTS,
        ),
    )


def dual_servo() -> DeviceDescription:
    """Two of the servo drive's axes on one node: the second has its objects 800h and its PDOs 64 further on."""
    name, product, device_type = "hilbench dual servo", 0x0403, 0xFFFF_0192
    received, sent = (
        [Pdo(mapping=tuple((index + 0x800, sub, bits) for index, sub, bits in pdo.mapping)) for pdo in pdos]
        for pdos in (SERVO_RPDOS, SERVO_TPDOS)
    )
    axis = [*effect_objects(EffectPlace.HARDWARE), *DRIVE_OBJECTS]
    return DeviceDescription(
        "hilbench_servo_dual.eds",
        "Simulated CiA-402 servo drive with two axes on one node",
        name,
        product,
        device_type,
        2 * len(SERVO_RPDOS),
        2 * len(SERVO_TPDOS),
        (
            *communication_objects(device_type, product, name, SERVO_RPDOS, SERVO_TPDOS),
            *all_pdo_objects(received, sent, first=65),
            *axis,
            *map(of_second_axis, axis),
        ),
    )


def virtual_io(kind: MachineKind, *, is_long: bool = False) -> DeviceDescription:
    """The CiA-401-like device with the twin's answers as analogue inputs and the machine's boundary as outputs; its
    PDOs are at first those of the smallest machine of its kind."""
    name, product, device_type = "hilbench virtual I/O", 0x0401, 0x000C_0191
    smallest = machine_part(kind, "topology").process_data(smallest_shapes()[kind])
    signals = {signal.sub: signal for signal in smallest.published}
    sensors = {signal.sub: signal for signal in smallest.boundary_inputs}
    tpdos = {number: Pdo() for number in range(1, 5)}
    if kind is MachineKind.WEB_LINE:
        most = MOST_SPANS_OF_LONG if is_long else MOST_SPANS
        spans = tuple(range(1, most + 1))
        for signal in machine_part(kind, "topology").process_data(Shape(most + 1, (), most, spans, spans)).published:
            signals.setdefault(signal.sub, signal)
        names = tuple(f"{number}" for number in range(1, MOST_STATIONS + 1))
        with_stations = machine_part(kind, "topology").process_data(
            Shape(2, (), 1, (), (), carriages=names, measured=names, pushed=names)
        )
        signals |= {
            signal.sub: replace(signal, text=signal.text.replace("position", "position or radius"))
            for signal in with_stations.published
            if signal.sub not in signals
        }
        sensors = {signal.sub: signal for signal in with_stations.boundary_inputs}
        longest = machine_part(kind, "topology").process_data(
            Shape(most + 1, (), most, spans if is_long else (1,), spans)
        )
        tpdos |= {pdo.number: Pdo() for pdo in longest.sent}
    tpdos |= {
        pdo.number: Pdo(True, pdo.every, tuple((signal.index, signal.sub, 32) for signal in pdo.signals))
        for pdo in smallest.sent
    }
    tpdos[STATUS_TPDO] = Pdo(True, 1, ((0x2100, 1, 16), (0x2100, 2, 8), (0x2100, 3, 8)))
    boundary = tuple((signal.index, signal.sub, 32) for signal in smallest.boundary_inputs)
    rpdos = [Pdo(True, 1, boundary) if boundary else Pdo(), Pdo(), Pdo(), Pdo()]
    inputs = {sub: Entry(signal.text, "REAL32", "ro", 0.0, True) for sub, signal in sorted(signals.items())}
    status = {
        1: Entry("SYNC simulated for, counted from NMT start", "U16", "ro", 0, True),
        2: Entry("Age in cycles", "U8", "ro", 0, True),
        3: Entry("Status bits", "U8", "ro", 0, True),
    }
    synchronizer = {1: Entry("Method, 0 as configured", "U8", "rw", 0, False)}
    model = {
        1: Entry("Effects as JSON, empty as configured", "STRING", "rw"),
        2: Entry("Largest step of a tension in the last change [N]", "REAL32", "ro", 0.0),
    }
    found = {1: Entry("Errors of the model that were found, as JSON", "STRING", "ro")}
    outputs = {signal.sub: Entry(signal.text, "REAL32", "rww", 0.0, True) for signal in sensors.values()}
    file_name, description = LONG_VIRTUAL_IO_FILE if is_long else VIRTUAL_IO_FILES[kind]
    return DeviceDescription(
        file_name,
        description,
        name,
        product,
        device_type,
        len(rpdos),
        len(tpdos),
        (
            *communication_objects(
                device_type, product, name, rpdos, [tpdos[number] for number in range(1, len(tpdos) + 1)]
            ),
            compound(0x2100, "Twin status", RECORD, status),
            compound(0x2101, "Synchronizer", RECORD, synchronizer),
            compound(0x2102, "Model", RECORD, model),
            compound(0x2103, "Found", RECORD, found),
            compound(0x6403, "Read analogue input floating point", ARRAY, inputs),
            *([compound(0x6413, "Write analogue output floating point", ARRAY, outputs)] if outputs else []),
        ),
    )


VIRTUAL_IO_FILES = {
    MachineKind.WEB_LINE: (
        "hilbench_virtual_io.eds",
        "Virtual I/O of the twin: simulated tension, estimated modulus, boundary of the web",
    ),
    MachineKind.SERVO_AXIS: (
        "hilbench_virtual_io_servo_axis.eds",
        "Virtual I/O of the twin of a servo axis: estimated inertia and friction",
    ),
}
LONG_VIRTUAL_IO_FILE = (
    "hilbench_virtual_io_long.eds",
    "Virtual I/O of the twin of a web line of up to 24 driven rollers, with an estimate at each span",
)


def bench() -> DeviceDescription:
    """The bench's own node, as it serves it."""
    return DeviceDescription(
        "hilbench_bench.eds",
        "The bench: what an operator may change while it runs",
        "hilbench bench",
        operator_objects.PRODUCT_CODE,
        0,
        0,
        0,
        tuple(map(_described, operator_objects.dictionary().values())),
    )


def _described(item: ODVariable | ODRecord) -> Object:
    names = {code: name for name, code in TYPES.items()}
    entries = {0: item} if isinstance(item, ODVariable) else item.subindices
    return Object(
        item.index,
        item.name,
        VAR if isinstance(item, ODVariable) else RECORD,
        {
            sub: Entry(each.name, names[each.data_type or 0], each.access_type, each.default)
            for sub, each in entries.items()
        },
    )


# --- rendering -------------------------------------------------------------------------------------------------------


def render(device: DeviceDescription) -> str:
    """The text of the EDS file."""
    sections = [_file_info(device), _device_info(device), _dummy_usage(), _section("Comments", [("Lines", "0")])]
    objects = sorted(device.objects, key=lambda item: item.index)
    mandatory = [item for item in objects if item.index in (0x1000, 0x1001, 0x1018)]
    manufacturer = [item for item in objects if 0x2000 <= item.index < 0x6000]
    optional = [item for item in objects if item not in mandatory and item not in manufacturer]
    for title, group in (
        ("MandatoryObjects", mandatory),
        ("OptionalObjects", optional),
        ("ManufacturerObjects", manufacturer),
    ):
        listing = [(str(number), f"0x{item.index:04X}") for number, item in enumerate(group, 1)]
        sections.append(_section(title, [("SupportedObjects", str(len(group))), *listing]))
        sections += [text for item in group for text in _object_sections(item)]
    return "\n".join(sections)


def _section(title: str, lines: Iterable[tuple[str, str]]) -> str:
    return f"[{title}]\n" + "".join(f"{key}={value}\n" for key, value in lines)


def _file_info(device: DeviceDescription) -> str:
    made = [("Time", "10:00AM"), ("Date", "11-20-2026")]
    lines = [
        ("FileName", device.file_name),
        ("FileVersion", "1"),
        ("FileRevision", "0"),
        ("EDSVersion", "4.0"),
        ("Description", device.description),
        *((f"Creation{key}", value) for key, value in made),
        ("CreatedBy", "tools/make_eds.py"),
        *((f"Modification{key}", value) for key, value in made),
        ("ModifiedBy", "tools/make_eds.py"),
    ]
    return _section("FileInfo", lines)


def _device_info(device: DeviceDescription) -> str:
    lines = [
        ("VendorName", "hilbench"),
        ("VendorNumber", "0x00000000"),
        ("ProductName", device.product_name),
        ("ProductNumber", f"0x{device.product_number:08X}"),
        ("RevisionNumber", "0x00010000"),
        ("OrderCode", ""),
        *((f"BaudRate_{rate}", "1") for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
        ("SimpleBootUpMaster", "0"),
        ("SimpleBootUpSlave", "1"),
        ("Granularity", "8"),
        ("DynamicChannelsSupported", "0"),
        ("GroupMessaging", "0"),
        ("NrOfRXPDO", str(device.rpdos)),
        ("NrOfTXPDO", str(device.tpdos)),
        ("LSS_Supported", "0"),
    ]
    return _section("DeviceInfo", lines)


def _dummy_usage() -> str:
    return _section("DummyUsage", [(f"Dummy{number:04d}", str(int(number > 1))) for number in range(1, 8)])


def _object_sections(item: Object) -> list[str]:
    if item.kind == VAR:
        return [_section(f"{item.index:04X}", _entry_lines(replace(item.entries[0], name=item.name), item.index))]
    head = [
        ("ParameterName", item.name),
        ("ObjectType", f"0x{item.kind:X}"),
        ("SubNumber", str(len(item.entries))),
    ]
    sections = [_section(f"{item.index:04X}", head)]
    for sub, entry in sorted(item.entries.items()):
        sections.append(_section(f"{item.index:04X}sub{sub:X}", _entry_lines(entry, item.index)))
    return sections


def _entry_lines(entry: Entry, index: int) -> list[tuple[str, str]]:
    default = [] if entry.default is None else [("DefaultValue", _default_text(entry))]
    lines = [
        ("ParameterName", entry.name),
        ("ObjectType", f"0x{VAR:X}"),
        ("DataType", f"0x{TYPES[entry.type]:04X}"),
        ("AccessType", entry.access),
        *default,
        ("PDOMapping", str(int(entry.mappable))),
    ]
    if entry.low is not None:
        lines.append(("LowLimit", str(entry.low)))
    if entry.high is not None:
        lines.append(("HighLimit", str(entry.high)))
    if index >= FIRST_DEVICE_OBJECT and entry.access == "ro" and entry.mappable:
        lines.append(("ObjFlags", "0x2"))  # a process input: its value is its own, not the default
    return lines


def _default_text(entry: Entry) -> str:
    """Raises ValueError for a REAL32 that is not read the same by everybody."""
    if entry.type == "REAL32":
        if entry.default != 0.0:
            raise ValueError(f"default {entry.default} of '{entry.name}', expected 0 or none for a REAL32")
        return "0"
    if entry.type == "U32" and isinstance(entry.default, int):
        return f"0x{entry.default:08X}"
    return str(entry.default)


def eds_files() -> dict[str, str]:
    """Text of every EDS file by its name."""
    io = (*map(virtual_io, MachineKind), virtual_io(MachineKind.WEB_LINE, is_long=True))
    return {device.file_name: render(device) for device in (servo(), dual_servo(), *io, bench())}


def main() -> None:
    """Write the files into ``eds/``."""
    for name, text in eds_files().items():
        (EDS_FOLDER / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
