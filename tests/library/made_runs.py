"""Run folders as runs leave them, made without a bench: a config, a result, a trace; by the hundred where wanted."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from hilbench.results.result import Environment, Fault, Result, Timing
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import CriterionResult

FIRST = datetime(2026, 3, 1, 8, 0, 0, tzinfo=UTC)


def made_run(
    base: Path,
    name: str = "web",
    *,
    number: int = 0,
    began: datetime | None = None,
    metrics: Mapping[str, float | None] | None = None,
    criteria: Sequence[CriterionResult] = (),
    faults: Sequence[Fault] = (),
    settings: Mapping[str, Any] | None = None,
    trace_bytes: int = 100,
    finished: bool = True,
) -> RunFolder:
    """One run; an hour after the one with the number before."""
    began = began or FIRST + timedelta(hours=number)
    folder = RunFolder.create(base, name, began.astimezone())
    folder.config.write_text(
        f"name: {name}\ndescription: made\n  for tests\nseed: {number}\npace: lockstep\nbus: {{}}\n"
    )
    folder.trace.write_bytes(b"x" * trace_bytes)
    if not finished:
        return folder
    timing = Timing(
        pace="lockstep", cycle_us=2000, cycles=1000, missed=0, jitter_us=None, realtime_factor=None, bus_load_pct=None
    )
    known = {"E_time_to_1pct_s": 0.1 + 0.01 * number, "E_noise_pct": 0.02} if metrics is None else dict(metrics)
    result = Result.of(criteria, known, timing, faults, Environment.here(number), began=began)
    data = json.loads(result.model_dump_json())
    data["provenance"] = {
        "config": f"bench_configs/{name}.yaml",
        "host": "stand7",
        "participants": "started",
        "overridden": [{"key": key, "value": value, "option": "--set"} for key, value in (settings or {}).items()],
        "git": {"commit": "c0ffee", "changed": False},
        "eds": [],
    }
    folder.result.write_text(json.dumps(data))
    return folder


def criterion(name: str, *, passed: bool = True, verifies: Sequence[str] = ()) -> CriterionResult:
    """The verdict on one criterion."""
    value = 0.1 if passed else 0.9
    return CriterionResult(name=name, value=value, limit="≤ 0.2", unit="s", passed=passed, verifies=list(verifies))
