"""Twin of a line with idlers, dancers, accumulators or reels: it follows them on the driven rollers' motion.

The axes' measured motion moves the twin's own dancers and accumulators (`hilbench.plant.web_line.line_follower`);
residuals of torques and station sensors correct carriages, radii of reels, and E of the sections where it is observable
(`web_line_filter`). Where a carriage keeps the tension E changes no force, but the strain of the web in the next
section: it is stated as far as all of the line is one web. Next to a reel without a radius sensor the tension
identifies the radius, and E is that of the model; likewise on a line with a carriage that is joined while running. On
others joined so E is stated once the web of unknown strain has left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np

from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.sample_coherence import OwnIncrements, SampleCoherence, play
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import StateTransfer
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.plant.web_line.stations import Reel, force_input
from hilbench.topology.signals import Shape
from hilbench.twin.estimated_errors import EstimatedModelError
from hilbench.twin.machines.machine import BoundaryInputs, Measured
from hilbench.twin.machines.web_line_breaks import SectionWatch
from hilbench.twin.machines.web_line_filter import Found, LineFilter


class LineWithStationsTwin:
    """`TwinMachine` of a line with stations. Motor torques are those of the closed line from the measured state on.

    It is synchronized if the web was at rest at its release, or once that web has been transported away: then the
    tensions are those of the measured motion, whatever they were.
    """

    def __init__(
        self,
        model: ModelParameters,
        config: EstimationConfig,
        shape: Shape,
        cycle_s: float,
        boundary_inputs: BoundaryInputs,
    ) -> None:
        axes = range(1, model.axis_count + 1)
        self.ports = tuple(MotorPort() for _ in axes)
        self.plant = Line(model, self.ports)
        self.shift_span = 0
        self.refused, self.synchronized = False, False
        self.torque_shift_Nm, self.torque_undecided = 0.0, False
        emulated = bool(shape.load_motors)
        self._unknowns = LineFilter(model, cycle_s, shape.measured, shape.torqued, emulated=emulated)
        self._model = model
        self._shape = shape
        self._boundary_inputs = boundary_inputs
        #: True if an unknown strain of a web at rest is observable as it leaves: all carriages and reels have a sensor.
        self._shows_at_rest = {*shape.carriages, *shape.reels} <= {*shape.measured}
        self._known_at_rest = config.web_at_rest == "as_upstream"
        self._per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in axes]
        self._web_m = sum(model.span_length_m(span) for span in range(1, model.span_count + 1))
        self._before = axes_before_spans(model)
        self._set_cycle(cycle_s)
        self._limited = self._frozen = False
        self._unknown_m = 0.0  # length of web with unknown strain in the line
        self._missed = 0
        self._residuals_Nm = [0.0] * model.axis_count
        self._positions_m: list[float] | None = None
        self._carriages = range(1, len(model.carriages) + 1)
        self._reels = [roller.axis for roller in model.line_rollers if isinstance(roller.station, Reel) and roller.axis]
        #: A torque-controlled reel moves as measured, all other driven rollers by their drives.
        self._transfer = StateTransfer(self._unknowns.sensitivities.line, self.plant, shape.torqued)

    def _set_cycle(self, cycle_s: float) -> None:
        model, shape, least_m = self._model, self._shape, least_travel_m(self._model, cycle_s)
        self._cycle_s = cycle_s
        of_a_cycle = play(model.position_unit, cycle_s)
        self._pairing = SampleCoherence(least_m) if isfinite(least_m) else OwnIncrements(model.axis_count, of_a_cycle)
        strain_from = {self._before[span - 1]: span for span in shape.simulated}
        unknowns = self._unknowns
        self._watch = SectionWatch(
            model, cycle_s, strain_from, unknowns.sensitivities.unknowns, shape.measured, unknowns.sensed_length_m
        )

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze parameter adaptation; see `TwinMachine`."""
        self._frozen = frozen

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; see `TwinMachine`. Estimates are kept."""
        self.plant.lock_to(cycle_s)
        self._unknowns.set_cycle_time(cycle_s)
        self._set_cycle(cycle_s)
        self._watch.reset(in_motion=True)
        self._missed = 0

    def keep(self) -> None:
        """No-op: no checkpoint is needed, as wrong estimates are soon corrected."""

    @property
    def problems(self) -> Mapping[int, Problem | None]:
        """Problem of each section's web, by the span that publishes its tension."""
        return self._watch.problems

    @property
    def problem(self) -> Problem | None:
        """First problem, if any."""
        return next((problem for problem in self.problems.values() if problem is not None), None)

    def reset(self) -> None:
        """Reset, at rest."""
        self.synchronized = False
        self._watch.reset(in_motion=False)
        self._positions_m = None
        self._residuals_Nm = [0.0] * len(self.ports)

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release the web, with the axes' motion and torque."""
        last, positions = self._at_web(before), self._at_web(now)
        self._pairing.reset()
        if not (self._pairing.update(*last) and self._pairing.update(*positions)):
            return False
        # From the previous cycle's positions: the same measurement is compared next.
        self._pairing.reset()
        self._pairing.update(*last)
        self._positions_m, self._missed = positions, 0
        moves = max(abs(x - then) for x, then in zip(positions, last, strict=True)) > 1e-3 * self._cycle_s
        known = not moves and (not self._shows_at_rest or (self._known_at_rest and not in_motion))
        self._watch.reset(in_motion=not known)
        self._unknown_m = 0.0 if known else self._web_m
        self.synchronized = known
        speeds = [(x - then) / self._cycle_s if moves else 0.0 for x, then in zip(positions, last, strict=True)]
        # Reels turn by web speed over radius; the others define the web speed.
        of_rollers = [v for axis, v in enumerate(speeds, 1) if axis not in self._reels] or speeds
        self._unknowns.begin(last, sum(of_rollers) / len(of_rollers), known=known)
        states: dict[str, float] = {}
        for axis, (x, v, (_, torque)) in enumerate(zip(positions, speeds, now, strict=True), 1):
            states |= {f"x{axis}_m": x, f"v{axis}_m_s": v, f"tau{axis}_Nm": torque}
        self.plant.set_state(states)
        self._transfer()
        return True

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Follow the measurement; False if the positions are not coherent (of one instant)."""
        positions = self._at_web(measured)
        if self._positions_m is None:
            return False
        if not self._pairing.update(*positions) or not self._elapsed_cycles:
            self._go_on_without()
            return False
        if not self._missed:
            self._unknowns.sense({name: self._boundary_inputs(signal) for name, signal in self._shape.sensors})
        self._unknowns.sensitivities.set_boundary(
            self._boundary_inputs("strain_prev"), self._boundary_inputs("F_next_N")
        )
        self._unknowns.follow(positions, self._elapsed_cycles * self._cycle_s)
        self._unknown_m = max(self._unknown_m - abs(positions[-1] - self._positions_m[-1]), 0.0)
        self.synchronized = self._unknown_m == 0.0
        self._positions_m, self._missed = positions, 0
        self._look_for_breaks(time_s, positions, [torque for _, torque in measured])
        left = np.array([torque - port.torque_Nm for (_, torque), port in zip(measured, self.ports, strict=True)])
        self._residuals_Nm = (left - self._unknowns.torques_missing_Nm).tolist()
        limited, since_s = self._limited or self._watch.doubtful or self._frozen, self._watch.slips_since_s
        if self._unknowns.compare(time_s, left, limited=limited, slips_since_s=since_s):
            self._watch.corrected(self._unknowns.sensitivities)
            for span, axis in enumerate(self._before, 1):
                name = f"span{span}.youngs_modulus_Pa" if len(self._before) > 1 else "youngs_modulus_Pa"
                self.plant.set_parameter(name, self._modulus(span, axis).value)
        belied_N = self._watch.take_belied()
        if belied_N:
            self._unknowns.put_tensions(belied_N)
            self._watch.corrected(self._unknowns.sensitivities)
        self._transfer()
        return True

    def _look_for_breaks(self, time_s: float, positions_m: Sequence[float], torques_Nm: Sequence[float]) -> None:
        """Update the detection of web break, slip and slack."""
        self._limited = any(port.torque_limited for port in self.ports)
        if self._limited or self._frozen:
            self._watch.suspend()
        else:
            unknowns = self._unknowns
            inertia_kg_m2, swings = unknowns.inertia_kg_m2, unknowns.swings
            self._watch.look(time_s, positions_m, torques_Nm, unknowns.sensitivities, inertia_kg_m2, swings=swings)

    def _modulus(self, span: int, axis: int) -> Found:
        return self._unknowns.modulus(axis, self._model.youngs_modulus_Pa(span))

    @property
    def separable(self) -> bool:
        """True if E is identified wherever it is stated."""
        return all(self._unknowns.separable(self._before[span - 1]) for span in self._shape.estimated)

    def _at_web(self, measured: Sequence[Measured]) -> list[float]:
        return [position * metres for (position, _), metres in zip(measured, self._per_rad, strict=True)]

    @property
    def _elapsed_cycles(self) -> int:
        """Cycles from the last followed motion to the present measurement."""
        return self._pairing.elapsed if isinstance(self._pairing, OwnIncrements) else self._missed + 1

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        self._pairing.miss()
        self._go_on_without()

    def _go_on_without(self) -> None:
        """Skip a cycle without a usable measurement."""
        self._missed += 1
        self._watch.interrupt()

    def listen(self) -> None:
        """Read the boundary inputs of the web."""
        self.plant.set_input("strain_prev", self._boundary_inputs("strain_prev"))
        self.plant.set_input("F_next_N", self._boundary_inputs("F_next_N"))
        for name, signal in self._shape.forces:  # on carriages with a stated force, from the last SYNC on
            self.plant.set_input(force_input(name), self._boundary_inputs(signal))
            self._unknowns.sensitivities.set_input(force_input(name), self._boundary_inputs(signal))

    def found(self) -> Sequence[EstimatedModelError]:
        """Empty: estimates are published as signals."""
        return ()

    def use_method(self, number: int) -> None:
        """Raise ValueError: there is no method to choose."""
        if number:
            raise ValueError(f"method {number}, expected 0: E of a line with stations is found in one way")

    #: See `TwinMachine`.
    largest_steps: Sequence[float] = ()

    def published(self) -> tuple[float, ...]:
        """Tension of each section; where E is stated also E with its deviation (inf if not identified), the simulated
        torque of the axis after it, and the residual; position of each carriage, radius of each reel, with their
        deviations."""
        shape, tensions, missing = self._shape, self.plant.tension_N.tolist(), self._unknowns.torques_missing_Nm
        values: list[float] = []
        for span in shape.simulated:
            values.append(tensions[span - 1])
            if span in shape.estimated:
                axis = shape.axis_before(span)
                modulus = self._modulus(span, self._before[span - 1])
                torque_Nm = self.ports[axis].torque_Nm + missing.item(axis)
                values += [modulus.value, modulus.deviation, torque_Nm, self._residuals_Nm[axis]]
        stations = [self._unknowns.carriage(number) for number in self._carriages]
        stations += [self._unknowns.radius(axis) for axis in self._reels]
        return (*values, *(number for found in stations for number in (found.value, found.deviation)))
