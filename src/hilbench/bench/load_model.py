"""The load-model task: the web that the load motor imitates, from the measured motion of the axes.

Torque emulation: the load motor applies the pull of the web; the inertia of the roller is real (the stand's
flywheel), because imitating an inertia by torque over a sampled bus is stable only below the real one
(`hilbench.web.stability`).
"""

from __future__ import annotations

from hilbench.bench.config import LoadConfig
from hilbench.web.parameters import ModelParameters
from hilbench.web.span import SpanFollower


def imitated_web(model: ModelParameters, load: LoadConfig) -> ModelParameters:
    """The truth of the run: the model's machine without the model's effects, with what `load:` changes and hides."""
    if model.web is None:
        raise ValueError("the model has no web")
    changes = load.web.model_dump(exclude_none=True)
    return model.model_copy(update={"web": model.web.model_copy(update=changes), "effects": list(load.effects)})


class LoadModel:
    """Web on measured motion → torque set point of the load motor (N·m at its shaft)."""

    def __init__(self, model: ModelParameters, load: LoadConfig, cycle_s: float) -> None:
        self.web = SpanFollower(imitated_web(model, load), strain_prev=model.upstream_strain)
        self._cycle_s = cycle_s
        self._running = False

    def stop(self) -> None:
        """Drives are off: no pull; the web is as at the start when it runs again."""
        self._running = False

    def update(self, x1_m: float, x2_m: float, v2_m_s: float) -> float:
        """Follow the motion since the last cycle; returns the load motor's torque in N·m.

        `x1_m`, `x2_m` are encoder positions at the web, `v2_m_s` is the measured speed of roller 2.
        """
        if not self._running:
            self.web.reset((x1_m, x2_m))
            self._running = True
        else:
            self.web.advance((x1_m, x2_m), self._cycle_s)
        return self.web.load_torque_Nm(v2_m_s)
