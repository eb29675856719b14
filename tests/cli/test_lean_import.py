"""What the processes of a bench import before they can run: it is most of the time until the first SYNC."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """if True:
    import sys
    import hilbench.bench.lifecycle.supervisor, hilbench.hardware.simulation, hilbench.twin.run, hilbench.cli.run
    assert "pandas" not in sys.modules and "asammdf" not in sys.modules
    import asammdf  # a recording is still written with it
    assert asammdf.MDF
"""


def test_a_bench_starts_without_the_libraries_of_recordings() -> None:
    ended = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr
