"""Torque-shift detector: a shift of friction or torque offset, separated from a change of E.

Both change the torque at once, and are not identifiable at one strain alone: F = E·h + d, with h = F/E by the encoders.
The strain that moves afterwards separates them: the closed tension loop takes either for another tension. From then on
a changed E is on a line through the origin, F = E'·h, a shift on the one that was there before, F = E·h + d, and the
two are compared by their squared residuals over the noise (likelihood ratio). While both fit, the change stays open:
the next change of tension decides. A constant error of the balance (c) is in both: F = E'·h + c, and F = (E - c/h)·h +
c + d.

Strain changes before the change, other than the loop's, are no evidence: whether they go with the force or not, no line
through them has the slope of the web. A shift is found only where the strain has moved by more than that.

Slow oscillation before the change, as of a tension upstream, is no white noise of the blocks: it counts as many times
as the blocks before are correlated.

Both are searched in block means (`block_means`). No shift is searched while the speed changes (an inertia error looks
like one). When neither line fits it was something else.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation import ring
from hilbench.estimation.bank import Array
from hilbench.estimation.web_line.block_means import SAME_SPEED

#: Blocks used as reference before a change, and the least number of them.
_BEFORE, _ENOUGH = 60, 24
#: Blocks left out after that of the change: a shaft that was hit is on no line, nor is a load motor that emulates a web
#: some cycles late.
_HIT = 1
#: Change that is evaluated: over the noise of a block, and relative to the tension.
_CHANGED_NOISES, _CHANGED = 6.0, 0.02
#: Least noise of a block, relative to the tension: the rest of the model's own errors.
_NOISE_FLOOR = 1e-3
#: Change of tension from block to block that counts as noise, times this: torque and motion are of one instant to some
#: milliseconds only.
_LATE = 0.15
#: Largest correlation of the noise of successive blocks: a slow oscillation is no sum of random values.
_MOST_ALIKE = 0.98
#: Squared residuals over the noise: difference that decides, and largest one of an acceptable explanation.
_DECIDED, _ACCEPTED = 16.0, 9.0
#: Their difference of E over a shift, when the change has been open for long: it is closed; it is not reported as
#: undecided; it is reported so again.
_SETTLED, _LEANS, _LEANS_NO_MORE = 8.0, 5.0, 2.5
#: Prior: E changes oftener than friction or offset, 100 to 1: twice the logarithm. It counts where the strain has
#: followed the change by this share, as with a closed loop; where it has not, another tension is needed.
_OFTENER, _FOLLOWED = 9.2, 0.5
#: Variance of the strain since the change over that before, from which on its movement outweighs its disturbances: a
#: slope is then off by a fifth of what the disturbances alone would show (errors in variables).
_MOVED = 5.0
#: Blocks that an explanation needs, after which it counts as undecided, and after which it is closed.
_LEAST, _LONG, _LONGEST = 15, 150, 3000


# State. Of a change: values before it (E of the line through the blocks before: stated E includes other effects) and
# sums over the blocks since, of force f and web h; the result. Then four rings of the blocks before: force (N), web
# (N/Pa), final speed (m/s) and stated E (Pa).
(
    _OPEN,
    _MODULUS_PA,
    _STATED_PA,
    _WEB_PER_PA,
    _WEB_VARIANCE_PER_PA2,
    _VARIANCE_N2,
    _SLOWNESS,  # factor on the noise before in a sum, relative to white noise
    _HITS,
    _LEANS_TO_MODULUS,
    _HAS_FOLLOWED,
    _WEB_LAST_PER_PA,  # of the block before
    _COUNT,
    _F,
    _H,
    _FF,
    _FH,
    _HH,
    FOUND_N,
    FOUND_PA,
    _FORCES,
    _WEBS,
    _SPEEDS,
    _STATED,
) = range(23)
_SIZE = 23


@compiled
def reset(s: Array) -> None:
    """Forget all blocks and an open change."""
    s[_OPEN] = 0.0
    ring.clear(s, int(s[_FORCES]))
    ring.clear(s, int(s[_WEBS]))
    ring.clear(s, int(s[_SPEEDS]))
    ring.clear(s, int(s[_STATED]))


@compiled
def look(
    s: Array,
    block_N: float,
    block_per_Pa: float,
    velocity_m_s: float,
    stated_Pa: float,
    may_decide: bool,
    deviation_N: float,
) -> bool:
    """Take the means of a complete block, and the stated E. True if a shift is certain: then FOUND_N is the force at
    the web by which the torque has shifted, FOUND_PA the E stated before.

    Without `may_decide` a certain shift is not yet returned: it may be something else. `deviation_N`: standard
    deviation of a constant error of the balance.
    """
    before = int(s[_SPEEDS])
    changed_speed = False
    if ring.count(s, before) > 0:
        first_m_s = ring.value(s, before, 0)
        changed_speed = not abs(velocity_m_s - first_m_s) <= SAME_SPEED * abs(first_m_s)
    if block_per_Pa <= 0.0 or changed_speed:
        reset(s)
    elif s[_OPEN] != 0.0:
        return _explain(s, block_N, block_per_Pa, may_decide, deviation_N)
    elif ring.count(s, before) < _ENOUGH or not _is_noticed(s, block_N, block_per_Pa):
        ring.push(s, int(s[_FORCES]), block_N)
        ring.push(s, int(s[_WEBS]), block_per_Pa)
        ring.push(s, before, velocity_m_s)
        ring.push(s, int(s[_STATED]), stated_Pa)
    return False


@compiled
def _is_noticed(s: Array, block_N: float, block_per_Pa: float) -> bool:
    """True if the block differs from those before. The block itself is a mixture, and belongs to neither side."""
    forces, webs, force_N, web_per_Pa, squares = int(s[_FORCES]), int(s[_WEBS]), 0.0, 0.0, 0.0
    count = ring.count(s, forces)
    for i in range(count):
        force_N += ring.value(s, forces, i)
        web_per_Pa += ring.value(s, webs, i)
    modulus_Pa = force_N / web_per_Pa
    tension_N = abs(modulus_Pa * block_per_Pa)
    before_N, products = 0.0, 0.0
    spread_per_Pa2 = 0.0
    for i in range(count):
        residual_N = ring.value(s, forces, i) - modulus_Pa * ring.value(s, webs, i)
        spread_per_Pa2 += (ring.value(s, webs, i) - web_per_Pa / count) ** 2
        squares += residual_N * residual_N
        products += residual_N * before_N
        before_N = residual_N
    alike = min(max(products / squares, 0.0), _MOST_ALIKE) if squares > 0.0 else 0.0
    variance_N2 = max(squares / (count - 1), (_NOISE_FLOOR * tension_N) ** 2)
    difference_N = abs(block_N - modulus_Pa * block_per_Pa)
    if difference_N < max(_CHANGED_NOISES * sqrt(variance_N2), _CHANGED * tension_N):
        return False
    s[_OPEN], s[_MODULUS_PA], s[_WEB_PER_PA], s[_VARIANCE_N2] = 1.0, modulus_Pa, web_per_Pa / count, variance_N2
    s[_WEB_VARIANCE_PER_PA2] = spread_per_Pa2 / (count - 1)
    s[_SLOWNESS] = (1.0 + alike) / (1.0 - alike)
    s[_STATED_PA] = ring.value(s, int(s[_STATED]), count - 1)
    s[_HITS], s[_LEANS_TO_MODULUS], s[_HAS_FOLLOWED] = _HIT, 0.0, 0.0
    for place in (_COUNT, _F, _H, _FF, _FH, _HH):
        s[place] = 0.0
    return True


@compiled
def _explain(s: Array, f: float, h: float, may_decide: bool, deviation_N: float) -> bool:
    if s[_HITS] > 0.0:
        s[_HITS] -= 1.0
        s[_WEB_LAST_PER_PA] = h
        return False
    late_N = _LATE * s[_MODULUS_PA] * (h - s[_WEB_LAST_PER_PA])
    weight = s[_VARIANCE_N2] / (s[_VARIANCE_N2] + late_N * late_N)
    s[_WEB_LAST_PER_PA] = h
    s[_COUNT] += weight
    s[_F] += weight * f
    s[_H] += weight * h
    s[_FF] += weight * f * f
    s[_FH] += weight * f * h
    s[_HH] += weight * h * h
    count = s[_COUNT]
    if count < _LEAST or not may_decide:
        return False
    free = _free(s)
    # The oscillation of a shaft that was hit is on neither line: it counts as noise.
    variance = s[_SLOWNESS] * max(s[_VARIANCE_N2], free / (count - 2.0))
    precision = variance / (deviation_N * deviation_N) if deviation_N != 0.0 else inf
    shift_N, of_shift = _of_shift(s, precision)
    of_shift, of_modulus = (of_shift - free) / variance, (_of_modulus(s, precision) - free) / variance
    if of_modulus - of_shift > _DECIDED and of_shift < _ACCEPTED and _has_moved(s):
        s[FOUND_N], s[FOUND_PA] = shift_N, s[_STATED_PA]
        reset(s)
        return True
    better = of_shift - of_modulus
    # Once it has followed, a later set-point does not undo that.
    if _has_followed(s):
        s[_HAS_FOLLOWED] = 1.0
    likelier = better + _OFTENER * s[_HAS_FOLLOWED]
    s[_LEANS_TO_MODULUS] = 1.0 if likelier > (_LEANS_NO_MORE if s[_LEANS_TO_MODULUS] != 0.0 else _LEANS) else 0.0
    enough = _SETTLED if count >= _LONG else _DECIDED
    settled = better > enough or min(of_shift, of_modulus) > _DECIDED
    if settled or count >= _LONGEST:
        reset(s)
    return False


@inlined
def _has_moved(s: Array) -> bool:
    """True if the strain has changed by more than at a constant tension: its disturbances (upstream tension, torque of
    its roller) are in the force as well, and no line through them has the slope of the web."""
    spread = s[_HH] / s[_COUNT] - (s[_H] / s[_COUNT]) ** 2
    return bool(spread > _MOVED * s[_WEB_VARIANCE_PER_PA2])


@inlined
def _has_followed(s: Array) -> bool:
    """True if the strain has changed since as a controlled tension requires with another E."""
    strain = s[_H] / s[_COUNT] / s[_WEB_PER_PA] - 1.0
    force = s[_F] / s[_COUNT] / (s[_MODULUS_PA] * s[_WEB_PER_PA]) - 1.0
    return bool(abs(strain) > _FOLLOWED * (abs(force) + abs(strain)))


@compiled
def _of_modulus(s: Array, precision: float) -> float:
    """Squared residuals of f = E'·h + c with a small c; `precision`: variance of the noise over that of c; infinite: c
    = 0."""
    through_origin = s[_FF] - s[_FH] * s[_FH] / s[_HH]
    if precision == inf:
        return float(through_origin)
    # Least squares for c in addition to E', with c² weighed by its precision.
    across = s[_F] - s[_FH] * s[_H] / s[_HH]
    return float(through_origin - across * across / (s[_COUNT] - s[_H] * s[_H] / s[_HH] + precision))


@compiled
def _of_shift(s: Array, precision: float) -> tuple[float, float]:
    """Shift d of f = E·h + d, and the squared residuals. E was c/h smaller before: c as in `_of_modulus`."""
    modulus_Pa, web_before_per_Pa = s[_MODULUS_PA], s[_WEB_PER_PA]
    s_fh = s[_FH] - s[_F] * s[_H] / s[_COUNT]
    s_hh = max(s[_HH] - s[_H] * s[_H] / s[_COUNT], 0.0)
    s_ff = s[_FF] - s[_F] * s[_F] / s[_COUNT]
    least, held = modulus_Pa, 0.0
    if precision < inf:
        held = precision * web_before_per_Pa * web_before_per_Pa
        least = (s_fh + held * modulus_Pa) / (s_hh + held)
    d = (s[_F] - least * s[_H]) / s[_COUNT]
    squares = s_ff - 2.0 * least * s_fh + least * least * s_hh
    if precision < inf:
        squares += held * (least - modulus_Pa) ** 2
    # An earlier error is in the stated E: the shift is the increase since.
    return d - (modulus_Pa - least) * web_before_per_Pa, squares


@compiled
def _free(s: Array) -> float:
    """Squared residuals of f = E'·h + d'."""
    s_ff = s[_FF] - s[_F] * s[_F] / s[_COUNT]
    s_fh = s[_FH] - s[_F] * s[_H] / s[_COUNT]
    s_hh = s[_HH] - s[_H] * s[_H] / s[_COUNT]
    return float(s_ff - s_fh * s_fh / s_hh if s_hh > 0.0 else s_ff)


@compiled
def undecided(s: Array) -> bool:
    """True if a change has been open for long, and may equally be E or a shift."""
    return bool(s[_OPEN] != 0.0 and s[_COUNT] >= _LONG and s[_LEANS_TO_MODULUS] == 0.0)


def new_state() -> Array:
    """State of the torque-shift detector on the blocks of axis 2."""
    size = ring.size(_BEFORE)
    s = np.zeros(_SIZE + 4 * size)
    for number, place in enumerate((_FORCES, _WEBS, _SPEEDS, _STATED)):
        s[place] = _SIZE + number * size
        ring.put(s, _SIZE + number * size, _BEFORE)
    return s
