"""What happens to a web and must not be booked as its Young's modulus: a break, and a roller that begins to slip.

Both are seen in the ratio of the tension that the torque shows to the one that the encoders' strain would give with
the model's E, over two blocks (`blocks`):

- break: the ratio falls to almost nothing while the strain says that the web should pull. No change of E goes so far.
- slip: the encoders no longer show the web's speed. The strain that they miss builds up over the length of the span,
  as 1 - exp(-s/L) of the length s that went through, while a change of E is there at once and a drift is much slower.
  A tension upstream that swings builds up as well, but to both sides: what goes no farther than it swung just before
  is no slip.

Either has to stand out of the noise of the blocks. Nothing is judged while the measurement can't be used, as with a
torque at its limit, nor across such a gap. Compiled.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation import ring
from hilbench.estimation.bank import Array
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line import block_means

#: Ratio below which the web is broken, and above which it is whole again.
BROKEN, WHOLE = 0.15, 0.3
#: Smoothing of the tension that is usual: a web that breaks loses that, strange positions alone don't take it away; and
#: of its noise.
_USUAL_S = 0.3
#: Deviations by which a break or a change stands out: normal noise goes so far once in 31,000 blocks. 5 would hide a
#: break from drives that take late SYNCs for the next one, whose blocks scatter.
_SURE = 4.0
#: Least tension that the strain must promise for a ratio to mean anything, as a share of the machine's usual one.
LEAST_SHARE = 0.125
#: Force that accelerates the roller, or its range within a block, over the tension that the strain promises, from which
#: nothing is judged: a fifth of this, from a mass and a lag known to a tenth each, makes a whole web look broken.
_MOTION = 4.0
#: Change of the ratio against that of so many blocks before (a median of three) from which something happened.
_CHANGED, _BEFORE = 0.05, 12
#: Blocks after which a change that is there at once is there, and a single block that is off is in no ratio any more.
_SETTLED = 2
#: Transported length, in spans, from a change to its judgement.
_JUDGED_AFTER = 1.0
#: Spans of web after which a strain that was another one when they began to pass is none any more (exp(-5) of it is
#: left). After a change or a slack web no slip is looked for until then: what leaves looks like one that comes or goes.
PASSED_SPANS = 5.0
#: Share of the change at its judgement that a change of E has had from its beginning.
_AT_ONCE = 0.7
#: How often the ratio is noted for the range that it swings in, as a share of the span's length.
_NOTED_EVERY = 0.1


_WEB_BREAK, _SLIP = int(Problem.WEB_BREAK), int(Problem.SLIP)
#: No change is under way.
_NONE = -1.0
# State; behind it two rings: ratios of the blocks before, and ratios as noted.
(
    _MODULUS_PA,  # what the ratio is formed with
    _SPAN_M,
    _LEAST_N,  # tension that the strain must promise
    _HAS_LAST,  # the block before this one
    _LAST_N,
    _LAST_PER_PA,
    _USUAL_N,
    _SCATTER_N2,  # mean square of the difference of two blocks' tensions
    _SINCE_CHANGE_M,  # what has gone through since a change that is not judged yet
    _QUIET_M,
    _RATIO_BEFORE,
    _RATIO_AT_ONCE,
    _SINCE_NOTED_M,
    _LEAST,
    _SETTLING,
    _BROKEN_NOW,
    _SLIPPING,
    _RATIOS,  # where the rings begin
    _SWUNG,
) = range(19)
_SIZE = 19


@compiled
def reset(s: Array) -> None:
    """The web is another one, or was at rest. s: state of `new_state`."""
    suspend(s)
    ring.clear(s, int(s[_SWUNG]))
    for place in (_USUAL_N, _SCATTER_N2, _RATIO_BEFORE, _RATIO_AT_ONCE, _SINCE_NOTED_M, _LEAST, _BROKEN_NOW, _SLIPPING):
        s[place] = 0.0
    s[_QUIET_M] = PASSED_SPANS * s[_SPAN_M]


@compiled
def suspend(s: Array) -> None:
    """The measurement can't be used: a change that is under way, and what was before, say nothing any more."""
    s[_HAS_LAST] = 0.0
    s[_SINCE_CHANGE_M] = _NONE
    ring.clear(s, int(s[_RATIOS]))


@inlined
def is_judging(s: Array) -> bool:
    """Whether something has changed that may yet be a slip."""
    return bool(s[_SINCE_CHANGE_M] >= 0.0)


