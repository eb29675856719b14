"""Every synchronizer in every scenario, and how honest the deviations are, as two tables.

    sync_scenarios.py [--seeds N] [--coverage-seeds N] [--write]

The demonstrator's web section with torque noise 0.05 N·m per 2 ms sample unless a scenario says otherwise; medians over
the seeds. `--write` puts them into the page, the first as a summary.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # simulated data lie with the tests

import docs_page
import numpy as np
from numpy.typing import NDArray
from tests.simulated_measurements import simulated_measurements

from hilbench.estimation.web_line.config import METHODS, AlsoEstimated, ChangepointConfig, SynchronizerConfig
from hilbench.results.web_line_synchronization import MethodResult, compare_methods
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).parents[1] / "bench_configs" / "web_section_step.yaml"
CYCLE_S, STEP_S, STEP = 0.002, 10.0, 10.5 / 8.7 - 1.0
E_PA = 8.7e9

Array = NDArray[np.float64]


def step(size: float) -> Callable[[Array], Array]:
    """E that steps at STEP_S."""
    return lambda t: np.where(t >= STEP_S, E_PA * (1.0 + size), E_PA)


def ramp(t: Array) -> Array:
    """E that rises by 1 % of its value per second for 10 s."""
    return E_PA * (1.0 + 0.01 * np.clip(t - STEP_S, 0.0, 10.0))


def steady(t: Array) -> Array:
    """Line speed: up to 3 m/s within 4 s."""
    return 3.0 * np.minimum(t / 4.0, 1.0)


def changing(t: Array) -> Array:
    """Line speed that swings by 0.5 m/s with a period of 6 s while E steps."""
    return steady(t) + np.where(t > 4.0, 0.5 * np.sin(2.0 * np.pi * (t - 4.0) / 6.0), 0.0)


@dataclass(frozen=True)
class Scenario:
    """What happens, and with which noise and offset of the torque measurement; `duration_s` long."""

    name: str
    modulus: Callable[[Array], Array]
    speed: Callable[[Array], Array] = steady
    noise: float = 1.0
    offset_Nm: float = 0.0
    retensioned: bool = False  #: axis 1 takes the tension back 0.5 s after the step, as a tension loop does
    duration_s: float = 30.0


SCENARIOS = (
    Scenario("a: step +20.7 %", step(STEP)),
    Scenario("a: step −20.7 %", step(-STEP)),
    Scenario("b: ramp 1 %/s for 10 s", ramp),
    Scenario("c: noise ×3", step(STEP), noise=3.0),
    Scenario("c: noise ×10", step(STEP), noise=10.0),
    Scenario("d: torque offset 0.05 N·m", step(STEP), offset_Nm=0.05, retensioned=True),
    Scenario("e: line speed swings", step(STEP), speed=changing),
    Scenario("f: standstill", step(STEP), speed=np.zeros_like),
)


def methods_for(scenario: Scenario) -> dict[str, SynchronizerConfig]:
    """All methods; where the torque has an offset also the one that looks for it."""
    methods: dict[str, SynchronizerConfig] = {name: config() for name, config in METHODS.items()}
    if scenario.offset_Nm:
        methods["changepoint, offset too"] = ChangepointConfig(also=AlsoEstimated(torque_offset_Nm=0.05))
    return methods


def run(task: tuple[int, int]) -> tuple[int, list[tuple[str, MethodResult]], float | None, float]:
    """One scenario with one seed: results by method, the bound's time to 1 %, its deviation at the end in %."""
    number, seed = task
    scenario = SCENARIOS[number]
    model = load_with_overrides(CONFIG).config.web_line
    t = np.asarray(np.arange(round(scenario.duration_s / CYCLE_S)) * CYCLE_S, np.float64)
    true, speed = scenario.modulus(t), scenario.speed(t)
    v1 = speed.copy()
    if scenario.retensioned:
        strain = model.upstream_strain
        back = t >= STEP_S + 0.5
        v1[back] *= (1.0 + strain) / (1.0 + strain * E_PA / true[back])
    data = simulated_measurements(
        model,
        np.column_stack([v1, speed]),
        true,
        torque_noise_Nm=0.05 * scenario.noise,
        torque_offset_Nm=scenario.offset_Nm,
        seed=seed,
    )
    found = compare_methods(model, data, methods_for(scenario), true)
    results = [(result.method, result) for result in found.results]
    return number, results, found.bound_time_to_1pct_s, float(100.0 * found.bound_sd_Pa[-1] / true[-1])


def median(values: list[float | None], digits: int = 3) -> str:
    """Median for the eye; a dash where most have none."""
    known = [value for value in values if value is not None]
    if 2 * len(known) <= len(values):
        return "–"
    return f"{np.median(known):.{digits}g}"


def rows(outcomes: list[tuple[int, list[tuple[str, MethodResult]], float | None, float]]) -> list[list[str]]:
    """Of the table, a row a method in a scenario, and one of the bound."""
    found = []
    for number, scenario in enumerate(SCENARIOS):
        mine = [outcome for outcome in outcomes if outcome[0] == number]
        for place, (name, _) in enumerate(mine[0][1]):
            seeds = [outcome[1][place][1] for outcome in mine]
            cells = [
                median([r.time_to_1pct_s for r in seeds]),
                median([r.overshoot_pct for r in seeds], 2),
                median([r.noise_pct for r in seeds], 2),
                median([r.bias_pct for r in seeds], 2),
                median([r.largest_error_pct for r in seeds], 2),
                median([None if r.covered is None else 100.0 * r.covered for r in seeds]),
                median([r.cpu_us for r in seeds], 2),
            ]
            found.append([scenario.name, name, *cells])
        bound = [median([o[2] for o in mine]), "–", f"{np.median([o[3] for o in mine]):.2g}", "–", "–", "–", "–"]
        found.append([scenario.name, BOUND, *bound])
    return found


