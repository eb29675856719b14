"""Whether the diagnosis names a step of Young's modulus on the bench's own recordings, and nothing else.

    diagnose_steps.py [--every N] [--jobs N] [--cases FILE] [--write]

Steps of 2 to 40 % up and down, at 0.5 to 8 m/s, forward and in reverse, held for 3 to 40 s before the line stops, and
in the middle of a ramp of the speed, with four seeds; each on a bench inside this process (lockstep, simulated
hardware), with the demonstrator's config. Right is: `elasticity_step` and nothing else, at the time and by the share
that it was, to 30 ms and half a per cent, or within its interval. `--every` takes each N-th case; `--cases` keeps each
finished case in a line of that file, and takes those that are there already as done; `--write` writes the table
into docs/tables and the page.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import docs_page
import finished_cases
import numpy as np

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.machines import emulation_of
from hilbench.results.recording import Recording
from hilbench.results.recording_builder import Recorder
from hilbench.runs.config import ExperimentConfig, load

CONFIG = Path(__file__).resolve().parents[1] / "bench_configs" / "web_section_step.yaml"
CHANGES_PCT = (2.0, -2.0, 5.0, -5.0, 10.0, -10.0, 20.0, -20.0, 40.0, -40.0)
SPEEDS_M_S = (0.5, 1.0, 3.0, 5.0, 8.0, -3.0)
HOLDS_S = (3.0, 10.0, 5.0, 40.0, 3.0, 20.0)
SEEDS = (1, 2, 3, 4)
#: Before the step at constant speed, s; slope of the speed, m/s².
BEFORE_S, SLOPE_M_S2 = 3.0, 1.5
NEAR_S, NEAR = 0.03, 0.005


@dataclass
class Case:
    """One step, and what was found."""

    change_pct: float
    speed_m_s: float
    hold_s: float
    in_ramp: bool
    seed: int
    time_s: float = 0.0  #: when the step acted
    verdict: str = ""
    found: list[list[Any]] = field(default_factory=list)
    tied: list[list[str]] = field(default_factory=list)
    named_time_s: list[float] = field(default_factory=list)  #: value, interval
    named_change: list[float] = field(default_factory=list)
    problem: str = ""
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """What tells it from others."""
        return json.dumps([self.change_pct, self.speed_m_s, self.hold_s, self.in_ramp, self.seed])

    @property
    def right(self) -> bool:
        """Whether the step, and nothing else, was found as it was."""
        if self.verdict != "named" or self.found != [["elasticity_step", None]]:
            return False
        return _near(self.named_time_s, self.time_s, NEAR_S) and _near(self.named_change, self.change_pct / 100.0, NEAR)


def _near(named: list[float], true: float, near: float) -> bool:
    value, low, high = named
    return abs(value - true) <= near or low <= true <= high


def cases() -> list[Case]:
    """Every change at every speed, every third in a ramp; holds and seeds take turns."""
    made = []
    count = len(SPEEDS_M_S)
    for row, change_pct in enumerate(CHANGES_PCT):
        for column in range(count):
            speed_m_s = SPEEDS_M_S[(column + row) % count]  # any share of the cases has all of them
            turn = count * row + column + row // 2
            hold_s, seed = HOLDS_S[turn % len(HOLDS_S)], SEEDS[turn % len(SEEDS)]
            made.append(Case(change_pct, speed_m_s, hold_s, turn % 3 == 2, seed))
    return made


def experiment(case: Case, E_Pa: float) -> list[dict[str, Any]]:
    """The steps of the experiment."""

    def ramp(to: float, duration_s: float) -> dict[str, Any]:
        return {"ramp": {"path": "line_speed_m_s", "to": to, "duration_s": duration_s}}

    v, step = case.speed_m_s, {"step": {"path": "load.web.youngs_modulus_Pa", "to": E_Pa * (1 + case.change_pct / 100)}}
    start_s = max(1.0, abs(v) / SLOPE_M_S2)
    begin = [{"hold": {"duration_s": 0.5}}, ramp(v, start_s), {"hold": {"duration_s": BEFORE_S}}]
    if case.in_ramp:
        begin += [ramp(0.8 * v, 1.0), step, ramp(0.6 * v, 1.0)]
    else:
        begin += [step]
    return [*begin, {"hold": {"duration_s": case.hold_s}}, ramp(0.0, start_s), {"hold": {"duration_s": 0.5}}]


def recorded(config: ExperimentConfig) -> Recording:
    """What a bench inside this process records of the experiment. Raises BenchFaultError."""
    recorder = Recorder(config.signals)
    with Bench(config, observers=[recorder], participants=Participants.IN_PROCESS) as bench:
        for step in config.steps:
            step.run(bench, [])
    return recorder.recording(datetime.now(UTC), config.description)


def run(case: Case) -> Case:
    """Make the recording, diagnose, compare."""
    plain = load(CONFIG)[0]
    E_Pa = plain.web_line.youngs_modulus_Pa(1)
    changes = {"seed": case.seed, "steps": experiment(case, E_Pa), "criteria": []}
    config = ExperimentConfig.model_validate({**plain.model_dump(), **changes})
    try:
        recording = recorded(config)
        case.time_s = float(recording.time_s[int(np.argmax(np.diff(recording["E_true_Pa"]) != 0.0)) + 1])
        began = time.perf_counter()
        found = diagnose(recording, config.web_line, "the bench", emulation=emulation_of(config))
        case.seconds = round(time.perf_counter() - began, 1)
    except Exception as error:  # a case that fails is a row of the table, not the end of the run
        case.problem = f"{type(error).__name__}: {error}"
        return case
    _note(case, found)
    return case


def _note(case: Case, found: Diagnosis) -> None:
    case.verdict = found.verdict
    case.found = [[effect.effect, effect.axis] for effect in found.effects]
    case.tied = [effect.tied_with for effect in found.effects]
    for effect in found.effects:
        if effect.effect == "elasticity_step":
            time_s, change = effect.parameters["time_s"], effect.parameters["relative_change"]
            case.named_time_s, case.named_change = [time_s.value, *time_s.ci95], [change.value, *change.ci95]
    if found.verdict == "unknown":
        case.problem = "; ".join(f"{m.signal} {m.condition} {m.detail}" for m in found.unexplained[:3])


def rows(done: list[Case]) -> list[list[str]]:
    """Counts and largest errors by size of the step and by speed."""
    found = []
    groups = [(f"±{size:g} %", [c for c in done if abs(c.change_pct) == size]) for size in (2, 5, 10, 20, 40)]
    groups += [(f"at {v:g} m/s", [c for c in done if c.speed_m_s == v]) for v in SPEEDS_M_S]
    groups += [("in a ramp of the speed", [c for c in done if c.in_ramp])]
    groups += [("held for 3 s", [c for c in done if c.hold_s == min(HOLDS_S)]), ("all", done)]
    for name, mine in groups:
        right = [case for case in mine if case.right]
        if mine:
            times = max((abs(c.named_time_s[0] - c.time_s) for c in right), default=0.0)
            changes = max((abs(100.0 * c.named_change[0] - c.change_pct) for c in right), default=0.0)
            found.append([name, str(len(mine)), str(len(right)), f"{1e3 * times:.1f}", f"{changes:.2f}"])
    return found


def summary(rows: list[docs_page.Row]) -> str:
    """Of all, and of those that are not all right."""
    shown = [row for row in rows if row["cases"] != row["right"] or row["steps of E"] == "all"]
    return docs_page.markdown(TABLE.columns, [list(row.values()) for row in shown])


TABLE = docs_page.Table(
    "diagnosis_steps",
    "diagnosis_method.md",
    ("steps of E", "cases", "right", "largest error of the time, ms", "of the change, %"),
    summary,
)


def text(done: list[Case]) -> str:
    """The share, and what was wrong."""
    lines = [f"{len(done)} cases, {100.0 * np.mean([c.right for c in done]):.1f} % right"]
    for case in done:
        if not case.right:
            where = f"{case.change_pct:+g} % at {case.speed_m_s:g} m/s, held {case.hold_s:g} s, seed {case.seed}"
            named = ", ".join(str(effect) for effect, _ in case.found) or case.verdict
            lines.append(f"\n{where}{', in a ramp' if case.in_ramp else ''} → {named} {case.problem}".rstrip())
    return "\n".join(lines)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="take each N-th case")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    asked = cases()[:: options.every]
    done = finished_cases.finish(asked, run, options.cases, options.jobs)
    order = [case.name for case in asked]
    done.sort(key=lambda case: order.index(case.name))
    print(docs_page.markdown(TABLE.columns, rows(done)), text(done), sep="\n\n")
    if options.write:
        TABLE.write(rows(done))
        docs_page.put(docs_page.DOCS / TABLE.page, "steps", text(done))


if __name__ == "__main__":
    main()
