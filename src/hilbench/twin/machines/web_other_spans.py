"""Spans of a line without an estimator of E, followed on the measured motion."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.estimation.web_line.anomalies import PASSED_SPANS
from hilbench.estimation.web_line.initial_strains import InitialStrains, creeps_per_N
from hilbench.estimation.web_line.span_estimator_cycle import DIVERGED_S
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters


class OtherSpans:
    """Spans without an estimator: their strains are transferred.

    `spans`: their numbers; `strain_limit`: largest plausible difference of a strain.
    """

    def __init__(self, model: ModelParameters, spans: Sequence[int], strain_limit: float) -> None:
        self._web = LineFollower(model)
        self._creeps_per_N, self._behind_N = creeps_per_N(model), model.boundary.downstream_tension_N
        self.spans = tuple(spans)
        self._limit = strain_limit
        self._passed_m = PASSED_SPANS * max(model.span_length_m(span) for span in range(1, model.span_count + 1))
        self._moduli = [f"span{span}.youngs_modulus_Pa" for span in range(1, model.span_count + 1)]
        self.webs: InitialStrains | None = None  #: of the line, as of the release
        self.reset()

    def reset(self) -> None:
        """Take the next positions as the first."""
        self.refused = False
        self._refused_m = self._refused_s = 0.0  # web that has passed, and time, while states were refused
        self._running = False
        self._last_m: Sequence[float] = ()

    def follow(self, positions_m: Sequence[float], strain_prev: float, F_next_N: float, cycle_s: float) -> None:
        """Follow the rollers to these positions (N,), a cycle after the last, with the stated boundary inputs."""
        web = self._web
        web.set_boundary(strain_prev, F_next_N)
        self._behind_N = F_next_N
        if self._running:
            web.follow(positions_m, cycle_s)
        else:
            web.reset(positions_m, strain=[strain_prev] * (len(positions_m) - 1))
        travels_m = [x - then for x, then in zip(positions_m, self._last_m, strict=True)] if self._running else []
        travel_m = abs(travels_m[0]) if travels_m else 0.0
        if self.webs is not None and travels_m:
            for span in self.spans:
                self.webs.move(span - 1, travels_m[span] / cycle_s, cycle_s)
        self._refused_m = self._refused_m + travel_m if self.refused else 0.0
        self._refused_s = self._refused_s + cycle_s if self.refused else 0.0
        self._last_m = positions_m
        self._running = True

    @property
    def diverged(self) -> bool:
        """True if diverged, as `SpanEstimator.diverged`."""
        return self._refused_s > DIVERGED_S and self._refused_m > self._passed_m

    def strain(self, span: int) -> float:
        """Measured strain of the web in one of these spans."""
        return float(self._web.strain[span - 1])

    def creep_ratio(self, span: int) -> float:
        """Share by which less web leaves one of these spans than the roller after it turns, by creep."""
        tensions, behind_N = self._web.tension_N, self._behind_N
        if span < len(tensions):
            behind_N = float(tensions[span])
        return self._creeps_per_N[span - 1] * (float(tensions[span - 1]) - behind_N)

    def transfer(self, line: Line) -> None:
        """Transfer the measured strains to the line, unless they are implausible."""
        states = {}
        self.refused = False
        measured, simulated = self._web.strain.tolist(), line.strain.tolist()
        for at in self.spans:
            if abs(measured[at - 1] - simulated[at - 1]) <= self._limit:
                states[f"strain{at}"] = measured[at - 1]
            else:
                self.refused = True
        for span, name in enumerate(self._moduli, 1):
            self._web.moduli_Pa[span - 1] = line.parameter(name)
        line.set_state(states)
