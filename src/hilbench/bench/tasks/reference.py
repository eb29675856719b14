"""The reference of a machine: the speed at which it runs, moved at a bounded rate where nobody gives a ramp."""

from __future__ import annotations

from math import copysign


class Reference:
    """A speed set point that is settable by one path, in the unit of the path per s; `step`: its largest change in a
    cycle when it is brought somewhere by the bench itself."""

    def __init__(self, path: str, step: float) -> None:
        self.path = path
        self.present = 0.0
        self._step = step
        self._goal: float | None = None

    def owns(self, path: str) -> bool:
        """Whether it is this reference."""
        return path == self.path

    def value(self, path: str) -> float:
        """Present value."""
        return self.present

    def set(self, path: str, value: float) -> None:
        """Another value at once; a goal that it was on the way to is forgotten."""
        self.present = value
        self._goal = None

    @property
    def goal(self) -> float | None:
        """Where it goes by itself; None while it stays what it was set to."""
        return self._goal

    def head_for(self, goal: float) -> None:
        """Go there by itself, step by step."""
        self._goal = goal

    def step_to(self, goal: float) -> tuple[float, bool]:
        """The value one step nearer to a goal, and whether that is the goal."""
        left = goal - self.present
        step = min(abs(left), self._step)
        return self.present + copysign(step, left), step >= abs(left)

    def slow_down(self) -> bool:
        """One step towards zero; whether it was any."""
        left = max(0.0, abs(self.present) - self._step)
        moved = self.present != 0.0
        self.present = copysign(left, self.present) if left else 0.0
        return moved
