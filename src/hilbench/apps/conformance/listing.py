"""The list of cases: groups, numbers, titles and clauses (`cases.yaml`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import yaml


@dataclass(frozen=True)
class Case:
    """One case as it is listed."""

    group: str
    number: int
    title: str
    clause: str

    @property
    def name(self) -> str:
        """Group and number: "SDO 5"."""
        return f"{self.group} {self.number}"


@cache
def listed_cases() -> tuple[Case, ...]:
    """All of them in the order in which they are examined."""
    text = resources.files("hilbench.apps.conformance").joinpath("cases.yaml").read_text(encoding="utf-8")
    return tuple(
        Case(group, number, entry["title"], entry["clause"])
        for group, entries in yaml.safe_load(text).items()
        for number, entry in entries.items()
    )
