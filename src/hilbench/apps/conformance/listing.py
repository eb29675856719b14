"""The list of cases (`cases/*.yaml`): group, number, title, clause, what it needs and what is done.

Those of CiA 301 are titled as in the report that CANopenNode publishes of its demo device; those of CiA 402 are ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from hilbench.apps.conformance import (
    drive_cases,
    od_cases,
    pdo_cases,
    power,
    sdo_cases,
    service_cases,
    steps,
)
from hilbench.apps.conformance.actions import Action, register
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import Case, NotApplicableError
from hilbench.block import Strict
from hilbench.strict_yaml import load, validate

register(power, steps, sdo_cases, pdo_cases, od_cases, service_cases, drive_cases)

_FOLDER: Final = Path(__file__).parent / "cases"
#: The files in the order in which their cases are examined.
_FILES: Final = ("eds", "sdo", "pdo", "od", "emcy", "sync", "heartbeat", "store", "nmt", "drive")


class Entry(Strict):
    """One case in its file: where the standard asks for it, what the device has to have for it, what is done."""

    title: str
    clause: str
    needs: tuple[Action, ...] = ()
    do: tuple[Action, ...]


class Group(Strict):
    """Cases of one group by number."""

    of_drives: bool = False  #: each axis is examined, if it is a drive of CiA 402
    cases: dict[int, Entry]


@dataclass(frozen=True)
class ListedCase(Case):
    """One case with what is done of it."""

    of_drives: bool = False
    actions: Sequence[Callable[[DeviceUnderTest], object]] = ()

    def examine(self, dut: DeviceUnderTest) -> None:
        """Examine a device by it. Raises NotApplicableError, NotAllowedError and CaseEndedError."""
        if self.of_drives and not dut.eds.is_drive:
            raise NotApplicableError("no drive of CiA 402: 6040h and 6041h are not in the EDS file")
        for act in self.actions:
            act(dut)


@cache
def listed_cases() -> tuple[ListedCase, ...]:
    """Cases in the order in which they are examined."""
    return tuple(
        ListedCase(name, number, case.title, case.clause, group.of_drives, (*case.needs, *case.do))
        for document in (load(_FOLDER / f"{file}.yaml") for file in _FILES)
        for name, group in ((name, validate(document, Group, (name,))) for name in document.data)
        for number, case in group.cases.items()
    )
