"""Bench for scripts and the pytest plugin, by the examples of docs/scripts.md."""

from __future__ import annotations

import re
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "scripts.md").read_text(encoding="utf-8")
SCRIPT, NOTEBOOK, TEST = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"


def test_the_package_itself_imports_nothing_heavy():
    code = "import sys, hilbench, hilbench.scripts.pytest_plugin; print({'numpy', 'can', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_script_of_the_page_finds_the_step_and_its_recording_is_a_data_frame():
    script = SCRIPT.replace("embedded:script", f"embedded:t{uuid.uuid4().hex[:10]}").replace(
        "bench_configs/web_section_step.yaml", str(CONFIG)
    )
    shown = "print(bench.recording.to_pandas()[['E_true_Pa', 'E_sim_Pa']].iloc[-1].round(-8).tolist())"
    done = subprocess.run([sys.executable, "-c", script + shown], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found, last = done.stdout.splitlines()
    assert re.fullmatch(r"found: True, after 0\.\d\d s", found)
    assert last == "[10500000000.0, 10500000000.0]"


def test_the_test_of_the_page_passes_and_its_bench_can_be_changed(pytester: pytest.Pytester):
    changed = (
        "import pytest\n@pytest.mark.hilbench_set('tension_control.set_point_N=90')\n"
        "def test_changed(bench):\n    assert bench.cycle().F_ref_N == 90.0\n"
    )
    pytester.makepyfile(TEST + changed)
    result = pytester.runpytest_subprocess(f"--hilbench-config={CONFIG}", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=2)


def test_without_a_config_the_fixture_says_what_is_missing(pytester: pytest.Pytester):
    pytester.makepyfile("def test_it(bench):\n    pass\n")
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*--hilbench-config FILE*"])
