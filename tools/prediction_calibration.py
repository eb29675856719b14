"""How well the probabilities of predicted limits are calibrated: seeded runs of a shipped bench, one forecast each.

    python tools/prediction_calibration.py [--runs 200] [--first 1] [--machine web_line] [--write]

Each run is drawn from its seed: a speed, the true E of the web (the twin starts from the model's), an experiment (a
step of E, of the tension set-point, or a faster or slower ramp), what is hidden from the model (dry friction, a torque
scale, or nothing), and a warning level around what the experiment will reach (standard deviation 5 % of a tension, 0.3
N·m of a torque). Of a servo axis: the inertia, dry and viscous friction of the emulated shaft (the twin starts from the
model's), a ramp of the speed, one behind a step of the inertia, or one that reverses, and a level of the torque. Of a
line of two spans: as of one, in either span (a ramp: of the last roller's torque), with another E in each. The
forecast is the last one a second before the experiment moves; the run says whether the level was crossed within the
horizon. The table has the Brier score (Brier, Monthly Weather Review 78(1), 1950), that of a forecast that always says
the share of crossings, and what came of the forecasts of each probability. Deterministic: lockstep, one process.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import docs_page
import numpy as np

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.runs.config import ExperimentConfig, load_with_overrides
from hilbench.runs.set_point_schedule import LookAhead
from hilbench.topology.sample import CycleSample

CONFIGS = Path(__file__).resolve().parents[1] / "bench_configs"
CONFIG, SERVO = CONFIGS / "predicted_limit.yaml", CONFIGS / "servo_predicted_limit.yaml"
SPANS = CONFIGS / "line_two_spans.yaml"
HORIZON_S = 2.5
#: When the experiment moves, s; the forecast is made `LEAD_S` before.
MOVES_S, LEAD_S = 3.5, 1.0
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
#: Motor torque per acceleration of the line and per tension: (J/r + i²·J_m/r)/i and r/i of the demonstrator.
_TORQUE_PER_ACCELERATION, _TORQUE_PER_TENSION = 29.8 * 0.04, 0.04


@dataclass(frozen=True)
class Case:
    """One run: what was done, what was forecast and what came."""

    seed: int
    experiment: str
    hidden: str
    signal: str
    level: float
    probability: float
    crossed: bool


Drawn = tuple[ExperimentConfig, str, str, str]


def drawn(seed: int) -> Drawn:
    """The config of a seed, its experiment, what is hidden, and the signal whose level may be crossed."""
    random = np.random.default_rng((seed, 18))
    speed_m_s, modulus_Pa = random.uniform(1.0, 3.0), 8.7e9 * random.uniform(0.97, 1.03)
    near = random.normal()  #: how far the level is from what will be reached, in units that each experiment has
    experiment = str(random.choice(["modulus", "set-point", "ramp"]))
    hidden = str(random.choice(["nothing", "friction", "torque scale"], p=[0.5, 0.25, 0.25]))
    effects: list[dict[str, Any]] = []
    if hidden == "friction":
        effects = [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": random.uniform(0.0, 2.0)}}]
    elif hidden == "torque scale":
        scale = random.uniform(-0.02, 0.02)
        effects = [{"effect": "torque_scale", "axis": 2, "parameters": {"relative_change": scale}}]
    move: dict[str, Any]
    if experiment == "modulus":
        factor = random.uniform(1.1, 1.25)
        move = {"step": {"path": "load.web.youngs_modulus_Pa", "to": modulus_Pa * factor}}
        quantity, signal, level = "tension_N", "F_true_N", 80.0 * factor * (1.0 + 0.05 * near)
    elif experiment == "set-point":
        to_N = random.uniform(88.0, 100.0)
        move = {"step": {"path": "tension_control.set_point_N", "to": to_N}}
        quantity, signal, level = "tension_N", "F_true_N", to_N * (1.005 + 0.05 * near)
    else:
        rate = random.uniform(2.0, 4.0)
        move = {"ramp": {"path": "line_speed_m_s", "to": speed_m_s + rate * 1.0, "duration_s": 1.0}}
        reached = rate * _TORQUE_PER_ACCELERATION + 10.0 * _TORQUE_PER_TENSION
        quantity, signal, level = "torque_Nm", "tau2_Nm", 1.15 * reached + 0.17 + 0.3 * near
    of_web = _of_web(seed, modulus_Pa, effects, {quantity: {"warning": float(level)}}, speed_m_s, move)
    return _config(CONFIG, of_web), experiment, hidden, signal


def _of_web(
    seed: int,
    modulus_Pa: float | list[float],
    effects: list[dict[str, Any]],
    limits: dict[str, Any],
    speed_m_s: float,
    move: dict[str, Any],
) -> dict[str, Any]:
    """What is changed in the config of a web line: no other limits, a ramp to the speed, then what is drawn."""
    others = ("tension_N", "torque_Nm", "speed_m_s", "position_difference_m", "estimate_ratio")
    return {
        "seed": seed,
        "load.web.youngs_modulus_Pa": modulus_Pa,
        "hardware.effects": effects,
        "safety.limits": {name: {} for name in others} | limits,
        "steps": [
            {"ramp": {"path": "line_speed_m_s", "to": speed_m_s, "duration_s": 1.0}},
            {"hold": {"until_s": MOVES_S}},
            move,
            {"hold": {"duration_s": HORIZON_S - LEAD_S}},
        ],
    }


def _config(path: Path, changes: dict[str, Any]) -> ExperimentConfig:
    """With these changes, a bench that looks ahead, on the embedded bus, without criteria."""
    ahead = {"horizon_s": HORIZON_S, "announce_above": 0.5}
    of_all = {"bus.address": "embedded", "twin.prediction": ahead, "criteria": []}
    given = [f"{key}={json.dumps(value)}" for key, value in (changes | of_all).items()]
    return load_with_overrides(path, changes=given).config


def drawn_shaft(seed: int) -> Drawn:
    """The same of a servo axis."""
    random = np.random.default_rng((seed, 19))
    inertia, dry = 0.048 * random.uniform(0.95, 1.1), 0.2 * random.uniform(0.5, 1.5)
    near, rate = random.normal(), random.uniform(25.0, 50.0)
    experiment = str(random.choice(["ramp", "inertia", "reversal"]))
    viscous = 0.004 * (random.uniform(0.0, 2.0) if random.random() < 0.5 else 1.0)
    hidden = "nothing" if viscous == 0.004 else "viscous friction"
    factor = random.uniform(0.9, 1.2) if experiment == "inertia" else 1.0
    to = -15.0 if experiment == "reversal" else 25.0
    moves: list[dict[str, Any]] = [
        {"ramp": {"path": "speed_rad_s", "to": to, "duration_s": abs(to - 5.0) / rate}},
        {"hold": {"duration_s": HORIZON_S - LEAD_S - abs(to - 5.0) / rate}},
    ]
    if experiment == "inertia":
        moves.insert(0, {"step": {"path": "load.shaft.inertia_kg_m2", "to": inertia * factor}})
    friction_Nm = -0.1 if experiment == "reversal" else dry + 0.05
    level = 1.2 * factor * inertia * rate + friction_Nm + 0.3 * near
    swing = [(25.0, 0.6), (5.0, 0.6), (25.0, 0.6), (5.0, 0.6)]
    ramps = [{"ramp": {"path": "speed_rad_s", "to": speed, "duration_s": lasts}} for speed, lasts in swing]
    shaft = {"inertia_kg_m2": inertia, "coulomb_friction_Nm": dry, "viscous_friction_Nm_s_per_rad": viscous}
    changes = {
        "seed": seed,
        "load.shaft": shaft,
        "safety.limits": {"torque_Nm": {"warning": float(max(level, 0.1))}, "speed_rad_s": {}, "estimate_ratio": {}},
        "steps": [*ramps, {"hold": {"until_s": MOVES_S}}, *moves],
    }
    return _config(SERVO, changes), experiment, hidden, "tau1_Nm"


def drawn_spans(seed: int) -> Drawn:
    """The same of a line of two spans."""
    random = np.random.default_rng((seed, 20))
    speed_m_s, moduli_Pa = random.uniform(1.0, 2.5), 8.7e9 * random.uniform(0.97, 1.03, 2)
    near, span = random.normal(), int(random.integers(2))
    experiment = str(random.choice(["modulus", "set-point", "ramp"]))
    hidden = str(random.choice(["nothing", "friction", "torque scale"], p=[0.5, 0.25, 0.25]))
    axis, tension_N = int(random.integers(2, 4)), (80.0, 90.0)[span]
    law: dict[str, Any] = {"effect": "coulomb_friction", "parameters": {"force_N": random.uniform(0.0, 2.0)}}
    if hidden == "torque scale":
        law = {"effect": "torque_scale", "parameters": {"relative_change": random.uniform(-0.02, 0.02)}}
    move: dict[str, Any]
    quantity, signal = "tension_N", f"F{span + 1}_true_N"
    if experiment == "modulus":
        factor = random.uniform(1.1, 1.25)
        path, to = f"load.web.span{span + 1}.youngs_modulus_Pa", moduli_Pa[span] * factor
        move, level = {"step": {"path": path, "to": to}}, tension_N * factor * (1.0 + 0.05 * near)
    elif experiment == "set-point":
        to = tension_N * random.uniform(1.1, 1.25)
        move = {"step": {"path": f"tension_control.span{span + 1}.set_point_N", "to": to}}
        level = to * (1.005 + 0.05 * near)
    else:
        rate = random.uniform(2.0, 4.0)
        move = {"ramp": {"path": "line_speed_m_s", "to": speed_m_s + rate * 1.0, "duration_s": 1.0}}
        reached = rate * _TORQUE_PER_ACCELERATION + 20.0 * _TORQUE_PER_TENSION
        quantity, signal, level = "torque_Nm", "tau3_Nm", 1.15 * reached + 0.17 + 0.3 * near
    effects = [] if hidden == "nothing" else [law | {"axis": axis}]
    limits = {quantity: {"warning": float(level)}}
    of_web = _of_web(seed, moduli_Pa.tolist(), effects, limits, speed_m_s, move)
    return _config(SPANS, of_web), experiment, hidden, signal


#: Of each kind of machine.
DRAWN: dict[str, Callable[[int], Drawn]] = {"web_line": drawn, "servo_axis": drawn_shaft, "two_spans": drawn_spans}


class Largest:
    """The largest size of a signal since `size` was set to 0."""

    def __init__(self, signal: str) -> None:
        self.size = 0.0
        self._signal = signal

    def sample(self, sample: CycleSample) -> None:
        """The next cycle."""
        self.size = max(self.size, abs(float(getattr(sample, self._signal))))


def run(seed: int, machine: str = "web_line") -> Case:
    """The run of a seed."""
    config, experiment, hidden, signal = DRAWN[machine](seed)
    waits = next(number for number, step in enumerate(config.steps) if step.hold and step.hold.until_s == MOVES_S)
    look_ahead, largest = LookAhead(config), Largest(signal)
    with Bench(config, observers=[largest], participants=Participants.IN_PROCESS) as bench:
        for number, step in enumerate(config.steps[: waits + 1]):
            bench.foresee(look_ahead.plan(number, bench.time_s))
            if number < waits:
                step.run(bench, [])
        bench.run(MOVES_S - LEAD_S - bench.time_s)
        assert bench.prediction is not None, "the config asks for it"
        outlook = bench.prediction.outlook
        assert outlook is not None, f"seed {seed}: the twin is not synchronized"
        place = outlook.place(signal)
        probability, level = float(outlook.probability[place, 0]), outlook.watched[place].warning

        largest.size = 0.0
        config.steps[waits].run(bench, [])
        for number, step in enumerate(config.steps[waits + 1 :], waits + 1):
            bench.foresee(look_ahead.plan(number, bench.time_s))
            step.run(bench, [])
    assert level is not None, "it was drawn"
    return Case(seed, experiment, hidden, signal, level, probability, largest.size > level)


def brier(cases: Sequence[Case]) -> float:
    """Mean square of the forecast's distance from what came."""
    return float(np.mean([(case.probability - case.crossed) ** 2 for case in cases]))


