"""What happens to a web and must not be booked as its Young's modulus: a break, and a roller that begins to slip.

Both are seen in the ratio of the tension that the torque shows to the one that the encoders' strain would give with
the model's E, over a short window (the mean of the momentum balance; what the roller's motion takes is subtracted):

- break: the ratio falls to almost nothing while the strain says that the web should pull. No change of E goes so far.
- slip: the encoders no longer show the web's speed. The strain that they miss builds up over the length of the span,
  as 1 - exp(-s/L) of the length s that went through, while a change of E is there at once and a drift is much slower.
  A tension upstream that swings builds up as well, but to both sides: what goes no farther than it swung just before
  is no slip.

Nothing is judged while the measurement can't be used, as with a torque at its limit, nor across such a gap.
"""

from __future__ import annotations

from collections import deque
from math import isfinite

from hilbench.estimation.web_line.balance import BalanceSample

#: Window of the mean tension.
_WINDOW_S = 0.04
#: Ratio below which the web is broken, and above which it is whole again.
_BROKEN, _WHOLE = 0.15, 0.3
#: Smoothing of the tension that is usual: a web that breaks loses that, strange positions alone don't take it away.
_USUAL_S = 0.3
#: Least tension that the strain must promise for a ratio to mean anything, N.
_LEAST_N = 10.0
#: Change of the ratio against what it was before from which something has happened.
_CHANGED = 0.05
#: Transported length, in spans, from a change to its judgement; what "before" means, in windows.
_JUDGED_AFTER = 1.0
#: Transported length, in spans, after a change or a slack web in which no slip is looked for: what happened to the
#: strain then leaves the span with the web, and that looks like a slip that comes or goes.
_QUIET = 5.0
_BEFORE_WINDOWS = 5
#: Share of the change at its judgement that a change of E has had from its beginning.
_AT_ONCE = 0.7
#: How often the ratio is noted for the range that it swings in, as a share of the span's length.
_NOTED_EVERY = 0.02


class Anomalies:
    """Looks at each cycle's balance of axis 2. `model_modulus_Pa`: what the ratio is formed with."""

    def __init__(self, model_modulus_Pa: float, mass_kg: float, span_length_m: float, cycle_s: float) -> None:
        self._modulus_Pa = model_modulus_Pa
        self._mass_kg = mass_kg
        self._span_length_m = span_length_m
        self._cycle_s = cycle_s
        self._cycles = round(_WINDOW_S / cycle_s)
        self.reset()

    def reset(self) -> None:
        """The web is another one, or was at rest."""
        self._window: deque[tuple[float, float, float]] = deque(maxlen=self._cycles + 1)
        self._ratios: deque[float] = deque(maxlen=_BEFORE_WINDOWS * self._cycles)
        self._force_sum_N = self._web_sum = 0.0
        self._after_gap = False
        self._usual_N = 0.0
        self._since_change_m: float | None = None
        self._quiet_m = _QUIET * self._span_length_m
        self._ratio_before = self._ratio_at_once = 0.0
        self._swung: deque[float] = deque(maxlen=round(_QUIET / _NOTED_EVERY))
        self._since_noted_m = 0.0
        self._least = 0.0
        self.broken = False
        self.slipping = False

    def suspend(self) -> None:
        """The measurement can't be used: a change that is under way, and what was before, say nothing any more."""
        self.interrupt()
        self._since_change_m = None
        self._ratios.clear()

    def interrupt(self) -> None:
        """A cycle is missing: what is measured next is not one cycle after the last, and no mean goes across."""
        self._window.clear()
        self._force_sum_N = self._web_sum = 0.0
        self._after_gap = True

    @property
    def judging(self) -> bool:
        """Whether something has changed that may yet be a slip."""
        return self._since_change_m is not None

    def update(self, now: BalanceSample) -> None:
        """Take the balance of this cycle; sets `broken` and `slipping`."""
        if not (isfinite(now.force_N) and isfinite(now.web_per_Pa)):
            self.reset()
            return
        if self._after_gap:
            self._after_gap = False
            return
        window = self._window
        if len(window) == window.maxlen:
            force_N, web, _ = window[0]
            self._force_sum_N -= force_N
            self._web_sum -= web
        window.append((now.force_N, now.web_per_Pa, now.velocity_m_s))
        self._force_sum_N += now.force_N
        self._web_sum += now.web_per_Pa
        if len(window) < (window.maxlen or 0):
            return
        count = len(window)
        promised_N = self._modulus_Pa * self._web_sum / count
        if promised_N < _LEAST_N:
            self._since_change_m = None
            self._quiet_m = _QUIET * self._span_length_m
            return
        accelerating_N = self._mass_kg * (now.velocity_m_s - window[0][2]) / ((count - 1) * self._cycle_s)
        tension_N = self._force_sum_N / count - accelerating_N
        ratio, threshold = tension_N / promised_N, _WHOLE if self.broken else _BROKEN
        self.broken = ratio < threshold and tension_N < threshold * self._usual_N
        if not self.broken:
            self._usual_N += self._cycle_s / _USUAL_S * (tension_N - self._usual_N)
        self._look_for_slip(ratio, now.velocity_m_s)

    def _look_for_slip(self, ratio: float, velocity_m_s: float) -> None:
        ratios = self._ratios
        self._since_noted_m += abs(velocity_m_s) * self._cycle_s
        if self._since_change_m is not None:
            self._judge(ratio, abs(velocity_m_s) * self._cycle_s)
        elif self._quiet_m > 0.0:
            self._quiet_m -= abs(velocity_m_s) * self._cycle_s
            ratios.clear()
        elif len(ratios) == ratios.maxlen and abs(ratio / ratios[0] - 1.0) > _CHANGED:
            self._since_change_m = 0.0
            self._ratio_before, self._ratio_at_once = ratios[0], 0.0
            low, high = min(self._swung, default=ratios[0]), max(self._swung, default=ratios[0])
            self._least = low - (high - low)
            self._settling = self._cycles
            ratios.clear()
        else:
            ratios.append(ratio)
        if self._since_change_m is None and self._since_noted_m > _NOTED_EVERY * self._span_length_m:
            self._since_noted_m = 0.0
            self._swung.append(ratio)

    def _judge(self, ratio: float, moved_m: float) -> None:
        """A change is under way: what it was one window after it was seen, and what it has become."""
        assert self._since_change_m is not None, "a change was seen"
        self._since_change_m += moved_m
        self._settling -= 1
        if self._settling == 0:
            self._ratio_at_once = ratio
        if self._settling > 0 or self._since_change_m < _JUDGED_AFTER * self._span_length_m:
            return
        change, at_once = ratio / self._ratio_before - 1.0, self._ratio_at_once / self._ratio_before - 1.0
        self._since_change_m = None
        self._quiet_m = _QUIET * self._span_length_m
        if abs(change) <= _CHANGED:  # it has gone again
            self.slipping = False
        elif not self.broken:
            self.slipping = change < 0.0 and at_once / change < _AT_ONCE and ratio < self._least
