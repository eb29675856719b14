"""A shift of friction or of the torque's offset, told from a change of E.

Both change the torque at once, and at one strain alone nothing tells them apart: F = E·h + d, with h = F/E as the
encoders show it. What does is the strain that moves afterwards, which the closed tension loop sees to by itself: it
takes either for another tension. From then on a changed E goes on a line through the origin, F = E'·h, a shift on the
one that was there before, F = E·h + d, and the two are weighed by their squared residuals over the noise. While both
fit, the change stays open: the next change of tension decides. What the balance may have been off by all the time (c)
is in both: F = E'·h + c, and F = (E - c/h)·h + c + d.

A shift is not looked for while the speed changes (an error of the inertia looks like one). When neither line fits it
was something else.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

from hilbench.estimation.web_line.balance import BalanceSample

#: EMCY error codes (CiA 301: FFxxh, device specific): a shift, its N·m as REAL32 in the manufacturer's field; a change
#: that is one or the other.
TORQUE_SHIFT, UNDECIDED = 0xFF17, 0xFF18

#: Length of a block, whose means are what is compared: short against the way of the strain to its new value.
_BLOCK_S = 0.02
#: Blocks that say what was before, and how many are enough.
_BEFORE, _ENOUGH = 60, 24
#: Blocks after that of the change that are left out: a shaft that was hit is on no line, nor is a load motor that
#: imitates a web some cycles late.
_HIT = 1
#: Change of the speed between blocks that are compared, relative.
_SAME_SPEED = 0.02
#: A change that is worth an explanation: over the noise of a block, and relative to the tension.
_CHANGED_NOISES, _CHANGED = 6.0, 0.02
#: Least noise of a block that is believed, relative to the tension: what is left of the model's own errors.
_NOISE_FLOOR = 1e-3
#: Squared residuals over the noise: one explanation is better than the other from here on, and itself good enough.
_DECIDED, _ACCEPTED = 16.0, 9.0
#: The same, of E over a shift, when the change has been open for long: nothing is said any more, it is not told as
#: undecided, it is told so again.
_SETTLED, _LEANS, _LEANS_NO_MORE = 8.0, 5.0, 2.5
#: Blocks that an explanation needs, after which it counts as undecided, and after which nothing is said any more.
_LEAST, _LONG, _LONGEST = 15, 150, 3000


class Block(NamedTuple):
    """Means over a block: tension by the torque in N, and what it is per Pa of E by the strain; at its end the speed
    and the E that is told."""

    force_N: float
    web_per_Pa: float
    velocity_m_s: float
    told_Pa: float


class TorqueShift(NamedTuple):
    """What has shifted: force at the web that the torque shows and the web does not pull; E is what was told before."""

    force_N: float
    youngs_modulus_Pa: float


@dataclass
class _Sums:
    """Of force f and web h over blocks, for lines through them."""

    count: int = 0
    f: float = 0.0
    h: float = 0.0
    ff: float = 0.0
    fh: float = 0.0
    hh: float = 0.0

    def add(self, block: Block) -> None:
        f, h = block.force_N, block.web_per_Pa
        self.count += 1
        self.f += f
        self.h += h
        self.ff += f * f
        self.fh += f * h
        self.hh += h * h

    def of_modulus(self, precision: float) -> float:
        """Squared residuals of f = E'·h + c with c known to be small, `precision`: variance of the noise over that of
        c; infinite: f = E'·h."""
        through_origin = self.ff - self.fh * self.fh / self.hh
        if precision == inf:
            return through_origin
        # Least squares for c beside E', with c² weighed by its precision.
        across = self.f - self.fh * self.h / self.hh
        return through_origin - across * across / (self.count - self.h * self.h / self.hh + precision)

    def of_shift(self, modulus_Pa: float, web_before_per_Pa: float, precision: float) -> tuple[float, float]:
        """d of f = E·h + d, and the squared residuals. E was c/h smaller before: c as in `of_modulus`."""
        s_fh = self.fh - self.f * self.h / self.count
        s_hh = max(self.hh - self.h * self.h / self.count, 0.0)
        s_ff = self.ff - self.f * self.f / self.count
        least = modulus_Pa
        if precision < inf:
            held = precision * web_before_per_Pa * web_before_per_Pa
            least = (s_fh + held * modulus_Pa) / (s_hh + held)
        d = (self.f - least * self.h) / self.count
        squares = s_ff - 2.0 * least * s_fh + least * least * s_hh
        if precision < inf:
            squares += held * (least - modulus_Pa) ** 2
        # What there was before is in E as it is told: the shift is what there is beyond that.
        return d - (modulus_Pa - least) * web_before_per_Pa, squares

    def free(self) -> float:
        """Squared residuals of f = E'·h + d'."""
        s_ff = self.ff - self.f * self.f / self.count
        s_fh = self.fh - self.f * self.h / self.count
        s_hh = self.hh - self.h * self.h / self.count
        return s_ff - s_fh * s_fh / s_hh if s_hh > 0.0 else s_ff


