"""What `hilbench compile` leaves is found by everybody who runs hilbench, also by those who may only read it."""

from __future__ import annotations

import os
import shutil
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

import hilbench
from hilbench.apps.commands.compile import modules_by_room
from hilbench.code_cache import CodeCache
from hilbench.compiled import entry_points
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import simulation
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
        assert isinstance(each._cache, CodeCache)
        assert each.arguments, f"{each}: expected @entry_point(VECTOR, REAL, …), the types of its arguments"
        assert len(each.arguments) == len(signature(each.py_func).parameters), each


@pytest.mark.parametrize(
    "refusing", ["()", *slow("[InTreeCacheLocator]", "[InTreeCacheLocator, UserWideCacheLocator]")]
)
def test_who_may_only_read_hilbench_runs_what_was_compiled_when_it_was_installed(tmp_path: Path, refusing: str) -> None:
    _misses("()", tmp_path)
    assert _misses(refusing, tmp_path) == "0"
    assert not list(tmp_path.rglob("*.nbc"))


def test_a_full_disk_keeps_nobody_from_running_what_was_compiled(tmp_path: Path) -> None:
    program = """if True:
        from errno import ENOSPC
        from numba.core.caching import IndexDataCacheFile
        def full(self, key, data):
            raise OSError(ENOSPC, "no space left on device")
        IndexDataCacheFile.save = full
        from hilbench.estimation import noise_level
        import numpy as np
        noise_level._take(np.zeros(8), 1.0)
        print(sum(noise_level._take.stats.cache_misses.values()))
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "1"), done.stderr


def test_code_that_is_kept_is_seen_without_loading_it_and_that_of_another_numba_is_not(tmp_path: Path) -> None:
    program = """if True:
        from pathlib import Path
        from hilbench import code_cache
        from hilbench.estimation import noise_level
        source = Path(noise_level.__file__)
        found = [code_cache.is_kept(source, "_take")]
        noise_level._take.compile(noise_level._take.arguments)
        found.append(code_cache.is_kept(source, "_take"))
        code_cache.numba.__version__ = "0.1"
        found.append(code_cache.is_kept(source, "_take"))
        print(*found)
    """
    shutil.copytree(Path(hilbench.__file__).parent, tmp_path / "hilbench", ignore=shutil.ignore_patterns("*.nb[ic]"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.split() == ["False", "True", "False"]


def test_variants_from_one_start_run_what_was_compiled_for_one() -> None:
    web = {"youngs_modulus_Pa": 9e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0}
    model = ModelParameters.model_validate({"web": web, "rollers": {"radius_m": 0.04, "inertia_kg_m2": 1e-3}})
    p = lay.pack(model)
    before = set(simulation.simulate.overloads)  # type: ignore[attr-defined]
    simulate(np.stack([p, p]), start_state(p, model), np.zeros((4, 2)), np.zeros((4, 2)), 0.002)
    assert set(simulation.simulate.overloads) - before <= {simulation.simulate.arguments}  # type: ignore[attr-defined]


def test_machine_code_is_found_again_by_what_it_is_made_of() -> None:
    """In another process, with other hashes of strings; and not where a function that it calls, or a value, differs."""
    program = """if True:
        from importlib import import_module
        from hilbench.apps.commands.compile import modules_by_room
        from hilbench.code_cache import made_of
        from hilbench.compiled import entry_points
        for modules in modules_by_room():
            for name in modules:
                print([made_of(each.py_func) for each in entry_points(import_module(name))])
    """
    texts = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            timeout=300,
            check=True,
        ).stdout
        for seed in "12"
    ]
    assert len(texts[0]) > 64 * len(_MODULES)
    assert texts[0] == texts[1]


_LAWS = """
import numpy as np
from hilbench.compiled import compiled, entry_point, REAL
from laws import FACTOR, gain
import more

@compiled
def twice(x):
    return gain(x) + gain(x)

@entry_point(REAL)
def act(x):
    return FACTOR * twice(x) + more.OFFSET
"""


@pytest.mark.parametrize(
    ("file", "before", "behind"),
    [
        ("laws", "return x + 1.0", "return x + 2.0"),
        *slow(("laws", "FACTOR = 2.0", "FACTOR = 3.0"), ("more", "OFFSET = 1.0", "OFFSET = 5.0")),
    ],
)
def test_a_changed_callee_or_constant_of_another_file_is_compiled_anew(
    tmp_path: Path, file: str, before: str, behind: str
) -> None:
    sources = {
        "act": _LAWS,
        "laws": "from hilbench.compiled import compiled\nFACTOR = 2.0\n@compiled\ndef gain(x):\n    return x + 1.0\n",
        "more": "OFFSET = 1.0\n",
    }
    program = "import act; print(act.act(3.0), sum(act.act.stats.cache_misses.values()))"

    def ran() -> list[str]:
        for name, text in sources.items():
            (tmp_path / f"{name}.py").write_text(text)
        command = [sys.executable, "-B", "-c", program]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
        return done.stdout.split()

    first = ran()
    assert first == ["17.0", "1"]
    assert ran() == ["17.0", "0"]
    assert before in sources[file]
    sources[file] = sources[file].replace(before, behind)
    changed = ran()
    assert changed[0] != "17.0"
    assert changed[1] == "1"
    assert ran() == [changed[0], "0"]


_RECORDS = """
from typing import NamedTuple
from hilbench.compiled import Reals, TABLE, arrays_in, entry_point

class Motion(NamedTuple):
    position_m: Reals
    velocity_m_s: Reals

class Axis(NamedTuple):
    motion: Motion

@entry_point(TABLE)
def act(table):
    return arrays_in(table, Axis).motion.position_m[0]
"""


def test_fields_in_another_order_in_a_record_of_a_record_are_compiled_anew(tmp_path: Path) -> None:
    program = "import act; from hilbench.code_cache import made_of; print(made_of(act.act.py_func))"
    fields = ["    position_m: Reals\n", "    velocity_m_s: Reals\n"]
    numbers = set()
    for text in (_RECORDS, _RECORDS.replace("".join(fields), "".join(reversed(fields)))):
        (tmp_path / "act.py").write_text(text)
        command = [sys.executable, "-B", "-c", program]
        numbers.add(subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout)
    assert len(numbers) == 2


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
    command = [sys.executable, "-m", "hilbench", "compile", "--jobs", "1"]
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
