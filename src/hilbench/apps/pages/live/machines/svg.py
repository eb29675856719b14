"""SVG of a drawing that moves: texts that show signals, groups that show the state of a part."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

_TEXT_PX = 13


def circle(x: float, y: float, r: float, kind: str) -> str:
    """`kind`: its class in the page's style sheet."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}" class="{kind}"/>'


def text(x: float, y: float, words: str, kind: str = "", anchor: str = "middle") -> str:
    """Words that stay."""
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">{escape(words)}</text>'


def value(x: float, y: float, signal: str, unit: str, *, kind: str = "", per: float = 1.0, before: str = "") -> str:
    """The value of a signal, in a unit of `per` SI units, with words before it."""
    said = {"signal": signal, "unit": unit, "per": f"{per:g}", "before": before}
    data = " ".join(f'data-{key}="{escape(words)}"' for key, words in said.items())
    return f'<text x="{x:.1f}" y="{y:.1f}" class="value {kind}" text-anchor="middle" {data}>{escape(before)}–</text>'


def part(name: str, shapes: Iterable[str]) -> str:
    """Group of shapes of a part of the bench, which shows its state."""
    return f'<g data-part="{escape(name)}">{"".join(shapes)}</g>'


def line(points: Iterable[tuple[float, float]], kind: str) -> str:
    """A polygonal line."""
    return f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}" class="{kind}"/>'


def picture(width: float, height: float, title: str, shapes: Iterable[str]) -> str:
    """SVG element of these shapes, as wide as it is drawn where there is room."""
    size = f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" font-size="{_TEXT_PX}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="{escape(title)}">'
    return f"{head}{''.join(shapes)}</svg>"
