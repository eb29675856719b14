"""Twin of a web line: the simulated web, and for each span an estimator of E from the torques after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, sqrt

from hilbench.estimation.plausibility import STANDSTILL_M_S
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.config import (
    METHODS,
    ChangepointConfig,
    EstimationConfig,
    InputConfig,
    SynchronizerConfig,
)
from hilbench.estimation.web_line.initial_strains import initial_strains
from hilbench.estimation.web_line.rollers import Rollers, two_rollers
from hilbench.estimation.web_line.span_estimator import UNKNOWN_AT_REST, UNKNOWN_STRAIN, Known, SpanEstimator
from hilbench.estimation.web_line.span_estimator_cycle import LARGEST_STRAIN
from hilbench.estimation.web_line.unmodelled_effects import priors_behind
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.sample_coherence import SampleCoherence
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.signals import Shape
from hilbench.twin.estimated_errors import EstimatedModelError
from hilbench.twin.machines import web_line_cycle
from hilbench.twin.machines.machine import BoundaryInputs, MachineVectors, Measured, TwinMachine
from hilbench.twin.machines.web_line_cycle import LineCycle
from hilbench.twin.machines.web_line_errors import as_effects
from hilbench.twin.machines.web_other_spans import OtherSpans
from hilbench.twin.machines.web_splice_tracker import SpliceTracker

#: Largest step of a tension by a model switch from one cycle to the next, as a share of a usual one.
_LARGEST_STEP = 0.005
#: Share of a cycle, in time constants of the velocity loop, from which on the torque is corrected for its ripple: at
#: SYNC in a ramp it is below its mean by half of that share. Between two tests: at 0.13 (the demonstrator at 4 ms) the
#: correction costs E 1 % for a while where the period changes, at 0.73 a light web is broken without it.
_RIPPLES_FROM = 0.2


def twin(
    model: ModelParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> TwinMachine:
    """Twin of a line; modules of lines with stations are imported for these alone."""
    if model.stations is None:
        return WebLineTwin(model, config, cycle_s, boundary_inputs)
    from hilbench.twin.machines.web_line_with_stations import LineWithStationsTwin

    return LineWithStationsTwin(model, config, shape, cycle_s, boundary_inputs)


class WebLineTwin:
    """`TwinMachine` with N axes and the spans between them; E of each span is found from the torques after it.

    The web starts as the bench's load model does, strained like the web upstream. On moving axes this is a guess: the
    twin then is synchronized when strain and E are known, at the latest when all web of unknown strain has been
    transported out of the line.
    """

    compiled_cycle = staticmethod(web_line_cycle.run)

    def __init__(
        self, model: ModelParameters, config: EstimationConfig, cycle_s: float, boundary_inputs: BoundaryInputs
    ) -> None:
        axes, spans = range(1, model.axis_count + 1), range(1, model.span_count + 1)
        self.ports = tuple(MotorPort() for _ in axes)
        self._model = model
        self.plant = Line(model, self.ports)
        self._transfer = config.transfer
        self._known_at_rest = config.web_at_rest == "as_upstream"
        methods = config.by_span(model.span_count)
        self._rollers = Rollers(model)
        self._several = len(spans) > 1
        shape = Shape(model.axis_count, (), len(spans), tuple(methods))
        self._estimated: dict[int, SpanEstimator] = {}
        for span, method in methods.items():
            along = [other for other in spans if other != span and shape.shows(other) == span]
            method = _over_rollers(method, model.axis_count - span)
            of_span = config.of_span(method, priors_behind(config.priors, span, model))
            alone = two_rollers(model, span, self._rollers.arrays.masses_kg[span:].tolist())
            self._estimated[span] = SpanEstimator(alone, of_span, self.plant, cycle_s, span, along)
        self._all = tuple(self._estimated.values())
        first, joined = self._all[0].span, list[SpanEstimator]()
        for span in range(first, len(spans) + 1):
            if span not in self._estimated:
                break
            joined.append(self._estimated[span])
        looks = self._several if config.splices is None else config.splices
        self._joined = joined if looks else []
        others = [span for span in spans if span not in methods]
        self._others = OtherSpans(model, others, config.transfer.strain_limit) if others else None
        self._boundary_inputs = boundary_inputs
        self._metres_per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in axes]
        self._last_at: tuple[float, Sequence[float]] | None = None  # while a reset may be due
        self._must_come_back = False
        self._set_cycle(cycle_s)
        #: The last checkpoints, oldest first.
        self._kept: tuple[Sequence[Known], ...] = ([each.known() for each in self._all],)

    def _set_cycle(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._pairing = SampleCoherence(least_travel_m(self._model, cycle_s), cycle_s)
        self._splice_tracker = SpliceTracker(self._joined, cycle_s) if self._joined else None
        # The measurement is one torque a cycle, while the set points of a ramp go in steps: where drives have followed
        # them well before the next, as on the longer cycles of several spans, the mean is another one.
        ripples = self._several or self._model.velocity_loop_per_s(2) * cycle_s > _RIPPLES_FROM
        parts = self._pairing, self._rollers, self._splice_tracker, self._others
        self._cycle = LineCycle(self._all, self._model, self.plant, cycle_s, *parts, ripples=ripples)

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze adaptation of E; see `TwinMachine`."""
        for each in self._all:
            each.freeze_adaptation(frozen=frozen)

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; see `TwinMachine`."""
        self.plant.lock_to(cycle_s)
        self._set_cycle(cycle_s)
        for each, known in zip(self._all, self._kept[0], strict=True):
            each.put_pieces(())
            each.set_cycle_time(cycle_s, known)
        self._last_at, self._must_come_back = None, True  # undo the travel of wrong cycles

    def keep(self) -> None:
        """Take a checkpoint, for `set_cycle_time`."""
        self._kept = self._kept[-1], [each.known() for each in self._all]

    @property
    def problem(self) -> Problem | None:
        """Reason why the last measurement could not be used; of several spans the first problem."""
        return next((problem for problem in self.problems.values() if problem is not None), None)

    @property
    def problems(self) -> Mapping[int, Problem | None]:
        """Problem of each span."""
        return {each.span if self._several else 0: each.problem for each in self._all}

    @property
    def shift_span(self) -> int:
        """Span with the largest (or an undecided) torque shift; 0 with one span."""
        if not self._several:
            return 0
        found = max(self._all, key=lambda each: (abs(each.torque_shift_Nm), each.torque_undecided))
        return found.span

    @property
    def refused(self) -> bool:
        """True if a measured state was implausible in the last cycle and was not transferred."""
        refused = any(each.refused for each in self._all)
        return refused or (self._others is not None and self._others.refused)

    @property
    def synchronized(self) -> bool:
        """True if E of each span is known as configured, and the web is the one that was measured."""
        return all(each.synchronized for each in self._all)

    @property
    def separable(self) -> bool:
        """True if the data separate all nuisance parameters from E."""
        return all(each.separable for each in self._all)

    @property
    def torque_shift_Nm(self) -> float:
        """Compensated shift of the measured torque; of several spans the largest."""
        return max([each.torque_shift_Nm for each in self._all], key=abs)

    @property
    def torque_undecided(self) -> bool:
        """True if the torque has changed and the cause, E or a torque shift, is still undecided."""
        return any(each.torque_undecided for each in self._all)

    def reset(self) -> None:
        """Reset to the initially assumed E, at rest."""
        for each in self._all:
            each.reset()
        self._cycle.spans["residual_Nm"] = 0.0
        self._start_anew()
        at_rest = [0.0] * len(self.ports)
        self.plant.set_state(_states(self._boundary_inputs("strain_prev"), at_rest, at_rest, at_rest))

    def _start_anew(self) -> None:
        """Forget the past measurements."""
        self._rollers.reset()
        if self._splice_tracker is not None:
            self._splice_tracker.reset()
        if self._others is not None:
            self._others.reset()
        self._last_at, self._must_come_back = None, False

    def release(self, before: Sequence[Measured], now: Sequence[Measured], *, in_motion: bool = False) -> bool:
        """Release the web, with the axes' motion and torque."""
        last, positions = self._positions_m(before), self._positions_m(now)
        self._pairing.reset()
        if not (self._pairing.update(*last) and self._pairing.update(*positions)):
            return False
        speeds = [(x - then) / self._cycle_s for x, then in zip(positions, last, strict=True)]
        moves = max(map(abs, speeds)) > STANDSTILL_M_S
        at_rest = [0.0] * len(self.ports)
        torques = [torque for _, torque in now]
        self.plant.set_state(
            _states(
                self._boundary_inputs("strain_prev"),
                positions,
                speeds if moves else at_rest,
                torques if moves else at_rest,
            )
        )
        known_at_rest = self._known_at_rest and not in_motion
        unknown = UNKNOWN_STRAIN if moves else 0.0 if known_at_rest else UNKNOWN_AT_REST
        webs = initial_strains(self._model)
        for each in self._all:
            each.release(unknown, webs)
        self._start_anew()
        self._kept = ([each.known() for each in self._all],)
        if self._others is not None:
            self._others.webs = webs
        self._pairing.forget_speed()
        return True

    def compare(self, time_s: float, measured: Sequence[Measured]) -> bool:
        """Update the estimators; False if the positions are not coherent (of one instant)."""
        positions_rad, torques_Nm = zip(*measured, strict=True)
        simulated_Nm = [port.torque_Nm for port in self.ports]
        boundary = self._boundary_inputs("strain_prev"), self._boundary_inputs("F_next_N")
        positions_m = self._cycle.compare(positions_rad, torques_Nm, simulated_Nm, *boundary)
        if positions_m is None:
            return False
        if any(each.state["moved"] for each in self._all):
            self.plant.show()
        for each in self._all:
            rad_per_m = 1.0 / self._metres_per_rad[each.span]
            each.look_for_known_change(self.ports[each.span].setpoint / rad_per_m)
        others = self._others
        if others is not None and self._transfer.strain:
            others.transfer(self.plant)
        if self.refused or self._must_come_back:
            self._bring_back(time_s, positions_m, torques_Nm)
        else:
            self._last_at = None
        return True

    def _bring_back(self, time_s: float, positions_m: Sequence[float], torques_Nm: Sequence[float]) -> None:
        """Reset a diverged simulation to the measured state; spans with an impossible strain are strained as
        upstream."""
        last, self._last_at = self._last_at, (time_s, positions_m)
        others = self._others
        diverged = any(each.diverged for each in self._all) or (others is not None and others.diverged)
        if last is None or not (diverged or self._must_come_back):
            return
        self._must_come_back = False
        speeds = [(x - then) / (time_s - last[0]) for x, then in zip(positions_m, last[1], strict=True)]
        states = _states(self._boundary_inputs("strain_prev"), positions_m, speeds, torques_Nm)
        strains = {each.span: each.strain for each in self._all}
        if others is not None:
            strains |= {span: others.strain(span) for span in others.spans}
        believed = {span: strain for span, strain in strains.items() if abs(strain) <= LARGEST_STRAIN}
        self.plant.set_state(states | {f"strain{span}": strain for span, strain in believed.items()})

    def _positions_m(self, measured: Sequence[Measured]) -> list[float]:
        """Positions of all axes at the web."""
        return [
            position_rad * metres_per_rad
            for (position_rad, _), metres_per_rad in zip(measured, self._metres_per_rad, strict=True)
        ]

    def miss(self) -> None:
        """Skip a cycle without measurement: the next one is a cycle further."""
        self._pairing.miss()
        for each in self._all:
            each.miss()

    def listen(self) -> None:
        """Read the boundary inputs of the web."""
        first = self._all[0]
        self.plant.set_boundary(
            first.upstream_strain(self._boundary_inputs("strain_prev")), self._boundary_inputs("F_next_N")
        )

    def found(self) -> Sequence[EstimatedModelError]:
        """Estimated errors of the model, of all spans."""
        return [found for each in self._all for found in as_effects(each.errors, self._model, each.span)]

    @property
    def runs_in_vectors(self) -> bool:
        """True if `in_vectors` covers all of a cycle: E of every span is estimated, and the model has no
        effects on E."""
        if self._others is not None or self.plant.changes_elasticity or self._must_come_back:
            return False
        # While it refuses measured states, the simulation may have to be reset.
        return all(each.probing_step is None and not each.refused for each in self._all)

    def in_vectors(self, vectors: MachineVectors, fallback: Callable[[int], bool]) -> LineCycle:
        """Runner in vectors; see `VectorMachine`."""
        self._cycle.begin(vectors, fallback)
        return self._cycle

    def use_method(self, number: int) -> None:
        """Switch to another synchronizer, by its number in the vocabulary, from the present E."""
        methods = list(METHODS.values())
        if number > len(methods):
            raise ValueError(f"method {number}, expected 0 to {len(methods)}")
        method = methods[number - 1]() if number else None
        if isinstance(method, InputConfig) and self._several:
            raise ValueError(f"method {number}, expected one that corrects E: the line has several spans")
        for each in self._all:
            each.use(method and _over_rollers(method, len(self.ports) - each.span))

    def published(self) -> tuple[float, ...]:
        """Tension of each span; where E is estimated also E, its deviation, and simulated torque and residual of the
        axis after it."""
        line, values = self.plant, list[float]()
        for span, tension_N in enumerate(line.shown_tensions_N, 1):
            values.append(tension_N)
            each = self._estimated.get(span)
            if each is not None:
                residual_Nm = float(self._cycle.spans["residual_Nm"][self._all.index(each)])
                modulus_Pa, deviation_Pa = each.modulus_and_deviation_Pa
                # The effective E is stated, as of a measured web.
                factor = line.elasticity_factor(span) * float(each.state["series_factor"])
                values += (factor * modulus_Pa, factor * deviation_Pa, self.ports[span].torque_Nm, residual_Nm)
        return tuple(values)

    @property
    def largest_steps(self) -> Sequence[float]:
        """Largest step of each output by a model switch; limited for tensions."""
        around = self._model.boundary
        step_N = _LARGEST_STEP * max(around.upstream_tension_N, around.downstream_tension_N)
        steps = list[float]()
        for span in range(1, self._model.span_count + 1):
            steps += (step_N, *([inf] * 4 if span in self._estimated else []))
        return steps


def _over_rollers(method: SynchronizerConfig, rollers: int) -> SynchronizerConfig:
    """Method settings for the summed torques of so many rollers: their noise adds up, and the same caution as with one
    would slow it accordingly."""
    if rollers == 1 or not isinstance(method, ChangepointConfig):
        return method
    return method.model_copy(update={"cautious_pct": sqrt(rollers) * method.cautious_pct})


def _states(strain: float, x_m: Sequence[float], v_m_s: Sequence[float], tau_Nm: Sequence[float]) -> dict[str, float]:
    """States of the line by name: one strain for every span; position, speed and torque of each axis (N,)."""
    states = {f"strain{span}": strain for span in range(1, len(x_m))}
    for k, (x, v, tau) in enumerate(zip(x_m, v_m_s, tau_Nm, strict=True), 1):
        states |= {f"x{k}_m": x, f"v{k}_m_s": v, f"tau{k}_Nm": tau}
    return states
