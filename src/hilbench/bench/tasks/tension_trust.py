"""Trust in the twin: decides if the tension loop may close on it, and if not, why.

It depends on the twin's own status (2100h), its age, and on whether its numbers can be those of a web at
all. Once in doubt, the loop stays open until the twin is synchronized again, and E is known well enough to
stay so: a twin is synchronized when the noise is small, however much of E may be due to something else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled
from hilbench.plant.web_line.parameters import LARGEST_MODULUS_Pa, LEAST_MODULUS_Pa
from hilbench.topology.sample import CycleSample, PlacesIn
from hilbench.topology.web_line_config import TensionControlConfig
from hilbench.twin.virtual_io import SYNCHRONIZED, TRANSFER_REFUSED

Vector = NDArray[np.float64]
Places = NDArray[np.int64]

#: Share of the set-point by which a simulated tension may be below zero: rounding of REAL32.
_BELOW_ZERO = 0.0125
#: So long a twin may refuse what is measured, or be unsure of E, s: while a new E of the web is looked for, which takes
#: it 0.13 s on a span of 1 m, and twice that where steps are small or spans short.
_REFUSES_S = 0.25
#: Share of the deviation at which a loop opens that it closes at.
_CLOSES_AT = 0.8


@dataclass(frozen=True, slots=True)
class TwinSignals:
    """Signals of the twin that a tension loop closes on; the defaults are those of a single span."""

    tension: str = "F_sim_N"
    modulus: str = "E_sim_Pa"
    deviation: str = "E_sd_Pa"


#: Of the vectors of `judged`. Figures: cycles of age, and of refusing, tensions in N and deviation of E in % up to
#: which they are believed; state: whether the twin has called itself synchronized and not been in doubt since, how many
#: cycles in a row it has refused what was measured and not called itself that, for how many it has been unsure of E
#: since it last was sure, and whether `refuse` holds.
_AGE_LIMIT, _REFUSES_CYCLES, _LOWEST_N, _HIGHEST_N, _DEVIATION_PCT, _FIGURES = range(6)
#: Places in a sample: age in cycles, status, tension in N, E and its deviation in Pa.
_AGE, _STATUS, _TENSION_N, _MODULUS_PA, _DEVIATION_PA, _PLACES = range(6)
REPORTED, _DIVERGED_CYCLES, _UNSURE_CYCLES, _REFUSED_BY_WATCH, _STATE = range(5)
#: Verdicts of `judged`.
TRUSTED, _OLD, _DIVERGED, _NO_WEB, _OUTSIDE, _UNSURE = range(6)


@compiled
def judged(figures: Vector, state: Vector, values: Vector, words: Places, at: Places) -> int:
    """Verdict on the twin's data at these places of a sample."""
    tension_N, modulus_Pa = values[at[_TENSION_N]], values[at[_MODULUS_PA]]
    deviation_Pa = values[at[_DEVIATION_PA]]
    if words[at[_AGE]] > figures[_AGE_LIMIT]:
        return _OLD
    status = words[at[_STATUS]]
    synchronized = status & SYNCHRONIZED != 0
    diverged = status & TRANSFER_REFUSED != 0 and not synchronized
    state[_DIVERGED_CYCLES] = state[_DIVERGED_CYCLES] + 1.0 if diverged else 0.0
    if state[_DIVERGED_CYCLES] > figures[_REFUSES_CYCLES]:
        return _DIVERGED
    if not (np.isfinite(tension_N) and LEAST_MODULUS_Pa <= modulus_Pa <= LARGEST_MODULUS_Pa):
        return _NO_WEB
    if not figures[_LOWEST_N] <= tension_N <= figures[_HIGHEST_N]:
        return _OUTSIDE
    # A twin that is starting knows nothing yet; an infinite deviation is that of a method which has none.
    limit_Pa = 0.01 * figures[_DEVIATION_PCT] * modulus_Pa
    closes = not _CLOSES_AT * limit_Pa < deviation_Pa < np.inf
    if closes:
        state[_UNSURE_CYCLES] = 0.0
    elif deviation_Pa > limit_Pa:
        state[_UNSURE_CYCLES] += 1.0
    if state[REPORTED] != 0.0:
        if state[_UNSURE_CYCLES] > figures[_REFUSES_CYCLES]:
            return _UNSURE
    elif synchronized and not closes:
        return _UNSURE
    if synchronized and state[_REFUSED_BY_WATCH] == 0.0:
        state[REPORTED] = 1.0
    return TRUSTED


class VirtualSensorSupervision:
    """Checks the twin cycle by cycle. `highest_tension_N`: what a simulated tension may reach and be believed."""

    def __init__(
        self,
        config: TensionControlConfig,
        highest_tension_N: float,
        cycle_s: float,
        signals: TwinSignals = TwinSignals(),
    ) -> None:
        self._config = config
        self._signals = signals
        self._at = PlacesIn(["twin_age_cycles", "twin_status", signals.tension, signals.modulus, signals.deviation])
        figures = np.zeros(_FIGURES)
        figures[_AGE_LIMIT], figures[_DEVIATION_PCT] = config.twin_age_limit_cycles, config.twin_deviation_limit_pct
        figures[_REFUSES_CYCLES] = _REFUSES_S / cycle_s
        figures[_LOWEST_N], figures[_HIGHEST_N] = -_BELOW_ZERO * config.set_point_N, highest_tension_N
        self._figures, self._state = figures, np.zeros(_STATE)
        self._synchronized = self._state.data.cast("B").cast("d")  # quicker than the vector
        self._why = "not synchronized yet"

    @property
    def trusted(self) -> bool:
        """True if the loop may be closed."""
        return self._synchronized[REPORTED] != 0.0

    @property
    def doubt(self) -> str:
        """Reason of an open loop; "" while it may be closed."""
        return "" if self.trusted else self._why

    def forget(self, reason: str) -> None:
        """Open the loop until the twin is synchronized anew."""
        self._synchronized[REPORTED] = 0.0
        self._why = reason

    def refuse(self, reason: str) -> None:
        """Open the loop, whatever the twin reports, until `allow`."""
        self._state[_REFUSED_BY_WATCH] = 1.0
        self.forget(reason)

    def allow(self) -> None:
        """Close the loop when the twin calls itself synchronized."""
        self._state[_REFUSED_BY_WATCH] = 0.0

    def doubts(self, found: int, sample: CycleSample) -> None:
        """Take the verdict of `judged`, if it is not TRUSTED."""
        self.forget(self._doubt(found, sample))

    def vectors(self, sample: CycleSample) -> tuple[Vector, Vector, Places]:
        """Figures, state and places of `judged`, for compiled callers."""
        return self._figures, self._state, self._at.of(sample)

    def _doubt(self, found: int, sample: CycleSample) -> str:
        config = self._config
        tension_N, modulus_Pa = getattr(sample, self._signals.tension), getattr(sample, self._signals.modulus)
        if found == _OLD:
            return f"the twin's data are more than {config.twin_age_limit_cycles} cycles old"
        if found == _DIVERGED:
            return f"what was measured is not what the twin simulates, for {_REFUSES_S:g} s now"
        if found == _NO_WEB:
            return f"the twin's data are no web's: tension {tension_N:g} N, E {modulus_Pa:g} Pa"
        if found == _OUTSIDE:
            highest_N = self._figures.item(_HIGHEST_N)
            return f"simulated tension {tension_N:.1f} N is outside 0 to {highest_N:g} N"
        limit_pct = config.twin_deviation_limit_pct * (1.0 if self.trusted else _CLOSES_AT)
        return f"the deviation of E is above {limit_pct:g} %"
