"""A bench beside whose twin lies a config with another cycle: somebody has started it with that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.whole_runs import config, run_folders, run_here

from hilbench.bench.lifecycle import in_process
from hilbench.canopen.bus_cycle import BusCycle
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.twin.process import TwinApplication, TwinSetup

CYCLE_S = 0.004
STEPS: list[dict[str, object]] = [
    {"hold": {"duration_s": 0.5}},
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 2.0}},
    {"hold": {"duration_s": 1.0}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
    {"hold": {"duration_s": 1.5}},
]
SAID = "EMCY FF19h: SYNC comes by another cycle than the twin's config has: 4 ms"


@contextmanager
def twin_of(cycle_s: float) -> Iterator[None]:
    """The twin's config has this cycle, and its clock sees SYNC come every CYCLE_S: a run in lockstep is that each
    time."""
    setup_of, made, before_sync = in_process.twin_setup, TwinApplication.__init__, TwinApplication.before_sync
    seen = {"ns": 0}

    def make(self: TwinApplication, setup: TwinSetup, *others: Any) -> None:
        made(self, setup, *others)
        self._bus_cycle = BusCycle(round(1e9 * setup.cycle_s), lambda: seen["ns"])

    def synced(self: TwinApplication, behind: int) -> None:
        seen["ns"] += round(1e9 * CYCLE_S)
        before_sync(self, behind)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(in_process, "twin_setup", lambda config: replace(setup_of(config), cycle_s=cycle_s))
        patch.setattr(TwinApplication, "__init__", make)
        patch.setattr(TwinApplication, "before_sync", synced)
        yield


def recorded(folder: Path, cycle_s: float) -> tuple[Recording, Result]:
    folder.mkdir()
    with twin_of(cycle_s):
        path = config(folder, steps=STEPS, cycle_time_s=CYCLE_S)
        code, _, said = run_here(path, "--no-report")
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
    # At cycles of 4 ms load motors imitate a web that is up to 1 % another one while the line speeds up.
    assert np.array(largest[1]) == pytest.approx(largest[0], abs=0.5, rel=0.5)
    assert largest[1][1] < 0.015
    assert texts(result) == [SAID]
