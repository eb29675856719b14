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
        self._ceiling: float | None = None
        self._held_back = False

    def owns(self, path: str) -> bool:
        """Whether it is this reference."""
        return path == self.path

    def value(self, path: str) -> float:
        """Present value."""
        return self.present

    def set(self, path: str, value: float) -> None:
        """Another value at once, as far as it is not held back; a goal that it was on the way to is forgotten."""
        if self._ceiling is not None:
            highest = max(self._ceiling, abs(self.present))
            if abs(value) > highest:
                value, self._held_back = copysign(highest, value), True
            elif self._held_back and abs(value) <= self._ceiling:
                self._ceiling = None
        self.present = value
        self._goal = None

    @property
    def goal(self) -> float | None:
        """Where it goes by itself; None while it stays what it was set to."""
        return self._goal

    def head_for(self, goal: float) -> None:
        """Go there by itself, step by step."""
        self._goal = goal

    @property
    def ceiling(self) -> float | None:
        """The size that it is held to, whoever asks for more; None while it is not, and once less was asked for after
        more."""
        return self._ceiling

    def hold_below(self, ceiling: float) -> None:
        """No more than this from now on, as a size; what it is beyond that it loses step by step (`keep_below`)."""
        self._ceiling, self._held_back = ceiling, False

    def keep_below(self) -> None:
        """One step towards what it is held to, where it is beyond."""
        if self._ceiling is not None and abs(self.present) > self._ceiling:
            self._held_back = True
            self.present = copysign(max(self._ceiling, abs(self.present) - self._step), self.present)

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
