"""A rotary axis with its drive, from 50 W motors to flywheels of 23 kg·m²: rotor, bristle friction, a gear with play,
a sampled velocity loop on a quantized encoder, and what the drive reports of its torque.

Rotor and load are two inertias on a stiff shaft (with play: a dead zone), integrated with semi-implicit Euler steps.
Friction is Dahl's: bristles of a stiffness that bend up to the Coulomb torque. The speed of the loop comes from
differences of encoder counts, through a first-order filter that keeps the torque of one count at 5 % of the rated one;
the loop is no faster than this filter allows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hilbench.results.recording import Recording

Array = NDArray[np.float64]

_TURN = 2.0 * np.pi
#: Sample of the velocity loop, and integration steps in it.
_LOOP_S, _STEPS = 2.5e-4, 5
#: Rad over which bristles bend up to the Coulomb torque.
_BRISTLE_RAD = 2e-3
#: Torque of one count through the filtered speed, over the rated one.
_COUNT_SHARE = 0.05
#: Least time in which the rated torque reaches the highest speed.
_FASTEST_S = 1.0


@dataclass(frozen=True)
class Size:
    """Ranges that machines of a size are drawn from, and units of the reported torque."""

    inertia_kg_m2: tuple[float, float]
    rated_Nm: tuple[float, float]
    speed_rad_s: tuple[float, float]


SIZES: Mapping[str, Size] = {
    "50 to 400 W": Size((4e-5, 8e-4), (0.16, 1.3), (60.0, 250.0)),
    "0.75 to 2 kW": Size((1e-3, 2e-2), (2.4, 10.0), (40.0, 180.0)),
    "direct drive": Size((0.05, 2.0), (10.0, 120.0), (4.0, 20.0)),
    "flywheel": Size((5.0, 24.0), (100.0, 400.0), (8.0, 40.0)),
}
MOTIONS = ("trapezoids", "sines", "pick and place", "one direction")


@dataclass(frozen=True)
class Axis:
    """An axis, how it is moved, and how it is recorded; `hidden`: effects by their parameters in the vocabulary's
    names. `play_rad`: of a gear between rotor and load; `warming`: share of its Coulomb friction that it loses in a
    time constant of 20 s."""

    inertia_kg_m2: float
    rated_Nm: float
    speed_rad_s: float
    coulomb_Nm: float
    viscous_Nm_s: float
    motion: str = "trapezoids"
    counts_per_turn: int = 1 << 17
    row_s: float = 1e-3
    bandwidth_rad_s: float = 60.0
    lag_s: float = 1e-3
    seconds: float = 30.0
    play_rad: float = 0.0
    warming: float = 0.0
    hidden: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def drawn(cls, size: str, motion: str, rng: np.random.Generator) -> Axis:
        """One of a size, its friction, loops and encoder at random."""
        of = SIZES[size]
        inertia, rated, speed = (float(np.exp(rng.uniform(*np.log(each)))) for each in _ranges(of))
        rated = max(rated, inertia * speed / _FASTEST_S)  # half of it reaches the speed in twice that time
        counts = int(rng.choice([4096, 10_000, 1 << 17, 1 << 20]))
        allowed = float(np.sqrt(0.3 * _COUNT_SHARE * rated * counts / (_TURN * inertia)))
        return cls(
            inertia_kg_m2=inertia,
            rated_Nm=rated,
            speed_rad_s=speed,
            coulomb_Nm=float(rng.uniform(0.01, 0.05)) * rated,
            viscous_Nm_s=float(rng.uniform(0.005, 0.03)) * rated / speed,
            motion=motion,
            counts_per_turn=counts,
            row_s=float(rng.choice([0.001, 0.004])),
            bandwidth_rad_s=min(float(rng.uniform(30.0, 90.0)), allowed),
            lag_s=float(rng.uniform(0.3e-3, 2e-3)),
        )

    @property
    def model(self) -> dict[str, Any]:
        """What is known of it: a model file."""
        shaft = {
            "inertia_kg_m2": self.inertia_kg_m2,
            "coulomb_friction_Nm": self.coulomb_Nm,
            "viscous_friction_Nm_s_per_rad": self.viscous_Nm_s,
        }
        return {"kind": "servo_axis", "shaft": shaft}

    def command(self, seed: int) -> tuple[Array, Array]:
        """Times and speed commands (n,) at the samples of the loop."""
        t_s = np.asarray(_LOOP_S * np.arange(round(self.seconds / _LOOP_S)), np.float64)
        return t_s, _COMMANDS[self.motion](self, t_s, np.random.default_rng([7, seed]))

    def recording(self, seed: int) -> Recording:
        """Positions, torques and commands, with the noise of this seed."""
        rng, (t_s, command) = np.random.default_rng([8, seed]), self.command(seed)
        every = round(self.row_s / _LOOP_S)
        position, torque = _simulated(command, *self._figures())
        offset = self._hidden("torque_offset", "offset_Nm")
        known_Nm = torque / (1.0 + self._hidden("torque_scale", "relative_change")) + offset
        known_Nm = known_Nm + rng.normal(0.0, 0.004 * self.rated_Nm, len(torque))
        unit_Nm = 1e-3 * self.rated_Nm
        rows = slice(None, None, every)
        return Recording(
            {
                "t_s": t_s[rows],
                "x1_rad": position[rows],
                "tau1_Nm": unit_Nm * np.round(known_Nm[rows] / unit_Nm),
                "v1_cmd_rad_s": command[rows],
            }
        )

    def _hidden(self, effect: str, parameter: str) -> float:
        return float(self.hidden.get(effect, {}).get(parameter, 0.0))

    def _figures(self) -> tuple[Array, float]:
        kp = self.bandwidth_rad_s * self.inertia_kg_m2
        inertia = self.inertia_kg_m2 * (1.0 + self._hidden("inertia_mismatch", "relative_change"))
        ripple = self.hidden.get("torque_ripple", {"amplitude_Nm": 0.0, "order": 1.0, "phase_rad": 0.0})
        figures = [
            inertia,
            self.coulomb_Nm + self._hidden("coulomb_friction", "torque_Nm"),
            self.viscous_Nm_s + self._hidden("viscous_friction", "coefficient_Nm_s_per_rad"),
            self._hidden("friction_asymmetry", "viscous_difference_Nm_s_per_rad"),
            *(ripple["amplitude_Nm"], ripple["order"], ripple["phase_rad"]),
            self._hidden("unbalance", "amplitude_Nm"),
            self._hidden("unbalance", "phase_rad"),
            self.play_rad,
            self.warming,
            self.lag_s,
            kp,
            0.25 * self.bandwidth_rad_s * kp,
            2.5 * self.rated_Nm,
            max(_TURN / self.counts_per_turn * kp / (_COUNT_SHARE * self.rated_Nm), _LOOP_S),
        ]
        return np.array(figures), _TURN / self.counts_per_turn


def _ranges(of: Size) -> tuple[tuple[float, float], ...]:
    return of.inertia_kg_m2, of.rated_Nm, of.speed_rad_s


# -- motions: speed commands (n,) of an axis at the times of its loop ------------------------------------------


def _rate(axis: Axis) -> float:
    """Acceleration of half of the rated torque, not faster than to full speed in 0.1 s. rad/s²."""
    return min(0.5 * axis.rated_Nm / axis.inertia_kg_m2, 10.0 * axis.speed_rad_s)


def _to_levels(axis: Axis, t_s: Array, levels: Array, hold_s: float) -> Array:
    """Ramps from one level to the next, each held."""
    command, level, since = np.zeros(len(t_s)), 0.0, 0.0
    k, step = -1, _rate(axis) * _LOOP_S
    for row, _ in enumerate(t_s):
        if k < 0 or since >= hold_s:
            k, since = (k + 1) % len(levels), 0.0
        if level == levels[k]:
            since += _LOOP_S
        level += float(np.clip(levels[k] - level, -step, step))
        command[row] = level
    return command


def _trapezoids(axis: Axis, t_s: Array, rng: np.random.Generator) -> Array:
    shares = np.array([0.3, 0.0, -0.3, 0.6, -0.6, 0.0, 1.0, -1.0, 0.15, -0.15, 0.0])
    return _to_levels(axis, t_s, axis.speed_rad_s * shares, float(rng.uniform(0.3, 0.9)))


def _one_direction(axis: Axis, t_s: Array, rng: np.random.Generator) -> Array:
    shares = np.array([0.2, 0.5, 0.3, 1.0, 0.7, 0.1])
    return _to_levels(axis, t_s, axis.speed_rad_s * shares, float(rng.uniform(0.8, 2.0)))


def _sines(axis: Axis, t_s: Array, rng: np.random.Generator) -> Array:
    """Three sines of up to 2 Hz, together within the speed and twice the rate of the ramps."""
    reached_Hz = _rate(axis) / (_TURN * axis.speed_rad_s)  # at which the acceleration allows full speed
    hertz = np.sort(rng.uniform(0.5, 4.0, 3)) * min(reached_Hz, 0.5)
    parts = np.array([np.sin(_TURN * f * t_s + rng.uniform(0.0, _TURN)) / (1.0 + f) for f in hertz])
    command = np.sum(parts, axis=0) * np.minimum(t_s, 1.0)
    fastest = np.max(np.abs(np.diff(command))) / _LOOP_S
    return np.asarray(command * min(axis.speed_rad_s / np.max(np.abs(command)), 2.0 * _rate(axis) / fastest))


def _pick_and_place(axis: Axis, t_s: Array, rng: np.random.Generator) -> Array:
    """Moves there and back with a smooth acceleration, and a pause at both ends."""
    move_s, pause_s = 0.3 + np.pi * axis.speed_rad_s / (1.6 * _rate(axis)), float(rng.uniform(0.1, 0.4))
    at = np.mod(t_s, 2.0 * (move_s + pause_s))
    back = at >= move_s + pause_s
    share = np.clip(np.where(back, at - move_s - pause_s, at) / move_s, 0.0, 1.0)
    size = np.array([0.4, 1.0, 0.7])[(t_s // (2.0 * (move_s + pause_s))).astype(int) % 3]
    return np.asarray(axis.speed_rad_s * size * np.where(back, -1.0, 1.0) * 0.5 * (1.0 - np.cos(_TURN * share)))


_COMMANDS: Mapping[str, Callable[[Axis, Array, np.random.Generator], Array]] = {
    "trapezoids": _trapezoids,
    "sines": _sines,
    "pick and place": _pick_and_place,
    "one direction": _one_direction,
}


@numba.njit(cache=True)
def _simulated(command: Array, figures: Array, count_rad: float) -> tuple[Array, Array]:
    """Measured positions (n,) and torques of the motor (n,) at the samples of the loop."""
    inertia, coulomb, viscous, difference, amplitude, order, phase, unbalance, at, play, warming = figures[:11]
    lag_s, kp, ki, limit, filter_s = figures[11:]
    step_s = _LOOP_S / _STEPS
    rotor = 0.4 * inertia if play > 0.0 else inertia
    load = inertia - rotor
    stiffness, damping = 4e4 * inertia, 40.0 * inertia
    x = v = z = integral = torque = x_load = v_load = measured = 0.0
    before = 0.0
    positions, torques = np.zeros(len(command)), np.zeros(len(command))
    for k in range(len(command)):
        position = count_rad * np.round(x / count_rad)
        positions[k], torques[k] = position, torque
        measured += _LOOP_S / (filter_s + _LOOP_S) * ((position - before) / _LOOP_S - measured)
        before = position
        error = command[k] - measured
        asked = kp * error + integral
        if abs(asked) < limit:
            integral += ki * error * _LOOP_S
        asked = min(max(asked, -limit), limit)
        dry = coulomb * (1.0 - warming * (1.0 - np.exp(-k * _LOOP_S / 20.0)))
        for _ in range(_STEPS):
            torque += (asked - torque) * step_s / lag_s
            # Dahl: the bristles follow, and yield at the Coulomb torque.
            z += v * step_s * (1.0 - np.sign(v) * z / _BRISTLE_RAD) if abs(z) < _BRISTLE_RAD or v * z < 0.0 else 0.0
            friction = dry * z / _BRISTLE_RAD + viscous * v + difference * abs(v)
            acting = torque + amplitude * np.sin(order * x + phase) + unbalance * np.sin(x + at) - friction
            if play > 0.0:
                twist = x - x_load
                beyond = twist - 0.5 * play if twist > 0.5 * play else min(twist + 0.5 * play, 0.0)
                shaft = stiffness * beyond + (damping * (v - v_load) if beyond != 0.0 else 0.0)
                acting -= shaft
                v_load += step_s * shaft / load
                x_load += step_s * v_load
            v += step_s * acting / rotor
            x += step_s * v
    return positions, torques
