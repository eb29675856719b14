"""What the diagnosis finds on recordings of real axes, beside what is known of them.

    diagnose_rigs.py FOLDER [--only NAME] [--write]

FOLDER holds one folder a rig (`servo`, `emps`, `motor_pair`, `friction_damper`, `double_pendulum`, `torque_ripple`,
`robot_joint`), in it gzip CSV as their sources have published them; none of it is kept in this repository. Of rotary
axes an angle stands for the position: with a radius of 1 m and no gear N·m are N. `--write` writes the table, with
what is wrong, and its summary on the page.

A joint of an arm is a `servo_axis` (rad), and the other joint's angle stands beside it.
"""

from __future__ import annotations

import argparse
import gzip
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import docs_page
import numpy as np

from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

_FRICTION = frozenset({"coulomb_friction", "viscous_friction"})
_SERVO = _FRICTION | {"torque_offset", "inertia_mismatch"}


@dataclass(frozen=True)
class Rig:
    """One rig: its files, what of them is time, position and torque, and what is known."""

    name: str
    files: str
    columns: tuple[str, str, str]
    inertia: float  #: kg·m², or kg of a linear axis; what its model says
    must: frozenset[str]  #: effects that are known to be there
    may: frozenset[str]  #: effects that are there, and may be too small to be certain
    known: str
    other: str = ""  #: the column of the angle of the axis that it is coupled with
    rpm: str = ""  #: the pattern of the speed at which it turned, in its files' names; it has no column of its motion


RIGS = (
    Rig(
        "servo Jm", "servo/Jm*", ("t_s", "x1_m", "tau1_Nm"), 1.6588e-4, _SERVO, frozenset({"torque_ripple"}),
        "J 1.95e-4, viscous 3.31e-4, Coulomb 0.0304, offset -3.8e-3, orders 5 and 10",
    ),
    Rig(
        "servo Bm", "servo/Bm*", ("t_s", "x1_m", "tau1_Nm"), 1.6588e-4, _SERVO, frozenset({"torque_ripple"}),
        "inertia fed forward: the recorded torque lacks it",
    ),
    Rig(
        "servo Fc", "servo/Fc*", ("t_s", "x1_m", "tau1_Nm"), 1.6588e-4, _SERVO - {"viscous_friction"},
        frozenset({"torque_ripple"}), "inertia and viscous friction fed forward",
    ),
    Rig(
        "servo Fs", "servo/Fs*", ("t_s", "x1_m", "tau1_Nm"), 1.6588e-4, frozenset({"inertia_mismatch"}),
        frozenset({"torque_ripple"}), "inertia, viscous and dry friction fed forward",
    ),
    Rig(
        "EMPS", "emps/*", ("t_s", "x1_m", "tau1_Nm"), 95.1089, _FRICTION,
        frozenset({"torque_offset", "friction_asymmetry", "stribeck_friction", "torque_ripple"}),
        "viscous 203.5, Coulomb 20.4, offset -3.2 (Janot, Gautier, Brunot)",
    ),
    Rig(
        "motor pair", "motor_pair/*", ("t_s", "x1_m", "tau1_Nm"), 1.2e-4, _FRICTION, frozenset({"inertia_mismatch"}),
        "one direction in a file: Coulomb and offset are tied",
    ),
    Rig(
        "friction damper", "friction_damper/*", ("t_s", "x_m", "force_N"), 1e-3,
        frozenset({"coulomb_friction", "backlash"}), _FRICTION | {"torque_offset"}, "Coulomb and backlash",
    ),
    Rig(
        "pendulum, joint 1", "double_pendulum/*", ("time", "pos_meas1", "tau_meas1"), 1e-2,
        frozenset({"unbalance"}), _SERVO, "gravity of order 1", "pos_meas2",
    ),
    Rig(
        "pendulum, joint 2", "double_pendulum/*", ("time", "pos_meas2", "tau_meas2"), 1e-2,
        frozenset({"coulomb_friction", "unbalance"}), _SERVO,
        "Coulomb 0.17 to 0.19 (published 0.11 to 0.12 times arctan(100·v)), gravity", "pos_meas1",
    ),
    Rig(
        "torque ripple", "torque_ripple/*_torque", ("t_s", "", "torque_Nm"), 1e-3, frozenset({"torque_ripple"}),
        frozenset({"torque_offset", "viscous_friction", "torque_ripple_load"}),
        "order 24, and order 4 that grows: 0.03 and 2.1 N·m without load and at 50 %", rpm=r"_(\d+)rpm_",
    ),
    Rig(
        "robot joint", "robot_joint/case*", ("time", "q", "tau_J"), 1e-3, frozenset({"coulomb_friction"}),
        frozenset({"stribeck_friction", "torque_offset", "friction_asymmetry", "inertia_mismatch"}),
        "dry friction that falls with the speed (least squares: viscous below 0); a Stribeck fit published with"
        " case3_middle leaves 0.350, with case4_slow 0.255 N·m",
    ),
)  # fmt: skip


