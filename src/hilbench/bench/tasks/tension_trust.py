"""Trust in the twin: decides if the tension loop may close on it, and if not, why.

It depends on the twin's own status (2100h), its age, and on whether its numbers can be those of a web at
all. Once in doubt, the loop stays open until the twin is synchronized again, and E is known well enough to
stay so: a twin is synchronized when the noise is small, however much of E may be due to something else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.compiled import Vector, Wholes, compiled, of_record, record_type
from hilbench.plant.web_line.parameters import LARGEST_MODULUS_Pa, LEAST_MODULUS_Pa
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import TensionControlConfig
from hilbench.twin.virtual_io import SYNCHRONIZED, TRANSFER_REFUSED

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


#: Cycles of age, and of refusing, tensions and deviation of E up to which the twin's data are believed.
_FIGURES = record_type("age_cycles", "refuses_cycles", "lowest_N", "highest_N", "deviation_pct")
#: Whether the twin has called itself synchronized and not been in doubt since, how many cycles in a row it has refused
#: what was measured and not called itself that, for how many it has been unsure of E since it last was sure, and
#: whether `refuse` holds.
_STATE = record_type("reported", "diverged_cycles", "unsure_cycles", "refused_by_watch")
#: Places in a sample: age in cycles, status, tension in N, E and its deviation in Pa.
PLACES = record_type("age", "status", "tension_N", "modulus_Pa", "deviation_Pa", of=np.int64)


class TrustArrays(NamedTuple):
    """What `judged` works on, beside a sample."""

    figures: Annotated[Any, _FIGURES]
    state: Annotated[Any, _STATE]
    at: Annotated[Any, PLACES]


#: Verdicts of `judged`.
TRUSTED, _OLD, _DIVERGED, _NO_WEB, _OUTSIDE, _UNSURE = range(6)


@compiled
def judged(trust: TrustArrays, values: Vector, words: Wholes) -> int:
    """Verdict on the twin's data in a sample."""
    figures, state, at = trust.figures, trust.state, trust.at
    tension_N, modulus_Pa = values[at.tension_N], values[at.modulus_Pa]
    deviation_Pa = values[at.deviation_Pa]
    if words[at.age] > figures.age_cycles:
        return _OLD
    status = words[at.status]
    synchronized = status & SYNCHRONIZED != 0
    diverged = status & TRANSFER_REFUSED != 0 and not synchronized
    state.diverged_cycles = state.diverged_cycles + 1.0 if diverged else 0.0
    if state.diverged_cycles > figures.refuses_cycles:
        return _DIVERGED
    if not (np.isfinite(tension_N) and LEAST_MODULUS_Pa <= modulus_Pa <= LARGEST_MODULUS_Pa):
        return _NO_WEB
    if not figures.lowest_N <= tension_N <= figures.highest_N:
        return _OUTSIDE
    # A twin that is starting knows nothing yet; an infinite deviation is that of a method which has none.
    limit_Pa = 0.01 * figures.deviation_pct * modulus_Pa
    closes = not _CLOSES_AT * limit_Pa < deviation_Pa < np.inf
    if closes:
        state.unsure_cycles = 0.0
    elif deviation_Pa > limit_Pa:
        state.unsure_cycles += 1.0
    if state.reported != 0.0:
        if state.unsure_cycles > figures.refuses_cycles:
            return _UNSURE
    elif synchronized and not closes:
        return _UNSURE
    if synchronized and state.refused_by_watch == 0.0:
        state.reported = 1.0
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
        self._highest_N = highest_tension_N
        figures = of_record(
            _FIGURES,
            age_cycles=config.twin_age_limit_cycles,
            refuses_cycles=_REFUSES_S / cycle_s,
            lowest_N=-_BELOW_ZERO * config.set_point_N,
            highest_N=highest_tension_N,
            deviation_pct=config.twin_deviation_limit_pct,
        )
        self._figures, self._states = np.array([figures], _FIGURES), np.zeros(1, _STATE)
        self._state = self._states[0]
        self._why = "not synchronized yet"

    @property
    def trusted(self) -> bool:
        """True if the loop may be closed."""
        return bool(self._state["reported"] != 0.0)

    @property
    def doubt(self) -> str:
        """Reason of an open loop; "" while it may be closed."""
        return "" if self.trusted else self._why

    def forget(self, reason: str) -> None:
        """Open the loop until the twin is synchronized anew."""
        self._state["reported"] = 0.0
        self._why = reason

    def refuse(self, reason: str) -> None:
        """Open the loop, whatever the twin reports, until `allow`."""
        self._state["refused_by_watch"] = 1.0
        self.forget(reason)

    def allow(self) -> None:
        """Close the loop when the twin calls itself synchronized."""
        self._state["refused_by_watch"] = 0.0

    def doubts(self, found: int, sample: CycleSample) -> None:
        """Take the verdict of `judged`, if it is not TRUSTED."""
        self.forget(self._doubt(found, sample))

    def arrays(self, kind: type[CycleSample]) -> TrustArrays:
        """What `judged` works on with such samples."""
        of = self._signals
        names = ["twin_age_cycles", "twin_status", of.tension, of.modulus, of.deviation]
        return TrustArrays(self._figures, self._states, kind.places(names))

    def _doubt(self, found: int, sample: CycleSample) -> str:
        config = self._config
        tension_N, modulus_Pa = getattr(sample, self._signals.tension), getattr(sample, self._signals.modulus)
        if found == _OLD:
            return f"the twin's data are more than {config.twin_age_limit_cycles} cycles old"
        if found == _DIVERGED:
            return f"the twin does not follow what is measured, for {_REFUSES_S:g} s now"
        if found == _NO_WEB:
            return f"the twin's data are no web's: tension {tension_N:g} N, E {modulus_Pa:g} Pa"
        if found == _OUTSIDE:
            return f"simulated tension {tension_N:.1f} N is outside 0 to {self._highest_N:g} N"
        limit_pct = config.twin_deviation_limit_pct * (1.0 if self.trusted else _CLOSES_AT)
        return f"the deviation of E is above {limit_pct:g} %"
