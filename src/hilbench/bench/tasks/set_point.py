"""The set-point of a task that has one."""

from __future__ import annotations


class OneSetPoint:
    """What can be set of a task: the quantity of this path; see `task.SettableQuantity`."""

    def __init__(self, path: str, value: float) -> None:
        self._path, self._set_point = path, value

    def owns(self, path: str) -> bool:
        """Whether it is the set-point."""
        return path == self._path

    def value(self, path: str) -> float:
        """The set-point."""
        return self._set_point

    def set(self, path: str, value: float) -> None:
        """Another set-point."""
        self._set_point = value
