"""The examination: reads, measures, listens and asks, and hands everything to the judges.

It writes nothing to any device and sends no NMT command, so that it can be run on a stand at any time. On a bus where
something is wrong already, or another master is at work, it sends nothing at all.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from hilbench.apps.canopen_tools.interface import read_interface
from hilbench.apps.doctor.check_interface import check_interface
from hilbench.apps.doctor.check_machine import Lateness, check_machine, measure_lateness, read_machine
from hilbench.apps.doctor.check_stations import ask, check_node, check_received
from hilbench.apps.doctor.findings import Check, Finding, Level, error, ok, warning
from hilbench.apps.doctor.subject import Start, Subject
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.canopen.listening import listen, present
from hilbench.canopen.master_guard import master_of
from hilbench.canopen.sdo_client import SDO_ANSWERS, SdoClient
from hilbench.errors import BenchFaultError

_LISTEN_S = 1.0
_MEASURE_S = 0.5
#: For nodes of simulated hardware and twin to answer, s.
PRESENT_S = 0.5


@dataclass(frozen=True)
class Examination:
    """Result of an examination."""

    findings: list[Finding]
    lateness: Lateness

    @property
    def nodes_asked(self) -> int:
        """Number of nodes that were read; without any, nothing is known of them."""
        return sum(finding.check is Check.NODE_ANSWERS for finding in self.findings)

    @property
    def passed(self) -> bool:
        """No error was found."""
        return not self.count(Level.ERROR)

    def count(self, level: str) -> int:
        """Number of findings of this level."""
        return sum(finding.level == level for finding in self.findings)


def examine(subject: Subject, announce: Callable[[str], None]) -> Examination:
    """Examine machine, interface and nodes."""
    announce("measure the timer")
    lateness = measure_lateness(subject.cycle_s, _MEASURE_S)
    findings = check_machine(read_machine(), lateness, subject)
    bus = subject.bus
    if bus is not None and not subject.on_socketcan:
        what = "embedded" if bus.interface == "embedded" else f"python-can's {bus.interface}"
        findings.append(ok(Check.INTERFACE, str(bus), f"{what}: nothing to check"))
        findings += _stations(subject, bus, announce)
    elif bus is not None:
        before = read_interface(bus.channel)
        interface = check_interface(before, before, subject)
        if any(finding.level is Level.ERROR for finding in interface):
            stations = [warning(Check.BUS, str(bus), "not used: its interface is not right", "bus_left_alone")]
        else:
            stations = _stations(subject, bus, announce)
            interface = check_interface(before, read_interface(bus.channel), subject)
        findings += interface + stations
    return Examination(findings, lateness)


def _stations(subject: Subject, bus: BusAddress, announce: Callable[[str], None]) -> list[Finding]:
    """Findings on the bus and those on it."""
    try:
        with ExitStack() as resources:
            return _on_bus(subject, bus, announce, resources)
    except BenchFaultError as fault:
        return [error(Check.BUS, str(bus), str(fault))]


def _on_bus(subject: Subject, bus: BusAddress, announce: Callable[[str], None], resources: ExitStack) -> list[Finding]:
    link = resources.enter_context(closing(open_link(bus)))
    announce(f"listen on {bus}")
    received = listen(link, _LISTEN_S)
    findings = [ok(Check.BUS, str(bus), "opens")]
    claimed_by = master_of(bus)
    findings += check_received(received, subject.nodes, subject.master_id, str(bus), claimed_by)
    if not subject.nodes or claimed_by or received.signs_of_master(subject.master_id):
        return findings
    ours = [node.node_id for node in subject.nodes if node.ours]
    if subject.start is not None and ours and not present(link, ours, PRESENT_S):
        announce("start simulated hardware and twin")
        # Those that are not there are named when asked.
        start_nodes(link, ours, subject.start, subject.boot_timeout_s, resources)
    announce("ask the nodes")
    with SdoClient(open_python_can(bus, SDO_ANSWERS), subject.sdo_timeout_s) as reader:
        for node in subject.nodes:
            findings += check_node(node, ask(reader, node))
    return findings


def start_nodes(link: Link, node_ids: Sequence[int], start: Start, timeout_s: float, resources: ExitStack) -> bool:
    """Start what a run starts, until `resources` are closed; True if all nodes answer in time."""
    children = start(Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="hilbench-"))))
    for child in children:
        resources.callback(child.end)
    deadline_s = time.monotonic() + timeout_s
    while len(present(link, node_ids, PRESENT_S)) < len(node_ids):
        for child in children:
            child.check()
        if time.monotonic() > deadline_s:
            return False
    return True
