"""Published web lines, with the controllers of their papers and with feed-forward from the twin's model.

    python tools/published_lines.py                        print the table
    python tools/published_lines.py --write                write it into docs/tables, a summary into docs/lines.md
    python tools/published_lines.py --pictures docs/images drawings of the lines

The lines are the models in bench_configs/published, stepped by `hilbench.plant`, and the benches of the same names in
bench_configs, with load motors and a twin, run in one process. A deviation is the largest |F - F_ref|
of the tension that the paper shows, over its set-point. Papers print no gains of Koç's PID; those here are tuned to
the settling times of its figure 8.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from math import copysign, exp, inf, nan
from pathlib import Path
from tempfile import TemporaryDirectory

import docs_page
import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.web_line_drawing import LineNotes, drawing
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.tension_cycle import LOOP
from hilbench.bench.tasks.tension_feed_forward import FeedForwardTask
from hilbench.bench.tasks.web_winding_control import ROUNDED, CarriageForce, ReelMechanics, ReelTension, eased
from hilbench.compiled import of_record, record_at
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, velocity_before
from hilbench.control.web_line.tension import CONTROLLER, control, tension_controller
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters, load_model
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import TensionControlConfig

FOLDER = Path(__file__).resolve().parents[1] / "bench_configs" / "published"
PER_MIN = 1.0 / 60.0
#: From here on the line runs evenly, until its speed changes.
SETTLED_S, CHANGES_S = 1.5, 2.0
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """Of a run: time (T,), tensions of the spans (T, K) and speeds of the axes (T, N), m/s."""

    time_s: Array
    tensions_N: Array
    speeds_m_s: Array

    def deviation_pct(self, span: int, set_point_N: float, after_s: float = 0.0) -> float:
        """The largest of a span, from 1, in % of the set-point."""
        error_N = np.abs(self.tensions_N[self.time_s >= after_s, span - 1] - set_point_N)
        return float(100.0 * np.max(error_N) / set_point_N)

    def cell_pct(self, spans: tuple[int, int], set_point_N: float) -> float:
        """The largest at a load cell, whose roller two spans pull at."""
        cell_N = np.mean([self.tensions_N[:, span - 1] for span in spans], axis=0)
        return float(100.0 * np.max(np.abs(cell_N[self.time_s >= SETTLED_S] / set_point_N - 1.0)))

    def changed_pct(self, span: int) -> float:
        """The largest change of a span, in % of what it was right before."""
        even_N = float(np.mean(self.tensions_N[(self.time_s >= SETTLED_S) & (self.time_s < CHANGES_S), span - 1]))
        return self.deviation_pct(span, even_N, SETTLED_S)

    def behind_pct(self, set_point_N: float) -> float:
        """The largest of the last span."""
        return self.deviation_pct(self.tensions_N.shape[1], set_point_N, SETTLED_S)


class Stand:
    """A line that runs at a speed with an even tension, and is stepped cycle by cycle."""

    def __init__(self, model: ModelParameters, speed_m_s: float, cycle_s: float) -> None:
        self.model, self.cycle_s = model, cycle_s
        self.ports = [MotorPort() for _ in range(model.axis_count)]
        self.line = Line(model, self.ports)
        carriages = {f"v_{each.station.name}_m_s" for each in model.carriages}
        names = [quantity.name for quantity in self.line.describe().states]
        moving = [name for name in names if name.startswith("v") and name not in carriages]
        self.line.set_state(dict.fromkeys(moving, speed_m_s))
        self.now = self.line.outputs()
        self._rows: list[tuple[float, list[float], list[float]]] = []

    def torque(self, axis: int, torque_Nm: float) -> None:
        """Of a motor, in the next cycle."""
        self.ports[axis - 1].mode, self.ports[axis - 1].setpoint = MotorMode.TORQUE, torque_Nm

    def velocity(self, axis: int, speed_m_s: float) -> None:
        """Of a roller, in the next cycle."""
        port = self.ports[axis - 1]
        port.mode, port.setpoint = MotorMode.VELOCITY, speed_m_s * self.model.motor_rad_per_m(axis)

    def step(self) -> None:
        """One cycle."""
        self.line.step(self.cycle_s)
        self.now = self.line.outputs()
        spans, axes = range(1, self.model.span_count + 1), range(1, self.model.axis_count + 1)
        self._rows.append(
            (self.line.time_s, [self.now[f"F{k}_N"] for k in spans], [self.now[f"v{k}_m_s"] for k in axes])
        )

    def course(self) -> Course:
        """What was stepped."""
        times, tensions, speeds = zip(*self._rows, strict=True)
        return Course(np.array(times), np.array(tensions), np.array(speeds))


@dataclass(frozen=True)
class Ramp:
    """From one speed to another over `duration_s` from `start_s` on, with a bounded jerk."""

    start_s: float
    duration_s: float
    before_m_s: float
    after_m_s: float
    rounded: float = ROUNDED

    def at(self, t_s: float) -> tuple[float, float]:
        """Speed and acceleration."""
        way, speed = eased((t_s - self.start_s) / self.duration_s, self.rounded)
        change = self.after_m_s - self.before_m_s
        return self.before_m_s + change * way, change / self.duration_s * speed


# -- Koç, Knittel, de Mathelin, Abba 2002 ----------------------------------------------------------------


KOC_N, KOC_FAST, KOC_SLOW = 15.0, 130.0 * PER_MIN, 70.0 * PER_MIN
KOC_SAMPLE_S = 0.01
#: Of the loop of the speed: its integral rate is a quarter of its square.
KOC_SPEED_RAD_S = 3.5


@dataclass
class Pid:
    """As the paper's decentralized control has one: sampled, its integral held at the limit; without a derivative."""

    gain: float
    rate: float
    limit: float
    integral: float = 0.0

    def output(self, error: float) -> float:
        """One sample."""
        integral = self.integral + self.rate * error * KOC_SAMPLE_S
        wanted = self.gain * error + integral
        if abs(wanted) > self.limit:
            return copysign(self.limit, wanted)
        self.integral = integral
        return wanted


