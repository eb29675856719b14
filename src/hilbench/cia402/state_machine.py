"""The CiA-402 power state machine (IEC 61800-7-201, "PDS FSA") as tables and pure functions, for both sides.

A drive finds the transition that a controlword commands by `commanded`; a master finds a drive's state by
`decode_statusword`, and the next controlword towards a wanted state by `controlword_towards_enabled` or
`controlword_towards_disabled`.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Final


class State(Enum):
    """Power states; the value is the statusword's pattern of the state (bits 6, 5, 3..0)."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08

    @property
    def label(self) -> str:
        """The state's name as the standard writes it."""
        return self.name.replace("_", " ")


#: States in which a power stage is on: everywhere else the shaft is free.
POWERED: Final = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})


class Command(Enum):
    """Commands in a controlword's bits 3..0; the value is the controlword a master sends for it."""

    DISABLE_VOLTAGE = 0x0000
    QUICK_STOP = 0x0002
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007  #: in OPERATION ENABLED the same bits mean "disable operation"
    ENABLE_OPERATION = 0x000F


class Transition(IntEnum):
    """The transitions by their numbers in the standard."""

    T0_START = 0
    T1_SELF_TEST_DONE = 1
    T2_SHUTDOWN = 2
    T3_SWITCH_ON = 3
    T4_ENABLE_OPERATION = 4
    T5_DISABLE_OPERATION = 5
    T6_SHUTDOWN = 6
    T7_DISABLE_VOLTAGE = 7
    T8_SHUTDOWN = 8
    T9_DISABLE_VOLTAGE = 9
    T10_DISABLE_VOLTAGE = 10
    T11_QUICK_STOP = 11
    T12_QUICK_STOP_DONE = 12  #: automatic, or by "disable voltage"
    T13_FAULT = 13  #: automatic
    T14_FAULT_REACTION_DONE = 14  #: automatic
    T15_FAULT_RESET = 15
    T16_ENABLE_OPERATION = 16


CONTROLWORD_FAULT_RESET: Final = 0x0080
CONTROLWORD_HALT: Final = 0x0100

STATUS_VOLTAGE_ENABLED: Final = 1 << 4
STATUS_WARNING: Final = 1 << 7
STATUS_REMOTE: Final = 1 << 9
STATUS_TARGET_REACHED: Final = 1 << 10
STATUS_INTERNAL_LIMIT: Final = 1 << 11
#: Bits 12 and 13 mean different things in different modes of operation.
STATUS_MODE_12: Final = 1 << 12
STATUS_MODE_13: Final = 1 << 13

#: Where each transition leads.
DESTINATION: Final = {
    Transition.T0_START: State.NOT_READY_TO_SWITCH_ON,
    Transition.T1_SELF_TEST_DONE: State.SWITCH_ON_DISABLED,
    Transition.T2_SHUTDOWN: State.READY_TO_SWITCH_ON,
    Transition.T3_SWITCH_ON: State.SWITCHED_ON,
    Transition.T4_ENABLE_OPERATION: State.OPERATION_ENABLED,
    Transition.T5_DISABLE_OPERATION: State.SWITCHED_ON,
    Transition.T6_SHUTDOWN: State.READY_TO_SWITCH_ON,
    Transition.T7_DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
    Transition.T8_SHUTDOWN: State.READY_TO_SWITCH_ON,
    Transition.T9_DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
    Transition.T10_DISABLE_VOLTAGE: State.SWITCH_ON_DISABLED,
    Transition.T11_QUICK_STOP: State.QUICK_STOP_ACTIVE,
    Transition.T12_QUICK_STOP_DONE: State.SWITCH_ON_DISABLED,
    Transition.T13_FAULT: State.FAULT_REACTION_ACTIVE,
    Transition.T14_FAULT_REACTION_DONE: State.FAULT,
    Transition.T15_FAULT_RESET: State.SWITCH_ON_DISABLED,
    Transition.T16_ENABLE_OPERATION: State.OPERATION_ENABLED,
}

