"""Rate of late answers to SYNC of each participant, whose last sample was held for longer than a cycle.

In real time an answer missing shortly before the next SYNC is not waited for. A little of that is ridden out (the
load model and the controllers know the age of a sample), more is a disturbance of its own: the emulated web is a
stiff spring, and an additional cycle of dead time in it is negative damping.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Time over which the present share is counted, and the share from which on it may be the cause of a fault.
_WINDOW_S = 1.0
TROUBLE = 0.05


@dataclass(slots=True)
class Lateness:
    """Lateness of one participant: cycles with a late answer, oldest answer in cycles, recent share of late ones."""

    late: int = 0
    oldest_cycles: int = 0
    lately: float = 0.0


class Timeliness:
    """Counts the cycles of an experiment, and in how many of them each participant was late."""

    def __init__(self, names: tuple[str, ...], cycle_s: float) -> None:
        self.cycles = 0
        self.of = {name: Lateness() for name in names}
        self._weight = min(1.0, cycle_s / _WINDOW_S)
        self._late_lately = False  # of any participant: most runs have nothing to count

    def update(self, ages_cycles: tuple[int, ...]) -> None:
        """Take the ages of the answers in use in a cycle, in the order of the names; 0: in time."""
        self.cycles += 1
        if not self._late_lately and not any(ages_cycles):
            return
        self._late_lately = True
        for lateness, age in zip(self.of.values(), ages_cycles, strict=True):
            if age:
                lateness.late += 1
                lateness.oldest_cycles = max(lateness.oldest_cycles, age)
            if age or lateness.lately:
                lateness.lately += self._weight * ((age > 0) - lateness.lately)

    def pass_on_time(self, cycles: int) -> None:
        """Count `cycles` cycles in which no participant was late."""
        self.cycles += cycles
        if not self._late_lately:
            return
        for lateness in self.of.values():
            for _ in range(cycles if lateness.lately else 0):
                lateness.lately += self._weight * (0 - lateness.lately)

    def trouble(self) -> str:
        """Text naming participants late so often that it may cause other trouble; "" if none."""
        if not self._late_lately:
            return ""
        late = [(name, each.lately) for name, each in self.of.items() if each.lately > TROUBLE]
        return ", ".join(f"{100 * share:.0f} % late samples of {name}" for name, share in late)
