"""What happens to a web and must not be booked as its Young's modulus: a break, and a roller that begins to slip.

Both are seen in the ratio of the tension that the torque shows to the one that the encoders' strain would give with
the model's E, over a short window (the mean of the momentum balance; what the roller's motion takes is subtracted):

- break: the ratio falls to almost nothing while the strain says that the web should pull. No change of E goes so far.
- slip: the encoders no longer show the web's speed. The strain that they miss builds up over the length of the span,
  as 1 - exp(-s/L) of the length s that went through, while a change of E is there at once and a drift is much slower.
  A tension upstream that swings builds up as well, but to both sides: what goes no farther than it swung just before
  is no slip.

Nothing is judged while the measurement can't be used, as with a torque at its limit, nor across such a gap. Single
cycles that are missing do no harm: the window goes on over them, as long as it is mostly measured. Compiled.
"""

from __future__ import annotations

from math import isfinite

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation import ring
from hilbench.estimation.bank import Array
from hilbench.estimation.plausibility import Problem

#: Window of the mean tension.
_WINDOW_S = 0.04
#: Ratio below which the web is broken, and above which it is whole again.
_BROKEN, _WHOLE = 0.15, 0.3
#: So many times as long it may last with the cycles that are missing in it.
_LONGEST = 3.0
#: Smoothing of the tension that is usual: a web that breaks loses that, strange positions alone don't take it away.
_USUAL_S = 0.3
#: Least tension that the strain must promise for a ratio to mean anything, as a share of the machine's usual one.
_LEAST_SHARE = 0.125
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


_WEB_BREAK, _SLIP = int(Problem.WEB_BREAK), int(Problem.SLIP)
#: No change is under way.
_NONE = -1.0
# State; behind it rings: force (N), web (N/Pa), speed (m/s) and number of the cycles of the window, ratios before, and
# ratios as noted.
(
    _MODULUS_PA,  # what the ratio is formed with
    _MASS_KG,
    _SPAN_M,
    _CYCLE_S,
    _CYCLES,
    _LEAST_N,  # tension that the strain must promise
    _CYCLE,  # number of this one
    _FORCE_SUM_N,
    _WEB_SUM,
    _AFTER_GAP,
    _USUAL_N,
    _SINCE_CHANGE_M,  # what has gone through since a change that is not judged yet
    _QUIET_M,
    _RATIO_BEFORE,
    _RATIO_AT_ONCE,
    _SINCE_NOTED_M,
    _LEAST,
    _SETTLING,
    _BROKEN_NOW,
    _SLIPPING,
    _FORCES,  # where the rings begin
    _WEBS,
    _SPEEDS,
    _NUMBERS,
    _RATIOS,
    _SWUNG,
) = range(26)
_SIZE = 26


@compiled
def reset(s: Array) -> None:
    """The web is another one, or was at rest. s: state of `Anomalies`."""
    _clear_window(s)
    ring.clear(s, int(s[_RATIOS]))
    ring.clear(s, int(s[_SWUNG]))
    for place in (_AFTER_GAP, _USUAL_N, _RATIO_BEFORE, _RATIO_AT_ONCE, _SINCE_NOTED_M, _LEAST, _BROKEN_NOW, _SLIPPING):
        s[place] = 0.0
    s[_SINCE_CHANGE_M] = _NONE
    s[_QUIET_M] = _QUIET * s[_SPAN_M]


@inlined
def _clear_window(s: Array) -> None:
    ring.clear(s, int(s[_FORCES]))
    ring.clear(s, int(s[_WEBS]))
    ring.clear(s, int(s[_SPEEDS]))
    ring.clear(s, int(s[_NUMBERS]))
    s[_FORCE_SUM_N] = 0.0
    s[_WEB_SUM] = 0.0


@compiled
def interrupt(s: Array) -> None:
    """A cycle is missing: what is measured next is not one cycle after the last."""
    s[_CYCLE] += 1.0
    s[_AFTER_GAP] = 1.0


@compiled
def suspend(s: Array) -> None:
    """The measurement can't be used: a change that is under way, and what was before, say nothing any more."""
    interrupt(s)
    _clear_window(s)
    s[_SINCE_CHANGE_M] = _NONE
    ring.clear(s, int(s[_RATIOS]))


@inlined
def is_judging(s: Array) -> bool:
    """Whether something has changed that may yet be a slip."""
    return bool(s[_SINCE_CHANGE_M] >= 0.0)


