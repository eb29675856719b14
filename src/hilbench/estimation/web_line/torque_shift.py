"""Torque-shift detector: a shift of friction or torque offset, separated from a change of E.

Both change the torque at once, and are not identifiable at one strain alone: F = E·h + d, with h = F/E by the encoders.
The strain that moves afterwards separates them: the closed tension loop takes either for another tension. From then on
a changed E is on a line through the origin, F = E'·h, a shift on the one that was there before, F = E·h + d, and the
two are compared by their squared residuals over the noise (likelihood ratio). While both fit, the change stays open:
the next change of tension decides. A constant error of the balance (c) is in both: F = E'·h + c, and F = (E - c/h)·h +
c + d.

Strain changes before the change, other than the loop's, are no evidence: whether they go with the force or not, no line
through them has the slope of the web. A shift is found only where the strain has moved by more than that.

Slow oscillation, as of a tension upstream or of neighbouring spans that settle, is no white noise of the blocks: it
counts as many times as the blocks before, or since, are correlated (variance of a mean of correlated samples; since the
change by the von Neumann ratio of the residuals).

Both are searched in block means (`block_means`). No shift is searched while the speed changes (an inertia error looks
like one). When neither line fits it was something else.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Record, compiled, record_type
from hilbench.estimation import ring
from hilbench.estimation.assumptions import LATE
from hilbench.estimation.ring import RING
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
#: Memory, in blocks, of what either line leaves of the blocks that come: where both leave more than is noticed, there
#: was another change, and blocks from before and behind it are on no line.
_RECENT: Final = 8.0
#: Blocks that an explanation needs, after which it counts as undecided, and after which it is closed.
_LEAST, _LONG, _LONGEST = 15, 150, 3000


#: State. Of a change: values before it (E of the line through the blocks before: stated E includes other effects;
#: factor on the noise of a sum, relative to white noise), force and web of the block before, sums over the blocks
#: since, of force f, web h and their changes d from block to block; the result. Then the blocks before: force, web,
#: final speed and stated E of each.
SHIFT: Final = np.dtype(
    [
        *record_type(
            *("open", "modulus_Pa", "stated_Pa", "web_per_Pa", "web_variance_per_Pa2", "variance_N2", "slowness"),
            *("hits", "leans_to_modulus", "has_followed", "last_N", "web_last_per_Pa"),
            *("count", "f", "h", "ff", "fh", "hh", "dff", "dfh", "dhh", "found_N", "found_Pa"),
            *("left_by_modulus_N", "left_by_shift_N"),
        ).descr,
        ("before", RING),
        *[(name, "f8", (_BEFORE,)) for name in ("forces_N", "webs_per_Pa", "speeds_m_s", "moduli_Pa")],
    ]
)


@compiled
def reset(s: Record) -> None:
    """Forget all blocks and an open change."""
    s.open = 0.0
    ring.clear(s.before)


@compiled
def look(
    s: Record,
    block_N: float,
    block_per_Pa: float,
    velocity_m_s: float,
    stated_Pa: float,
    may_decide: bool,
    deviation_N: float,
) -> bool:
    """Take the means of a complete block, and the stated E. True if a shift is certain: then `found_N` is the force at
    the web by which the torque has shifted, `found_Pa` the E stated before.

    Without `may_decide` a certain shift is not yet returned: it may be something else. `deviation_N`: standard
    deviation of a constant error of the balance.
    """
    before, changed_speed = s.before, False
    if before.count > 0:
        first_m_s = s.speeds_m_s[before.first]
        changed_speed = not abs(velocity_m_s - first_m_s) <= SAME_SPEED * abs(first_m_s)
    if block_per_Pa <= 0.0 or changed_speed:
        reset(s)
    elif s.open != 0.0:
        return _explain(s, block_N, block_per_Pa, may_decide, deviation_N)
    elif before.count < _ENOUGH or not _is_noticed(s, block_N, block_per_Pa):
        at = ring.push(before, _BEFORE)
        s.forces_N[at], s.webs_per_Pa[at] = block_N, block_per_Pa
        s.speeds_m_s[at], s.moduli_Pa[at] = velocity_m_s, stated_Pa
    return False


@compiled
def _is_noticed(s: Record, block_N: float, block_per_Pa: float) -> bool:
    """True if the block differs from those before. The block itself is a mixture, and belongs to neither side."""
    forces_N, webs_per_Pa, force_N, web_per_Pa, squares = s.forces_N, s.webs_per_Pa, 0.0, 0.0, 0.0
    count = s.before.count
    for i in range(count):
        at = ring.place(s.before, _BEFORE, i)
        force_N += forces_N[at]
        web_per_Pa += webs_per_Pa[at]
    modulus_Pa = force_N / web_per_Pa
    tension_N = abs(modulus_Pa * block_per_Pa)
    before_N, products = 0.0, 0.0
    spread_per_Pa2 = 0.0
    for i in range(count):
        at = ring.place(s.before, _BEFORE, i)
        residual_N = forces_N[at] - modulus_Pa * webs_per_Pa[at]
        spread_per_Pa2 += (webs_per_Pa[at] - web_per_Pa / count) ** 2
        squares += residual_N * residual_N
        products += residual_N * before_N
        before_N = residual_N
    alike = min(max(products / squares, 0.0), _MOST_ALIKE) if squares > 0.0 else 0.0
    variance_N2 = max(squares / (count - 1), (_NOISE_FLOOR * tension_N) ** 2)
    difference_N = abs(block_N - modulus_Pa * block_per_Pa)
    if difference_N < max(_CHANGED_NOISES * sqrt(variance_N2), _CHANGED * tension_N):
        return False
    s.open, s.modulus_Pa, s.web_per_Pa, s.variance_N2 = 1.0, modulus_Pa, web_per_Pa / count, variance_N2
    s.web_variance_per_Pa2 = spread_per_Pa2 / (count - 1)
    s.slowness = (1.0 + alike) / (1.0 - alike)
    s.stated_Pa = s.moduli_Pa[ring.place(s.before, _BEFORE, count - 1)]
    s.hits, s.leans_to_modulus, s.has_followed = _HIT, 0.0, 0.0
    s.count = s.f = s.h = s.ff = s.fh = s.hh = s.dff = s.dfh = s.dhh = 0.0
    s.left_by_modulus_N = s.left_by_shift_N = 0.0
    return True


@compiled
def _explain(s: Record, f: float, h: float, may_decide: bool, deviation_N: float) -> bool:
    if s.hits > 0.0:
        s.hits -= 1.0
        s.web_last_per_Pa = h
        return False
    if s.count >= 2.0 * _LEAST:
        shift_N = (s.f - s.modulus_Pa * s.h) / s.count
        s.left_by_modulus_N += (f - s.fh / s.hh * h - s.left_by_modulus_N) / _RECENT
        s.left_by_shift_N += (f - s.modulus_Pa * h - shift_N - s.left_by_shift_N) / _RECENT
        left_N = min(abs(s.left_by_modulus_N), abs(s.left_by_shift_N))
        noise_N = sqrt(s.slowness * s.variance_N2 / (2.0 * _RECENT))
        if left_N > max(_CHANGED_NOISES * noise_N, 0.5 * _CHANGED * abs(s.f / s.count)):
            reset(s)
            return False
    df, dh = f - s.last_N, h - s.web_last_per_Pa
    late_N = LATE * s.modulus_Pa * dh
    weight = s.variance_N2 / (s.variance_N2 + late_N * late_N)
    s.last_N, s.web_last_per_Pa = f, h
    if s.count > 0.0:
        s.dff += weight * df * df
        s.dfh += weight * df * dh
        s.dhh += weight * dh * dh
    s.count += weight
    s.f += weight * f
    s.h += weight * h
    s.ff += weight * f * f
    s.fh += weight * f * h
    s.hh += weight * h * h
    count = s.count
    if count < _LEAST or not may_decide:
        return False
    free, slope_Pa, _ = _fit(s, 0.0, 0.0)
    changes_N2 = s.dff - 2.0 * slope_Pa * s.dfh + slope_Pa * slope_Pa * s.dhh
    # The oscillation of a shaft that was hit, and of spans that settle, is on neither line: it counts as noise.
    alike = min(max(1.0 - 0.5 * changes_N2 / free, 0.0), _MOST_ALIKE) if free > 0.0 else 0.0
    slowness = max(s.slowness, (1.0 + alike) / (1.0 - alike))
    variance = max(s.slowness * s.variance_N2, slowness * free / (count - 2.0))
    precision = variance / (deviation_N * deviation_N) if deviation_N != 0.0 else inf
    # E was c/h smaller before.
    of_shift, least_Pa, shift_N = _fit(s, precision * s.web_per_Pa * s.web_per_Pa, 0.0)
    of_modulus, _, _ = _fit(s, 0.0, precision)
    of_shift, of_modulus = (of_shift - free) / variance, (of_modulus - free) / variance
    # The strain has changed by more than at a constant tension: its disturbances (upstream tension, torque of its
    # roller) are in the force as well, and no line through them has the slope of the web.
    moved = s.hh / count - (s.h / count) ** 2 > _MOVED * s.web_variance_per_Pa2
    if of_modulus - of_shift > _DECIDED and of_shift < _ACCEPTED and moved:
        # An earlier error is in the stated E: the shift is the increase since.
        s.found_N, s.found_Pa = shift_N - (s.modulus_Pa - least_Pa) * s.web_per_Pa, s.stated_Pa
        reset(s)
        return True
    better = of_shift - of_modulus
    # The strain has changed as a controlled tension requires with another E; a later set-point does not undo that.
    strain = s.h / count / s.web_per_Pa - 1.0
    force = s.f / count / (s.modulus_Pa * s.web_per_Pa) - 1.0
    if abs(strain) > _FOLLOWED * (abs(force) + abs(strain)):
        s.has_followed = 1.0
    likelier = better + _OFTENER * s.has_followed
    s.leans_to_modulus = 1.0 if likelier > (_LEANS_NO_MORE if s.leans_to_modulus != 0.0 else _LEANS) else 0.0
    enough = _SETTLED if count >= _LONG else _DECIDED
    settled = better > enough or min(of_shift, of_modulus) > _DECIDED
    if settled or count >= _LONGEST:
        reset(s)
    return False


@compiled
def _fit(s: Record, held: float, precision: float) -> tuple[float, float, float]:
    """Squared residuals of f = E'·h + c, E' and c: E' held to E, and c to 0, by these precisions over that of a block
    (0: free; infinite: fixed)."""
    weight = s.count + precision
    s_ff, s_fh = s.ff - s.f * s.f / weight, s.fh - s.f * s.h / weight
    s_hh, least_Pa = max(s.hh - s.h * s.h / weight, 0.0), s.modulus_Pa
    if held < inf:
        least_Pa = (s_fh + held * s.modulus_Pa) / (s_hh + held) if s_hh + held > 0.0 else 0.0
    squares = s_ff - 2.0 * least_Pa * s_fh + least_Pa * least_Pa * s_hh
    if held < inf:
        squares += held * (least_Pa - s.modulus_Pa) ** 2
    return squares, least_Pa, (s.f - least_Pa * s.h) / weight


@compiled
def undecided(s: Record) -> bool:
    """True if a change has been open for long, and may equally be E or a shift."""
    return bool(s.open != 0.0 and s.count >= _LONG and s.leans_to_modulus == 0.0)


def new_state() -> NDArray[np.void]:
    """State of the torque-shift detector on the blocks of axis 2."""
    return np.zeros(1, SHIFT)
