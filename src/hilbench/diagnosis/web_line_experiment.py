"""Signals of a line of driven rollers in an experiment that is proposed, by simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.parameters import ModelParameters

#: Times of the rows (n,), s; times of the corners, s; from there on speed in m/s and set-point in N (None: the usual).
Profile = tuple[Array, Sequence[float], Sequence[float], Sequence[float | None]]


def line_signals(profile: Profile, found: Diagnosis, tension_N: float | None) -> Callable[[list[Machine]], Array]:
    """Prediction by models (B,) of the signals of a line under a profile (B, signals·n), in units of the noise.

    `tension_N`: usual set point; None where none may be set.
    """
    model = found.model
    assert isinstance(model, ModelParameters), "a machine with a web"
    emulation = found.emulation if isinstance(found.emulation, Emulation) else None
    predictor = FreeRun(model, _as_measured(profile, model, tension_N), emulation)
    noise = {gap.signal: gap.noise_floor for gap in found.gaps}
    sigma = np.array([noise.get(name, 0.0) for name in predictor.names])
    sigma = np.where(sigma > 0.0, sigma, predictor.tolerances)
    kept = np.flatnonzero(sigma > 0.0)

    def predicted(models: list[Machine]) -> Array:
        rows = predictor.predict(np.array([machines.of_kind(model).pack(one) for one in models]))
        return np.asarray((rows[:, kept] / sigma[kept, None])[:, :, predictor.rows].reshape(len(models), -1))

    return predicted


def _as_measured(profile: Profile, model: ModelParameters, tension_N: float | None) -> Measured:
    """Commands of a bench for the profile: speeds, and the strain of the tension set-point."""
    t, times, speeds, set_points = profile
    usual = tension_N or model.boundary.upstream_tension_N
    tensions = np.array([usual if to is None else to for to in set_points])
    tension = tensions[np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(tensions) - 1)]
    strains = [np.full_like(t, model.upstream_strain)]
    strains += [tension / model.stiffness_N(span) for span in range(1, model.span_count + 1)]
    strains.append(np.full_like(t, model.downstream_strain))
    of_axes = [np.interp(t, times, speeds)]
    for span in range(model.span_count, 0, -1):
        before, here, behind = strains[span - 1 : span + 2]
        entering = np.where(of_axes[-1] >= 0.0, here - before, behind - here)
        of_axes.append(of_axes[-1] * (1.0 - entering))
    n, axes = len(t), range(1, model.axis_count + 1)
    zero = np.zeros(n)
    return Measured(
        t_s=t,
        period_s=float(t[1]),
        commands_m_s=np.column_stack(of_axes[::-1]),
        boundary=np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (n, 1)),
        tau_Nm=dict.fromkeys(axes, zero),
        x_m=dict.fromkeys(axes, zero),
        v_m_s={},
    )
