"""A torque ripple of the motor behind the span: an order of its angle in the balance; compiled.

What the momentum balance of each cycle has beyond the tension and what else has been found is correlated with the
cosine and sine of the orders of the motor's angle (least mean squares, Widrow 1975). An order counts as found when its
amplitude is far beyond what noise gives it.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np

from hilbench.compiled import compiled
from hilbench.estimation.bank import Array

#: Orders that are looked for: 1 to this.
ORDERS = 12
# Columns of the table of orders: amplitudes of cosine and sine (N), and whether it is found.
COSINE, SINE, FOUND = range(3)
# What is kept from cycle to cycle: the cycle before, whose acceleration is known now, and the residuals' variance.
COUNT, FORCE_N, EXPECTED_N, SPEED_M_S, ANGLE, RATE, VARIANCE_N2, SEEN = range(8)
KEPT = 8
#: How far back the correlation reaches, s; frequencies in which it is formed: least (Hz), most (share of a cycle).
_MEMORY_S, _LEAST_HZ, _MOST = 3.0, 2.0, 0.4
#: An order is found from so many deviations of its amplitude on, and until it is below so many.
_FOUND, _LOST = 8.0, 4.0
#: Not before so long a motion, s: what begins with it is no ripple.
_LEAST_S = 3.0
#: Residuals count only so many deviations.
_LIMIT = 4.0


def new_table() -> tuple[Array, Array]:
    """Orders (ORDERS, 3) and what is kept (KEPT,)."""
    return np.zeros((ORDERS, 3)), np.zeros(KEPT)


@compiled
def _look(table: Array, s: Array, residual: float, cycle_s: float) -> bool:
    """Correlate one residual, of the angle that is kept; True when another order has been found."""
    s[SEEN] += 1.0
    gain = cycle_s / _MEMORY_S
    deviation = sqrt(s[VARIANCE_N2])
    if s[SEEN] > 50.0:
        residual = min(max(residual, -_LIMIT * deviation), _LIMIT * deviation)
    first_c, first_s = cos(s[ANGLE]), sin(s[ANGLE])
    error, c, q = residual, 1.0, 0.0
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        error -= table[n, COSINE] * c + table[n, SINE] * q
    s[VARIANCE_N2] += max(0.002, 1.0 / s[SEEN]) * (error * error - s[VARIANCE_N2])
    changed, c, q = False, 1.0, 0.0
    noise_N2 = gain * s[VARIANCE_N2]
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        rate = (n + 1) * abs(s[RATE])
        if rate < 2.0 * pi * _LEAST_HZ or rate * cycle_s > 2.0 * pi * _MOST:
            continue
        table[n, COSINE] += 2.0 * gain * error * c
        table[n, SINE] += 2.0 * gain * error * q
        size_N2 = table[n, COSINE] ** 2 + table[n, SINE] ** 2
        many = _LOST if table[n, FOUND] > 0.0 else _FOUND
        found = 1.0 if s[SEEN] * cycle_s > _LEAST_S and size_N2 > many * many * noise_N2 else 0.0
        changed |= found > table[n, FOUND]
        table[n, FOUND] = found
    return changed


@compiled
def interrupt(s: Array) -> None:
    """A cycle is missing: no acceleration is formed across it."""
    s[COUNT] = 0.0


@compiled
def look(
    table: Array, s: Array, force_N: float, expected_N: float, speed_m_s: float, angle: float, mass: float, dt: float
) -> bool:
    """Take a cycle: force of the balance, what is expected of it without inertia, speed, angle of the motor (rad).

    table and s as of `new_table`. True when another order has been found.
    """
    changed = False
    if s[COUNT] >= 2.0:
        # The difference of two speeds, each of two positions, is the acceleration one cycle ago.
        residual = s[FORCE_N] - s[EXPECTED_N] - mass * (speed_m_s - s[SPEED_M_S]) / dt
        if abs(s[RATE]) * ORDERS > 2.0 * pi * _LEAST_HZ:
            changed = _look(table, s, residual, dt)
    s[COUNT] += 1.0
    s[RATE] = (angle - s[ANGLE]) / dt
    s[FORCE_N], s[EXPECTED_N], s[SPEED_M_S], s[ANGLE] = force_N, expected_N, speed_m_s, angle
    return changed


@compiled
def ripple_N(table: Array, angle: float) -> float:
    """Force of the orders that are found at this angle of the motor (rad)."""
    total, c, q = 0.0, 1.0, 0.0
    first_c, first_s = cos(angle), sin(angle)
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        if table[n, FOUND] > 0.0:
            total += table[n, COSINE] * c + table[n, SINE] * q
    return float(total)
