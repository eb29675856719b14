"""The tension of bench_configs/compensated_rollers.yaml before and after compensation: what is left turn by turn.

    python tools/compensation.py                                        print the swing of the true tension
    python tools/compensation.py --picture docs/images/compensation.svg draw the true tension, too

The runs are those of the config in one process, at its first speed, with and without `controllers: compensate`. Swing:
from peak to peak in a turn of the rollers.
"""

from __future__ import annotations

import argparse
from math import tau
from pathlib import Path

import numpy as np

from hilbench.apps.report.chart import BLUE, VERMILLION, Chart, Curve
from hilbench.apps.report.plots import Picture, drawn
from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import Recording

CONFIG = Path(__file__).resolve().parents[1] / "bench_configs" / "compensated_rollers.yaml"
SPEED_M_S, RAMP_S, TURNS = 3.0, 4.0, 24


def run(*changes: str) -> tuple[Recording, float]:
    """Recording up to some turns after the ramp, and how long a turn takes."""
    bench = Bench(CONFIG, changes=changes, participants=Participants.IN_PROCESS)
    turn_s = tau * bench.config.web_line.radius_m(1) / SPEED_M_S
    with bench:
        bench.ramp("line_speed_m_s", SPEED_M_S, duration_s=RAMP_S)
        bench.run(TURNS * turn_s)
    return bench.recording, turn_s


def main() -> None:
    """Run, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the picture there (SVG)")
    path = parser.parse_args().picture
    curves = []
    for name, colour, changes in (
        ("without", VERMILLION, ["controllers.compensate=[]"]),
        ("compensated", BLUE, []),
    ):
        recording, turn_s = run(*changes)
        turns, tension_N = (recording.time_s - RAMP_S) / turn_s, recording["F_true_N"]
        swings_N = [np.ptp(tension_N[(turns >= turn) & (turns < turn + 1)]) for turn in range(TURNS)]
        print(f"{name}: {' '.join(f'{swing:.2g}' for swing in swings_N)} N")
        shown = turns >= 0.0
        curves.append(Curve(name, recording.time_s[shown], tension_N[shown], colour, 1.0))
    if path is not None:
        chart = Chart("true tension, N", curves)
        path.write_bytes(drawn(Picture("compensation", "Tension with eccentric rollers", "", [chart])).as_file("svg"))


if __name__ == "__main__":
    main()
