"""Strain of the web that enters a span: as the twin has it of another span, or as the config wants it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Vector, compiled
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample

Places = NDArray[np.int64]

#: What enters a span, on the side before it and then on that behind it: strain while nothing is known, and section of
#: the span there; places of its tension and E, NOWHERE: it stays so.
_WANTED, _OF_SECTION_M2, _ENTERING = range(3)
_TENSION_AT, _MODULUS_AT, _PLACES = range(3)
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
def entering_strain(entering: Vector, at: Places, values: Vector, forward: bool, fresh: bool) -> float:
    """Strain of the web that enters, from what the twin has sent last, where that is `fresh`."""
    side = 0 if forward else 1
    of, place = entering[side * _ENTERING :], at[side * _PLACES :]
    if not fresh or place[_MODULUS_AT] == NOWHERE:
        return float(of[_WANTED])
    modulus_Pa = values[place[_MODULUS_AT]]
    if not modulus_Pa > 0.0:
        return float(of[_WANTED])
    return float(values[place[_TENSION_AT]] / (modulus_Pa * of[_OF_SECTION_M2]))


@dataclass(frozen=True)
class EnteringStrain:
    """Strain of the web that may enter a span: as the twin has it of another span, by the signals of that one's tension
    and E and its section; `wanted` while nothing is known of it, and where there is no such span."""

    wanted: float
    tension: str = ""
    modulus: str = ""
    section_m2: float = 0.0


def entering_vectors(kind: type[CycleSample], sides: Sequence[EnteringStrain]) -> tuple[Vector, Places]:
    """Vectors of `entering_strain`: of the web before the span, then of that after it."""
    figures = [value for side in sides for value in (side.wanted, side.section_m2)]
    places = [kind.place(name) if name else NOWHERE for side in sides for name in (side.tension, side.modulus)]
    return np.array(figures), np.array(places, np.int64)
