"""The PDO set of a bench as a DBC file: every PDO once, with names and SI units."""

from __future__ import annotations

from collections.abc import Mapping

from hilbench.canopen.dbc import DbcMessage, dbc_text
from hilbench.canopen.identifiers import FUNCTION_CODE, RPDOS, TPDOS
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
_NAMES = {code: f"{kind}{k}" for kind, codes in (("TPDO", TPDOS), ("RPDO", RPDOS)) for k, code in enumerate(codes, 1)}


def pdo_set_dbc(config: BenchConfig) -> str:
    """The file's text. Raises UnusableInputError for an EDS file that cannot be used."""
    nodes = Nodes(config)
    messages: dict[int, DbcMessage] = {}
    for part in config.parts:
        units, signals = None, {}
        # A second axis, and the virtual I/O of a long line, have PDOs whose identifiers are those of other numbers.
        names = _NAMES | nodes.pdo_names(part.name)
        if part.role is Role.VIRTUAL_IO:
            signals = _process_data(config)
        else:
            units = declared_units(part, nodes.dictionary(part.name))
        for pdo in nodes.pdo_maps(part.name):
            # A virtual axis listens to the RPDO of its real axis: one frame, two receivers.
            messages.setdefault(pdo.cob_id, _message(part.name, pdo, units, signals, names))
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


def _message(
    part: str,
    pdo: PdoMap,
    units: DriveUnits | None,
    signals: Mapping[tuple[int, int], Signal],
    names_of_pdos: Mapping[int, str],
) -> DbcMessage:
    """`signals`: by index and sub-index; `names_of_pdos`: by COB-ID, else by function code."""
    function = pdo.cob_id & FUNCTION_CODE
    number = names_of_pdos.get(pdo.cob_id) or names_of_pdos.get(function, f"PDO_{pdo.cob_id:X}")
    sender = _MASTER if function in RPDOS else part
    names, in_units = [], []
    for variable in pdo.variables:
        signal = signals.get((variable.index, variable.subindex))
        names.append(variable.name if signal is None else signal.name)
        in_units.append(si_unit(variable.index, units) if signal is None else (1.0, signal.unit))
    return DbcMessage(f"{part}_{number}", sender, pdo, tuple(in_units), tuple(names))
