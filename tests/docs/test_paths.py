"""The files that the docs name are there, so that a newcomer who follows them arrives."""

from __future__ import annotations

import re

import pytest
from tests.docs.shown import PAGES, ROOT

#: A path of this project in inline code: with a folder, and of a kind that is kept in it.
_PATH = re.compile(r"`((?:[\w.*-]+/)+[\w.*-]*\.(?:py|yaml|eds|js|css|md|json|toml))`")
#: Names that stand for the reader's own.
_PLACEHOLDERS = re.compile(r"NAME|RUN|my_|^(runs|found|comparison|folder|left|build|stands?)/")
_BELOW = (ROOT, ROOT / "src" / "hilbench", ROOT / "docs")


def named() -> list[tuple[str, str]]:
    found = {
        (str(page.relative_to(ROOT)), path)
        for page in PAGES
        for path in _PATH.findall(page.read_text(encoding="utf-8"))
        if not _PLACEHOLDERS.search(path)
    }
    return sorted(found)


@pytest.mark.parametrize(("page", "path"), named(), ids=lambda value: value)
def test_a_file_that_a_page_names_is_there(page: str, path: str) -> None:
    assert any(list(folder.glob(path)) for folder in _BELOW), f"{page} names {path}"
