"""Random web lines: what `check` says of each, beside what a short run of it then shows.

    python tools/random_machines.py                     40 machines, the table of their outcomes
    python tools/random_machines.py --count 200 --write write docs/tables/random_machines.csv and docs/fault_tests.md
    python tools/random_machines.py --only 17           one machine, with its config and all that was said
    python tools/random_machines.py --kept FILE         go on where an ended tool left off

A machine is drawn from its seed: two to four driven rollers, their sizes and gears, web, tensions, cycle time and line
speed, motors and drives to fit. It runs in lockstep in one process: up to speed, a step of Young's modulus, down again.
The web is whole and nothing is hidden, so that an EMCY of a break, slip, slack web or shift (FF13h to FF17h) is a false
alarm. What happens in a run: a fault, a warning level, a drive at its limit for 0.1 s or longer, or tension or speed
off at the end of a hold. Small margins of a loop that `check` tells may show as any of these, and need not; a run whose
tension loop is open at the end of a hold says nothing of its tension.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from dataclasses import dataclass
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import docs_page
import numpy as np
import yaml
from finished_cases import finish

from hilbench.bench.lifecycle.participants import Participants
from hilbench.cia402.units import RPM
from hilbench.errors import HilbenchError, UnusableInputError
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.results.run import run_experiment
from hilbench.runs.check import check_experiment
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[1]
EDS = ROOT / "eds"
#: What a tension may be off its set-point, and a speed, at the end of a hold.
TENSION_SHARE, SPEED_SHARE = 0.05, 0.01
#: A hold lasts until a tension has settled, within these: six time constants of web and loop.
SHORTEST_HOLD_S, LONGEST_HOLD_S = 4.0, 15.0
#: What of EMCY messages is false where the web is whole; that E or a shift has changed the torque (FF18h) is true.
ALARMS = ("web break", "slip", "slack", "FF17h")
TRUE = ("FF18h", "EMCY cleared: ambiguous")
#: What of the warnings is of the loop's margins.
MARGINS = "the tension loop rings"
#: A drive that is at its limit for less altogether, s, is in a transient, of which `check` says nothing.
AT_LIMIT_S = 0.1
LIMITED = re.compile(r"(?P<drive>.+) has left its limit: at it for (?P<total_s>\S+) s")


@dataclass(frozen=True)
class Case:
    """A machine and what came of it; "" where nothing was said."""

    name: str
    drawn: str  #: in short
    refused: str = ""
    warned: str = ""  #: by `check`
    margins: str = ""  #: told by `check`
    happened: str = ""  #: in the run, beside alarms
    alarm: str = ""  #: a false one
    open_loop: str = ""  #: a tension loop was, at the end of a hold; then the tensions there

    @property
    def agrees(self) -> bool:
        """Whether what happened was told, and only then; small margins alone need not show in a short run."""
        return bool(self.warned or self.margins) if self.happened else not self.warned


def drawn(seed: int) -> dict[str, Any]:
    """The config of the machine of a seed."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        """By its logarithm, to three digits."""
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")

    axes = int(rng.choice([2, 2, 2, 3, 4]))
    cycle_s = float(rng.choice([0.001, 0.002, 0.004, 0.005]) if axes == 2 else rng.choice([0.004, 0.005]))
    width_m, thickness_m, span_m = between(0.1, 2.0), between(15e-6, 400e-6), between(0.4, 6.0)
    radius_m, gear, speed_m_s = between(0.04, 0.3), between(1.0, 15.0), between(0.3, 8.0)
    ramp_s = max(2.0, round(speed_m_s / between(0.3, 1.5), 1))
    roller_kg_m2 = float(f"{2 * pi * 7850 * width_m * between(0.004, 0.015) * radius_m**3:.3g}")
    rotor_kg_m2 = float(f"{roller_kg_m2 / gear**2 * between(0.05, 1.0):.3g}")
    inertia_kg_m2 = roller_kg_m2 / gear**2 + rotor_kg_m2
    # A web as stiff as load motors can emulate at this cycle, or softer, as far as materials are.
    swing_rad_s = between(0.03, 0.3) / cycle_s
    stiffness_N = inertia_kg_m2 * (gear / radius_m) ** 2 * swing_rad_s**2 * span_m
    modulus_Pa = float(f"{min(max(stiffness_N / (width_m * thickness_m), 0.1e9), 200e9):.3g}")
    set_point_N = float(f"{min(modulus_Pa * width_m * thickness_m * between(2e-4, 5e-3), 2000.0):.3g}")
    # A motor that keeps a difference of tension by half the set-point and accelerates, with 10 to 200 % to spare.
    needed_Nm = 0.5 * set_point_N * radius_m / gear + inertia_kg_m2 * speed_m_s / radius_m * gear / ramp_s
    torque_Nm = float(f"{needed_Nm * between(1.1, 3.0):.3g}")
    load_Nm = float(f"{2.0 * set_point_N * radius_m / gear + torque_Nm:.3g}")
    most_rpm = int(speed_m_s / radius_m * gear / RPM * between(0.9, 2.5))
    velocity_loop_rad_s = between(40.0, 150.0)
    kp = float(f"{inertia_kg_m2 * velocity_loop_rad_s:.3g}")

    def drive(node_id: int, peak_Nm: float) -> dict[str, Any]:
        return {
            "node_id": node_id,
            "eds": str(EDS / "hilbench_servo.eds"),
            "units": {"rated_torque_Nm": float(f"{peak_Nm / 3.0:.4g}")},
            "parameters": {"6080h": most_rpm},
        }

    names = [f"axis{k}" for k in range(1, axes + 1)]
    bandwidths = [between(1.0, 8.0) for _ in range(1, axes)]
    settles_s = 6.0 * max((axes - 1) * span_m / speed_m_s, *(1.0 / each for each in bandwidths))
    hold = {"hold": {"duration_s": round(min(max(settles_s, SHORTEST_HOLD_S), LONGEST_HOLD_S), 1)}}
    return {
        "name": f"random_{seed}",
        "description": f"The random machine of seed {seed}.",
        "seed": seed,
        "pace": "lockstep",
        "cycle_time_s": cycle_s,
        "mirroring": "listen",
        "bus": {"address": "embedded"},
        "drives": {
            name: {**drive(k, torque_Nm), "virtual": drive(16 + k, torque_Nm)} for k, name in enumerate(names, 1)
        },
        "load_motors": {
            f"load{k}": {
                **drive(axes + k - 1, load_Nm),
                "shaft": names[k - 1],
                "motor": {
                    "torque_limit_Nm": load_Nm,
                    "inertia_kg_m2": float(f"{0.3 * rotor_kg_m2:.3g}"),
                    "velocity_kp_Nm_s_per_rad": kp,
                    "velocity_ki_Nm_per_rad": float(f"{0.2 * kp * velocity_loop_rad_s:.3g}"),
                },
            }
            for k in range(2, axes + 1)
        },
        "machine": {
            "web": {
                "youngs_modulus_Pa": modulus_Pa,
                "width_m": width_m,
                "thickness_m": thickness_m,
                "span_length_m": [span_m] * (axes - 1),
            },
            "rollers": {"radius_m": radius_m, "inertia_kg_m2": roller_kg_m2, "gear_ratio": gear},
            "motors": {"inertia_kg_m2": rotor_kg_m2},
            "web_load": [False, *[True] * (axes - 1)],
            "drives": {
                "velocity_kp_Nm_s_per_rad": kp,
                "velocity_ki_Nm_per_rad": float(f"{0.2 * kp * velocity_loop_rad_s:.3g}"),
                "torque_limit_Nm": torque_Nm,
                "current_loop_time_constant_s": 0.001,
                "sample_time_s": 0.001,
            },
            "boundary": {
                "upstream_tension_N": float(f"{set_point_N * between(0.7, 1.4):.3g}"),
                "downstream_tension_N": float(f"{set_point_N * between(0.7, 1.4):.3g}"),
            },
        },
        "hardware": {
            "sensors": {
                "torque_noise_Nm": float(f"{0.005 * torque_Nm:.3g}"),
                "velocity_noise_rad_s": 0.002,
            }
        },
        "twin": {
            "node": {"node_id": 32, "eds": str(EDS / "hilbench_virtual_io.eds")},
            "estimate": [{"quantity": "youngs_modulus_Pa", "method": "changepoint"}],
        },
        "controllers": {
            f"tension{span}": {"span": span, "set_point_N": set_point_N, "bandwidth_rad_per_s": bandwidth}
            for span, bandwidth in enumerate(bandwidths, 1)
        },
        "safety": {
            "limits": {
                "tension_N": {"warning": 2.0 * set_point_N, "trip": 4.0 * set_point_N},
                "torque_Nm": {"warning": None, "trip": None},
            }
        },
        "steps": [
            {"ramp": {"path": "line_speed_m_s", "to": speed_m_s, "duration_s": ramp_s}},
            hold,
            {"step": {"path": "load.web.youngs_modulus_Pa", "to": modulus_Pa * float(rng.choice([0.85, 1.15]))}},
            hold,
            {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": ramp_s}},
        ],
        "criteria": [],
    }


def tried(case: Case) -> Case:
    """`check` and run of a machine."""
    document = drawn(int(case.name))
    with TemporaryDirectory(prefix="random-machine-") as folder:
        path = Path(folder, "machine.yaml")
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        try:
            loaded = load_with_overrides(path)
            warnings = check_experiment(loaded, with_margins=True).warnings
        except UnusableInputError as error:
            return Case(case.name, case.drawn, refused=error.problem)
        margins = "; ".join(each for each in warnings if each.startswith(MARGINS))
        warned = "; ".join(each.partition(": ")[2] for each in warnings if not each.startswith(MARGINS))
        try:
            outcome = run_experiment(loaded, Path(folder, "runs"), participants=Participants.IN_PROCESS)
        except HilbenchError as error:
            return Case(case.name, case.drawn, warned=warned, margins=margins, happened=str(error))
        seen = _seen(outcome.result)
        recording = read_recording(outcome.folder.recording) if outcome.recorded else None
    off, open_loop, slack = ([], False, False) if recording is None else _course(recording, document)
    false = [word for word in ALARMS if not (slack and word == "slack")]
    alarms = [text for text in seen if any(word in text for word in false)]
    others = [text for text in seen if text not in alarms] + ([] if open_loop else off)
    return Case(
        case.name,
        case.drawn,
        warned=warned,
        margins=margins,
        happened="; ".join(others),
        alarm="; ".join(alarms),
        open_loop="; ".join(off) or "tension kept" if open_loop else "",
    )


def _seen(result: Result) -> list[str]:
    """Faults and warnings of a run; a loop that opens is told by whether it was ever closed."""
    told = [f"{each.source}: {each.text}" for each in result.faults]
    ended = [found for each in result.warnings or () if (found := LIMITED.match(each.text))]
    brief = {found["drive"] for found in ended if float(found["total_s"]) < AT_LIMIT_S}
    brief -= {found["drive"] for found in ended if float(found["total_s"]) >= AT_LIMIT_S}
    return told + [
        f"{each.source}: {each.text}"
        for each in result.warnings or ()
        if not each.text.startswith("tension loop")
        and not any(word in each.text for word in TRUE)
        and not any(each.text.startswith((f"{drive} is at its limit", f"{drive} has left")) for drive in brief)
    ]


def _course(recording: Recording, document: dict[str, Any]) -> tuple[list[str], bool, bool]:
    """Speeds and tensions that were off at the ends of the holds, whether a tension loop was open there, and whether a
    web was slack in truth."""
    ramp, spans = document["steps"][0]["ramp"], len(document["controllers"])
    names = [""] if spans == 1 else [str(span) for span in range(1, spans + 1)]
    found: dict[str, None] = {}
    is_open = False
    hold_s = document["steps"][1]["hold"]["duration_s"]
    for end_s in (ramp["duration_s"] + hold_s, ramp["duration_s"] + 2 * hold_s):
        rows = (recording.time_s > end_s - 0.5) & (recording.time_s < end_s)
        if not rows.any():
            continue  # it ended before, with a fault
        speed_m_s = float(np.mean(recording[f"v{spans + 1}_m_s"][rows]))
        if abs(speed_m_s / ramp["to"] - 1.0) > SPEED_SHARE:
            found[f"line speed {speed_m_s:.3g} m/s"] = None
        for name in names:
            is_open |= not recording[f"loop{name}_closed"][rows].all()
            error = float(np.mean(recording[f"F{name}_true_N"][rows] / recording[f"F{name}_ref_N"][rows])) - 1.0
            if abs(error) > TENSION_SHARE:
                found[f"tension{name} {100 * error:+.0f} %"] = None
    return list(found), is_open, any(bool((recording[f"F{name}_true_N"] <= 0.0).any()) for name in names)


def in_short(document: dict[str, Any]) -> str:
    """The machine of a config, for a line."""
    machine, web = document["machine"], document["machine"]["web"]
    return (
        f"{len(document['drives'])} rollers of {machine['rollers']['radius_m']:g} m, gear "
        f"{machine['rollers']['gear_ratio']:g}, {document['steps'][0]['ramp']['to']:g} m/s, "
        f"E {web['youngs_modulus_Pa'] * 1e-9:g} GPa, {web['span_length_m'][0]:g} m, "
        f"{document['controllers']['tension1']['set_point_N']:g} N, {document['cycle_time_s'] * 1e3:g} ms"
    )


def table(cases: list[Case]) -> str:
    """How many came to what."""
    ran = [case for case in cases if not case.refused]
    agree = sum(case.agrees for case in ran)
    alarms = [case for case in ran if case.alarm]
    counts = {
        "Machines": len(cases),
        "refused by `check`": len(cases) - len(ran),
        "run": len(ran),
        "nothing announced, nothing happened": sum(case.agrees and not case.happened for case in ran),
        "announced, and happened": sum(case.agrees and bool(case.happened) for case in ran),
        "announced, did not happen": sum(bool(case.warned) and not case.happened for case in ran),
        "not announced, happened": sum(not case.agrees and bool(case.happened) for case in ran),
        "`check` and run agree": f"{100 * agree / len(ran):.1f} %" if ran else "–",
        "small margins reported": sum(bool(case.margins) for case in ran),
        "false alarms of break, slip, slack web or shift": len(alarms),
        "a tension loop open at the end of a hold": sum(bool(case.open_loop) for case in ran),
    }
    return "; ".join(f"{what}: {count}" for what, count in counts.items()) + "."


def odd(cases: list[Case]) -> list[list[str]]:
    """Rows of those where `check` and run disagree, or an alarm is false."""
    ran = sorted((case for case in cases if not case.refused), key=lambda case: int(case.name))
    return [
        [case.name, case.drawn, _cut(case.warned), _cut("; ".join(filter(None, (case.happened, case.alarm))))]
        for case in ran
        if not case.agrees or case.alarm
    ]


def summary(rows: list[docs_page.Row]) -> str:
    """Their seeds."""
    return f"Disagreements and false alarms: seeds {', '.join(row['seed'] for row in rows)}."


TABLE = docs_page.Table(
    "random_machines", "fault_tests.md", ("seed", "machine", "announced by check", "in the run"), summary
)


def _cut(text: str) -> str:
    short = text if len(text) < 160 else text[:159] + "…"
    return short.replace("|", "/").replace("\n", " ") or "–"


def main() -> int:
    """Draw, check, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40, help="machines, of the seeds from 1 on")
    parser.add_argument("--only", type=int, metavar="SEED", help="the machine of this seed alone")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="finished machines stand here, one a line")
    parser.add_argument("--jobs", type=int, default=1, help="machines at a time")
    parser.add_argument("--write", action="store_true", help="write random_machines.csv and docs/fault_tests.md")
    options = parser.parse_args()
    if options.only is not None:
        document = drawn(options.only)
        print(yaml.safe_dump(document, sort_keys=False), tried(Case(str(options.only), in_short(document))), sep="\n")
        return 0
    asked = [Case(str(seed), in_short(drawn(seed))) for seed in range(1, options.count + 1)]
    cases = finish(asked, tried, options.kept, options.jobs)
    print(table(cases), docs_page.markdown(TABLE.columns, odd(cases)), sep="\n\n")
    print(Counter(case.refused[:60] for case in cases if case.refused).most_common(), file=sys.stderr)
    if options.write:
        docs_page.put(docs_page.DOCS / TABLE.page, "counts of random machines", table(cases))
        TABLE.write(odd(cases))
    return 0


if __name__ == "__main__":
    sys.exit(main())
