"""Bus and node of a command that attaches to what runs already, and whether it may write there."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hilbench.apps.canopen_tools.eds_match import find_eds
from hilbench.apps.cli.config_file import load_config
from hilbench.apps.cli.options import SDO_TIMEOUT_S
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.canopen.eds import load_eds
from hilbench.canopen.master import Master
from hilbench.canopen.master_guard import mastery
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import BenchFaultError, UnusableInputError

if TYPE_CHECKING:  # the models take their time to import; a command without a config does not need them
    from canopen import ObjectDictionary
    from hilbench.runs.config import ExperimentConfig

#: Node id of a bench of which there is no config.
MASTER_ID = 127


class BusSession(ExitStack):
    """A command on a bus as it runs: what is opened through it is closed when it is left. `bench`: None without a
    config. Raises UnusableInputError."""

    def __init__(self, config: Path | None, bus: str | None) -> None:
        super().__init__()
        self.bench = None if config is None else load_config(config, bus=bus).config
        address = BusAddress.parse(bus or "embedded") if self.bench is None else self.bench.bus_address
        self.bus = address.as_it_runs()

    def be_only_master(self, what: str, *, force: bool) -> None:
        """Enter `only_master`."""
        self.enter_context(only_master(self.bus, self.bench, what, force=force))

    def link(self) -> Link:
        """Open a link of its own."""
        link = open_link(self.bus)
        self.callback(link.close)
        return link

    def reader(self, timeout_s: float) -> SdoClient:
        """Open what reads objects of any node, by raw bytes."""
        return self.enter_context(SdoClient(open_python_can(self.bus), timeout_s))

    def device(
        self, node: str, eds: Path, timeout_s: float = SDO_TIMEOUT_S, dcf: Path | None = None
    ) -> tuple[Master, int, str, ObjectDictionary]:
        """A master that knows a node, with id, name and object dictionary of it; raises as `node_on_bus`."""
        return self.known(*node_on_bus(node, self.bench, self.bus, eds, dcf), timeout_s)

    def known(
        self, node_id: int, name: str, od: ObjectDictionary, timeout_s: float = SDO_TIMEOUT_S
    ) -> tuple[Master, int, str, ObjectDictionary]:
        """Master of a node whose object dictionary is known."""
        master = Master(open_python_can(self.bus), timeout_s)
        self.callback(master.close)
        master.add(node_id, od, name)
        return master, node_id, name, od


def only_master(
    bus: BusAddress, config: ExperimentConfig | None, what: str, *, force: bool
) -> AbstractContextManager[None]:
    """Guard of writes onto a bus: as its only master, or beside another because a person insists.

    Entering raises UnusableInputError, which says who is there.
    """
    if force:
        return nullcontext()
    return mastery(bus, MASTER_ID if config is None else config.master.node_id, what)


def node_on_bus(
    node: str, config: ExperimentConfig | None, bus: BusAddress, eds: Path, dcf: Path | None = None
) -> tuple[int, str, ObjectDictionary]:
    """Node id, name for messages and object dictionary; a config names its nodes and their EDS files.

    `dcf` describes the device where there is no EDS file of it.

    Raises UnusableInputError for a node or a file that is none, BenchFaultError when the node does not answer.
    """
    node_id, name, od = node_and_eds(node, config, bus, eds)
    if od is None and dcf is not None:
        od = load_eds(dcf, node_id)
    if od is None:
        raise UnusableInputError(
            eds, f"no EDS file with the identity of node {node_id}, expected one; or give --eds FILE"
        )
    return node_id, name, od


def node_and_eds(
    node: str, config: ExperimentConfig | None, bus: BusAddress, eds: Path
) -> tuple[int, str, ObjectDictionary | None]:
    """Node with its EDS file; no object dictionary where none is known for the device."""
    parts = () if config is None else config.parts
    for part in parts:
        if node in (part.name, str(part.node.node_id)):
            return part.node.node_id, part.name, load_eds(part.node.eds, part.node.node_id)
    if config is not None and is_the_bench(node, config):
        from hilbench.bench.operator.operator_objects import dictionary

        return config.master.node_id, "bench", dictionary()
    if not node.isdecimal() or not 1 <= int(node) <= 127:
        names = "" if config is None else f", or one of {', '.join(part.name for part in parts)}, bench"
        raise UnusableInputError("NODE", f"'{node}', expected a node id from 1 to 127{names}")
    node_id = int(node)
    if eds.is_file():
        return node_id, "node", load_eds(eds, node_id)
    with SdoClient(open_python_can(bus), SDO_TIMEOUT_S) as reader:
        if reader.read(node_id, 0x1000) is None:
            raise BenchFaultError(f"no answer from node {node_id} on {bus} to an SDO read of 1000h")
        found = find_eds(reader, node_id, eds, left_out)
    return node_id, "node", None if found is None else load_eds(found, node_id)


def drive_on_node(node: str, config: ExperimentConfig | None, axis: int | None) -> tuple[str, int]:
    """A drive as `node_on_bus` takes it, by its name where a config has one, and which axis of its node it is."""
    for part in () if config is None else config.parts:
        if node == part.name and axis not in (None, part.node_axis):
            raise UnusableInputError("--axis", f"{axis}, expected none with {node}, which is axis {part.node_axis}")
        if node == part.name or (node, axis or 1) == (str(part.node.node_id), part.node_axis):
            return part.name, part.node_axis
    return node, axis or 1


def left_out(error: UnusableInputError) -> None:
    """Say that a file of a folder cannot be used."""
    print(f"hilbench: left out: {error}", file=sys.stderr)


def is_the_bench(node: str, config: ExperimentConfig | None) -> bool:
    """True if NODE is the bench itself, whose objects are there for an operator to write."""
    return config is not None and node in ("bench", str(config.master.node_id))
