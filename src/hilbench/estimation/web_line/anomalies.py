"""Web anomalies that must not be taken for a change of Young's modulus: a web break, and a slipping roller.

Both are detected in the ratio of the tension by the torque to that by the encoders' strain and the model's E, over two
blocks (`block_means`):

- break: the ratio falls to almost nothing while the strain requires tension. No change of E goes so far.
- slip: the encoders no longer measure the web's speed. The missing strain builds up over the length of the span, as
  1 - exp(-s/L) of the transported length s, while a change of E is immediate and a drift is much slower. An
  oscillating tension upstream builds up as well, but to both sides: within its previous range it is no slip.

Either has to exceed the noise of the blocks. Nothing is judged while the measurement is unusable, as with a torque at
saturation, nor across such a gap. Compiled.
"""

from __future__ import annotations

from math import sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Record, compiled, inlined, record_type
from hilbench.estimation import ring
from hilbench.estimation.assumptions import CERTAIN
from hilbench.estimation.problems import Problem
from hilbench.estimation.ring import RING

#: Ratio below which the web is broken, and above which it is whole again.
BROKEN, WHOLE = 0.15, 0.3
#: Smoothing time of the usual tension, which a breaking web loses, while implausible positions alone keep it; and of
#: its noise.
_USUAL_S = 0.3
#: Least tension by the strain for a meaningful ratio, as a share of the machine's usual one.
LEAST_SHARE = 0.125
#: Force that accelerates the roller, or its range within a block, over the tension by the strain, from which on nothing
#: is judged: a fifth of this, from a mass and a lag known to a tenth each, makes a whole web look broken.
_MOTION = 4.0
#: Change of the ratio against that of so many blocks before (a median of three) that starts an evaluation.
_CHANGED, BEFORE = 0.05, 12
#: Blocks after which an immediate change is complete, and a single outlier block is in no ratio any more.
_SETTLED = 2
#: Transported length, in spans, from a change to its judgement.
_JUDGED_AFTER = 1.0
#: Spans of web after which an initial difference of strain has left (exp(-5) of it remains). After a change or a slack
#: web no slip is detected until then: a leaving difference looks like a beginning one.
PASSED_SPANS = 5.0
#: Least share of the change at its judgement that a change of E has from its beginning.
_AT_ONCE = 0.7
#: Travel between notes of the ratio for its range, as a share of the span's length.
_NOTED_EVERY = 0.1


_WEB_BREAK, _SLIP = int(Problem.WEB_BREAK), int(Problem.SLIP)
#: No open change.
_NONE = -1.0
#: Number of ratios that are noted for their range: a span's length after length, while an initial difference leaves.
_NOTED: Final = round(PASSED_SPANS / _NOTED_EVERY)
#: State: E that the ratio is formed with; length of the span; least tension by the strain; the block before; the usual
#: tension, and the mean square of the difference of two blocks' tensions; travel since a change that is not judged yet;
#: what is left until a change counts; ratios before a change and soon after it; least ratio that was noted. Then the
#: ratios of the blocks before, and those noted for their range.
ANOMALIES: Final = np.dtype(
    [
        *record_type(
            *("modulus_Pa", "span_m", "least_N", "has_last", "last_N", "last_per_Pa", "usual_N", "scatter_N2"),
            *("since_change_m", "quiet_m", "ratio_before", "ratio_at_once", "since_noted_m", "least", "settling"),
            *("broken_now", "slipping"),
        ).descr,
        ("before", RING),
        ("ratios", "f8", (BEFORE,)),
        ("noted", RING),
        ("swung", "f8", (_NOTED,)),
    ]
)


@compiled
def reset(s: Record) -> None:
    """Reset for another web, or after a standstill. s: state of `new_state`."""
    suspend(s)
    ring.clear(s.noted)
    s.usual_N = s.scatter_N2 = s.ratio_before = s.ratio_at_once = s.since_noted_m = s.least = 0.0
    s.broken_now = s.slipping = 0.0
    s.quiet_m = PASSED_SPANS * s.span_m


@compiled
def suspend(s: Record) -> None:
    """Forget an open change and the previous blocks: the measurement is unusable."""
    s.has_last = 0.0
    s.since_change_m = _NONE
    ring.clear(s.before)


@inlined
def is_judging(s: Record) -> bool:
    """True if a change is open that may be a slip."""
    return bool(s.since_change_m >= 0.0)


