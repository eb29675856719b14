"""What an operator changes in a running bench: in range, at once, in the journal; what is not, refused in a line."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import SHORT, config, recover, start, wait_for_frames
from tests.cli.in_process import hilbench

from hilbench.apps.monitor.changes import ChangeRequests
from hilbench.bench.operator.operator_objects import OperatorObjects
from hilbench.can.frame import Frame
from hilbench.can.open import open_python_can
from hilbench.canopen.sdo_client import SdoClient
from hilbench.exchange.master_node import MasterNode
from hilbench.results.recording import read_recording
from hilbench.runs.config import load

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "bench_configs" / "web_section_step.yaml"


def answered(requests: ChangeRequests, count: int) -> list[str]:
    said: list[str] = []
    deadline_s = time.monotonic() + 60.0
    while len(said) < count:
        time.sleep(0.05)
        said += requests.ended()
        assert time.monotonic() < deadline_s
    return said


@pytest.mark.slow
def test_changes_of_a_running_bench_are_recovered_with_the_run(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[SHORT[0], {"hold": {"duration_s": 1000.0}}])
    bench = load(path)[0]
    process = start(path)
    folder = wait_for_frames(path, 600)
    address = bench.bus_address.as_it_runs()
    requests = ChangeRequests(bench, lambda: SdoClient(open_python_can(address), 30.0))
    written = (folder / "journal.log").read_bytes().count(b"line_speed_m_s")
    for key, value in (("t", 95.0), ("m", 9000.0), ("v", 0.6), ("v", 50.0)):
        requests.ask(requests.changeable[key], value)
    said = answered(requests, 4)
    requests.close()
    read = hilbench(
        "sdo", "read", "127", "operator.tension_set_point_n", "--bus", address, "--eds", ROOT / "eds", "--json"
    )
    deadline_s = time.monotonic() + 60.0
    while (folder / "journal.log").read_bytes().count(b"line_speed_m_s") < written + 50:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    process.kill()
    process.communicate(timeout=60)
    assert said[:3] == [
        "tension set-point 95 N: set",
        "E of the emulated web 9000 N/mm²: set",
        "line speed 0.6 m/s: set",
    ]
    assert json.loads(read.stdout)["value"] == 95.0
    assert said[3] == "line speed 50 m/s: refused, expected -8 to 8 m/s (abort 06090031h)"
    assert recover(folder).returncode == 0
    found = read_recording(folder / "recording.mf4")
    assert (found["F_ref_N"][0], found["F_ref_N"][-1]) == (80.0, 95.0)
    assert (found["E_true_Pa"][0], found["E_true_Pa"][-1]) == (8.7e9, float(np.float32(9.0e9)))  # REAL32
    # The line goes to the new speed at the rate of the quick stop, 3 m/s², not in one step.
    assert np.max(np.abs(np.diff(found["v2_cmd_m_s"]))) <= 3.0 * 0.002 + 1e-6
    assert found["v2_cmd_m_s"].max() > found["v2_cmd_m_s"][-1]


def test_what_can_not_be_changed_now_is_no_number_or_is_no_object_is_refused() -> None:
    bench = load(SHIPPED)[0]
    objects = OperatorObjects(bench, lambda path: 3.0, lambda path: "line" not in path)
    node = MasterNode(bench.master.node_id, objects.store)

    def ask(data: str) -> str:
        node.handle([Frame(0x67F, bytes.fromhex(data)), Frame(0x601, bytes(8))])
        (answer,) = node.answers()
        assert answer.can_id == 0x5FF
        return answer.data.hex()

    assert ask("4000220100000000") == "4300220100004040"  # reads 3.0
    assert ask("2300220100004040") == "8000220122000008"  # not while the experiment moves it
    assert ask("230022020000c07f") == "8000220230000906"  # NaN
    assert ask("2300220400004040") == "8000220411000906"  # no such sub-index
    assert objects.changes() == []
    assert ask("2300220200004040") == "6000220200000000"
    assert objects.changes() == [("tension_control.set_point_N", 3.0)]
    assert objects.changes() == []
