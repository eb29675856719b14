"""Stability of a shaft with a load motor whose torque is computed from its motion over a sampled bus.

Linear model: the axis's velocity PI (sampled), both current loops, and a law of emulation that is evaluated once per
bus cycle on measured motion and acts whole cycles later. Its monodromy over one bus cycle is built exactly (matrix
exponential between samples); stable means that every eigenvalue lies inside the unit circle, except those at 1:
standstill is possible at any angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from hilbench.arrays import Matrix
from hilbench.plant.matrix_exponential import matrix_exponential

#: A current loop is never faster than this in the model (an ideal one would make the matrices singular).
_FASTEST_S = 1e-6
#: Eigenvalues so near to 1 belong to the freedom of angle (and of speed, without a velocity loop).
_STANDSTILL = 1e-6
_X, _V, _TAU, _TAU_LOAD, _COMMAND, _LOAD_COMMAND, _INTEGRAL, _LAW = range(8)


@dataclass(frozen=True, slots=True)
class SampledShaft:
    """Axis with the load motor on its shaft; motor side, SI."""

    inertia_kg_m2: float  #: all that turns
    velocity_kp_Nm_s_per_rad: float = 0.0
    velocity_ki_Nm_per_rad: float = 0.0
    current_loop_time_constant_s: float = 0.001
    load_current_loop_time_constant_s: float = 0.001
    sample_time_s: float = 0.001  #: of the drives
    cycle_s: float = 0.002  #: of the bus
    delay_cycles: int = 1  #: from measuring to the start of the torque's hold; the bench's is 1


@dataclass(frozen=True, slots=True)
class LinearLaw:
    """Linear law of emulation with a memory z (n,); y is the motion (position, velocity) at SYNC:

    torque = from_memory·z + from_motion·y, then z becomes memory·z + motion·y.
    """

    memory: Matrix  #: (n, n)
    motion: Matrix  #: (n, 2)
    from_memory: Matrix  #: (n,) N·m
    from_motion: Matrix  #: (2,) N·m/rad, N·m·s/rad


def emulation_delay_s(shaft: SampledShaft) -> float:
    """Mean time from measured motion to the load motor's torque: cycles, half the hold, and the current loop."""
    return (shaft.delay_cycles + 0.5) * shaft.cycle_s + shaft.load_current_loop_time_constant_s


def spectral_radius_under(shaft: SampledShaft, law: LinearLaw) -> float:
    """Largest magnitude of the loop's eigenvalues over one bus cycle, without those of standstill."""
    eigenvalues = np.linalg.eigvals(_between_syncs(shaft, len(law.memory)) @ _bus_tick(shaft, law))
    rest = eigenvalues[np.abs(eigenvalues - 1.0) > _STANDSTILL]
    return float(np.max(np.abs(rest)))


def largest_stable(radius: Callable[[float], float], most: float) -> float:
    """First border of stability above zero (at most `most`): scan upwards by 5 %, then bisect.

    `radius` is the spectral radius at a size.
    """
    low, high = 0.0, 1e-4 * most
    while radius(high) < 1.0:
        if high >= most:
            return most
        low, high = high, min(1.05 * high, most)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


@cache
def _between_syncs(shaft: SampledShaft, memory: int) -> Matrix:
    """Transition over the drive samples of a bus cycle; cached: it is independent of the law, and most of the work."""
    size = _LAW + memory + shaft.delay_cycles
    drive = _continuous(shaft, size) @ _velocity_loop(shaft, size)
    return np.asarray(np.linalg.matrix_power(drive, round(shaft.cycle_s / shaft.sample_time_s)))


def _continuous(shaft: SampledShaft, size: int) -> Matrix:
    """Transition from one drive sample to the next: motion and current loops."""
    a = np.zeros((size, size))
    a[_X, _V] = 1.0
    a[_V, [_TAU, _TAU_LOAD]] = 1.0 / shaft.inertia_kg_m2
    for torque, command, time_constant in (
        (_TAU, _COMMAND, shaft.current_loop_time_constant_s),
        (_TAU_LOAD, _LOAD_COMMAND, shaft.load_current_loop_time_constant_s),
    ):
        a[torque, torque] = -1.0 / max(time_constant, _FASTEST_S)
        a[torque, command] = 1.0 / max(time_constant, _FASTEST_S)
    return matrix_exponential(a * shaft.sample_time_s)


def _velocity_loop(shaft: SampledShaft, size: int) -> Matrix:
    """PI velocity loop at a drive sample, reference zero (as `drive_loops.velocity_loop` within its limits)."""
    b = np.eye(size)
    b[_INTEGRAL, _V] = -shaft.velocity_ki_Nm_per_rad * shaft.sample_time_s
    b[_COMMAND] = b[_INTEGRAL]
    b[_COMMAND, _V] -= shaft.velocity_kp_Nm_s_per_rad
    return b


def _bus_tick(shaft: SampledShaft, law: LinearLaw) -> Matrix:
    """Transition at SYNC: the oldest torque in the queue takes effect, the new one is computed from the motion."""
    memory = len(law.memory)
    queue = _LAW + memory
    size = queue + shaft.delay_cycles
    unit = np.eye(size)
    torque = np.zeros(size)
    torque[_LAW:queue] = law.from_memory
    torque[[_X, _V]] = law.from_motion
    c = np.eye(size)
    c[_LAW:queue] = 0.0
    c[_LAW:queue, _LAW:queue] = law.memory
    c[_LAW:queue, [_X, _V]] = law.motion
    steps = [_LOAD_COMMAND, *range(queue, size)]
    for place, source in pairwise(steps):
        c[place] = unit[source]
    c[steps[-1]] = torque
    return c
