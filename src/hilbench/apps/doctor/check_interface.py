"""Check of a CAN interface against a bench's needs: pure functions of what was read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hilbench.apps.canopen_tools.interface import InterfaceFacts
from hilbench.apps.doctor.findings import Check, Finding, Level, error, ok, warning

#: From here on a controller says ERROR-WARNING (ISO 11898-1: limit 96).
_WARNING_LIMIT = 96
_GOOD_QUEUE = 1000
_ENDS_COMMUNICATION = ("LISTEN-ONLY",)
_CHANGES_COMMUNICATION = ("LOOPBACK", "ONE-SHOT", "PRESUME-ACK")

_STATES = {
    "ERROR-ACTIVE": (Level.OK, ""),
    "ERROR-WARNING": (Level.WARNING, "many bit errors: check termination (60 ohm between CAN_H and CAN_L) and stubs"),
    "ERROR-PASSIVE": (
        Level.ERROR,
        "no node acknowledges, or the bit rate is wrong: is a powered node connected? candump -e {name},0:0,#FFFFFFFF",
    ),
    "BUS-OFF": (
        Level.ERROR,
        "remove the cause (short, wrong bit rate, no termination), then: "
        "sudo ip link set {name} down && sudo ip link set {name} up",
    ),
    "STOPPED": (Level.ERROR, "sudo ip link set {name} up"),
    "SLEEPING": (Level.ERROR, "sudo ip link set {name} down && sudo ip link set {name} up"),
}


@dataclass(frozen=True)
class InterfaceNeeds:
    """Requirements of the bench on its interface."""

    bitrate: int  #: bit/s
    frames_per_cycle: int  #: that may wait in the transmit queue at a time
    bitrate_source: str = "as bus: bitrate: in the config"  #: why it is that one, for the finding


def check_interface(before: InterfaceFacts, after: InterfaceFacts, needs: InterfaceNeeds) -> list[Finding]:
    """Findings on an interface, read `before` and `after` some traffic: counters that grow meanwhile are errors.

    State and error counters are those after it: a controller that is alone on its wire is sound until it sends.
    """
    name = before.name
    if not before.exists:
        advice = (
            f"sudo modprobe vcan && sudo ip link add dev {name} type vcan && sudo ip link set {name} up"
            if name.startswith("vcan")
            else "ip -brief link show type can, and dmesg for the adapter's driver"
        )
        return [error(Check.INTERFACE, name, "no such interface", f"a CAN interface {name}", advice)]
    if not before.is_can:
        return [error(Check.INTERFACE, name, "no CAN interface", "link type can (280)", "ip -brief link show type can")]
    findings = [ok(Check.INTERFACE, name, f"CAN interface ({before.kind or 'kind not known'})"), _up(before, needs)]
    if before.detailed:
        findings += [_bitrate(before, needs), *_modes(before), *_state(after), *_error_counters(after)]
        findings += [*_past_errors(before, after), *_restart(before)]
    else:
        findings.append(
            warning(
                Check.BITRATE,
                name,
                "not known: no ip command that speaks JSON",
                f"{needs.bitrate} bit/s",
                "sudo apt install iproute2",
            )
        )
    return [*findings, _queue_length(before, needs)]


def _up_command(facts: InterfaceFacts, needs: InterfaceNeeds) -> str:
    if facts.kind == "vcan":
        return f"sudo ip link set {facts.name} up"
    return f"sudo ip link set {facts.name} up type can bitrate {needs.bitrate} restart-ms 0"


def _up(facts: InterfaceFacts, needs: InterfaceNeeds) -> Finding:
    if facts.up:
        return ok(Check.UP, facts.name, "up")
    return error(Check.UP, facts.name, "down", "up", _up_command(facts, needs))


def _bitrate(facts: InterfaceFacts, needs: InterfaceNeeds) -> Finding:
    if facts.kind == "vcan":
        return ok(Check.BITRATE, facts.name, "none: a vcan has no wire")
    wanted = f"{needs.bitrate} bit/s, {needs.bitrate_source}"
    if facts.bitrate is None:
        return warning(
            Check.BITRATE, facts.name, "not reported by the driver", wanted, "set it where the adapter is configured"
        )
    if facts.bitrate != needs.bitrate:
        advice = f"sudo ip link set {facts.name} down && {_up_command(facts, needs)}"
        return error(Check.BITRATE, facts.name, f"{facts.bitrate} bit/s", wanted, advice)
    return ok(Check.BITRATE, facts.name, f"{facts.bitrate} bit/s")


def _modes(facts: InterfaceFacts) -> Iterator[Finding]:
    for mode in facts.modes:
        off = f"sudo ip link set {facts.name} down && sudo ip link set {facts.name} up type can {mode.lower()} off"
        if mode in _ENDS_COMMUNICATION:
            yield error(Check.MODE, facts.name, mode, "a controller that sends and acknowledges", off)
        elif mode in _CHANGES_COMMUNICATION:
            yield warning(Check.MODE, facts.name, mode, "none of loopback, one-shot, presume-ack", off)
    if not set(facts.modes) & {*_ENDS_COMMUNICATION, *_CHANGES_COMMUNICATION}:
        yield ok(Check.MODE, facts.name, " ".join(facts.modes) or "normal")


def _state(facts: InterfaceFacts) -> Iterator[Finding]:
    # What is down is stopped, and has been reported already.
    if facts.state is None or not facts.up:
        return
    level, advice = _STATES.get(facts.state, (Level.WARNING, "ip -details link show {name}"))
    expected = "" if level is Level.OK else "ERROR-ACTIVE"
    yield Finding(Check.CAN_STATE, facts.name, level, facts.state, expected, advice.format(name=facts.name))


def _error_counters(facts: InterfaceFacts) -> Iterator[Finding]:
    sent, received = facts.transmit_errors, facts.receive_errors
    if sent is None or received is None:
        return
    found = f"transmit {sent}, receive {received}"
    if max(sent, received) >= _WARNING_LIMIT:
        advice = f"check bit rate, termination and wiring; watch: ip -details link show {facts.name}"
        yield error(Check.ERROR_COUNTERS, facts.name, found, f"0, at most {_WARNING_LIMIT - 1}", advice)
    elif sent or received:
        advice = f"bit errors a short time ago; watch whether they come back: ip -details link show {facts.name}"
        yield warning(Check.ERROR_COUNTERS, facts.name, found, "0", advice)
    else:
        yield ok(Check.ERROR_COUNTERS, facts.name, found)


def _past_errors(before: InterfaceFacts, after: InterfaceFacts) -> Iterator[Finding]:
    grown = {name: count - before.counters.get(name, 0) for name, count in after.counters.items()}
    new = ", ".join(f"{name} +{count}" for name, count in grown.items() if count > 0)
    old = ", ".join(f"{name} {count}" for name, count in before.counters.items() if count)
    show = f"ip -details -statistics link show {before.name}"
    if new:
        advice = f"errors happen now: check wiring, termination, bit rate; {show}"
        yield error(Check.PAST_ERRORS, before.name, f"during this check: {new}", "none", advice)
    elif old:
        advice = f"if these are of an earlier set-up, they don't matter; they must not grow: {show}"
        yield warning(Check.PAST_ERRORS, before.name, old, "none since the driver was loaded", advice)
    elif before.counters:
        yield ok(Check.PAST_ERRORS, before.name, "none")


def _restart(facts: InterfaceFacts) -> Iterator[Finding]:
    if facts.restart_ms is None:
        return
    if facts.restart_ms == 0:
        yield ok(Check.RESTART, facts.name, "restart-ms 0: bus-off persists until restarted by hand")
        return
    yield warning(
        Check.RESTART,
        facts.name,
        f"restart-ms {facts.restart_ms}: comes back by itself after bus-off",
        "restart-ms 0, so that bus-off is a fault that stays",
        f"sudo ip link set {facts.name} down && sudo ip link set {facts.name} up type can restart-ms 0",
    )


def _queue_length(facts: InterfaceFacts, needs: InterfaceNeeds) -> Finding:
    if not facts.queued:
        return ok(Check.QUEUE_LENGTH, facts.name, "no queue: frames go to the receivers at once")
    if facts.queue_length is None:
        return ok(Check.QUEUE_LENGTH, facts.name, "not reported by the driver")
    wanted = 2 * needs.frames_per_cycle
    if facts.queue_length >= wanted:
        return ok(Check.QUEUE_LENGTH, facts.name, f"{facts.queue_length} frames")
    return warning(
        Check.QUEUE_LENGTH,
        facts.name,
        f"{facts.queue_length} frames",
        f"{wanted} or more: two cycles of {needs.frames_per_cycle} frames",
        f"sudo ip link set {facts.name} txqueuelen {_GOOD_QUEUE}",
    )
