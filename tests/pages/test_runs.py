"""The pages of the runs in a folder."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from hilbench.apps.pages.access import Access
from hilbench.apps.pages.runs import routes
from hilbench.apps.pages.server import site
from hilbench.results.result import Fault, Result, Timing
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import CriterionResult

HERE = "http://127.0.0.1:8321"
TIMING = Timing(
    pace="lockstep", cycle_us=2000.0, cycles=10, missed=0, jitter_us=None, realtime_factor=None, bus_load_pct=1.0
)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    return tmp_path / "runs"


@pytest.fixture
def client(base: Path) -> Iterator[TestClient]:
    access = Access("127.0.0.1", 8321)
    with TestClient(site(access, routes(base)), base_url=HERE) as client:
        client.post("/session", headers={"Authorization": access.token, "Origin": HERE})
        yield client


def run(base: Path, name: str, passed: bool = True, fault: Fault | None = None) -> RunFolder:
    folder = RunFolder.create(base, name)
    folder.config.write_text("name: x\n")
    criterion = CriterionResult(name="<b>tension</b>", value=1.0, limit="<= 2", unit="N", passed=passed)
    Result.of([criterion], {"E_noise_pct": 0.1}, TIMING, [] if fault is None else [fault]).write(folder.result)
    return folder


def test_every_run_is_listed_with_what_became_of_it(client: TestClient, base: Path) -> None:
    run(base, "good")
    run(base, "bad", passed=False)
    run(base, "stopped", fault=Fault(time_s=1.0, source="operator", text="interrupted"))
    run(base, "broken", fault=Fault(time_s=1.0, source="bench", text="no answer"))
    cut = RunFolder.create(base, "cut")
    cut.config.write_text("name: x\n")
    cut.trace.write_text("")
    os.utime(cut.trace, (0.0, 0.0))
    text = client.get("/runs").text
    for word in ("passed", "failed", "interrupted", "fault", "unfinished", "no answer", cut.name):
        assert word in text


def test_a_run_that_goes_on_is_said_to_run(client: TestClient, base: Path) -> None:
    folder = RunFolder.create(base, "now")
    folder.config.write_text("name: x\n")
    with open(folder.trace, "w") as trace:
        fcntl.flock(trace, fcntl.LOCK_EX)
        assert "running" in client.get("/runs").text
    os.utime(folder.trace, (0.0, 0.0))
    assert "running" not in client.get("/runs").text


def test_what_stands_in_a_file_is_text(client: TestClient, base: Path) -> None:
    run(base, "one", passed=False, fault=Fault(time_s=0.0, source="bench", text="<script>alert(1)</script>"))
    answer = client.get("/runs")
    assert "alert(1)" in answer.text
    assert "<script>alert" not in answer.text
    policy = answer.headers["content-security-policy"]
    assert "script-src 'sha256-" in policy
    assert "'unsafe-inline'" not in policy.partition("script-src")[2]


def test_a_report_can_not_act_for_who_reads_it(client: TestClient, base: Path) -> None:
    folder = run(base, "one")
    assert client.get(f"/runs/{folder.name}/report").status_code == 404
    folder.report.write_text("<p>report</p>")
    answer = client.get(f"/runs/{folder.name}/report")
    assert "report" in answer.text
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts;")
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy.replace("default-src 'none'", "")


def test_only_reports_of_runs_are_opened(client: TestClient, base: Path) -> None:
    run(base, "one")
    for folder in (base / "no_run", base.parent / "secret"):
        folder.mkdir()
        (folder / "report.html").write_text("secret")
    (base.parent / "secret" / "config.yaml").write_text("name: x\n")
    for name in ("no_run", "..%2fsecret", "%2e%2e/secret", "nothing"):
        answer = client.get(f"/runs/{name}/report")
        assert answer.status_code == 404, name
        assert "secret" not in answer.text


def test_a_result_that_can_not_be_read_hides_no_other_run(client: TestClient, base: Path) -> None:
    good, broken = run(base, "one"), run(base, "two")
    broken.result.write_text("{")
    text = client.get("/runs").text
    assert good.name in text
    assert broken.name in text


def test_no_folder_is_said(client: TestClient) -> None:
    answer = client.get("/runs")
    assert answer.status_code == 404
    assert "No runs" in answer.text