def reliability(cases: Sequence[Case]) -> list[tuple[float, float, int, float, float]]:
    """Of each class of probability: its edges, how many forecasts, their mean, and the share that came true."""
    rows = []
    for low, high in pairwise(EDGES):
        inside = [case for case in cases if low <= case.probability < high or (high == 1.0 and case.probability == 1.0)]
        if inside:
            said = float(np.mean([case.probability for case in inside]))
            came = float(np.mean([case.crossed for case in inside]))
            rows.append((low, high, len(inside), said, came))
    return rows


def rows(machine: str, cases: Sequence[Case]) -> list[list[str]]:
    """Of the table: all, by forecast, by experiment, by what was hidden."""
    share = float(np.mean([case.crossed for case in cases]))
    mean = float(np.mean([case.probability for case in cases]))
    found = [[ALL, str(len(cases)), _pct(mean), _pct(share), f"{brier(cases):.4f}", f"{share * (1 - share):.4f}"]]
    for low, high, count, said, came in reliability(cases):
        found.append([f"{FORECAST} {100 * low:.0f} to {100 * high:.0f} %", str(count), _pct(said), _pct(came), "", ""])
    for what in ("experiment", "hidden"):
        for value in sorted({getattr(case, what) for case in cases}):
            of = [case for case in cases if getattr(case, what) == value]
            found.append([f"{what} {value}", str(len(of)), "", "", f"{brier(of):.4f}", ""])
    return [[machine, *row] for row in found]


