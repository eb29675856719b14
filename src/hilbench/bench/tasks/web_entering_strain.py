"""Strain of the web that enters a span: as the twin has it of another span, or as the config wants it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilbench.compiled import Record, Records, Vector, compiled, record_type
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample

#: What enters a span on one side: strain while nothing is known, and section of the span there; places of its tension
#: and E, NOWHERE: it stays so.
ENTERING = record_type("wanted", "section_m2")
ENTERING_AT = record_type("tension", "modulus", of=np.int64)
NOWHERE = -1


def strains_around(config: BenchConfig, span: int) -> tuple[float, float]:
    """Strains of the web before and after a span, by the model: on each side that of the set-point of the nearest span
    with a controller, as an axis without one passes the strain on; that of the web around the line for none."""
    model, controls = config.web_line, config.tension_controls
    before = [control for number, control in controls.items() if number < span]
    behind = [control for number, control in controls.items() if number > span]
    return (
        before[-1].set_point_N / model.stiffness_N(before[-1].span) if before else model.upstream_strain,
        behind[0].set_point_N / model.stiffness_N(behind[0].span) if behind else model.downstream_strain,
    )


@compiled
def entering_strain(entering: Record, at: Record, values: Vector, fresh: bool) -> float:
    """Strain of the web that enters, from what the twin has sent last, where that is `fresh`."""
    if not fresh or at.modulus == NOWHERE:
        return float(entering.wanted)
    modulus_Pa = values[at.modulus]
    if not modulus_Pa > 0.0:
        return float(entering.wanted)
    return float(values[at.tension] / (modulus_Pa * entering.section_m2))


@dataclass(frozen=True)
class EnteringStrain:
    """Strain of the web that may enter a span: as the twin has it of another span, by the signals of that one's tension
    and E and its section; `wanted` while nothing is known of it, and where there is no such span."""

    wanted: float
    tension: str = ""
    modulus: str = ""
    section_m2: float = 0.0


def entering_records(kind: type[CycleSample], sides: Sequence[EnteringStrain]) -> tuple[Records, Records]:
    """ENTERING and ENTERING_AT of the web before the span, then of that after it."""
    figures = [(side.wanted, side.section_m2) for side in sides]
    places = [tuple(kind.place(name) if name else NOWHERE for name in (side.tension, side.modulus)) for side in sides]
    return np.array(figures, ENTERING), np.array(places, ENTERING_AT)
