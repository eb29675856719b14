"""Shifts of a bench in one process: hours that are scored as they pass, without a recording.

    outcome = run_shift(MACHINES["web_section_step"], hours=8.0)

The model is right: nothing is hidden but the noise of the simulated sensors. A shift goes round and round by
`Operation.round`, which has everything in it that happens to such a machine; what is drawn comes from a seed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.estimation.shift_score import (
    AFTER_STEP_S,
    MOVES_M_S,
    STEP_N,
    EstimateScore,
    Mask,
    TensionScore,
    behind,
    shares_of_steps,
)

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import BenchFaultError
from hilbench.results.recording_builder import RecordingBuilder
from hilbench.runs.config import ExperimentConfig, load_with_overrides
from hilbench.topology.signals import Shape

Array = NDArray[np.float64]
Channels = Mapping[str, Array]

CONFIGS = Path(__file__).parents[2] / "bench_configs"
E_PATH, SPEED_PATH, INERTIA_PATH = "load.web.youngs_modulus_Pa", "line_speed_m_s", "load.shaft.inertia_kg_m2"
#: E stays between these factors on that of the config; sizes of its steps, drawn evenly by their logarithm.
LOWEST, HIGHEST, LEAST_STEP, LARGEST_STEP = 0.65, 1.5, 0.03, 0.4
#: E drifts all the time by 6 % an hour, there and back again each hour, and now and then by 1 % a minute, 1/s.
SLOW_DRIFT_PER_S, DRIFT_PER_S = 0.06 / 3600.0, 0.01 / 60.0
#: A drift is made of steps each so many seconds: 2e-5 at most, which is none to who scores (`STEP_SHARE`).
DRIFT_EVERY_S = 0.1
#: Once an hour the line is at rest for so long, and a splice comes in: a piece of so much web of other E.
LONG_STOP_S, SPLICE_M, SPLICE_CHANGE, HOUR_S = 1800.0, 200.0, -0.15, 3600.0
#: When a line starts its web has the strain upstream: the tension counts once it has been so near to its set-point (N),
#: well within what is judged, for as long as a step is left out, or from that time on (s).
ARRIVES_N, ARRIVES_BY_S = 0.5, 10.0
#: The one step of E of a hold.
HOLD_STEP = 0.207
#: Rows that are scored at once.
_ROWS = 8192
#: Pictures have so many columns, each with the least and the largest value in it.
COLUMNS = 1200


#: What a method needs beside its name: the published one as `web_section_step_pid.yaml` has it.
OF_METHOD: Mapping[str, Sequence[str]] = {
    "pid": ("twin.transfer.strain=false", "controllers.tension_control.bandwidth_rad_per_s=3.0"),
}


class Rows(RecordingBuilder):
    """Samples that are handed on a block at a time, and not kept."""

    def __init__(self, names: Sequence[str], whole: Sequence[str], take: Callable[[Channels], None]) -> None:
        super().__init__(names, _ROWS, whole)
        self._take = take
        self._integers = [name in set(whole) for name in names]

    def next_block(self) -> None:
        """The block is full: hand it on, and begin it anew."""
        self.flush()

    def flush(self) -> None:
        """Hand on what there is."""
        rows = self.block[: int(self.used[0])]
        if len(rows):
            words = rows.view(np.int64)
            self._take(
                {
                    name: (words if integer else rows)[:, at].astype(np.float64)
                    for at, (name, integer) in enumerate(zip(self.names, self._integers, strict=True))
                }
            )
        self.used[0] = 0


@dataclass
class Envelope:
    """Least and largest value of a signal in each of so many equal parts of a time, (2, COLUMNS)."""

    until_s: float
    low: Array = field(default_factory=lambda: np.full(COLUMNS, np.inf))
    high: Array = field(default_factory=lambda: np.full(COLUMNS, -np.inf))

    def add(self, t_s: Array, values: Array) -> None:
        """Samples, in any order."""
        at = np.clip((t_s / self.until_s * COLUMNS).astype(int), 0, COLUMNS - 1)
        np.fmin.at(self.low, at, values)
        np.fmax.at(self.high, at, values)


class Scored:
    """Scores of a bench's samples: each estimate, each tension that is kept, and what the loops do."""

    def __init__(self, config: ExperimentConfig, until_s: float, *, draws: bool) -> None:
        shape, self._cycle_s = config.shape, config.cycle_time_s
        self._after = round(AFTER_STEP_S / self._cycle_s)
        turns = config.machine.machine_kind == "servo_axis"
        self._speed = "v1_rad_s" if turns else f"v{shape.axes}_m_s"
        self.estimates = {name: EstimateScore() for name in (("J",) if turns else _names("E", shape, shape.estimated))}
        self.tensions = {name: TensionScore() for name in _names("F", shape, () if turns else shape.controlled)}
        self._unit = "kg_m2" if turns else "Pa"
        self._last: dict[str, Array] = {}
        self._arrived: set[str] = set()
        self.opened = 0
        self.offset_s = 0.0  #: of the samples that come now, for pictures
        self.pictures: dict[str, Envelope] = {}
        self._until_s, self._draws = until_s, draws

    def begin(self) -> None:
        """Samples of another bench follow."""
        self._last, self._arrived = {}, set()

    def take(self, rows: Channels) -> None:
        """Score the next rows; the last ones before are looked back on."""
        keep, lately = self._after + 1, len(next(iter(self._last.values()))) if self._last else 0
        both = {name: np.concatenate([self._last[name], rows[name]]) for name in rows} if lately else dict(rows)
        self._score(both, lately)
        self._last = {name: values[-keep:] for name, values in both.items()}
        if self._draws:
            self._draw(rows)

    def _score(self, rows: Channels, first: int) -> None:
        moves = np.abs(rows[self._speed]) > MOVES_M_S
        steps = np.zeros(len(moves), np.bool_)
        for name in self.estimates:
            steps |= shares_of_steps(rows[f"{name}_true_{self._unit}"])
        for name in self.estimates:
            found, sd, true = (rows[f"{name}_{kind}_{self._unit}"] for kind in ("sim", "sd", "true"))
            counts = moves & ~behind(steps, self._after)
            counts[:first] = False
            self.estimates[name].add(found, sd, true, counts)
        for name in self.tensions:
            steps |= np.concatenate([[False], np.abs(np.diff(rows[f"{name}_ref_N"])) > STEP_N])
        for name, score in self.tensions.items():
            counts = moves & ~behind(steps, self._after)
            counts[:first] = False
            counts[: self._arrival(name, rows, moves)] = False
            score.add(rows[f"{name}_true_N"], rows[f"{name}_ref_N"], counts)
            closed = rows[f"loop{name[1:]}_closed"][max(first - 1, 0) :]
            self.opened += int(np.count_nonzero(np.diff(closed) < 0.0))

    def _arrival(self, name: str, rows: Channels, moves: Mask) -> int:
        """First row from which on a tension counts."""
        if name in self._arrived:
            return 0
        near = moves & (np.abs(rows[f"{name}_true_N"] - rows[f"{name}_ref_N"]) <= ARRIVES_N)
        stays = ~behind(~near, self._after) & (np.arange(len(near)) >= self._after)
        there = np.flatnonzero(stays | (rows["t_s"] >= ARRIVES_BY_S))
        if not len(there):
            return len(near)
        self._arrived.add(name)
        return int(there[0])

    def _draw(self, rows: Channels) -> None:
        t_s = rows["t_s"] + self.offset_s
        for name in self.tensions:
            for signal in (f"{name}_true_N", f"{name}_ref_N"):
                self._envelope(signal).add(t_s, rows[signal])
        for name in self.estimates:
            found, sd, true = (rows[f"{name}_{kind}_{self._unit}"] for kind in ("sim", "sd", "true"))
            for signal, values in (
                (f"{name}_sim", found), (f"{name}_true", true),
                (f"{name}_low", found - 1.96 * sd), (f"{name}_high", found + 1.96 * sd),
            ):  # fmt: skip
                self._envelope(signal).add(t_s, values)

    def _envelope(self, signal: str) -> Envelope:
        return self.pictures.setdefault(signal, Envelope(self._until_s))


