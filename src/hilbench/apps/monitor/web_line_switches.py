"""Yes-or-no switches of a bench with a web line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import MODEL_CHANGE, TENSION_PROBE


@dataclass(frozen=True)
class Switch:
    """Yes-or-no switch of a bench: path, key in the monitor, title, and the meaning of yes and no."""

    path: str
    key: str
    title: str
    yes: str
    no: str


PROBE: Final = Switch(TENSION_PROBE, "p", "probe", "move the tension a little, or allow it", "end or refuse it")
MODEL: Final = Switch(MODEL_CHANGE, "c", "model change", "the twin takes over the proposed model", "refuse it")


def switches(config: BenchConfig) -> Iterator[Switch]:
    """Switches of this bench."""
    if any(control.probes.mode != "off" for control in config.tension_controls.values()):
        yield PROBE
    if config.twin.live_diagnosis is not None:
        yield MODEL
