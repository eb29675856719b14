"""Interface of receivers of every frame on a bench's bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from hilbench.can.frame import Frame


class FrameTap(Protocol):
    """Sees every frame of the bus in the order of the wire; each has its time (ns since the epoch)."""

    def write(self, frames: Sequence[Frame]) -> None:
        """Take frames that went over the bus."""

    def end_cycle(self) -> None:
        """The frames of a cycle are complete."""


@runtime_checkable
class LineTap(FrameTap, Protocol):
    """Frame tap that also takes text in candump's log format."""

    def head(self, can_id: int) -> str:
        """Text between time and data in the log lines of an identifier."""

    def write_lines(self, text: str, frames: int) -> None:
        """Take whole log lines of `frames` frames that went over the bus."""
