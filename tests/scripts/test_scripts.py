"""Bench for scripts and the pytest plugin, by the examples of docs/scripts.md."""

from __future__ import annotations

import re
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import read_recording
from hilbench.results.result import Result

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "scripts.md").read_text(encoding="utf-8")
SCRIPT, NOTEBOOK, TEST = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"


def test_the_package_itself_imports_nothing_heavy():
    code = (
        "import sys, hilbench, hilbench.apps.scripts.pytest_plugin; print({'numpy', 'can', 'numba'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.slow
def test_the_script_of_the_page_finds_the_step_and_its_recording_is_a_data_frame(capsys: pytest.CaptureFixture[str]):
    script = SCRIPT.replace("embedded:script", f"embedded:t{uuid.uuid4().hex[:10]}")
    names: dict[str, Any] = {}
    exec(script.replace("bench_configs/web_section_step.yaml", str(CONFIG)), names)
    assert re.fullmatch(r"found: True, after 0\.\d\d s\n", capsys.readouterr().out)
    frame = names["bench"].recording.to_pandas()
    assert frame["E_sim_Pa"].iloc[-1] == pytest.approx(frame["E_true_Pa"].iloc[-1], rel=1e-2)
    assert (frame.index.name, frame.attrs["units"]["E_sim_Pa"]) == ("t_s", "Pa")
    data = names["bench"].recording.to_xarray()
    assert data["E_sim_Pa"].sel(t_s=frame.index[-1]).item() == frame["E_sim_Pa"].iloc[-1]
    assert (data["E_sim_Pa"].attrs["units"], data["t_s"].attrs["units"]) == ("Pa", "s")


@pytest.mark.slow
def test_the_test_of_the_page_passes_and_its_bench_can_be_changed(pytester: pytest.Pytester):
    mark = "import pytest\n\n@pytest.mark.hilbench_set('controllers.tension_control.set_point_N=90')\n"
    pytester.makepyfile(f"{mark}{TEST}    assert response.recording['F_ref_N'][-1] == 90.0\n")
    result = pytester.runpytest_subprocess(f"--hilbench-config={CONFIG}", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=1)


def test_without_a_config_the_fixture_says_what_is_missing(pytester: pytest.Pytester):
    pytester.makepyfile("def test_it(bench):\n    pass\n")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*--hilbench-config FILE*"])


FAILING = """
import pytest

def test_that_fails(bench):
    bench.run(0.1)
    assert bench.time_s > 100.0, "too short"

@pytest.mark.hilbench_set("master.boot_timeout_s=0.001")
def test_that_cannot_start(bench):
    pass

def test_that_passes(bench):
    bench.run(0.1)
"""


@pytest.mark.slow
def test_each_bench_leaves_its_run_folder_and_a_failure_names_it(pytester: pytest.Pytester):
    pytester.makepyfile(FAILING)
    result = pytester.runpytest_subprocess(
        f"--hilbench-config={CONFIG}", "-p", "no:cacheprovider", "--hilbench-out=left", "--junit-xml=junit.xml"
    )
    result.assert_outcomes(passed=1, failed=1, errors=1)
    folders = {re.sub(r"-\d{8}-\d{6}.*", "", path.name): path for path in sorted((pytester.path / "left").iterdir())}
    failed, broken, passed = (
        folders[name] for name in ("test_that_fails", "test_that_cannot_start", "test_that_passes")
    )
    text = result.stdout.str()
    assert f"run folder: {failed.relative_to(pytester.path)}" in text
    assert f"run folder: {broken.relative_to(pytester.path)}" in text
    assert str(passed.name) not in text
    results = {path: Result.read(path / "result.json") for path in (failed, broken, passed)}
    assert [results[path].passed for path in (failed, broken, passed)] == [False, False, True]
    (criterion,) = results[failed].criteria
    assert (criterion.name.rpartition("::")[2], criterion.passed) == ("test_that_fails", False)
    assert "too short" in (criterion.reason or "")
    assert results[failed].faults == []
    assert "did not" in results[broken].faults[0].text or "no answer" in results[broken].faults[0].text
    assert (failed / "report.html").exists()
    assert not (passed / "report.html").exists()
    for folder in (failed, passed):
        assert {"config.yaml", "trace.log", "journal.log", "recording.mf4"} <= {path.name for path in folder.iterdir()}
    cases = {case.get("name"): case for case in ElementTree.parse(pytester.path / "junit.xml").iter("testcase")}
    named = {name: [prop.get("value") for prop in case.iter("property")] for name, case in cases.items()}
    assert named["test_that_passes"] == [str(passed.relative_to(pytester.path))]


def test_a_script_leaves_a_run_folder_where_it_is_asked_to(tmp_path: Path):
    options = {"participants": Participants.IN_PROCESS, "out": tmp_path}
    bench, broken = Bench(CONFIG, **options), Bench(CONFIG, **options)

    def fails() -> None:
        with bench:
            bench.step("tension_control.set_point_N", 90.0)
            bench.run(0.1)
            raise AssertionError("not so")

    with pytest.raises(AssertionError):
        fails()
    assert bench.folder is not None
    result = Result.read(bench.folder.result)
    assert [(row.name, row.passed, row.reason) for row in result.criteria] == [("script", False, "not so")]
    recovered = read_recording(bench.folder.recording)
    assert np.array_equal(recovered["F_ref_N"], bench.recording["F_ref_N"])
    with pytest.raises(ZeroDivisionError), broken:
        raise ZeroDivisionError("of the script")
    assert broken.folder is not None
    assert "of the script" in Result.read(broken.folder.result).faults[0].text
    with Bench(CONFIG, participants=Participants.IN_PROCESS) as without:
        assert without.folder is None
    assert len(list(tmp_path.iterdir())) == 2
