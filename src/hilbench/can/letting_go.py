"""A python-can bus of which a thread that waits in `recv` can be let go."""

from __future__ import annotations

from abc import abstractmethod

from hilbench.can.python_can import can


class LetsGo(can.BusABC):
    """Its `recv` ends when it is told to, not when its time is over."""

    _receives = True

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; None where none comes within `timeout` s (None: wait for one)."""
        try:
            return super().recv(timeout)
        except can.CanOperationError:
            if self._receives:
                raise
            return None

    def end_receiving(self) -> None:
        """From now on `recv` returns None at once, also where somebody waits in it."""
        self._receives = False
        self._wake()

    @abstractmethod
    def _wake(self) -> None:
        """Have whoever waits get an error."""
