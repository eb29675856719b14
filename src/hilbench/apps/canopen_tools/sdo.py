"""`hilbench sdo`: one object of one node, by index or name, with its unit; a whole configuration as a file."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer import Argument, Option

from hilbench.apps.cli.options import (
    SDO_TIMEOUT_S,
    BusOption,
    ConfigOption,
    EdsOption,
    ForceOption,
    JsonOption,
    NodeArgument,
    TimeoutOption,
    print_json,
)
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_CRITERION_FAILED, BenchFaultError, UnusableInputError

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

    from canopen import ObjectDictionary
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import Configuration, Difference, Key
    from hilbench.canopen.master import Master

ObjectArgument = Annotated[
    str, Argument(metavar="OBJECT", help="6041, 6041h, 0x1018sub1, 1018:1, or a name: target_velocity")
]

app = typer.Typer(help="Read or write objects of a node by SDO, one or all of them.", no_args_is_help=True)

_SAVE = int.from_bytes(b"save", "little")
_FILES = (".dcf", ".eds", ".bin", ".cdcf")
_HEX_INDEX = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})h?(?:(?:sub|:)([0-9A-Fa-f]{1,2}))?$")
_LONGEST_INTEGER = 8  # bytes
_REAL32 = struct.Struct("<f")
_LEAST_REAL, _LARGEST_REAL = 1e-6, 1e12
_WITH_UNIT = re.compile(r"^\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([^\s0-9].*)$")


@app.command()
def dump(
    node: NodeArgument,
    file: Annotated[Path, Argument(metavar="FILE", help="DCF to write (.dcf), or concise DCF (.bin, .cdcf)")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    timeout: TimeoutOption = SDO_TIMEOUT_S,
) -> None:
    """Read all objects of a node and keep them as a DCF: its EDS file with the values (ParameterValue, CiA 306).

    A concise DCF (CiA 302-3) has the settings alone, in the order in which a device accepts them. Objects that could
    not be read are named with the reason; --timeout gives slow ones more time.

    Example: hilbench sdo dump 1 axis1.dcf --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import is_concise, write_concise, write_dcf

    with BusSession(config, bus) as on:
        master, node_id, _, od = on.device(node, eds, timeout)
        found = _configuration(master, node_id, od)
    (write_concise if is_concise(file) else write_dcf)(found, file)
    print(f"{file}: {len(found.values)} objects of node {node_id}")
    for key, why in found.refused.items():
        print(f"not read: {found.name(key)}: {why}")