def koc_pid() -> Course:
    """Three motors with a PID each; the reference of the speed steps from 130 to 70 m/min and back (figure 17)."""
    model = load_model(FOLDER / "koc_2002.yaml")
    stand = Stand(model, KOC_FAST, KOC_SAMPLE_S)
    limits = limits_Nm(model)
    # Tension settles in 2 s (figure 8), the speed in half a second: integral rates in N/(N·s), at the radius at start.
    unwinder, winder = (model.radius_m(axis) for axis in (1, 3))
    pulls = [
        Pid(0.0, 2.0 * unwinder, limits[0], KOC_N * unwinder),
        Pid(0.0, 2.0 * winder, limits[2], KOC_N * winder),
    ]
    mass_kg = sum(koc_mass_kg(model, axis, model.radius_m(axis)) for axis in (1, 3)) + model.mass_kg(2)
    radius_m, bandwidth = model.radius_m(2), KOC_SPEED_RAD_S
    speed = Pid(bandwidth * mass_kg * radius_m, 0.25 * bandwidth**2 * mass_kg * radius_m, limits[1])
    torques = (-KOC_N * unwinder, 0.0, KOC_N * winder)
    for sample in range(round(12.0 / KOC_SAMPLE_S)):
        for axis, torque_Nm in enumerate(torques, 1):  # a sample late, as a computer is
            stand.torque(axis, torque_Nm)
        t_s = sample * KOC_SAMPLE_S
        wanted = KOC_SLOW if 2.0 <= t_s < 7.0 else KOC_FAST
        now = stand.now
        torques = (
            -pulls[0].output(KOC_N - now["F1_N"]),
            speed.output(wanted - now["v2_m_s"]),
            pulls[1].output(KOC_N - 0.5 * (now["F3_N"] + now["F4_N"])),
        )
        stand.step()
    return stand.course()


def limits_Nm(model: ModelParameters) -> list[float]:
    """Of the motors."""
    assert model.drives is not None, "the published lines have drives"
    return [per_item(model.drives.torque_limit_Nm, axis) for axis in range(1, model.axis_count + 1)]


def koc_mass_kg(model: ModelParameters, axis: int, radius_m: float) -> float:
    """Of a reel at the web."""
    return ReelMechanics.of_model(model, axis).inertia_kg_m2(radius_m) / radius_m**2


