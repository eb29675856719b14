"""The PDO set of a bench as a DBC file: every PDO once, with names and SI units."""

from __future__ import annotations

from hilbench.canopen.dbc import DbcMessage, dbc_text
from hilbench.canopen.identifiers import FUNCTION_CODE, RPDOS, TPDOS
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.object_units import si_unit
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.nodes import Nodes, declared_units
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role

_MASTER = "bench"
_NAMES = {code: f"{kind}{k}" for kind, codes in (("TPDO", TPDOS), ("RPDO", RPDOS)) for k, code in enumerate(codes, 1)}


def pdo_set_dbc(config: BenchConfig) -> str:
    """The file's text. Raises UnusableInputError for an EDS file that cannot be used."""
    nodes = Nodes(config)
    messages: dict[int, DbcMessage] = {}
    for part in config.parts:
        units = None
        if part.role is not Role.VIRTUAL_IO:
            units = declared_units(part, nodes.dictionary(part.name))
        for pdo in nodes.pdo_maps(part.name):
            # A virtual axis listens to the RPDO of its real axis: one frame, two receivers.
            messages.setdefault(pdo.cob_id, _message(part.name, pdo, units))
    return dbc_text(messages.values(), f"PDO set of the bench {config.name}; SI units, drives at the motor shaft")


def _message(part: str, pdo: PdoMap, units: DriveUnits | None) -> DbcMessage:
    function = pdo.cob_id & FUNCTION_CODE
    number = _NAMES.get(function, f"PDO_{pdo.cob_id:X}")
    sender = _MASTER if function in RPDOS else part
    return DbcMessage(f"{part}_{number}", sender, pdo, tuple(si_unit(v.index, units) for v in pdo.variables))
