"""Bus and node of a command that attaches to what runs already, and whether it may write there."""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from hilbench.apps.canopen_tools.eds_match import eds_files, fitting, read_identity
from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import SDO_TIMEOUT_S
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.canopen.eds import load_eds
from hilbench.canopen.master import Master
from hilbench.canopen.master_guard import mastery
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import BenchFaultError, UnusableInputError

if TYPE_CHECKING:
    from canopen import ObjectDictionary

#: Node id of a bench of which there is no config.
MASTER_ID = 127


class BusSession(ExitStack):
    """A command on a bus as it runs: what is opened through it is closed when it is left. `bench`: None without a
    config, `parts`: those that it names, `master_id`: of the bench. Raises UnusableInputError."""

    def __init__(self, config: Path | None, bus: str | None) -> None:
        super().__init__()
        self.bench = None if config is None else load_config(config, bus=bus).config
        address = BusAddress.parse(bus or "embedded") if self.bench is None else self.bench.bus_address
        self.bus = address.as_it_runs()
        self.parts = () if self.bench is None else self.bench.parts
        self.master_id = MASTER_ID if self.bench is None else self.bench.master.node_id

    def be_only_master(self, what: str, *, force: bool) -> None:
        """Guard writes onto the bus: as its only master, or beside another because a person insists.

        Raises UnusableInputError, which says who is there.
        """
        if not force:
            self.enter_context(mastery(self.bus, self.master_id, what))

    def link(self) -> Link:
        """Open a link of its own."""
        return self.enter_context(closing(open_link(self.bus)))

    def master(self, timeout_s: float) -> Master:
        """Open what reads and writes objects: of any node by raw bytes, of known ones by their object dictionary."""
        return self.enter_context(Master(open_python_can(self.bus), timeout_s))

    def device(
        self,
        node: str,
        eds: Path,
        timeout_s: float = SDO_TIMEOUT_S,
        dcf: Path | None = None,
        *,
        may_be_unknown: bool = False,
    ) -> tuple[Master, int, str, ObjectDictionary]:
        """A master that knows a node, with id, name for messages and object dictionary of it.

        `dcf` describes the device where there is no EDS file of it; one that `may_be_unknown` has no objects then.
        Raises UnusableInputError for a node or a file that is none, BenchFaultError when the node does not answer.
        """
        node_id, name, od = self._node(node, eds)
        if od is None and dcf is not None:
            od = load_eds(dcf, node_id)
        if od is None and may_be_unknown:
            from canopen import ObjectDictionary

            od = ObjectDictionary()
        if od is None:
            raise UnusableInputError(
                eds, f"no EDS file with the identity of node {node_id}, expected one; or give --eds FILE"
            )
        master = self.master(timeout_s)
        master.add(node_id, od, name)
        return master, node_id, name, od

    def _node(self, node: str, eds: Path) -> tuple[int, str, ObjectDictionary | None]:
        """Id, name for messages and object dictionary of a node, None where no EDS file of the device is known; a
        config names its nodes and their EDS files. Raises as `device`."""
        for part in self.parts:
            if node in (part.name, str(part.node.node_id)):
                return part.node.node_id, part.name, load_eds(part.node.eds, part.node.node_id)
        if self.is_the_bench(node):
            from hilbench.bench.operator.operator_objects import dictionary

            return self.master_id, "bench", dictionary()
        if not node.isdecimal() or not 1 <= int(node) <= 127:
            names = f", or one of {', '.join(part.name for part in self.parts)}, bench" if self.bench else ""
            raise UnusableInputError("NODE", f"'{node}', expected a node id from 1 to 127{names}")
        node_id = int(node)
        if eds.is_file():
            return node_id, "node", load_eds(eds, node_id)
        with SdoClient(open_python_can(self.bus), SDO_TIMEOUT_S) as reader:
            if reader.read(node_id, 0x1000) is None:
                raise BenchFaultError(f"no answer from node {node_id} on {self.bus} to an SDO read of 1000h")
            found = fitting(eds_files(eds, left_out), read_identity(reader, node_id))
        return node_id, "node", load_eds(found[0].path, node_id) if found else None

    def drive(self, node: str, axis: int | None) -> tuple[str, int]:
        """A drive as `device` takes it, by its name where a config has one, and which axis of its node it is."""
        for part in self.parts:
            if node == part.name and axis not in (None, part.node_axis):
                raise UnusableInputError("--axis", f"{axis}, expected none with {node}, which is axis {part.node_axis}")
            if node == part.name or (node, axis or 1) == (str(part.node.node_id), part.node_axis):
                return part.name, part.node_axis
        return node, axis or 1

    def is_the_bench(self, node: str) -> bool:
        """True if NODE is the bench itself, whose objects are there for an operator to write."""
        return self.bench is not None and node in ("bench", str(self.master_id))


def left_out(error: UnusableInputError) -> None:
    """Say that a file of a folder cannot be used."""
    print(f"hilbench: left out: {error}", file=sys.stderr)
