"""Requirements of a specification in ReqIF (OMG Requirements Interchange Format 1.2), as DOORS, Polarion, StrictDoc and
others write it."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from hilbench.apps.library.matrix import Requirement
from hilbench.errors import UnusableInputError

#: Attributes in which tools keep the id that people use, and the title; the first that is there (ReqIF implementation
#: guide of prostep ivip, system attributes).
_IDS: Final = ("ReqIF.ForeignID", "ReqIF.ForeignId", "UID", "ID")
_TITLES: Final = ("ReqIF.Name", "TITLE", "Title", "ReqIF.Text", "STATEMENT")
_HEADING: Final = "ReqIF.ChapterName"
_LONGEST_TITLE: Final = 120


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
        raise UnusableInputError(
            path, f"is no specification ({' '.join(str(error).split()) or type(error).__name__}), expected ReqIF"
        ) from error
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
