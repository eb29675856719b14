"""Until when the web in a span is one that nobody knows: its E and strain are looked for until they tell enough.

`joint_initialization` finds them from the balance; here is when they are known well enough for a method to go on from
there.
"""

from __future__ import annotations

from hilbench.estimation.web_line.initial_strains import InitialStrains
from hilbench.estimation.web_line.joint_initialization import InitialWeb, JointInitialization
from hilbench.estimation.web_line.synchronizers.base import SyncSample
from hilbench.estimation.web_line.synchronizers.plant import Plant

#: Deviation of E and of the strain, in %, with which a web that was found is known: while it passes, which makes
#: a better one of it soon, and at rest, where it takes a movement for so long.
_FOUND_PCT, _FOUND_AT_REST_PCT = 0.3, 0.33


class InitialSearch:
    """Of a span of `webs`, from 0, whose strain was a guess when its web was released, but for an unknown share
    (relative). Nothing is looked for before `begin`."""

    def __init__(self, webs: InitialStrains, span: int, unknown_share: float) -> None:
        self._webs, self._span, self._unknown_share = webs, span, unknown_share
        self._finding: JointInitialization | None = None

    @property
    def is_on(self) -> bool:
        """Whether E and strain are being looked for."""
        return self._finding is not None

    def begin(self, plant: Plant, strain_scale: float, friction_share: float) -> None:
        """Look for them from here on; all as of `JointInitialization`."""
        self._finding = JointInitialization(plant, self._webs, self._span, strain_scale, friction_share)

    def end(self) -> InitialWeb | None:
        """Look for them no more; what is known of the web by now, if anything."""
        finding, self._finding = self._finding, None
        return None if finding is None else finding.found

    def know(self) -> None:
        """No other span needs to ask any more by how much the strain in this one is off."""
        self._webs.know(self._span)

    def deviation_Pa(self, youngs_modulus_Pa: float) -> float:
        """What this E may be off by (standard deviation) while it is looked for; else nothing is said: 0."""
        return 0.0 if self._finding is None else self._finding.deviation_Pa(youngs_modulus_Pa)

    def move(self, velocity_m_s: float, duration_s: float) -> float:
        """Web has gone through the span; the unknown share (relative) in the strain of what enters it now."""
        self._webs.move(self._span, velocity_m_s, duration_s)
        return self._unknown_share * self._webs.entering(self._span)

    @property
    def passes(self) -> bool:
        """Whether the web that was there has begun to leave, which tells its strain from E."""
        return self._finding is not None and self._finding.passes

    def look(self, sample: SyncSample | None, cycle_s: float, strain: float) -> InitialWeb | None:
        """Take the balance of a cycle, after `move`; None: it can't be used. `strain`: as it follows from the guess.

        What is known of the web once that is enough to go on with; else None.
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
