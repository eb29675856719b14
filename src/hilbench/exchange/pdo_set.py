"""The PDO set of a bench as a DBC file: every PDO once, with names and SI units."""

from __future__ import annotations

from collections.abc import Mapping

from hilbench.canopen.dbc import DbcMessage, dbc_text
from hilbench.canopen.identifiers import RPDO_INDICES
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.object_units import si_unit
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.addressing import declared_units
from hilbench.exchange.nodes import Nodes
from hilbench.machine_kinds import machine_part
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role
from hilbench.topology.signal_kinds import Signal

_MASTER = "bench"


def pdo_set_dbc(config: BenchConfig) -> str:
    """The file's text. Raises UnusableInputError for an EDS file that cannot be used."""
    nodes = Nodes(config)
    messages: dict[int, DbcMessage] = {}
    for part in config.parts:
        units, signals = None, {}
        if part.role is Role.VIRTUAL_IO:
            signals = _process_data(config)
        else:
            units = declared_units(part)
        for pdo in nodes.pdo_maps(part.name):
            # A virtual axis listens to the RPDO of its real axis: one frame, two receivers.
            messages.setdefault(pdo.cob_id, _message(part.name, pdo, units, signals))
    return dbc_text(messages.values(), f"PDO set of the bench {config.name}; SI units, drives at the motor shaft")


def _process_data(config: BenchConfig) -> dict[tuple[int, int], Signal]:
    """Signals of the virtual I/O's objects on a machine of this kind, by index and sub-index."""
    known = {signal.name: signal for signal in config.signals}
    data = machine_part(config.machine.kind, "topology").process_data(config.shape)
    return {
        (each.index, each.sub): known[each.name]
        for each in (*data.published, *data.boundary_inputs)
        if each.name in known
    }


def _message(part: str, pdo: PdoMap, units: DriveUnits | None, signals: Mapping[tuple[int, int], Signal]) -> DbcMessage:
    """`signals`: by index and sub-index."""
    sender = _MASTER if pdo.communication in RPDO_INDICES else part
    names, in_units = [], []
    for variable in pdo.variables:
        signal = signals.get((variable.index, variable.subindex))
        names.append(variable.name if signal is None else signal.name)
        in_units.append(si_unit(variable.index, units) if signal is None else (1.0, signal.unit))
    return DbcMessage(f"{part}_{pdo.name}", sender, pdo, tuple(in_units), tuple(names))
