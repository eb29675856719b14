"""A page as a browser would take it apart."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

#: A name that would run if a page took it for markup.
EVIL = "<script>alert('1')</script> & \"x\""


class ParsedPage(HTMLParser):
    """Collects tags, addresses, identifiers and text; checks that every element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.identifiers: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self.open_elements: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "br", "input"):
            self.open_elements.append(tag)
        self.handle_attributes(attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.handle_attributes(attrs)

    def handle_attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action"):
                self.addresses.append(value or "")
            if name == "id":
                self.identifiers.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open_elements.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open_elements and self.open_elements[-1] == "script":
            self.scripts.append(data)
        elif not self.open_elements or self.open_elements[-1] != "style":
            self.text += data


def parsed(path: Path) -> ParsedPage:
    page = ParsedPage()
    page.feed(path.read_text(encoding="utf-8"))
    assert not page.open_elements
    return page
