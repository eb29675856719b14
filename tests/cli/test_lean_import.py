"""What the processes of a bench import before they can run: it is most of the time until the first SYNC."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_PROGRAM = """if True:
    import sys
    import hilbench.bench.lifecycle.supervisor, hilbench.hardware.simulation, hilbench.twin.run, hilbench.cli.run
    early = {"pandas", "asammdf", "scipy.linalg"} & set(sys.modules)
    assert not early, early
    import asammdf  # a recording is still written with it
    assert asammdf.MDF
"""


def test_a_bench_starts_without_the_libraries_of_recordings_and_of_its_check() -> None:
    ended = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_python_can_that_cannot_be_imported_leaves_the_libraries_of_recordings_alone(tmp_path: Path) -> None:
    (tmp_path / "can.py").write_text("raise ImportError('broken')\n")
    program = f"""if True:
        import sys
        sys.path.insert(0, {str(tmp_path)!r})
        finders = list(sys.meta_path)
        try:
            import hilbench.can.python_can
        except ImportError as error:
            assert str(error) == "broken"
        assert sys.meta_path == finders
        import asammdf
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_diagnosis_calculates_with_one_thread_a_product_unless_told_otherwise() -> None:
    """The library reads it once, when it is imported: nothing may have imported it before."""
    program = """if True:
        import os, sys
        import hilbench.cli.main
        assert "numpy" not in sys.modules
        os.environ.pop("OPENBLAS_NUM_THREADS", None)
        try:
            hilbench.cli.main.diagnose("nowhere.csv", None)
        except BaseException:
            pass
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr
