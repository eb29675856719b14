"""The twin of a line with idlers, dancers, accumulators or reels: it follows them on the driven rollers' motion.

What the axes measure moves the twin's own dancers and accumulators (`hilbench.plant.web_line.line_follower`): tension
of each section, carriages and radii are virtual sensors, with E as the model has it. E is not estimated: the balances
that show it know driven rollers alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

from hilbench.estimation.plausibility import Problem
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.pairing import Pairing
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m
from hilbench.topology.signals import Shape
from hilbench.twin.found import FoundBeside
from hilbench.twin.machines.machine import Measured, Told

_OF_AN_AXIS = (("x", "m"), ("v", "m_s"), ("tau", "Nm"))


class LineWithStationsTwin:
    """A `TwinMachine`. The motors' torques are those of the closed line, which goes on from what is measured.

    It is synchronized where the web was at rest when it was let go, or once that has been transported away: then the
    tensions are those of the measured motion, whatever they were.
    """

    def __init__(self, model: ModelParameters, shape: Shape, cycle_s: float, told: Told) -> None:
        axes = range(1, model.axis_count + 1)
        self.ports = tuple(MotorPort() for _ in axes)
        self.plant = Line(model, self.ports)
        self.problem: Problem | None = None
        self.problems: Mapping[int, Problem | None] = {0: None}
        self.shift_span = 0
        self.refused, self.synchronized = False, False
        self.separable = False  #: nothing is estimated
        self.torque_shift_Nm, self.torque_undecided = 0.0, False
        self._follower = LineFollower(model)
        self._shape = shape
        self._told = told
        self._cycle_s = cycle_s
        self._per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in axes]
        self._pairing = Pairing(least_way_m(model))
        self._web_m = sum(model.span_length_m(span) for span in range(1, model.span_count + 1))
        self._unknown_m = 0.0  # so much web that could not be known is still in the line
        self._missed = 0
        self._residuals_Nm = [0.0] * model.axis_count
        self._positions_m: list[float] | None = None
        self._of_axes = {f"{name}{axis}_{unit}" for axis in axes for name, unit in _OF_AN_AXIS}

    def reset(self) -> None:
        """Start anew, at rest."""
        self.synchronized = False
        self._positions_m = None
        self._residuals_Nm = [0.0] * len(self.ports)

    def release(self, before: Sequence[Measured], now: Sequence[Measured]) -> None:
        """Let the web go, with the axes' motion and torque."""
        last, positions = self._at_web(before), self._at_web(now)
        self._follower.reset(positions)
        self._pairing.reset()
        self._pairing.update(*positions)
        self._positions_m, self._missed = positions, 0
        moves = max(abs(x - then) for x, then in zip(positions, last, strict=True)) > 1e-3 * self._cycle_s
        self._unknown_m = self._web_m if moves else 0.0
        self.synchronized = not moves
        speeds = [(x - then) / self._cycle_s if moves else 0.0 for x, then in zip(positions, last, strict=True)]
        states: dict[str, float] = {}
        for axis, (x, v, (_, torque)) in enumerate(zip(positions, speeds, now, strict=True), 1):
            states |= {f"x{axis}_m": x, f"v{axis}_m_s": v, f"tau{axis}_Nm": torque if moves else 0.0}
        self.plant.set_state(states)
        self._transfer()

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Follow what was measured; False where the positions are not of one instant."""
        positions = self._at_web(measured)
        if self._positions_m is None:
            return False
        if not self._pairing.update(*positions):
            self.miss()
            return False
        self._follower.set_input("strain_prev", self._told("strain_prev"))
        self._follower.set_input("F_next_N", self._told("F_next_N"))
        self._follower.follow(positions, (self._missed + 1) * self._cycle_s)
        self._unknown_m = max(self._unknown_m - abs(positions[0] - self._positions_m[0]), 0.0)
        self.synchronized = self._unknown_m == 0.0
        self._positions_m, self._missed = positions, 0
        torques = [torque for _, torque in measured]
        self._residuals_Nm = [torque - port.torque_Nm for torque, port in zip(torques, self.ports, strict=True)]
        self._transfer()
        return True

    def _transfer(self) -> None:
        """Let the closed line go on with the web, and all that no motor drives, as they were followed."""
        found = self._follower.get_state().values
        self.plant.set_state({name: value for name, value in found.items() if name not in self._of_axes})

    def _at_web(self, measured: Sequence[Measured]) -> list[float]:
        return [position * metres for (position, _), metres in zip(measured, self._per_rad, strict=True)]

    def miss(self) -> None:
        """A cycle without measurement."""
        self._missed += 1
        self._pairing.miss()

    def listen(self) -> None:
        """Take over what is around the web now."""
        self.plant.set_input("strain_prev", self._told("strain_prev"))
        self.plant.set_input("F_next_N", self._told("F_next_N"))

    def found(self) -> Sequence[FoundBeside]:
        """No errors of the model are looked for."""
        return ()

    def use_method(self, number: int) -> None:
        """There is none to choose. Raises ValueError."""
        if number:
            raise ValueError(f"method {number}, expected 0: E of a line with stations is not estimated")

    def published(self) -> tuple[float, ...]:
        """Of each section its tension; where E would be found E as the model has it, with no deviation that is known,
        the simulated torque of the axis behind it, and the residual."""
        shape, tensions = self._shape, self.plant.tension_N.tolist()
        values: list[float] = []
        for span in shape.simulated:
            values.append(tensions[span - 1])
            if span in shape.estimated:
                axis = shape.axis_before(span)
                modulus_Pa = self.plant.parameter(f"span{span}.youngs_modulus_Pa")
                values += [modulus_Pa, inf, self.ports[axis].torque_Nm, self._residuals_Nm[axis]]
        return tuple(values)
