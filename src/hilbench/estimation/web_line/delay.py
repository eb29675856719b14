"""Constant dead time of the measured torque: estimation, and compensation by delaying all other signals."""

from __future__ import annotations

from math import exp, floor
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import Reals, Record, Vector, compiled, inlined, record_type
from hilbench.estimation import ring
from hilbench.estimation.ring import RING

#: Longest delay searched.
LONGEST_S = 0.05
#: Memory of the evidence for a delay.
_MEMORY_S = 30.0
#: Steps of the stated delay, in cycles, and its hysteresis: the balance is evaluated so much earlier, where each change
#: moves a running roller's position by speed times change.
_STEP, _HYSTERESIS = 0.25, 0.4
#: Improvement of the squared error, in standard deviations of the noise, from which on a delay is accepted.
_EVIDENCE = 25.0


_FINDER: Final = record_type("cycle_s", "keep", "noise", "seen", "delay_s")
_LINE: Final = np.dtype([("cycle_s", "f8"), ("cycles", RING)])


class DelayFinder(NamedTuple):
    """Comparison of changes of the measured torque, over a fixed lag, with earlier ones of the simulated torque.

    Of each whole number of cycles the squared differences are averaged; of changes, so that offsets and trends don't
    matter. The minimum, refined by a parabola, is the delay, once it explains the measurement better than no delay
    beyond noise.
    """

    s: Annotated[Any, _FINDER]
    simulated_Nm: Reals  #: newest first, as the next
    measured_Nm: Reals
    errors_Nm2: Reals  #: averaged square of each delay


class DelayLine(NamedTuple):
    """Past balances, to be paired with a late torque: position, the rest of the force, web and speed of each."""

    s: Annotated[Any, _LINE]
    positions_m: Reals
    rests_N: Reals
    webs_per_Pa: Reals
    speeds_m_s: Reals


@compiled
def find(finder: DelayFinder, torque_real_Nm: float, torque_sim_Nm: float) -> float:
    """Take one cycle; returns the estimated delay in s."""
    s, simulated_Nm, real_Nm, errors_Nm2 = finder.s, finder.simulated_Nm, finder.measured_Nm, finder.errors_Nm2
    length, lag = len(simulated_Nm), len(real_Nm) - 1
    for i in range(length - 1, 0, -1):
        simulated_Nm[i] = simulated_Nm[i - 1]
    for i in range(lag, 0, -1):
        real_Nm[i] = real_Nm[i - 1]
    simulated_Nm[0] = torque_sim_Nm
    real_Nm[0] = torque_real_Nm
    s.seen += 1.0
    if s.seen < length:
        return float(s.delay_s)
    change_real = real_Nm[0] - real_Nm[lag]
    for i in range(len(errors_Nm2)):
        apart = change_real - (simulated_Nm[i] - simulated_Nm[lag + i])
        errors_Nm2[i] = s.keep * errors_Nm2[i] + apart * apart
    s.noise = s.keep * s.noise + 1.0
    best_s = _best_s(s, errors_Nm2)
    if abs(best_s - s.delay_s) > _HYSTERESIS * s.cycle_s:
        step_s = _STEP * s.cycle_s
        s.delay_s = step_s * round(best_s / step_s)
    return float(s.delay_s)


@compiled
def _best_s(s: Record, errors_Nm2: Vector) -> float:
    best = 0
    for i in range(len(errors_Nm2)):
        if errors_Nm2[i] < errors_Nm2[best]:
            best = i
    floor_Nm2 = errors_Nm2[best] / max(s.noise, 1.0)
    if errors_Nm2[0] - errors_Nm2[best] <= _EVIDENCE * 2.0 * floor_Nm2 and s.delay_s == 0.0:
        return 0.0
    shift = 0.0
    if 0 < best < len(errors_Nm2) - 1:
        before, at, after = errors_Nm2[best - 1], errors_Nm2[best], errors_Nm2[best + 1]
        bend = before - 2.0 * at + after
        shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float((best + shift) * s.cycle_s)


@compiled
def forget(line: DelayLine) -> None:
    """Forget all past balances."""
    ring.clear(line.s.cycles)


@compiled
def pair(
    line: DelayLine,
    x2_m: float,
    force_N: float,
    web_per_Pa: float,
    velocity_m_s: float,
    torque_force_N: float,
    delay_s: float,
) -> tuple[bool, float, float, float, float]:
    """Balance at the torque's own time: position, force, web, speed; False until enough cycles are stored.

    `torque_force_N`: the part of `force_N` by the (late) torque.
    """
    s, capacity = line.s, len(line.positions_m)
    at = ring.push(s.cycles, capacity)
    line.positions_m[at], line.rests_N[at] = x2_m, force_N - torque_force_N
    line.webs_per_Pa[at], line.speeds_m_s[at] = web_per_Pa, velocity_m_s
    if delay_s == 0.0:
        return True, x2_m, force_N, web_per_Pa, velocity_m_s
    cycles = delay_s / s.cycle_s
    whole = floor(cycles)
    newest = s.cycles.count - 1
    if whole + 1 > newest:
        return False, x2_m, force_N, web_per_Pa, velocity_m_s
    share = cycles - whole
    at = ring.place(s.cycles, capacity, newest - whole)
    before = ring.place(s.cycles, capacity, newest - whole - 1)
    return (
        True,
        _between(line.positions_m, at, before, share),
        _between(line.rests_N, at, before, share) + torque_force_N,
        _between(line.webs_per_Pa, at, before, share),
        _between(line.speeds_m_s, at, before, share),
    )


@inlined
def _between(values: Vector, at: int, before: int, share: float) -> float:
    """Value `at` an index, by `share` that of the cycle before it."""
    newer, older = values[at], values[before]
    return float(newer + (older - newer) * share)


def new_line(cycle_s: float) -> DelayLine:
    """No past balances yet."""
    state = np.zeros(1, _LINE)
    state["cycle_s"] = cycle_s
    return DelayLine(state, *np.zeros((4, round(LONGEST_S / cycle_s) + 3)))


def new_finder(cycle_s: float) -> DelayFinder:
    """Finder that has seen nothing yet."""
    delays = max(2, round(LONGEST_S / cycle_s)) + 1
    lag = max(2, round(0.03 / cycle_s))
    state = np.array([(cycle_s, exp(-cycle_s / _MEMORY_S), 0.0, 0.0, 0.0)], _FINDER)
    return DelayFinder(state, np.zeros(delays + lag + 1), np.zeros(lag + 1), np.zeros(delays))
