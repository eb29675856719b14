"""What the page in the browser costs a bench, and how old what it shows is.

    python tools/page_cost.py

runs the demonstrator in lockstep with and without a page that has three viewers, in turns, and prints what the bench's
own process, the embedded bus' and the page's take of the processor in a cycle. Then it runs it in real time beside a
page with three viewers, and prints how old the picture of one is, at any moment. On a machine with much else to do
the figures are those of a machine with much else to do.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
from lockstep_profile import cpu_s, hub_pid
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

ROOT: Final = Path(__file__).resolve().parents[1]
CONFIG: Final = ROOT / "bench_configs" / "web_section_step.yaml"
VIEWERS: Final = 3
_SETTLE_CYCLES: Final = 1500


@dataclass
class Viewer:
    """A connection that reads what comes, and notes when of which SYNC it was told (s of the wall clock)."""

    socket: ClientConnection
    told: list[tuple[float, float]] = field(default_factory=list)

    def read(self) -> None:
        """Until the server ends."""
        try:
            for message in self.socket:
                if isinstance(message, str):
                    state: dict[str, Any] = json.loads(message)
                    if state.get("sync_s"):
                        self.told.append((time.time(), state["sync_s"]))
        except (OSError, ConnectionClosed):
            return

    def ages_s(self) -> np.ndarray[Any, Any]:
        """How old the picture was, every millisecond while the bench ran."""
        received, of = np.array(self.told).T
        received, of = received[of < of[-1]], of[of < of[-1]]
        at = np.arange(received[0], received[-1], 0.001)
        return np.asarray(at - of[np.searchsorted(received, at, side="right") - 1])


def syncs(folder: Path) -> int:
    """Cycles so far, by the trace of the only run in a folder."""
    traces = list(folder.glob("*/trace.log"))
    return traces[0].read_bytes().count(b" 080#") if traces else 0


@contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """A process that is ended in the end."""
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def page(stack: ExitStack, options: list[str], runs: Path) -> tuple[int, list[Viewer]]:
    """The process of a page, and its viewers."""
    command = [sys.executable, "-m", "hilbench", "monitor", str(CONFIG), *options, "--browser", "--port", "0"]
    process = stack.enter_context(
        ended(subprocess.Popen([*command, "--runs", str(runs)], stdout=subprocess.PIPE, text=True))
    )
    assert process.stdout is not None
    place = urlsplit(process.stdout.readline().removeprefix("page: ").strip())
    origin = Origin(f"http://{place.netloc}")
    connection = http.client.HTTPConnection(place.netloc)
    connection.request("POST", "/session", headers={"Authorization": f"Bearer {place.fragment}", "Origin": origin})
    cookie = str(connection.getresponse().headers["set-cookie"]).partition(";")[0]
    viewers = []
    for _ in range(VIEWERS):
        headers = {"Cookie": cookie}
        opening = connect(f"ws://{place.netloc}/live", origin=origin, additional_headers=headers, max_size=None)
        viewer = Viewer(stack.enter_context(opening))
        viewer.socket.send("{}")
        threading.Thread(target=viewer.read, daemon=True).start()
        viewers.append(viewer)
    return process.pid, viewers


def run(seconds: float, pace: str, with_page: bool) -> tuple[dict[str, float], list[Viewer]]:
    """Microseconds of the processor that each process takes in a cycle, and the viewers."""
    bus = f"page-cost-{os.getpid()}"
    steps = f"[{{ramp: {{path: line_speed_m_s, to: 3.0, duration_s: 1.0}}}}, {{hold: {{until_s: {seconds + 5.0}}}}}]"
    options = ["--bus", f"embedded:{bus}", "--pace", pace]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        runs = Path(folder)
        viewed = page(stack, options, runs) if with_page else None
        command = [sys.executable, "-m", "hilbench", "run", str(CONFIG), *options, "--out", folder]
        bench = subprocess.Popen(
            [*command, "--set", f"steps={steps}", "--set", "criteria=[]"], stdout=subprocess.DEVNULL, text=True
        )
        stack.enter_context(ended(bench))
        while syncs(runs) < _SETTLE_CYCLES and bench.poll() is None:
            time.sleep(0.2)
        pids = {"bench": bench.pid, "bus": hub_pid(bus) or bench.pid, **({"page": viewed[0]} if viewed else {})}
        if viewed:
            for viewer in viewed[1]:
                viewer.told.clear()
        first, before = syncs(runs), {name: cpu_s(pid) for name, pid in pids.items()}
        while (last := syncs(runs)) < first + round(seconds / 0.002) and bench.poll() is None:
            time.sleep(0.2)
        if bench.poll() is not None:
            print(f"the bench has ended after {last} cycles: exit code {bench.returncode}", file=sys.stderr)
            return {}, viewed[1] if viewed else []
        used = {name: 1e6 * (cpu_s(pid) - before[name]) / (last - first) for name, pid in pids.items()}
        return used, viewed[1] if viewed else []


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of bus time that each run is looked at")
    parser.add_argument("--turns", type=int, default=3)
    given = parser.parse_args()
    cost: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for _ in range(given.turns):
        for with_page in (False, True):
            cost[with_page].append(run(given.seconds, "lockstep", with_page)[0])
    print("processor time in a cycle of 2 ms (median of the turns), µs: without, with page")
    for name in ("bench", "bus", "page"):
        values = [
            statistics.median(each[name] for each in cost[w]) if name in cost[w][0] else None for w in (False, True)
        ]
        shown = ["-" if value is None else f"{value:.1f}" for value in values]
        more = "" if None in values else f"  {100 * (values[1] - values[0]) / 2000:+.2f} % of a cycle"  # type: ignore[operator]
        print(f"  {name:6} {shown[0]:>8} {shown[1]:>8}{more}")
    _, viewers = run(given.seconds, "realtime", True)
    ages_ms = 1e3 * np.concatenate([viewer.ages_s() for viewer in viewers])
    p50, p99 = np.percentile(ages_ms, [50, 99])
    figures = f"{p50:.0f} ms (median), {p99:.0f} ms (p99), {ages_ms.max():.0f} ms (largest)"
    print(f"age of the picture at 500 Hz, {VIEWERS} viewers: {figures}")
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
