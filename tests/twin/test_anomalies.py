"""Break, slip and change of E of the imitated web, told apart by the twin on the bus."""

from __future__ import annotations

from pathlib import Path

import yaml
from tests.bench.test_runs import config, run, run_folders
from tests.bench.test_safety import result_of

from hilbench.record.trace import TraceReader
from hilbench.twin.plausibility import Problem

AT_SPEED = [
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
    {"hold": {"until_s": 1.5}},
]
WITHIN_CYCLES = 100


def emergencies(folder: Path) -> list[int]:
    """Error codes of the twin's EMCY messages."""
    frames = TraceReader(folder / "trace.log")
    return [int.from_bytes(data[:2], "little") for can_id, data, _ in frames if can_id == 0x0A0]


def test_a_web_break_is_told_within_200_ms_and_stops_the_line(tmp_path: Path) -> None:
    steps = [*AT_SPEED, {"step": {"path": "load.web.broken", "to": 1}}, {"hold": {"duration_s": 2.0}}]
    path = config(tmp_path, steps=steps)
    code, out, _ = run(path)
    folder = run_folders(path)[0]
    assert code == 3
    assert "web break" in out
    result = result_of(folder)
    assert result.faults[0].time_s is not None
    # The fault comes with the EMCY, which the bench has at the end of the same cycle.
    assert 1.5 < result.faults[0].time_s <= 1.5 + WITHIN_CYCLES * 0.002
    assert emergencies(folder)[0] == Problem.WEB_BREAK


def test_slip_is_told_and_changes_of_e_are_not_taken_for_it(tmp_path: Path) -> None:
    steps = [
        *AT_SPEED,
        {"hold": {"until_s": 2.4}},  # the web that was there at the start has left the span
        {"step": {"path": "load.web.youngs_modulus_Pa", "to": 6.5e9}},
        {"hold": {"until_s": 3.0}},
        {"step": {"path": "load.effects.elasticity_drift.rate_per_s", "to": 0.02}},
        {"hold": {"until_s": 4.8}},
        {"step": {"path": "load.effects.web_slip.creep_per_N", "to": 2e-6}},
        {"hold": {"until_s": 5.5}},
    ]
    path = config(tmp_path, steps=steps)
    data = yaml.safe_load(path.read_text())
    data["model"]["boundary"]["downstream_tension_N"] = 40.0  # creep goes by the difference of the tensions
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    assert run(path)[0] == 0
    folder = run_folders(path)[0]
    assert emergencies(folder)[0] == Problem.SLIP
    warnings = result_of(folder).warnings or []
    told = next(warning for warning in warnings if "EMCY FF16h: slip" in warning.text)
    # It takes a span's length of web to tell a slip from a change of E: 0.33 s.
    assert told.time_s is not None
    assert 4.8 < told.time_s < 4.8 + 0.6
    assert any("ratio of speeds is held: EMCY FF16h: slip" in warning.text for warning in warnings)
