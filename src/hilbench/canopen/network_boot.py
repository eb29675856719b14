"""Boot-up of a network by its NMT master (CiA 302-2): its slaves, the check of their identity, their
configuration (1F22h), and their start. All of it is in the master's DCF (1F80h ff.), as `dcfgen` writes it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import canopen
from hilbench.canopen import concise_dcf, eds
from hilbench.canopen.concise_dcf import Write
from hilbench.canopen.device_configuration import write_device
from hilbench.canopen.identifiers import LAST_NODE, NmtCommand
from hilbench.canopen.master import Master
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.files import content, usable

# Bits of 1F80h and of an entry of 1F81h.
_IS_MASTER, _START_ALL_AT_ONCE, _START_NO_NODE = 0x01, 0x02, 0x08
_IS_SLAVE, _BOOT, _MANDATORY, _NO_RESET = 0x01, 0x04, 0x08, 0x10

_NMT_STARTUP, _ASSIGNMENT, _CONCISE_DCF, _BOOT_TIME, _HEARTBEATS = 0x1F80, 0x1F81, 0x1F22, 0x1F89, 0x1016
#: What of a device is expected: where the master has it, where the device, the error status and its words.
_IDENTITY: Final = (
    (0x1F84, (0x1000, 0), "C", "device type"),
    (0x1F85, (0x1018, 1), "D", "vendor-ID"),
    (0x1F86, (0x1018, 2), "M", "product code"),
    (0x1F87, (0x1018, 3), "N", "revision number"),
    (0x1F88, (0x1018, 4), "O", "serial number"),
)
_ASK_S: Final = 0.05
_HEARTBEAT_S: Final = 1.0


class BootError(StrEnum):
    """Error status of a boot-up by its letter (CiA 302-2)."""

    NO_ANSWER = "B"
    DEVICE_TYPE = "C"
    VENDOR_ID = "D"
    CONFIGURATION = "J"
    NO_HEARTBEAT = "K"
    PRODUCT_CODE = "M"
    REVISION = "N"
    SERIAL_NUMBER = "O"


@dataclass(frozen=True)
class Slave:
    """A node that belongs to the network."""

    node_id: int
    assignment: int  #: 1F81h
    identity: dict[int, int]  #: what is expected, by index of the master's object; 0 or absent: anything
    configuration: list[Write]
    heartbeat_s: float  #: within which one is to be received; 0: none is expected

    @property
    def mandatory(self) -> bool:
        """True if nothing starts without it."""
        return bool(self.assignment & _MANDATORY)

    @property
    def boots(self) -> bool:
        """True if it is configured and started; otherwise it is only checked for presence."""
        return bool(self.assignment & _BOOT)

    @property
    def may_be_reset(self) -> bool:
        """True if its communication is reset even if it may be at work."""
        return not self.assignment & _NO_RESET


@dataclass(frozen=True)
class NetworkPlan:
    """Network of the master's DCF."""

    startup: int  #: 1F80h
    boot_time_s: float  #: longest boot time of a mandatory slave; 0: not given
    slaves: list[Slave]


@dataclass(frozen=True)
class Booted:
    """Result of a slave's boot; without an error it is there, and as it should be."""

    slave: Slave
    error: BootError | None = None
    reason: str = ""


class _FailedError(Exception):
    def __init__(self, error: BootError, reason: str) -> None:
        super().__init__(reason)
        self.error, self.reason = error, reason


def read_plan(path: Path) -> NetworkPlan:
    """Network of a master's DCF; concise DCFs are in its folder, named by UploadFile, or in it.

    Raises UnusableInputError for a file that is none of an NMT master, or one that names no slave.
    """
    od = eds.load_eds(path, 0)
    startup = _number(od, _NMT_STARTUP, 0)
    if not startup & _IS_MASTER:
        raise UnusableInputError(path, f"1F80h is {startup:X}h, expected that of an NMT master (bit 0)")
    files = _upload_files(path)
    heartbeats_s = dict(_heartbeats_s(od))
    slaves = [
        Slave(
            node_id,
            assignment,
            {index: _number(od, index, node_id) for index, *_ in _IDENTITY},
            _configuration(path, od, node_id, files),
            heartbeats_s.get(node_id, 0.0),
        )
        for node_id in range(1, LAST_NODE + 1)
        if (assignment := _number(od, _ASSIGNMENT, node_id)) & _IS_SLAVE
    ]
    if not slaves:
        raise UnusableInputError(path, "1F81h has no slave, expected a network (bit 0 of an entry)")
    return NetworkPlan(startup, _number(od, _BOOT_TIME, 0) / 1000.0, slaves)


