"""Estimator of one span, cycle by cycle: momentum balance, estimate of E, transfer of measured states.

Used by the twin on the bus and for recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from math import hypot, inf, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import interpreted, table_of
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.plausibility import Plausibility
from hilbench.estimation.problems import PROBLEMS, Problem
from hilbench.estimation.web_line import anomalies, block_means, delay, torque_shift
from hilbench.estimation.web_line import span_estimator_cycle as cycle
from hilbench.estimation.web_line.balance import BalanceSample, MeasuredBalance
from hilbench.estimation.web_line.config import (
    ChangepointConfig,
    EstimationConfig,
    InputConfig,
    PidConfig,
    SynchronizerConfig,
)
from hilbench.estimation.web_line.initial_strains import SLOW_M_S, InitialStrains, initial_strains
from hilbench.estimation.web_line.joint_initialization import InitialWeb, JointInitialization
from hilbench.estimation.web_line.probing_step import new_probing_step
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, Synchronizer, SyncSample
from hilbench.estimation.web_line.synchronizers.changepoint import ChangepointSynchronizer
from hilbench.estimation.web_line.synchronizers.create import new_synchronizer
from hilbench.estimation.web_line.unmodelled_effects import UnmodelledEffects
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.plant.web_line.splices import Piece

#: Uncertainty (relative) of the upstream strain as a guess of the strain of a web that is first seen running, and at
#: rest, where it may be strained by anything.
UNKNOWN_STRAIN, UNKNOWN_AT_REST = 0.3, 1.0
#: Least prior deviation with which a method takes over the estimate of the previous one.
_LEAST_PRIOR_PCT = 0.1
#: Share of a torque shift up to which the remainder counts as zero.
_GONE = 0.1
#: Deviation (relative) of a creeping roller's dry friction from that at line speed.
_AT_SPEED = 0.1

#: Roller behind the span, of the model of two.
_AXIS = 2
_NOTHING_MEASURED = (nan,) * 9
_undecided, _is_synchronized = interpreted(torque_shift.undecided), interpreted(cycle.is_synchronized)


class Known(NamedTuple):
    """Checkpoint of a span's estimate: E, torque shift and unmodelled effects."""

    youngs_modulus_Pa: float
    torque_shift_Nm: float
    errors: UnmodelledEffects | None


