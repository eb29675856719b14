"""Splice tracking through a line: found in the first span with an estimator of E, and predicted in the next ones.

While a joint is inside a span the web there is modelled as springs in series, and leaves the span with the strain of
its last piece. When it reaches the next roller the next span has it, without searching it: the estimate there is E of
the web without it, and a change of that is a new one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isinf
from typing import Final

import numpy as np

from hilbench.compiled import Record, compiled, record_type
from hilbench.estimation.web_line import splices
from hilbench.estimation.web_line.span_estimator import Known, SpanEstimator
from hilbench.estimation.web_line.splices import Entered, Joint, SpliceFinder
from hilbench.plant.web_line.splices import Piece

#: Interval and reach of the checkpoints, s: a joint is found after it has come in.
_REMEMBERED_S, _LONGEST_S = 0.1, 3.0
#: Length of an endless piece, m.
_ENDLESS_M = 1e9
#: State of a tracker: whether there are joints; cycles, and their number per checkpoint; in the first span, apparent
#: strain without a joint over the true one, and the strain of the previous cycle.
TRACKER: Final = record_type("joints", "cycle", "every", "seeming", "strain")


@compiled
def passes(s: Record, sums: Record, t: Record, strain: float, before_m: float) -> bool:
    """Run `SpliceTracker.update` of a cycle without result or checkpoint; False, and nothing done, otherwise. s: state
    of the splice tracker, sums: those of its finder; t: of the first span's estimator, strain: as measured there,
    before_m: position of the roller before it."""
    used = t.used != 0.0
    if s.joints != 0.0 or s.seeming != 1.0 or (s.cycle + 1.0) % s.every == 0.0:
        return False
    if used and sums.count + 1.0 >= sums.cycles:
        return False
    s.cycle += 1.0
    s.strain = strain
    if used:
        web_per_Pa = t.used_per_Pa * (1.0 / t.series_factor)
        splices.collect(sums, t.used_N, web_per_Pa, t.used_m_s, before_m)
    else:
        splices.interrupt(sums)
    return True


@dataclass
class _Inside:
    """Joint whose web is in a span; `handed_on`: its front has left."""

    joint: Joint
    handed_on: bool = False


@dataclass
class _Span:
    """Span with the joints in it, by the travel of the roller before it."""

    tracking: SpanEstimator
    joints: list[_Inside] = field(default_factory=list)
    #: Strain that it would have more if no joint had come into the first span.
    without_joint: float = 0.0

    def put(self) -> None:
        """Set these joints in the measured web."""
        self.tracking.put_pieces(
            [
                Piece(inside.joint.front_m, min(inside.joint.length_m, _ENDLESS_M), inside.joint.relative_change)
                for inside in self.joints
            ]
        )


class SpliceTracker:
    """Joints in successive spans; `trackings`: estimators of these spans."""

    def __init__(self, trackings: Sequence[SpanEstimator], cycle_s: float) -> None:
        self._spans = [_Span(tracking) for tracking in trackings]
        first = trackings[0]
        self._finder = SpliceFinder(first.length_m, first.mass_kg, cycle_s)
        self._cycle_s = cycle_s
        #: State of the tracker and sums of its finder, for compiled callers of `passes`.
        self.arrays = np.zeros(1, TRACKER), self._finder.sums
        self._state = self.arrays[0][0]
        self._state["every"] = max(1, round(_REMEMBERED_S / cycle_s))
        #: Checkpoints of the first span, by the position of the roller before it, m.
        self._memories: deque[tuple[float, Known]] = deque(maxlen=round(_LONGEST_S / _REMEMBERED_S))
        self.reset()

    def reset(self) -> None:
        """Forget all joints: the web is uniform."""
        self._look_anew()
        self._state["joints"] = 0.0
        for span in self._spans:
            if span.joints:
                span.joints.clear()
                span.put()

    def _look_anew(self) -> None:
        self._finder.reset()
        self._state["seeming"], self._state["strain"] = 1.0, 0.0
        self._memories.clear()
        self._before: Known | None = None
        for span in self._spans:
            span.without_joint = 0.0

    def update(self, positions_m: Sequence[float]) -> None:
        """Track joints after the spans' comparison; positions (K + 1,) of the rollers around them, at the web, m."""
        first = self._spans[0]
        self._remember(first, positions_m[0])
        self._follow_seeming(first)
        tracking = first.tracking
        entered = self._finder.update(
            tracking.used, positions_m[0], self._seeming / float(tracking.state["series_factor"])
        )
        tracking.state["other_web"] = self._finder.suspects
        if entered is not None:
            self._enter(first, entered)
        for place, span in enumerate(self._spans):
            if span.joints:
                behind = self._spans[place + 1] if place + 1 < len(self._spans) else None
                self._hand_on(span, behind, positions_m[place], positions_m[place + 1])
        if entered is None and self._seeming != 1.0 and not first.joints:
            self._look_anew()
        self._state["joints"] = any(span.joints for span in self._spans)
        self._state["strain"] = first.tracking.strain

    @property
    def _seeming(self) -> float:
        return float(self._state["seeming"])

    def _enter(self, first: _Span, entered: Entered) -> None:
        """Enter a joint that has been found, is better known, or was none."""
        tracking = first.tracking
        before = self._known_before(entered.joint)
        known = before._replace(youngs_modulus_Pa=before.youngs_modulus_Pa * (1.0 + entered.relative_change))
        tracking.believe(known, tracking.strain * self._seeming * entered.strain_ratio)
        first.joints = [] if entered.joint is None else [_Inside(entered.joint)]
        first.put()
        if entered.joint is None:  # the spans behind were entered by web of a joint that was none
            for behind in self._spans[1:]:
                behind.tracking.believe(behind.tracking.known(), behind.tracking.strain + behind.without_joint)
                behind.without_joint = 0.0
        self._state["seeming"] = 1.0 / entered.strain_ratio

    def _known_before(self, joint: Joint | None) -> Known:
        """Checkpoint from before a joint came in; that of the first one is kept as long as it is inside."""
        if joint is not None and not self._spans[0].joints:
            before = [known for at_m, known in self._memories if at_m < joint.front_m]
            self._before = before[-1] if before else self._memories[0][1]
        assert self._before is not None, "a joint is taken back only after it was found"
        return self._before

    def _remember(self, first: _Span, at_m: float) -> None:
        self._state["cycle"] += 1.0
        if self._state["cycle"] % self._state["every"] == 0.0 and not first.joints and first.tracking.used is not None:
            self._memories.append((at_m, first.tracking.known()))

    def _follow_seeming(self, first: _Span) -> None:
        """Update the apparent strain without a joint: as if all web in the span were alike."""
        tracking, before = first.tracking, float(self._state["strain"])
        strain, now = tracking.strain, tracking.used
        if not first.joints or now is None or not strain > 0.0:
            return
        share = abs(now.velocity_m_s) * self._cycle_s / tracking.length_m
        seems, t = self._seeming * before, tracking.state
        # All pieces carry the same tension, each with its own strain.
        leaving = strain * float(t["series_factor"]) / float(t["end_factor"])
        self._state["seeming"] = (seems + strain - before + share * (leaving - seems)) / strain
        more = self._seeming * strain - leaving
        for behind in self._spans[1:]:
            share = max(now.velocity_m_s, 0.0) * self._cycle_s / behind.tracking.length_m
            behind.without_joint += share * (more - behind.without_joint)
            more = behind.without_joint

    def _hand_on(self, span: _Span, behind: _Span | None, before_m: float, behind_m: float) -> None:
        """Move joints that have passed a span to the next one; a span filled by the new web takes its E."""
        stretch = 1.0 + span.tracking.strain
        passed = []
        for inside in span.joints:
            joint = inside.joint
            beyond_m = (before_m - joint.front_m) / stretch - span.tracking.length_m / stretch
            if beyond_m >= 0.0 and not inside.handed_on:
                inside.handed_on = True
                if behind is not None:
                    behind.joints.append(_Inside(joint._replace(front_m=behind_m - beyond_m * stretch)))
                    behind.put()
                if isinf(joint.length_m):
                    span.tracking.become(joint.relative_change)
                    passed.append(inside)
            if beyond_m >= joint.length_m:
                passed.append(inside)
        if passed:
            span.joints = [inside for inside in span.joints if inside not in passed]
            span.put()
