"""The load-model task: the web that the load motor imitates, from the measured motion of the axes.

Torque emulation: the load motor applies the pull of the web; the inertia of the roller is real (the rig's
flywheel), because imitating an inertia by torque over a sampled bus is stable only below the real one
(`hilbench.plant.web_line.stability`).
"""

from __future__ import annotations

from hilbench.plant.effects import find_effect
from hilbench.plant.web_line.imitation import lead_s
from hilbench.plant.web_line.pairing import Pairing
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.span import SpanFollower
from hilbench.topology.config import LoadConfig
from hilbench.topology.quantities import WEB_BROKEN, YOUNGS_MODULUS, EffectPath, parse_effect_path

#: So many cycles that a sample is late by are made good by prediction; an older one has too little in it.
_MOST_PREDICTED_CYCLES = 3
#: Ways of a cycle that are longer than this are measured well enough to count cycles by them.
_LEAST_WAY_M = 1e-4


def imitated_web(model: ModelParameters, load: LoadConfig) -> ModelParameters:
    """The truth of the run: the model's machine without the model's effects, with what `load:` changes and hides.

    The upstream strain stays the model's: it does not follow a change of E in the span.
    """
    changes = load.web.model_dump(exclude_none=True)
    data = model.model_dump()
    data["web"] |= changes
    data["boundary"]["upstream_strain"] = model.upstream_strain
    data["effects"] = [entry.model_dump() for entry in load.effects]
    return ModelParameters.model_validate(data)


class LoadModel:
    """Web on measured motion → torque set point of the load motor (N·m at its shaft).

    The torque acts later than the motion was measured, so the tension is predicted over that delay: without it the
    loop of web and sampled shaft is unstable on the demonstrator (`hilbench.plant.web_line.stability`). While samples
    are late, or their positions not of one instant, the torque stays; the web then follows over the time that has
    really gone by, and what the new sample is still late by is predicted as well. (To predict over a sample that is not
    there, from the noise of the last one, does more harm than to hold.)
    """

    def __init__(self, model: ModelParameters, load: LoadConfig, cycle_s: float) -> None:
        self.web = SpanFollower(imitated_web(model, load))
        self._cycle_s = cycle_s
        self._lead_s = lead_s(model, cycle_s)
        self._running = False
        self._broken = False
        self._pairing = Pairing()
        self._torque_Nm = 0.0
        self._behind_cycles = 0  # since the instant of the positions that the web is at
        self._x2_m = 0.0
        self._effects = {(entry.effect, entry.axis): dict(entry.parameters) for entry in load.effects}

    def warm_up(self) -> None:
        """Compile (or load from the cache) what each cycle runs, before one has to wait for it."""
        self.update(0.0, 0.0, 0.0)
        self.update(0.0, 0.0, 0.0)
        _ = self.web.effective_modulus_Pa
        self.stop()

    def stop(self) -> None:
        """Drives are off: no pull; the web is as at the start when it runs again."""
        self._running = False

    def update(self, x1_m: float, x2_m: float, v2_m_s: float, *, late: bool = False) -> float:
        """Follow the motion since the last cycle; returns the load motor's torque in N·m.

        `x1_m`, `x2_m` are encoder positions at the web, `v2_m_s` is the measured speed of roller 2; `late`: one of
        them is of an earlier cycle.
        """
        if not self._running:
            self.web.reset((x1_m, x2_m))
            self._pairing.reset()
            self._pairing.update(x1_m, x2_m)
            self._running = True
            self._behind_cycles, self._x2_m = 0, x2_m
        else:
            self._behind_cycles += 1
            if late:
                self._pairing.miss()
            if late or not self._pairing.update(x1_m, x2_m):
                return self._torque_Nm
            self._follow(x1_m, x2_m, v2_m_s)
        lead_s = self._lead_s + min(self._behind_cycles, _MOST_PREDICTED_CYCLES) * self._cycle_s
        predicted_N = [0.0] if self._broken else self.web.predicted_tension_N(lead_s)
        self._torque_Nm = self.web.web_torque_Nm(2, v2_m_s, tension_N=predicted_N)
        return self._torque_Nm

    def _follow(self, x1_m: float, x2_m: float, v2_m_s: float) -> None:
        """After a gap the positions may still be those of an earlier cycle: the way says how many cycles it took."""
        cycles = self._behind_cycles
        way_m, way_of_a_cycle_m = abs(x2_m - self._x2_m), abs(v2_m_s) * self._cycle_s
        if cycles > 1 and way_of_a_cycle_m > _LEAST_WAY_M:
            cycles = min(max(round(way_m / way_of_a_cycle_m), 1), cycles)
        self.web.advance((x1_m, x2_m), cycles * self._cycle_s)
        self._behind_cycles -= cycles
        self._x2_m = x2_m

    @property
    def tension_N(self) -> float:
        """Tension of the imitated web in the span."""
        return 0.0 if self._broken else float(self.web.tension_N[0])

    @property
    def strain(self) -> float:
        """Strain of the imitated web in the span; of one that has torn none."""
        return 0.0 if self._broken else float(self.web.strain[0])

    def value(self, path: str) -> float:
        """Present value of a quantity of the imitated mechanics. Raises ValueError for an unknown path."""
        if path == YOUNGS_MODULUS:
            return self.web.youngs_modulus_Pa
        if path == WEB_BROKEN:
            return float(self._broken)
        return self._effect_value(parse_effect_path(path))

    def set(self, path: str, value: float) -> None:
        """Give a quantity a value from now on. Raises ValueError for an unknown path or an impossible value."""
        if path == YOUNGS_MODULUS:
            self.web.youngs_modulus_Pa = value
        elif path == WEB_BROKEN:
            self._broken = value != 0.0
        else:
            self._set_effect_value(parse_effect_path(path), value)

    def _effect_value(self, path: EffectPath) -> float:
        given = self._effects.get((path.effect, path.axis), {})
        return find_effect(path.effect).filled(given)[path.parameter]

    def _set_effect_value(self, path: EffectPath, value: float) -> None:
        parameters = find_effect(path.effect).filled(self._effects.get((path.effect, path.axis), {}))
        parameters[path.parameter] = value
        self.web.set_effect(path.effect, path.axis, slot=0, **parameters)
        self._effects[path.effect, path.axis] = parameters