_COMMANDED: Final = {
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): Transition.T2_SHUTDOWN,
    (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): Transition.T3_SWITCH_ON,
    # "Switch on + enable operation": 3, and then 4 by the same controlword.
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): Transition.T3_SWITCH_ON,
    (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): Transition.T7_DISABLE_VOLTAGE,
    (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): Transition.T7_DISABLE_VOLTAGE,
    (State.SWITCHED_ON, Command.ENABLE_OPERATION): Transition.T4_ENABLE_OPERATION,
    (State.SWITCHED_ON, Command.SHUTDOWN): Transition.T6_SHUTDOWN,
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): Transition.T10_DISABLE_VOLTAGE,
    (State.SWITCHED_ON, Command.QUICK_STOP): Transition.T10_DISABLE_VOLTAGE,
    (State.OPERATION_ENABLED, Command.SWITCH_ON): Transition.T5_DISABLE_OPERATION,
    (State.OPERATION_ENABLED, Command.SHUTDOWN): Transition.T8_SHUTDOWN,
    (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): Transition.T9_DISABLE_VOLTAGE,
    (State.OPERATION_ENABLED, Command.QUICK_STOP): Transition.T11_QUICK_STOP,
    (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): Transition.T12_QUICK_STOP_DONE,
    (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): Transition.T16_ENABLE_OPERATION,
}

#: Transitions towards power: the standard wants bit 7 clear for every command. Commands that take power away
#: are obeyed with bit 7 set, too, because ignoring them would be the dangerous reading.
_TOWARDS_POWER: Final = frozenset(
    {
        Transition.T2_SHUTDOWN,
        Transition.T3_SWITCH_ON,
        Transition.T4_ENABLE_OPERATION,
        Transition.T16_ENABLE_OPERATION,
    }
)


def decode_controlword(controlword: int) -> Command:
    """The command in bits 3..0 of a controlword (0xx0x, 0x01x, 0x110, 00111, 01111)."""
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if controlword & 0x08 else Command.SWITCH_ON


def commanded(state: State, controlword: int, previous: int) -> Transition | None:
    """Transition that `controlword` commands of a drive in `state`, or None.

    `previous` is the controlword before it: a fault is reset by the rising edge of bit 7 only.
    """
    if state is State.FAULT:
        rising = controlword & ~previous & CONTROLWORD_FAULT_RESET
        return Transition.T15_FAULT_RESET if rising else None
    transition = _COMMANDED.get((state, decode_controlword(controlword)))
    if controlword & CONTROLWORD_FAULT_RESET and transition in _TOWARDS_POWER:
        return None
    return transition


#: The statusword bits that determine a state; bit 5 counts only where the quick stop has a meaning.
STATUS_MASK: Final = {
    State.NOT_READY_TO_SWITCH_ON: 0x4F,
    State.SWITCH_ON_DISABLED: 0x4F,
    State.READY_TO_SWITCH_ON: 0x6F,
    State.SWITCHED_ON: 0x6F,
    State.OPERATION_ENABLED: 0x6F,
    State.QUICK_STOP_ACTIVE: 0x6F,
    State.FAULT_REACTION_ACTIVE: 0x4F,
    State.FAULT: 0x4F,
}
_STATE_OF_BITS: Final = {
    bits: state for state, mask in STATUS_MASK.items() for bits in range(0x80) if bits & mask == state.value
}


def decode_statusword(statusword: int) -> State | None:
    """The state a statusword shows; None for a pattern that the standard does not know."""
    return _STATE_OF_BITS.get(statusword & 0x7F)


_DISABLE = Command.DISABLE_VOLTAGE.value
_TOWARDS_ENABLED: Final = {
    State.SWITCH_ON_DISABLED: Command.SHUTDOWN.value,
    State.READY_TO_SWITCH_ON: Command.SWITCH_ON.value,
    State.SWITCHED_ON: Command.ENABLE_OPERATION.value,
    State.OPERATION_ENABLED: Command.ENABLE_OPERATION.value,
}
_TOWARDS_DISABLED: Final = {
    State.OPERATION_ENABLED: Command.SWITCH_ON.value,  # "disable operation": ramps down by 605Ch
    State.SWITCHED_ON: Command.SHUTDOWN.value,
}


def controlword_towards_enabled(state: State) -> int:
    """The next controlword on the way to OPERATION ENABLED.

    An active quick stop is left through SWITCH ON DISABLED (transition 16 is not everywhere allowed); a fault
    is not reset on the way: that is a decision of its own.
    """
    return _TOWARDS_ENABLED.get(state, _DISABLE)


def controlword_towards_disabled(state: State) -> int:
    """The next controlword on the way to SWITCH ON DISABLED, step by step and with the ramp of 605Ch."""
    return _TOWARDS_DISABLED.get(state, _DISABLE)
