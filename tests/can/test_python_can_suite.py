"""python-can's own back-to-back tests, unmodified, against the embedded bus.

They are part of its source distribution only; `make test` fetches it (version and hash from requirements.lock).
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

SUITE = Path(__file__).parents[2] / ".cache" / "python-can"
PACKAGE = "python_can_tests"


def load_suite() -> ModuleType | None:
    """The module `test/back2back_test.py` in a package of its own (it imports its neighbours); None: not there."""
    folder = SUITE / "test"
    if not (folder / "back2back_test.py").exists():
        return None
    for name, file in ((PACKAGE, "__init__.py"), (f"{PACKAGE}.back2back_test", "back2back_test.py")):
        search = [str(folder)] if name == PACKAGE else None
        spec = importlib.util.spec_from_file_location(name, folder / file, submodule_search_locations=search)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


suite = load_suite()


def test_the_suite_is_here_in_the_version_that_is_installed() -> None:
    assert suite is not None, "python-can's tests are missing: make .cache/python-can/.extracted"
    assert f"\nVersion: {version('python-can')}\n" in (SUITE / "PKG-INFO").read_text()


if suite is not None:
    # No name at module level may hold the suite's own classes: they would be collected, for other interfaces.

    @pytest.mark.usefixtures("runtime")
    class TestBackToBack(suite.Back2BackTestCase):
        INTERFACE_1 = INTERFACE_2 = "hilbench"
        CHANNEL_1 = CHANNEL_2 = "suite"

    @pytest.mark.slow  # the same by the same interface, with a lock around it
    @pytest.mark.usefixtures("runtime")
    class TestThreadSafe(suite.TestThreadSafeBus):
        INTERFACE_1 = INTERFACE_2 = "hilbench"
        CHANNEL_1 = CHANNEL_2 = "suite"
