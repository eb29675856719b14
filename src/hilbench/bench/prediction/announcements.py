"""Predicted and actual limit crossings of a run: those that were announced, or should have been."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from hilbench.prediction.outlook import LEVELS, Crossing, Level, WatchedQuantity

#: An announcement is over when its probability has fallen below this share of that from which it is made.
_RELEASE: Final = 0.5
#: Action on a crossing that was announced only.
ANNOUNCED: Final = "announced"


@dataclass(slots=True)
class Announcement:
    """A crossing announced at `t_s` (experiment time), with its data then; `crossed_s`: when it came."""

    t_s: float
    crossing: Crossing
    action: str  #: action of the bench
    withdrawn_s: float | None = None  #: when it was not expected any more
    crossed_s: float | None = None


@dataclass(slots=True)
class Unannounced:
    """A crossing without an announcement."""

    t_s: float
    watched: WatchedQuantity
    level: Level


class Announcements:
    """Announcements and missed crossings of one run."""

    def __init__(self, watched: Sequence[WatchedQuantity], above: float) -> None:
        self.made: list[Announcement] = []
        self.missed: list[Unannounced] = []
        self._above = above
        self._open: dict[tuple[str, Level], Announcement] = {}
        self._beyond: set[tuple[str, Level]] = set()
        self._levels = [
            (place, watched, level, limit)
            for place, watched in enumerate(watched)
            for level in LEVELS
            if (limit := watched.level(level)) is not None
        ]

    def update(self, now_s: float, crossings: Iterable[Crossing]) -> Iterator[Announcement]:
        """New announcements by the crossings that are expected now; the others are withdrawn."""
        likely = {(each.watched.signal, each.level): each for each in crossings}
        for key, each in likely.items():
            if each.probability >= self._above and key not in self._open and key not in self._beyond:
                self._open[key] = announcement = Announcement(now_s, each, ANNOUNCED)
                self.made.append(announcement)
                yield announcement
        for key, announcement in list(self._open.items()):
            now = likely.get(key)
            if now is None or now.probability < _RELEASE * self._above:
                announcement.withdrawn_s = now_s
                del self._open[key]

    def acted(self, crossings: Iterable[Crossing], action: str) -> None:
        """The bench did something about these."""
        for each in crossings:
            announcement = self._open.get((each.watched.signal, each.level))
            if announcement is not None:
                announcement.action = action

    def metrics(self) -> dict[str, float | None]:
        """Metrics of the run until now, by their names in criteria."""
        came = [each.crossed_s - each.t_s for each in self.made if each.crossed_s is not None]
        in_vain = [each for each in self.made if each.crossed_s is None and each.action == ANNOUNCED]
        return {
            "limits_predicted": float(len(came)),
            "limits_not_predicted": float(len(self.missed)),
            "limits_predicted_in_vain": float(len(in_vain)),
            "prediction_lead_s": min(came, default=None),
        }

    def see(self, now_s: float, values: Sequence[float]) -> None:
        """Compare the measured values of a cycle, by quantity, with their limits."""
        for place, watched, level, limit in self._levels:
            key = watched.signal, level
            size = abs(values[place])
            if size <= limit:
                if key in self._beyond and size < 0.95 * limit:
                    self._beyond.discard(key)
            elif key not in self._beyond:
                self._beyond.add(key)
                announcement = self._open.pop(key, None)
                if announcement is None:
                    self.missed.append(Unannounced(now_s, watched, level))
                else:
                    announcement.crossed_s = now_s
