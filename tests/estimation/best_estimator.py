"""How well E could be known in a run: the deviation of the best linear estimator that knows what is hidden.

    deviation = best_deviation(record, line, ModelErrorsConfig(), jumps_s=(100.0,))

A Kalman filter in information form (Kailath, Sayed, Hassibi, *Linear Estimation*, 2000, chapter 9) on the momentum
balance of roller 2. Its regressors are the true motion, tension and torque, free of noise, so that nothing is learned
from noise; the only noise is that of the measured torque. It knows

- which effects are hidden (`effects_of`), though not their sizes: those have the priors of `ModelErrorsConfig`, by the
  same sizes of the machine as the twin's own filters (`PRIORS` below has each with its unit);
- when E jumps and when it drifts, though not how far: a jump has the deviation `jump_pct`, the rate of a drift
  `drift_pct_per_s`, and E wanders by `wander_pct_per_sqrt_s`, of `ChangepointConfig`.

What drifts by itself does so around its prior (Ornstein–Uhlenbeck), with the times below. No estimator that has to find
out which effects there are, or when E jumps, does better. States and regressors, per block of 20 ms (means; e: E over
its nominal value, T the motor's force at the web, q and the built-up angles follow the span: q' = v/L·(… − q)):

    y = e·E·S·ε + offset + dry·sign(v) + viscous·v + scale·T + mass·m·v' + unbalance·(cos φ2, sin φ2)
        + creep·e·E·S·q(F − F_next) + eccentricity·e·E·S·(q(cos φ), q(sin φ)) + delay·T'
        + ripple·(cos nφ_motor, sin nφ_motor) + wave·e·(q(cos ωt), q(sin ωt))

At rest friction is any force: such blocks say nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot, inf, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from tests.estimation.shift_score import MOVES_M_S
from tests.independent_line import Line, Record

from hilbench.estimation.web_line.config import ChangepointConfig, ModelErrorsConfig

Array = NDArray[np.float64]

#: Rows whose means are a measurement, and measurements between two predictions: 20 ms and 0.1 s of rows of 2 ms.
BLOCK_ROWS, CHUNK_BLOCKS = 10, 5
#: Time in which what is hidden wanders through its prior, s: a shift (the twin's own filters have that, too); for
#: eccentricities, whose rollers' angles part slowly, as there.
WANDERS_S, BEATS_S = 36000.0, 2000.0
#: Deviations that `ModelErrorsConfig` has none for: the delay of the torque, two cycles of 2 ms.
DELAY_S = 0.004

#: States by effect of the vocabulary, one for each regressor.
STATES_OF: dict[str, tuple[str, ...]] = {
    "torque_offset": ("offset",),
    "strain_offset": ("offset",),
    "coulomb_friction": ("dry",),
    "viscous_friction": ("viscous",),
    "torque_scale": ("scale",),
    "inertia_mismatch": ("mass",),
    "web_slip": ("creep",),
    "unbalance": ("unbalance_cos", "unbalance_sin"),
    "torque_delay": ("delay",),
    "torque_ripple": ("ripple_cos", "ripple_sin"),
    "upstream_disturbance": ("wave_cos", "wave_sin"),
}
#: Of a roller by its axis.
ECCENTRIC = {1: ("eccentric1_cos", "eccentric1_sin"), 2: ("eccentric2_cos", "eccentric2_sin")}
#: Every state that the twin's own filters have: what must be allowed for where nobody knows what is hidden.
ANY = (
    "offset", "dry", "viscous", "scale", "mass", "creep", "unbalance_cos", "unbalance_sin", *ECCENTRIC[2],
)  # fmt: skip


@dataclass(frozen=True)
class Jumps:
    """What is known of the course of E: when it jumps, and from when to when it drifts, s."""

    times_s: Sequence[float] = ()
    drift_s: tuple[float, float] | None = None


def states_of(line: Line) -> tuple[str, ...]:
    """States of the effects that are hidden in a line. Raises KeyError for an effect that has none."""
    found: list[str] = []
    for item in line.hidden:
        eccentric = item["effect"] == "roller_eccentricity"
        found += ECCENTRIC[item["axis"]] if eccentric else STATES_OF[item["effect"]]
    return tuple(dict.fromkeys(found))


def prior_deviations(line: Line, errors: ModelErrorsConfig) -> dict[str, float]:
    """Standard deviation of each state: forces in N at the web, N·s/m, s, or relative."""
    per_m = line.gear_ratio / line.radius_m
    tension_N = max(line.upstream_N, line.downstream_N)
    strain = tension_N / (line.modulus_Pa * line.width_m * line.thickness_m)
    friction_N = 0.01 * errors.friction_pct * tension_N
    torque_N = 0.01 * errors.torque_offset_pct * line.limit_Nm * per_m
    strain_N = 0.01 * errors.strain_pct * tension_N
    unbalance_N = 0.01 * errors.unbalance_pct * tension_N
    eccentric = 1e-6 * errors.eccentricity_um / line.radius_m / sqrt(2.0)
    return {
        "offset": hypot(torque_N, strain_N),
        "dry": friction_N,
        "viscous": friction_N / errors.at_speed_m_s,
        "scale": 0.01 * errors.torque_scale_pct,
        "mass": 0.01 * errors.inertia_pct,
        "creep": 0.01 * errors.creep_pct * strain / tension_N,
        "unbalance_cos": unbalance_N,
        "unbalance_sin": unbalance_N,
        "delay": DELAY_S,
        "ripple_cos": torque_N,
        "ripple_sin": torque_N,
        "wave_cos": strain_N,
        "wave_sin": strain_N,
        **{name: eccentric for names in ECCENTRIC.values() for name in names},
    }


def best_deviation(
    record: Record,
    line: Line,
    errors: ModelErrorsConfig,
    known: Jumps,
    *,
    states: Iterable[str] | None = None,
    friction_s: float = WANDERS_S,
) -> Array:
    """Deviation of E over its nominal value at each row, (n,); infinite before the first block.

    `states`: what is hidden (None: what the line hides, `states_of`; `ANY` where nobody knows); `friction_s`: the time
    in which friction changes, where it warms up.
    """
    names = tuple(states_of(line) if states is None else states)
    rows = _regressors(record, line, names)
    n_blocks = len(rows) // BLOCK_ROWS // CHUNK_BLOCKS * CHUNK_BLOCKS
    used = n_blocks * BLOCK_ROWS
    moves = np.abs(record.truth["v2_true_m_s"][:used]).reshape(n_blocks, BLOCK_ROWS).min(axis=1) > MOVES_M_S
    blocks = rows[:used].reshape(n_blocks, BLOCK_ROWS, -1).mean(axis=1) * moves[:, None]
    noise_N = line.noise * line.torque_noise_Nm * line.gear_ratio / line.radius_m
    chunks = blocks.reshape(-1, CHUNK_BLOCKS, blocks.shape[1])
    information = np.einsum("kbi,kbj->kij", chunks, chunks) * BLOCK_ROWS / noise_N**2
    deviation = _filtered(information, line, errors, names, known, friction_s)
    out = np.full(len(rows), inf)
    out[:used] = np.repeat(deviation, CHUNK_BLOCKS * BLOCK_ROWS)
    out[used:] = deviation[-1]
    return out


def _filtered(
    information: Array,
    line: Line,
    errors: ModelErrorsConfig,
    names: Sequence[str],
    known: Jumps,
    friction_s: float,
) -> Array:
    """Deviation of E behind each chunk, (chunks,), from what its measurements say, (chunks, N, N)."""
    method = ChangepointConfig()
    chunk_s = BLOCK_ROWS * CHUNK_BLOCKS * line.row_s
    priors, size = prior_deviations(line, errors), 2 + len(names)
    prior = np.zeros((size, size))
    prior[0, 0] = (0.01 * method.initial_deviation_pct) ** 2
    decay, process = np.eye(size), np.zeros((size, size))
    process[0, 0] = (0.01 * method.wander_pct_per_sqrt_s) ** 2 * chunk_s
    for at, name in enumerate(names, 2):
        time_s = _wanders_s(name, friction_s)
        decay[at, at] = np.exp(-chunk_s / time_s)
        prior[at, at] = priors[name] ** 2
        process[at, at] = prior[at, at] * (1.0 - decay[at, at] ** 2)
    at_jumps = {int(time_s / chunk_s) for time_s in known.times_s}
    drift_from, drift_to = (int(time_s / chunk_s) for time_s in known.drift_s or (0.0, 0.0))
    rate = (0.01 * method.drift_pct_per_s) ** 2
    covariance, out = prior, np.empty(len(information))
    for k, said in enumerate(information):
        drifts = drift_from <= k < drift_to
        decay[0, 1] = chunk_s if drifts else 0.0
        decay[1, 1] = float(drifts)
        covariance = decay @ covariance @ decay.T + process
        if drifts and k == drift_from:
            covariance[1, 1] = rate
        if k in at_jumps:
            covariance[0, 0] += (0.01 * method.jump_pct) ** 2
        covariance = _corrected(covariance, said)
        out[k] = sqrt(covariance[0, 0])
    return out


def _corrected(covariance: Array, information: Array) -> Array:
    """Covariance with what measurements say of it: (P⁻¹ + HᵀR⁻¹H)⁻¹, also where P has no inverse."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled, said = covariance / np.outer(size, size), information * np.outer(size, size)
    found = np.linalg.solve(np.eye(len(size)) + scaled @ said, scaled)
    return np.asarray(0.5 * (found + found.T) * np.outer(size, size))


