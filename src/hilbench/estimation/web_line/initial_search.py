"""Search of E and strain of a web with unknown strain, until both are known.

`joint_initialization` estimates them from the balance; this decides when the estimate is good enough for a method.
"""

from __future__ import annotations

from hilbench.estimation.web_line.initial_strains import InitialStrains
from hilbench.estimation.web_line.joint_initialization import InitialWeb, JointInitialization
from hilbench.estimation.web_line.synchronizers.base import Plant, SyncSample

#: Deviation of E and of the strain, in %, at which a web counts as known: while it passes, which soon replaces it by a
#: better known one, and at rest, where a movement takes so long.
_FOUND_PCT, _FOUND_AT_REST_PCT = 0.3, 0.33


class InitialSearch:
    """Search for a span (from 0) of `webs`, whose strain at the web's release was a guess with an unknown share
    (relative). Starts at `begin`."""

    def __init__(self, webs: InitialStrains, span: int, unknown_share: float) -> None:
        self._webs, self._span, self._unknown_share = webs, span, unknown_share
        self._finding: JointInitialization | None = None

    @property
    def is_on(self) -> bool:
        """True while E and strain are searched."""
        return self._finding is not None

    def begin(self, plant: Plant, strain_scale: float, friction_share: float) -> None:
        """Start the search; arguments as of `JointInitialization`."""
        self._finding = JointInitialization(plant, self._webs, self._span, strain_scale, friction_share)

    def end(self) -> InitialWeb | None:
        """End the search; returns its estimate, if there is one."""
        finding, self._finding = self._finding, None
        return None if finding is None else finding.found

    def know(self) -> None:
        """Mark this span's strain as known, for the other spans."""
        self._webs.know(self._span)

    def deviation_Pa(self, youngs_modulus_Pa: float) -> float:
        """Standard deviation of this E during the search, else 0."""
        return 0.0 if self._finding is None else self._finding.deviation_Pa(youngs_modulus_Pa)

    def move(self, velocity_m_s: float, duration_s: float) -> float:
        """Move web through the span; returns the unknown share (relative) in the strain of the entering web."""
        self._webs.move(self._span, velocity_m_s, duration_s)
        return self._unknown_share * self._webs.entering(self._span)

    @property
    def passes(self) -> bool:
        """True if the initial web has begun to leave, which separates its strain from E."""
        return self._finding is not None and self._finding.passes

    def look(self, sample: SyncSample | None, cycle_s: float, strain: float) -> InitialWeb | None:
        """Take the balance of a cycle, after `move`; None: unusable. `strain`: by the guess.

        Returns the estimate once it is good enough, else None.
        """
        finding = self._finding
        if finding is None:
            return None
        if sample is None:
            finding.skip(cycle_s)
            return None
        found = finding.update(sample)
        if found is None or not self._webs.enters_known(self._span):
            return None
        share = 0.01 * (_FOUND_PCT if finding.passes else _FOUND_AT_REST_PCT)
        strain += found.strain_error
        if found.deviation_Pa > share * found.youngs_modulus_Pa or found.strain_deviation > share * strain:
            return None
        return found
