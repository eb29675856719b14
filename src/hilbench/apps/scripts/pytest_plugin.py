"""The pytest plugin: a bench as a fixture (``pytest --hilbench-config bench.yaml``).

Loaded by every pytest session of an environment in which hilbench is installed, so it imports nothing heavy.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from hilbench.apps.scripts.bench import Bench, StepResponse

#: The bench of a test, once there is one, and what its phases said.
_BENCH: pytest.StashKey[Bench] = pytest.StashKey()
_FAILURES: pytest.StashKey[list[str]] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options, and the config file's place in an ini file."""
    group = parser.getgroup("hilbench")
    group.addoption("--hilbench-config", metavar="FILE", help="bench config of the fixtures bench and step_experiment")
    group.addoption("--hilbench-bus", metavar="BUS", help="another bus, as hilbench run --bus")
    group.addoption(
        "--hilbench-out", metavar="FOLDER", default="runs", help="where each bench leaves its run folder (runs)"
    )
    parser.addini("hilbench_config", "bench config, where --hilbench-config gives none", type="paths")


def pytest_configure(config: pytest.Config) -> None:
    """The marker."""
    config.addinivalue_line("markers", "hilbench_set(*changes): KEY=VALUE of the bench config for this test")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, None]:
    """Name the run folder in the report of a test that failed; in JUnit XML it is the property ``hilbench_run``."""
    outcome = yield
    report: pytest.TestReport = outcome.get_result()
    made = item.stash.get(_BENCH, None)
    if made is None or made.folder is None:
        return
    folder = str(made.folder.path)
    if report.when == "setup" or ("hilbench_run", folder) not in item.user_properties:
        item.user_properties.append(("hilbench_run", folder))
        report.user_properties.append(("hilbench_run", folder))
    if report.failed:
        item.stash.setdefault(_FAILURES, []).append(_reason(report))
        report.sections.append(("hilbench", f"run folder: {folder}"))


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A running bench with enabled drives, of this test alone; a simulated one gets a bus of its own.


    It leaves a run folder, named after the test.
    """
    from hilbench.apps.scripts.bench import Bench
    from hilbench.runs.criteria import failed_or_passed

    options = request.config
    config = options.getoption("--hilbench-config") or next(iter(options.getini("hilbench_config")), None)
    if config is None:
        raise pytest.UsageError("no bench config: give --hilbench-config FILE, or hilbench_config in the ini file")
    marks = request.node.iter_markers("hilbench_set")
    changes = [text for mark in marks for text in mark.args]
    made = Bench(
        config,
        bus=options.getoption("--hilbench-bus") or _bus_of_its_own(Path(config), changes),
        changes=changes,
        out=options.getoption("--hilbench-out"),
        name=request.node.name,
    )
    request.node.stash[_BENCH] = made
    with made:
        yield made
        failures = request.node.stash.get(_FAILURES, [])
        made.verdicts.append(failed_or_passed(request.node.nodeid, "; ".join(failures)))
    if failures and made.folder is not None and made.folder.recording.exists():
        from hilbench.apps.report.html import write_report

        write_report(made.folder)


def _reason(report: pytest.TestReport) -> str:
    """Reason of the failure, in a line."""
    crash = getattr(report.longrepr, "reprcrash", None)
    lines = (crash.message if crash is not None else report.longreprtext).strip().splitlines()
    return lines[0] if lines else f"{report.when} failed"


def _bus_of_its_own(config: Path, changes: list[str]) -> str | None:
    """Bus of its own for a bench on the embedded bus without a name; None: the config's."""
    from hilbench.runs.config import bus_of_folder, load_with_overrides

    address = load_with_overrides(config, changes=changes).config.bus.address
    return f"embedded:pytest{os.getpid()}" if address == str(bus_of_folder(config)) else None


@pytest.fixture
def step_experiment(bench: Bench) -> Callable[..., StepResponse]:
    """Run a step change on the bench: ``step_experiment("load.web.youngs_modulus_Pa", to=10.5e9)``.

    Keywords as in `hilbench.apps.scripts.bench.Bench.step_response`.
    """
    return bench.step_response