def boot_network(
    master: Master, plan: NetworkPlan, timeout_s: float, report: Callable[[Booted], None] = lambda _: None
) -> list[Booted]:
    """Reset, check, configure and start the slaves; `report` is called for each. A mandatory slave with an error keeps
    all of them from being started, others only themselves.

    `timeout_s`: longest time for an answer where the plan gives none. Raises BusError when the bus is lost.
    """
    for slave in plan.slaves:
        master.add(slave.node_id, canopen.ObjectDictionary(), f"node {slave.node_id}")
    if all(slave.may_be_reset for slave in plan.slaves):
        master.nmt(NmtCommand.RESET_COMMUNICATION)
    else:
        for slave in plan.slaves:
            if slave.may_be_reset:
                master.nmt(NmtCommand.RESET_COMMUNICATION, slave.node_id)
    deadline_s = time.monotonic() + (plan.boot_time_s or timeout_s)
    found = []
    for slave in plan.slaves:
        booted = _boot(master, slave, deadline_s)
        report(booted)
        found.append(booted)
    if not any(booted.error and booted.slave.mandatory for booted in found):
        _start(master, plan, found)
    return found


def _start(master: Master, plan: NetworkPlan, found: list[Booted]) -> None:
    if plan.startup & _START_NO_NODE:
        return
    ready = [booted.slave.node_id for booted in found if booted.error is None and booted.slave.boots]
    if plan.startup & _START_ALL_AT_ONCE and len(ready) == len(found):
        master.nmt(NmtCommand.START)
    else:
        for node_id in ready:
            master.nmt(NmtCommand.START, node_id)


def _boot(master: Master, slave: Slave, deadline_s: float) -> Booted:
    try:
        _await_answer(master, slave, deadline_s)
        _check_identity(master, slave)
        if slave.boots:
            _configure(master, slave)
            _await_heartbeat(master, slave)
    except _FailedError as failed:
        return Booted(slave, failed.error, failed.reason)
    return Booted(slave)


def _await_answer(master: Master, slave: Slave, deadline_s: float) -> None:
    while not isinstance(master.read(slave.node_id, 0x1000), bytes):
        if time.monotonic() > deadline_s:
            raise _FailedError(BootError.NO_ANSWER, "no answer to an SDO read of 1000h")
        time.sleep(_ASK_S)


def _check_identity(master: Master, slave: Slave) -> None:
    for index, (at, sub), letter, words in _IDENTITY:
        expected = slave.identity.get(index, 0)
        if not expected:
            continue
        answer = master.read(slave.node_id, at, sub)
        found = int.from_bytes(answer, "little") if isinstance(answer, bytes) else None
        if found != expected:
            shown = "not told" if found is None else f"{found:X}h"
            raise _FailedError(BootError(letter), f"{words} is {shown}, expected {expected:X}h")


def _configure(master: Master, slave: Slave) -> None:
    try:
        failed = write_device(master, slave.node_id, slave.configuration)
    except BenchFaultError as error:
        raise _FailedError(BootError.CONFIGURATION, str(error)) from error
    for (index, sub), why in failed.items():
        raise _FailedError(BootError.CONFIGURATION, f"{index:04X}h sub {sub}: {why}")


def _await_heartbeat(master: Master, slave: Slave) -> None:
    if not slave.heartbeat_s:
        return
    if slave.node_id not in master.responding_within(max(slave.heartbeat_s, _HEARTBEAT_S)):
        raise _FailedError(BootError.NO_HEARTBEAT, f"no heartbeat within {max(slave.heartbeat_s, _HEARTBEAT_S):g} s")


# -- the master's DCF --------------------------------------------------------------------------------------------


def _number(od: canopen.ObjectDictionary, index: int, sub: int) -> int:
    value = _value(od, index, sub)
    return value if isinstance(value, int) else 0


def _value(od: canopen.ObjectDictionary, index: int, sub: int) -> object:
    """Parameter value of a DCF, else the default; None without either."""
    found = eds.known(od, index, sub)
    return None if found is None else found.default if found.value is None else found.value


def _heartbeats_s(od: canopen.ObjectDictionary) -> Iterator[tuple[int, float]]:
    """Node id and consumer heartbeat time, 1016h."""
    for sub in range(1, LAST_NODE + 1):
        entry = _number(od, _HEARTBEATS, sub)
        if entry:
            yield entry >> 16 & 0x7F, (entry & 0xFFFF) / 1000.0


def _upload_files(path: Path) -> dict[int, Path]:
    """Files that 1F22h names, by node id."""
    nodes = range(1, LAST_NODE + 1)
    names = {node_id: eds.option(path, f"1F22sub{node_id:X}", "UploadFile") for node_id in nodes}
    return {node_id: path.parent / name for node_id, name in names.items() if name}


def _configuration(path: Path, od: canopen.ObjectDictionary, node_id: int, files: dict[int, Path]) -> list[Write]:
    place, block = path, b""
    if node_id in files:
        place = files[node_id]
        with usable(place, "read", f"the concise DCF of node {node_id} (1F22h)"):
            block = content(place, eds.MOST_BYTES)
    else:
        value = _value(od, _CONCISE_DCF, node_id)
        block = value if isinstance(value, bytes) else b""
    try:
        return concise_dcf.decode(block) if block else []
    except ValueError as error:
        raise UnusableInputError(place, f"1F22h of node {node_id}: {error}") from error
