"""Shifts of the independent line: a quarter of an hour in production, what is asked and how the web changes.

    line = shift_line(hidden=[effect("coulomb_friction", 2, force_N=6.0)])
    record = line.record_courses(courses("stops", "steps", duration_s=900.0, seed=1), seed=1)

The tension is kept by the line's own sensor of force: whoever estimates E from the record has no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from tests.independent_line.line import CYCLE_S, Courses, Hidden, Line

Array = NDArray[np.float64]

#: Length of a shift on the scoreboard, s.
SHIFT_S = 900.0
SPEED_M_S, TENSION_N = 3.0, 80.0
#: Start, and how quickly the line changes its speed, m/s².
START_S, ACCELERATION_M_S2 = 1.0, 0.75
#: Speeds and set-points of `stops` one after the other (m/s, N), and how long each of them lasts, s.
SPEEDS_M_S, SPEED_S = (3.0, 4.0, 2.0, 3.5, 2.5), 70.0
TENSIONS_N, TENSION_S = (80.0, 70.0, 90.0, 75.0, 85.0), 55.0
#: A set-point changes within this time, s.
SET_POINT_RAMP_S = 0.5
#: Every so often the line stops, and is at rest for a while, s.
STOP_EVERY_S, REST_S = 240.0, 20.0
#: Steps of E: when (s), and the factor on E from then on: +20.7, −10, +3, −25, +40, −3 %.
STEPS = ((100.0, 1.207), (185.0, 1.0863), (330.0, 1.1189), (430.0, 0.8392), (600.0, 1.1748), (800.0, 1.1396))
#: A drift of 1 % a minute of E: from, to, s; and one of 6 % an hour all the time.
DRIFT_S, DRIFT_PER_S, SLOW_DRIFT_PER_S = (120.0, 600.0), 0.01 / 60.0, 0.06 / 3600.0
#: Friction that warms up: the share it has more when it is cold, and the time constant, s.
COLD_SHARE, WARM_UP_S = 0.5, 300.0
#: Noise of the sensor that the tension is kept by, N in each cycle (it is smoothed over 50 ms).
SENSOR_NOISE_N = 0.5


def shift_line(hidden: Sequence[Hidden] = (), noise: float = 1.0) -> Line:
    """The demonstrator's section with these effects hidden; its tension is kept by a sensor of force.

    Gains: the drives give way to a change of tension by thirty times the strain that it is (E·S/L over the stiffness of
    two velocity loops), so that it follows the speeds with a lag of 31·L/v; with these it is back within 1 N in 4 s.
    """
    return Line(hidden=hidden, noise=noise, controls_force=True, tension_kp=20.0, tension_ki_per_s=10.0)


def _steady(t: Array) -> tuple[Array, Array]:
    return np.full(len(t), SPEED_M_S), np.full(len(t), TENSION_N)


def _stops(t: Array) -> tuple[Array, Array]:
    """Speeds and set-points that change, and a stop every four minutes."""
    speed = np.array(SPEEDS_M_S)[np.floor(t / SPEED_S).astype(int) % len(SPEEDS_M_S)]
    tension = np.array(TENSIONS_N)[np.floor(t / TENSION_S).astype(int) % len(TENSIONS_N)]
    since = t % STOP_EVERY_S
    rests = (t >= STOP_EVERY_S) & (since < REST_S)
    return np.where(rests, 0.0, speed), tension


def _constant(t: Array) -> Array:
    return np.ones(len(t))


def _steps(t: Array) -> Array:
    times = np.array([time_s for time_s, _ in STEPS])
    factors = np.array([1.0, *(factor for _, factor in STEPS)])
    return np.asarray(factors[np.searchsorted(times, t, side="right")])


def _drift(t: Array) -> Array:
    return np.asarray(1.0 + DRIFT_PER_S * (np.clip(t, *DRIFT_S) - DRIFT_S[0]))


def _slow_drift(t: Array) -> Array:
    return np.asarray(1.0 + SLOW_DRIFT_PER_S * t)


#: What is asked: speed (m/s) and set-point (N) as they are wanted, (n,) each; the line goes there by ramps.
PROFILES: Mapping[str, Callable[[Array], tuple[Array, Array]]] = {"steady": _steady, "stops": _stops}
#: How E goes: its factor, (n,).
MODULI: Mapping[str, Callable[[Array], Array]] = {
    "constant": _constant,
    "steps": _steps,
    "drift": _drift,
    "slow_drift": _slow_drift,
}


def courses(profile: str, modulus: str, duration_s: float, *, seed: int = 0, warms_up: bool = False) -> Courses:
    """A shift: a profile of `PROFILES`, a course of E of `MODULI`, and friction that is lost as the line warms up."""
    n = round(duration_s / CYCLE_S) + 1
    t = np.asarray(np.arange(n) * CYCLE_S, np.float64)
    speed, tension = PROFILES[profile](t)
    speed = np.where(t < START_S, 0.0, speed)
    rng = np.random.default_rng([seed, 23])
    return Courses(
        speed_m_s=_limited(speed, ACCELERATION_M_S2 * CYCLE_S),
        tension_N=_smoothed(tension, round(SET_POINT_RAMP_S / CYCLE_S)),
        wander=np.zeros(n),
        sensor_noise_N=SENSOR_NOISE_N * rng.standard_normal(n),
        modulus=MODULI[modulus](t),
        friction=1.0 + COLD_SHARE * np.exp(-t / WARM_UP_S) if warms_up else np.ones(n),
    )


def _limited(wanted: Array, most: float) -> Array:
    """The same with steps of at most `most`: from each change on a ramp."""
    out = wanted.copy()
    for change in np.flatnonzero(np.diff(wanted)) + 1:
        start, to = out[change - 1], wanted[change]
        cycles = int(np.ceil(abs(to - start) / most))
        ramp = out[change : change + cycles]
        ramp[:] = start + np.sign(to - start) * most * np.arange(1, len(ramp) + 1)
        if len(ramp) == cycles:
            ramp[-1] = to
    return out


def _smoothed(wanted: Array, cycles: int) -> Array:
    """Means over the last so many cycles: steps become ramps."""
    padded = np.concatenate([np.full(cycles, wanted[0]), wanted])
    total = np.cumsum(padded)
    return np.asarray((total[cycles:] - total[:-cycles]) / cycles)