def _names(symbol: str, shape: Shape, spans: Sequence[int]) -> list[str]:
    return [f"{symbol}{shape.numbered(span)}" for span in spans]


# -- what happens ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Machine:
    """A shipped config, and what its shift has."""

    name: str
    speed: float = 3.0  #: m/s, or rad/s
    changes: Sequence[str] = ()
    reverses: bool = False
    splices: bool = False
    changes_tension: bool = True
    reel_s: float | None = None  #: the web on its reels lasts so long; then a bench begins anew
    once: bool = False  #: its own steps, once
    shaft: bool = False
    holds: bool = False  #: nothing but one step of E, and a hold

    @property
    def title(self) -> str:
        """What a table calls its shift."""
        return f"{self.name}, a hold" if self.holds else self.name


def _ahead(controller: str) -> tuple[str, ...]:
    """With what the twin knows ahead of this loop, as the other lines have it: without, a tension takes a length of web
    or two to come back, whatever E is known to be."""
    return (f"controllers.{controller}.feed_forward=twin",)


MACHINES: Mapping[str, Machine] = {
    each.title: each
    for each in (
        Machine("web_section_step", reverses=True),
        Machine("line_two_spans", 2.0, reverses=True, splices=True),
        Machine("line_three_spans", 2.0, reverses=True, splices=True),
        Machine("line_with_dancer", 2.0, _ahead("outfeed_tension")),
        Machine("winding_line", 1.2, _ahead("winding_tension"), changes_tension=False, reel_s=140.0),
        Machine("servo_axis", 35.0, shaft=True),
        Machine("shift", once=True),
        Machine("web_section_step", holds=True),
        Machine("line_two_spans", 2.0, holds=True),
        Machine("line_three_spans", 2.0, holds=True),
        Machine("line_with_dancer", 2.0, _ahead("outfeed_tension"), holds=True),
    )
}


