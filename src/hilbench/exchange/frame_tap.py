"""Who sees every frame of a bench's bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from hilbench.can.frame import Frame


class FrameTap(Protocol):
    """Sees every frame of the bus in the order of the wire; each has its time (ns since the epoch)."""

    def write(self, frames: Sequence[Frame]) -> None:
        """Frames that went over the bus."""

    def end_cycle(self) -> None:
        """The frames of a cycle are complete."""


@runtime_checkable
class LineTap(FrameTap, Protocol):
    """One that takes text, too, in candump's log format."""

    def head(self, can_id: int) -> str:
        """What stands between time and data in the lines of an identifier."""

    def write_lines(self, text: str, frames: int) -> None:
        """Whole lines of so many frames that went over the bus."""
