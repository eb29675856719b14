"""Active alarms of the twin: each begins at once, and ends when its condition has been absent for a while."""

from __future__ import annotations

from hilbench.estimation.problems import Problem

#: Time for which a condition has to be absent for its alarm to end.
_QUIET_S = 0.5


class Alarms:
    """One alarm for each problem; an intermittent condition is one alarm."""

    def __init__(self, cycle_s: float) -> None:
        self.set_cycle_time(cycle_s)
        self._left: dict[Problem, int] = {}

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time."""
        self._quiet_cycles = max(1, round(_QUIET_S / cycle_s))

    def reset(self) -> None:
        """Forget active alarms."""
        self._left.clear()

    @property
    def idle(self) -> bool:
        """True if no alarm is active."""
        return not self._left

    def update(self, problem: Problem | None) -> tuple[list[Problem], list[Problem]]:
        """Take this cycle's problem; returns the alarms that begin and those that end."""
        begun = [problem] if problem is not None and problem not in self._left else []
        for known in self._left:
            self._left[known] -= 1
        if problem is not None:
            self._left[problem] = self._quiet_cycles
        ended = [known for known, cycles in self._left.items() if cycles <= 0]
        for known in ended:
            del self._left[known]
        return begun, ended
