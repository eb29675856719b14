"""The job that docs/ci.md shows, run in the guest as it stands there.

What needs a network (*Install*, and what is not a command) is left out: the guest has hilbench, and no network. The
config is a shorter one, by the job's own variable. On a machine with CAN of its own the job's `vcan0` may be in use.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.skipif("HILBENCH_GUEST" not in os.environ, reason="its vcan0 may be somebody's: only in the guest"),
]

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "ci.md"
CONFIG = "tests/vcan/step_change.yaml"


def job() -> dict[str, Any]:
    [text] = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    workflow: dict[str, Any] = yaml.safe_load(text)
    [made] = workflow["jobs"].values()
    return dict(made)


@pytest.fixture
def runner(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of the job's steps; vcan0 is not there before, and is again afterwards."""
    if shutil.which("sudo") is None:  # the guest's tests are root
        stand_in = tmp_path / "sudo"
        stand_in.write_text('#!/bin/sh\nexec "$@"\n')
        stand_in.chmod(0o755)
    path = os.pathsep.join([str(tmp_path), str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run(["ip", "link", "delete", "vcan0"], check=True)
    yield {**os.environ, **job()["env"], "CONFIG": str(ROOT / CONFIG), "PATH": path}
    subprocess.run(["ip", "link", "add", "dev", "vcan0", "type", "vcan"], capture_output=True, check=False)
    subprocess.run(["ip", "link", "set", "vcan0", "up", "txqueuelen", "1000"], check=True)


def test_the_job_of_the_page_passes(runner: dict[str, str], tmp_path: Path) -> None:
    steps = {step["name"]: step["run"] for step in job()["steps"] if "run" in step}
    assert list(steps) == ["Install", "A CAN bus", "The experiment"]
    for name in ("A CAN bus", "The experiment"):
        with (tmp_path / "said").open("w") as said:  # no pipe: what a failed step leaves running would hold it open
            done = subprocess.run(
                ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", steps[name]],  # as the runner starts it
                cwd=tmp_path,
                env=runner,
                stdout=said,
                stderr=subprocess.STDOUT,
                check=False,
            )
        assert done.returncode == 0, f"{name}: {(tmp_path / 'said').read_text()}"
    [run] = (tmp_path / "runs").iterdir()
    assert (run / "result.xml").read_text().count("<testsuite") >= 1
    kept = next(step for step in job()["steps"] if "upload-artifact" in step.get("uses", ""))["with"]["path"].split()
    assert all((tmp_path / path).exists() for path in kept)
