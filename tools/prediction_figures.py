"""What docs/prediction.md shows of the shipped benches: how near predictions come, what they cost, and a picture.

    python tools/prediction_figures.py                                          print the tables
    python tools/prediction_figures.py --write                             write them into docs/tables and the page
    python tools/prediction_figures.py --picture docs/images/prediction.svg     draw the picture

The runs are those of bench_configs/predicted_limit.yaml and servo_predicted_limit.yaml in one process; the outlooks are
compared with what was recorded later.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import docs_page
import numpy as np

from hilbench.apps.report.chart import BLUE, INK, VERMILLION, Band, Chart, Curve
from hilbench.apps.report.plots import Picture, drawn
from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.prediction.create import look_of
from hilbench.bench.prediction.servo_axis import ShaftLook
from hilbench.bench.prediction.web_line import LineLook
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.outlook import Outlook
from hilbench.results.recording import Recording
from hilbench.results.recording_builder import Recorder
from hilbench.runs.config import load_with_overrides
from hilbench.runs.set_point_schedule import LookAhead
from hilbench.topology.sample import CycleSample

CONFIGS = Path(__file__).resolve().parents[1] / "bench_configs"
CONFIG = CONFIGS / "predicted_limit.yaml"
SERVO = CONFIGS / "servo_predicted_limit.yaml"


class Outlooks:
    """All outlooks of a run, as an observer of its cycles."""

    def __init__(self) -> None:
        self.found: list[Outlook] = []
        self.bench: Bench | None = None

    def sample(self, sample: CycleSample) -> None:
        """Keep the outlook if it is a new one."""
        assert self.bench is not None, "it is set before the bench is entered"
        prediction = self.bench.prediction
        outlook = prediction.outlook if prediction is not None else None
        if outlook is not None and (not self.found or self.found[-1] is not outlook):
            self.found.append(outlook)


def run(path: Path) -> tuple[Recording, list[Outlook]]:
    """A shipped experiment."""
    config = load_with_overrides(path, bus="embedded").config
    recorder, outlooks, look_ahead = Recorder(config.signals), Outlooks(), LookAhead(config)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(
            config, observers=[recorder, outlooks], participants=Participants.IN_PROCESS, work_folder=Path(folder)
        )
        outlooks.bench = bench
        with bench:
            for number, step in enumerate(config.steps):
                bench.foresee(look_ahead.plan(number, bench.time_s))
                step.run(bench, [])
    return recorder.recording(datetime.now(UTC), ""), outlooks.found


def errors(recording: Recording, outlooks: Sequence[Outlook]) -> list[list[str]]:
    """Rows: by quantity and lead, how far the median was off (root mean square), and how often the band held."""
    rows = []
    time_s = recording.time_s
    for place, watched in enumerate(outlooks[0].watched):
        values = recording[watched.signal]
        for lead_s in (0.5, 2.0, 5.0):
            off, held = [], []
            for outlook in outlooks:
                row = int(np.argmin(np.abs(outlook.times_s - outlook.now_s - lead_s)))
                at_s = outlook.times_s[row]
                if at_s > time_s[-1]:
                    continue
                came = float(np.interp(at_s, time_s, values))
                low, median, high = (course[row] for course in outlook.band(place))
                off.append(median - came)
                held.append(low <= came <= high)
            sizes = np.abs(off)
            within = (np.sqrt(np.mean(sizes**2)), np.quantile(sizes, 0.95))
            cells = [f"{value:.2g} {watched.unit}" for value in within]
            rows.append([watched.name, f"{lead_s:g} s", *cells, f"{100 * np.mean(held):.0f} %"])
    return rows


def summary(rows: list[docs_page.Row]) -> str:
    """By quantity: the largest error, its lead, and the least share that the band held."""
    lines = []
    for quantity in dict.fromkeys(row["quantity"] for row in rows):
        of = [row for row in rows if row["quantity"] == quantity]
        worst = max(of, key=lambda row: float(row[OFF].split()[0]))
        held = min((row[HELD] for row in of), key=lambda share: float(share.split()[0]))
        lines.append([quantity, f"{worst[OFF]} ({worst['lead']} ahead)", held])
    return docs_page.markdown(["quantity", "median off by at most, rms", "band of 90 % held, least"], lines)


OFF, HELD = "median off by, rms", "band of 90 % held"
COLUMNS = ("quantity", "lead", OFF, "95 % of the time within", HELD)
LINE_TABLE = docs_page.Table("prediction_errors", "prediction.md", COLUMNS, summary)
SERVO_TABLE = docs_page.Table("prediction_errors_servo", "prediction.md", COLUMNS, summary)


def look_at_rest(look: LineLook | ShaftLook) -> tuple[Callable[[], None], Callable[[], Outlook]]:
    """As `Look.prepare`, of a machine that stands."""
    if isinstance(look, LineLook):
        return look.futures.prepare(*look.futures.at_rest(), look.futures.no_offsets(), 1)
    return look.futures.prepare(*look.futures.at_rest(), look.futures.no_offsets(), 1)


def cost() -> str:
    """A table: time of 64 futures of 5 s on one core, of the compiled part and of all of it, the least of ten."""
    lines = ["| bench | step | 64 futures of 5 s, compiled | all of a look |", "|---|---|---|---|"]
    for name in ("web_section_step.yaml", "line_two_spans.yaml", "servo_axis.yaml"):
        look = look_of(load_with_overrides(CONFIGS / name).config, PredictionConfig())
        assert isinstance(look, LineLook | ShaftLook)
        futures = look.futures
        futures.warm_up()
        whole, compiled = [], []
        for _ in range(10):
            begin = time.thread_time()
            run_them, outlook = look_at_rest(look)
            prepared = time.thread_time()
            run_them()
            compiled.append(time.thread_time() - prepared)
            list(outlook().crossings())
            whole.append(time.thread_time() - begin)
        lines.append(
            f"| {name} | {1e3 * futures.step_s:.2g} ms | {1e3 * min(compiled):.1f} ms | {1e3 * min(whole):.1f} ms |"
        )
    return "\n".join(lines)


def picture(recording: Recording, outlooks: Sequence[Outlook]) -> bytes:
    """The outlook a second before the first step of E, and what came."""
    outlook = min(outlooks, key=lambda each: abs(each.now_s - 5.0))
    part = (recording.time_s > 3.0) & (recording.time_s < outlook.times_s[-1])
    time_s, charts = recording.time_s[part], []
    for signal, label in (("F_true_N", "tension, N"), ("tau2_Nm", "torque of axis 2, N·m")):
        place = outlook.place(signal)
        low, median, high = outlook.band(place)
        curves = [
            Curve("came", time_s, recording[signal][part], INK, 1.0, spread=signal == "tau2_Nm"),
            Curve("predicted at 5 s", outlook.times_s, median, BLUE, 1.4),
        ]
        limit = outlook.watched[place].warning
        if limit is not None and signal == "F_true_N":
            curves.append(Curve("warning", time_s, np.full(len(time_s), limit), VERMILLION, 1.0, (4.0, 3.0)))
        charts.append(Chart(label, curves, [Band(outlook.times_s, low, high, BLUE, 0.25)]))
    shown = drawn(Picture("prediction", "Prediction and what came", "", charts))
    return shown.as_file("svg")


def main() -> None:
    """Measure, and put it where it was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write prediction_errors*.csv and docs/prediction.md")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the picture there (SVG)")
    options = parser.parse_args()
    recording, outlooks = run(CONFIG)
    costs = cost()
    print(costs)
    for table, rows in ((LINE_TABLE, errors(recording, outlooks)), (SERVO_TABLE, errors(*run(SERVO)))):
        print(docs_page.markdown(table.columns, rows))
        if options.write:
            table.write(rows)
    if options.write:
        docs_page.put(docs_page.DOCS / LINE_TABLE.page, "cost", costs)
    if options.picture:
        options.picture.write_bytes(picture(recording, outlooks))


if __name__ == "__main__":
    main()
