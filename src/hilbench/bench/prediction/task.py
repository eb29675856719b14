"""Prediction task: looks ahead at fixed cycles, from the present state, without delaying a cycle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from operator import attrgetter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.prediction.announcements import Announcement, Announcements
from hilbench.bench.prediction.window import Hindsight, Reading, Window
from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.limits import Limited
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import Inputs
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.futures import Futures, Prepared
from hilbench.prediction.outlook import Crossing, Outlook, WatchedQuantity
from hilbench.prediction.plan import Asked, Move
from hilbench.real_time import leave_the_cycle
from hilbench.topology.sample import CycleSample

#: What the highest speed to come is brought to, as a share of itself, with each look that still sees a limit crossed.
_LOWER = 0.9
#: Key that separates the random draws of an extra look from those of the regular one of a cycle.
_BESIDES = 1
#: Of the horizon, to find that speed.
_POINTS = 200


class PredictedLimitError(BenchFaultError):
    """A quantity is going to go beyond its trip level."""


class Look(ABC):
    """Prediction of a kind of machine from the samples of one run; `watched`: what is `limited`."""

    signals: tuple[str, ...]  #: needed for a look
    unready: str  #: message where the present state is not known
    futures: Futures[Any, Any]

    def __init__(self, limited: Sequence[Limited]) -> None:
        self.watched = tuple(
            WatchedQuantity(each.name, each.signal, each.unit, each.limit.warning, each.limit.trip) for each in limited
        )
        #: Those that are measured without the model, and so are compared with what was predicted.
        self._compared = np.array([k for k, each in enumerate(self.watched) if each.unit == "N·m"])

    def warm_up(self) -> None:
        """Compile, or load, what a look runs."""
        self.futures.warm_up()

    @abstractmethod
    def ready(self, sample: CycleSample) -> bool:
        """True if the present state is known well enough."""

    def moves_of(self, move: Move) -> tuple[Move, ...]:
        """Moves of single quantities that a move consists of."""
        return (move,)

    def _measured(self, reading: Reading) -> NDArray[np.float64]:
        """Present values of what is compared, 0 of the others."""
        measured = np.zeros(len(self.watched))
        measured[self._compared] = reading.fitted(*(self.watched[k].signal for k in self._compared))
        return measured

    @abstractmethod
    def prepare(self, now_s: float, window: Window, hindsight: Hindsight, asked: Asked, *key: int) -> Prepared:
        """Two parts of a look ahead: a long one that lets other threads run, and one that returns its outlook."""


def expected(crossing: Crossing, now_s: float) -> str:
    """Text of an expected crossing, in one line for an operator."""
    when = f"in {max(crossing.expected_s - now_s, 0.0):.1f} s"
    if crossing.latest_s - crossing.earliest_s >= 0.1:
        earliest, latest = (max(each - now_s, 0.0) for each in (crossing.earliest_s, crossing.latest_s))
        when += f" ({earliest:.1f} to {latest:.1f} s)"
    return f"{crossing} {when}, probability {100 * crossing.probability:.0f} %"


class Prediction(CyclicTask):
    """Looks ahead in one run; `asked` returns present values and planned moves.

    In lockstep a look is over in its own cycle. In real time it runs in a thread of its own in parallel, with no
    more than a normal process' share of the machine, and its outlook counts from the cycle in which it is ready; a look
    that takes longer than the time to the next leaves that one out.
    """

    def __init__(
        self,
        look: Look,
        config: PredictionConfig,
        state: BenchState,
        asked: Callable[[], Asked],
        *,
        seed: int,
        lockstep: bool,
        on_predicted_limit: Literal["warn", "stop", "slow_down"],
        reference: Reference,
    ) -> None:
        self.announcements = Announcements(look.watched, config.announce_above)
        self.outlook: Outlook | None = None  #: the last one
        self.looks = self.left_out = 0
        self._look, self._config, self._state, self._asked = look, config, state, asked
        self.warm_up = look.warm_up
        self._seed, self._on_predicted_limit = seed, on_predicted_limit
        self._reference, self._slows_down = reference, False
        self._every = max(1, round(config.every_s / state.cycle_s))
        self._window, self._hindsight = Window(look.signals), Hindsight(len(look.watched))
        self._values = attrgetter(*(watched.signal for watched in look.watched))
        self._pool = None if lockstep else ThreadPoolExecutor(1, "prediction", initializer=leave_the_cycle)
        self._running: tuple[Future[None], Callable[[], Outlook]] | None = None
        self._is_asked = False  # an extra look is under way

    def close(self) -> None:
        """A look that still runs is of no use any more."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Keep the reference where it is held."""
        self._reference.keep_below()

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Take this cycle in; look ahead when it is time. Raises PredictedLimitError where the bench is to stop."""
        self.announcements.see(sample.t_s, self._values(sample))
        if not (self._state.twin.fresh(sample) and self._look.ready(sample)):
            self._window.clear()
            self._hindsight.clear()
            return
        self._window.add(sample)
        if self._running is not None and self._running[0].done():
            (run, outlook), self._running = self._running, None
            run.result()
            self._take(sample, outlook())
        if sample.cycle % self._every == 0 and self._window.full:
            self._begin(sample)

    def refuse_if_predicted(
        self, path: str, to: float, duration_s: float, above: float, cycle: Callable[[], object]
    ) -> None:
        """Refuse a move that is predicted to trip a limit (`Bench.refuse_if_predicted`)."""
        sample = self._state.sample
        step = f"{path} to {to:.6g}"
        while self._running is not None:
            cycle()
        if not self._window.full:
            raise BenchFaultError(f"t = {sample.t_s:.3f} s: {step} can't be checked: {self._look.unready}")
        asked = self._asked()
        plan = asked.plan.with_moves(self._look.moves_of(Move(path, sample.t_s, sample.t_s + duration_s, to)))
        outlook = self._looked(replace(asked, plan=plan), sample, cycle)
        trips = [each for each in outlook.crossings() if each.level == "trip" and each.probability > above]
        if trips:
            worst = max(trips, key=lambda each: each.probability)
            raise PredictedLimitError(
                f"t = {outlook.now_s:.3f} s: {step} is refused: {expected(worst, outlook.now_s)}, "
                f"expected at most {100 * above:g} %"
            )

    def _looked(self, asked: Asked, sample: CycleSample, cycle: Callable[[], object]) -> Outlook:
        """Outlook of an extra look; where it must not hold up a cycle, cycles run meanwhile."""
        run, outlook = self._look.prepare(
            sample.t_s, self._window, self._hindsight, asked, self._seed, sample.cycle, _BESIDES
        )
        if self._pool is None:
            run()
            return outlook()
        self._is_asked = True
        try:
            done = self._pool.submit(run)
            while not done.done():
                cycle()
            done.result()
        finally:
            self._is_asked = False
        return outlook()

    def _begin(self, sample: CycleSample) -> None:
        if self._running is not None or self._is_asked:
            self.left_out += 1
            return
        run, outlook = self._look.prepare(
            sample.t_s, self._window, self._hindsight, self._asked(), self._seed, sample.cycle
        )
        if self._pool is not None:
            self._running = self._pool.submit(run), outlook
            return
        run()
        self._take(sample, outlook())

    def _take(self, sample: CycleSample, outlook: Outlook) -> None:
        self.looks += 1
        self.outlook = outlook
        self._hindsight.expect(outlook)
        crossings = list(outlook.crossings())
        for announcement in self.announcements.update(sample.t_s, crossings):
            self._announce(sample, announcement)
        self._act(sample, [each for each in crossings if each.level == "trip"])

    def _act(self, sample: CycleSample, trips: Sequence[Crossing]) -> None:
        """Stop or slow down if a trip is predicted."""
        config, now_s = self._config, sample.t_s
        slowed, self._slows_down = self._slows_down, False
        likely = [each for each in trips if each.probability >= config.act_above]
        if self._on_predicted_limit == "stop" and likely:
            first = min(likely, key=lambda each: each.expected_s)
            self.announcements.acted(likely, "stopped")
            raise PredictedLimitError(f"t = {now_s:.3f} s: predicted: {expected(first, now_s)}")
        if self._on_predicted_limit == "slow_down":
            still = [each for each in trips if each.probability >= config.announce_above] if slowed else likely
            self.announcements.acted(still, "slowed down")
            self._slows_down = bool(still)
            if still:
                self._reference.hold_below(_LOWER * self._highest(now_s))
            elif slowed and self._reference.ceiling is not None:
                text = f"{self._reference.path} is held below {self._reference.ceiling:.4g}"
                self._state.reports.note("prediction", text, kind="held")

    def _highest(self, now_s: float) -> float:
        """Largest size of the reference within the horizon."""
        path, asked = self._reference.path, self._asked()
        times_s = now_s + np.linspace(0.0, self._config.horizon_s, _POINTS)
        return float(np.max(np.abs(asked.course(path, self._reference.present, now_s, times_s))))

    def _announce(self, sample: CycleSample, announcement: Announcement) -> None:
        crossing = announcement.crossing
        kind = f"{crossing.watched.signal} {crossing.level}"
        self._state.reports.note("prediction", expected(crossing, sample.t_s), kind=kind)
        cycle = self._state.running().timing.cycles
        self._state.journal(Change(cycle, "predicted", crossing.watched.signal, crossing.limit, crossing.probability))