@compiled
def look(s: Array, force_N: float, web_per_Pa: float, velocity_m_s: float) -> int:
    """Take the balance of this cycle; whether the web is broken or slips, as a `Problem`, 0: neither."""
    if not (isfinite(force_N) and isfinite(web_per_Pa)):
        reset(s)
        return 0
    s[_CYCLE] += 1.0
    if s[_AFTER_GAP] != 0.0:
        s[_AFTER_GAP] = 0.0
        return _found(s)
    forces, webs, speeds, numbers = int(s[_FORCES]), int(s[_WEBS]), int(s[_SPEEDS]), int(s[_NUMBERS])
    if ring.count(s, numbers) and s[_CYCLE] - ring.value(s, numbers, 0) > _LONGEST * s[_CYCLES]:
        _clear_window(s)
    if ring.is_full(s, forces):
        s[_FORCE_SUM_N] -= ring.value(s, forces, 0)
        s[_WEB_SUM] -= ring.value(s, webs, 0)
    ring.push(s, forces, force_N)
    ring.push(s, webs, web_per_Pa)
    ring.push(s, speeds, velocity_m_s)
    ring.push(s, numbers, s[_CYCLE])
    s[_FORCE_SUM_N] += force_N
    s[_WEB_SUM] += web_per_Pa
    if not ring.is_full(s, forces):
        return _found(s)
    count = ring.count(s, forces)
    promised_N = s[_MODULUS_PA] * s[_WEB_SUM] / count
    if promised_N < s[_LEAST_N]:
        s[_SINCE_CHANGE_M] = _NONE
        s[_QUIET_M] = _QUIET * s[_SPAN_M]
        return _found(s)
    if count > 3:
        gained_m_s = _speed(s, count - 3) - _speed(s, 0)
        cycles = ring.value(s, numbers, count - 2) - ring.value(s, numbers, 1)
    else:
        gained_m_s = velocity_m_s - ring.value(s, speeds, 0)
        cycles = s[_CYCLE] - ring.value(s, numbers, 0)
    accelerating_N = s[_MASS_KG] * gained_m_s / (cycles * s[_CYCLE_S])
    tension_N = s[_FORCE_SUM_N] / count - accelerating_N
    ratio, threshold = tension_N / promised_N, _WHOLE if s[_BROKEN_NOW] != 0.0 else _BROKEN
    broken = ratio < threshold and tension_N < threshold * s[_USUAL_N]
    s[_BROKEN_NOW] = 1.0 if broken else 0.0
    if not broken:
        s[_USUAL_N] += s[_CYCLE_S] / _USUAL_S * (tension_N - s[_USUAL_N])
    _look_for_slip(s, ratio, velocity_m_s)
    return _found(s)


@inlined
def _speed(s: Array, first: int) -> float:
    """The middle one of three speeds in a row: of a position that is of another instant one is too fast, and the next
    too slow."""
    speeds = int(s[_SPEEDS])
    a, b, c = ring.value(s, speeds, first), ring.value(s, speeds, first + 1), ring.value(s, speeds, first + 2)
    return max(min(a, b), min(max(a, b), c))


@inlined
def _found(s: Array) -> int:
    if s[_BROKEN_NOW] != 0.0:
        return _WEB_BREAK
    return _SLIP if s[_SLIPPING] != 0.0 else 0


@compiled
def _look_for_slip(s: Array, ratio: float, velocity_m_s: float) -> None:
    ratios, swung, moved_m = int(s[_RATIOS]), int(s[_SWUNG]), abs(velocity_m_s) * s[_CYCLE_S]
    s[_SINCE_NOTED_M] += moved_m
    if is_judging(s):
        _judge(s, ratio, moved_m)
    elif s[_QUIET_M] > 0.0:
        s[_QUIET_M] -= moved_m
        ring.clear(s, ratios)
    elif ring.is_full(s, ratios) and abs(ratio / ring.value(s, ratios, 0) - 1.0) > _CHANGED:
        before = ring.value(s, ratios, 0)
        s[_SINCE_CHANGE_M] = 0.0
        s[_RATIO_BEFORE] = before
        s[_RATIO_AT_ONCE] = 0.0
        low = high = ring.value(s, swung, 0) if ring.count(s, swung) else before
        for i in range(ring.count(s, swung)):
            low = min(low, ring.value(s, swung, i))
            high = max(high, ring.value(s, swung, i))
        s[_LEAST] = low - (high - low)
        s[_SETTLING] = s[_CYCLES]
        ring.clear(s, ratios)
    else:
        ring.push(s, ratios, ratio)
    if not is_judging(s) and s[_SINCE_NOTED_M] > _NOTED_EVERY * s[_SPAN_M]:
        s[_SINCE_NOTED_M] = 0.0
        ring.push(s, swung, ratio)


@compiled
def _judge(s: Array, ratio: float, moved_m: float) -> None:
    """A change is under way: what it was one window after it was seen, and what it has become."""
    s[_SINCE_CHANGE_M] += moved_m
    s[_SETTLING] -= 1.0
    if s[_SETTLING] == 0.0:
        s[_RATIO_AT_ONCE] = ratio
    if s[_SETTLING] > 0.0 or s[_SINCE_CHANGE_M] < _JUDGED_AFTER * s[_SPAN_M]:
        return
    change, at_once = ratio / s[_RATIO_BEFORE] - 1.0, s[_RATIO_AT_ONCE] / s[_RATIO_BEFORE] - 1.0
    s[_SINCE_CHANGE_M] = _NONE
    s[_QUIET_M] = _QUIET * s[_SPAN_M]
    if abs(change) <= _CHANGED:  # it has gone again
        s[_SLIPPING] = 0.0
    elif s[_BROKEN_NOW] == 0.0:
        s[_SLIPPING] = 1.0 if change < 0.0 and at_once / change < _AT_ONCE and ratio < s[_LEAST] else 0.0


def new_state(
    model_modulus_Pa: float, usual_tension_N: float, mass_kg: float, span_length_m: float, cycle_s: float
) -> Array:
    """State of what looks at each cycle's balance of axis 2.

    `model_modulus_Pa`: what the ratio is formed with; `mass_kg`: at the web, of what is behind the span.
    """
    cycles = round(_WINDOW_S / cycle_s)
    capacities = dict.fromkeys((_FORCES, _WEBS, _SPEEDS, _NUMBERS), cycles + 1)
    capacities |= {_RATIOS: _BEFORE_WINDOWS * cycles, _SWUNG: round(_QUIET / _NOTED_EVERY)}
    s = np.zeros(_SIZE + sum(map(ring.size, capacities.values())))
    s[_MODULUS_PA], s[_MASS_KG], s[_SPAN_M], s[_CYCLE_S] = model_modulus_Pa, mass_kg, span_length_m, cycle_s
    s[_CYCLES] = cycles
    s[_LEAST_N] = _LEAST_SHARE * usual_tension_N
    at = _SIZE
    for place, capacity in capacities.items():
        s[place] = at
        at = ring.put(s, at, capacity)
    return s
