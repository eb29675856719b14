"""A twin whose nodes somebody stops, starts or resets, or that does not answer: the cycles go on, the loop holds."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.bench.strangers import Plan, from_sync, on_the_bus
from tests.bench.whole_runs import config
from tests.tiers import slow

from hilbench.bench.lifecycle.participants import Participants
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus
from hilbench.canopen.eds import load_eds
from hilbench.canopen.master import Master
from hilbench.exchange.sync_cycle import SyncCycle
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

SPEED_M_S = 1.0
STEPS = [
    {"ramp": {"path": "line_speed_m_s", "to": SPEED_M_S, "duration_s": 0.4}},
    {"wait_until": {"condition": "loop_closed < 1", "timeout_s": 60.0}},
    {"wait_until": {"condition": "loop_closed > 0", "timeout_s": 60.0, "for_s": 0.5}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]
START, STOP, RESET = 1, 2, 129


def command(number: int, node_id: int) -> Frame:
    return Frame(0x000, bytes((number, node_id)))


def run(folder: Path, *plans: Plan, **changes: object) -> tuple[int, Result, Recording]:
    safety = {"cycle_timeout_s": 1.0}
    loaded = load_with_overrides(config(folder, **({"steps": STEPS, "safety": safety} | changes)))
    with on_the_bus(*plans):
        outcome = run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS)
    return outcome.exit_code, outcome.result, read_recording(outcome.folder.recording)


@pytest.mark.parametrize(
    ("numbers", "node_id"),
    [([STOP], 32), *slow(([STOP], 17), ([RESET], 32), ([RESET], 18), ([STOP, START], 32))],
    ids=["stop io", "stop axis", "reset io", "reset axis", "stop and start io"],
)
def test_a_twin_whose_nodes_somebody_commands_is_taken_back(tmp_path: Path, numbers: list[int], node_id: int) -> None:
    code, result, found = run(tmp_path, from_sync(600, *(command(number, node_id) for number in numbers), until=601))
    told = "; ".join(result.all_warnings())
    assert code == 0, (told, result.faults)
    assert "tension loop open, axis 1 follows the ratio of speeds: " in told
    assert "tension loop closed again" in told
    assert found["twin_age_cycles"][-1] == 0
    assert np.max(np.abs(np.asarray(found["F_true_N"]) - 80.0)) < 30.0


@pytest.mark.slow
def test_a_twin_that_never_comes_back_holds_up_no_cycle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stops: list[float] = []
    before = [time.monotonic()]
    cycle = SyncCycle.exchange

    def watched(self: SyncCycle, outgoing: Sequence[Frame], *, may_be_left_out: bool = False) -> list[Frame]:
        began = time.monotonic()
        stops.append(began - before[0])
        frames = cycle(self, outgoing, may_be_left_out=may_be_left_out)
        before[0] = time.monotonic()
        return frames

    monkeypatch.setattr(SyncCycle, "exchange", watched)
    steps = [
        {"ramp": {"path": "line_speed_m_s", "to": SPEED_M_S, "duration_s": 0.4}},
        {"hold": {"duration_s": 6.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
    ]
    stopped = from_sync(600, *(command(STOP, node_id) for node_id in (17, 18, 32)))
    code, result, found = run(tmp_path, stopped, steps=steps, master={"sdo_timeout_s": 0.2, "boot_timeout_s": 60.0})
    assert code == 0
    assert not found["loop_closed"][-1]
    assert len([text for text in result.all_warnings() if "tension loop open," in text]) == 1
    # It was tried again and again beside thousands of cycles. The drives take a bench for dead after 5 s without SYNC.
    assert len(stops) > 3000
    assert max(stops) < 4.0
    assert np.max(np.abs(np.asarray(found["F_true_N"]) - 80.0)) < 30.0


def test_a_node_that_does_not_answer_holds_up_no_transfer_with_another() -> None:
    bus = MemoryBus()
    answering = bus.open_link()
    master = Master(bus.open_python_can(), sdo_timeout_s=30.0)
    eds = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"
    for node_id in (1, 2):
        master.add(node_id, load_eds(eds, node_id), f"node{node_id}")
    waits = threading.Thread(target=lambda: master.wait_for_answer([1], 0.0), daemon=True)
    waits.start()
    while not any(frame.can_id == 0x601 for frame in answering.receive(0.1)):
        pass
    reads: list[object] = []
    other = threading.Thread(target=lambda: reads.append(master.sdo_read(2, 0x1000)), daemon=True)
    other.start()
    while not any(frame.can_id == 0x602 for frame in answering.receive(0.1)):
        assert waits.is_alive()
    answering.send([Frame(0x582, bytes.fromhex("4300100092010000"))])
    other.join(20.0)
    assert reads == [0x192]
    assert waits.is_alive()
    answering.send([Frame(0x581, bytes.fromhex("4300100092010000"))])
    waits.join(20.0)
    master.close()
