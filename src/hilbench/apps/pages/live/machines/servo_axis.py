"""A servo axis: one shaft with its drive and, on the same shaft, the load motor."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.apps.report.page import filled
from hilbench.arrays import Array
from hilbench.topology.config import BenchConfig
from hilbench.topology.servo_axis import INERTIA


def drawing(config: BenchConfig) -> str:
    """Drawing of a bench with one shaft."""
    motors = [*config.drives, *config.load_motors]
    return filled("pages/servo_axis", motors=motors, load_motors=config.load_motors, inertia=INERTIA)


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True: the shaft has no memory."""
    return True
