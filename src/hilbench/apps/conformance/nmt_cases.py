"""Actions of NMT cases (CiA 301, 7.2.8, 7.3.2): what acts in a state, and the services that change it."""

from __future__ import annotations

from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.process_data import receive_pdo, set_up, transmit_pdo
from hilbench.apps.conformance.record import NotAllowedError, NotApplicableError
from hilbench.canopen.identifiers import NMT, NmtCommand, NmtState

_SOON_S: Final = 0.05
_STATES: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


@action
def pdos_act(dut: DeviceUnderTest, state: NmtCommand, act: bool) -> None:
    """Check whether SYNC triggers a TPDO, and an RPDO acts."""
    try:
        pdo = transmit_pdo(dut)
    except NotApplicableError as error:
        dut.notes.append(str(error))
    else:
        set_up(dut, 1)
        dut.nmt(state)
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
    set_up(dut, 1)
    dut.write(0x6040, 0, 0)
    dut.nmt(state)
    dut.send(pdo.cob_id, b"\x06\x00")
    dut.sync()
    if state is NmtCommand.STOP:
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # where SDO is possible again
    dut.reads("controlword after an RPDO with 6", 0x6040, 0, 6 if act else 0)
    dut.write(0x6040, 0, 0)


@action
def no_sdo(dut: DeviceUnderTest) -> None:
    """Expect that SDO is not answered."""
    answer = dut.exchange(bytes.fromhex("4000100000000000"))
    dut.check("read 1000h:0", "no answer", "no answer" if answer is None else answer.hex(" "), answer is None)


@action
def resets_from_every_state(dut: DeviceUnderTest) -> None:
    """Each with the boot-up message."""
    for before in _STATES:
        for command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            dut.nmt(before)
            dut.reset(command)
            dut.produce_heartbeats()
            dut.shows(NmtState.PRE_OPERATIONAL)


@action
def service(dut: DeviceUnderTest, command: NmtCommand) -> None:
    """Command from each of the other states."""
    dut.produce_heartbeats()
    for before in _STATES:
        if before is not command:
            dut.nmt(before)
            dut.nmt(command)
            dut.shows(_STATES[command])


@action
def commands_without_effect(dut: DeviceUnderTest) -> None:
    """Commands for another node, unknown, or too short change nothing."""
    for data in (bytes((1, dut.node_id % 127 + 1)), bytes((0x77, dut.node_id)), bytes((1,))):
        dut.send(NMT, data)
        dut.receive(_SOON_S)
        dut.shows(NmtState.PRE_OPERATIONAL)