@app.command()
def load(
    node: NodeArgument,
    file: Annotated[Path, Argument(metavar="FILE", help="DCF (.dcf) or concise DCF (.bin, .cdcf)")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    store: Annotated[bool, Option("--store", help="let the device keep it over a loss of power (1010h sub 1)")] = False,
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    force: ForceOption = False,
) -> None:
    """Write a configuration to a node, and read back what it has then; commands and set points are left out.

    Of a DCF that was made for another node id, the COB-IDs that carry it get this node's.

    Exit code: 0 all of it is there, 1 some objects were refused, kept another value or were not answered, or it could
    not be stored, 3 the node does not answer.

    Example: hilbench sdo load 1 axis1.dcf --bus socketcan:can0 --store
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import Configuration, moved, node_of_file, write_device, writes_of_file

    with BusSession(config, bus) as on:
        on.be_only_master(f"sdo load to node {node}", force=force)
        master, node_id, _, od = on.device(node, eds, timeout, _description(file))
        made_for = node_of_file(file)
        writes, renamed = moved(writes_of_file(file, od), made_for or node_id, node_id)
        with _progress(f"node {node_id}") as progress:
            failed = write_device(master, node_id, writes, progress)
        not_stored = _store(master, node_id, failed) if store else None
    objects = len({write.key for write in writes})
    print(f"node {node_id}: {objects - len(failed)} of {objects} objects as in {file}")
    if renamed:
        print(f"{len(renamed)} COB-IDs of node {made_for} became those of node {node_id}")
    for key, why in failed.items():
        print(f"{Configuration(od).name(key)}: {why}")
    if not_stored is not None:
        print(f"not stored: {not_stored}")
    if failed or not_stored is not None:
        raise typer.Exit(EXIT_CRITERION_FAILED)


def _store(master: Master, node_id: int, failed: Mapping[Key, str]) -> str | None:
    """Why the device does not keep it; None: it does."""
    if failed:
        return "the device is not as the file has it"
    if not master.has(node_id, 0x1010, 1):
        return "its EDS file has no object 1010h sub 1, by which a device stores its parameters"
    try:
        master.sdo_write(node_id, 0x1010, _SAVE, 1)
    except BenchFaultError as error:
        return str(error)
    return None


@app.command()
def diff(
    first: Annotated[str, Argument(metavar="FIRST", help="node (id, or name with --config) or file")],
    second: Annotated[str, Argument(metavar="SECOND", help="node or file")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    everything: Annotated[
        bool, Option("--all", help="also objects that are no settings, and those that one side lacks")
    ] = False,
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    json: JsonOption = False,
) -> None:
    """Compare the settings of two devices, a device with a file, or two files.

    Exit code: 0 no difference, 1 differences.

    Example: hilbench sdo diff 1 axis1.dcf --bus socketcan:can0

    Example: hilbench sdo diff axis1.dcf axis2.dcf
    """
    from hilbench.canopen.device_configuration import differences

    both = _both(first, second, config, bus, eds, timeout)
    found = differences(*both, all_objects=everything)
    if json:
        rows = [{**asdict(row), "key": f"{row.key[0]:04X}h:{row.key[1]}"} for row in found]
        print_json(rows, ensure_ascii=False)
    else:
        _show_differences(found, first, second)
    raise typer.Exit(EXIT_CRITERION_FAILED if found else 0)


def _both(
    first: str, second: str, config: Path | None, bus: str | None, eds: Path, timeout_s: float
) -> tuple[Configuration, Configuration]:
    """The two sides; a concise DCF is read with the objects of the other side."""
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import is_concise, read_file
    from hilbench.canopen.eds import load_eds

    sides: dict[str, Configuration] = {}
    files = [name for name in (first, second) if Path(name).suffix.lower() in _FILES]
    dcf = next((found for name in files if (found := _description(Path(name)))), None)
    for name in (first, second):
        if name in files:
            continue
        with BusSession(config, bus) as on:
            master, node_id, _, od = on.device(name, eds, timeout_s, dcf)
            sides[name] = _configuration(master, node_id, od)
    for name in sorted(files, key=lambda name: is_concise(Path(name))):
        if sides:
            od = next(iter(sides.values())).od
        elif is_concise(Path(name)):
            raise UnusableInputError(name, "a concise DCF names no objects, expected a DCF or a node beside it")
        else:
            od = load_eds(Path(name), 0)
        sides[name] = read_file(Path(name), od)
    return sides[first], sides[second]


def _description(file: Path) -> Path | None:
    """The file, if it says what objects there are; a concise DCF has values alone."""
    from hilbench.canopen.device_configuration import is_concise

    return None if is_concise(file) or not file.is_file() else file


def _configuration(master: Master, node_id: int, od: ObjectDictionary) -> Configuration:
    from hilbench.canopen.device_configuration import read_device

    with _progress(f"node {node_id}") as progress:
        found = read_device(master, node_id, od, progress)
    if not found.values:
        raise BenchFaultError(f"node {node_id}: none of its {len(found.refused)} objects could be read")
    return found


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on the terminal, where there is one."""
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what)
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _show_differences(found: Sequence[Difference], first: str, second: str) -> None:
    console = Console(highlight=False)
    if not found:
        console.print(f"{first} and {second} have the same settings", markup=False)
        return
    title = "1 object differs" if len(found) == 1 else f"{len(found)} objects differ"
    rows = [(row.name, row.first or "-", row.second or "-") for row in found]
    console.print(table(("object", first, second), rows, title=title))


