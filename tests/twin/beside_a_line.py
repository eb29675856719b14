"""A twin of a line beside a line that is simulated, without bus or bench: a minute in a few seconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.plant.models import DEMONSTRATOR
from tests.twin.independent_spans import IndependentSpans

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.web_line import SMALLEST, boundary
from hilbench.twin.machines.web_line import WebLineTwin

Array = NDArray[np.float64]
CYCLE_S = 0.003
_TORQUE_NOISE_NM, _POSITION_NOISE_RAD = 0.05, 2e-6


def line_model(*lengths_m: float, **changes: Any) -> ModelParameters:
    """Of driven rollers around spans of these lengths, like the shipped lines."""
    of_spans = {
        "web": {**DEMONSTRATOR["web"], "span_length_m": list(lengths_m)},
        "web_load": [False] + [True] * len(lengths_m),
    }
    return ModelParameters.model_validate({**DEMONSTRATOR, **of_spans, **changes})


class BesideALine:
    """The line and its twin, cycle by cycle; all rollers are told the same speed. What the twin tells is kept. `line`:
    the plant of `model` where it is None."""

    def __init__(
        self,
        model: ModelParameters,
        config: EstimationConfig | None = None,
        seed: int = 1,
        line: IndependentSpans | None = None,
        torque_noise_Nm: float = _TORQUE_NOISE_NM,
    ) -> None:
        around = boundary(model, SMALLEST)
        self.model = model
        self.twin = WebLineTwin(model, config or EstimationConfig(), CYCLE_S, around.__getitem__)
        self.line: Any = line or Line(model, [type(port)() for port in self.twin.ports])
        self.speed_m_s = 0.0
        self.time_s = 0.0
        self._rng, self._noise = np.random.default_rng(seed), (_POSITION_NOISE_RAD, torque_noise_Nm)
        self._rows: list[tuple[float, ...]] = []
        self._before: list[tuple[float, float]] | None = None
        self._joined = False
        for port in (*self.twin.ports, *self.line.ports):
            port.mode = MotorMode.VELOCITY

    def measured(self) -> list[tuple[float, float]]:
        """Position in rad and torque in N·m of each axis."""
        noise = self._rng.normal(size=(len(self.line.ports), 2)) * self._noise
        return [
            (port.position_rad + float(x), port.torque_Nm + float(tau))
            for port, (x, tau) in zip(self.line.ports, noise, strict=True)
        ]

    def go(
        self, until_s: float, speed_m_s: float | None = None, *, with_twin: bool = True,
        each_cycle: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        """Go on until a time, the speed changing evenly to another one."""
        cycles = round((until_s - self.time_s) / CYCLE_S)
        first_m_s = self.speed_m_s
        for cycle in range(1, cycles + 1):
            if speed_m_s is not None:
                self.speed_m_s = first_m_s + (speed_m_s - first_m_s) * cycle / cycles
            each_cycle()
            self._cycle(with_twin=with_twin)

    def _cycle(self, *, with_twin: bool) -> None:
        measured, before = self.measured(), self._before
        self._before = measured
        for axis, port in enumerate((*self.line.ports, *self.twin.ports)):
            port.setpoint = self.speed_m_s * self.model.motor_rad_per_m(axis % len(self.line.ports) + 1)
        if with_twin and before is not None:
            if not self._joined:
                self.twin.release(before, measured)
                self._joined = True
            self.twin.compare(self.time_s, measured)
            self.twin.listen()
            self.twin.plant.step(CYCLE_S)
        spans = range(1, self.model.span_count + 1)
        of_span = "span{}." if len(spans) > 1 else ""
        true = (
            self.line.parameter(f"{of_span.format(k)}youngs_modulus_Pa") * self.line.elasticity_factor(k) for k in spans
        )
        self._rows.append((self.time_s, *true, *self.line.tension_N, *self.twin.published()))
        self.line.step(CYCLE_S)
        self.time_s += CYCLE_S

    def table(self) -> dict[str, Array]:
        """What was true, and what the twin told, by signal: `E2_true_Pa`, `E2_sim_Pa`, `F2_sim_N`, `E2_sd_Pa`."""
        rows, count = np.array(self._rows), self.model.span_count
        found = {"t_s": rows[:, 0]}
        for k in range(1, count + 1):
            found[f"E{k}_true_Pa"], found[f"F{k}_true_N"] = rows[:, k], rows[:, count + k]
            at = 1 + 2 * count + 5 * (k - 1)
            found |= {f"F{k}_sim_N": rows[:, at], f"E{k}_sim_Pa": rows[:, at + 1], f"E{k}_sd_Pa": rows[:, at + 2]}
        return found
