"""Constant dead time of the measured torque: estimation, and compensation by delaying all other signals."""

from __future__ import annotations

from math import exp, floor

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation import ring
from hilbench.estimation.bank import Array

#: Longest delay searched.
LONGEST_S = 0.05
#: Memory of the evidence for a delay.
_MEMORY_S = 30.0
#: Steps of the stated delay, in cycles, and its hysteresis: the balance is evaluated so much earlier, where each change
#: moves a running roller's position by speed times change.
_STEP, _HYSTERESIS = 0.25, 0.4
#: Improvement of the squared error, in standard deviations of the noise, from which on a delay is accepted.
_EVIDENCE = 25.0


# State of a finder; then the simulated torques and the measured ones, newest first, and the averaged square (N·m)² of
# each delay.
_CYCLE_S, _DELAYS, _LAG, _NOISE, _KEEP, _SEEN, DELAY_S = range(7)
_SIZE = 7
# State of a line; then four rings: position (m), the rest of the force (N), web (N/Pa), speed (m/s).
_OF_CYCLE_S, _POSITIONS, _RESTS, _WEBS, _SPEEDS = range(5)
_LINE_SIZE = 5


@compiled
def find(s: Array, torque_real_Nm: float, torque_sim_Nm: float) -> float:
    """Take one cycle; returns the estimated delay in s. s: state of `new_finder`."""
    delays, lag = int(s[_DELAYS]), int(s[_LAG])
    length = delays + lag + 1
    simulated, real, errors = _SIZE, _SIZE + length, _SIZE + length + lag + 1
    for i in range(length - 1, 0, -1):
        s[simulated + i] = s[simulated + i - 1]
    for i in range(lag, 0, -1):
        s[real + i] = s[real + i - 1]
    s[simulated] = torque_sim_Nm
    s[real] = torque_real_Nm
    s[_SEEN] += 1.0
    if s[_SEEN] < length:
        return float(s[DELAY_S])
    change_real = s[real] - s[real + lag]
    for i in range(delays):
        apart = change_real - (s[simulated + i] - s[simulated + lag + i])
        s[errors + i] = s[_KEEP] * s[errors + i] + apart * apart
    s[_NOISE] = s[_KEEP] * s[_NOISE] + 1.0
    best_s = _best_s(s, errors, delays)
    if abs(best_s - s[DELAY_S]) > _HYSTERESIS * s[_CYCLE_S]:
        step_s = _STEP * s[_CYCLE_S]
        s[DELAY_S] = step_s * round(best_s / step_s)
    return float(s[DELAY_S])


@compiled
def _best_s(s: Array, errors: int, delays: int) -> float:
    best = 0
    for i in range(delays):
        if s[errors + i] < s[errors + best]:
            best = i
    floor_Nm2 = s[errors + best] / max(s[_NOISE], 1.0)
    if s[errors] - s[errors + best] <= _EVIDENCE * 2.0 * floor_Nm2 and s[DELAY_S] == 0.0:
        return 0.0
    shift = 0.0
    if 0 < best < delays - 1:
        before, at, after = s[errors + best - 1], s[errors + best], s[errors + best + 1]
        bend = before - 2.0 * at + after
        shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float((best + shift) * s[_CYCLE_S])


@compiled
def forget(s: Array) -> None:
    """Clear the rings. s: state of a line (`new_line`)."""
    ring.clear(s, int(s[_POSITIONS]))
    ring.clear(s, int(s[_RESTS]))
    ring.clear(s, int(s[_WEBS]))
    ring.clear(s, int(s[_SPEEDS]))


@compiled
def pair(
    s: Array, x2_m: float, force_N: float, web_per_Pa: float, velocity_m_s: float, torque_force_N: float, delay_s: float
) -> tuple[bool, float, float, float, float]:
    """Balance at the torque's own time: position, force, web, speed; False until enough cycles are stored. s: state of
    a line (`new_line`).

    `torque_force_N`: the part of `force_N` by the (late) torque.
    """
    positions, rests, webs, speeds = int(s[_POSITIONS]), int(s[_RESTS]), int(s[_WEBS]), int(s[_SPEEDS])
    ring.push(s, positions, x2_m)
    ring.push(s, rests, force_N - torque_force_N)
    ring.push(s, webs, web_per_Pa)
    ring.push(s, speeds, velocity_m_s)
    if delay_s == 0.0:
        return True, x2_m, force_N, web_per_Pa, velocity_m_s
    cycles = delay_s / s[_OF_CYCLE_S]
    whole = floor(cycles)
    newest = ring.count(s, positions) - 1
    if whole + 1 > newest:
        return False, x2_m, force_N, web_per_Pa, velocity_m_s
    share, at = cycles - whole, newest - whole
    rest_N = _between(s, rests, at, share)
    return (
        True,
        _between(s, positions, at, share),
        rest_N + torque_force_N,
        _between(s, webs, at, share),
        _between(s, speeds, at, share),
    )


@inlined
def _between(s: Array, values: int, at: int, share: float) -> float:
    """Interpolated ring value: `at`, by `share` that of the cycle before it."""
    newer, older = ring.value(s, values, at), ring.value(s, values, at - 1)
    return newer + (older - newer) * share


def new_line(cycle_s: float) -> Array:
    """State of past balances, to be paired with a late torque."""
    capacity = round(LONGEST_S / cycle_s) + 3
    s = np.zeros(_LINE_SIZE + 4 * ring.size(capacity))
    s[_OF_CYCLE_S] = cycle_s
    at = _LINE_SIZE
    for place in (_POSITIONS, _RESTS, _WEBS, _SPEEDS):
        s[place] = at
        at = ring.put(s, at, capacity)
    return s


def new_finder(cycle_s: float) -> Array:
    """State of the delay finder: compares changes of the measured torque with earlier ones of the simulated torque.

    For each whole number of cycles the squared differences of the second differences (over a fixed lag, so that offsets
    and trends don't matter) are averaged; the minimum, refined by a parabola, is the delay. It is accepted once it
    explains the measurement better than no delay beyond noise.
    """
    delays = max(2, round(LONGEST_S / cycle_s)) + 1
    lag = max(2, round(0.03 / cycle_s))
    s = np.zeros(_SIZE + (delays + lag + 1) + (lag + 1) + delays)
    s[_CYCLE_S], s[_DELAYS], s[_LAG] = cycle_s, delays, lag
    s[_KEEP] = exp(-cycle_s / _MEMORY_S)
    return s