def koc_feed_forward(inertia_error: float = 0.02, radius_error: float = 0.002) -> Course:
    """The reels in torque mode, told tension and acceleration; the traction roller leads at its speed.

    What the twin knows is wrong by so much: of the reels' inertia and radius.
    """
    model, cycle_s = load_model(FOLDER / "koc_2002.yaml"), 0.002
    stand = Stand(model, KOC_FAST, cycle_s)
    limits = limits_Nm(model)
    reels = {axis: ReelMechanics.of_model(model, axis) for axis in (1, 3)}
    pulls = {axis: ReelTension(reels[axis], 0.0, 2.0, limits[axis - 1]) for axis in (1, 3)}
    ramps = [Ramp(2.0, 1.0, KOC_FAST, KOC_SLOW, 0.5), Ramp(7.0, 1.0, KOC_SLOW, KOC_FAST, 0.5)]
    commands = {axis: reel.torque_Nm(KOC_N, 0.0, model.radius_m(axis)) for axis, reel in reels.items()}
    speed_m_s = KOC_FAST
    for cycle in range(round(12.0 / cycle_s)):
        for axis, torque_Nm in commands.items():
            stand.torque(axis, torque_Nm)
        stand.velocity(2, speed_m_s)
        now = stand.now
        speed_m_s, acceleration = ramps[0 if cycle * cycle_s < 7.0 else 1].at(cycle * cycle_s)
        commands = {}
        for axis, name, tension in ((1, "unwinder", ("F1_N", "F2_N")), (3, "rewinder", ("F3_N", "F4_N"))):
            radius_m = now[f"r_{name}_m"] * (1.0 + radius_error)
            told = acceleration * (1.0 + inertia_error)
            cell_N = 0.5 * (now[tension[0]] + now[tension[1]])
            commands[axis] = pulls[axis].torque_Nm(KOC_N, cell_N, told, radius_m, cycle_s)
        stand.step()
    return stand.course()


# -- Giannoccaro, Sakamoto, Uchitomi 2016 ----------------------------------------------------------------

FILM_N, FILM_CYCLE_S = 14.0, 0.002
#: Bandwidth of the tension loops, and of the correction.
FILM_LOOP = {"bandwidth_rad_per_s": 4.0, "set_point_N": FILM_N, "feed_forward": "twin"}


class KnownTension:
    """What keeps the tension of a span, as the feed-forward asks it."""

    def __init__(self, goal_N: float, modulus_Pa: float) -> None:
        self.loop = np.array([of_record(LOOP, set_point_N=goal_N, modulus_Pa=modulus_Pa)], LOOP)


def film(duration_s: float = 2.0, *, feed_forward: bool = True, modulus_error: float = 0.01) -> Course:
    """The bench's own loops on the line of four rolls, 1 to 2 m/s in `duration_s`; the winder leads.

    The twin's E, and with it the tension that it shows, is wrong by so much. Without feed-forward: its controllers
    alone.
    """
    model = load_model(FOLDER / "giannoccaro_2016.yaml")
    stand, line_speed, nothing = Stand(model, 1.0, FILM_CYCLE_S), Reference(LINE_SPEED, 1.0), CycleSample()
    spans = range(1, model.span_count + 1)
    moduli = {span: model.youngs_modulus_Pa(span) * (1.0 + modulus_error) for span in spans}
    configs = {span: TensionControlConfig.model_validate(FILM_LOOP | {"span": span}) for span in spans}
    strains = model.upstream_strain, model.downstream_strain
    controllers = {
        span: tension_controller(each.bandwidth_rad_per_s, each.correction_limit_m_s, model, span, strains)
        for span, each in configs.items()
    }
    loops = {span: KnownTension(FILM_N, moduli[span]) for span in spans}
    rises_s = {span: configs[span].set_point_rise_s for span in spans}
    plan = FeedForwardTask(model, FILM_CYCLE_S, line_speed, loops, rises_s)
    line_speed.set(LINE_SPEED, 1.0)
    plan.rest(nothing, {})
    commands = dict.fromkeys(range(1, model.axis_count + 1), 1.0)
    for cycle in range(round((2.0 + duration_s + 4.0) / FILM_CYCLE_S)):
        for axis, command_m_s in commands.items():  # a cycle late, as the bus is
            stand.velocity(axis, command_m_s)
        now = stand.now
        line_speed.set(LINE_SPEED, min(max(1.0 + (cycle * FILM_CYCLE_S - 2.0) / duration_s, 1.0), 2.0))
        plan.before(nothing, {})
        speed_m_s = line_speed.present
        leads = {axis: plan.lead(axis).item() if feed_forward else 0.0 for axis in range(1, model.axis_count + 1)}
        commands = {model.axis_count: speed_m_s + leads[model.axis_count]}
        for span in reversed(spans):
            entering = model.upstream_strain if span == 1 else now[f"strain{span - 1}"]
            trajectory = record_at(plan.trajectory(span), TRAJECTORY)
            around = velocity_before(trajectory, speed_m_s, entering) if feed_forward else nan
            tension_N = now[f"F{span}_N"] * (1.0 + modulus_error)
            controller = record_at(controllers[span], CONTROLLER)
            speed_m_s = control(controller, True, speed_m_s, FILM_N, tension_N, moduli[span], FILM_CYCLE_S, around)
            commands[span] = speed_m_s + leads[span]
        stand.step()
    return stand.course()


