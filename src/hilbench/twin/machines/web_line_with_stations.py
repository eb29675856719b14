"""Twin of a line with idlers, dancers, accumulators or reels: it follows them on the driven rollers' motion.

The axes' measured motion moves the twin's own dancers and accumulators (`hilbench.plant.web_line.line_follower`);
residuals of torques and station sensors correct carriages, radii of reels, and E of the sections where it is observable
(`web_line_filter`). Where a carriage keeps the tension E changes no force, but the strain of the web in the next
section: it is stated as far as all of the line is one web. Next to a reel without a radius sensor the tension
identifies the radius, and E is that of the model; likewise on a line with a carriage that is joined while running. On
others joined so E is stated once the web of unknown strain has left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import table_of
from hilbench.cycle_program import CompiledStage
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.span_estimator_cycle import DIVERGED_S
from hilbench.plant.motor_port import FEEDBACK_SIZE, MotorPort
from hilbench.plant.sample_coherence import OwnIncrements, SampleCoherence, play
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import rig_cycle
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import StateTransfer
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.plant.web_line.stations import Reel, force_input
from hilbench.topology.signals import Shape
from hilbench.twin.machines import web_line_stations_cycle as cycle
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, BoundaryInputs, MachineVectors, Measured, OneMethod
from hilbench.twin.machines.web_line_breaks import SectionWatch
from hilbench.twin.machines.web_line_filter import LineFilter

#: Result of each end of a cycle.
_ENDS = {cycle.COMPARED: WENT_ON, cycle.DONE: WENT_ON, cycle.PROBLEM: LOOK, cycle.WITHOUT: MISSED}


class LineWithStationsTwin(OneMethod):
    """`TwinMachine` of a line with stations, and `VectorMachine`. Motor torques are those of the closed line from the
    measured state on.

    It is synchronized if the web was at rest at its release, or once that web has been transported away: then the
    tensions are those of the measured motion, whatever they were.
    """

    compiled_cycle = staticmethod(cycle.run)

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
        emulated = bool(shape.load_motors)
        self._unknowns = LineFilter(model, cycle_s, shape.measured, shape.torqued, emulated=emulated)
        self._model = model
        self._shape = shape
        self._boundary_inputs = boundary_inputs
        #: True if an unknown strain of a web at rest is observable as it leaves: all carriages and reels have a sensor.
        self._shows_at_rest = {*shape.carriages, *shape.reels} <= {*shape.measured}
        self._known_at_rest = config.web_at_rest == "as_upstream"
        self._m_per_rad = np.array([1.0 / model.motor_rad_per_m(axis) for axis in axes])
        self._web_m = sum(model.span_length_m(span) for span in range(1, model.span_count + 1))
        self._before = axes_before_spans(model)
        self._moduli_Pa = np.array([model.youngs_modulus_Pa(span) for span in range(1, model.span_count + 1)])
        self._reels = [roller.axis for roller in model.line_rollers if isinstance(roller.station, Reel) and roller.axis]
        #: A torque-controlled reel moves as measured, all other driven rollers by their drives.
        self._transfer = StateTransfer(self._unknowns.sensitivities.line, self.plant, shape.torqued)
        self._released = False
        self._twin, self._residuals_Nm = np.zeros(1, cycle.TWIN), np.zeros(len(axes))
        self._set_cycle(cycle_s)

    def _set_cycle(self, cycle_s: float) -> None:
        model, shape, least_m = self._model, self._shape, least_travel_m(self._model, cycle_s)
        self._cycle_s = cycle_s
        of_a_cycle = play(model.position_unit, cycle_s)
        self._pairing = SampleCoherence(least_m) if isfinite(least_m) else OwnIncrements(model.axis_count, of_a_cycle)
        strain_from = {self._before[span - 1]: span for span in shape.simulated}
        unknowns = self._unknowns
        self._watch = SectionWatch(
            model, cycle_s, strain_from, unknowns.sensitivities, shape.measured, unknowns.sensed_length_m
        )
        self._own = self._arrays_by_objects(least_m)
        self._table = self._table_of(self._own)

    def _arrays_by_objects(self, least_m: float) -> cycle.StationsArrays:
        """Arrays of a cycle whose line is stepped by its object."""
        shape, model, unknowns, plant, axes = self._shape, self._model, self._unknowns, self.plant, len(self.ports)
        sensors, forces = dict(shape.sensors), [force_input(name) for name, _ in shape.forces]
        #: Signals of the boundary inputs, in the order of the compiled cycle.
        self._signals = ["strain_prev", "F_next_N", *(sensors[name] for name in unknowns.sensor_names)]
        self._signals += [signal for _, signal in shape.forces]
        axis_of = {span: shape.axis_before(span) for span in shape.estimated}
        stated = [(span - 1, axis_of.get(span, -1), 0, 0) for span in shape.simulated]
        stations = [(unknowns.sensitivities.carriage_row(k + 1), -1, 1.0, 0) for k in range(len(model.carriages))]
        stations += [(-1, axis - 1, model.radius_m(axis), 0) for axis in self._reels]
        size = len(stated) + 4 * len(shape.estimated) + 2 * len(stations)
        step, twin = plant.step_in_vectors(plant.vectors.p.item(lay.W_SAMPLE_TIME_S)), self._twin
        twin["cycle_s"], twin["by_object"], twin["stated"] = self._cycle_s, 1.0, 0.0
        twin["own_travels"], twin["least_travel_m"] = not isfinite(least_m), least_m
        return cycle.StationsArrays(
            twin,
            self._pairing.vectors(axes)[0],
            self._m_per_rad,
            *(np.zeros(axes), np.zeros(axes), self._residuals_Nm),
            np.zeros(4 * axes),
            rig_cycle.RigArrays(plant.vectors, step.motors, np.zeros(axes), step.sensors, np.zeros(5 * axes)),
            step.silence,
            np.zeros(len(self._signals) + size),
            np.zeros(2, np.int64),
            np.array([(0, 1)], cycle.AT),
            np.arange(len(self._signals)),
            len(self._signals) + np.arange(size),
            np.array(stated, cycle.OF_SPAN),
            np.array(stations, cycle.STATION),
            np.array([(push.place, push.more_N) for push in map(plant.push_of, forces)], cycle.PUSH),
            *(unknowns.arrays, self._watch.arrays),
            self._transfer.at,
        )

    def _table_of(self, arrays: cycle.StationsArrays) -> NDArray[np.int64]:
        line, detectors = self._unknowns.sensitivities, [each.arrays for _, each in self._unknowns.transients]
        return np.concatenate([table_of(arrays), line.slopes_table, line.copies.table, *map(table_of, detectors)])

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze parameter adaptation; see `TwinMachine`."""
        self._twin["frozen"] = frozen

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; see `TwinMachine`. Estimates are kept."""
        self.plant.lock_to(cycle_s)
        self._unknowns.set_cycle_time(cycle_s)
        self._set_cycle(cycle_s)
        self._watch.reset(in_motion=True)
        self._twin["missed"] = 0.0

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
        self._watch.reset(in_motion=False)
        self._released = False
        self._residuals_Nm[:] = 0.0

    @property
    def synchronized(self) -> bool:
        """True if no web of unknown strain is in the line, and it follows what is measured."""
        return self._released and not self.refused and bool(self._twin["unknown_m"] == 0.0)

    @property
    def refused(self) -> bool:  # type: ignore[override] # of a machine that refuses nothing it is an attribute
        """True if nothing has been measured for `DIVERGED_S`."""
        return bool(self._twin["missed"] * self._cycle_s > DIVERGED_S)

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release the web, with the axes' motion and torque."""
        last, positions = self._at_web(before), self._at_web(now)
        self._pairing.reset()
        if not (self._pairing.update(*last) and self._pairing.update(*positions)):
            return False
        # From the previous cycle's positions: the same measurement is compared next.
        self._pairing.reset()
        self._pairing.update(*last)
        moves = max(abs(x - then) for x, then in zip(positions, last, strict=True)) > 1e-3 * self._cycle_s
        known = not moves and (not self._shows_at_rest or (self._known_at_rest and not in_motion))
        self._watch.reset(in_motion=not known)
        twin, self._released = self._twin, True
        twin["last_m"], twin["missed"], twin["unknown_m"] = positions[-1], 0.0, 0.0 if known else self._web_m
        speeds = [(x - then) / self._cycle_s if moves else 0.0 for x, then in zip(positions, last, strict=True)]
        # Reels turn by web speed over radius; the others define the web speed.
        of_rollers = [v for axis, v in enumerate(speeds, 1) if axis not in self._reels] or speeds
        self._unknowns.begin(last, sum(of_rollers) / len(of_rollers), known=known)
        states: dict[str, float] = {}
        for axis, (x, v, (_, torque)) in enumerate(zip(positions, speeds, now, strict=True), 1):
            states |= {f"x{axis}_m": x, f"v{axis}_m_s": v, f"tau{axis}_Nm": torque}
        self.plant.set_state(states)
        self._transfer()
        twin["stated"] = 0.0
        return True

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Follow the measurement; False if the positions are not coherent (of one instant)."""
        if not self._released:
            return False
        own = self._own
        own.measured[::4], own.measured[2::4] = zip(*measured, strict=True)
        own.rig.shown.reshape(-1, FEEDBACK_SIZE)[:] = [port.feedback for port in self.ports]
        self._take_inputs()
        self._twin["time_s"] = time_s
        if self.go_on_from(cycle.run(cycle.BEGIN, self._table)) == MISSED:
            return False
        self.plant.show()
        return True

    def _take_inputs(self) -> None:
        self._own.values[: len(self._signals)] = list(map(self._boundary_inputs, self._signals))

    def go_on_from(self, code: int) -> int:
        """Run the rest of a cycle; see `machine.InVectors`."""
        while code not in _ENDS:
            code = cycle.run(self._do(code), self._table)
        return _ENDS[code]

    def _do(self, part: int) -> int:
        """Do Python's part of a cycle; returns the part behind which it goes on."""
        unknowns, watch, twin = self._unknowns, self._watch, self._twin[0]
        time_s, unusable = float(twin["time_s"]), bool(twin["limited"] or twin["frozen"])
        if part == cycle.STATED:
            self._state()
            return part
        if part == cycle.BREAKS:
            if unusable:
                watch.suspend()
            else:
                watch.judge(time_s, unknowns.inertia_kg_m2, swings=unknowns.swings)
            return part
        corrected = True
        if part == cycle.BELIED:
            unknowns.put_tensions(watch.take_belied())
        elif part == cycle.SLIP:
            unknowns.begin_slip(watch.slips_since_s)
        elif part == cycle.TRANSIENTS:
            corrected = unknowns.look_for_transients(time_s)
            if not corrected:
                return part
        else:
            corrected = unknowns.correct(time_s, limited=unusable or watch.doubtful)
        twin["stated"] = 0.0
        if corrected:
            watch.corrected()
            self.plant.moduli_Pa[:] = self._moduli_Pa * [unknowns.modulus_factor(axis) for axis in self._before]
        return max(part, cycle.CORRECTION)

    def _state(self) -> None:
        """Update what is published with its deviation."""
        unknowns, model = self._unknowns, self._model
        for row, span in zip(self._own.spans, self._shape.simulated, strict=True):
            if row["axis"] >= 0.0:
                axis, modulus_Pa = self._before[span - 1], model.youngs_modulus_Pa(span)
                row["modulus_Pa"] = modulus_Pa * unknowns.modulus_factor(axis)
                row["deviation_Pa"] = modulus_Pa * unknowns.modulus_deviation(axis)
        carriages = map(unknowns.carriage_deviation_m, range(1, len(model.carriages) + 1))
        self._own.stations["deviation"] = [*carriages, *map(unknowns.radius_deviation_m, self._reels)]
        self._twin["separable"], self._twin["stated"] = self.separable, 1.0

    @property
    def separable(self) -> bool:
        """True if E is identified wherever it is stated."""
        return all(self._unknowns.separable(self._before[span - 1]) for span in self._shape.estimated)

    def _at_web(self, measured: Sequence[Measured]) -> list[float]:
        return [position * metres for (position, _), metres in zip(measured, self._m_per_rad.tolist(), strict=True)]

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        self._pairing.miss()
        self._twin["missed"] += 1.0
        self._twin["time_s"] += self._cycle_s
        self._watch.interrupt()

    def listen(self) -> None:
        """Read the boundary inputs of the web, and forces on carriages, from the last SYNC on."""
        self._take_inputs()
        cycle.run(cycle.LISTEN, self._table)

    def published(self) -> tuple[float, ...]:
        """Outputs of the compiled cycle."""
        if not self._twin["stated"]:
            self._state()
        cycle.run(cycle.STATED, self._table)
        return tuple(self._own.values[len(self._signals) :].tolist())

    # -- in vectors --------------------------------------------------------------------------------------

    @property
    def runs_in_vectors(self) -> bool:
        """True once it is released; see `VectorMachine`."""
        return self._released

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> LineWithStationsTwin:
        """Go on in these vectors until `give`; see `VectorMachine`."""
        self._twin["samples"], self._twin["by_object"] = self.plant.step_in_vectors(self._cycle_s).samples, 0.0
        arrays = self._own._replace(
            measured=vectors.measured,
            rig=self._own.rig._replace(asked=vectors.asked, shown=vectors.shown),
            values=vectors.values,
            whole=vectors.whole,
            at=np.array([(vectors.number, vectors.status)], cycle.AT),
            inputs=np.array([vectors.boundary_places[signal] for signal in self._signals]),
            published=np.array(vectors.published),
        )
        self._table = self._table_of(arrays)
        #: See `machine.InVectors`.
        self.piece = CompiledStage(
            cycle.run, cycle.BEGIN, arrays, continues=cycle.DONE, fallback=fallback, table=self._table
        )
        return self

    def give(self) -> int:
        """Write back to the objects; see `machine.InVectors`."""
        self._twin["by_object"], self._table = 1.0, self._table_of(self._own)
        return int(self._twin["status"][0])
