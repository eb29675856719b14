"""Check of a CAN interface against a bench's needs: pure functions of what was read."""

from __future__ import annotations

from collections.abc import Iterator

from hilbench.apps.canopen_tools.interface import InterfaceFacts
from hilbench.apps.doctor.findings import Check, Finding, error, ok, warning
from hilbench.apps.doctor.subject import Subject

#: From here on a controller says ERROR-WARNING (ISO 11898-1: limit 96).
_WARNING_LIMIT = 96
_GOOD_QUEUE = 1000
_ENDS_COMMUNICATION = ("LISTEN-ONLY",)
_CHANGES_COMMUNICATION = ("LOOPBACK", "ONE-SHOT", "PRESUME-ACK")

#: What a controller may say of itself that is an error; anything but ERROR-ACTIVE is at least a warning.
_STATES_OF_ERROR = ("ERROR-PASSIVE", "BUS-OFF", "STOPPED", "SLEEPING")


def check_interface(before: InterfaceFacts, after: InterfaceFacts, subject: Subject) -> list[Finding]:
    """Findings on an interface, read `before` and `after` some traffic: counters that grow meanwhile are errors.

    State and error counters are those after it: a controller that is alone on its wire is sound until it sends.
    """
    name = before.name
    if not before.exists:
        problem = "no_vcan" if name.startswith("vcan") else "no_interface"
        return [error(Check.INTERFACE, name, "no such interface", problem)]
    if not before.is_can:
        return [error(Check.INTERFACE, name, "no CAN interface", "no_can_interface")]
    up = ok(Check.UP, name, "up")
    if not before.up:
        up = error(Check.UP, name, "down", up_command=_up_command(before, subject))
    findings = [ok(Check.INTERFACE, name, f"CAN interface ({before.kind or 'kind not known'})"), up]
    if before.detailed:
        findings += [_bitrate(before, subject), *_modes(before), *_state(after), *_error_counters(after)]
        findings += [*_past_errors(before, after), *_restart(before)]
    else:
        found = "not known: no ip command that speaks JSON"
        findings.append(warning(Check.BITRATE, name, found, "no_ip_command", bitrate=subject.bitrate))
    return [*findings, _queue_length(before, subject)]


def _up_command(facts: InterfaceFacts, subject: Subject) -> str:
    of_a_wire = "" if facts.kind == "vcan" else f" type can bitrate {subject.bitrate} restart-ms 0"
    return f"sudo ip link set {facts.name} up{of_a_wire}"


def _bitrate(facts: InterfaceFacts, subject: Subject) -> Finding:
    name, found, wanted = facts.name, f"{facts.bitrate} bit/s", {"bitrate": subject.bitrate}
    if facts.kind == "vcan":
        return ok(Check.BITRATE, name, "none: a vcan has no wire")
    if facts.bitrate == subject.bitrate:
        return ok(Check.BITRATE, name, found)
    values = {**wanted, "source": subject.bitrate_source, "up_command": _up_command(facts, subject)}
    if facts.bitrate is None:
        return warning(Check.BITRATE, name, "not reported by the driver", "bitrate_not_reported", **values)
    return error(Check.BITRATE, name, found, "bitrate", **values)


def _modes(facts: InterfaceFacts) -> Iterator[Finding]:
    for mode in facts.modes:
        if mode in _ENDS_COMMUNICATION:
            yield error(Check.MODE, facts.name, mode, "mode_ends_communication", mode=mode.lower())
        elif mode in _CHANGES_COMMUNICATION:
            yield warning(Check.MODE, facts.name, mode, "mode_changes_communication", mode=mode.lower())
    if not set(facts.modes) & {*_ENDS_COMMUNICATION, *_CHANGES_COMMUNICATION}:
        yield ok(Check.MODE, facts.name, " ".join(facts.modes) or "normal")


def _state(facts: InterfaceFacts) -> Iterator[Finding]:
    # What is down is stopped, and has been reported already.
    if facts.state is None or not facts.up:
        return
    if facts.state == "ERROR-ACTIVE":
        yield ok(Check.CAN_STATE, facts.name, facts.state)
    elif facts.state in _STATES_OF_ERROR:
        yield error(Check.CAN_STATE, facts.name, facts.state, facts.state)
    else:
        problem = "ERROR-WARNING" if facts.state == "ERROR-WARNING" else ""
        yield warning(Check.CAN_STATE, facts.name, facts.state, problem)


def _error_counters(facts: InterfaceFacts) -> Iterator[Finding]:
    name, sent, received = facts.name, facts.transmit_errors, facts.receive_errors
    if sent is None or received is None:
        return
    found = f"transmit {sent}, receive {received}"
    if max(sent, received) >= _WARNING_LIMIT:
        yield error(Check.ERROR_COUNTERS, name, found, most=_WARNING_LIMIT - 1)
    elif sent or received:
        yield warning(Check.ERROR_COUNTERS, name, found, "few_errors")
    else:
        yield ok(Check.ERROR_COUNTERS, name, found)


def _past_errors(before: InterfaceFacts, after: InterfaceFacts) -> Iterator[Finding]:
    name = before.name
    grown = {counter: count - before.counters.get(counter, 0) for counter, count in after.counters.items()}
    new = ", ".join(f"{counter} +{count}" for counter, count in grown.items() if count > 0)
    old = ", ".join(f"{counter} {count}" for counter, count in before.counters.items() if count)
    if new:
        yield error(Check.PAST_ERRORS, name, f"during this check: {new}")
    elif old:
        yield warning(Check.PAST_ERRORS, name, old, "old_errors")
    elif before.counters:
        yield ok(Check.PAST_ERRORS, name, "none")


def _restart(facts: InterfaceFacts) -> Iterator[Finding]:
    if facts.restart_ms == 0:
        yield ok(Check.RESTART, facts.name, "restart-ms 0: bus-off persists until restarted by hand")
    elif facts.restart_ms is not None:
        found = f"restart-ms {facts.restart_ms}: comes back by itself after bus-off"
        yield warning(Check.RESTART, facts.name, found)


def _queue_length(facts: InterfaceFacts, subject: Subject) -> Finding:
    name, frames, wanted = facts.name, subject.frames_per_cycle, 2 * subject.frames_per_cycle
    if not facts.queued:
        return ok(Check.QUEUE_LENGTH, name, "no queue: frames go to the receivers at once")
    if facts.queue_length is None:
        return ok(Check.QUEUE_LENGTH, name, "not reported by the driver")
    found = f"{facts.queue_length} frames"
    if facts.queue_length >= wanted:
        return ok(Check.QUEUE_LENGTH, name, found)
    return warning(Check.QUEUE_LENGTH, name, found, wanted=wanted, frames=frames, good=_GOOD_QUEUE)
