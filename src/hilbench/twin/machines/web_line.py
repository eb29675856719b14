"""The twin of a web line: the simulated web, and the synchronizer that finds its E from torques behind a span."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.estimation.plausibility import Problem
from hilbench.estimation.web_line.config import EstimationConfig, InputConfig
from hilbench.estimation.web_line.synchronizers.create import METHODS
from hilbench.estimation.web_line.tracking import MOVES_M_S, UNKNOWN_STRAIN, Tracking
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.pairing import Pairing, SteadyWay
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m
from hilbench.plant.web_line.span import SpanFollower
from hilbench.twin.machines.machine import Measured, Told
from hilbench.twin.machines.web_section import WebSection


def boundary(model: ModelParameters) -> dict[str, float]:
    """What is around the web before the bench says it."""
    return {"strain_prev": model.upstream_strain, "F_next_N": model.boundary.downstream_tension_N}


class WebLineTwin:
    """A `TwinMachine` with N axes and the spans between them; E is found from the torques behind one of these.

    The web starts as the bench's load model does, strained like the web upstream. On axes that move already this is a
    guess: the twin then calls itself synchronized when strain and E are known, at the latest when the web that it could
    not know has been transported out of the span.
    """

    def __init__(self, model: ModelParameters, config: EstimationConfig, cycle_s: float, told: Told) -> None:
        axes = range(1, model.axis_count + 1)
        self.ports = tuple(MotorPort() for _ in axes)
        self.plant = Line(model, self.ports)
        self._transfer = config.transfer
        self._span = config.estimate[0].span
        self._section = WebSection(model, self.plant, self.ports, self._span)
        self._tracking = Tracking(self._section.model, config, self._section, self._section, cycle_s)
        self._others = _OtherSpans(model, self._span, config.transfer.strain_limit) if len(axes) > 2 else None
        self._told = told
        self._cycle_s = cycle_s
        self._metres_per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in axes]
        self._pairing = Pairing(least_way_m(model))
        self._steady = SteadyWay(cycle_s)  # of the axis behind the span
        self._residual_Nm = 0.0

    @property
    def problem(self) -> Problem | None:
        """Why the last measurement could not be used."""
        return self._tracking.problem

    @property
    def refused(self) -> bool:
        """Whether a measured state was not plausible and was not taken over in the last cycle."""
        return self._tracking.refused or (self._others is not None and self._others.refused)

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
        self._start_anew()
        self._residual_Nm = 0.0
        at_rest = [0.0] * len(self.ports)
        self.plant.set_state(_states(self._told("strain_prev"), at_rest, at_rest, at_rest))

    def _start_anew(self) -> None:
        """What is measured has no past."""
        self._section.reset()
        if self._others is not None:
            self._others.reset()

    def release(self, before: Sequence[Measured], now: Sequence[Measured]) -> None:
        """Let the web go, with the axes' motion and torque."""
        last, positions = self._positions_m(before), self._positions_m(now)
        speeds = [(x - then) / self._cycle_s for x, then in zip(positions, last, strict=True)]
        moves = max(map(abs, speeds)) > MOVES_M_S
        at_rest = [0.0] * len(self.ports)
        torques = [torque for _, torque in now]
        self.plant.set_state(
            _states(self._told("strain_prev"), positions, speeds if moves else at_rest, torques if moves else at_rest)
        )
        self._tracking.release(UNKNOWN_STRAIN if moves else 0.0)
        self._start_anew()
        self._pairing.reset()
        self._steady.reset()

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Let the synchronizer compare; False where the positions are not of one instant."""
        positions_m = self._positions_m(measured)
        before_m, behind_m = positions_m[self._span - 1 : self._span + 1]
        if not self._pairing.update(*positions_m) or not self._steady.update(behind_m):
            self.miss()
            return False
        strain, F_next_N = self._told("strain_prev"), self._told("F_next_N")
        others = self._others
        if others is not None:
            others.follow(positions_m, strain, F_next_N, self._cycle_s)
            strain = others.strain_before
        torques_Nm = [torque_Nm for _, torque_Nm in measured]
        torque_Nm = self._section.measured_torque_Nm(positions_m, torques_Nm, strain, self._cycle_s)
        simulated_Nm = self.ports[self._span].torque_Nm
        self._tracking.compare(time_s, before_m, behind_m, torque_Nm, strain, F_next_N)
        rad_per_m = 1.0 / self._metres_per_rad[self._span]
        self._tracking.look_for_known_change(self.ports[self._span].setpoint / rad_per_m)
        self._residual_Nm = self._tracking.residual_Nm
        if others is not None:
            self._residual_Nm = torques_Nm[self._span] - self._tracking.torque_shift_Nm - simulated_Nm
            if self._transfer.strain:
                others.transfer(self.plant)
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
        method = methods[number - 1]() if number else None
        if isinstance(method, InputConfig) and self._others is not None:
            raise ValueError(f"method {number}, expected one that corrects E: the line has several spans")
        self._tracking.use(method)

    def published(self) -> tuple[float, ...]:
        """Of each span its tension; of that at which E is found E, its deviation, and of the torque of the axis behind
        it what is simulated, and the residual."""
        tracking, line = self._tracking, self.plant
        factor = line.elasticity_factor(self._span)  # the E that acts is told, as of a web that is measured
        tensions_N = line.tension_N.tolist()
        return (
            *tensions_N[: self._span],
            factor * tracking.estimate.youngs_modulus_Pa,
            factor * tracking.estimate.deviation_Pa,
            self.ports[self._span].torque_Nm,
            self._residual_Nm,
            *tensions_N[self._span :],
        )


class _OtherSpans:
    """The spans of a line at which nothing is estimated, on the measured motion: their strains are taken over.

    `span`: that at which E is found; `strain_limit`: largest plausible difference of a strain.
    """

    def __init__(self, model: ModelParameters, span: int, strain_limit: float) -> None:
        self._web = SpanFollower(model)
        self._span = span
        self._limit = strain_limit
        self.reset()

    def reset(self) -> None:
        """The next positions are the first."""
        self.refused = False
        self._running = False
        self.strain_before = 0.0  #: of the web that enters the span at which E is found

    def follow(self, positions_m: Sequence[float], strain_prev: float, F_next_N: float, cycle_s: float) -> None:
        """The rollers are at these positions (N,) a cycle after the last; around the line is what is told."""
        web = self._web
        web.set_input("strain_prev", strain_prev)
        web.set_input("F_next_N", F_next_N)
        if self._running:
            web.follow(positions_m, cycle_s)
        else:
            web.reset(positions_m, strain=[strain_prev] * (len(positions_m) - 1))
        self._running = True
        self.strain_before = float(web.strain[self._span - 2]) if self._span > 1 else strain_prev

    def transfer(self, line: Line) -> None:
        """Put the measured strains in the place of the simulated ones, unless they are too far off to be believed."""
        states = {}
        self.refused = False
        for at, (measured, simulated) in enumerate(
            zip(self._web.strain.tolist(), line.strain.tolist(), strict=True), 1
        ):
            if at == self._span:
                continue
            if abs(measured - simulated) <= self._limit:
                states[f"strain{at}"] = measured
            else:
                self.refused = True
        for at in range(1, len(states) + 2):
            name = f"span{at}.youngs_modulus_Pa"
            self._web.set_parameter(name, line.parameter(name))
        line.set_state(states)


def _states(strain: float, x_m: Sequence[float], v_m_s: Sequence[float], tau_Nm: Sequence[float]) -> dict[str, float]:
    """States of the line by name: one strain for every span; position, speed and torque of each axis (N,)."""
    states = {f"strain{span}": strain for span in range(1, len(x_m))}
    for k, (x, v, tau) in enumerate(zip(x_m, v_m_s, tau_Nm, strict=True), 1):
        states |= {f"x{k}_m": x, f"v{k}_m_s": v, f"tau{k}_Nm": tau}
    return states
