"""The set-point of a task that has one."""

from __future__ import annotations


class OneSetPoint:
    """Settable quantity of a task with one set-point, at this path; see `task.SettableQuantity`."""

    def __init__(self, path: str, value: float) -> None:
        self._path, self._set_point = path, value

    def owns(self, path: str) -> bool:
        """True if the path is the set-point's."""
        return path == self._path

    def value(self, path: str) -> float:
        """The set-point."""
        return self._set_point

    def set(self, path: str, value: float) -> None:
        """Another set-point."""
        self._set_point = value
