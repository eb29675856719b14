"""Reference of a machine: the speed at which it runs, moved at a bounded rate where no ramp is given."""

from __future__ import annotations

from math import copysign
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, Reals, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.topology.sample import CycleSample

#: Cycles that a course is laid down for at once.
_LONGEST_COURSE = 256
#: Of a course: the value of the next cycle, and how many there are.
_PROGRESS = record_type("next", "end", of=np.int64)


class _Course(NamedTuple):
    present: Reals  #: (1,)
    course: Reals
    progress: Annotated[Any, _PROGRESS]


class _Shown(NamedTuple):
    present: Reals  #: (1,)
    values: Reals  #: of a sample


@entry_point(COUNT, TABLE)
def _follow(_: int, table: Wholes2) -> int:
    """Take the value of the next cycle."""
    a = arrays_in(table, _Course)
    if a.progress.next < a.progress.end:
        a.present[0] = a.course[a.progress.next]
        a.progress.next += 1
    return CONTINUE


@entry_point(COUNT, TABLE)
def _show(place: int, table: Wholes2) -> int:
    """Write the value into a sample."""
    a = arrays_in(table, _Shown)
    a.values[place] = a.present[0]
    return CONTINUE


class Reference:
    """A speed set point that is settable by one path, in the unit of the path per s; `step`: its largest change in a
    cycle when it is brought somewhere by the bench itself."""

    def __init__(self, path: str, step: float) -> None:
        self.path = path
        self.vector = np.zeros(1)  #: of the present value
        self._at = self.vector.data.cast("B").cast("d")  # faster access to one value
        self._course, self._progress = np.zeros(_LONGEST_COURSE), np.zeros(1, _PROGRESS)
        #: Compiled stage: follow the trajectory.
        self.piece = CompiledStage(_follow, 0, _Course(self.vector, self._course, self._progress), fallback=never)
        self._step = step
        self.goal: float | None = None  #: goal that it moves to by itself; None while it stays at its value
        self.ceiling: float | None = None
        self._held_back = False

    @property
    def present(self) -> float:
        """Present value."""
        return float(self._at[0])

    @present.setter
    def present(self, value: float) -> None:
        self._at[0] = value

    @staticmethod
    def warm_up_shown() -> None:
        """Compile, or load, the stage of `shown_in`, before a cycle has to wait for it."""
        load(_show)

    def shown_in(self, sample: CycleSample, signal: str) -> CompiledStage:
        """Compiled stage that writes the reference into a signal."""
        return CompiledStage(_show, type(sample).place(signal), _Shown(self.vector, sample.reals), fallback=never)

    def owns(self, path: str) -> bool:
        """True if the path is this reference's."""
        return path == self.path

    def value(self, path: str) -> float:
        """Present value."""
        return self.present

    def set(self, path: str, value: float) -> None:
        """Set a value at once, up to the ceiling; a goal under way is dropped."""
        if self.ceiling is not None:
            highest = max(self.ceiling, abs(self.present))
            if abs(value) > highest:
                value, self._held_back = copysign(highest, value), True
            elif self._held_back and abs(value) <= self.ceiling:
                self.ceiling = None
        self.present = value
        self.goal = None

    def load_trajectory(self, values: NDArray[np.float64]) -> int:
        """Load values for the next cycles, one per cycle that begins with `piece`; returns how many fit."""
        count = min(len(values), _LONGEST_COURSE)
        self._course[:count] = values[:count]
        self._progress[0] = 0, count
        return count

    def end_trajectory(self) -> int:
        """Keep the present value; returns the number of values of the trajectory that were used."""
        had = int(self._progress["next"][0])
        self._progress[0] = 0, 0
        return had

    def move_to(self, goal: float) -> None:
        """Go there by itself, step by step."""
        self.goal = goal

    def hold_below(self, ceiling: float) -> None:
        """Hold its size below `ceiling` from now on; what is above is reduced step by step (`keep_below`)."""
        self.ceiling, self._held_back = ceiling, False

    def keep_below(self) -> None:
        """Move one step towards the ceiling, where it is beyond."""
        if self.ceiling is not None and abs(self.present) > self.ceiling:
            self._held_back = True
            self.present = copysign(max(self.ceiling, abs(self.present) - self._step), self.present)

    def step_to(self, goal: float) -> tuple[float, bool]:
        """The value one step nearer to a goal, and whether that is the goal."""
        left = goal - self.present
        step = min(abs(left), self._step)
        return self.present + copysign(step, left), step >= abs(left)

    def slow_down(self) -> bool:
        """Move one step towards zero; true if it moved."""
        left = max(0.0, abs(self.present) - self._step)
        moved = self.present != 0.0
        self.present = copysign(left, self.present) if left else 0.0
        return moved
