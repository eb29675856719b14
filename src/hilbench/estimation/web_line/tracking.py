"""One cycle of keeping the simulation in step with the measurement: compare, estimate, transfer.

The same for the twin on the bus and for a recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from math import exp, hypot, inf, isfinite
from typing import NamedTuple, Protocol

from hilbench.estimation.plausibility import Plausibility, Problem
from hilbench.estimation.web_line.anomalies import Anomalies
from hilbench.estimation.web_line.balance import BalanceSample, MeasuredBalance
from hilbench.estimation.web_line.config import EstimationConfig, InputConfig, PidConfig, SynchronizerConfig
from hilbench.estimation.web_line.delay import DelayFinder, DelayLine
from hilbench.estimation.web_line.found_running import FoundRunning
from hilbench.estimation.web_line.known_change import DriveLoop, KnownChange
from hilbench.estimation.web_line.model_errors import ModelErrors
from hilbench.estimation.web_line.synchronizers.base import Estimate, Synchronizer, SyncSample
from hilbench.estimation.web_line.synchronizers.create import new_synchronizer
from hilbench.estimation.web_line.synchronizers.plant import Plant
from hilbench.estimation.web_line.torque_shift import TorqueShiftFinder
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.splices import WHOLE, Piece

#: Above this speed of an axis the plant runs already when the twin joins.
MOVES_M_S = 1e-3
#: How far off the upstream strain may be as a guess of the strain of a web that is found under way.
UNKNOWN_STRAIN = 0.3
#: Relative uncertainty of the strain below which the web in the span counts as known.
_KNOWN_STRAIN = 0.003
#: Least deviation with which a method takes over the estimate of the one before.
_LEAST_PRIOR_PCT = 0.1
#: What is left of a shift of the torque that has gone again, as a share of it.
_GONE = 0.1
#: Deviations of E and of the strain, in %, with which a web that was found under way is known.
_FOUND_MODULUS_PCT, _FOUND_STRAIN_PCT = 0.3, 0.3
#: Deviation of E, in %, with which a known change of the tension tells it, and its share of what was stated before.
_KNOWN_PCT, _SAYS_MORE = 0.3, 0.9
#: Share of the tension by which more may become known to be none without a fresh look at what happens to the web.
_ALL_AT_ONCE = 0.002
#: Largest strain, either way, of a measured state that is taken over: no web has more.
_LARGEST_STRAIN = 0.5


class TrackedLine(Protocol):
    """The simulation of two rollers with a span between them: a `Line`, or two rollers of one that has more."""

    def parameter(self, name: str) -> float:
        """Present value of a parameter."""

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on."""

    def set_state(self, state: Mapping[str, float]) -> None:
        """Transfer states by name: strain1, x1_m, x2_m, v1_m_s, v2_m_s; the others stay."""

    @property
    def strain(self) -> Vector:
        """Strain of the span (1,)."""

    @property
    def x_m(self) -> Vector:
        """Positions at the web (2,)."""

    @property
    def v_m_s(self) -> Vector:
        """Speeds at the web (2,)."""


class SimulatedMotor(Protocol):
    """What shows a simulated torque: a `MotorPort`, or several motors as one."""

    @property
    def torque_Nm(self) -> float:
        """Motor side."""


class Known(NamedTuple):
    """What is known of a span at some time: E, what the torque has shifted by, and what else the model lacks."""

    youngs_modulus_Pa: float
    torque_shift_Nm: float
    errors: ModelErrors | None


