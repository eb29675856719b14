"""The twin of a web line: the simulated web, and the synchronizer that finds its E from the torque of axis 2."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.estimation.plausibility import Problem
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.synchronizers.create import METHODS
from hilbench.estimation.web_line.tracking import Tracking
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.pairing import Pairing, SteadyWay
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m
from hilbench.twin.machines.machine import Measured, Told

#: Above this speed of an axis the plant runs already when the twin joins.
_MOVES_M_S = 1e-3
#: How far off the upstream strain may be as a guess of the strain of a web that is found under way.
_UNKNOWN_STRAIN = 0.3


def boundary(model: ModelParameters) -> dict[str, float]:
    """What is around the web before the bench says it."""
    return {"strain_prev": model.upstream_strain, "F_next_N": model.boundary.downstream_tension_N}


class WebLineTwin:
    """A `TwinMachine` with two axes and one span.

    The web starts as the bench's load model does, strained like the web upstream. On axes that move already this is a
    guess: the twin then calls itself synchronized when the web that it could not know has been transported out of the
    span and E is known.
    """

    def __init__(self, model: ModelParameters, config: EstimationConfig, cycle_s: float, told: Told) -> None:
        self.ports = (MotorPort(), MotorPort())
        self.plant = Line(model, self.ports)
        self._tracking = Tracking(model, config, self.plant, self.ports[1], cycle_s)
        self._told = told
        self._cycle_s = cycle_s
        self._metres_per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in (1, 2)]
        self._pairing = Pairing(least_way_m(model))
        self._steady = SteadyWay(cycle_s)  # of axis 2

    @property
    def problem(self) -> Problem | None:
        """Why the last measurement could not be used."""
        return self._tracking.problem

    @property
    def refused(self) -> bool:
        """Whether a measured state was not plausible and was not taken over in the last cycle."""
        return self._tracking.refused

    @property
    def synchronized(self) -> bool:
        """Whether E is known as well as the config asks for, and the web is the one that was measured."""
        return self._tracking.synchronized

    @property
    def separable(self) -> bool:
        """Whether the data tell everything that is estimated from E."""
        return all(nuisance.separable for nuisance in self._tracking.estimate.nuisances)

    @property
    def torque_shift_Nm(self) -> float:
        """What the measured torque has shifted by, and is corrected for."""
        return self._tracking.torque_shift_Nm

    @property
    def torque_undecided(self) -> bool:
        """Whether the torque has changed, and nothing tells yet whether that was E or a shift."""
        return self._tracking.torque_undecided

    def reset(self) -> None:
        """Start anew with the E that is assumed at the start, at rest."""
        self._tracking.reset()
        self.plant.set_state(_states(self._told("strain_prev"), [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]))

    def release(self, before: Sequence[Measured], now: Sequence[Measured]) -> None:
        """Let the web go, with the axes' motion and torque."""
        last, positions = self._positions_m(before), self._positions_m(now)
        speeds = [(x - then) / self._cycle_s for x, then in zip(positions, last, strict=True)]
        moves = max(map(abs, speeds)) > _MOVES_M_S
        at_rest = [0.0, 0.0]
        torques = [torque for _, torque in now]
        self.plant.set_state(
            _states(self._told("strain_prev"), positions, speeds if moves else at_rest, torques if moves else at_rest)
        )
        self._tracking.release(_UNKNOWN_STRAIN if moves else 0.0)
        self._pairing.reset()
        self._steady.reset()

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Let the synchronizer compare; False where the positions are not of one instant."""
        x1_m, x2_m = self._positions_m(measured)
        if not self._pairing.update(x1_m, x2_m) or not self._steady.update(x2_m):
            self.miss()
            return False
        self._tracking.compare(time_s, x1_m, x2_m, measured[1][1], self._told("strain_prev"), self._told("F_next_N"))
        return True

    def _positions_m(self, measured: Sequence[Measured]) -> list[float]:
        """Of both axes, at the web."""
        return [
            position_rad * metres_per_rad
            for (position_rad, _), metres_per_rad in zip(measured, self._metres_per_rad, strict=True)
        ]

    def miss(self) -> None:
        """A cycle without measurement."""
        self._tracking.miss()

    def listen(self) -> None:
        """Take over what is around the web now."""
        self.plant.set_input("strain_prev", self._tracking.upstream_strain(self._told("strain_prev")))
        self.plant.set_input("F_next_N", self._told("F_next_N"))

    def use_method(self, number: int) -> None:
        """Go on with another synchronizer, by its number in the vocabulary, from the present E."""
        methods = list(METHODS.values())
        if number > len(methods):
            raise ValueError(f"method {number}, expected 0 to {len(methods)}")
        self._tracking.use(methods[number - 1]() if number else None)

    def published(self) -> tuple[float, ...]:
        """Tension, E and its deviation, simulated torque of axis 2, its residual."""
        tracking, line = self._tracking, self.plant
        factor = line.elasticity_factor  # the E that acts is told, as of a web that is measured
        return (
            float(line.tension_N[0]),
            factor * tracking.estimate.youngs_modulus_Pa,
            factor * tracking.estimate.deviation_Pa,
            self.ports[1].torque_Nm,
            tracking.residual_Nm,
        )


def _states(strain: float, x_m: Sequence[float], v_m_s: Sequence[float], tau_Nm: Sequence[float]) -> dict[str, float]:
    """States of the line by name: one strain for every span; position, speed and torque of each axis (N,)."""
    states = {f"strain{span}": strain for span in range(1, len(x_m))}
    for k, (x, v, tau) in enumerate(zip(x_m, v_m_s, tau_Nm, strict=True), 1):
        states |= {f"x{k}_m": x, f"v{k}_m_s": v, f"tau{k}_Nm": tau}
    return states
