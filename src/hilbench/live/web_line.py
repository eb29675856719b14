"""A line of driven rollers, as it is diagnosed while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.emulated import emulation_of
from hilbench.diagnosis.measured import Measured
from hilbench.live import web_line_segment as line_segment
from hilbench.live.machine import SHORT, LiveMachine
from hilbench.live.web_line_gap import ModelGap, exchanged_m
from hilbench.live.web_line_segment import line, numbered
from hilbench.live.window import Window
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.line import elasticity_factor
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.topology.config import BenchConfig

_SHIFT: Final = "elasticity_shift"
_SHARE: Final = "relative_change"


def machine(config: BenchConfig) -> LiveLine:
    """What a session diagnoses."""
    emulation = emulation_of(config) if config.load_motors else None
    assert emulation is None or isinstance(emulation, Emulation), "of this machine"
    return LiveLine(config.web_line, emulation, config.cycle_time_s, config.shape.estimated)


class LiveLine(LiveMachine):
    """A `LiveMachine` whose twin estimates E. `emulation`: how the web is emulated, None where it is there;
    `spans`: in which E is estimated, None for all of them."""

    moves = 0.05  #: m/s
    emulation: Emulation | None

    def __init__(
        self, model: ModelParameters, emulation: Emulation | None, cycle_s: float, spans: Sequence[int] | None = None
    ) -> None:
        super().__init__(model)
        self.emulation = emulation
        self._line = model
        self._spans = tuple(range(1, model.span_count + 1) if spans is None else spans)
        axes = range(1, model.axis_count + 1)
        self.speeds = tuple(f"v{axis}_m_s" for axis in axes)
        self.needed = (
            *(f"x{axis}_m" for axis in axes),
            *self.speeds,
            *(f"tau{axis}_Nm" for axis in axes),
            *("strain_prev", "F_next_N"),
        )
        self.estimated = tuple(f"E{numbered(model, span)}_sim_Pa" for span in self._spans)
        self.usual_Nm = np.array(
            [machine_sizes(model, k).force_N / model.motor_rad_per_m(k) for k in range(1, model.axis_count + 1)]
        )
        self._cycle_s = cycle_s

    def gap(self, model: Machine) -> ModelGap:
        """Residual generator of one model."""
        return ModelGap(line(model), self._spans, self._cycle_s)

    def estimate_of(self, model: Machine) -> Array:
        """E of each span in which it is estimated (M,) as the model has it, Pa."""
        return np.array([line(model).youngs_modulus_Pa(span) for span in self._spans])

    def with_estimate(self, model: Machine, estimate: Array) -> Machine:
        """The model with another E in these spans (M,); what is around them stays."""
        of_line, shares = line(model), dict[int, float]()
        for entry in of_line.effects:
            if entry.effect == _SHIFT:
                spans = range(1, of_line.span_count + 1) if entry.span is None else (entry.span,)
                shares |= dict.fromkeys(spans, entry.parameters[_SHARE])
        for span, modulus_Pa in zip(self._spans, estimate.tolist(), strict=True):
            shares[span] = modulus_Pa / of_line.youngs_modulus_Pa(span) - 1.0
        kept = [entry for entry in of_line.effects if entry.effect != _SHIFT]
        shifts = [
            EffectEntry(effect=_SHIFT, span=span if of_line.span_count > 1 else None, parameters={_SHARE: share})
            for span, share in shares.items()
        ]
        return machines.with_effects(of_line, [*kept, *shifts])

    def estimate_at(self, model: Machine, time_s: float) -> Array:
        """E in these spans (M,) as the model's effects make it at a time of theirs."""
        p = lay.pack(of_line := line(model))
        return np.array([of_line.youngs_modulus_Pa(k) * elasticity_factor(p, k, time_s) for k in self._spans])

    def is_of_estimate(self, effect_id: str) -> bool:
        """True if an effect is a change of E."""
        return find_effect(effect_id).domain is Domain.ELASTICITY and effect_id not in ("web_damping", "strain_offset")

    def followed_from(self, window: Window, first: int) -> int:
        """Until all of its web is another one."""
        return first - line_segment.rows_of_travel(window, self._line, first, exchanged_m(self._line)) - SHORT

    def quiet_cycle(self, window: Window, first: int, end: int) -> int | None:
        """The first cycle before which, for a while, neither speeds nor tensions change; None where there is none."""
        return line_segment.quiet_cycle(window, self._line, first, end, self._cycle_s)

    def data_of(self, window: Window, model: Machine, first: int, end: int, begun: int) -> Measured:
        """Measured data of these cycles, of what has begun in cycle `begun`: until then the web was strained as by
        the model. Raises UnusableInputError for what can't be diagnosed."""
        return line_segment.data_of(window, line(model), self.emulation, (begun, first, end), self._cycle_s)

    def steady(self, chunk_s: float) -> tuple[float, dict[str, float]]:
        """A speed, m/s, at which all of its web is another one with the second chunk."""
        boundary = {
            "strain_prev": self._line.upstream_strain,
            "F_next_N": self._line.boundary.downstream_tension_N,
        }
        return exchanged_m(self._line) / chunk_s, boundary
