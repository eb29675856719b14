"""The nodes of the shipped bench as the bench sees them, without a bus."""

from __future__ import annotations

from functools import cache

from tests.bench.whole_runs import SHIPPED

from hilbench.cia402.configuration import default_reader
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.nodes import Nodes
from hilbench.runs.config import ExperimentConfig, load


@cache
def shipped() -> ExperimentConfig:
    return load(SHIPPED)[0]


def nodes() -> Nodes:
    found = Nodes(shipped())
    for drive in found.drives:
        drive.units = DriveUnits.from_objects(default_reader(drive.od), {}, drive.settings.name)
    return found
