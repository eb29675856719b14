"""Torque ripple of the motor after the span: orders of its angle in the momentum balance; compiled.

The residual of each cycle's balance is correlated with the cosine and sine of the orders of the motor's angle (least
mean squares, Widrow 1975). An order counts as found when its amplitude is far beyond what noise gives it: the noise
near its frequency, as that of an encoder, which is a force by the acceleration, is mostly far above it.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np

from hilbench.compiled import compiled
from hilbench.estimation.assumptions import CERTAIN
from hilbench.estimation.bank import Array

#: Searched orders: 1 to this.
ORDERS = 12
# Columns of the table of orders: amplitudes of cosine and sine (N), and whether it is found.
COSINE, SINE, FOUND = range(3)
# Residual near its frequency, its mean square (N²) with the weight of that mean, and for how long the order has stood
# out (s).
LEFT_COSINE, LEFT_SINE, POWER, WEIGHT, STOOD_OUT_S = range(3, 8)
COLUMNS = 8
# Kept from cycle to cycle: the previous cycle, whose acceleration is known now, and the residuals' variance.
COUNT, FORCE_N, EXPECTED_N, SPEED_M_S, ANGLE, RATE, VARIANCE_N2, FEEDBACK = range(8)
KEPT = 8
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


def new_table() -> tuple[Array, Array]:
    """Table of orders (ORDERS, COLUMNS) and state kept between cycles (KEPT,)."""
    return np.zeros((ORDERS, COLUMNS)), np.zeros(KEPT)


@compiled
def _look(table: Array, s: Array, residual: float, cycle_s: float) -> bool:
    """Correlate the residual of the kept angle; True if another order has been found."""
    s[FEEDBACK] += 1.0
    gain = cycle_s / _MEMORY_S
    deviation = sqrt(s[VARIANCE_N2])
    if s[FEEDBACK] > 50.0:
        residual = min(max(residual, -CERTAIN * deviation), CERTAIN * deviation)
    first_c, first_s = cos(s[ANGLE]), sin(s[ANGLE])
    error, c, q = residual, 1.0, 0.0
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        error -= table[n, COSINE] * c + table[n, SINE] * q
    s[VARIANCE_N2] += max(0.002, 1.0 / s[FEEDBACK]) * (error * error - s[VARIANCE_N2])
    changed, c, q = False, 1.0, 0.0
    noise_N2, near = gain * s[VARIANCE_N2], cycle_s / _NEAR_S
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        rate = (n + 1) * abs(s[RATE])
        if rate < 2.0 * pi * _LEAST_HZ or rate * cycle_s > 2.0 * pi * _MOST:
            continue
        table[n, COSINE] += 2.0 * gain * error * c
        table[n, SINE] += 2.0 * gain * error * q
        table[n, LEFT_COSINE] += near * (error * c - table[n, LEFT_COSINE])
        table[n, LEFT_SINE] += near * (error * q - table[n, LEFT_SINE])
        near_N2 = table[n, LEFT_COSINE] ** 2 + table[n, LEFT_SINE] ** 2
        table[n, POWER] += gain * (near_N2 - table[n, POWER])
        table[n, WEIGHT] += gain * (1.0 - table[n, WEIGHT])
        size_N2 = table[n, COSINE] ** 2 + table[n, SINE] ** 2
        many = _LOST if table[n, FOUND] > 0.0 else _FOUND
        many_N2 = many * many * gain / near * table[n, POWER] / table[n, WEIGHT]
        stands_out, beyond_all = size_N2 > many_N2, size_N2 > many * many * noise_N2
        table[n, STOOD_OUT_S] = table[n, STOOD_OUT_S] + cycle_s if stands_out else 0.0
        lasts = table[n, STOOD_OUT_S] > _LASTS_S or (stands_out and table[n, FOUND] > 0.0)
        found = 1.0 if (beyond_all or lasts) and s[FEEDBACK] * cycle_s > _LEAST_S else 0.0
        changed |= found > table[n, FOUND]
        table[n, FOUND] = found
    return changed


@compiled
def interrupt(s: Array) -> None:
    """Form no acceleration across a missing cycle."""
    s[COUNT] = 0.0


@compiled
def look(
    table: Array, s: Array, force_N: float, expected_N: float, speed_m_s: float, angle: float, mass: float, dt: float
) -> bool:
    """Take a cycle: force of the balance, expected force without inertia, speed, angle of the motor (rad).

    table and s as of `new_table`. True if another order has been found.
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
    """Force of the found orders at this angle of the motor (rad)."""
    total, c, q = 0.0, 1.0, 0.0
    first_c, first_s = cos(angle), sin(angle)
    for n in range(ORDERS):
        c, q = c * first_c - q * first_s, q * first_c + c * first_s
        if table[n, FOUND] > 0.0:
            total += table[n, COSINE] * c + table[n, SINE] * q
    return float(total)