class Tracking:
    """Moves E, and the transferred states, of `line` to where it agrees with what is measured.

    `axis2` is the port of the line's second motor. Positions are at the web, torques at the motor.
    """

    def __init__(
        self,
        model: ModelParameters,
        config: EstimationConfig,
        line: TrackedLine,
        axis2: SimulatedMotor,
        cycle_s: float,
    ) -> None:
        self.config = config
        self._line = line
        self._axis2 = axis2
        self._cycle_s = cycle_s
        self._balance = MeasuredBalance(model)
        self._initial_Pa = config.youngs_modulus_Pa or model.youngs_modulus_Pa(1)
        self._torque_limit_Nm = per_item(model.drives.torque_limit_Nm, 2) if model.drives else inf
        self._strain_prev = model.upstream_strain
        self._model_delay_s = next(
            (e.parameters.get("delay_s", 0.0) for e in model.effects if (e.effect, e.axis) == ("torque_delay", 2)), 0.0
        )
        self._anomalies = Anomalies(model.youngs_modulus_Pa(1), self._balance.mass_kg, model.span_length_m(1), cycle_s)
        self._shift_finder = TorqueShiftFinder(self._balance.mass_kg, cycle_s)
        self._known_change = _known_change(model, config, self._balance.mass_kg, cycle_s)
        self._model = model
        self._errors: ModelErrors | None = None
        self._synchronizer: Synchronizer
        self._unmodelled_N = 0.0
        self.reset()

    def reset(self) -> None:
        """Start anew, with E as assumed at the start."""
        self._line.set_parameter("youngs_modulus_Pa", self._initial_Pa)
        if self.config.unmodelled_torque_Nm is None:
            self._errors = ModelErrors(
                self.config.model_errors, self._model, self._balance, self._initial_Pa, self._cycle_s
            )
        self._begin(self.config.synchronizer, self._initial_Pa)
        self._web_per_Pa = self._balance.section_m2 * self._strain_prev
        self._plausibility = Plausibility(
            self._torque_limit_Nm,
            self._balance.dry_friction_N,
            self._balance.section_m2 * self._strain_prev,
            self._cycle_s,
        )
        self._finder = DelayFinder(self._cycle_s) if self.config.torque_delay == "estimate" else None
        self._delay_line = DelayLine(self._cycle_s)
        self.delay_s = self._model_delay_s
        self.estimate = self._stated(Estimate(self._initial_Pa, inf))
        self.residual_Nm = 0.0
        self.used: BalanceSample | None = None  #: what E was found from in this cycle, with what is no tension
        self._spliced = WHOLE
        self.other_web_suspected = False  #: E may be changing because other web comes in
        self.problem: Problem | None = None
        self.torque_shift_Nm = 0.0  #: what the measured torque has shifted by, and is corrected for
        self.refused = False  #: a measured state was not plausible in this cycle
        self.release()

    def release(self, strain_uncertainty: float = 0.0) -> None:
        """The web is released anew, strained as upstream but for an unknown share (relative)."""
        self._balance.reset()
        self._missed_s = 0.0  # since the last measurement
        self._delay_line.reset()
        self._anomalies.reset()
        self._shift_finder.reset()
        self._now: tuple[BalanceSample, float] | None = None  # and its torque, N·m
        if self._known_change is not None:
            self._known_change.reset()
        if self._errors is not None:
            self._errors.release()
        self._strain_uncertainty = strain_uncertainty
        self._found: FoundRunning | None = None
        if strain_uncertainty > 0.0 and not isinstance(self._method, PidConfig | InputConfig):
            plant = Plant.of(self._balance, self.estimate.youngs_modulus_Pa)
            self._found = FoundRunning(plant, self._strain_prev)
        self._running = False

    def use(self, synchronizer: SynchronizerConfig | None) -> None:
        """Go on with another method (None: the configured one) from the present E, without a jump."""
        config, known = synchronizer or self.config.synchronizer, self.estimate
        if not isinstance(config, PidConfig):
            share_pct = 100.0 * self._own_deviation_Pa / known.youngs_modulus_Pa
            known_pct = min(max(share_pct, _LEAST_PRIOR_PCT), config.initial_deviation_pct)
            config = config.model_copy(update={"initial_deviation_pct": known_pct})
        # A black box goes on as the model that it is.
        black_box = isinstance(config, InputConfig)
        model_Pa = self._line.parameter("youngs_modulus_Pa")
        self._begin(config, model_Pa if black_box else known.youngs_modulus_Pa)

    def _begin(self, config: SynchronizerConfig, youngs_modulus_Pa: float) -> None:
        self._method = config
        self._synchronizer = new_synchronizer(config, Plant.of(self._balance, youngs_modulus_Pa))
        looks_for_it = not isinstance(config, PidConfig | InputConfig) and config.also.torque_offset_Nm > 0.0
        if self.config.unmodelled_torque_Nm is not None:
            unmodelled_Nm = 0.0 if looks_for_it else self.config.unmodelled_torque_Nm
            self._unmodelled_N = unmodelled_Nm * self._balance.force_per_torque_per_m

    def _stated(self, estimate: Estimate) -> Estimate:
        """With what the data can't tell from E: no method sees it in its data."""
        modulus_Pa, self._own_deviation_Pa = estimate.youngs_modulus_Pa, estimate.deviation_Pa
        if not 0.0 < modulus_Pa < inf:  # torque of somebody else's web, say: no material has such an E
            modulus_Pa, self._own_deviation_Pa = self.estimate.youngs_modulus_Pa, inf
        deviation_Pa = hypot(self._own_deviation_Pa, self._unmodelled_Pa())
        return Estimate(modulus_Pa, deviation_Pa, estimate.nuisances, estimate.upstream_strain)

    def _unmodelled_Pa(self) -> float:
        """What the model may lack, as E; a web without strain says nothing of E."""
        force_N = self._unmodelled_N if self._errors is None else self._errors.deviation_N
        if not force_N:
            return 0.0
        return force_N / self._web_per_Pa if self._web_per_Pa else inf

    @property
    def synchronized(self) -> bool:
        """Whether E is known as well as the config asks for, and the web in the span is the one that was measured."""
        limit = 0.01 * self.config.synchronized_pct * self.estimate.youngs_modulus_Pa
        return self.problem is None and self._strain_uncertainty == 0.0 and self._own_deviation_Pa <= limit

    @property
    def web_is_known(self) -> bool:
        """Whether the web in the span is the one that was measured, none that was found under way."""
        return self._strain_uncertainty == 0.0

    @property
    def measured_strain(self) -> float:
        """Of the web in the span, as the encoders show it."""
        return float(self._balance.web.strain[0])

    @property
    def series_factor(self) -> float:
        """What pieces of other web make of E of the span, as springs in series."""
        return self._spliced.factor

    @property
    def leaving_strain(self) -> float:
        """Of the web that leaves the span, as measured: all of it pulls alike, and each piece has its strain."""
        return self.measured_strain * self._spliced.factor / self._spliced.at_end

    @property
    def unstretched_m(self) -> float:
        """Web in the span."""
        return self._balance.span_length_m / (1.0 + self.measured_strain)

    @property
    def span_length_m(self) -> float:
        """Of the span."""
        return self._balance.span_length_m

    @property
    def mass_kg(self) -> float:
        """At the web, of what is behind the span."""
        return self._balance.mass_kg

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Let these be the pieces of other web in the span, by the way of the roller before it."""
        self._balance.web.put_pieces(pieces)
        self._spliced = self._balance.web.spliced_spans[0]

    def become(self, relative_change: float) -> None:
        """The web in the span is all of what a piece of it was: what is known of E is known of that."""
        known_Pa = (1.0 + relative_change) * self.estimate.youngs_modulus_Pa
        self.estimate = replace(self.estimate, youngs_modulus_Pa=known_Pa)
        self.use(self._method)
        if self._errors is not None:
            self._errors.release()

    def known(self) -> Known:
        """What is known now, to come back to."""
        return Known(self.estimate.youngs_modulus_Pa, self.torque_shift_Nm, deepcopy(self._errors))

    def believe(self, known: Known, strain: float) -> None:
        """What has come to light since then was no change of E of the web that is in the span, but another strain."""
        self._balance.web.set_state({"strain1": strain})
        self.torque_shift_Nm, self._errors = known.torque_shift_Nm, deepcopy(known.errors)
        self.estimate = replace(self.estimate, youngs_modulus_Pa=known.youngs_modulus_Pa)
        self.use(self._method)
        self._anomalies.suspend()
        self._shift_finder.reset()

    @property
    def torque_undecided(self) -> bool:
        """Whether the torque has changed, and nothing tells yet whether that was E or a shift."""
        return self._shift_finder.undecided

    def miss(self) -> None:
        """A cycle without measurement."""
        self._missed_s += self._cycle_s
        self._anomalies.interrupt()
        self._shift_finder.interrupt()
        self.skip()

    def skip(self) -> None:
        """Hold the estimate for a cycle."""
        if self._errors is not None:
            self._errors.hold(self._cycle_s)
        self.estimate = self._stated(self._synchronizer.hold(self._cycle_s))

    def compare(
        self,
        time_s: float,
        x1_m: float,
        x2_m: float,
        torque_Nm: float,
        strain_prev: float,
        F_next_N: float,
        centre_m: float | None = None,
    ) -> None:
        """Take what was measured at the instant that the line has been simulated to; updates the line.

        `centre_m`: of the centre of mass, where roller 2 stands for several.
        """
        line, balance = self._line, self._balance
        torque_Nm -= self.torque_shift_Nm
        balance.use_modulus(self.estimate.youngs_modulus_Pa)
        raw = balance.update(x1_m, x2_m, torque_Nm, strain_prev, F_next_N, self._cycle_s + self._missed_s)
        if centre_m is not None:
            raw.x2_m = centre_m
        self._missed_s = 0.0
        self._now, self.used = (raw, torque_Nm), None
        self._spliced = balance.web.spliced_spans[0]
        now = self._without_errors(raw)
        torque_sim_Nm = self._axis2.torque_Nm
        self.residual_Nm = torque_Nm - torque_sim_Nm
        self.problem = self._plausibility.problem(torque_Nm, now.web_per_Pa, now.velocity_m_s)
        if self.problem is None:
            self.problem = self._anomaly(now)
        else:
            self._anomalies.suspend()
        moved = self._find_delay(torque_Nm, torque_sim_Nm)
        paired = None
        if not isfinite(raw.force_N):
            self._delay_line.reset()
        else:
            paired = self._delay_line.pair(raw, torque_Nm * balance.force_per_torque_per_m, self.delay_s)
        if self._strain_uncertainty > 0.0:
            self._transport_out(now.velocity_m_s)
        if self._strain_uncertainty > 0.0:
            usable = paired if self.problem is None and not moved else None
            self._look_at_found_web(time_s, torque_Nm, torque_sim_Nm, strain_prev, usable, now.velocity_m_s)
            self.skip()
        elif self.problem is not None or paired is None or moved:
            self.skip()
        else:
            self.used = paired
            self._look_for_errors(paired, torque_Nm, x1_m, F_next_N)
            paired = self._without_errors(paired)
            strain = float(line.strain[0])
            sensitivity = balance.section_m2 * strain / balance.force_per_torque_per_m
            sample = SyncSample(time_s, self._cycle_s, torque_Nm, torque_sim_Nm, sensitivity, strain_prev, paired)
            self._web_per_Pa = paired.web_per_Pa
            self.estimate = self._stated(self._synchronizer.update(sample))
        self._look_for_shift(now)
        black_box = self.estimate.upstream_strain is not None
        if not black_box:
            line.set_parameter("youngs_modulus_Pa", self._spliced.factor * self.estimate.youngs_modulus_Pa)
        if self._running:
            transfer = self.config.transfer
            self._transfer(x1_m, x2_m, strain=transfer.strain and not black_box, axes=transfer.axes or black_box)
        self._running = True

    def _look_at_found_web(
        self,
        time_s: float,
        torque_Nm: float,
        torque_sim_Nm: float,
        strain_prev: float,
        paired: BalanceSample | None,
        velocity_m_s: float,
    ) -> None:
        """The web was found under way: the method begins as soon as its E and strain are known."""
        if self._found is None:
            return
        if paired is None:
            self._found.skip(velocity_m_s, self._cycle_s)
            return
        sample = SyncSample(time_s, self._cycle_s, torque_Nm, torque_sim_Nm, 0.0, strain_prev, paired)
        found = self._found.update(sample)
        if found is None:
            return
        strain = float(self._balance.web.strain[0]) + found.strain_error
        known = found.deviation_Pa <= 0.01 * _FOUND_MODULUS_PCT * found.youngs_modulus_Pa
        if not known or found.strain_deviation > 0.01 * _FOUND_STRAIN_PCT * strain:
            return
        self._balance.web.set_state({"strain1": strain})
        self._strain_uncertainty, self._found = 0.0, None
        self.estimate = self._stated(Estimate(found.youngs_modulus_Pa, found.deviation_Pa))
        self.use(self._method)

    def look_for_known_change(self, set_point_m_s: float) -> None:
        """After `compare`: what the last changes of the tension tell of E, at a steady set-point of axis 2 (m/s).

        It is believed, and what else the torque shows taken out of it, when it says more than what is known.
        """
        change = self._known_change
        if change is None or self._now is None:
            return
        if self.problem is not None or self._strain_uncertainty > 0.0 or self.estimate.upstream_strain is not None:
            change.reset()
            return
        now, torque_Nm = self._now
        # The torque as it is measured: what it is corrected for may become another.
        ratio = self._balance.force_per_torque_per_m
        shift_N = self.torque_shift_Nm * ratio
        measured = replace(now, force_N=now.force_N + shift_N)
        known = change.update(measured, set_point_m_s, torque_Nm * ratio + shift_N, self.estimate.youngs_modulus_Pa)
        limit_Pa = min(0.01 * _KNOWN_PCT * self.estimate.youngs_modulus_Pa, _SAYS_MORE * self.estimate.deviation_Pa)
        if known is None or not 0.0 < known.deviation_Pa <= limit_Pa or known.youngs_modulus_Pa <= 0.0:
            return
        self.torque_shift_Nm = known.force_N / ratio
        self.estimate = replace(self.estimate, youngs_modulus_Pa=known.youngs_modulus_Pa)
        self.use(self._method)
        # It is not the web that has changed, but what is known of it.
        self._anomalies.suspend()
        self._shift_finder.reset()
        # An experiment tells it once and for all: nothing else is looked for from here on.
        self._errors = None
        self._unmodelled_N = known.deviation_Pa * now.web_per_Pa
        self.estimate = self._stated(Estimate(known.youngs_modulus_Pa, self._own_deviation_Pa))
        change.believe(known.youngs_modulus_Pa)

    def upstream_strain(self, told: float) -> float:
        """The strain of the web that enters the simulation; `told` is what the real web's is said to be."""
        return told + (self.estimate.upstream_strain or 0.0)

    def _anomaly(self, now: BalanceSample) -> Problem | None:
        """Only of a web that is known: one that is found under way says nothing yet."""
        if self._strain_uncertainty > 0.0:
            return None
        self._anomalies.update(now)
        if self._anomalies.broken:
            return Problem.WEB_BREAK
        return Problem.SLIP if self._anomalies.slipping else None

    def _without_errors(self, balance: BalanceSample) -> BalanceSample:
        """The balance without what is known to be no tension."""
        if self._errors is None or not self._errors.correction_N:
            return balance
        return replace(balance, force_N=balance.force_N - self._errors.correction_N)

    def _look_for_errors(self, balance: BalanceSample, torque_Nm: float, x1_m: float, F_next_N: float) -> None:
        """What is known to be no tension from now on; when that is more than before, the past means another E."""
        errors = self._errors
        if errors is None:
            return
        # How much of other web is in the span, and what else it is, says nothing of the model.
        if self._spliced is not WHOLE or self.other_web_suspected:
            errors.interrupt()
            return
        errors.update(balance, torque_Nm, x1_m, F_next_N, self.estimate.youngs_modulus_Pa)
        if errors.rebased_N and balance.web_per_Pa > 0.0:
            self._synchronizer.rebase(-errors.rebased_N / balance.web_per_Pa)
            # What has become known all at once is nothing that has happened to the web.
            if abs(errors.rebased_N) > _ALL_AT_ONCE * self.estimate.youngs_modulus_Pa * balance.web_per_Pa:
                self._anomalies.suspend()
                self._shift_finder.reset()

    def _look_for_shift(self, now: BalanceSample) -> None:
        """A shift is taken out of the torque from the next cycle on, and E goes on from what it was before it."""
        if self.config.torque_shift == "ignore":
            return
        if self.problem is not None or self._strain_uncertainty > 0.0:
            self._shift_finder.reset()
            return
        shift = self._shift_finder.update(
            now,
            self.estimate.youngs_modulus_Pa,
            may_decide=not self._anomalies.judging,
            deviation_N=self._errors.likely_deviation_N if self._errors is not None else 0.0,
        )
        if shift is not None:
            more_Nm = shift.force_N / self._balance.force_per_torque_per_m
            self.torque_shift_Nm += more_Nm
            if abs(self.torque_shift_Nm) < _GONE * abs(more_Nm):
                self.torque_shift_Nm = 0.0
            self.estimate = replace(self.estimate, youngs_modulus_Pa=shift.youngs_modulus_Pa)
            self.use(self._method)

    def _find_delay(self, torque_Nm: float, torque_sim_Nm: float) -> bool:
        """Whether the delay is another one from this cycle on."""
        before_s = self.delay_s
        if self._finder is not None and self.problem is None:
            self.delay_s = self._finder.update(torque_Nm, torque_sim_Nm)
        return self.delay_s != before_s

    def _transport_out(self, velocity_m_s: float) -> None:
        """What is not known of the strain leaves with the web: it decays by exp(-v·t/L)."""
        self._strain_uncertainty *= exp(-abs(velocity_m_s) * self._cycle_s / self._balance.span_length_m)
        if self._strain_uncertainty < _KNOWN_STRAIN:
            self._strain_uncertainty = 0.0

    def _transfer(self, x1_m: float, x2_m: float, *, strain: bool, axes: bool) -> None:
        """Put measured states in the place of simulated ones, unless they are too far off to be believed."""
        transfer, line, web = self.config.transfer, self._line, self._balance.web
        self.refused = False
        states: dict[str, float] = {}
        if strain:
            measured = float(web.strain[0])
            # Beyond any web: speeds that are no line's bring encoders there, and -1 would be a web of no length.
            believable = abs(measured) <= _LARGEST_STRAIN
            if believable and abs(measured - float(line.strain[0])) <= transfer.strain_limit:
                states["strain1"] = measured
            else:
                self.refused = True
        if axes:
            (x1_sim, x2_sim), (v1_sim, v2_sim) = line.x_m.tolist(), line.v_m_s.tolist()
            v1, v2 = web.speeds_m_s.tolist()
            near = max(abs(x1_m - x1_sim), abs(x2_m - x2_sim)) <= transfer.position_limit_m
            slow = max(abs(v1 - v1_sim), abs(v2 - v2_sim)) <= transfer.velocity_limit_m_s
            if near and slow:
                states |= {"x1_m": x1_m, "x2_m": x2_m, "v1_m_s": v1, "v2_m_s": v2}
            else:
                self.refused = True
        if states:
            line.set_state(states)


def _known_change(
    model: ModelParameters, config: EstimationConfig, mass_kg: float, cycle_s: float
) -> KnownChange | None:
    """What looks at known changes of the tension; None where that is not wanted."""
    wanted = config.known_change
    if wanted is None:
        return None
    loop = None
    if wanted.loop_gain_deviation_pct is not None and model.drives is not None:
        squared = model.motor_rad_per_m(2) ** 2
        loop = DriveLoop(
            per_item(model.drives.velocity_kp_Nm_s_per_rad, 2) * squared,
            per_item(model.drives.velocity_ki_Nm_per_rad, 2) * squared,
            per_item(model.drives.current_loop_time_constant_s, 2),
            model.drives.sample_time_s,
            0.01 * wanted.loop_gain_deviation_pct,
        )
    return KnownChange(mass_kg, loop, cycle_s)
