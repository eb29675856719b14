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

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation import ring
from hilbench.estimation.bank import Array
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line import block_means

#: Ratio below which the web is broken, and above which it is whole again.
BROKEN, WHOLE = 0.15, 0.3
#: Smoothing time of the usual tension, which a breaking web loses, while implausible positions alone keep it; and of
#: its noise.
_USUAL_S = 0.3
#: Deviations of a certain break or change: normal noise exceeds them once in 31,000 blocks. 5 would hide a break from
#: drives that take late SYNCs for the next one, whose blocks scatter.
_SURE = 4.0
#: Least tension by the strain for a meaningful ratio, as a share of the machine's usual one.
LEAST_SHARE = 0.125
#: Force that accelerates the roller, or its range within a block, over the tension by the strain, from which on nothing
#: is judged: a fifth of this, from a mass and a lag known to a tenth each, makes a whole web look broken.
_MOTION = 4.0
#: Change of the ratio against that of so many blocks before (a median of three) that starts an evaluation.
_CHANGED, _BEFORE = 0.05, 12
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
# State; then two rings: ratios of the blocks before, and noted ratios.
(
    _MODULUS_PA,  # what the ratio is formed with
    _SPAN_M,
    _LEAST_N,  # least tension by the strain
    _HAS_LAST,  # the block before this one
    _LAST_N,
    _LAST_PER_PA,
    _USUAL_N,
    _SCATTER_N2,  # mean square of the difference of two blocks' tensions
    _SINCE_CHANGE_M,  # travel since a change that is not judged yet
    _QUIET_M,
    _RATIO_BEFORE,
    _RATIO_AT_ONCE,
    _SINCE_NOTED_M,
    _LEAST,
    _SETTLING,
    _BROKEN_NOW,
    _SLIPPING,
    _RATIOS,  # offsets of the rings
    _SWUNG,
) = range(19)
_SIZE = 19


@compiled
def reset(s: Array) -> None:
    """Reset for another web, or after a standstill. s: state of `new_state`."""
    suspend(s)
    ring.clear(s, int(s[_SWUNG]))
    for place in (_USUAL_N, _SCATTER_N2, _RATIO_BEFORE, _RATIO_AT_ONCE, _SINCE_NOTED_M, _LEAST, _BROKEN_NOW, _SLIPPING):
        s[place] = 0.0
    s[_QUIET_M] = PASSED_SPANS * s[_SPAN_M]


@compiled
def suspend(s: Array) -> None:
    """Forget an open change and the previous blocks: the measurement is unusable."""
    s[_HAS_LAST] = 0.0
    s[_SINCE_CHANGE_M] = _NONE
    ring.clear(s, int(s[_RATIOS]))


@inlined
def is_judging(s: Array) -> bool:
    """True if a change is open that may be a slip."""
    return bool(s[_SINCE_CHANGE_M] >= 0.0)


@compiled
def look(s: Array, block: Array) -> None:
    """Take a complete block. `block`: state of `block_means`."""
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
    _look_for_slip(s, ratio, sure_N / promised_N, abs(block[block_means.VELOCITY_M_S]) * block[block_means.DURATION_S])


@inlined
def found(s: Array) -> int:
    """`Problem` of the web: broken or slipping; 0: neither."""
    if s[_BROKEN_NOW] != 0.0:
        return _WEB_BREAK
    return _SLIP if s[_SLIPPING] != 0.0 else 0


@compiled
def _look_for_slip(s: Array, ratio: float, sure: float, moved_m: float) -> None:
    """`sure`: a change of the ratio that is no noise."""
    ratios, swung = int(s[_RATIOS]), int(s[_SWUNG])
    s[_SINCE_NOTED_M] += moved_m
    if is_judging(s):
        _judge(s, ratio, sure, moved_m)
    elif s[_QUIET_M] > 0.0:
        s[_QUIET_M] -= moved_m
        ring.clear(s, ratios)
    elif ring.is_full(s, ratios) and abs(ratio / _ratio_before(s) - 1.0) > max(_CHANGED, sure):
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
    """Median of three old ratios, of which an outlier block is in one at most."""
    ratios = int(s[_RATIOS])
    a, b, c = ring.value(s, ratios, 0), ring.value(s, ratios, _SETTLED), ring.value(s, ratios, 2 * _SETTLED)
    return max(min(a, b), min(max(a, b), c))


@compiled
def _judge(s: Array, ratio: float, sure: float, moved_m: float) -> None:
    """Judge an open change by its ratio soon after detection and now: of a slip, more is missing now than noise."""
    changed = max(_CHANGED, sure)
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
    if abs(change) <= changed:  # back to its earlier value
        s[_SLIPPING] = 0.0
    elif s[_BROKEN_NOW] == 0.0:
        s[_SLIPPING] = 1.0 if change < 0.0 and at_once > _AT_ONCE * change + 0.5 * sure and ratio < s[_LEAST] else 0.0


def new_state(model_modulus_Pa: float, usual_tension_N: float, span_length_m: float) -> Array:
    """State of the anomaly detector on the blocks of axis 2. `model_modulus_Pa`: E of the ratio."""
    capacities = {_RATIOS: _BEFORE, _SWUNG: round(PASSED_SPANS / _NOTED_EVERY)}
    s = np.zeros(_SIZE + sum(map(ring.size, capacities.values())))
    s[_MODULUS_PA], s[_SPAN_M], s[_LEAST_N] = model_modulus_Pa, span_length_m, LEAST_SHARE * usual_tension_N
    at = _SIZE
    for place, capacity in capacities.items():
        s[place] = at
        at = ring.put(s, at, capacity)
    return s
