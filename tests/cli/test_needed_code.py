"""What a run compiles before it starts: what it needs and is not kept, with word of how far that is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from tools.needed_code import EXAMPLES, used_by

import hilbench
from hilbench.apps.commands.needed_code import needed
from hilbench.compiled import entry_points

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("kind", EXAMPLES)
def test_what_is_needed_is_there_to_be_compiled(kind: str) -> None:
    assert len(needed(kind)) > 20
    for module, name in needed(kind):
        assert name in [each.py_func.__name__ for each in entry_points(import_module(module))], f"{module}.{name}"


@pytest.fixture(scope="module")
def all_is_compiled() -> None:
    subprocess.run([sys.executable, "-m", "hilbench", "compile"], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.slow
@pytest.mark.usefixtures("all_is_compiled")
@pytest.mark.parametrize(
    ("kind", "example"), [(kind, example) for kind, examples in EXAMPLES.items() for example in examples]
)
def test_a_run_calls_nothing_that_it_has_not_compiled_before(kind: str, example: str, tmp_path: Path) -> None:
    """python tools/needed_code.py makes it so again."""
    assert set(used_by(example, tmp_path)) <= set(needed(kind))


def test_a_first_run_compiles_what_is_missing_and_says_how_far_it_is(tmp_path: Path) -> None:
    package = tmp_path / "hilbench"
    shutil.copytree(Path(str(hilbench.__file__)).parent, package, ignore=shutil.ignore_patterns("*.nb[ic]"))
    program = f"""if True:
        from pathlib import Path
        from hilbench.apps.commands.needed_code import Function, compile_on_all_cores, missing, needed
        from hilbench.runs.config import load
        config, _ = load(Path({str(ROOT / "bench_configs" / "web_section_step.yaml")!r}))
        assert missing(config) == needed("web_line")
        small = [each for each in needed("web_line") if each.name in ("_keep", "coherent", "_stamp")]
        compile_on_all_cores(small, lambda text, share: print(text, share, sep="|"))
        assert not set(missing(config)) & set(small)
    """
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    said = [line.split("|") for line in done.stdout.splitlines()]
    assert said[0] == ["compiling 3 functions, once on this machine: a minute or two", "0.0"]
    assert said[-1] == ["compiled 3 of 3", "1.0"]


def test_where_nothing_can_be_kept_nothing_is_compiled_for_nobody(tmp_path: Path) -> None:
    package = tmp_path / "hilbench"
    shutil.copytree(Path(str(hilbench.__file__)).parent, package, ignore=shutil.ignore_patterns("*.nb[ic]"))
    program = f"""if True:
        from pathlib import Path
        from numba.core.caching import InTreeCacheLocator
        def refuse(self):
            raise PermissionError(13, "read-only")
        InTreeCacheLocator.ensure_cache_path = refuse
        from hilbench.apps.commands.needed_code import missing
        from hilbench.runs.config import load
        print(missing(load(Path({str(ROOT / "bench_configs" / "web_section_step.yaml")!r}))[0]))
    """
    # A home that is not there: nothing can be made below /proc.
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "NUMBA_"))}
    environment = variables | {"PYTHONPATH": str(tmp_path), "HOME": "/proc/nobody"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr
