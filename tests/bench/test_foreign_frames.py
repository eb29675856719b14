"""Somebody else on the bench's bus: a second sender, a second master, a stranger's SDO. Seen, told, not believed."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from tests.bench.strangers import STEPS, Plan, from_sync, on_the_bus
from tests.bench.whole_runs import ENDLESS, config, start, wait_for_frames
from tests.tiers import slow

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.open import open_link
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides


def run(folder: Path, *plans: Plan, **changes: object) -> tuple[int, Result, Recording]:
    """A short run with strangers on its bus."""
    folder.mkdir(exist_ok=True)
    loaded = load_with_overrides(config(folder, **({"steps": STEPS} | changes)))
    with on_the_bus(*plans):
        outcome = run_experiment(loaded, folder / "runs", participants=Participants.IN_PROCESS)
    return outcome.exit_code, outcome.result, read_recording(outcome.folder.recording)


def told(result: Result) -> list[tuple[str, str, int]]:
    prefix = "foreign frames, "
    return [
        (warning.source.removeprefix(prefix), warning.text, warning.count)
        for warning in result.warnings or []
        if warning.source.startswith(prefix)
    ]


def download(node_id: int, index: int, value: int, size: int, sub: int = 0) -> Frame:
    head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + bytes((sub,))
    return Frame(0x600 + node_id, head + value.to_bytes(4, "little"))


def after_the_answers(*frames: Frame) -> Plan:
    """A stranger that waits until the drives and the twin have answered: its frames come second."""
    return lambda sync, received: frames if sync >= 100 else ()


VELOCITY_0 = Frame(0x282, bytes(4))
DOUBLED_E = Frame(0x1A0, np.array([80.0, 17.4e9], "<f4").tobytes())


@pytest.mark.parametrize(
    ("frame", "who"),
    [(VELOCITY_0, "axis2 (node 2)"), *slow((DOUBLED_E, "virtual io (node 32)"))],
    ids=["drive", "twin"],
)
def test_a_second_sender_of_a_tpdo_is_told_and_what_comes_first_is_used(tmp_path: Path, frame: Frame, who: str) -> None:
    _, alone, true = run(tmp_path / "alone")
    assert told(alone) == []
    code, result, found = run(tmp_path / "two", after_the_answers(frame))
    assert code == 0
    ((about, text, count),) = told(result)
    assert about == who
    assert f"COB-ID {frame.can_id:03X}h" in text
    (trace,) = (tmp_path / "two").glob("**/trace.log")
    cycles = trace.read_bytes().count(b" 080#") - 99
    assert cycles - 2 <= count <= cycles
    # The stranger is queued behind the drives: nothing of what it says is believed.
    for name in ("v2_m_s", "E_sim_Pa", "F_sim_N", "F_true_N", "v1_cmd_m_s"):
        assert np.array_equal(found[name], true[name]), name


WRITES = {
    "6060h sub 0 'Modes of operation' = 8": download(1, 0x6060, 8, 1),
    "6085h sub 0 'Quick stop deceleration' = 1": download(2, 0x6085, 1, 4),
    "1016h sub 1": download(1, 0x1016, 0, 4, 1),
}


def test_parameters_of_drives_that_strangers_write_are_told_with_node_object_and_value(tmp_path: Path) -> None:
    _, result, _ = run(tmp_path, *(from_sync(200, frame, until=203) for frame in WRITES.values()))
    found = told(result)
    for text, frame in WRITES.items():
        node = frame.can_id - 0x600
        assert [(about, count) for about, said, count in found if text in said] == [(f"axis{node} (node {node})", 3)]
    assert len(found) == len(WRITES)


ONLY_OURS = {
    "SYNC (COB-ID 080h)": ("the bench", Frame(0x080, b"")),
    "heartbeat (COB-ID 77Fh)": ("the bench", Frame(0x77F, b"\5")),
    "RPDO (COB-ID 203h)": ("load (node 3)", Frame(0x203, bytes.fromhex("0f000000"))),
    "RPDO (COB-ID 220h)": ("virtual io (node 32)", Frame(0x220, bytes(8))),
    "NMT 'start'": ("axis2 (node 2)", Frame(0x000, b"\1\2")),
    "TPDO (COB-ID 181h) of a length other than 8 bytes": ("axis1 (node 1)", Frame(0x181, bytes(5))),
}


def test_what_only_the_bench_or_a_node_sends_is_told_when_somebody_else_does(tmp_path: Path) -> None:
    times = zip(range(200, 300, 10), ONLY_OURS.values(), strict=False)
    _, result, _ = run(tmp_path, *(from_sync(at, frame, until=at + 1) for at, (_, frame) in times))
    for text, (about, _) in ONLY_OURS.items():
        found = [row for row in told(result) if row[0] == about and text in row[1]]
        assert [row[2] for row in found] == [1], told(result)


@pytest.mark.parametrize(
    "plan",
    [after_the_answers(VELOCITY_0), from_sync(200, WRITES["1016h sub 1"]), from_sync(200, Frame(0x000, b"\1\0"))],
    ids=["second sender", "SDO", "NMT"],
)
def test_where_the_config_says_stop_foreign_frames_end_the_run(tmp_path: Path, plan: Plan) -> None:
    code, result, _ = run(tmp_path, plan, safety={"on_foreign_frames": "stop"})
    assert code == 3
    (fault,) = result.faults
    assert "foreign frames, " in fault.text
    assert "before that" not in fault.text
    assert fault.time_s is not None
    assert fault.time_s < 0.5


HARMLESS = {
    "read by SDO": Frame(0x601, bytes.fromhex("4041600000000000")),
    "request of an operator": Frame(0x67F, bytes.fromhex("230022020000a042")),
    "another node's SDO": Frame(0x605, bytes.fromhex("2b17100064000000")),
    "another node's NMT": Frame(0x000, b"\x80\x05"),
    "remote frame": Frame(0x181 | REMOTE_FLAG, b""),
    "29-bit identifier": Frame(0x201 | EXTENDED_FLAG, bytes(6)),
}


def test_what_does_no_harm_is_not_told_and_does_not_stop(tmp_path: Path) -> None:
    code, result, _ = run(tmp_path, from_sync(200, *HARMLESS.values()), safety={"on_foreign_frames": "stop"})
    assert told(result) == []
    assert code == 0


def test_what_the_bench_itself_does_by_sdo_and_nmt_is_its_own(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path, safety={"on_foreign_frames": "stop"}))
    with Bench(loaded.config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 0.5, 0.2)
        bench.step("hardware.effects.coulomb_friction.axis1.force_N", 20.0)
        bench.run(0.2)
        bench.use_synchronizer("rls")
        bench.restart_twin()
        bench.run(0.2)
        assert bench.get("hardware.effects.coulomb_friction.axis1.force_N") == 20.0
        bench.run(0.2)
    assert not [notice for notice in bench.notices if "foreign" in notice.source]


def test_a_fault_names_the_foreign_frames_that_came_before_it(tmp_path: Path) -> None:
    reset = from_sync(200, Frame(0x000, b"\x81\1"), until=201)
    code, result, _ = run(tmp_path, reset, safety={"cycle_timeout_s": 0.5})
    assert code == 3
    fault, cause = result.faults[0].text.split("; before that, ")
    assert "axis1 (node 1)" in fault
    assert "foreign frames, axis1 (node 1): NMT 'reset node'" in cause
    assert cause.startswith("from t = 0.3")


@pytest.mark.slow
def test_a_flood_of_writes_is_counted_and_bounded(tmp_path: Path) -> None:
    flood = [download(1, 0x2000 + number % 200, number, 4) for number in range(1000)]
    _, result, _ = run(tmp_path, from_sync(200, *flood, until=220))
    found = told(result)
    assert len(found) < 20
    assert sum(count for _, _, count in found) == 20 * len(flood)


@pytest.mark.slow
def test_a_stranger_beside_a_run_of_real_processes_is_in_its_result(tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS)
    process = start(path)
    folder = wait_for_frames(path, 500)
    link = open_link(load_with_overrides(path).config.bus_address.as_it_runs())
    for k in range(50):
        # Each another one: the same again could be a frame that CAN itself repeats, which is none of a stranger.
        velocity = Frame(VELOCITY_0.can_id, k.to_bytes(4, "little"))
        link.send([velocity, WRITES["1016h sub 1"], HARMLESS["read by SDO"]])
        link.receive(0.01)
    link.close()
    # A bench that is held up has not seen the last of them yet.
    wait_for_frames(path, (folder / "trace.log").read_bytes().count(b" 080#") + 20)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    found = {text.split(" '")[0]: count for _, text, count in told(Result.read(folder / "result.json"))}
    written = found.pop("SDO write by another station: 1016h sub 1")
    assert written == 50
    ((text, count),) = found.items()
    assert "TPDO (COB-ID 282h) more often than SYNC asks for it" in text
    assert 45 <= count <= 50