# -- Kuhm, Knittel 2012 ----------------------------------------------------------------------------------

STORE_N, STORE_M_S, STORE_CYCLE_S = 300.0, 4.2, 0.002


def reel_change(
    *,
    feed_forward: bool = True,
    mass_error: float = 0.05,
    friction_error: float = -0.3,
    behind_takes: float = 0.0,
    ramp_s: float = 4.0,
    stands_s: float = 4.0,
) -> Course:
    """What comes in stops in 4 s, stands for 4 s and starts again in 4 s, while 4.2 m/s go out (figure 15, d to f).

    With feed-forward the force on the carriage has what its parts need, with so much of mass and friction wrong, and
    the speed changes with a bounded jerk; without it is that of the tension alone, at an even rate, as in the paper.
    `behind_takes`: as of `CarriageForce`.
    """
    model = load_model(FOLDER / "kuhm_2012.yaml")
    stand, (carriage,) = Stand(model, STORE_M_S, STORE_CYCLE_S), model.carriages
    station, told = carriage.station, CarriageForce(model, carriage, mass_error, friction_error, behind_takes)
    stop, start = Ramp(2.0, ramp_s, STORE_M_S, 0.0), Ramp(2.0 + ramp_s + stands_s, ramp_s, 0.0, STORE_M_S)
    incoming_m_s = STORE_M_S
    for cycle in range(round((start.start_s + ramp_s + 4.0) / STORE_CYCLE_S)):
        t_s = cycle * STORE_CYCLE_S
        stand.velocity(1, incoming_m_s)  # a cycle late, as the bus is
        stand.velocity(2, STORE_M_S)
        ramp = stop if t_s < start.start_s else start
        incoming_m_s, acceleration = ramp.at(t_s) if feed_forward else linear(ramp, t_s)
        if feed_forward:
            force_N = told.force_N(STORE_N, incoming_m_s, STORE_M_S, acceleration, 0.0)
            stand.line.set_input(f"force_{station.name}_N", force_N)
        stand.step()
    return stand.course()


def linear(ramp: Ramp, t_s: float) -> tuple[float, float]:
    """The same change at an even rate."""
    share = min(max((t_s - ramp.start_s) / ramp.duration_s, 0.0), 1.0)
    change = ramp.after_m_s - ramp.before_m_s
    return ramp.before_m_s + share * change, change / ramp.duration_s if 0.0 < share < 1.0 else 0.0


# -- the benches -----------------------------------------------------------------------------------------


def on_bench_pct(name: str, per: float, *changes: str) -> list[float]:
    """What the criteria of a config in bench_configs are about, in % of `per`."""
    with TemporaryDirectory() as folder:
        given = load_with_overrides(FOLDER.parent / f"{name}.yaml", bus=f"embedded:{name}", changes=changes)
        result = run_experiment(given, Path(folder), participants=Participants.IN_PROCESS).result
    return [100.0 * (criterion.value or inf) / per for criterion in result.criteria]


