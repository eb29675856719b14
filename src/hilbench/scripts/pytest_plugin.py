"""The pytest plugin: a bench as a fixture (``pytest --hilbench-config bench.yaml``).

Loaded by every pytest session of an environment in which hilbench is installed, so it imports nothing heavy.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hilbench.scripts.bench import Bench, StepResponse


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options, and the config file's place in an ini file."""
    group = parser.getgroup("hilbench")
    group.addoption("--hilbench-config", metavar="FILE", help="bench config of the fixtures bench and step_experiment")
    group.addoption("--hilbench-bus", metavar="BUS", help="another bus, as hilbench run --bus")
    parser.addini("hilbench_config", "bench config, where --hilbench-config gives none", type="paths")


def pytest_configure(config: pytest.Config) -> None:
    """The marker."""
    config.addinivalue_line("markers", "hilbench_set(*changes): KEY=VALUE of the bench config for this test")


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A running bench with enabled drives, of this test alone; a simulated one gets a bus of its own."""
    from hilbench.experiment.config import bus_of_folder
    from hilbench.scripts.bench import Bench

    config = request.config.getoption("--hilbench-config") or next(iter(request.config.getini("hilbench_config")), None)
    if config is None:
        raise pytest.UsageError("no bench config: give --hilbench-config FILE, or hilbench_config in the ini file")
    marks = request.node.iter_markers("hilbench_set")
    changes = [text for mark in marks for text in mark.args]
    made = Bench(config, bus=request.config.getoption("--hilbench-bus"), changes=changes)
    if made.config.bus.address == str(bus_of_folder(Path(config))):
        made = Bench(config, bus=f"embedded:pytest{os.getpid()}", changes=changes)
    with made:
        yield made


@pytest.fixture
def step_experiment(bench: Bench) -> Callable[..., StepResponse]:
    """Run a step change on the bench: ``step_experiment("load.web.youngs_modulus_Pa", to=10.5e9)``.

    Keywords as in `hilbench.scripts.bench.Bench.step_response`.
    """
    return bench.step_response
