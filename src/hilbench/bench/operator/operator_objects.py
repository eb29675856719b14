"""Settable quantities while the bench runs: objects of the bench's own node, written by SDO.

2200h of node `master: node_id` holds the present values as REAL32, SI, each quantity at the sub-index that
`hilbench.bench.machines.ranges` gives it: of a web line sub 1 the line speed (m/s), sub 2 the tension set-point (N),
sub 3 Young's modulus of the emulated web (Pa); by 1018h the node is known as a bench. A write is a request: what is in
range is applied between two cycles and answered with the next one, so that it is in the trace, in lockstep too. A
refusal is an abort code of CiA 301.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from canopen.objectdictionary import ODRecord, ODVariable

import canopen
from hilbench.bench.machines.ranges import OPERATOR_OBJECTS, operator_ranges
from hilbench.canopen.data_types import DataType
from hilbench.canopen.object_store import INVALID_VALUE, PRESENT_STATE, Cell, ObjectStore, SdoAbort
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import permitted

INDEX: Final = 0x2200
PRODUCT_CODE: Final = 0x0302
_IDENTITY: Final = (
    ("Highest sub-index supported", 4),
    ("Vendor-ID", 0),
    ("Product code", PRODUCT_CODE),
    ("Revision number", 0x0001_0000),
    ("Serial number", 0),
)


class OperatorObjects:
    """The objects of the bench's node. `get`: present value of a path; `may_change`: whether it may be changed now."""

    def __init__(self, config: BenchConfig, get: Callable[[str], float], may_change: Callable[[str], bool]) -> None:
        self.asked: list[tuple[str, float]] = []  #: accepted and not applied yet, in their order
        ranges = operator_ranges(config)
        self.store = ObjectStore(dictionary(ranges))
        for path, (least, largest) in ranges.items():
            cell = self.store.cell(INDEX, OPERATOR_OBJECTS[path][0])
            cell.variable.min, cell.variable.max = least, largest  # type: ignore[assignment]
            self._serve(cell, path, get, may_change)

    def changes(self) -> list[tuple[str, float]]:
        """Take the requests since the last call."""
        asked, self.asked = self.asked, []
        return asked

    def _serve(self, cell: Cell, path: str, get: Callable[[str], float], may_change: Callable[[str], bool]) -> None:
        def write(value: float) -> None:
            if not permitted(path).holds(value):
                raise SdoAbort(INVALID_VALUE)
            if not may_change(path):
                raise SdoAbort(PRESENT_STATE)
            self.asked.append((path, value))

        cell.on_write = write
        cell.on_read = lambda: get(path)


def dictionary(paths: Iterable[str] = OPERATOR_OBJECTS) -> canopen.ObjectDictionary:
    """Object dictionary of the bench's own node (``eds/hilbench_bench.eds``); `paths`: the machine's quantities."""
    od = canopen.ObjectDictionary()
    od.add_object(_variable("Device type", 0x1000, 0, DataType.UNSIGNED32, "const", 0))
    od.add_object(_variable("Error register", 0x1001, 0, DataType.UNSIGNED8, "ro", 0))
    identity = ODRecord("Identity object", 0x1018)
    for sub, (name, value) in enumerate(_IDENTITY):
        identity.add_member(
            _variable(name, 0x1018, sub, DataType.UNSIGNED32 if sub else DataType.UNSIGNED8, "const", value)
        )
    od.add_object(identity)
    entries = [OPERATOR_OBJECTS[path] for path in paths]
    record = ODRecord("Operator", INDEX)
    record.add_member(_variable("Highest sub-index supported", INDEX, 0, DataType.UNSIGNED8, "const", max(entries)[0]))
    for sub, name in entries:
        record.add_member(_variable(name, INDEX, sub, DataType.REAL32, "rw"))
    od.add_object(record)
    return od


def _variable(
    name: str, index: int, sub: int, data_type: int, access_type: str, default: int | None = None
) -> ODVariable:
    variable = ODVariable(name, index, sub)
    variable.data_type, variable.access_type, variable.default = data_type, access_type, default
    return variable
