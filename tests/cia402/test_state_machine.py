"""The CiA-402 power state machine: tables of the standard, written out a second time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.cia402.state_machine import (
    DESTINATION,
    State,
    commanded,
    controlword_towards_disabled,
    controlword_towards_enabled,
    decode_statusword,
)

S = State

#: IEC 61800-7-201: (transition, from, controlword bits 7 and 3..0 with x for "any", to).
COMMANDED = [
    (2, S.SWITCH_ON_DISABLED, "0 x110", S.READY_TO_SWITCH_ON),
    (3, S.READY_TO_SWITCH_ON, "0 x111", S.SWITCHED_ON),
    (4, S.SWITCHED_ON, "0 1111", S.OPERATION_ENABLED),
    (5, S.OPERATION_ENABLED, "0 0111", S.SWITCHED_ON),
    (6, S.SWITCHED_ON, "0 x110", S.READY_TO_SWITCH_ON),
    (7, S.READY_TO_SWITCH_ON, "0 xx0x", S.SWITCH_ON_DISABLED),
    (7, S.READY_TO_SWITCH_ON, "0 x01x", S.SWITCH_ON_DISABLED),
    (8, S.OPERATION_ENABLED, "0 x110", S.READY_TO_SWITCH_ON),
    (9, S.OPERATION_ENABLED, "0 xx0x", S.SWITCH_ON_DISABLED),
    (10, S.SWITCHED_ON, "0 xx0x", S.SWITCH_ON_DISABLED),
    (10, S.SWITCHED_ON, "0 x01x", S.SWITCH_ON_DISABLED),
    (11, S.OPERATION_ENABLED, "0 x01x", S.QUICK_STOP_ACTIVE),
    (12, S.QUICK_STOP_ACTIVE, "0 xx0x", S.SWITCH_ON_DISABLED),
    (16, S.QUICK_STOP_ACTIVE, "0 1111", S.OPERATION_ENABLED),
]


def _matches(pattern: str, controlword: int) -> bool:
    bits = f"{controlword >> 7 & 1} {controlword & 0xF:04b}"
    return all(p in ("x", b) for p, b in zip(pattern, bits, strict=True))


@pytest.mark.parametrize("state", list(State))
def test_every_controlword_asks_for_the_transition_of_the_standard(state: State) -> None:
    for controlword in range(0x80):
        expected = [row for row in COMMANDED if row[1] is state and _matches(row[2], controlword)]
        transition = commanded(state, controlword, 0)
        if expected:
            assert transition is not None
            assert (int(transition), DESTINATION[transition]) == (expected[0][0], expected[0][3])
        else:
            assert transition is None


def test_only_the_rising_edge_of_bit_7_resets_a_fault() -> None:
    assert commanded(S.FAULT, 0x80, 0x00) == 15
    assert commanded(S.FAULT, 0x8F, 0x0F) == 15
    assert commanded(S.FAULT, 0x80, 0x80) is None
    assert commanded(S.FAULT, 0x0F, 0x80) is None
    assert commanded(S.FAULT_REACTION_ACTIVE, 0x80, 0x00) is None


@pytest.mark.parametrize(
    ("state", "controlword"),
    [(S.SWITCH_ON_DISABLED, 0x86), (S.READY_TO_SWITCH_ON, 0x87), (S.SWITCHED_ON, 0x8F), (S.QUICK_STOP_ACTIVE, 0x8F)],
)
def test_no_way_to_power_while_the_reset_bit_is_set(state: State, controlword: int) -> None:
    assert commanded(state, controlword, 0) is None
    assert commanded(state, controlword & 0x7F, 0) is not None


def test_power_can_be_taken_away_while_the_reset_bit_is_set() -> None:
    assert commanded(S.OPERATION_ENABLED, 0x80, 0x0F) == 9
    assert commanded(S.OPERATION_ENABLED, 0x82, 0x0F) == 11


@given(st.integers(0, 0xFFFF))
def test_statusword_is_decoded_by_the_masks_of_the_standard(statusword: int) -> None:
    masks = {
        S.NOT_READY_TO_SWITCH_ON: (0x4F, 0x00),
        S.SWITCH_ON_DISABLED: (0x4F, 0x40),
        S.READY_TO_SWITCH_ON: (0x6F, 0x21),
        S.SWITCHED_ON: (0x6F, 0x23),
        S.OPERATION_ENABLED: (0x6F, 0x27),
        S.QUICK_STOP_ACTIVE: (0x6F, 0x07),
        S.FAULT_REACTION_ACTIVE: (0x4F, 0x0F),
        S.FAULT: (0x4F, 0x08),
    }
    shown = [state for state, (mask, value) in masks.items() if statusword & mask == value]
    assert decode_statusword(statusword) is (shown[0] if shown else None)


@pytest.mark.parametrize("start", [s for s in State if s not in (S.FAULT, S.FAULT_REACTION_ACTIVE)])
def test_the_masters_controlwords_lead_to_enabled_and_back(start: State) -> None:
    def follow(state: State, choose, wanted: State) -> list[State]:  # type: ignore[no-untyped-def]
        path = []
        while state is not wanted:
            if state is S.NOT_READY_TO_SWITCH_ON:
                state = S.SWITCH_ON_DISABLED  # transition 1 is automatic
            else:
                transition = commanded(state, choose(state), 0)
                assert transition is not None
                state = DESTINATION[transition]
            path.append(state)
            assert len(path) < 6
        return path

    follow(start, controlword_towards_enabled, S.OPERATION_ENABLED)
    assert S.OPERATION_ENABLED not in follow(start, controlword_towards_disabled, S.SWITCH_ON_DISABLED)
