"""Torque ripple of the motor after the span: orders of its angle in the momentum balance; compiled.

The residual of each cycle's balance is correlated with the cosine and sine of the orders of the motor's angle (least
mean squares, Widrow 1975). An order counts as found when its amplitude is far beyond what noise gives it: the noise
near its frequency, as that of an encoder, which is a force by the acceleration, is mostly far above it.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import Final

from hilbench.arrays import Array
from hilbench.compiled import Record, compiled, record_type, viewed
from hilbench.estimation.assumptions import CERTAIN

#: Searched orders: 1 to this.
ORDERS = 12
#: An order: amplitudes of cosine and sine (N), and whether it is found; residual near its frequency, its mean square
#: (N²) with the weight of that mean, and for how long the order has stood out (s).
ORDER: Final = record_type(*("cosine", "sine", "found", "left_cosine", "left_sine", "power", "weight", "stood_out_s"))
#: Kept from cycle to cycle: the previous cycle, whose acceleration is known now, and the residuals' variance.
KEPT: Final = record_type(*("count", "force_N", "expected_N", "speed_m_s", "angle", "rate", "variance_N2", "feedback"))
#: Memory of the correlation, s; frequencies in which it is formed: least (Hz), most (share of a cycle).
_MEMORY_S, _LEAST_HZ, _MOST = 3.0, 2.0, 0.4
#: Deviations of its amplitude from which on an order is found, and below which it is lost.
_FOUND, _LOST = 8.0, CERTAIN
#: Least duration of motion, s: an effect of its start is no ripple.
_LEAST_S = 3.0
#: Time, s, over which the residual is averaged at the frequency of an order: the noise near it may be far less than
#: that of all frequencies.
_NEAR_S = 0.2
#: Time for which an order below the noise of all frequencies has to stand out, s: as long as a transient takes to count
#: as noise.
_LASTS_S = 0.5


@compiled
def _look(table: Array, s: Record, residual: float, cycle_s: float) -> bool:
    """Correlate the residual of the kept angle; True if another order has been found."""
    s.feedback += 1.0
    gain = cycle_s / _MEMORY_S
    deviation = sqrt(s.variance_N2)
    if s.feedback > 50.0:
        residual = min(max(residual, -CERTAIN * deviation), CERTAIN * deviation)
    first_c, first_s = cos(s.angle), sin(s.angle)
    error, c, q = residual, 1.0, 0.0
    for n in range(ORDERS):
        o = viewed(table[n], ORDER)[0]
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        error -= o.cosine * c + o.sine * q
    s.variance_N2 += max(0.002, 1.0 / s.feedback) * (error * error - s.variance_N2)
    changed, c, q = False, 1.0, 0.0
    noise_N2, near = gain * s.variance_N2, cycle_s / _NEAR_S
    for n in range(ORDERS):
        o = viewed(table[n], ORDER)[0]
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        rate = (n + 1) * abs(s.rate)
        if rate < 2.0 * pi * _LEAST_HZ or rate * cycle_s > 2.0 * pi * _MOST:
            continue
        o.cosine += 2.0 * gain * error * c
        o.sine += 2.0 * gain * error * q
        o.left_cosine += near * (error * c - o.left_cosine)
        o.left_sine += near * (error * q - o.left_sine)
        near_N2 = o.left_cosine * o.left_cosine + o.left_sine * o.left_sine
        o.power += gain * (near_N2 - o.power)
        o.weight += gain * (1.0 - o.weight)
        size_N2 = o.cosine * o.cosine + o.sine * o.sine
        many = _LOST if o.found > 0.0 else _FOUND
        many_N2 = many * many * gain / near * o.power / o.weight
        stands_out, beyond_all = size_N2 > many_N2, size_N2 > many * many * noise_N2
        o.stood_out_s = o.stood_out_s + cycle_s if stands_out else 0.0
        lasts = o.stood_out_s > _LASTS_S or (stands_out and o.found > 0.0)
        found = 1.0 if (beyond_all or lasts) and s.feedback * cycle_s > _LEAST_S else 0.0
        changed |= found > o.found
        o.found = found
    return changed


@compiled
def look(
    table: Array, s: Record, force_N: float, expected_N: float, speed_m_s: float, angle: float, mass: float, dt: float
) -> bool:
    """Take a cycle: force of the balance, expected force without inertia, speed, angle of the motor (rad).

    table: an `ORDER` in each row; s: `KEPT`, whose count is 0 after a missing cycle: no acceleration is formed across
    it. True if another order has been found.
    """
    changed = False
    if s.count >= 2.0:
        # The difference of two speeds, each of two positions, is the acceleration one cycle ago.
        residual = s.force_N - s.expected_N - mass * (speed_m_s - s.speed_m_s) / dt
        if abs(s.rate) * ORDERS > 2.0 * pi * _LEAST_HZ:
            changed = _look(table, s, residual, dt)
    s.count += 1.0
    s.rate = (angle - s.angle) / dt
    s.force_N, s.expected_N, s.speed_m_s, s.angle = force_N, expected_N, speed_m_s, angle
    return changed


@compiled
def ripple_N(table: Array, angle: float) -> float:
    """Force of the found orders at this angle of the motor (rad)."""
    total, c, q = 0.0, 1.0, 0.0
    first_c, first_s = cos(angle), sin(angle)
    for n in range(ORDERS):
        o = viewed(table[n], ORDER)[0]
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        if o.found > 0.0:
            total += o.cosine * c + o.sine * q
    return float(total)