def koc_table(folder: Path, before_m_s: float, after_m_s: float) -> Path:
    """A table of the line's speed as the plant's PID of it answers a step of its reference, without limits."""
    rows = []
    for row in range(200):
        at_s = 0.02 * row
        share = 1.0 - exp(-0.5 * KOC_SPEED_RAD_S * at_s) * (1.0 - 0.5 * KOC_SPEED_RAD_S * at_s)
        rows.append(f"{at_s:g},{before_m_s + share * (after_m_s - before_m_s):.6f}")
    table = folder / f"to_{after_m_s:g}.csv"
    table.write_text("\n".join(["t_s,ramp:line_speed_m_s", *rows, ""]), encoding="utf-8")
    return table


def torque_mode_pct(*, feed_forward: bool) -> list[float]:
    """The largest deviation at each load cell, % of 15 N, of the bench whose reels are told torques.

    Without feed-forward the line's speed goes as the PID of the traction motor brings it, as in the paper.
    """
    name, changes = "koc_2002_torque", list[str]()
    with TemporaryDirectory() as kept:
        folder = Path(kept)
        if not feed_forward:
            changes = [f"controllers.{each}_tension.feed_forward=none" for each in ("unwinder", "winder")]
            for step, before_m_s, after_m_s in ((3, KOC_FAST, KOC_SLOW), (6, KOC_SLOW, KOC_FAST)):
                changes.append(f"steps.{step}={{table: {{file: {koc_table(folder, before_m_s, after_m_s)}}}}}")
        given = load_with_overrides(FOLDER.parent / f"{name}.yaml", bus=f"embedded:{name}", changes=changes)
        outcome = run_experiment(given, folder / "run", participants=Participants.IN_PROCESS)
        if outcome.result.faults:
            return [inf, inf]
        recording = read_recording(outcome.folder.recording)
    time_s = np.asarray(recording["t_s"])
    looked = (time_s >= 6.0) & (time_s < time_s[-1] - 3.1)  # from the first change until it is brought to rest
    cells_N = [np.asarray(recording[f"F_cell{number}_meas_N"])[looked] for number in (1, 2)]
    return [float(100.0 * np.max(np.abs(cell_N / KOC_N - 1.0))) for cell_N in cells_N]


def bench_rows() -> list[tuple[str, str, str, float]]:
    """Rows of the table."""
    alone = [f"controllers.{name}_tension.feed_forward=none" for name in ("unwinder", "winder")]
    ahead, pi = on_bench_pct("koc_2002", KOC_N), on_bench_pct("koc_2002", KOC_N, *alone)
    film_pct, store_pct = on_bench_pct("giannoccaro_2016", FILM_N), on_bench_pct("kuhm_2012", 100.0)
    in_4_s, stays = "controllers.store_position.feed_ramp_s=4.0", "controllers.store_position.force=null"
    faster_pct, alone_pct = on_bench_pct("kuhm_2012", 100.0, in_4_s), on_bench_pct("kuhm_2012", 100.0, in_4_s, stays)
    torqued, torqued_ahead = torque_mode_pct(feed_forward=False), torque_mode_pct(feed_forward=True)
    return [
        ("Koç 2002 on a bench, reels in torque mode", "winder's load cell, PID", "75", torqued[1]),
        ("", "unwinder's load cell, PID", "50 to 70", torqued[0]),
        ("", "winder's load cell, feed-forward", "4 (LPV × radius)", torqued_ahead[1]),
        ("", "unwinder's load cell, feed-forward", "–", torqued_ahead[0]),
        ("Koç 2002 on a bench, all axes by speeds", "before the winder, feed-forward", "4 (LPV × radius)", ahead[1]),
        ("", "behind the unwinder, feed-forward", "–", ahead[0]),
        ("", "before the winder, PI around speeds", "75 (PID, torques)", pi[1]),
        ("", "behind the unwinder, PI around speeds", "50 to 70 (PID, torques)", pi[0]),
        ("Giannoccaro 2016 on a bench", "all spans, in 1 s", "17 (1 to 1.5 m/s in 1 s)", max(film_pct)),
        ("Kuhm 2012 on a bench", "behind, force that stays, in 4 s", "30", alone_pct[1]),
        ("", "first strand, force that stays, in 4 s", "–", alone_pct[0]),
        ("", "before and behind, shared, in 4 s, standing 4 s", "–", max(faster_pct[:2])),
        ("", "before and behind, shared, in 6.5 s, standing 1.5 s", "–", max(store_pct[:2])),
        ("", "behind the next roller", "–", store_pct[2]),
    ]


