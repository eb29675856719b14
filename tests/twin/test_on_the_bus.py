"""The twin as a process on the bus: joining a running plant, changing the method, saying by EMCY what is wrong."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.bench.whole_runs import config, run_folders, run_here

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.estimation.web_line.config import METHODS
from hilbench.results.recording import Recording, read_recording
from hilbench.runs.config import load_with_overrides
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.virtual_io import TwinStatus

#: EMCY of node 32.
EMCY = " 0A0#"


def recorded(path: Path) -> Recording:
    code, _, said = run_here(path)
    assert code == 0, said
    return read_recording(run_folders(path)[0] / "recording.mf4")


def test_a_virtual_axis_has_the_torque_of_the_units_that_the_config_gives(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 0.5}}])
    changed = yaml.safe_load(path.read_text())
    for drive in changed["drives"].values():  # 5 N·m by the EDS file, of which 6072h allows three times
        drive["units"] = drive["virtual"]["units"] = {"rated_torque_Nm": 10.0}
    changed["machine"]["drives"]["torque_limit_Nm"] = 30.0
    changed["machine"]["rollers"]["inertia_kg_m2"] = 3.0
    changed["safety"] = {"limits": {"torque_Nm": {"warning": None, "trip": None}}}
    path.write_text(yaml.safe_dump(changed))
    found = recorded(path)
    assert np.max(found["tau2_Nm"]) > 17.0
    assert np.max(np.abs(found["tau2_sim_Nm"] - found["tau2_Nm"])[50:]) < 4.0


def test_a_twin_joins_a_running_plant_and_only_then_the_loop_closes(tmp_path: Path) -> None:
    steps = [
        {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
        {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
        {"hold": {"duration_s": 1.0}},
        {"restart_twin": {}},
        {"hold": {"duration_s": 2.5}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.5}},
    ]
    # The damping goes on beside the loop: what it makes of the encoders' noise would hide a bump.
    control = {"set_point_N": 80.0, "swing_damping_ratio": 0.0}
    found = recorded(config(tmp_path, steps=steps, controllers={"tension_control": control}))
    time_s, status = found.time_s, np.asarray(found["twin_status"]).astype(int)
    closed = np.asarray(found["loop_closed"]) > 0.5
    synchronized = (status & TwinStatus.SYNCHRONIZED) > 0
    # It closes only on a twin that is synchronized, at the start and after the restart.
    closes = np.flatnonzero(~closed[:-1] & closed[1:]) + 1
    assert np.all(synchronized[closes])
    opened = int(np.flatnonzero(closed[:-1] & ~closed[1:])[0]) + 1
    again = opened + int(np.argmax(closed[opened:]))
    # Not before a span has gone through (0.33 s): only then its strain is told from E.
    assert 0.33 < time_s[again] - time_s[opened] < 1.0
    settled = slice(again + 50, again + 250)
    error = np.asarray(found["E_sim_Pa"])[settled] / np.asarray(found["E_true_Pa"])[settled] - 1.0
    assert np.max(np.abs(error)) < 0.01
    # Bumpless: the command of axis 1 moves no faster when the loop closes than 1 mm/s in a cycle.
    v1 = np.asarray(found["v1_cmd_m_s"])
    assert np.max(np.abs(np.diff(v1[again - 3 : again + 4]))) < 1e-3


@pytest.mark.slow
def test_methods_change_places_under_way(tmp_path: Path) -> None:
    steps: list[dict[str, object]] = [{"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.5}}]
    methods = ("ekf", "lm", "global", "rls", "pid", "input", "changepoint")
    assert set(methods) == set(METHODS)
    for method in methods:
        steps += [{"synchronizer": {"method": method}}, {"hold": {"duration_s": 0.4}}]
    steps += [{"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.5}}]
    found = recorded(config(tmp_path, steps=steps))
    estimate, true = np.asarray(found["E_sim_Pa"]), np.asarray(found["E_true_Pa"])
    runs = found.time_s > 0.4
    assert np.max(np.abs(estimate / true - 1.0)[runs]) < 0.02


def test_standstill_under_dry_friction_is_told_by_emcy_and_taken_back(tmp_path: Path) -> None:
    friction = [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": 4.0}}]
    path = config(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["machine"]["effects"] = friction
    data["hardware"] = {**data.get("hardware", {}), "effects": friction}
    data["steps"] = [
        {"hold": {"duration_s": 0.3}},
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
        {"hold": {"duration_s": 0.6}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
    ]
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    found = recorded(path)
    lines = (run_folders(path)[0] / "trace.log").read_text().splitlines()
    said = [line.split(EMCY)[1][:6] for line in lines if EMCY in line]
    assert said[0] == "14FF21"  # error code FF14h, low byte first, and the error register
    assert said[1][:4] == "0000"
    status = np.asarray(found["twin_status"]).astype(int)
    speed = np.asarray(found["v2_m_s"])
    holding = (status & TwinStatus.HOLDING) > 0
    assert np.mean(holding[np.abs(speed) < 5e-4]) > 0.8
    assert not np.any(holding[speed > 0.1])
    moving = speed > 0.9
    assert np.asarray(found["E_sim_Pa"])[moving][-100:] == pytest.approx(8.7e9, rel=0.01)


def test_positions_that_are_for_once_a_cycle_old_are_no_web_break(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, received, said = AxisListener.decode, defaultdict[int, int](int), {}

    def late(self: AxisListener, data: bytes) -> tuple[float, float]:
        received[self.cob_id] += 1
        now = original(self, data)
        if received[self.cob_id] % 400 != 0:  # else what it said at the SYNC before
            said[self.cob_id] = now
        return said[self.cob_id]

    monkeypatch.setattr(AxisListener, "decode", late)
    with Bench(load_with_overrides(config(tmp_path)).config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 3.0, 1.0)
        bench.run(5.0)
        assert not [notice.text for notice in bench.notices if "web break" in notice.text]
        assert bench.last.E_sim_Pa == pytest.approx(bench.last.E_true_Pa, rel=0.01)
        bench.ramp("line_speed_m_s", 0.0, 1.0)
