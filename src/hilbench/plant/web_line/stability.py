"""How much a load motor can imitate over a sampled bus before the loop through it goes unstable.

Linear model of one shaft: the axis' velocity PI (sampled), both current loops, and a torque that is computed once
per bus cycle from measured motion and acts whole cycles later. Its monodromy over one bus cycle is built exactly
(matrix exponential between samples); stable means that every eigenvalue lies inside the unit circle, except those
at 1: standstill is possible at any angle.

Two laws of imitation:

- inertia by torque, tau = -J_e·(v_k - v_{k-1})/T. Without any control loop the limit is J_e = J whatever the delay
  (the rates of change obey d_{k+1} = -(J_e/J)·d_{k-delay}); the axis' own loop moves it.
- the web as a spring, tau = -k·(x + lead·x'): the delay works as negative damping of about k·(delay - lead).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from hilbench.plant.web_line.parameters import ModelParameters, per_item

#: A current loop is never faster than this in the model (an ideal one would make the matrices singular).
_FASTEST_S = 1e-6
#: Eigenvalues so near to 1 belong to the freedom of angle (and of speed, without a velocity loop).
_STANDSTILL = 1e-6
_X, _V, _TAU, _TAU_LOAD, _COMMAND, _LOAD_COMMAND, _INTEGRAL, _V_BEFORE, _X_BEFORE, _QUEUE = range(10)


@dataclass(frozen=True, slots=True)
class SampledShaft:
    """One axis with the load motor on its shaft; motor side, SI."""

    inertia_kg_m2: float  #: all that turns
    velocity_kp_Nm_s_per_rad: float = 0.0
    velocity_ki_Nm_per_rad: float = 0.0
    current_loop_time_constant_s: float = 0.001
    load_current_loop_time_constant_s: float = 0.001
    sample_time_s: float = 0.001  #: of the drives
    cycle_s: float = 0.002  #: of the bus
    delay_cycles: int = 1  #: from measuring to the start of the torque's hold; the bench's is 1

    @classmethod
    def of_model(cls, model: ModelParameters, axis: int = 2, **changes: float) -> SampledShaft:
        """The shaft of a model's axis. Raises ValueError for a model without drives."""
        if model.drives is None:
            raise ValueError("the model has no drives, expected 'drives'")
        values: dict[str, float] = {
            "inertia_kg_m2": model.mass_kg(axis) / model.motor_rad_per_m(axis) ** 2,
            "velocity_kp_Nm_s_per_rad": per_item(model.drives.velocity_kp_Nm_s_per_rad, axis),
            "velocity_ki_Nm_per_rad": per_item(model.drives.velocity_ki_Nm_per_rad, axis),
            "current_loop_time_constant_s": per_item(model.drives.current_loop_time_constant_s, axis),
            "sample_time_s": model.drives.sample_time_s,
        }
        return cls(**{**values, **changes})  # type: ignore[arg-type]


def spectral_radius(
    shaft: SampledShaft, *, inertia_kg_m2: float = 0.0, stiffness_Nm_per_rad: float = 0.0, lead_s: float = 0.0
) -> float:
    """Greatest magnitude of the loop's eigenvalues over one bus cycle while inertia or a spring is imitated."""
    eigenvalues = np.linalg.eigvals(_monodromy(shaft, inertia_kg_m2, stiffness_Nm_per_rad, lead_s))
    rest = eigenvalues[np.abs(eigenvalues - 1.0) > _STANDSTILL]
    return float(np.max(np.abs(rest)))


def largest_inertia_ratio(shaft: SampledShaft, most: float = 100.0) -> float:
    """Largest emulated over real inertia that is stable (at most `most`)."""
    return _largest(lambda ratio: spectral_radius(shaft, inertia_kg_m2=ratio * shaft.inertia_kg_m2), most)


def largest_stiffness_Nm_per_rad(shaft: SampledShaft, lead_s: float = 0.0, most: float = 1e6) -> float:
    """Largest spring at the shaft that is stable (at most `most`); a web's is E·S/L·(r/i)²."""
    return _largest(lambda k: spectral_radius(shaft, stiffness_Nm_per_rad=k, lead_s=lead_s), most)


