"""What a tool has measured, in its place on a page of the docs: between the lines `<!-- NAME: begin -->` and `end`."""

from __future__ import annotations

from pathlib import Path


def between(page: Path, name: str) -> str:
    """What stands there. Raises ValueError when the page lacks the lines."""
    return _parts(page, name)[1].strip("\n")


def put(page: Path, name: str, text: str) -> None:
    """Put `text` there. Raises ValueError when the page lacks the lines."""
    before, _, after = _parts(page, name)
    page.write_text(f"{before}\n{text}\n{after}", encoding="utf-8")


def _parts(page: Path, name: str) -> tuple[str, str, str]:
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    there, found_end, after = rest.partition(end)
    if not found or not found_end:
        raise ValueError(f"{page}: expected the lines '{begin}' and '{end}'")
    return before + begin, there, end + after
