"""Which alarms of the twin are on: each begins at once, and ends when its condition has stayed away for a while."""

from __future__ import annotations

from hilbench.estimation.problems import Problem

#: How long a condition has to stay away for its alarm to end.
_QUIET_S = 0.5


class Alarms:
    """One alarm for each problem; a condition that comes and goes is one alarm."""

    def __init__(self, cycle_s: float) -> None:
        self.set_cycle_time(cycle_s)
        self._left: dict[Problem, int] = {}

    def set_cycle_time(self, cycle_s: float) -> None:
        """A cycle is so long from now on."""
        self._quiet_cycles = max(1, round(_QUIET_S / cycle_s))

    def reset(self) -> None:
        """Forget what was on."""
        self._left.clear()

    @property
    def idle(self) -> bool:
        """Whether none is on."""
        return not self._left

    def update(self, problem: Problem | None) -> tuple[list[Problem], list[Problem]]:
        """Take what is wrong in this cycle; the alarms that begin and those that end with it."""
        begun = [problem] if problem is not None and problem not in self._left else []
        for known in self._left:
            self._left[known] -= 1
        if problem is not None:
            self._left[problem] = self._quiet_cycles
        ended = [known for known, cycles in self._left.items() if cycles <= 0]
        for known in ended:
            del self._left[known]
        return begun, ended