def _pct(share: float) -> str:
    return f"{100 * share:.1f} %"


def summary(rows: list[docs_page.Row]) -> str:
    """Of each machine how many crossed, with the Brier scores; then what came of each class of forecasts."""
    machines = list(dict.fromkeys(row["machine"] for row in rows))
    titles = ("machine", "runs", "came true", "Brier score", "of the share")
    alls = docs_page.markdown(titles, [[row[title] for title in titles] for row in rows if row["of"] == ALL])
    lines = []
    for kind in dict.fromkeys(row["of"] for row in rows if row["of"].startswith(FORECAST)):
        of = {row["machine"]: row["came true"] for row in rows if row["of"] == kind}
        lines.append([kind.removeprefix(f"{FORECAST} "), *(of.get(machine, "–") for machine in machines)])
    return f"{alls}\n\n{docs_page.markdown(['forecast; came true of', *machines], lines)}"


ALL, FORECAST = "all", "forecast"
TABLE = docs_page.Table(
    "prediction_calibration",
    "prediction.md",
    ("machine", "of", "runs", "mean forecast", "came true", "Brier score", "of the share"),
    summary,
)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="how many seeds")
    parser.add_argument("--first", type=int, default=1, help="the first one")
    parser.add_argument("--machine", choices=DRAWN, default="web_line", help="which bench")
    parser.add_argument("--out", type=Path, help="JSON lines, one a run")
    parser.add_argument("--write", action="store_true", help="write its rows, and a summary on the page")
    options = parser.parse_args()
    cases = []
    for seed in range(options.first, options.first + options.runs):
        cases.append(run(seed, options.machine))
        if options.out:
            with open(options.out, "a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(cases[-1])) + "\n")
    found = rows(options.machine, cases)
    print(docs_page.markdown(TABLE.columns, found))
    if options.write:
        others = [list(row.values()) for row in TABLE.rows()]
        kept = {machine: [row for row in others if row[0] == machine] for machine in DRAWN}
        kept[options.machine] = found
        TABLE.write(row for of in kept.values() for row in of)


if __name__ == "__main__":
    main()