def recording(path: Path, rig: Rig) -> Recording:
    """The rig's columns of a file, which begin with these names or hold them; times made even."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        table = np.genfromtxt(file, delimiter=",")
    wanted = dict(zip(("t_s", "x1_rad" if rig.other else "x1_m", "tau1_Nm"), rig.columns, strict=True))
    if rig.rpm:
        del wanted["x1_m"]
    if rig.other:
        wanted["x2_rad"] = rig.other
    found = {
        channel: table[:, next(k for k, name in enumerate(names) if name == want or want in name)]
        for channel, want in wanted.items()
    }
    t = found.pop("t_s")
    period = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], period)
    channels = {channel: np.interp(even, t, values) for channel, values in found.items()}
    if turned := re.search(rig.rpm, path.name) if rig.rpm else None:
        channels["v1_m_s"] = np.full(len(even), float(turned[1]) * np.pi / 30.0)
    return Recording({"t_s": even - t[0], **channels})


def model(rig: Rig) -> Machine:
    """Of a lone axis of which nothing but the inertia is known."""
    if rig.other:
        return ServoAxisParameters.model_validate({"kind": "servo_axis", "shaft": {"inertia_kg_m2": rig.inertia}})
    rollers = {"radius_m": 1.0, "inertia_kg_m2": rig.inertia, "gear_ratio": 1.0}
    return ModelParameters.model_validate({"rollers": rollers, "motors": {"inertia_kg_m2": 0.0}, "effects": []})


def problems(rig: Rig, found: Diagnosis) -> Iterator[str]:
    """What is wrong with a diagnosis, by what is known of the rig."""
    names = {item.effect for item in found.effects}
    tied = {name for item in found.effects for name in item.tied_with}
    if lacking := rig.must - names - tied:
        yield f"not found: {', '.join(sorted(lacking))}"
    if false := names - rig.must - rig.may:
        yield f"not there, or not known: {', '.join(sorted(false))}"
    for item in found.effects:
        row = find_effect(item.effect)
        for name in set(row.strength) & item.parameters.keys():
            low, high = item.parameters[name].ci95
            if low <= row.parameter(name).neutral <= high:
                yield f"{item.effect}: the interval of {name} contains its neutral value"


def _said(found: Diagnosis) -> str:
    words = []
    for item in found.effects:
        name = next(iter(item.parameters))
        value = item.parameters[name]
        half = 0.5 * (value.ci95[1] - value.ci95[0])
        order = f" (order {item.parameters['order'].value:.4g})" if "order" in item.parameters else ""
        tied = f", tied with {', '.join(item.tied_with)}" if item.tied_with else ""
        words.append(f"{item.effect}{order} {value.value:.3g} ± {half:.1g}{tied}")
    for item in found.nuisance:
        sizes = [(name, f"{value.value:.3g} {value.unit}") for name, value in item.parameters.items()]
        said = [size if len(sizes) == 1 else f"{name} {size}" for name, size in sizes]
        words.append(f"beside it {item.effect} {', '.join(said)}")
    return "; ".join(words) or "nothing"


def summary(rows: list[docs_page.Row]) -> str:
    """By rig: verdicts, the least and the most that is left; and what is wrong."""
    lines = []
    for rig in dict.fromkeys(row["rig"] for row in rows):
        of = [row for row in rows if row["rig"] == rig]
        verdicts = ", ".join(dict.fromkeys(row["verdict"] for row in of))
        left = sorted((row["left, %"] for row in of), key=float)
        between = left[0] if len(of) == 1 else f"{left[0]} to {left[-1]}"
        lines.append((rig, str(len(of)), verdicts, between))
    table = docs_page.markdown(("rig", "recordings", "verdict", "left, %"), lines)
    wrong = [f"- wrong: {row['rig']}, {row['recording']}: {row['wrong']}" for row in rows if row["wrong"]]
    return "\n".join([table, "", *wrong]).strip()


TABLE = docs_page.Table(
    "rigs",
    "diagnosis_method.md",
    ("rig", "recording", "verdict", "found (first parameter, 95 %)", "left, %", "known", "wrong"),
    summary,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="rigs whose name has this")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    rows = []
    for rig in (rig for rig in RIGS if options.only in rig.name):
        for path in sorted(options.folder.glob(f"{rig.files}.csv.gz")):
            data, began = recording(path, rig), time.monotonic()
            found = diagnose(data, model(rig), path)
            share = 100.0 * found.gap.after / float(np.std(np.asarray(data["tau1_Nm"])))
            name, wrong = path.name.removesuffix(".csv.gz"), "; ".join(problems(rig, found))
            rows.append([rig.name, name, found.verdict, _said(found), f"{share:.1f}", rig.known, wrong])
            print(*rows[-1], f"{time.monotonic() - began:.0f} s", sep=" | ", flush=True)
    if options.write:
        TABLE.write(rows)


if __name__ == "__main__":
    main()
