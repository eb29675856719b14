"""NMT cases (CiA 301, 7.2.8, 7.3.2): states and the services that change them, seen by heartbeats."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.process_data import receive_pdo, set_up, transmit_pdo
from hilbench.apps.conformance.record import NotAllowedError, NotApplicableError
from hilbench.canopen.identifiers import NMT, NmtCommand, NmtState

_PARAMETERS: Final = {(0x1006, 0): 7, (0x1007, 0): 7, (0x1015, 0): 7, (0x1017, 0): 500, (0x1016, 1): 0x7D0064}
_SOON_S: Final = 0.05


def boot_up(dut: DeviceUnderTest) -> None:
    """After a reset the parameters are those of power-on."""
    dut.reset()
    there = {key: value for key, value in _PARAMETERS.items() if dut.eds.can_write(*key)}
    before = {key: dut.value(*key) for key in there}
    for key, value in there.items():
        dut.write(*key, value)
    dut.reset()
    for key, value in before.items():
        dut.reads(f"{key[0]:04X}h:{key[1]} as at power-on", *key, value)
    dut.produce_heartbeats()
    dut.shows(NmtState.PRE_OPERATIONAL)


def _pdos_act(dut: DeviceUnderTest, command: NmtCommand, act: bool) -> None:
    """Check whether SYNC triggers a TPDO, and an RPDO acts."""
    try:
        pdo = transmit_pdo(dut)
    except NotApplicableError as error:
        dut.notes.append(str(error))
    else:
        set_up(dut, pdo, 1)
        dut.nmt(command)
        dut.forget()
        dut.frames("SYNC", dut.sync(), pdo.cob_id, *(["??" * pdo.size] if act else []))
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    if not dut.eds.is_drive:
        return
    try:
        pdo = receive_pdo(dut)
    except (NotApplicableError, NotAllowedError) as error:
        dut.notes.append(str(error))
        return
    set_up(dut, pdo, 1)
    dut.write(0x6040, 0, 0)
    dut.nmt(command)
    dut.send(pdo.cob_id, b"\x06\x00")
    dut.sync()
    if command is NmtCommand.STOP:
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # where SDO is possible again
    dut.reads("controlword after an RPDO with 6", 0x6040, 0, 6 if act else 0)
    dut.write(0x6040, 0, 0)


def _answers_sdo(dut: DeviceUnderTest, answers: bool) -> None:
    if answers:
        dut.ask("read 1000h:0", "40 00 10 00 00000000", "43 00 10 00 ????????")
        return
    answer = dut.exchange(bytes.fromhex("4000100000000000"))
    dut.check("read 1000h:0", "no answer", "no answer" if answer is None else answer.hex(" "), answer is None)


def pre_operational(dut: DeviceUnderTest) -> None:
    """SDO, no PDO."""
    dut.reset()
    _answers_sdo(dut, answers=True)
    dut.produce_heartbeats()
    dut.shows(NmtState.PRE_OPERATIONAL)
    _pdos_act(dut, NmtCommand.ENTER_PRE_OPERATIONAL, act=False)


def operational(dut: DeviceUnderTest) -> None:
    """SDO and PDO."""
    dut.produce_heartbeats()
    dut.nmt(NmtCommand.START)
    _answers_sdo(dut, answers=True)
    dut.shows(NmtState.OPERATIONAL)
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    _pdos_act(dut, NmtCommand.START, act=True)


def stopped(dut: DeviceUnderTest) -> None:
    """The heartbeat alone."""
    dut.produce_heartbeats()
    dut.nmt(NmtCommand.STOP)
    _answers_sdo(dut, answers=False)
    dut.shows(NmtState.STOPPED)
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    _pdos_act(dut, NmtCommand.STOP, act=False)


_STATES: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


def resets(dut: DeviceUnderTest) -> None:
    """Reset from every state, with the boot-up message."""
    for before in _STATES:
        for command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            dut.nmt(before)
            dut.reset(command)
            dut.produce_heartbeats()
            dut.shows(NmtState.PRE_OPERATIONAL)


def service(dut: DeviceUnderTest, command: NmtCommand) -> None:
    """Command from each of the other states."""
    dut.produce_heartbeats()
    for before in _STATES:
        if before is not command:
            dut.nmt(before)
            dut.nmt(command)
            dut.shows(_STATES[command])
    if command is NmtCommand.STOP:
        _others(dut)


def _others(dut: DeviceUnderTest) -> None:
    """Commands for another node, unknown, or too short change nothing."""
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    for data in (bytes((1, dut.node_id % 127 + 1)), bytes((0x77, dut.node_id)), bytes((1,))):
        dut.send(NMT, data)
        dut.receive(_SOON_S)
        dut.shows(NmtState.PRE_OPERATIONAL)


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], None]]] = {
    "NMT 1": boot_up,
    "NMT 2": pre_operational,
    "NMT 3": operational,
    "NMT 4": stopped,
    "NMT 5": resets,
    "NMT 6": lambda dut: service(dut, NmtCommand.ENTER_PRE_OPERATIONAL),
    "NMT 7": lambda dut: service(dut, NmtCommand.START),
    "NMT 8": lambda dut: service(dut, NmtCommand.STOP),
}
