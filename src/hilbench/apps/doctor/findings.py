"""Findings of an examination: one for each thing that was looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from pathlib import Path
from typing import Final

from hilbench import strict_yaml


class Level(StrEnum):
    """Severity: `error` means that a run would fail or must not be trusted."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


class Check(StrEnum):
    """Everything that is looked at; docs/real_stand.md has a table of what each of them means."""

    INTERFACE = "interface"
    UP = "up"
    BITRATE = "bitrate"
    MODE = "mode"
    CAN_STATE = "can_state"
    ERROR_COUNTERS = "error_counters"
    PAST_ERRORS = "past_errors"
    RESTART = "restart"
    QUEUE_LENGTH = "queue_length"
    RECEIVE_BUFFER = "receive_buffer"
    CLOCK = "clock"
    CLOCK_SOURCE = "clock_source"
    TIMER = "timer"
    PRIORITY = "priority"
    LOCKED_MEMORY = "locked_memory"
    KERNEL = "kernel"
    ISOLATED_CORES = "isolated_cores"
    GOVERNOR = "governor"
    BUS = "bus"
    OTHER_MASTER = "other_master"
    STRANGERS = "strangers"
    NODE_ANSWERS = "node_answers"
    IDENTITY = "identity"
    MAPPED_OBJECTS = "mapped_objects"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at; `advice` is what to do, with the command to type, where it is not ok."""

    check: Check
    subject: str  #: where: interface, "this machine", or "axis1 (node 1)"
    level: Level
    found: str
    expected: str = ""
    advice: str = ""


@cache
def _texts() -> Mapping[str, Mapping[str, str]]:
    """Texts of findings: what is expected, and what to do otherwise."""
    texts: Mapping[str, Mapping[str, str]] = strict_yaml.load(Path(__file__).with_name("findings.yaml")).data
    return texts


def ok(check: Check, subject: str, found: str) -> Finding:
    """Finding that all is well."""
    return Finding(check, subject, Level.OK, found)


def _problem(level: Level, check: Check, subject: str, found: str, problem: str = "", **values: object) -> Finding:
    """Finding of what is not as it should be; `problem`: in `findings.yaml`, if not by the check."""
    text, values = _texts()[problem or check], {"name": subject, **values}
    return Finding(check, subject, level, found, text["expected"].format_map(values), text["advice"].format_map(values))


#: A run works, but not as well or not as safely as it could.
warning: Final = partial(_problem, Level.WARNING)
#: A run would fail, or its result could not be trusted.
error: Final = partial(_problem, Level.ERROR)
