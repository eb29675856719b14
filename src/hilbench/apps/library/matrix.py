"""Requirements by runs: which of them each run has verified, and which no criterion covers."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from hilbench.apps.library.index import RunEntry
from hilbench.errors import UnusableInputError, one_line

Cell = Literal["passed", "marginal", "failed", "error", "fault", ""]
#: From the best to the worst: what several criteria of a run say together is what the worst of them says.
_ORDER: Final[tuple[Cell, ...]] = ("", "passed", "marginal", "error", "fault", "failed")
#: Attributes in which tools keep the id that people use, and the title; the first that is there (ReqIF implementation
#: guide of prostep ivip, system attributes).
_IDS: Final = ("ReqIF.ForeignID", "ReqIF.ForeignId", "UID", "ID")
_TITLES: Final = ("ReqIF.Name", "TITLE", "Title", "ReqIF.Text", "STATEMENT")
_HEADING: Final = "ReqIF.ChapterName"
_LONGEST_TITLE: Final = 120


@dataclass(frozen=True)
class Requirement:
    """Requirement of a specification: its title may be "" where only its id is known."""

    id: str
    title: str = ""


@dataclass(frozen=True)
class Row:
    """A requirement: what each run says of it, "" where none of its criteria verifies it; `criteria`: their names."""

    requirement: Requirement
    cells: Sequence[Cell]
    criteria: Sequence[str]

    @property
    def covered(self) -> bool:
        """True if any of the runs has a criterion that verifies it."""
        return bool(self.criteria)

    @property
    def newest(self) -> Cell:
        """Cell of the newest run with a verdict on it."""
        return next((cell for cell in self.cells if cell), "")


@dataclass(frozen=True)
class Matrix:
    """`runs` are the columns, the newest first; `rows` the requirements, in the order of their specification, then
    those that only criteria name."""

    runs: Sequence[RunEntry]
    rows: Sequence[Row]

    @property
    def not_covered(self) -> list[Requirement]:
        """Requirements that no criterion of any run verifies."""
        return [row.requirement for row in self.rows if not row.covered]

    @property
    def fulfilled(self) -> bool:
        """True if every requirement is covered, and passed when it was last verified."""
        return all(row.newest in ("passed", "marginal") for row in self.rows)

    def as_data(self) -> dict[str, Any]:
        """Data for a program."""
        return {
            "runs": [{"run": run.path, "result": run.state} for run in self.runs],
            "requirements": [
                {
                    "id": row.requirement.id,
                    "title": row.requirement.title,
                    "covered": row.covered,
                    "newest": row.newest or None,
                    "criteria": list(row.criteria),
                    "runs": {run.path: cell for run, cell in zip(self.runs, row.cells, strict=True) if cell},
                }
                for row in self.rows
            ],
        }


def matrix_of(runs: Sequence[RunEntry], specified: Iterable[Requirement] = ()) -> Matrix:
    """The matrix of these runs; requirements of the specification are in it whether any run verifies them or not.

    A run that ended with a fault verifies nothing that it says passed: its bench was not what it should be.
    """
    requirements: dict[str, Requirement] = {each.id: each for each in specified}
    criteria: dict[str, dict[str, None]] = {}
    cells: dict[str, dict[str, Cell]] = {}
    for run in runs:
        for verdict in run.verdicts:
            for name in verdict.verifies:
                requirements.setdefault(name, Requirement(name))
                criteria.setdefault(name, {})[verdict.name] = None
                of_run = cells.setdefault(name, {})
                of_run[run.path] = max(of_run.get(run.path, ""), _cell(run, verdict.verdict), key=_ORDER.index)
    shown = [run for run in runs if any(run.path in found for found in cells.values())]
    rows = [
        Row(each, [cells.get(name, {}).get(run.path, "") for run in shown], list(criteria.get(name, ())))
        for name, each in requirements.items()
    ]
    return Matrix(shown, rows)


def _cell(run: RunEntry, verdict: str) -> Cell:
    if run.state in ("fault", "interrupted") and verdict != "failed":
        return "fault"
    return next(cell for cell in _ORDER if cell == verdict)


def write_matrix_page(matrix: Matrix, base: Path, path: Path) -> Path:
    """Write the page, with links to the reports of the runs in the folder `base`; returns `path`.

    Raises UnusableInputError if it can't be written.
    """
    from hilbench.apps.library.runs_page import report_address
    from hilbench.apps.report.page import write_page

    links = [report_address(base, run, path) if run.has_report else "" for run in matrix.runs]
    covered = len(matrix.rows) - len(matrix.not_covered)
    held = sum(row.newest in ("passed", "marginal") for row in matrix.rows)
    return write_page(
        path,
        "library/matrix",
        title="Requirements",
        facts=[f"{len(matrix.rows)} requirements", f"{covered} covered", f"{held} passed when last looked at"],
        passed=matrix.fulfilled,
        runs=list(zip(matrix.runs, links, strict=True)),
        rows=matrix.rows,
    )


def read_reqif(path: Path) -> list[Requirement]:
    """The requirements of a .reqif file, in the order of its specifications; headings are left out.

    Raises UnusableInputError for what is none, or without the package reqif.
    """
    try:
        from reqif.parser import ReqIFParser
    except ImportError:
        raise UnusableInputError(path, "needs reqif, expected 'pip install hilbench[reqif]'") from None
    if not path.is_file():
        raise UnusableInputError(path, "no such file, expected a specification (.reqif)")
    try:
        bundle = ReqIFParser.parse(str(path))
        found = {each.id: each for each in _requirements(bundle)}
    except Exception as error:  # the parser lets through whatever a broken file does to it
        raise UnusableInputError(path, f"is no specification ({one_line(error)}), expected ReqIF") from error
    return list(found.values())


def _requirements(bundle: Any) -> Iterator[Requirement]:
    content = bundle.core_content.req_if_content
    names = {
        definition.identifier: definition.long_name or definition.identifier
        for spec_type in content.spec_types or ()
        for definition in getattr(spec_type, "attribute_definitions", None) or ()
    }
    objects = {each.identifier: each for each in content.spec_objects or ()}
    order = [
        entry.spec_object
        for specification in content.specifications or ()
        for entry in bundle.iterate_specification_hierarchy(specification)
    ]
    for identifier in dict.fromkeys([*order, *objects]):
        if identifier in objects:
            yield from _requirement(objects[identifier], names)


def _requirement(found: Any, names: Mapping[str, str]) -> Iterator[Requirement]:
    """None of a heading."""
    values = {names.get(each.definition_ref, each.definition_ref): _as_text(each.value) for each in found.attributes}
    title = next((values[name] for name in _TITLES if values.get(name)), found.long_name or "")
    if values.get(_HEADING) and not any(values.get(name) for name in _TITLES):
        return
    known = next((values[name] for name in _IDS if values.get(name)), found.identifier)
    yield Requirement(known, title if len(title) <= _LONGEST_TITLE else f"{title[: _LONGEST_TITLE - 1]}…")


def _as_text(value: object) -> str:
    """Text without the markup of XHTML attributes."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", str(value))).split())