@compiled
def look(s: Array, block: Array) -> None:
    """Take a block that is complete. `block`: state of `blocks`."""
    block_N, block_per_Pa = block[block_means.FORCE_N], block[block_means.WEB_PER_PA]
    first, gained_N = s[_HAS_LAST] == 0.0, block_N - s[_LAST_N]
    tension_N, web_per_Pa = 0.5 * (s[_LAST_N] + block_N), 0.5 * (s[_LAST_PER_PA] + block_per_Pa)
    s[_HAS_LAST], s[_LAST_N], s[_LAST_PER_PA] = 1.0, block_N, block_per_Pa
    if first:
        return
    promised_N = s[_MODULUS_PA] * web_per_Pa
    if promised_N < s[_LEAST_N]:
        s[_SINCE_CHANGE_M] = _NONE
        s[_QUIET_M] = PASSED_SPANS * s[_SPAN_M]
        return
    if block[block_means.MOTION_N] > _MOTION * promised_N:
        suspend(s)
        return
    ratio, threshold = tension_N / promised_N, WHOLE if s[_BROKEN_NOW] != 0.0 else BROKEN
    sure_N = _SURE * sqrt(0.25 * s[_SCATTER_N2])  # of the mean of two blocks
    broken = ratio < threshold and tension_N < min(threshold * s[_USUAL_N], promised_N - sure_N)
    s[_BROKEN_NOW] = 1.0 if broken else 0.0
    smoothing = min(block[block_means.DURATION_S] / _USUAL_S, 1.0)
    if not broken:
        s[_USUAL_N] += smoothing * (tension_N - s[_USUAL_N])
    s[_SCATTER_N2] += smoothing * (gained_N * gained_N - s[_SCATTER_N2])
    changed = max(_CHANGED, sure_N / promised_N)
    _look_for_slip(s, ratio, changed, abs(block[block_means.VELOCITY_M_S]) * block[block_means.DURATION_S])


@inlined
def found(s: Array) -> int:
    """Whether the web is broken or slips, as a `Problem`; 0: neither."""
    if s[_BROKEN_NOW] != 0.0:
        return _WEB_BREAK
    return _SLIP if s[_SLIPPING] != 0.0 else 0


@compiled
def _look_for_slip(s: Array, ratio: float, changed: float, moved_m: float) -> None:
    ratios, swung = int(s[_RATIOS]), int(s[_SWUNG])
    s[_SINCE_NOTED_M] += moved_m
    if is_judging(s):
        _judge(s, ratio, changed, moved_m)
    elif s[_QUIET_M] > 0.0:
        s[_QUIET_M] -= moved_m
        ring.clear(s, ratios)
    elif ring.is_full(s, ratios) and abs(ratio / _ratio_before(s) - 1.0) > changed:
        before = _ratio_before(s)
        s[_SINCE_CHANGE_M] = 0.0
        s[_RATIO_BEFORE] = before
        s[_RATIO_AT_ONCE] = 0.0
        low = high = ring.value(s, swung, 0) if ring.count(s, swung) else before
        for i in range(ring.count(s, swung)):
            low = min(low, ring.value(s, swung, i))
            high = max(high, ring.value(s, swung, i))
        s[_LEAST] = low - (high - low)
        s[_SETTLING] = _SETTLED
        ring.clear(s, ratios)
    else:
        ring.push(s, ratios, ratio)
    if not is_judging(s) and s[_SINCE_NOTED_M] > _NOTED_EVERY * s[_SPAN_M]:
        s[_SINCE_NOTED_M] = 0.0
        ring.push(s, swung, ratio)


@inlined
def _ratio_before(s: Array) -> float:
    """The median of three old ratios, of which a single block that is off is in one at most."""
    ratios = int(s[_RATIOS])
    a, b, c = ring.value(s, ratios, 0), ring.value(s, ratios, _SETTLED), ring.value(s, ratios, 2 * _SETTLED)
    return max(min(a, b), min(max(a, b), c))


@compiled
def _judge(s: Array, ratio: float, changed: float, moved_m: float) -> None:
    """A change is under way: what it was soon after it was seen, and what it has become."""
    s[_SINCE_CHANGE_M] += moved_m
    s[_SETTLING] -= 1.0
    if s[_SETTLING] == 0.0:
        s[_RATIO_AT_ONCE] = ratio
        if abs(ratio / s[_RATIO_BEFORE] - 1.0) <= changed:  # a single block was off
            s[_SINCE_CHANGE_M] = _NONE
            return
    if s[_SETTLING] > 0.0 or s[_SINCE_CHANGE_M] < _JUDGED_AFTER * s[_SPAN_M]:
        return
    change, at_once = ratio / s[_RATIO_BEFORE] - 1.0, s[_RATIO_AT_ONCE] / s[_RATIO_BEFORE] - 1.0
    s[_SINCE_CHANGE_M] = _NONE
    s[_QUIET_M] = PASSED_SPANS * s[_SPAN_M]
    if abs(change) <= changed:  # it has gone again
        s[_SLIPPING] = 0.0
    elif s[_BROKEN_NOW] == 0.0:
        s[_SLIPPING] = 1.0 if change < 0.0 and at_once / change < _AT_ONCE and ratio < s[_LEAST] else 0.0


def new_state(model_modulus_Pa: float, usual_tension_N: float, span_length_m: float) -> Array:
    """State of what looks at the blocks of axis 2. `model_modulus_Pa`: what the ratio is formed with."""
    capacities = {_RATIOS: _BEFORE, _SWUNG: round(PASSED_SPANS / _NOTED_EVERY)}
    s = np.zeros(_SIZE + sum(map(ring.size, capacities.values())))
    s[_MODULUS_PA], s[_SPAN_M], s[_LEAST_N] = model_modulus_Pa, span_length_m, LEAST_SHARE * usual_tension_N
    at = _SIZE
    for place, capacity in capacities.items():
        s[place] = at
        at = ring.put(s, at, capacity)
    return s
