"""A bench beside whose twin lies a config with another cycle: somebody has started it with that."""

from __future__ import annotations

import subprocess
import sys
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.whole_runs import config, run, run_folders, run_here

from hilbench.bench.lifecycle import in_process
from hilbench.canopen.host import HostedDevices
from hilbench.exchange.addressing import device_clock
from hilbench.processes import log
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.topology.config import BenchConfig
from hilbench.twin.bus_clock import BusClock
from hilbench.twin.process import TwinApplication, twin
from hilbench.twin.virtual_io import TwinStatus

CYCLE_S = 0.004
STEPS: list[dict[str, object]] = [
    {"hold": {"duration_s": 0.5}},
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 2.0}},
    {"hold": {"duration_s": 1.0}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
    {"hold": {"duration_s": 1.5}},
]
SAID = "EMCY FF19h: SYNC comes by another cycle than the twin's config has"
#: Of processes: the cycle of the bench, and as the config of the twin has it.
BY_THE_CLOCK_S, OF_TWIN_S = 0.02, 0.008
#: Before other processes, where that is permitted: what a twin makes of a SYNC that flutters is not asked here.
FIRST = ("--set", "realtime.priority=20")
SERVO = Path(__file__).resolve().parents[2] / "bench_configs" / "servo_axis.yaml"


@contextmanager
def twin_of(cycle_s: float) -> Iterator[None]:
    """The twin's config has this cycle, and its clock sees SYNC come every CYCLE_S: a run in lockstep is that each
    time."""
    made, before_sync = TwinApplication.__init__, TwinApplication.before_sync
    seen = {"ns": 0}

    def another(bench: BenchConfig) -> HostedDevices:
        return twin(bench.model_copy(update={"cycle_time_s": cycle_s}), device_clock(bench))

    def make(self: TwinApplication, bench: BenchConfig, *others: Any) -> None:
        made(self, bench, *others)
        self._clock = BusClock(bench.cycle_time_s, lambda: seen["ns"], self.device, log)

    def synced(self: TwinApplication, behind: int) -> None:
        seen["ns"] += round(1e9 * CYCLE_S)
        before_sync(self, behind)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_process, "twin", another)
        patch.setattr(TwinApplication, "__init__", make)
        patch.setattr(TwinApplication, "before_sync", synced)
        yield


def recorded(folder: Path, cycle_s: float) -> tuple[Recording, Result]:
    folder.mkdir()
    with twin_of(cycle_s):
        path = config(folder, steps=STEPS, cycle_time_s=CYCLE_S)
        code, _, said = run_here(path)
    assert code == 0, said
    (made,) = run_folders(path)
    return read_recording(made / "recording.mf4"), Result.read(made / "result.json")


def texts(result: Result) -> list[str]:
    """What it warns of."""
    return [warned.text for warned in result.warnings or ()]


@pytest.mark.slow
def test_the_loop_works_on_it_as_on_a_twin_whose_config_has_the_cycle_of_the_bench(tmp_path: Path) -> None:
    largest = []
    for folder, cycle_s in (("same", CYCLE_S), ("other", 0.002)):
        found, result = recorded(tmp_path / folder, cycle_s)
        settled = (found.time_s > 0.5) & (np.abs(found.time_s - 3.65) > 0.2)  # but for the step
        off_N = np.asarray(found["F_sim_N"]) - np.asarray(found["F_true_N"])
        error = np.asarray(found["E_sim_Pa"]) / np.asarray(found["E_true_Pa"]) - 1.0
        largest.append((np.max(np.abs(off_N)[settled]), np.max(np.abs(error)[settled])))
        assert np.all(np.asarray(found["loop_closed"])[settled])
    # At cycles of 4 ms load motors emulate a web that is up to 1 % another one while the line speeds up.
    assert np.array(largest[1]) == pytest.approx(largest[0], abs=0.5, rel=0.5)
    assert largest[1][1] < 0.015
    assert texts(result) == [f"{SAID}: 4 ms"]


@contextmanager
def started_by_hand(folder: Path, bus: str) -> Iterator[Path]:
    """Simulated hardware and twin by the clock, each with a cycle of its own; what the twin says."""
    with ExitStack() as ends:
        for command, cycle_s in (("simulate-hardware", BY_THE_CLOCK_S), ("twin", OF_TWIN_S)):
            words = [sys.executable, "-m", "hilbench", command, str(SERVO), "--bus", bus, "--pace", "realtime"]
            log = ends.enter_context((folder / f"{command}.log").open("w"))
            process = subprocess.Popen([*words, *FIRST, "--set", f"cycle_time_s={cycle_s}"], stdout=log, stderr=log)
            ends.callback(process.wait)
            ends.callback(process.terminate)
        yield folder / "twin.log"


@pytest.mark.slow
def test_a_twin_by_the_clock_says_once_that_it_goes_by_the_sync_of_its_bench_and_runs_on(tmp_path: Path) -> None:
    bus, speeds = f"embedded:t{uuid.uuid4().hex[:10]}", (30.0, 5.0, 30.0, 0.0)
    steps = ", ".join(f"{{ramp: {{path: speed_rad_s, to: {to}, duration_s: 2.0}}}}" for to in speeds)
    values = f"cycle_time_s={BY_THE_CLOCK_S}", f"steps=[{steps}]", "criteria=[]"
    given = [word for value in values for word in ("--set", value)]
    with started_by_hand(tmp_path, bus) as log:
        options = ["--bus", bus, "--pace", "realtime", "--no-start", "--no-report", "--out", str(tmp_path / "runs")]
        code, out, err = run(SERVO, *options, *FIRST, *given)
    assert code == 0, out + err
    (made,) = (tmp_path / "runs").iterdir()
    assert log.read_text().count("SYNC comes every 20 ms, cycle_time_s is 8 ms: the twin goes by SYNC") == 1
    of_twin = [each for each in Result.read(made / "result.json").warnings or () if "FF19h" in each.text]
    assert [(each.text, each.count) for each in of_twin] == [(f"{SAID}: 20 ms", 1)]
    found = read_recording(made / "recording.mf4")
    status = np.asarray(found["twin_status"]).astype(int)[found.time_s > (of_twin[0].time_s or 0.0)]
    assert np.all(status & TwinStatus.RUNNING > 0)
