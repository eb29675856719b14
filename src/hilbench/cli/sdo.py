"""`hilbench sdo read|write`: one object of one node, by index or name, with its unit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hilbench.cli.options import BusOption, ConfigOption, EdsOption, JsonOption, NodeArgument
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

    from hilbench.fieldbus.master import Master

ObjectArgument = Annotated[
    str, typer.Argument(metavar="OBJECT", help="6041, 6041h, 0x1018sub1, 1018:1, or a name: target_velocity")
]

app = typer.Typer(help="Read or write one object of a node by SDO.", no_args_is_help=True)

_HEX_INDEX = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})h?(?:(?:sub|:)([0-9A-Fa-f]{1,2}))?$")
_WITH_UNIT = re.compile(r"^\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([^\s0-9].*)$")


@app.command("read")
def read(
    node: NodeArgument,
    name: ObjectArgument,
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    json: JsonOption = False,
) -> None:
    """Read an object; numbers in device units and, where the standard or the drive tells its unit, in SI (motor side).

    Example: hilbench sdo read 1 velocity_actual_value --bus socketcan:can0

    Example: hilbench sdo read axis2 1018:1 --config bench_configs/web_section_step.yaml
    """
    with _object(node, name, config, bus, eds) as found:
        value = found.read()
        _print(found, value, as_json=json)


@app.command("write")
def write(
    node: NodeArgument,
    name: ObjectArgument,
    value: Annotated[
        str, typer.Argument(metavar="VALUE", help="number (0x1F too), text, or a number with its SI unit")
    ],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    json: JsonOption = False,
) -> None:
    """Write an object and read it back; a value with a unit ("0.5 N·m", "10 rad/s") is converted to device units.

    Example: hilbench sdo write 1 quick_stop_deceleration "75 rad/s²" --bus socketcan:can0

    A negative value follows "--": hilbench sdo write 1 target_torque -- -20
    """
    with _object(node, name, config, bus, eds) as found:
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
        from hilbench.fieldbus.data_types import data_type

        kind = data_type(self.variable.data_type or 0)
        given = _WITH_UNIT.match(text) if kind.is_number and not text.lower().startswith("0x") else None
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


@contextmanager
def _object(node: str, name: str, config: Path | None, bus: str | None, eds: Path) -> Iterator[_Object]:
    from hilbench.cli.attach import config_and_bus, master_of, node_on_bus
    from hilbench.drives.configuration import read_units
    from hilbench.drives.object_units import has_drive_unit, si_unit

    bench, address = config_and_bus(config, bus)
    node_id, node_name, od = node_on_bus(node, bench, address, eds)
    variable = _variable(od, name)
    master = master_of(address, node_id, od, node_name)
    try:
        units = None
        if has_drive_unit(variable.index):
            with suppress(UnusableInputError):  # the value is shown without a unit
                units = read_units(master, node_id, od, {} if bench is None else bench.units_of(node_id), node_name)
        yield _Object(master, node_id, node_name, variable, si_unit(variable.index, units))
    finally:
        master.close()


def _variable(od: Any, name: str) -> ODVariable:
    from hilbench.fieldbus import eds as eds_files

    match = _HEX_INDEX.match(name.strip())
    try:
        if match:
            return eds_files.variable(od, int(match[1], 16), int(match[2] or "0", 16))
        return eds_files.find(od, name)
    except KeyError as error:
        raise UnusableInputError(
            "OBJECT", f"'{name}': {error.args[0]} in the EDS, expected an index or a name"
        ) from None


def _print(found: _Object, value: Any, *, as_json: bool) -> None:
    from json import dumps

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
        print(dumps(data, indent=2, ensure_ascii=False))
        return
    shown = "written" if value is None else value.hex(" ") if isinstance(value, bytes) else str(value)
    shown += f" ({value:X}h)" if isinstance(value, int) and value >= 0 else ""
    unit = f" = {si:.6g} {found.unit[1]}" if si is not None and found.unit is not None else ""
    place = f"{found.node_name} (node {found.node_id})" if found.node_name != "node" else f"node {found.node_id}"
    print(f"{place} {found.key} {found.variable.name}: {shown}{unit}")
