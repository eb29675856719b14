"""The bench of a config file, as a script, a notebook or a test uses it."""

from __future__ import annotations

import atexit
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Self

from hilbench.bench import bench, quantities
from hilbench.bench.bench import InterruptedByOperatorError
from hilbench.bench.check import check_bench
from hilbench.bench.in_process import check_in_process
from hilbench.bench.participants import Participants
from hilbench.experiment.config import load_with_overrides
from hilbench.experiment.events import EventLog
from hilbench.experiment.metrics import Judgement, judge
from hilbench.record.recording import Recording
from hilbench.record.run import Recorder


@dataclass(frozen=True)
class StepResponse:
    """What a step change did: the whole recording, when the step was (s of experiment time), and the metrics.

    Metrics are those of `hilbench.experiment.metrics.METRICS` that a recording decides, of this step alone; None for
    what it does not show, `not_judged` says why.
    """

    recording: Recording
    step_time_s: float
    metrics: dict[str, float | None]
    not_judged: dict[str, str] = field(default_factory=dict)


class Bench(bench.Bench):
    """A bench from its config file that keeps what it measured.

    Use it as a context manager; what it can do is in `hilbench.bench.bench.Bench`::

        with Bench("bench_configs/web_section_step.yaml", changes=["tension_control.set_point_N=90"]) as bench:
            bench.ramp("line_speed_m_s", 3.0, duration_s=4.0)
            bench.run(2.0)
        bench.recording.to_pandas()[["F_true_N", "F_sim_N"]].plot()

    `bus`, `pace`, `seed` and `changes` (texts ``KEY=VALUE``) are what ``hilbench run`` takes. Raises UnusableInputError
    for a config that cannot be used, before anything is started; entering raises it for a bus that has another master
    (`force`: unless it was only heard). Steps and criteria of the file are left alone.
    """

    def __init__(
        self,
        config: str | PathLike[str],
        *,
        bus: str | None = None,
        pace: str | None = None,
        seed: int | None = None,
        changes: Sequence[str] = (),
        participants: Participants = Participants.STARTED,
        announce: Callable[[str], None] = lambda text: None,
        force: bool = False,
    ) -> None:
        loaded = load_with_overrides(Path(config), bus=bus, pace=pace, seed=seed, changes=changes)
        check_bench(loaded.config, loaded.document)
        if participants is Participants.IN_PROCESS:
            check_in_process(loaded.config)
        self._recorder = Recorder()
        self._made = datetime.now(UTC)
        self._happened = EventLog(loaded.config.cycle_time_s)
        super().__init__(
            loaded.config,
            observers=[self._recorder],
            participants=participants,
            announce=announce,
            journal=self._happened.add,
            may_idle=True,
            force=force,
        )

    def __enter__(self) -> Self:
        super().__enter__()
        atexit.register(self._leave_forgotten)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        atexit.unregister(self._leave_forgotten)
        super().__exit__(kind, error, trace)

    def _leave_forgotten(self) -> None:
        """The program ends, and the bench still runs."""
        name = f"the bench '{self.config.name}'"
        print(f"hilbench: {name} was never left, and is stopped now; expected 'with Bench(…)'", file=sys.stderr)
        self.__exit__(InterruptedByOperatorError, InterruptedByOperatorError("the program has ended"), None)

    @property
    def recording(self) -> Recording:
        """What was measured until now, one row a cycle, as a copy."""
        return self._recorder.recording(self._made, self.config.description)

    def judge(self) -> Judgement:
        """Every step until now with its figures (`hilbench.experiment.metrics`)."""
        return judge(self.recording.channels, journal=self._happened.events())

    def metrics(self) -> dict[str, float | None]:
        """The metrics that the recording shows until now, of several steps the worst."""
        return self.judge().metrics()

    def step_response(
        self,
        path: str,
        to: float,
        *,
        line_speed_m_s: float = 3.0,
        ramp_s: float = 2.0,
        settle_s: float = 2.0,
        hold_s: float = 3.0,
    ) -> StepResponse:
        """Bring the line to its speed, let it settle, step a quantity, hold, and say what that did.

        Raises UnusableValueError for what can't be done, before anything moves.
        """
        to = quantities.checked_value(quantities.checked_path(path), to)
        quantities.checked_value(quantities.LINE_SPEED, line_speed_m_s)
        for name, given in (("ramp_s", ramp_s), ("settle_s", settle_s), ("hold_s", hold_s)):
            quantities.checked_duration_s(name, given, above_zero=name == "ramp_s")
        self.ramp(quantities.LINE_SPEED, line_speed_m_s, ramp_s)
        self.run(settle_s)
        self.step(path, to)
        step_time_s = self.events[-1].time_s
        self.run(hold_s)
        judged = self.judge()
        last = Judgement(judged.steps[-1:], judged.events)
        return StepResponse(self.recording, step_time_s, last.metrics(), last.not_judged())