@dataclass
class _Change:
    """What there was before a change, and what there is since. `modulus_Pa` is that of the line through the blocks
    before: beside E whatever else was told then is in it."""

    modulus_Pa: float
    told_Pa: float
    web_per_Pa: float
    variance_N2: float
    hit: int = _HIT
    leans_to_modulus: bool = False
    since: _Sums = field(default_factory=_Sums)


class TorqueShiftFinder:
    """Looks at each cycle's balance of axis 2. `mass_kg`: of roller and motor, at the web."""

    def __init__(self, mass_kg: float, cycle_s: float) -> None:
        self._mass_kg = mass_kg
        self._cycle_s = cycle_s
        self._cycles = max(2, round(_BLOCK_S / cycle_s))
        self.reset()

    def reset(self) -> None:
        """The web is another one, was at rest, or what is measured says something else."""
        self._before: deque[Block] = deque(maxlen=_BEFORE)
        self._change: _Change | None = None
        self.interrupt()

    @property
    def undecided(self) -> bool:
        """Whether a change has been open for long, and may as well be the one as the other."""
        change = self._change
        return change is not None and change.since.count >= _LONG and not change.leans_to_modulus

    def interrupt(self) -> None:
        """A cycle is missing: no mean goes across."""
        self._count = 0
        self._force_sum_N = self._web_sum = 0.0
        self._began_m_s = 0.0

    def update(
        self, now: BalanceSample, told_Pa: float, *, may_decide: bool = True, deviation_N: float = 0.0
    ) -> TorqueShift | None:
        """Take the balance of this cycle and the E that is told; a shift once it is sure.

        Without `may_decide` what is sure is not said yet: it may be something else. `deviation_N`: what the balance may
        have been off by all the time.
        """
        if self._count == 0:
            self._began_m_s = now.velocity_m_s
        self._count += 1
        self._force_sum_N += now.force_N
        self._web_sum += now.web_per_Pa
        if self._count < self._cycles:
            return None
        count = self._count
        accelerating_N = self._mass_kg * (now.velocity_m_s - self._began_m_s) / ((count - 1) * self._cycle_s)
        block = Block(self._force_sum_N / count - accelerating_N, self._web_sum / count, now.velocity_m_s, told_Pa)
        self.interrupt()
        return self._take(block, may_decide, deviation_N)

    def _take(self, block: Block, may_decide: bool, deviation_N: float) -> TorqueShift | None:
        before = self._before
        if block.web_per_Pa <= 0.0 or (before and not _same_speed(block, before[0])):
            self.reset()
        elif self._change is not None:
            return self._explain(self._change, block, may_decide, deviation_N)
        elif len(before) < _ENOUGH:
            before.append(block)
        else:
            self._change = _noticed(before, block)
            if self._change is None:
                before.append(block)
        return None

    def _explain(self, change: _Change, block: Block, may_decide: bool, deviation_N: float) -> TorqueShift | None:
        if change.hit > 0:
            change.hit -= 1
            return None
        change.since.add(block)
        since = change.since
        if since.count < _LEAST or not may_decide:
            return None
        free = since.free()
        # What a shaft that was hit swings through goes on neither line: it counts as noise.
        variance = max(change.variance_N2, free / (since.count - 2))
        precision = variance / deviation_N**2 if deviation_N else inf
        shift_N, of_shift = since.of_shift(change.modulus_Pa, change.web_per_Pa, precision)
        of_shift, of_modulus = (of_shift - free) / variance, (since.of_modulus(precision) - free) / variance
        if of_modulus - of_shift > _DECIDED and of_shift < _ACCEPTED:
            self.reset()
            return TorqueShift(shift_N, change.told_Pa)
        better = of_shift - of_modulus
        change.leans_to_modulus = better > (_LEANS_NO_MORE if change.leans_to_modulus else _LEANS)
        enough = _SETTLED if since.count >= _LONG else _DECIDED
        settled = better > enough or min(of_shift, of_modulus) > _DECIDED
        if settled or since.count >= _LONGEST:
            self.reset()
        return None


def _same_speed(one: Block, other: Block) -> bool:
    return abs(one.velocity_m_s - other.velocity_m_s) <= _SAME_SPEED * abs(other.velocity_m_s)


def _noticed(before: deque[Block], block: Block) -> _Change | None:
    """What there was, when the block is no more of it. The block itself has some of both, and belongs to neither."""
    modulus_Pa = sum(past.force_N for past in before) / sum(past.web_per_Pa for past in before)
    tension_N = abs(modulus_Pa * block.web_per_Pa)
    squares = sum((past.force_N - modulus_Pa * past.web_per_Pa) ** 2 for past in before)
    variance_N2 = max(squares / (len(before) - 1), (_NOISE_FLOOR * tension_N) ** 2)
    difference_N = abs(block.force_N - modulus_Pa * block.web_per_Pa)
    if difference_N < max(_CHANGED_NOISES * variance_N2**0.5, _CHANGED * tension_N):
        return None
    web_per_Pa = sum(past.web_per_Pa for past in before) / len(before)
    return _Change(modulus_Pa, before[-1].told_Pa, web_per_Pa, variance_N2)