@app.command("read")
def read(
    node: NodeArgument,
    name: ObjectArgument,
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    json: JsonOption = False,
) -> None:
    """Read an object; numbers in device units and, where the standard or the drive tells its unit, in SI (motor side).

    By its index any object of any node can be read: one that no EDS file tells of is shown as bytes, and as the number
    (little-endian) or the text that these could be.

    Example: hilbench sdo read 1 velocity_actual_value --bus socketcan:can0

    Example: hilbench sdo read axis2 1018:1 --config bench_configs/web_section_step.yaml
    """
    from hilbench.apps.canopen_tools.attach import BusSession

    index = _index(name)
    with BusSession(config, bus) as on:
        device = on.device(node, eds, timeout, may_be_unknown=index is not None)
        master, node_id, _, od = device
        if index is not None and not master.has(node_id, *index):
            _print_bytes(node_id, index, _bytes_of(master, node_id, index), known=bool(od), as_json=json)
        else:
            found = _object(on, name, *device)
            _print(found, found.read(), as_json=json)


@app.command("write")
def write(
    node: NodeArgument,
    name: ObjectArgument,
    value: Annotated[str, Argument(metavar="VALUE", help="number (0x1F too), text, or a number with its SI unit")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Write an object and read it back; a value with a unit ("0.5 N·m", "10 rad/s") is converted to device units.

    A bus with a master (a running bench, or one received) is left alone; what a bench itself has for its operator,
    2200h of node "bench", can be written.

    Example: hilbench sdo write 1 quick_stop_deceleration "75 rad/s²" --bus socketcan:can0

    A negative value follows "--": hilbench sdo write 1 target_torque -- -20
    """
    from hilbench.apps.canopen_tools.attach import BusSession

    with BusSession(config, bus) as on:
        if not on.is_the_bench(node):
            on.be_only_master(f"sdo write to node {node}", force=force)
        found = _object(on, name, *on.device(node, eds, timeout))
        found.write(found.parse(value))
        _print(found, found.read() if "r" in found.variable.access_type else None, as_json=json)


@dataclass(frozen=True)
class _Object:
    """An object of a node on the bus."""

    master: Master
    node_id: int
    node_name: str
    variable: ODVariable
    unit: tuple[float, str] | None

    @property
    def key(self) -> str:
        return f"{self.variable.index:04X}h:{self.variable.subindex}"

    def read(self) -> Any:
        return self.master.sdo_read(self.node_id, self.variable.index, self.variable.subindex)

    def write(self, value: Any) -> None:
        self.master.sdo_write(self.node_id, self.variable.index, value, self.variable.subindex)

    def parse(self, text: str) -> Any:
        """A value as the object takes it. Raises UnusableInputError."""
        from hilbench.canopen.data_types import data_type

        kind = data_type(self.variable.data_type or 0)
        plain = not kind.is_number or text.lower().startswith("0x") or _is_number(text)
        given = None if plain else _WITH_UNIT.match(text)
        if given is not None:
            return self._from_si(float(given[1]), given[2].strip(), whole=kind.is_integer)
        try:
            return kind.parse(text, self.node_id)
        except ValueError as error:
            raise UnusableInputError(
                "VALUE", f"'{text}', expected a value of {self.key} '{self.variable.name}'"
            ) from error

    def _from_si(self, number: float, unit: str, *, whole: bool) -> int | float:
        plain = unit.replace("Nm", "N·m").replace("^2", "²").replace("s2", "s²")
        if self.unit is None or plain != self.unit[1]:
            expected = "none" if self.unit is None else self.unit[1]
            raise UnusableInputError(
                "VALUE", f"unit '{unit}' of {self.key} '{self.variable.name}', expected {expected}"
            )
        return round(number / self.unit[0]) if whole else number / self.unit[0]


def _bytes_of(master: Master, node_id: int, key: tuple[int, int]) -> bytes:
    """Content of an object that is in no EDS file. Raises BenchFaultError."""
    from hilbench.canopen.sdo_client import SdoAbortedError, SdoCommunicationError, reason_of

    try:
        return master.upload(node_id, *key)
    except (SdoAbortedError, SdoCommunicationError) as error:
        reason = reason_of(error, master.timeout_s)
        raise BenchFaultError(f"node {node_id}, {key[0]:04X}h:{key[1]}: reading it: {reason}") from error


def _object(on: BusSession, name: str, master: Master, node_id: int, node_name: str, od: ObjectDictionary) -> _Object:
    from hilbench.cia402.axis import axis_of
    from hilbench.cia402.configuration import read_units
    from hilbench.cia402.object_units import has_drive_unit, si_unit

    variable, units = _variable(od, name), None
    if has_drive_unit(variable.index):
        with suppress(UnusableInputError):  # the value is shown without a unit
            axis = axis_of(variable.index)
            given = {} if on.bench is None else on.bench.units_of(node_id, axis)
            units = read_units(master, node_id, od, given, node_name, axis)
    return _Object(master, node_id, node_name, variable, si_unit(variable.index, units))


def _index(name: str) -> tuple[int, int] | None:
    """Index and sub-index of an object that is named by them."""
    match = _HEX_INDEX.match(name.strip())
    return None if match is None else (int(match[1], 16), int(match[2] or "0", 16))


def _variable(od: ObjectDictionary, name: str) -> ODVariable:
    from hilbench.canopen import eds as eds_files

    index = _index(name)
    try:
        return eds_files.find(od, name) if index is None else eds_files.variable(od, *index)
    except KeyError as error:
        raise UnusableInputError(
            "OBJECT", f"'{name}': {error.args[0]} in the EDS, expected an index or a name"
        ) from None


def _is_number(text: str) -> bool:
    """True for a number, also with an exponent, which is no unit."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _looks_like(data: bytes) -> dict[str, int | float | str]:
    """Possible values of bytes of an unknown type: integers of their length, a floating-point number, text."""
    found: dict[str, int | float | str] = {}
    if 1 <= len(data) <= _LONGEST_INTEGER:
        found["unsigned"] = int.from_bytes(data, "little")
        if data[-1] & 0x80:
            found["signed"] = int.from_bytes(data, "little", signed=True)
    if len(data) == _REAL32.size:
        (number,) = _REAL32.unpack(data)
        if _LEAST_REAL <= abs(number) < _LARGEST_REAL:  # integers look like numbers far below
            found["REAL32"] = float(f"{number:.7g}")
    text = data.rstrip(b"\0").decode("latin-1")
    if text and text.isascii() and text.isprintable():
        found["text"] = text
    return found


def _print_bytes(node_id: int, at: tuple[int, int], data: bytes, *, known: bool, as_json: bool) -> None:
    """Print an object that no EDS file tells of; `known`: there is one of the device."""
    like, key, why = _looks_like(data), f"{at[0]:04X}h:{at[1]}", "not in its EDS" if known else "no EDS file"
    if as_json:
        nothing = {"name": None, "value": data.hex(), "si": None, "si_unit": None}
        print_json({"node": node_id, "object": key, **nothing, "looks_like": like}, ensure_ascii=False)
        return
    words = [
        f"{name} {value} ({value:X}h)" if name == "unsigned" else f"{name} {value}" for name, value in like.items()
    ]
    count = f"{len(data)} byte" if len(data) == 1 else f"{len(data)} bytes"
    shown = f"{data.hex(' ')} ({count}, {why})" if data else f"empty ({why})"
    print(f"node {node_id} {key}: " + "; as ".join([shown, *words]))


def _print(found: _Object, value: Any, *, as_json: bool) -> None:
    si = value * found.unit[0] if found.unit is not None and isinstance(value, int | float) else None
    if as_json:
        data = {
            "node": found.node_id,
            "object": found.key,
            "name": found.variable.name,
            "value": value.hex() if isinstance(value, bytes) else value,
            "si": si,
            "si_unit": None if found.unit is None else found.unit[1],
        }
        print_json(data, ensure_ascii=False)
        return
    shown = "written" if value is None else value.hex(" ") if isinstance(value, bytes) else str(value)
    shown += f" ({value:X}h)" if isinstance(value, int) and value >= 0 else ""
    unit = f" = {si:.6g} {found.unit[1]}" if si is not None and found.unit is not None else ""
    place = f"{found.node_name} (node {found.node_id})" if found.node_name != "node" else f"node {found.node_id}"
    print(f"{place} {found.key} {found.variable.name}: {shown}{unit}")