def _wanders_s(name: str, friction_s: float) -> float:
    if name in ("dry", "viscous"):
        return friction_s
    return BEATS_S if name.startswith("eccentric") else WANDERS_S


def _regressors(record: Record, line: Line, names: Sequence[str]) -> Array:
    """By row: of E, of its rate (nothing by itself), and of each state, (n, 2 + N); N per unit of the state."""
    truth = record.truth
    t, v, tension = record.channels["t_s"], truth["v2_true_m_s"], truth["F_true_N"]
    ratio = line.gear_ratio / line.radius_m
    stiffness = line.modulus_Pa * line.width_m * line.thickness_m
    web = truth["E_true_Pa"] / line.modulus_Pa * stiffness
    mass = (line.inertia_kg_m2 + line.gear_ratio**2 * line.motor_inertia_kg_m2) / line.radius_m**2
    share = 1.0 - np.exp(-np.abs(v) * line.row_s / line.length_m)

    def built_up(values: Array) -> Array:
        return _lagged(values, share)

    def column(name: str) -> Array:
        turn = {"cos": np.cos, "sin": np.sin}.get(name[-3:], np.cos)
        match name.rsplit("_", 1)[0]:
            case "offset":
                return np.ones(len(t))
            case "dry":
                return np.sign(v)
            case "viscous":
                return v
            case "scale":
                return ratio * truth["tau2_true_Nm"]
            case "mass":
                return mass * np.gradient(v, line.row_s)
            case "creep":
                return web * built_up(tension - line.downstream_N)
            case "unbalance":
                return np.asarray(turn(truth["x2_true_m"] / line.radius_m))
            case "delay":
                return ratio * np.gradient(truth["tau2_true_Nm"], line.row_s)
            case "ripple":
                return np.asarray(turn(_ripple_order(line) * truth["x2_true_m"] * ratio))
            case "wave":
                return web / stiffness * built_up(turn(2.0 * pi * _wave_Hz(line) * t))
            case "eccentric1":
                return web * built_up(turn(truth["x1_true_m"] / line.radius_m))
            case "eccentric2":
                return web * built_up(turn(truth["x2_true_m"] / line.radius_m))
            case other:
                raise KeyError(other)

    return np.stack([stiffness * truth["strain"], np.zeros(len(t)), *map(column, names)], axis=1)


def _lagged(values: Array, share: Array) -> Array:
    """What has built up in a span of what enters it: the first-order lag of its transport."""
    out, now = np.empty(len(values)), 0.0
    for k, (value, part) in enumerate(zip(values.tolist(), share.tolist(), strict=True)):
        now += part * (value - now)
        out[k] = now
    return out


def _ripple_order(line: Line) -> float:
    return float(next(item["parameters"]["order"] for item in line.hidden if item["effect"] == "torque_ripple"))


def _wave_Hz(line: Line) -> float:
    known = (item["parameters"] for item in line.hidden if item["effect"] == "upstream_disturbance")
    return float(next(known)["frequency_Hz"])
