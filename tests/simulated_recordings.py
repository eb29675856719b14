"""Recordings with a hidden effect: test data for a diagnosis that is given the unmodified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.offline import simulate, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording

Array = NDArray[np.float64]

PERIOD_S: Final = 0.002
#: Noise of the demonstrator's measurements: torque N·m, position m, velocity m/s.
_TORQUE_NM, _POSITION_M, _SPEED_M_S = 0.05, 3e-7, 1e-4
_STANDS_S: Final = 1.0


@dataclass(frozen=True)
class Experiment:
    """Commands of the axes (n, N), m/s, and the tensions (n, K) that they ask for."""

    t_s: Array
    commands_m_s: Array
    F_ref_N: Array


def experiment(model: ModelParameters, duration_s: float, seed: int, top_m_s: float = 4.0) -> Experiment:
    """A rich one: speed levels and ramps, creep speed, tension steps, small pseudo-random steps of the speed ratio."""
    rng = np.random.default_rng(seed)
    t = np.asarray(np.arange(round(duration_s / PERIOD_S)) * PERIOD_S, np.float64)
    levels = np.array([0.0, 0.75, 0.75, 1.0, 1.0, 0.375, 0.375, 0.75, 0.75, 0.075, 0.075, 0.75, 0.75, 0.2])
    knots = _STANDS_S + (t[-1] - _STANDS_S) * np.linspace(0.0, 1.0, len(levels))
    v_last = top_m_s * np.interp(t, knots, levels)
    part = np.floor(t / 3.3).astype(int)
    speeds, tensions = [v_last], []
    strains = [np.full_like(t, model.upstream_strain)]
    for span in range(1, model.span_count + 1):
        tension = model.boundary.upstream_tension_N * rng.choice([1.0, 1.0, 1.2, 0.85, 1.1, 0.9], part.max() + 1)[part]
        wiggle = 0.03 * rng.choice([-1.0, 1.0], int(t[-1] / 0.7) + 2)[np.floor(t / 0.7).astype(int)]
        wanted = tension / model.boundary.upstream_tension_N - 1.0 + wiggle * (t > 0.6 * t[-1])
        wanted[t < _STANDS_S] = 0.0
        strains.append(model.boundary.upstream_tension_N / model.stiffness_N(span) * (1.0 + wanted))
        tensions.append(tension)
    for before, behind in zip(reversed(strains[:-1]), reversed(strains[1:]), strict=True):
        speeds.append(speeds[-1] * (1.0 - (behind - before)))
    return Experiment(t, np.column_stack(speeds[::-1]), np.column_stack(tensions))


Disturbance = Callable[[ModelParameters, Experiment, float, np.random.Generator], tuple[Array, Array]]


def _speed_ripple(model: ModelParameters, e: Experiment, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Ripple over the displacement that grows with the square of the speed, and is no multiple of a turn."""
    v = e.commands_m_s[:, -1]
    way = np.cumsum(v) * PERIOD_S
    return np.zeros_like(v), size * (v / np.max(np.abs(v))) ** 2 * np.sin(way * rng.uniform(9.0, 17.0))


def _running_in(model: ModelParameters, e: Experiment, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Dry friction that fades as a bearing warms."""
    v = e.commands_m_s[:, -1]
    fading = np.exp(-e.t_s / (rng.uniform(0.15, 0.3) * e.t_s[-1]))
    return np.zeros_like(v), -size * fading * np.sign(v) * (np.abs(v) > 0.01)


def _relaxation(model: ModelParameters, e: Experiment, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Downstream web that relaxes for seconds at a new tension: its memory of the tension, and of the speed."""
    decay = np.exp(-PERIOD_S / rng.uniform(1.5, 4.0))
    wanted = e.F_ref_N[:, -1] / np.std(e.F_ref_N[:, -1])
    changes = np.diff(wanted + e.commands_m_s[:, -1], prepend=wanted[0])
    memory = lfilter([1.0], [1.0, -decay], changes)
    return np.zeros_like(memory), -size * memory


def _hysteresis(model: ModelParameters, e: Experiment, size: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """A force that lags behind the speed like the output of a play."""
    v, width = e.commands_m_s[:, 1], 0.6
    out, state = np.empty_like(v), 0.0
    for k, value in enumerate(v):
        state = min(max(state, value - width), value + width)
        out[k] = value - state
    return np.zeros_like(v), -size * out / width


#: What no effect of the vocabulary explains: additions to upstream strain (1) and downstream tension (N) that are not
#: recorded, by name, with sizes from visible to gross.
UNKNOWNS: Final[Mapping[str, tuple[Disturbance, tuple[float, float, float]]]] = {
    "speed_ripple": (_speed_ripple, (1.0, 3.0, 8.0)),
    "running_in": (_running_in, (1.0, 3.0, 8.0)),
    "relaxation": (_relaxation, (1.0, 3.0, 8.0)),
    "hysteresis": (_hysteresis, (1.0, 3.0, 8.0)),
}


def hidden_recording(
    model: ModelParameters,
    effects: list[EffectEntry],
    *,
    duration_s: float = 66.0,
    seed: int = 0,
    unknown: tuple[str, float] | None = None,
    noise: float = 1.0,
    period_s: float = PERIOD_S,
    top_m_s: float = 4.0,
) -> Recording:
    """Simulate the model with effects on a rich experiment, add measurement noise, keep every `period_s`-th row."""
    run = experiment(model, duration_s, seed, top_m_s)
    rng = np.random.default_rng([seed, 1])
    plant = model.with_effects(*effects)
    parameters = lay.pack(plant)
    n = len(run.t_s)
    recorded = np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (n, 1))
    hidden = recorded.copy()
    if unknown is not None:
        name, size = unknown
        strain, force = UNKNOWNS[name][0](model, run, size, rng)
        hidden += np.column_stack([strain, force])
    found = simulate(parameters, start_state(parameters, plant), run.commands_m_s, hidden, PERIOD_S)
    every = round(period_s / PERIOD_S)
    columns: dict[str, Array] = {"t_s": run.t_s}
    axes = range(model.axis_count)
    for axis in axes:
        columns[f"v{axis + 1}_cmd_m_s"] = run.commands_m_s[:, axis]
    for name, values, sd in (
        ("x{}_m", found.x_m, _POSITION_M),
        ("v{}_m_s", found.v_m_s, _SPEED_M_S),
        ("tau{}_Nm", found.tau_Nm, _TORQUE_NM),
    ):
        for axis in axes:
            columns[name.format(axis + 1)] = values[:, axis] + noise * sd * rng.standard_normal(n)
    columns |= {"strain_prev": recorded[:, 0], "F_next_N": recorded[:, 1]}
    several = model.span_count > 1
    columns |= {f"F{span + 1 if several else ''}_ref_N": run.F_ref_N[:, span] for span in range(model.span_count)}
    return Recording({name: np.ascontiguousarray(values[::every]) for name, values in columns.items()})
