"""A twin of a line with dancers, accumulators or reels beside such a line, without bus or bench.

The line is the plant, with other values than the twin believes, or anything else with ports and outputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from tests.plant.models import DEMONSTRATOR

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.web_line import web_line_shape
from hilbench.topology.web_line_config import ControllerConfig, TensionControlConfig
from hilbench.twin.machines.kinds import boundary
from hilbench.twin.machines.web_line_with_stations import LineWithStationsTwin

Array = NDArray[np.float64]
CYCLE_S = 0.003
_TORQUE_NOISE_NM, _POSITION_NOISE_RAD = 0.02, 2e-6
CELL_OFF = 3e-3  #: constant error of a load cell, as a share
_CELL_NOISE_N = 0.3

#: The demonstrator's rollers, motors and drives, with longer spans between them.
PAPER: dict[str, Any] = DEMONSTRATOR | {
    "web_load": [False, True, True],
    "boundary": {"upstream_strain": 2.829e-4, "downstream_tension_N": 70.0},
    "web": DEMONSTRATOR["web"] | {"span_length_m": [1.5, 2.5, 2.0, 3.0]},
}


def dancer_line(youngs_modulus_Pa: float = 8.7e9, *, next_N: float = 70.0, **dancer: Any) -> ModelParameters:
    """Of three driven rollers, a dancer before the second, a guide roller before the third; `next_N`: behind."""
    of_dancer = {
        "type": "dancer",
        "name": "dancer",
        "radius_m": 0.05,
        "inertia_kg_m2": 0.0025,
        "mass_kg": 10.0,
        "force_N": 160.0,
        "viscous_friction_N_s_per_m": 400.0,
        "lower_stop_m": -0.2,
        "upper_stop_m": 0.2,
    }
    guide = {"type": "idler", "name": "guide", "radius_m": 0.06, "inertia_kg_m2": 0.004}
    driven = {"type": "roller"}
    return ModelParameters.model_validate(
        PAPER
        | {
            "boundary": PAPER["boundary"] | {"downstream_tension_N": next_N},
            "web": PAPER["web"] | {"youngs_modulus_Pa": youngs_modulus_Pa},
            "stations": [driven, of_dancer | dancer, driven, guide, driven],
        }
    )


def guided_line(youngs_modulus_Pa: float = 8.7e9, **changes: Any) -> ModelParameters:
    """Of three driven rollers, with guide rollers in between."""
    guide = {"type": "idler", "radius_m": 0.06, "inertia_kg_m2": 0.004}
    driven = {"type": "roller"}
    return ModelParameters.model_validate(
        PAPER
        | {
            "web": PAPER["web"] | {"youngs_modulus_Pa": youngs_modulus_Pa},
            "stations": [driven, guide | {"name": "first"}, driven, guide | {"name": "second"}, driven],
        }
        | changes
    )


def winding_line(radii_m: tuple[float, float] = (0.25, 0.12), **web: Any) -> ModelParameters:
    """An unwinder, a press and a rewinder, of whose reels these are the radii at the start."""
    reel = {"core_radius_m": 0.05, "density_kg_m3": 300.0}
    return ModelParameters.model_validate(
        PAPER
        | {
            "web_load": True,
            "web": {"youngs_modulus_Pa": 2e8, "width_m": 0.5, "thickness_m": 1e-3, "span_length_m": [2.0, 3.0]} | web,
            "stations": [{"type": "unwinder"} | reel, {"type": "roller"}, {"type": "rewinder"} | reel],
            "rollers": {
                "radius_m": [radii_m[0], 0.15, radii_m[1]],
                "inertia_kg_m2": [0.6, 0.7, 0.6],
                "gear_ratio": 5.0,
            },
            "boundary": {"upstream_strain": 8e-4},
        }
    )


class Simulated(Protocol):
    """What stands in for the line: motors by ports, what is true by name as `Line` has it."""

    ports: Any

    def step(self, duration_s: float) -> None: ...

    def outputs(self) -> dict[str, float]: ...


class BesideStations:
    """The line and its twin, cycle by cycle. Axes are told speeds at the web (m/s), of reels by their true radius."""

    def __init__(
        self,
        line: Line,
        true: ModelParameters,
        believed: ModelParameters,
        measured: tuple[str, ...] = (),
        seed: int = 1,
        config: EstimationConfig | None = None,
    ) -> None:
        config = config or EstimationConfig()
        controls: list[ControllerConfig] = [TensionControlConfig(span=believed.span_count)]
        self.shape = web_line_shape(believed, (), config, controls, measured)
        self._said = dict(boundary(believed, self.shape))
        self.twin = LineWithStationsTwin(believed, config, self.shape, CYCLE_S, self._said.__getitem__)
        self.line, self._true = line, true
        self.time_s, self.cycles = 0.0, 0
        self._rng = np.random.default_rng(seed)
        self._rows: list[dict[str, float]] = []
        self._before: list[tuple[float, float]] | None = None
        self._joined = False
        self._reels = {1: "r_unwinder_m", true.axis_count: "r_rewinder_m"} if self.shape.reels else {}
        for port in (*self.twin.ports, *line.ports):
            port.mode = MotorMode.VELOCITY

    def go(self, until_s: float, *speeds_m_s: float, ramp_s: float = 0.0, with_twin: bool = True) -> None:
        """Go on until a time; each axis comes to its speed within `ramp_s`."""
        first = [getattr(self, "_speeds", [0.0] * len(speeds_m_s)), self.time_s]
        while self.time_s < until_s - 1e-9:
            share = min((self.time_s - first[1]) / ramp_s, 1.0) if ramp_s else 1.0
            self._speeds = [old + share * (new - old) for old, new in zip(first[0], speeds_m_s, strict=True)]
            self._cycle(with_twin=with_twin)

    def _cycle(self, *, with_twin: bool) -> None:
        true = self.line.outputs()
        noise = self._rng.normal(size=(len(self.line.ports), 2)) * (_POSITION_NOISE_RAD, _TORQUE_NOISE_NM)
        measured = [
            (port.position_rad + float(x), port.torque_Nm + float(tau))
            for port, (x, tau) in zip(self.line.ports, noise, strict=True)
        ]
        for axis, speed_m_s in enumerate(self._speeds, 1):
            ratio = true[self._reels[axis]] / self._true.radius_m(axis) if axis in self._reels else 1.0
            turn = speed_m_s / ratio * self._true.motor_rad_per_m(axis)
            self.line.ports[axis - 1].setpoint = self.twin.ports[axis - 1].setpoint = turn
        if with_twin and self._before is not None:
            if not self._joined:
                self.twin.release(self._before, measured)
                self._joined = True
            self.twin.compare(self.time_s, measured)
            self.twin.listen()
            self.twin.plant.step(CYCLE_S)
            self._keep(true)
        self._before = measured
        for name, signal in self.shape.sensors:
            self._said[signal] = self._cell_N(name, true) if signal[0] == "F" else true[f"{signal[0]}_{name}_m"]
        self.line.step(CYCLE_S)
        self.time_s += CYCLE_S

    def _cell_N(self, name: str, true: Mapping[str, float]) -> float:
        """What the load cell of an idler says: the tensions on both sides of it, with noise and a constant error."""
        between = [roller.name for roller in self._true.line_rollers].index(name)
        mean_N = 0.5 * (true[f"F{between}_N"] + true[f"F{between + 1}_N"])
        return mean_N * (1.0 + CELL_OFF) + _CELL_NOISE_N * float(self._rng.normal())

    def _keep(self, true: Mapping[str, float]) -> None:
        values, shape, row = iter(self.twin.published()), self.shape, {"t_s": self.time_s}
        for span in shape.simulated:
            row[f"F{span}_sim_N"] = next(values)
            if span in shape.estimated:
                row |= {f"E{span}_sim_Pa": next(values), f"E{span}_sd_Pa": next(values)}
                row["tau_sim"], row["tau_residual"] = next(values), next(values)
        for name in shape.stations:
            letter = "x" if name in shape.carriages else "r"
            row |= {f"{letter}_{name}_sim_m": next(values), f"{letter}_{name}_sd_m": next(values)}
        row |= {name.replace("_m", "_true_m"): value for name, value in true.items() if name[:2] in ("x_", "r_")}
        row |= {name.replace("_N", "_true_N"): value for name, value in true.items() if name[0] == "F"}
        self._rows.append(row)

    def table(self) -> dict[str, Array]:
        """What was true, and what the twin told, by signal."""
        return {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}


def beside(
    true: ModelParameters,
    believed: ModelParameters,
    measured: tuple[str, ...] = (),
    seed: int = 1,
    config: EstimationConfig | None = None,
) -> BesideStations:
    """The twin beside the plant."""
    line = Line(true, [MotorPort() for _ in range(true.axis_count)])
    return BesideStations(line, true, believed, measured, seed, config)