class SpanEstimator:
    """Estimates E of a span (from 1) of `line` from the measured momentum balance; transfers measured states to it.

    `model`: of the roller before the span and all after it as one, as a line of two rollers; `along`: spans whose E
    follows that of this one, in the ratio of the line's model. Positions are at the web, torques at the motor.
    """

    def __init__(
        self,
        model: ModelParameters,
        config: EstimationConfig,
        line: Line,
        cycle_s: float,
        span: int = 1,
        along: Sequence[int] = (),
    ) -> None:
        self.config = config
        self._line, self.span = line, span
        spans, modulus_Pa = [span, *along], line.parameters.youngs_modulus_Pa
        #: As of `SpanEstimatorArrays`.
        self._moduli = np.array(
            [line.moduli[[k - 1 for k in spans]], [modulus_Pa(k) / modulus_Pa(span) for k in spans]]
        )
        self._cycle_s = cycle_s
        self._balance = balance = MeasuredBalance(model)
        #: Length between the rollers, and mass at the web of those after the span.
        self.length_m, self.mass_kg = balance.span_length_m, balance.mass_kg
        self._initial_Pa = config.youngs_modulus_Pa or model.youngs_modulus_Pa(1)
        self._torque_limit_Nm = per_item(model.drives.torque_limit_Nm, 2) if model.drives else inf
        self._strain_prev = model.upstream_strain
        self._model_delay_s = next(
            (e.parameters.get("delay_s", 0.0) for e in model.effects if (e.effect, e.axis) == ("torque_delay", 2)), 0.0
        )
        self._anomalies = anomalies.new_state(
            model.youngs_modulus_Pa(1), machine_sizes(model, 2).force_N, model.span_length_m(1)
        )
        self._blocks = block_means.new_state(balance.mass_kg, cycle_s)
        self._shift = torque_shift.new_state()
        self._delay_line = delay.new_line(cycle_s)
        #: None: all state is in the arrays.
        self.probing_step = new_probing_step(model, config, balance.mass_kg, cycle_s)
        self._model = model
        self._of_span = self._new_state()
        self.state = self._t = self._of_span[0]  #: a `span_estimator_cycle.SPAN`
        self._errors: UnmodelledEffects | None = None
        self._synchronizer: Synchronizer
        self._nuisances: tuple[Nuisance, ...] | None = ()  # None: those that the bank has found
        self._input_strain: float | None = None
        # Without a bank, or without unmodelled effects, spare vectors fill the table.
        spare_bank = ChangepointSynchronizer(ChangepointConfig(), Plant.of(balance, self._initial_Pa))
        self._spare_errors, self._spare_bank = self._new_errors(), spare_bank
        self.reset()

    def _new_state(self) -> NDArray[np.void]:
        state, config, balance = np.zeros(1, cycle.SPAN), self.config, self._balance
        t = state[0]
        t["cycle_s"], t["force_per_torque"] = self._cycle_s, balance.force_per_torque_per_m
        t["section_m2"], t["span_m"], t["span"] = balance.section_m2, balance.span_length_m, self.span - 1
        t["compensates"] = config.torque_shift != "ignore"
        t["finds_delay"] = config.torque_delay == "estimate"
        t["delayed"] = config.torque_delay == "estimate" or self._model_delay_s != 0.0
        transfer = config.transfer
        t["transfers_strain"], t["transfers_axes"] = transfer.strain, transfer.axes
        t["strain_limit"], t["position_limit_m"] = transfer.strain_limit, transfer.position_limit_m
        t["velocity_limit_m_s"] = transfer.velocity_limit_m_s
        return state

    def _new_errors(self) -> UnmodelledEffects:
        config, balance = self.config, self._balance
        priors = [prior for prior in config.priors if prior.axis == _AXIS]
        return UnmodelledEffects(config.model_errors, self._model, balance, self._initial_Pa, self._cycle_s, priors)

    def _gather(self) -> None:
        """Collect the current state arrays and the table of their addresses."""
        errors, bank = self._errors or self._spare_errors, self._spare_bank
        if isinstance(self._synchronizer, ChangepointSynchronizer):
            bank = self._synchronizer
        self._t["has_errors"] = self._errors is not None
        self._arrays = cycle.SpanEstimatorArrays(
            self._of_span,
            self._plausibility.state,
            self._anomalies,
            self._shift,
            self._delay_line,
            self._delay_finder,
            self._moduli,
            self._balance.vectors,
            errors.state,
            bank.arrays,
            self._line.vectors,
            self._blocks,
        )
        #: Addresses of the state arrays for `span_estimator_cycle.run_arrays`; replaced whenever the arrays are.
        self.table: NDArray[np.int64] = table_of(self._arrays)

    @property
    def input_strain(self) -> float:
        """Upstream-strain correction of the unknown-input observer; 0 for methods that estimate E."""
        return self._input_strain or 0.0

    def has_advanced(self) -> None:
        """Update cached values after cycles run entirely by compiled callers."""
        if self._t["bank"]:
            self._nuisances = None

    def reset(self) -> None:
        """Reset the estimate, with E as assumed at the start."""
        t = self._t
        self._line.vectors.p[self._moduli[0].astype(int)] = self._moduli[1] * self._initial_Pa
        if self.config.unmodelled_torque_Nm is None:
            self._errors = self._new_errors()
        self._look_anew()
        t["modulus_Pa"], t["web_per_Pa"] = self._initial_Pa, self._balance.section_m2 * self._strain_prev
        self._begin(self.config.synchronizer, self._initial_Pa)
        t["delay_s"] = self._model_delay_s
        t["residual_Nm"] = t["used"] = t["spliced"] = t["other_web"] = t["problem"] = 0.0
        t["series_factor"] = t["end_factor"] = 1.0
        t["shift_Nm"] = 0.0
        self._state(Estimate(self._initial_Pa, inf))
        self.release()

    def _look_anew(self) -> None:
        """Reset plausibility check and delay finder."""
        self._plausibility = Plausibility(
            self._torque_limit_Nm,
            self._balance.dry_friction_N,
            self._balance.section_m2 * self._strain_prev,
            self._cycle_s,
        )
        self._delay_finder = delay.new_finder(self._cycle_s)

    def freeze_adaptation(self, *, frozen: bool) -> None:
        """Freeze adaptation of E and the plant errors while the cycle time is uncertain; strain tracking goes on."""
        self._t["frozen"] = frozen

    def set_cycle_time(self, cycle_s: float, known: Known) -> None:
        """Set the cycle time. The estimate is restored from `known`; the strain stays as measured."""
        self._cycle_s = self._t["cycle_s"] = cycle_s
        self._blocks = block_means.new_state(self._balance.mass_kg, cycle_s)
        self._delay_line = delay.new_line(cycle_s)
        self.probing_step = new_probing_step(self._model, self.config, self._balance.mass_kg, cycle_s)
        self._look_anew()
        self._go_back(known)
        if self._errors is not None:
            self._errors.set_cycle_time(cycle_s)
        self.use(self._method)
        self._forget(cycle.SUSPEND)
        if self._search is not None:  # The search's samples were of another cycle time.
            self._find_web()

    def release(self, strain_uncertainty: float = 0.0, webs: InitialStrains | None = None) -> None:
        """Reset the web: strained as upstream but for an unknown share (relative). `webs`: initial strains of the line,
        where it has several spans."""
        t = self._t
        self._balance.reset()
        self._forget(cycle.NEW_WEB)
        t["missed_s"] = t["measured"] = t["runs"] = t["refused"] = t["refused_m"] = t["creep_ratio"] = t["found"] = 0.0
        if self.probing_step is not None:
            self.probing_step.reset()
        if self._errors is not None:
            self._errors.release()
        t["strain_uncertainty"] = strain_uncertainty
        self._webs, self._place = webs or initial_strains(self._model), self.span - 1 if webs else 0
        self._unknown_share = strain_uncertainty
        self._search: JointInitialization | None = None
        if strain_uncertainty > 0.0 and not isinstance(self._method, PidConfig | InputConfig):
            self._find_web()

    def _find_web(self) -> None:
        """Start the joint initialization of E and strain."""
        plant = Plant.of(self._balance, self.estimate.youngs_modulus_Pa)
        friction_share = 0.01 * self.config.model_errors.friction_pct
        self._search = JointInitialization(plant, self._webs, self._place, self._strain_prev, friction_share)
        self._state_looked_for()
        self._t["bank"] = 0.0  # until the method starts from the result

    def _forget(self, what: int) -> None:
        cycle.run_arrays(what, _NOTHING_MEASURED, self.table)

    def use(self, synchronizer: SynchronizerConfig | None) -> None:
        """Switch to another method (None: the configured one) from the present E, bumpless."""
        config, known = synchronizer or self.config.synchronizer, self.estimate
        if not isinstance(config, PidConfig):
            share_pct = 100.0 * float(self._t["own_deviation_Pa"]) / known.youngs_modulus_Pa
            known_pct = min(max(share_pct, _LEAST_PRIOR_PCT), config.initial_deviation_pct)
            config = config.model_copy(update={"initial_deviation_pct": known_pct})
        # A black box goes on with the model's own E.
        black_box = isinstance(config, InputConfig)
        model_Pa = self._line.vectors.p.item(int(self._moduli[0, 0]))
        self._begin(config, model_Pa if black_box else known.youngs_modulus_Pa)

    def _begin(self, config: SynchronizerConfig, youngs_modulus_Pa: float) -> None:
        self._nuisances = self.estimate.nuisances
        self._method = config
        self._synchronizer = new_synchronizer(config, Plant.of(self._balance, youngs_modulus_Pa))
        self._t["bank"] = 0.0  # until it has started
        self._gather()
        looks_for_it = not isinstance(config, PidConfig | InputConfig) and config.also.torque_offset_Nm > 0.0
        if self.config.unmodelled_torque_Nm is not None:
            unmodelled_Nm = 0.0 if looks_for_it else self.config.unmodelled_torque_Nm
            self._t["unmodelled_N"] = unmodelled_Nm * self._balance.force_per_torque_per_m

    def _state(self, estimate: Estimate) -> None:
        """Publish the method's estimate, with its nuisance parameters."""
        self._nuisances, self._input_strain = estimate.nuisances, estimate.upstream_strain
        self._t["black_box"] = estimate.upstream_strain is not None
        stated = estimate.youngs_modulus_Pa, estimate.deviation_Pa
        cycle.run_arrays(cycle.STATE, (*map(float, stated), *_NOTHING_MEASURED[2:]), self.table)

    @property
    def estimate(self) -> Estimate:
        """Stated E with its deviation and nuisance parameters."""
        modulus_Pa, deviation_Pa = self.modulus_and_deviation_Pa
        nuisances = self._nuisances
        if nuisances is None:
            assert isinstance(self._synchronizer, ChangepointSynchronizer), "None is said of the bank alone"
            nuisances = self._synchronizer.nuisances
        return Estimate(modulus_Pa, deviation_Pa, nuisances, self._input_strain)

    @property
    def modulus_and_deviation_Pa(self) -> tuple[float, float]:
        """Stated E and its deviation."""
        t = self._t
        return float(t["modulus_Pa"]), float(t["deviation_Pa"])

    @property
    def separable(self) -> bool:
        """True if all nuisance parameters are separable from E by the data."""
        if self._nuisances is None and isinstance(self._synchronizer, ChangepointSynchronizer):
            return self._synchronizer.separable
        return all(nuisance.separable for nuisance in self.estimate.nuisances)

    @property
    def torque_shift_Nm(self) -> float:
        """Shift of the measured torque that has been found and is compensated."""
        return float(self._t["shift_Nm"])

    @property
    def problem(self) -> Problem | None:
        """Reason why the last measurement could not be used, if any."""
        return PROBLEMS[int(self._t["problem"])]

    @property
    def refused(self) -> bool:
        """True if a measured state was implausible in the last cycle and was not transferred, or there is none."""
        return bool(self._t["refused"] != 0.0 or self._t["missed_s"] > cycle.DIVERGED_S)

    @property
    def diverged(self) -> bool:
        """True if the simulation has diverged: measured states refused for longer than `DIVERGED_S`, and until all web
        that was in the span has left it."""
        t = self._t
        lasts = t["refused"] * self._cycle_s > cycle.DIVERGED_S
        return bool(lasts and t["refused_m"] > anomalies.PASSED_SPANS * self._balance.span_length_m)

    @property
    def used(self) -> BalanceSample | None:
        """Balance sample that E was estimated from in the last cycle, uncorrected for unmodelled effects."""
        return self._balance_used if self._t["used"] else None

    @property
    def _balance_used(self) -> BalanceSample:
        return BalanceSample(*[float(self._t[f"used_{name}"]) for name in ("m", "N", "per_Pa", "m_s")])

    @property
    def strain(self) -> float:
        """Strain of the web in the span, by the encoders."""
        return self._balance.web.strain.item(0)

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Set the pieces of other web in the span, by the travel of the roller before it."""
        t, web = self._t, self._balance.web
        web.put_pieces(pieces)
        t["spliced"] = bool(pieces)
        t["series_factor"], t["end_factor"] = web.spliced_spans[0]

    @property
    def synchronized(self) -> bool:
        """True if E is known to `synchronized_pct`, the measured web is in the span, and its strain in the
        simulation."""
        return _is_synchronized(self._of_span.view(np.recarray)[0], self.config.synchronized_pct)

    def become(self, relative_change: float) -> None:
        """Scale E by 1 + `relative_change`: a splice has passed, and all of the span is its web now."""
        self._t["modulus_Pa"] *= 1.0 + relative_change
        self.use(self._method)
        if self._errors is not None:
            self._errors.release()

    @property
    def errors(self) -> tuple[Nuisance, ...]:
        """Estimated model errors; empty where none are looked for."""
        return () if self._errors is None else self._errors.found()

    def known(self) -> Known:
        """Checkpoint of the present estimate, for `believe` and `set_cycle_time`."""
        return Known(self.estimate.youngs_modulus_Pa, self.torque_shift_Nm, deepcopy(self._errors))

    def believe(self, known: Known, strain: float) -> None:
        """Restore `known` with another measured strain: what was observed since was no change of E in the span."""
        self._balance.web.set_state({"strain1": strain})
        self._go_back(known)
        self.use(self._method)
        self._forget(cycle.SUSPEND)

    def _go_back(self, known: Known) -> None:
        self._errors = deepcopy(known.errors)
        self._t["shift_Nm"], self._t["modulus_Pa"] = known.torque_shift_Nm, known.youngs_modulus_Pa

    @property
    def torque_undecided(self) -> bool:
        """True if the torque has changed and the cause, E or a torque shift, is still undecided."""
        return _undecided(self._shift.view(np.recarray)[0])

    def miss(self) -> None:
        """Skip a cycle without measurement."""
        self._t["missed_s"] += self._cycle_s
        self._forget(cycle.INTERRUPT)
        self.skip()

    def skip(self) -> None:
        """Hold the estimate for a cycle."""
        if self._errors is not None:
            self._errors.hold(self._cycle_s)
        self._state(self._synchronizer.hold(self._cycle_s))

    def place(self, x1_m: float, x2_m: float, strain_prev: float) -> None:
        """Place the web at the rollers if it is not yet followed, strained as upstream."""
        self._balance.begin(x1_m, x2_m, strain_prev)

    def compare(
        self, x1_m: float, x2_m: float, torque_Nm: float, torque_sim_Nm: float, strain_prev: float, F_next_N: float
    ) -> None:
        """Take the measurement of the instant that a line of two rollers has been simulated to; update the line."""
        self.place(x1_m, x2_m, strain_prev)
        values = x1_m, x2_m, torque_Nm, torque_sim_Nm, strain_prev, F_next_N, nan, nan, 0.0
        stage = cycle.run_arrays(cycle.COMPARE, tuple(map(float, values)), self.table)
        if stage == cycle.DONE:
            self.has_advanced()
        else:
            self.go_on_from(stage, strain_prev)
        if self._t["moved"]:
            self._line.show()

    def go_on_from(self, stage: int, strain_prev: float) -> None:
        """Run the interpreted rest of a cycle from `stage` on, where a compiled caller stopped."""
        t = self._t
        if stage == cycle.UPDATE:
            self._update(strain_prev)
        elif stage in (cycle.HOLD, cycle.FOUND_WEB):
            if stage == cycle.FOUND_WEB:
                self._look_at_found_web(strain_prev)
                t["used"] = 0.0
            self.skip()
            if self._search is not None:
                self._state_looked_for()
        elif t["bank"]:
            self._nuisances = None
        if stage != cycle.SHIFT:
            stage = cycle.run_arrays(cycle.LOOK_FOR_SHIFT, _NOTHING_MEASURED, self.table)
        if stage == cycle.SHIFT:
            self._take_out_shift()
            cycle.run_arrays(cycle.TRANSFER, _NOTHING_MEASURED, self.table)

    def _sample(self, strain_prev: float, force_N: float) -> SyncSample:
        """Sample of this cycle for a method, with this force in the balance."""
        t = self._t
        sensitivity = float(t["section_m2"]) * float(self._line.strain[self.span - 1]) / float(t["force_per_torque"])
        return SyncSample(
            self._cycle_s,
            float(t["torque_Nm"]),
            float(t["torque_sim_Nm"]),
            sensitivity,
            strain_prev,
            replace(self._balance_used, force_N=force_N),
        )

    def _update(self, strain_prev: float) -> None:
        """Update a method other than the bank, or one that starts, with this cycle."""
        if self._search is not None:  # the web of unknown strain has left the span
            found, self._search = self._search.found, None
            self._believe_found(found)
        self._webs.know(self._place)
        t, method = self._t, self._synchronizer
        if t["rebased_Pa"]:
            method.rebase(float(t["rebased_Pa"]))
        t["web_per_Pa"] = t["used_per_Pa"]
        self._state(method.update(self._sample(strain_prev, float(t["corrected_N"]))))
        t["bank"] = isinstance(method, ChangepointSynchronizer) and method.started and not method.has_nuisances

    def _state_looked_for(self) -> None:
        """State E as assumed, with the deviation of the search, until the web is known."""
        assert self._search is not None, "it is looked for"
        looked_for_Pa = self._search.deviation_Pa(float(self._t["modulus_Pa"]))
        self._state(replace(self.estimate, deviation_Pa=max(float(self._t["own_deviation_Pa"]), looked_for_Pa)))

    def _look_at_found_web(self, strain_prev: float) -> None:
        """Search E and strain of a web that was first seen running; the method starts once both, and the strain of the
        web that enters, are known."""
        t, search, webs = self._t, self._search, self._webs
        webs.move(self._place, self._balance.sample.velocity_m_s, self._cycle_s)
        enters = self._unknown_share * webs.entering(self._place)
        t["strain_uncertainty"] = max(float(t["strain_uncertainty"]), enters)
        if search is None:
            return
        sample = self._sample(strain_prev, float(t["used_N"])) if t["used"] else None
        strain = float(self._balance.web.strain[0])
        found = search.look(sample, self._cycle_s, strain)
        if found is None:
            return
        passes = search.passes
        self._balance.web.set_state({"strain1": strain + found.strain_error})
        t["strain_uncertainty"], t["found"] = 0.0, 1.0
        self._search = None
        self._believe_found(found)
        if not passes:  # a movement from rest has shown friction as well
            if self._errors is not None:
                friction_sd_N = hypot(found.friction_deviation_N, _AT_SPEED * found.friction_N)
                self._errors.know(found.youngs_modulus_Pa, found.deviation_Pa, found.friction_N, friction_sd_N)
            if found.sticks:
                self._plausibility.sticks(SLOW_M_S)
        webs.know(self._place)

    def _believe_found(self, found: InitialWeb | None) -> None:
        """Continue the method from the search's result, if there is one."""
        if found is None or found.youngs_modulus_Pa <= 0.0:
            return
        self._state(Estimate(found.youngs_modulus_Pa, found.deviation_Pa))
        self.use(self._method)

    def look_for_known_change(self, set_point_m_s: float) -> None:
        """Evaluate probing steps after `compare`: E from changes of the tension, at a steady set-point of axis 2 (m/s).

        The result is used, and the remaining torque taken as a shift, if it is more certain than the present estimate.
        """
        change, t = self.probing_step, self._t
        if change is None or not t["measured"]:
            return
        if self.problem is not None or t["strain_uncertainty"] != 0.0 or self._input_strain is not None:
            change.reset()
            return
        now, torque_Nm, estimate = self._balance.sample, float(t["torque_Nm"]), self.estimate
        # The torque as measured: its correction may change.
        ratio = self._balance.force_per_torque_per_m
        shift_N = self.torque_shift_Nm * ratio
        measured = replace(now, force_N=now.force_N + shift_N)
        known = change.update(measured, set_point_m_s, torque_Nm * ratio + shift_N, estimate.youngs_modulus_Pa)
        if known is None or not known.is_more_certain_than(estimate.youngs_modulus_Pa, estimate.deviation_Pa):
            return
        t["shift_Nm"], t["modulus_Pa"] = known.force_N / ratio, known.youngs_modulus_Pa
        # A probing step is conclusive: no other model errors are looked for from here on.
        self._errors = None
        self.use(self._method)
        # The web has not changed, only its estimate.
        self._forget(cycle.SUSPEND)
        t["unmodelled_N"] = known.deviation_Pa * now.web_per_Pa
        self._state(Estimate(known.youngs_modulus_Pa, float(self._t["own_deviation_Pa"])))
        change.believe(known.youngs_modulus_Pa)

    def upstream_strain(self, stated_strain: float) -> float:
        """Strain of the web that enters the simulation; `stated_strain` is the reported one of the real web."""
        return stated_strain + self.input_strain

    def _take_out_shift(self) -> None:
        """Compensate a torque shift from the next cycle on; E goes on from its value before the shift."""
        t, shift = self._t, self._shift[0]
        more_Nm = shift["found_N"] / self._balance.force_per_torque_per_m
        t["shift_Nm"] += more_Nm
        if abs(self.torque_shift_Nm) < _GONE * abs(more_Nm):
            t["shift_Nm"] = 0.0
        t["modulus_Pa"] = shift["found_Pa"]
        self.use(self._method)
