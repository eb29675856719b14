"""Bench for scripts and the pytest plugin, by the examples of docs/scripts.md."""

from __future__ import annotations

import re
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "scripts.md").read_text(encoding="utf-8")
SCRIPT, NOTEBOOK, TEST = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"


def test_the_package_itself_imports_nothing_heavy():
    code = "import sys, hilbench, hilbench.scripts.pytest_plugin; print({'numpy', 'can', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


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


def test_the_test_of_the_page_passes_and_its_bench_can_be_changed(pytester: pytest.Pytester):
    mark = "import pytest\n\n@pytest.mark.hilbench_set('tension_control.set_point_N=90')\n"
    pytester.makepyfile(f"{mark}{TEST}    assert response.recording['F_ref_N'][-1] == 90.0\n")
    result = pytester.runpytest_inprocess(f"--hilbench-config={CONFIG}", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=1)


def test_without_a_config_the_fixture_says_what_is_missing(pytester: pytest.Pytester):
    pytester.makepyfile("def test_it(bench):\n    pass\n")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*--hilbench-config FILE*"])
