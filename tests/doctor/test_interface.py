"""From the kernel's words on a CAN interface to findings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hilbench.apps.canopen_tools.interface import InterfaceFacts, parse_ip_link, read_sysfs
from hilbench.apps.doctor.check_interface import check_interface
from hilbench.apps.doctor.findings import Check, Finding, Level
from hilbench.apps.doctor.subject import Subject
from hilbench.can.open import BusAddress

CAPTURED = Path(__file__).parent / "captured"
SUBJECT = Subject(BusAddress("socketcan", "can0", 1_000_000), realtime=True, frames_per_cycle=13)


def captured(name: str) -> InterfaceFacts:
    return parse_ip_link((CAPTURED / f"{name}.json").read_text())


def judge(facts: InterfaceFacts, after: InterfaceFacts | None = None) -> dict[Check, Finding]:
    findings = check_interface(facts, after or facts, SUBJECT)
    assert len({finding.check for finding in findings}) == len(findings)
    for finding in findings:
        assert "\n" not in finding.advice
        # Whatever is not as it should be says what was expected and what to do, and nothing else does.
        assert bool(finding.expected) == bool(finding.advice) == (finding.level is not Level.OK), finding
    return {finding.check: finding for finding in findings}


def not_ok(findings: dict[Check, Finding]) -> dict[Check, Level]:
    return {check: finding.level for check, finding in findings.items() if finding.level is not Level.OK}


def test_facts_of_a_controller() -> None:
    facts = captured("sja1000_error_active")
    assert facts == InterfaceFacts(
        name="can0",
        up=True,
        kind="can",
        queue_length=1000,
        bitrate=1_000_000,
        state="ERROR-ACTIVE",
        transmit_errors=0,
        receive_errors=0,
        restart_ms=0,
        counters=facts.counters,
    )
    assert set(facts.counters) >= {"bus_error", "bus_off", "rx_dropped", "rx_over_errors", "tx_dropped"}
    assert not any(facts.counters.values())


def test_a_sound_controller_and_a_vcan_are_ok() -> None:
    assert not_ok(judge(captured("sja1000_error_active"))) == {}
    findings = judge(captured("vcan_up"))
    assert not_ok(findings) == {}
    assert "no wire" in findings[Check.BITRATE].found
    assert "no queue" in findings[Check.QUEUE_LENGTH].found


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sja1000_error_passive", {"can_state": "error", "error_counters": "error", "past_errors": "warning"}),
        ("sja1000_bus_off", {"can_state": "error", "error_counters": "error", "past_errors": "warning"}),
        ("sja1000_stopped", {"up": "error"}),
        ("sja1000_500k_restart", {"bitrate": "error", "restart": "warning"}),
        ("sja1000_listen_only", {"bitrate": "error", "restart": "warning", "mode": "error"}),
    ],
)
def test_what_is_wrong_is_found_and_nothing_else(name: str, expected: dict[str, str]) -> None:
    assert not_ok(judge(captured(name))) == {Check(check): Level(level) for check, level in expected.items()}


def test_the_advice_is_the_command_to_type() -> None:
    up = "sudo ip link set can1 up type can bitrate 1000000 restart-ms 0"
    assert judge(captured("sja1000_stopped"))[Check.UP].advice == up
    wrong = judge(captured("sja1000_500k_restart"))[Check.BITRATE]
    assert wrong.found == "500000 bit/s"
    assert wrong.expected.startswith("1000000 bit/s")
    assert wrong.advice == f"sudo ip link set can1 down && {up}"
    down = replace(captured("vcan_up"), up=False)
    assert judge(down)[Check.UP].advice == "sudo ip link set vcan0 up"
    assert "type vcan" in judge(InterfaceFacts("vcan7", exists=False))[Check.INTERFACE].advice
    assert "listen-only off" in judge(captured("sja1000_listen_only"))[Check.MODE].advice


def test_a_queue_holds_two_cycles() -> None:
    facts = captured("sja1000_error_active")
    short = judge(replace(facts, queue_length=25))[Check.QUEUE_LENGTH]
    assert short.level is Level.WARNING
    assert "txqueuelen" in short.advice
    assert judge(replace(facts, queue_length=26))[Check.QUEUE_LENGTH].level is Level.OK


def test_errors_that_happen_now_are_worse_than_old_ones() -> None:
    before = captured("sja1000_error_active")
    old = replace(before, counters={**before.counters, "bus_error": 4})
    assert judge(old)[Check.PAST_ERRORS].level is Level.WARNING
    new = replace(before, counters={**before.counters, "bus_error": 4, "rx_over_errors": 2})
    now = judge(old, after=new)[Check.PAST_ERRORS]
    assert now.level is Level.ERROR
    assert "rx_over_errors +2" in now.found
    assert "bus_error" not in now.found


def test_a_controller_that_turns_out_to_be_alone_when_it_sends() -> None:
    findings = judge(captured("sja1000_error_active"), after=captured("sja1000_error_passive"))
    assert not_ok(findings) == dict.fromkeys((Check.CAN_STATE, Check.ERROR_COUNTERS, Check.PAST_ERRORS), Level.ERROR)


@pytest.mark.parametrize(("counts", "level"), [((0, 1), "warning"), ((95, 0), "warning"), ((0, 96), "error")])
def test_error_counters(counts: tuple[int, int], level: str) -> None:
    facts = replace(captured("sja1000_error_active"), transmit_errors=counts[0], receive_errors=counts[1])
    assert not_ok(judge(facts)) == {Check.ERROR_COUNTERS: Level(level)}


@pytest.mark.parametrize("state", ["ERROR-WARNING", "SLEEPING", "SOMETHING-NEW"])
def test_every_other_state_is_told(state: str) -> None:
    assert Check.CAN_STATE in not_ok(judge(replace(captured("sja1000_error_active"), state=state)))


def interface_folder(root: Path, *, kind: int, flags: int) -> None:
    folder = root / "can0"
    folder.mkdir()
    for name, value in (("type", str(kind)), ("flags", hex(flags)), ("tx_queue_len", "10")):
        (folder / name).write_text(value + "\n")


def test_without_ip_the_rest_is_still_judged(tmp_path: Path) -> None:
    interface_folder(tmp_path, kind=280, flags=0x40081)
    findings = judge(read_sysfs("can0", tmp_path))
    assert not_ok(findings) == {Check.BITRATE: Level.WARNING, Check.QUEUE_LENGTH: Level.WARNING}
    assert "iproute2" in findings[Check.BITRATE].advice


def test_no_interface_and_no_can_interface(tmp_path: Path) -> None:
    assert not_ok(judge(read_sysfs("can0", tmp_path))) == {Check.INTERFACE: Level.ERROR}
    interface_folder(tmp_path, kind=1, flags=0x1003)
    assert not_ok(judge(read_sysfs("can0", tmp_path))) == {Check.INTERFACE: Level.ERROR}
