"""What a bench with a web line is told yes or no to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import MODEL_CHANGE, TENSION_PROBE


@dataclass(frozen=True)
class Switch:
    """What a bench is told yes or no: path, key in the monitor, how it is called, and what yes and no mean."""

    path: str
    key: str
    title: str
    yes: str
    no: str


PROBE: Final = Switch(TENSION_PROBE, "p", "probe", "move the tension a little, or allow it", "end or refuse it")
MODEL: Final = Switch(MODEL_CHANGE, "c", "model change", "the twin goes on with what was proposed", "refuse it")


def switches(config: BenchConfig) -> Iterator[Switch]:
    """Those that this bench has."""
    if any(control.probes.mode != "off" for control in config.tension_controls.values()):
        yield PROBE
    if config.twin.live_diagnosis is not None:
        yield MODEL