class Operation:
    """An operator of a bench: commands, and what happens to the web meanwhile."""

    def __init__(self, bench: Bench, machine: Machine, seed: int, until_s: float) -> None:
        self._bench, self._machine, self._until_s = bench, machine, until_s
        self._rng = np.random.default_rng([seed, 311])
        self._nominal = bench.get(INERTIA_PATH if machine.shaft else E_PATH)
        self._now = self._nominal
        self._fast_per_s = 0.0
        self._rounds = 0
        self._hour = 0
        spans = bench.config.shape.controlled
        self._set_points = [
            f"tension_control.span{span}.set_point_N" if len(bench.config.shape.numbered(span)) else
            "tension_control.set_point_N" for span in spans
        ]  # fmt: skip

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self._bench.time_s >= self._until_s

    def run(self) -> None:
        """Go round and round until the time is up, then stop."""
        if self._machine.holds:
            self.to_speed(1.0)
            self.hold(6.0)
            self._change(1.0 + HOLD_STEP)
            self.hold(self._until_s)
            self.to_speed(0.0)
            return
        turn = self.swing if self._machine.shaft else self.round
        self.to_speed(1.0)
        while not self.over:
            turn()
            self._rounds += 1
        self.to_speed(0.0)

    def round(self) -> None:
        """Four minutes of production: a hold, a step of E, set-points, speeds, a drift, a stop, a start."""
        self.hold(40.0)
        self.step_modulus()
        self.hold(45.0)
        if self._machine.changes_tension and self._set_points:
            self.change_tension(self._set_points[self._rounds % len(self._set_points)])
        self.to_speed(float(self._rng.uniform(0.6, 1.2)))
        self.hold(30.0)
        self._fast_per_s = DRIFT_PER_S * (-1.0) ** self._rounds
        self.hold(60.0)
        self._fast_per_s = 0.0
        self.stop()
        if self._bench.time_s >= (self._hour + 1) * HOUR_S and not self.over:
            self._hour += 1
            self.once_an_hour()
        self.to_speed(1.0)

    def swing(self) -> None:
        """Half a minute of a shaft: accelerations, a hold, an inertia that steps, now and then a stop."""
        for share in (0.3, 1.0, 0.15, 0.7, 1.0):
            self.to_speed(share, 1.0)
            self.hold(1.0)
        self.step_modulus()
        for share in (0.2, 0.9, 0.3, 1.0):
            self.to_speed(share, 1.0)
            self.hold(1.0)
        self.hold(12.0)
        if self._rounds % 4 == 3:
            self.to_speed(0.0)
            self.hold(10.0)
            self.to_speed(1.0)

    def stop(self) -> None:
        """Stop for 20 s; every second time, where the line can, run backwards for a while."""
        self.to_speed(0.0)
        self.hold(20.0)
        if self._machine.reverses and self._rounds % 2 == 0:
            self.to_speed(-0.4)
            self.hold(10.0)
            self.to_speed(0.0)

    def once_an_hour(self) -> None:
        """Half an hour at rest, and a splice behind it."""
        self.hold(LONG_STOP_S)
        if self._machine.splices:
            self.to_speed(1.0)
            self.hold(10.0)
            self._bench.set("load.effects.splice.length_m", SPLICE_M)
            self._bench.step("load.effects.splice.relative_change", SPLICE_CHANGE)
            self.hold(SPLICE_M / self._machine.speed + 30.0)
            self.stop()

    def hold(self, duration_s: float) -> None:
        """Let time pass, while E drifts."""
        end_s = min(self._bench.time_s + duration_s, self._until_s)
        while (left_s := end_s - self._bench.time_s) > 0.5 * self._bench.config.cycle_time_s:
            part_s = min(left_s, DRIFT_EVERY_S)
            self._bench.run(part_s)
            if not (self._machine.shaft or self._machine.holds):
                there = self._bench.time_s % HOUR_S < 0.5 * HOUR_S
                slow = 2.0 * SLOW_DRIFT_PER_S * (1.0 if there else -1.0)
                self._change(1.0 + (slow + self._fast_per_s) * part_s)

    def to_speed(self, share: float, duration_s: float = 4.0) -> None:
        """Ramp to a share of the machine's speed."""
        if not self.over or share == 0.0:
            path = "speed_rad_s" if self._machine.shaft else SPEED_PATH
            self._bench.ramp(path, share * self._machine.speed, duration_s)

    def step_modulus(self) -> None:
        """E (or the inertia) steps, by 3 to 40 % up or down, so that it stays between its bounds."""
        if self.over:
            return
        size = float(np.exp(self._rng.uniform(np.log(LEAST_STEP), np.log(LARGEST_STEP))))
        up = bool(self._rng.integers(2))
        if not LOWEST <= self._now / self._nominal * (1.0 + size if up else 1.0 - size) <= HIGHEST:
            up = not up
        self._change(1.0 + size if up else 1.0 - size)

    def change_tension(self, path: str) -> None:
        """A set-point goes up by an eighth and back again."""
        if self.over:
            return
        before = self._bench.get(path)
        self._bench.step(path, 1.125 * before)
        self.hold(15.0)
        self._bench.step(path, before)
        self.hold(15.0)

    def _change(self, factor: float) -> None:
        self._now = min(max(self._now * factor, LOWEST * self._nominal), HIGHEST * self._nominal)
        self._bench.set(INERTIA_PATH if self._machine.shaft else E_PATH, self._now)