# -- the table -------------------------------------------------------------------------------------------


def table() -> list[list[str]]:
    """Published deviations beside those of the same line here, % of the set-point."""
    pid, ahead = koc_pid(), koc_feed_forward()
    cells = ((1, 2), (3, 4))
    rows = [
        ("Koç 2002, speed 130 to 70 m/min and back", "winder's load cell, PID", "75", pid.cell_pct(cells[1], KOC_N)),
        ("", "unwinder's load cell, PID", "50 to 70", pid.cell_pct(cells[0], KOC_N)),
        ("", "winder's load cell, feed-forward", "4 (LPV × radius)", ahead.cell_pct(cells[1], KOC_N)),
        ("", "unwinder's load cell, feed-forward", "–", ahead.cell_pct(cells[0], KOC_N)),
    ]
    courses = {duration_s: film(duration_s) for duration_s in (1.0, 2.0)}
    for duration_s, course in courses.items():
        worst = max(course.deviation_pct(span, FILM_N, SETTLED_S) for span in (1, 2, 3))
        first = "" if rows[-1][0].startswith("Gia") else "Giannoccaro 2016, 1 to 2 m/s"
        rows.append((first, f"all spans, in {duration_s:g} s", "17 (1 to 1.5 m/s in 1 s)", worst))
    even, changed = reel_change(feed_forward=False), reel_change()
    rows += [
        ("Kuhm 2012, reel change at 4.2 m/s", "behind, force of the tension alone", "30", even.behind_pct(STORE_N)),
        ("", "behind, feed-forward", "–", changed.behind_pct(STORE_N)),
        ("", "before, feed-forward", "–", changed.changed_pct(1)),
    ]
    for ramp_s, stands_s in ((4.0, 4.0), (6.0, 2.0)):
        shared = reel_change(behind_takes=0.5, ramp_s=ramp_s, stands_s=stands_s)
        what = f"before and behind, shared, in {ramp_s:g} s, standing {stands_s:g} s"
        rows.append(("", what, "–", max(map(shared.changed_pct, (1, shared.tensions_N.shape[1])))))
    rows += bench_rows()
    lines, name = [], ""
    for line, what, published, found in rows:
        name = line or name
        lines.append([name, what, published, f"{found:.2g}"])
    return lines


def summary(rows: list[docs_page.Row]) -> str:
    """Lines by their rows of which the papers have a figure."""
    known = [row for row in rows if row["published, %"] != "–"]
    lines = []
    for line in dict.fromkeys(row["line"] for row in known):
        of = [row for row in known if row["line"] == line]
        pairs = dict.fromkeys((row["published, %"], row["here, %"]) for row in of)
        lines.append([line, *("; ".join(values) for values in zip(*pairs, strict=True))])
    return docs_page.markdown(("line", "published, %", "here, %"), lines)


TABLE = docs_page.Table("published_lines", "lines.md", ("line", "tension", "published, %", "here, %"), summary)


def main() -> None:
    """Print the table, write it into a page, or draw the lines."""
    parser = argparse.ArgumentParser(description="published web lines here")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw the lines there instead")
    given = parser.parse_args()
    if given.pictures is not None:
        for name in ("koc_2002", "giannoccaro_2016", "kuhm_2012"):
            line = drawing(load_model(FOLDER / f"{name}.yaml"), LineNotes())
            given.pictures.joinpath(f"{name}.svg").write_bytes(line.as_file("svg"))
        return
    rows = table()
    print(docs_page.markdown(TABLE.columns, rows))
    if given.write:
        TABLE.write(rows)


if __name__ == "__main__":
    main()
