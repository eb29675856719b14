"""Reels of measured radius: their speeds follow the radius of the web on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from hilbench.bench.tasks.task import CompiledStages, StagedTask
from hilbench.bench.tasks.tension_task import AxisTask
from hilbench.cycle_program import python_stage
from hilbench.topology.sample import CycleSample


@dataclass(frozen=True, slots=True)
class MeasuredReel:
    """A reel with a sensor of its radius: its drive, its axis, the sensor's signal, and the radius in m by which its
    position and speed are counted, that at the start."""

    drive: str
    axis: int
    signal: str
    counted_m: float

    def ratio(self, sample: CycleSample) -> float:
        """Radius over that by which it is counted; 1 while the sensor has reported nothing."""
        radius_m: float = getattr(sample, self.signal)
        return radius_m / self.counted_m if radius_m > 0.0 else 1.0


class ReelSpeeds(StagedTask):
    """Scales the reels' speeds so that the web on them has the speed that was commanded.

    `line_speed`: signal of the speed of the leading axis at the web, "" where only its command is needed.
    """

    def __init__(self, reels: Sequence[MeasuredReel], leader: AxisTask, line_speed: str) -> None:
        self._reels = [(reel, f"v{reel.axis}_cmd_m_s") for reel in reels]
        self._leader = leader
        self._line_speed = line_speed

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Python's stage that commands the reels."""
        shown = {reel.drive: command for reel, command in self._reels}
        return CompiledStages(before=[python_stage(partial(self._command, sample))], shown=shown)

    def _command(self, sample: CycleSample) -> None:
        """Command the reels, m/s at the radius that they had at the start."""
        if self._line_speed:
            setattr(sample, self._line_speed, self._leader.speed_m_s)
        for reel, command in self._reels:
            setattr(sample, command, getattr(sample, command) / reel.ratio(sample))


class ReelTravel:
    """Travel of the web at a reel, m, from cycle to cycle by its radius."""

    def __init__(self, reel: MeasuredReel) -> None:
        self._reel = reel
        self._position = f"x{reel.axis}_m"
        self._at_m: float | None = None
        self._travel_m = 0.0

    def __call__(self, sample: CycleSample) -> float:
        """Travel up to the last sample."""
        position_m: float = getattr(sample, self._position)
        if self._at_m is not None:
            self._travel_m += (position_m - self._at_m) * self._reel.ratio(sample)
        self._at_m = position_m
        return self._travel_m
