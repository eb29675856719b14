"""What `hilbench compile` leaves is found by everybody who runs hilbench, also by those who may only read it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib import import_module
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from tests.tiers import slow

from hilbench.cli.compile import modules_by_room
from hilbench.compiled import entry_points
from hilbench.kept_code import KeptCode
from hilbench.plant.web_line import kernel
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.offline import simulate, start_state
from hilbench.plant.web_line.parameters import ModelParameters

_MODULES = [name for modules in modules_by_room() for name in modules]
_USE = """if True:
    import sys
    import numpy as np
    from numba.core.caching import InTreeCacheLocator, UserWideCacheLocator
    def refuse(self):
        raise PermissionError(13, "read-only")
    for each in {refusing}:
        each.ensure_cache_path = refuse
    from hilbench.estimation import noise_level
    noise_level._take(np.zeros(8), 1.0)
    print(sum(noise_level._take.stats.cache_misses.values()))
"""


def _misses(refusing: str, home: Path) -> str:
    """How often a process compiles a function that was compiled before, where these places can't be written."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home)}
    command = [sys.executable, "-c", _USE.format(refusing=refusing)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True)
    return ended.stdout.strip()


@pytest.mark.parametrize("module", _MODULES)
def test_setup_compiles_each_function_that_python_calls_for_the_arguments_that_it_takes(module: str) -> None:
    found = entry_points(import_module(module))
    assert found
    for each in found:
        assert isinstance(each._cache, KeptCode)
        assert each.arguments, f"{each}: expected @entry_point(VECTOR, REAL, …), the types of its arguments"
        assert len(each.arguments) == len(signature(each.py_func).parameters), each


@pytest.mark.parametrize(
    "refusing", ["()", *slow("[InTreeCacheLocator]", "[InTreeCacheLocator, UserWideCacheLocator]")]
)
def test_who_may_only_read_hilbench_runs_what_was_compiled_when_it_was_installed(tmp_path: Path, refusing: str) -> None:
    _misses("()", tmp_path)
    assert _misses(refusing, tmp_path) == "0"
    assert not list(tmp_path.rglob("*.nbc"))


def test_variants_from_one_start_run_what_was_compiled_for_one() -> None:
    web = {"youngs_modulus_Pa": 9e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0}
    model = ModelParameters.model_validate({"web": web, "rollers": {"radius_m": 0.04, "inertia_kg_m2": 1e-3}})
    p = lay.pack(model)
    before = set(kernel.simulate.overloads)  # type: ignore[attr-defined]
    simulate(np.stack([p, p]), start_state(p, model), np.zeros((4, 2)), np.zeros((4, 2)), 0.002)
    assert set(kernel.simulate.overloads) - before <= {kernel.simulate.arguments}  # type: ignore[attr-defined]


def test_intermediate_code_is_read_when_something_is_compiled_with_a_function_and_not_to_call_it() -> None:
    program = """if True:
        import llvmlite.binding, numpy as np
        from hilbench.compiled import compiled
        from hilbench.estimation import noise_level
        read, parse = [], llvmlite.binding.parse_bitcode
        def noted(code, *context):
            read.append(len(code))
            return parse(code, *context)
        llvmlite.binding.parse_bitcode = noted
        one, other = np.zeros(8), np.zeros(8)
        for k in range(8):
            noise_level._take(one, 0.5 * k * k)
        assert not noise_level._take.stats.cache_misses
        assert max(read) < 5000, read  # that of the runtime
        @compiled
        def through(s, value):
            noise_level._take(s, value)
        for k in range(8):
            through(other, 0.5 * k * k)
        assert max(read) > 5000, read
        assert one.any() and one.tobytes() == other.tobytes()
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_process_neither_compiles_numbas_runtime_nor_loads_masked_arrays() -> None:
    program = """if True:
        import sys
        from numba.core.runtime import nrtdynmod
        import numpy as np
        from hilbench.estimation import noise_level
        def made(target):
            raise AssertionError("compiled, not loaded")
        nrtdynmod.create_nrt_module = made
        noise_level._take(np.zeros(8), 1.0)
        assert not noise_level._take.stats.cache_misses
        assert "numpy.ma" not in sys.modules
    """
    run = [sys.executable, "-c", "from hilbench.estimation import noise_level as n; n._take.compile(n._take.arguments)"]
    subprocess.run(run, timeout=300, check=True)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_bench_knows_whether_what_it_has_imported_is_compiled() -> None:
    program = """if True:
        import sys
        import hilbench.bench.lifecycle.supervisor
        from hilbench.compiled import all_compiled
        from hilbench.estimation import noise_level
        imported = {name for name in sys.modules if name.startswith("hilbench.")}
        noise_level._take.compile(noise_level._take.arguments)
        assert all_compiled(), imported
        noise_level._take.overloads.clear()
        assert all_compiled()  # it is on disk
        noise_level._take.arguments = (*noise_level._take.arguments, *noise_level._take.arguments)
        assert not all_compiled()
    """
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr


def test_an_entry_point_closes_over_numbers_alone() -> None:
    """What else a closure holds is another one in each process, and its machine code is never found again."""
    points = [each.py_func for name in _MODULES for each in entry_points(import_module(name))]
    held = {
        (each.__module__, each.__qualname__): [cell.cell_contents for cell in each.__closure__ or ()] for each in points
    }
    assert len(held) > 50
    assert {name: values for name, values in held.items() if not all(isinstance(one, int) for one in values)} == {}


def _descendants(pid: int) -> set[int]:
    """Processes below a process, as /proc has them."""
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found |= {child, *_descendants(child)}
    return found


def _compiles(pid: int) -> bool:
    """Whether a process has loaded the compiler."""
    with suppress(OSError):
        return "llvmlite" in Path(f"/proc/{pid}/maps").read_text()
    return False


def _runs(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_who_kills_it_leaves_nobody_compiling(number: signal.Signals, tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "hilbench.cli", "compile", "--jobs", "1"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as started:
        begun_s = time.monotonic()
        while not any(map(_compiles, _descendants(started.pid))):
            assert started.poll() is None
            assert time.monotonic() - begun_s < 120.0
            time.sleep(0.01)
        left = _descendants(started.pid)
        started.send_signal(number)
    ended_s = time.monotonic()
    while any(map(_runs, left)):
        assert time.monotonic() - ended_s < 30.0
        time.sleep(0.01)