@compiled
def look(s: Record, block: Record) -> None:
    """Take a complete block. `block`: state of `block_means`."""
    block_N, block_per_Pa = block.force_N, block.web_per_Pa
    first, gained_N = s.has_last == 0.0, block_N - s.last_N
    tension_N, web_per_Pa = 0.5 * (s.last_N + block_N), 0.5 * (s.last_per_Pa + block_per_Pa)
    s.has_last, s.last_N, s.last_per_Pa = 1.0, block_N, block_per_Pa
    if first:
        return
    promised_N = s.modulus_Pa * web_per_Pa
    if promised_N < s.least_N:
        s.since_change_m = _NONE
        s.quiet_m = PASSED_SPANS * s.span_m
        return
    if block.motion_N > _MOTION * promised_N:
        suspend(s)
        return
    ratio, threshold = tension_N / promised_N, WHOLE if s.broken_now != 0.0 else BROKEN
    sure_N = CERTAIN * sqrt(0.25 * s.scatter_N2)  # of the mean of two blocks
    broken = ratio < threshold and tension_N < min(threshold * s.usual_N, promised_N - sure_N)
    s.broken_now = 1.0 if broken else 0.0
    smoothing = min(block.duration_s / _USUAL_S, 1.0)
    if not broken:
        s.usual_N += smoothing * (tension_N - s.usual_N)
    s.scatter_N2 += smoothing * (gained_N * gained_N - s.scatter_N2)
    _look_for_slip(s, ratio, sure_N / promised_N, abs(block.velocity_m_s) * block.duration_s)


@inlined
def found(s: Record) -> int:
    """`Problem` of the web: broken or slipping; 0: neither."""
    if s.broken_now != 0.0:
        return _WEB_BREAK
    return _SLIP if s.slipping != 0.0 else 0


@compiled
def _look_for_slip(s: Record, ratio: float, sure: float, moved_m: float) -> None:
    """`sure`: a change of the ratio that is no noise."""
    s.since_noted_m += moved_m
    if is_judging(s):
        _judge(s, ratio, sure, moved_m)
    elif s.quiet_m > 0.0:
        s.quiet_m -= moved_m
        ring.clear(s.before)
    elif s.before.count == BEFORE and abs(ratio / _ratio_before(s) - 1.0) > max(_CHANGED, sure):
        before = _ratio_before(s)
        s.since_change_m = 0.0
        s.ratio_before = before
        s.ratio_at_once = 0.0
        low = high = s.swung[s.noted.first] if s.noted.count else before
        for i in range(s.noted.count):
            low = min(low, s.swung[i])
            high = max(high, s.swung[i])
        s.least = low - (high - low)
        s.settling = _SETTLED
        ring.clear(s.before)
    else:
        s.ratios[ring.push(s.before, BEFORE)] = ratio
    if not is_judging(s) and s.since_noted_m > _NOTED_EVERY * s.span_m:
        s.since_noted_m = 0.0
        s.swung[ring.push(s.noted, _NOTED)] = ratio


@inlined
def _ratio_before(s: Record) -> float:
    """Median of three old ratios, of which an outlier block is in one at most."""
    first, ratios = s.before, s.ratios
    a = ratios[ring.place(first, BEFORE, 0)]
    b = ratios[ring.place(first, BEFORE, _SETTLED)]
    c = ratios[ring.place(first, BEFORE, 2 * _SETTLED)]
    return float(max(min(a, b), min(max(a, b), c)))


@compiled
def _judge(s: Record, ratio: float, sure: float, moved_m: float) -> None:
    """Judge an open change by its ratio soon after detection and now: of a slip, more is missing now than noise."""
    changed = max(_CHANGED, sure)
    s.since_change_m += moved_m
    s.settling -= 1.0
    if s.settling == 0.0:
        s.ratio_at_once = ratio
        if abs(ratio / s.ratio_before - 1.0) <= changed:  # a single block was off
            s.since_change_m = _NONE
            return
    if s.settling > 0.0 or s.since_change_m < _JUDGED_AFTER * s.span_m:
        return
    change, at_once = ratio / s.ratio_before - 1.0, s.ratio_at_once / s.ratio_before - 1.0
    s.since_change_m = _NONE
    s.quiet_m = PASSED_SPANS * s.span_m
    if abs(change) <= changed:  # back to its earlier value
        s.slipping = 0.0
    elif s.broken_now == 0.0:
        s.slipping = 1.0 if change < 0.0 and at_once > _AT_ONCE * change + 0.5 * sure and ratio < s.least else 0.0


def new_state(model_modulus_Pa: float, usual_tension_N: float, span_length_m: float) -> NDArray[np.void]:
    """State of the anomaly detector on the blocks of axis 2. `model_modulus_Pa`: E of the ratio."""
    s = np.zeros(1, ANOMALIES)
    s["modulus_Pa"], s["span_m"], s["least_N"] = model_modulus_Pa, span_length_m, LEAST_SHARE * usual_tension_N
    return s
