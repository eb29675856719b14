"""Whether the tension loop may close on the twin, and if not, why.

What counts is what the twin reports of itself (2100h), how old it is, and whether its numbers can be those of a web at
all. Once in doubt, the loop stays open until the twin calls itself synchronized again, and E is known well enough to
stay so: a twin is synchronized when the noise is small, however much of E may be something else.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from operator import attrgetter

from hilbench.plant.web_line.parameters import LARGEST_MODULUS_Pa, LEAST_MODULUS_Pa
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import TensionControlConfig
from hilbench.twin.virtual_io import TwinStatus

_SYNCHRONIZED, _REFUSED = int(TwinStatus.SYNCHRONIZED), int(TwinStatus.TRANSFER_REFUSED)
#: Share of the set-point by which a simulated tension may be below zero: rounding of REAL32.
_BELOW_ZERO = 0.0125
#: Share of the deviation at which a loop opens that it closes at.
_CLOSES_AT = 0.8


@dataclass(frozen=True, slots=True)
class TwinSignals:
    """What of the twin a tension loop closes on, by the names of the signals; as they are where there is one span."""

    tension: str = "F_sim_N"
    modulus: str = "E_sim_Pa"
    deviation: str = "E_sd_Pa"


class TwinTrust:
    """Checks the twin cycle by cycle. `highest_tension_N`: what a simulated tension may reach and be believed."""

    def __init__(
        self, config: TensionControlConfig, highest_tension_N: float, signals: TwinSignals = TwinSignals()
    ) -> None:
        self._config = config
        self._values = attrgetter(signals.tension, signals.modulus, signals.deviation)
        self._highest_tension_N = highest_tension_N
        self._synchronized = False
        self._astray_cycles = 0  # in a row
        self.doubt = "not synchronized yet"  #: why the loop is open; "" while it may be closed

    def forget(self, reason: str) -> None:
        """Open the loop until the twin is synchronized anew."""
        self._synchronized = False
        self.doubt = reason

    def update(self, sample: CycleSample) -> bool:
        """Whether the loop may be closed on the twin's data in `sample`."""
        doubt = self._doubt(sample)
        if doubt:
            self.forget(doubt)
        elif sample.twin_status & _SYNCHRONIZED:
            self._synchronized = True
            self.doubt = ""
        return self._synchronized

    def _doubt(self, sample: CycleSample) -> str:
        config = self._config
        if sample.twin_age_cycles > config.twin_age_limit_cycles:
            return f"the twin's data are more than {config.twin_age_limit_cycles} cycles old"
        astray = sample.twin_status & _REFUSED and not sample.twin_status & _SYNCHRONIZED
        self._astray_cycles = self._astray_cycles + 1 if astray else 0
        if self._astray_cycles > config.twin_age_limit_cycles:
            return f"what was measured is not what the twin simulates, for {config.twin_age_limit_cycles} cycles now"
        tension_N, modulus_Pa, deviation_Pa = self._values(sample)
        if not (isfinite(tension_N) and LEAST_MODULUS_Pa <= modulus_Pa <= LARGEST_MODULUS_Pa):
            return f"the twin's data are no web's: tension {tension_N:g} N, E {modulus_Pa:g} Pa"
        if not -_BELOW_ZERO * config.set_point_N <= tension_N <= self._highest_tension_N:
            return f"simulated tension {tension_N:.1f} N is outside 0 to {self._highest_tension_N:g} N"
        # An infinite deviation is that of a method which has none.
        limit_pct = config.twin_deviation_limit_pct * (1.0 if self._synchronized else _CLOSES_AT)
        told = self._synchronized or sample.twin_status & _SYNCHRONIZED  # a twin that is starting knows nothing yet
        if told and 0.01 * limit_pct * modulus_Pa < deviation_Pa < inf:
            return f"the deviation of E is above {limit_pct:g} %"
        return ""
