"""Unknown initial strains of a line's webs: how much of each is left, and in which span.

The assumed initial strain of a span is off by some δ. Web of the previous span enters it, web leaves it, so its strain
error d follows that of the span before,

    d_k' = (out_(k-1) - out_k)/L_k      per travel of the web,      out_k = d_k + a_k·d_k - b_k·d_(k+1)

where a and b are the influence of tension errors by creep over the roller after a span. So d is a sum of the δ of all
spans, each with a share that depends on travel alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.floating[Any]]

#: Prior standard deviation of a δ, over the strain upstream: next to no information.
PRIOR = 2.0
#: Lines don't run slower: rollers that go to and fro return the web that they have taken, m/s.
SLOW_M_S = 0.02
#: Of the speeds.
_SMOOTHING_S = 0.008
#: Unknown share below which a web counts as known.
KNOWN = 0.003


@dataclass(frozen=True, slots=True)
class Strains:
    """Estimate of the δ of all spans (K,), over the strain upstream, with their covariance (K, K)."""

    mean: Array
    covariance: Array


class InitialStrains:
    """Shares of unknown strains in a line of spans of these lengths (K,), counted from 0; `creep_per_N` (K,): over the
    rollers after them by the model, `stiffness_N` (K,): assumed E·S."""

    def __init__(self, lengths_m: Sequence[float], creep_per_N: Sequence[float], stiffness_N: Sequence[float]) -> None:
        count = len(lengths_m)
        creep, stiffness = np.asarray(creep_per_N), np.asarray(stiffness_N)
        self._a, self._b = (creep * stiffness).tolist(), (creep[:-1] * stiffness[1:]).tolist()
        #: (K, K): share of each span's δ in the present strain of a span (row).
        self.shares = np.eye(count)
        nothing = Strains(np.zeros(count), PRIOR**2 * np.eye(count))
        #: By the torques after each span, and after those that its web comes from.
        self.estimates = [nothing] * count
        self._nothing = nothing
        self._lengths_m = tuple(lengths_m)
        self._before = list(range(-1, count - 1))  # the span that web comes from; outside the line: a known one
        self._to_and_fro = np.zeros((count, 2))  # position of slow rollers, and their largest travel, m
        self._speeds_m_s = np.zeros(count)  # of the rollers after the spans, low-passed

    def move(self, span: int, velocity_m_s: float, duration_s: float) -> None:
        """Move web through a span; call it for the spans in the order that the web passes them."""
        row, forwards, rate = self.shares[span], velocity_m_s >= 0.0, 1.0
        self._speeds_m_s[span] += (1.0 - exp(-duration_s / _SMOOTHING_S)) * (velocity_m_s - self._speeds_m_s[span])
        if abs(velocity_m_s) >= SLOW_M_S:
            self._before[span] = span - 1 if forwards else span + 1
        if forwards:
            rate += self._a[span] + (self._b[span - 1] if span > 0 else 0.0)
        decay = exp(-rate * self._travel_m(span, velocity_m_s, duration_s) / self._lengths_m[span])
        row *= decay
        entering = self._entering(span)
        if entering is not None:
            row += (1.0 - decay) / rate * (1.0 + (self._a[span - 1] if forwards else 0.0)) * entering
        if forwards and span + 1 < len(self.shares):
            row += (1.0 - decay) / rate * self._b[span] * self.shares[span + 1]

    def _travel_m(self, span: int, velocity_m_s: float, duration_s: float) -> float:
        if abs(velocity_m_s) >= SLOW_M_S:
            return abs(velocity_m_s) * duration_s
        self._to_and_fro[span, 0] += velocity_m_s * duration_s
        at_m, furthest_m = self._to_and_fro[span].tolist()
        self._to_and_fro[span, 1] = max(abs(at_m), furthest_m)
        return float(self._to_and_fro[span, 1] - furthest_m)

    def _entering(self, span: int) -> Array | None:
        before = self._before[span]
        return self.shares[before] if 0 <= before < len(self.shares) else None

    def entering(self, span: int) -> float:
        """Largest share of an unknown strain in the web that enters a span."""
        entering = self._entering(span)
        return 0.0 if entering is None else float(np.abs(entering).max())

    def enters_known(self, span: int) -> bool:
        """True if the strain of the web that enters a span is known."""
        return self.entering(span) < KNOWN

    def go_along(self, span: int, speed_m_s: float, least_m_s: float) -> bool:
        """True if all rollers after the one behind a span turn in the direction of this speed at `least_m_s` or more;
        for speed 0: if all are slower than that."""
        speeds_m_s = self._speeds_m_s[span + 1 :]
        if speed_m_s == 0.0:
            return bool(np.all(np.abs(speeds_m_s) <= least_m_s))
        return bool(np.all(np.copysign(speeds_m_s, speeds_m_s * speed_m_s) >= least_m_s))

    def estimate_before(self, span: int) -> Strains:
        """Estimate of all strains without the torques after this span."""
        before = self._before[span]
        return self.estimates[before] if 0 <= before < len(self.estimates) else self._nothing

    def know(self, span: int) -> None:
        """Mark the strain of a span as known."""
        self.shares[span] = 0.0


def initial_strains(model: ModelParameters) -> InitialStrains:
    """Initial strains of a line, E as in the model."""
    spans = range(1, model.span_count + 1)
    return InitialStrains(
        [model.span_length_m(span) for span in spans], creeps_per_N(model), [model.stiffness_N(span) for span in spans]
    )


def creeps_per_N(model: ModelParameters) -> list[float]:
    """Creep over the roller after each span, by the model."""
    creeps = {e.section: e.parameters.get("creep_per_N", 0.0) for e in model.effects if e.effect == "web_slip"}
    return [creeps.get(span, creeps.get(None, 0.0)) for span in range(1, model.span_count + 1)]