def summary(rows: list[docs_page.Row]) -> str:
    """Time to 1 % in s by scenario and method; medians of the largest errors in the settled part and of the costs."""
    methods = [name for name in dict.fromkeys(row["method"] for row in rows) if "," not in name and name != BOUND]
    lines = []
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        of = {row["method"]: row for row in rows if row["scenario"] == scenario}
        lines.append([scenario, *(of[name]["to 1 % in s"] for name in (*methods, BOUND))])
    for title, column in (("largest error in %, median", "largest error in %"), ("µs a cycle, median", "µs")):
        values = [[float(row[column]) for row in rows if row["method"] == name] for name in methods]
        lines.append([title, *(f"{np.median(of):.2g}" for of in values), "–"])
    return docs_page.markdown(["scenario", *(f"`{name}`" for name in methods), "bound"], lines)


BOUND = "Cramér–Rao bound"
TABLE = docs_page.Table(
    "scenarios",
    "compare_methods.md",
    (
        "scenario",
        "method",
        "to 1 % in s",
        "overshoot in %",
        "noise in %",
        "bias in %",
        "largest error in %",
        "95 % holds in %",
        "µs",
    ),
    summary,
)


@dataclass(frozen=True)
class Honesty:
    """What the torque is off by in each run, N·m (standard deviation over the runs), and what the twin allows for."""

    name: str
    offset_Nm: float
    unmodelled_Nm: float | None
    also_Nm: float = 0.0


HONESTY = (
    Honesty("noise only, nothing else allowed for", 0.0, 0.0),
    Honesty("offset 0.03 N·m, allowed for (`unmodelled_torque_Nm`)", 0.03, 0.03),
    Honesty("offset 0.05 N·m, looked for (`also`)", 0.05, 0.0, also_Nm=0.05),
    Honesty("offset 0.05 N·m, anything looked for (default)", 0.05, None),
)
HONEST_METHODS = ("rls", "lm", "ekf", "changepoint")


def coverage(task: tuple[int, int]) -> tuple[int, list[float], list[float]]:
    """One seed of a row of HONESTY: by method, the share of cycles covered before the step and after it settled."""
    number, seed = task
    row, model = HONESTY[number], load_with_overrides(CONFIG).config.web_line
    t = np.asarray(np.arange(round(8.0 / CYCLE_S)) * CYCLE_S, np.float64)
    true = np.where(t >= 5.0, E_PA * (1.0 + STEP), E_PA)
    speed = 3.0 * np.minimum(t, 1.0)
    offset_Nm = row.offset_Nm * float(np.random.default_rng([seed, 1]).standard_normal())
    commands = np.column_stack([speed, speed])
    data = simulated_measurements(model, commands, true, torque_offset_Nm=offset_Nm, seed=seed)
    also = AlsoEstimated(torque_offset_Nm=row.also_Nm)
    methods = {name: METHODS[name].model_validate({"also": also}) for name in HONEST_METHODS}
    found = compare_methods(model, data, methods, true, row.unmodelled_Nm)
    before, after = slice(round(3.0 / CYCLE_S), round(5.0 / CYCLE_S)), slice(round(6.5 / CYCLE_S), None)
    inside = [np.abs(r.track.E_Pa - true) <= 1.96 * r.track.E_sd_Pa for r in found.results]
    return number, [float(np.mean(x[before])) for x in inside], [float(np.mean(x[after])) for x in inside]


def coverage_table(outcomes: list[tuple[int, list[float], list[float]]]) -> str:
    """The second table in Markdown."""
    lines = [
        "| torque | " + " | ".join(f"`{name}`" for name in HONEST_METHODS) + " |",
        "|---|" + "--:|" * len(HONEST_METHODS),
    ]
    for number, row in enumerate(HONESTY):
        mine = [outcome for outcome in outcomes if outcome[0] == number]
        means = [100.0 * np.mean([outcome[part] for outcome in mine], axis=0) for part in (1, 2)]
        cells = [f"{before:.1f} / {after:.1f}" for before, after in zip(*means, strict=True)]
        lines.append(f"| {row.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--coverage-seeds", type=int, default=200)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    with ProcessPoolExecutor(2) as pool:
        tasks = [(number, seed) for number in range(len(SCENARIOS)) for seed in range(options.seeds)]
        scenarios = rows(list(pool.map(run, tasks)))
        tasks = [(number, seed) for number in range(len(HONESTY)) for seed in range(options.coverage_seeds)]
        honesty = coverage_table(list(pool.map(coverage, tasks, chunksize=4)))
    print(docs_page.markdown(TABLE.columns, scenarios), honesty, sep="\n\n")
    if options.write:
        TABLE.write(scenarios)
        docs_page.put(docs_page.DOCS / TABLE.page, "honesty", honesty)


if __name__ == "__main__":
    main()