@dataclass(frozen=True)
class BenchOutcome:
    """How a bench did over a shift: the worst of its estimates and of its tensions."""

    simulated_s: float
    cpu_us: float  #: a cycle
    worst_pct: float | None  #: error of E in motion, 1 s behind each step left out
    within_pct: float  #: cycles within 1 %
    held_pct: float  #: cycles in which the 95 % interval holds the true E: of the estimate that is off 95 % the most
    half_pct: float  #: median half width, the largest
    tension_N: float | None  #: error of the true tension against its set-point, 1 s behind steps left out
    tension_within_pct: float  #: cycles within 1 N
    opened: int  #: how often a loop was opened
    alarms: int  #: notices, with their repetitions
    notices: tuple[str, ...]  #: of each kind the first, with its time
    ended: str  #: "" or what ended the run before its time

    @property
    def figures(self) -> dict[str, Any]:
        """The same as a mapping."""
        return asdict(self)


@dataclass
class Shift:
    """One machine's shift, and what was seen of it."""

    machine: Machine
    hours: float
    method: str = "changepoint"
    seed: int = 1
    draws: bool = False

    def __post_init__(self) -> None:
        self.until_s = 3600.0 * self.hours
        changes = [*self.machine.changes, f"seed={self.seed}", *OF_METHOD.get(self.method, ())]
        if self.method != "changepoint":
            changes += [f"twin.estimate=[{{quantity: youngs_modulus_Pa, span: 1, method: {self.method}}}]"]
        path = CONFIGS / f"{self.machine.name}.yaml"
        self.config = load_with_overrides(path, changes=changes).config
        self.scored = Scored(self.config, self.until_s, draws=self.draws)
        self.notices: list[tuple[float, str, int]] = []
        self.ended = ""

    def run(self) -> BenchOutcome:
        """All of it; of a machine with reels as many of these as it takes."""
        began, elapsed_s, cycles = time.process_time(), 0.0, 0
        while not self.ended:
            part_s = min(self.machine.reel_s or self.until_s, self.until_s - elapsed_s)
            self.scored.offset_s = elapsed_s
            elapsed_s += self._run_bench(part_s, self.seed + round(elapsed_s))
            if self.machine.once or elapsed_s >= self.until_s - 1.0:
                break
        cycles = round(elapsed_s / self.config.cycle_time_s)
        return self._outcome(elapsed_s, 1e6 * (time.process_time() - began) / max(cycles, 1))

    def _run_bench(self, until_s: float, seed: int) -> float:
        """Until it has stopped, or was ended; returns how long that was, s."""
        signals = self.config.signals
        names, whole = [each.name for each in signals], [each.name for each in signals if each.integer]
        watch = Rows(names, whole, self.scored.take)
        self.scored.begin()
        bench = Bench(self.config, observers=[watch], participants=Participants.IN_PROCESS)
        try:
            with bench:
                if self.machine.once:
                    for step in self.config.steps:
                        step.run(bench, [])
                else:
                    Operation(bench, self.machine, seed, until_s).run()
        except BenchFaultError as error:
            self.ended = str(error).splitlines()[0]
        watch.flush()
        offset_s = self.scored.offset_s
        self.notices += [(offset_s + each.time_s, f"{each.source}: {each.text}", each.count) for each in bench.notices]
        return bench.time_s

    def _outcome(self, simulated_s: float, cpu_us: float) -> BenchOutcome:
        estimates, tensions = list(self.scored.estimates.values()), list(self.scored.tensions.values())
        worst = max((each.worst_pct for each in estimates), key=abs, default=None)
        kept = max((each.worst_N for each in tensions), key=abs, default=None)
        return BenchOutcome(
            simulated_s,
            cpu_us,
            worst if worst is None or np.isfinite(worst) else None,
            min((each.within_pct for each in estimates), default=0.0),
            max((each.held_pct for each in estimates), key=lambda held: abs(held - 95.0), default=0.0),
            max((each.half_width_pct for each in estimates), default=0.0),
            kept,
            min((each.within_pct for each in tensions), default=100.0),
            self.scored.opened,
            sum(count for _, _, count in self.notices),
            tuple(f"{at_s:.1f} s: {text}" for at_s, text, _ in self.notices[:8]),
            self.ended,
        )


def run_shift(machine: Machine, hours: float, *, method: str = "changepoint", seed: int = 1) -> BenchOutcome:
    """A shift of this machine."""
    return Shift(machine, hours, method, seed).run()
