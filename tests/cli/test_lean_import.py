"""What the processes of a bench import before they can run: it is most of the time until the first SYNC."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.tiers import slow

_CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
_PROGRAM = """if True:
    import sys
    import hilbench.bench.lifecycle.supervisor, hilbench.hardware.simulation
    import hilbench.twin.run, hilbench.apps.commands.run
    early = {"pandas", "asammdf", "scipy.linalg"} & set(sys.modules)
    assert not early, early
    import asammdf  # a recording is still written with it
    assert asammdf.MDF
"""


def test_a_bench_starts_without_the_libraries_of_recordings_and_of_its_check() -> None:
    ended = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(
    "module",
    [
        "canopen_tools.attach",
        "conformance.description",
        "conformance.examine",
        "devices.drive",
        "doctor.drift",
        "gateway.session",
        "monitor.changes",
    ],
)
def test_what_attaches_to_a_bus_loads_no_library_of_recordings(module: str) -> None:
    program = f"""if True:
        import sys
        import hilbench.apps.{module}
        early = {{"pandas", "asammdf"}} & set(sys.modules)
        assert not early, early
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


def test_the_help_of_all_commands_loads_nothing_of_a_bus() -> None:
    program = """if True:
        import sys
        from hilbench.apps.cli.main import main
        sys.argv = ["hilbench", "--help"]
        try:
            main()
        except SystemExit as ended:
            assert not ended.code, ended.code
        early = {"can", "canopen", "pandas"} & set(sys.modules)
        assert not early, early
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_command_that_runs_a_bench_with_processes_loads_neither_hardware_nor_what_one_process_runs_on() -> None:
    program = """if True:
        import sys
        import hilbench.apps.commands.run
        rooms = ("hilbench.in_process_cycle", "hilbench.hardware.")
        early = sorted(name for name in sys.modules if name.startswith(rooms))
        assert not early, early
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(("name", "other"), [("web_section_step", "servo_axis"), *slow(("servo_axis", "web_line"))])
def test_the_check_before_a_run_imports_no_scipy_and_nothing_that_only_others_need(name: str, other: str) -> None:
    program = f"""if True:
        import sys
        from pathlib import Path
        import hilbench.apps.commands.run
        from hilbench.bench.bench import Bench
        from hilbench.bench.lifecycle.participants import Participants
        from hilbench.bench.lifecycle.startup import copies_beside
        from hilbench.runs.check import check_experiment
        from hilbench.runs.config import load_with_overrides
        loaded = load_with_overrides(Path({str(_CONFIGS)!r}) / "{name}.yaml")
        check_experiment(loaded)
        with copies_beside(loaded.config, Participants.STARTED) as beside:
            assert beside
        Bench(loaded.config)
        assert "scipy.linalg" not in sys.modules
        of_others = "twin.machines.{other}", "bench.machines.{other}", "prediction.{other}"
        at_the_end = "apps.history.entries", "apps.report.html"
        early = {{f"hilbench.{{name}}" for name in (*of_others, *at_the_end)}} & set(sys.modules)
        assert not early, early
        print("numba.typed.typeddict" in sys.modules)
    """
    for _ in range(2):  # the first may have to compile
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
    assert done.stdout == "False\n", "what numba compiles with is loaded, although all is on disk"


@pytest.mark.slow
def test_the_first_compiled_call_does_not_import_scipy_and_a_product_of_matrices_can_still_be_compiled() -> None:
    program = """if True:
        import sys
        import numba, numpy
        from hilbench.plant.web_line.line_follower import LineFollower
        from hilbench.plant.web_line.parameters import ModelParameters
        web = {"youngs_modulus_Pa": 9e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0}
        data = {"web": web, "rollers": {"radius_m": 0.04, "inertia_kg_m2": 1e-3}}
        LineFollower(ModelParameters.model_validate(data))
        assert "scipy.linalg" not in sys.modules
        product = numba.njit(lambda a, b: numpy.dot(a, b))(numpy.eye(2), numpy.ones((2, 2)))
        assert (product == 1.0).all()
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
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
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_a_diagnosis_calculates_with_one_thread_a_product_unless_told_otherwise() -> None:
    """The library reads it once, when it is imported: nothing may have imported it before."""
    program = """if True:
        import os, sys
        import hilbench.apps.cli.main
        assert "numpy" not in sys.modules
        sys.argv = ["hilbench", "diagnose", "nowhere.csv"]
        try:
            hilbench.apps.cli.main.main()
        except SystemExit as end:
            assert end.code == 2
        assert "numpy" in sys.modules
        print(os.environ["OPENBLAS_NUM_THREADS"])
    """
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    for told, used in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")):
        command = [sys.executable, "-c", program]
        ended = subprocess.run(
            command, env=environment | told, capture_output=True, text=True, timeout=300, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert ended.stdout.strip() == used


def test_what_make_starts_keeps_the_bytecode_of_what_it_imports() -> None:
    """Else each of the processes of a run compiles all of hilbench anew, which takes as long as to import it."""
    ended = subprocess.run(
        ["make", "--silent", "--eval=shown: ; @env", "shown"],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert "PATH=" in ended.stdout
    assert "PYTHONDONTWRITEBYTECODE" not in ended.stdout