def web_stiffness_Nm_per_rad(model: ModelParameters, axis: int = 2, modulus_Pa_per_m: float | None = None) -> float:
    """The span before `axis` as a spring at its motor: E·S/L·(r/i)²; `modulus_Pa_per_m`: E/L, unless the model's."""
    web = model.required_web
    if modulus_Pa_per_m is None:
        modulus_Pa_per_m = web.youngs_modulus_Pa / model.span_length_m(axis - 1)
    return modulus_Pa_per_m * web.section_m2 / model.motor_rad_per_m(axis) ** 2


def imitation_delay_s(shaft: SampledShaft) -> float:
    """Mean time from measured motion to the load motor's torque: cycles, half the hold, and the current loop."""
    return (shaft.delay_cycles + 0.5) * shaft.cycle_s + shaft.load_current_loop_time_constant_s


def _largest(radius: Callable[[float], float], most: float) -> float:
    """First border of stability above zero: scan upwards by 5 %, then bisect."""
    low, high = 0.0, 1e-4 * most
    while radius(high) < 1.0:
        if high >= most:
            return most
        low, high = high, min(1.05 * high, most)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


def _monodromy(shaft: SampledShaft, inertia: float, stiffness: float, lead_s: float) -> NDArray[np.float64]:
    return np.asarray(_between_syncs(shaft) @ _bus_tick(shaft, _size(shaft), inertia, stiffness, lead_s))


def _size(shaft: SampledShaft) -> int:
    return _QUEUE + shaft.delay_cycles


@cache
def _between_syncs(shaft: SampledShaft) -> NDArray[np.float64]:
    """The drive's samples of a bus cycle; the same whatever is imitated, and most of the work."""
    size = _size(shaft)
    drive = _continuous(shaft, size) @ _velocity_loop(shaft, size)
    return np.asarray(np.linalg.matrix_power(drive, round(shaft.cycle_s / shaft.sample_time_s)))


def _continuous(shaft: SampledShaft, size: int) -> NDArray[np.float64]:
    """From one drive sample to the next: motion and current loops."""
    a = np.zeros((size, size))
    a[_X, _V] = 1.0
    a[_V, [_TAU, _TAU_LOAD]] = 1.0 / shaft.inertia_kg_m2
    for torque, command, time_constant in (
        (_TAU, _COMMAND, shaft.current_loop_time_constant_s),
        (_TAU_LOAD, _LOAD_COMMAND, shaft.load_current_loop_time_constant_s),
    ):
        a[torque, torque] = -1.0 / max(time_constant, _FASTEST_S)
        a[torque, command] = 1.0 / max(time_constant, _FASTEST_S)
    return np.asarray(expm(a * shaft.sample_time_s))


def _velocity_loop(shaft: SampledShaft, size: int) -> NDArray[np.float64]:
    """The PI at a drive sample, reference zero (as `drives.motor.velocity_loop` within its limits)."""
    b = np.eye(size)
    b[_INTEGRAL, _V] = -shaft.velocity_ki_Nm_per_rad * shaft.sample_time_s
    b[_COMMAND] = b[_INTEGRAL]
    b[_COMMAND, _V] -= shaft.velocity_kp_Nm_s_per_rad
    return b


def _bus_tick(shaft: SampledShaft, size: int, inertia: float, stiffness: float, lead_s: float) -> NDArray[np.float64]:
    """At SYNC: the oldest torque in the queue takes effect, the new one is computed from the motion."""
    rate = 1.0 / shaft.cycle_s
    law = np.zeros(size)
    law[[_V, _V_BEFORE]] = -inertia * rate, inertia * rate
    law[_X] = -stiffness * (1.0 + lead_s * rate)
    law[_X_BEFORE] = stiffness * lead_s * rate
    c = np.eye(size)
    c[_V_BEFORE] = np.eye(size)[_V]
    c[_X_BEFORE] = np.eye(size)[_X]
    steps = [_LOAD_COMMAND, *range(_QUEUE, size)]
    for place, source in pairwise(steps):
        c[place] = np.eye(size)[source]
    c[steps[-1]] = law
    return c
