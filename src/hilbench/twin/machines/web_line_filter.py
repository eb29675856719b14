"""Estimation of carriage positions, reel radii and section moduli E of a line with stations, by an augmented filter.

A line follows the measured motion; residuals of its torques and station sensors update the unknowns by the line's own
sensitivities to them (`hilbench.plant.web_line.sensitivity_model`). So the radius of a reel is found by v·dt = r·dphi
with the strain in it, from the tension that a wrong radius would make, or from the carriage that it would move.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import copysign, exp, hypot, inf, isfinite, nan, sqrt
from typing import Final

import numpy as np

from hilbench.compiled import Vector
from hilbench.estimation import noise_level
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.web_line.augmented_filter import AugmentedFilter, Posterior
from hilbench.estimation.web_line.transients import Transient
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.drive_response import DriveResponse
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_carriages, section_length_m, section_spans
from hilbench.plant.web_line.sensitivity_model import Kind, SensitivityModel, Unknown
from hilbench.twin.machines.web_line_sensors import StationSensors
from hilbench.twin.machines.web_line_stations_cycle import FILTER, FilterArrays
from hilbench.twin.machines.web_line_transients import transient_detector

_WINDOW_S: Final = 0.03  #: averaging window
# Priors, as standard deviations.
_RADIUS_SHARE: Final = 0.02
_MODULUS_SHARE: Final = 0.2
_SECTION_SHARE: Final = 0.03  #: of a section's E from that of the whole web
_DRIFT_APART: Final = 0.1  #: share of that drifting in a shift, in which the whole web may go through all of it
#: Sudden change of E: of the whole web, and in addition of a section.
_JUMP_SHARE, _SECTION_JUMP_SHARE = 0.2, 0.1
#: Share of a web of unknown strain that has to have left before E is learned: until then it is not separable from the
#: strain. And the relative deviation of E that is added by learning both of them from their product.
_SHOWN_FROM, _OF_PRODUCT = 0.1, 0.01
#: Strain of the entering web: at rest, running, and at rest with unknown strain.
_STRAIN_AT_REST, _STRAIN_IN_MOTION, _STRAIN_UNKNOWN = 0.02, 0.5, 1.0
#: Of its travel. A running one has its stops as only prior, and so has one whose position its spring will show.
_CARRIAGE_AT_REST: Final = 0.01
_USUAL_TRAVEL_M: Final = 1.0  #: of a carriage without stops
_MODEL_SHARE: Final = 0.01  #: of E, lower limit by model errors
# Process noise.
#: Of web: at 1e-4 the web balance of a measured carriage can't show a drift of E of 1 % in a minute.
_CARRIAGE_M_PER_SQRT_M: Final = 1e-5
_SLIPPING_M_PER_SQRT_M: Final = 2e-3  #: while a web slips
_THICKNESS_SHARE: Final = 0.1  #: thickness error, which changes a reel's radius
_RADIUS_PER_SQRT_M: Final = 2e-5  #: other changes
_STRAIN_PER_SQRT_S: Final = 1e-3  #: of the entering web
#: Time constant (a shift) of E, and of a torque's slow error, within their priors (Ornstein-Uhlenbeck). So E changes by
#: 1 % in a minute, 8 % in an hour, a torque by 1 % of its slow error in 2.5 s: E is likelier to.
_SHIFT_S: Final = 5e4
# Measurement noise.
_OFFSET_SHARE: Final = 0.002  #: slow error of a torque: friction, offset; of the drive's limit
_LEAST_NOISE_SHARE: Final = 1e-3  #: of a window: oscillating idlers are no white noise
#: Of a limit, or of the tension at a load cell, at first: the line is released in another state than the real one, and
#: oscillates; and for how long.
_SWING_SHARE, _SWING_S = 0.2, 0.05
#: After a change of the web: of torques and tensions that show it, and for how long.
_CHANGE_OSCILLATION_SHARE, _CHANGE_OSCILLATES_S = 0.3, 0.13
#: The same of torques next to a section with a carriage, which oscillates against its web, and of its position: with
#: less E beside it is taken from the oscillation, with more a slip for E.
_TRANSIENT_OSCILLATION_SHARE, _TRANSIENT_OSCILLATES_S = 1.0, 0.3
_CARRIAGE_OSCILLATION_SHARE: Final = 0.5
_TRANSIENT_SHARE: Final = 0.03  #: of a limit, of these at first
_INERTIA_SHARE: Final = 0.05  #: of the accelerating torque
#: Change of a section's strain while a web slips, over that of the entering web.
_SLIPPING_PER_SQRT_S: Final = 0.2
#: Evidence (`AugmentedFilter.evidence_of_change`) on which E is corrected: with a right model its errors are draws of
#: priors, a new one in minutes. Of two sections one draw in 20,000 exceeds it, once in some 100 days.
_ACCEPTED: Final = 20.0
_KEPT: Final = 0.5 * _ACCEPTED  #: evidence remaining once more is known, down to which it is kept
#: Start of the transient detection: the line is released in another state than the real one, and oscillates.
_TRANSIENTS_FROM_S: Final = 0.5
_TRANSIENT_NOISE_SHARE: Final = 1e-3  #: of a limit: other torque noise
#: Time for which an uncertain transient is kept, for the strain of its web to show in the next section.
_MAY_BE_S: Final = 3.0
#: Deviations of E by which the next section's has to differ, and the error of that, as a share.
_BOOKED, _BOOKED_OFF = 3.0, 0.35
_EMULATED_SHARE: Final = 0.25  #: error of the size of a transient emulated by load motors
#: Time after the start and after a change for which E is corrected immediately; time constant of the correction after
#: that, so that changes faster than a drift are first seen as evidence.
_LEARNS_S, _FOLLOWS_S = 1.0, 1.0
_STARTS_S: Final = 0.5
#: Travel between two checkpoints, as a share of the shortest section; and how many lengths of the longest one they
#: reach back.
_KEPT_EVERY, _KEPT_LENGTHS = 0.1, 3.0
#: Limits of the corrections.
_LEAST_MODULUS, _MOST_MODULUS, _MOST_RADIUS = -0.8, 4.0, 0.3


@dataclass(frozen=True, slots=True)
class _Kept:
    """Checkpoint: posterior of the filter, and accumulated corrections of the unknowns (n,)."""

    time_s: float
    travel_m: float
    posterior: Posterior
    corrected: Vector


class LineFilter:
    """Estimator of a line with stations, whose axes answer once a cycle; `measured`: names of stations with a sensor;
    `torqued`: torque-controlled axes, whose torque has no information on the web; `emulated`: load motors emulate the
    web's tension."""

    def __init__(
        self,
        model: ModelParameters,
        cycle_s: float,
        measured: Sequence[str],
        torqued: Sequence[int] = (),
        *,
        emulated: bool = False,
    ) -> None:
        self._emulated = emulated
        self.sensitivities = SensitivityModel(model, measured)
        self._model = model
        pulled = [axis for axis in range(1, model.axis_count + 1) if model.carries_web_load(axis)]
        self._axes = [axis for axis in pulled if axis not in torqued]
        self._rows = np.array(self._axes, int) - 1
        self._sensors = StationSensors(model, self.sensitivities, measured)
        loops, axes = model.drives, range(1, model.axis_count + 1)
        assert loops is not None, "a twin's model has drives"
        self._limits_Nm = [per_item(loops.torque_limit_Nm, axis) for axis in self._axes]
        limits_Nm, of_sensors = np.array(self._limits_Nm), self._sensors.offsets
        self._offsets = np.concatenate([_OFFSET_SHARE * limits_Nm, of_sensors])
        shows = np.array([self._shows_in_torques(each) for each in self.sensitivities.unknowns], float)
        self._gains = [per_item(loops.velocity_kp_Nm_s_per_rad, axis) for axis in axes]
        self._rates = [per_item(loops.velocity_ki_Nm_per_rad, axis) for axis in axes]
        own_kg = [model.roller_mass_kg(axis) + model.motor_mass_kg(axis) for axis in axes]
        per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
        wound_kg_m2 = [model.wound_inertia_kg_m2(axis) / model.gear_ratio(axis) ** 2 for axis in axes]
        #: Inertia of each driven roller (N,), at the motor: its own, and of the web wound on it at the start.
        self._own_kg_m2, self._wound_kg_m2 = np.array(own_kg) / per_m**2, np.array(wound_kg_m2)
        self._response = DriveResponse(self._gains, self._rates, len(shows) + 1, cycle_s)
        count, all_of, line = len(self._axes), len(self._offsets), self.sensitivities
        noise = np.zeros(count), np.zeros((count, noise_level.SIZE)), np.zeros(count)
        searched = (_TRANSIENT_NOISE_SHARE * limits_Nm) ** 2, np.zeros(count)
        window = np.zeros(all_of), np.zeros((all_of, len(shows))), self._sensors.rows, np.zeros(len(of_sensors))
        rollers = np.zeros(len(per_m)), per_m, np.zeros(len(per_m))
        torques, unknowns = (self._rows, *noise, *searched), (shows, line.steps, line.errors)
        answers = self._response.arrays, line.load_slopes
        #: Of the compiled cycle.
        self.arrays = FilterArrays(np.zeros(1, FILTER), *torques, *window, *unknowns, *rollers, *answers)
        self._state = self.arrays.state[0]
        self._state["emulated"] = emulated
        self._set_cycle(cycle_s)
        kinds = np.array([each.kind for each in self.sensitivities.unknowns])
        self._is_strain, self._is_modulus = kinds == Kind.STRAIN, kinds == Kind.MODULUS
        sensed = np.array([each in self._sensors.sensed for each in self.sensitivities.unknowns], bool)
        #: Unknowns that are observed by torques and tensions alone.
        self._by_torque = ~self._is_strain & ~sensed
        #: Which innovation updates which unknown while a web slips: torques the tensions, sensors what they sense.
        self._learns_slipping = np.zeros((len(kinds), len(self._offsets)), bool)
        self._learns_slipping[self._is_strain, : len(self._axes)] = True
        self._learns_slipping[~self._by_torque, len(self._axes) :] = True
        #: The same for a web at rest with unknown strain, as one measurement can't separate E and strain, and where a
        #: reel has a wrong flywheel while accelerating: an error that is no noise.
        self._learns_no_modulus = np.repeat(~self._is_modulus[:, None], len(self._offsets), axis=1)
        lengths_m = [section_length_m(model, axis) for axis in range(1, model.axis_count)]
        self._keep_every_m, self._keep_m = _KEPT_EVERY * min(lengths_m), _KEPT_LENGTHS * max(lengths_m)
        self._web_m = sum(lengths_m)
        held = axes_before_carriages(model)
        self._beside_carriages = np.array([axis in held or axis - 1 in held for axis in self._axes], bool)
        self.begin([0.0] * model.axis_count, 0.0)
        self._set_transients()

    def _set_cycle(self, cycle_s: float) -> None:
        self._cycle_s = self._response.cycle_s = cycle_s
        self._window = self._state["window"] = max(round(_WINDOW_S / cycle_s), 1)

    def _set_transients(self) -> None:
        """Create the transient detectors for this cycle time."""
        model = self._model
        held = {Unknown(Kind.MODULUS, axis) for axis in axes_before_carriages(model)}
        answer = DriveResponse(self._gains, self._rates, 1, self._cycle_s)
        answer.set_inertia(self.inertia_kg_m2)
        #: Of each section with a carriage: index of its E, and its transient detector.
        self.transients = [
            (place, transient_detector(model, unknown.number, self._rows.tolist(), answer, self._cycle_s))
            for place, unknown in enumerate(self.sensitivities.unknowns)
            if unknown in held and self._axes  # without torques of the web nothing is observable
        ]

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; the estimate stays."""
        if cycle_s == self._cycle_s:
            return
        self._set_cycle(cycle_s)
        self._set_growth()
        self._set_inertia()
        self._set_transients()
        self._may_be.clear()
        self._begin_window()

    def begin(self, positions_m: Sequence[float], speed_m_s: float, *, known: bool = True) -> None:
        """Start with the driven rollers (N,) at these positions and this web speed, 0 at rest. Not `known`: the strain
        of a web at rest is unknown."""
        self.sensitivities.reset(positions_m, speed_m_s)
        in_motion = speed_m_s != 0.0 or not known
        strained = _STRAIN_AT_REST if not in_motion else _STRAIN_IN_MOTION if speed_m_s else _STRAIN_UNKNOWN
        believed = np.diag([self._believed(each, in_motion, strained) ** 2 for each in self.sensitivities.unknowns])
        unknown_at_rest = not known and speed_m_s == 0.0
        self._moduli_from_m = _SHOWN_FROM * self._web_m if unknown_at_rest else 0.0
        self._model_share = hypot(_MODEL_SHARE, _OF_PRODUCT if unknown_at_rest else 0.0)
        identifies = not in_motion or not self._model.carriages
        self._identifies_moduli = identifies and any(each.kind is Kind.MODULUS for each in self.sensitivities.unknowns)
        common = sqrt(_MODULUS_SHARE**2 - _SECTION_SHARE**2)
        moduli = self._moduli_apart(common, _SECTION_SHARE)
        drifts = self._moduli_apart(common, _DRIFT_APART * _SECTION_SHARE)
        #: Covariance (p, p) of sudden changes of E, and of drift in a shift.
        at = np.ix_(self._is_modulus, self._is_modulus)
        jumps = self._moduli_apart(_JUMP_SHARE, _SECTION_JUMP_SHARE)
        self._jumps, self._drifts = jumps[at], drifts[at]
        of_carriages = self._sensors.of_carriages
        disturbed = np.concatenate([self._beside_carriages, of_carriages])
        of_torques = np.where(self._beside_carriages, _TRANSIENT_OSCILLATION_SHARE, _CHANGE_OSCILLATION_SHARE)
        of_sensors = np.where(self._sensors.tensions_N > 0.0, _CHANGE_OSCILLATION_SHARE, 0.0)
        swings = np.concatenate([of_torques, np.where(of_carriages, _CARRIAGE_OSCILLATION_SHARE, of_sensors)])
        swings_on = np.exp(
            -self._window * self._cycle_s / np.where(disturbed, _TRANSIENT_OSCILLATES_S, _CHANGE_OSCILLATES_S)
        )
        swinging = np.concatenate(
            [_TRANSIENT_SHARE * self._beside_carriages * self._limits_Nm, 0.0 * self._sensors.offsets]
        )
        #: Deviation of a reel's radius change per m of web, over the initial radius, beyond the model's.
        rates = np.zeros(len(self.sensitivities.unknowns))
        for place, unknown in enumerate(self.sensitivities.unknowns):
            if unknown.kind is Kind.RADIUS:
                rates[place] = _THICKNESS_SHARE * abs(self.sensitivities.slopes_per_m[unknown.number])
        most = np.concatenate([np.full(len(self._axes), inf), self._sensors.most_oscillation])
        self._filter = AugmentedFilter(
            believed + moduli, self._is_modulus, rates, self._offsets, swings, most, swings_on, swinging
        )
        self._set_growth()
        for state, limit_Nm in zip(self.arrays.noise, self._limits_Nm, strict=True):
            state[:] = NoiseLevel(0.01 * limit_Nm, 1e-4 * limit_Nm).state
        for name in ("travel_m", "window_travel_m", "has_speeds", "searches", "slips", "uncertain"):
            self._state[name] = 0.0
        self._state["followed_m"] = positions_m[-1]
        # On a line joined while running, E and strain are separable once its web has been replaced; but after a
        # carriage, which keeps the tension, web enters with a strain that E has made.
        self._state["known_from_m"] = self._web_m if in_motion else 0.0
        self._time_s = 0.0
        self.arrays.sensed[:] = nan
        self._speeds_m_s: Vector | None = None
        self.arrays.loads[:] = 0.0
        self._response.reset()
        self._set_inertia()
        self._may_be: list[tuple[float, int, Transient]] = []  # uncertain transients, and their start times
        #: Travel from which on E next to a carriage has changed, or web enters with another strain, or slips.
        self._undecided_from_m = inf
        self._corrected = np.zeros(len(self.sensitivities.unknowns))
        self._learns_until_s = self._oscillates_until_s = -inf
        self._started = np.zeros_like(self._corrected)
        self._kept = deque([_Kept(-inf, 0.0, self._filter.posterior, self._corrected)])
        self._begin_window()

    def _believed(self, unknown: Unknown, in_motion: bool, strained: float) -> float:
        if unknown.kind is Kind.CARRIAGE:
            station = self._model.carriages[unknown.number - 1].station
            ends = (station.lower_stop_m, station.upper_stop_m)
            travel_m = _USUAL_TRAVEL_M if ends[0] is None or ends[1] is None else ends[1] - ends[0]
            known = not in_motion and not self._shows_in_torques(unknown)
            return _CARRIAGE_AT_REST * travel_m if known else travel_m / sqrt(12.0)
        if unknown.kind is Kind.STRAIN:
            return self._model.upstream_strain * strained
        return _RADIUS_SHARE if unknown.kind is Kind.RADIUS else 0.0

    def _moduli_apart(self, common: float, apart: float) -> Vector:
        """Covariance of E of the sections: deviations common to the web, and of each by itself; 0 if E is not
        identified."""
        moduli = self._is_modulus.astype(float) * self._identifies_moduli
        return common**2 * np.outer(moduli, moduli) + apart**2 * np.diag(moduli)

    def _shows_in_torques(self, unknown: Unknown) -> bool:
        """False for a carriage without spring or arm, whose position is not observable by tension: that a longer web is
        more compliant is below any model's accuracy."""
        if unknown.kind is not Kind.CARRIAGE:
            return True
        station = self._model.carriages[unknown.number - 1].station
        return station.spring_N_per_m > 0.0 or station.arm_length_m > 0.0

    def _set_inertia(self) -> None:
        """Update the inertia of reels by the web on them."""
        #: Inertia of each driven roller (N,) with the web on it now, at the motor.
        self.inertia_kg_m2: Vector = self._own_kg_m2 + self._wound_kg_m2 * self.sensitivities.ratios**4
        # That of a load motor in place of a reel has not changed.
        self.arrays.lacking_kg_m2[:] = self.inertia_kg_m2 - self._own_kg_m2 - self._wound_kg_m2
        self._response.set_inertia(self.inertia_kg_m2)

    @property
    def _travel_m(self) -> float:
        return float(self._state["travel_m"])

    @property
    def _slips(self) -> bool:
        return bool(self._state["slips"])

    @property
    def sensor_names(self) -> Sequence[str]:
        """Stations with a sensor, in the order of the compiled cycle."""
        return self._sensors.names

    @property
    def swings(self) -> bool:
        """True while carriages oscillate after a sudden change of E."""
        return self._time_s <= self._oscillates_until_s

    def _begin_window(self) -> None:
        self._state["count"] = self.arrays.sums[:] = self.arrays.slopes[:] = 0.0

    def sensed_length_m(self, axis: int) -> float:
        """Length of the section after an axis, with its carriages at their sensed positions."""
        length_m = self.sensitivities.length_m(axis)
        for each, sensed_m in zip(self._sensors.sensed, self.arrays.sensed.tolist(), strict=False):
            if each.kind is Kind.CARRIAGE and isfinite(sensed_m):
                left_m = sensed_m - self.sensitivities.position_m(each.number)
                length_m += left_m * self.sensitivities.longer_by(each, axis)
        return length_m

    # -- what the compiled cycle leaves --------------------------------------------------------------------

    def begin_slip(self, since_s: float) -> None:
        """A web slips: undo corrections since the latest time without slip; from now on torques update tensions
        alone."""
        self._take_back(since_s)
        self._undecided_from_m = inf
        self._begin_window()

    def correct(self, time_s: float, *, limited: bool) -> bool:
        """Update by the innovations of a window; True if something was corrected. `limited`: a torque is saturated, and
        has no information."""
        corrected = not limited and self._correct(time_s)
        self._keep(time_s)
        self._state["uncertain"] = bool(self._may_be)  # what the next section books has changed
        self._begin_window()
        return corrected

    def _correct(self, time_s: float) -> bool:
        count, unknowns = int(self._state["count"]), self.sensitivities.unknowns
        lasted_s = count * self._cycle_s
        self._time_s += lasted_s
        self._state["searches"] = self._identifies_moduli and self._time_s >= _TRANSIENTS_FROM_S
        self._filter.grow(*self._growth(lasted_s))
        learns = self._learns_slipping if self._slips else None
        innovations, slopes = self.arrays.sums / count, self.arrays.slopes / count
        if learns is None and self._travel_m < self._moduli_from_m:
            learns = self._learns_no_modulus
        variances, jumps = self._variances(count, lasted_s), (self._jumps, self.sensitivities.web_changed())
        changes = self._filter.update(innovations, slopes, variances, jumps, learns)
        if self._filter.has_begun_to_change:
            # The drives' response restarts from a change of the web in the middle of the window.
            web = [i for i, each in enumerate(unknowns) if each.kind in (Kind.MODULUS, Kind.STRAIN)]
            self._response.answer_from(count // 2, web, self.arrays.loads)
            self._undecided_from_m = inf
            return False
        if learns is None:
            changes = changes + self._parameters()
        changes = np.array([self._bounded(each, float(change)) for each, change in zip(unknowns, changes, strict=True)])
        self._apply(changes)
        return True

    def _parameters(self) -> Vector:
        """Corrections of E (n,): changes at once for a while after a sudden one, and slowly after that; none while
        undecided. Initial errors on overwhelming evidence, or while there is no earlier information."""
        filtered, none = self._filter, np.zeros_like(self._corrected)
        if filtered.has_changed:
            if self._time_s > self._learns_until_s:
                self._oscillates_until_s = self._time_s + _TRANSIENT_OSCILLATES_S
            self._learn()
        found = self._from_start()
        if self._time_s <= self._learns_until_s:
            return found + filtered.take_changes(1.0)
        changes, starts = filtered.evidence_of_change(), filtered.evidence_of_start(none)
        if self._is_another(max(changes, starts)):
            found = found + filtered.take_start()
            self._learn(anew=changes > starts)
        if self._undecided_from_m < inf:
            return found
        return found + filtered.take_changes(self._window * self._cycle_s / _FOLLOWS_S)

    def _from_start(self) -> Vector:
        """Corrections of initial errors of E (n,): immediate while nothing is known of the web, and undone later
        without evidence."""
        filtered, none = self._filter, np.zeros_like(self._corrected)
        if self._time_s <= _STARTS_S or self._travel_m < self._state["known_from_m"]:
            taken = filtered.take_start()
            self._started = self._started + taken
            return taken
        started, self._started = self._started, none
        if started.any() and filtered.evidence_of_start(started) < _KEPT:
            return filtered.give_back(started)
        return none

    def _is_another(self, evidence: float) -> bool:
        """True if E has changed by this evidence: next to a carriage, only once a slip would have been detected."""
        if evidence < (_ACCEPTED if self._undecided_from_m == inf else _KEPT):
            self._undecided_from_m = inf
            return False
        self._undecided_from_m = min(self._undecided_from_m, self._travel_m)
        return not self.transients or self._travel_m - self._undecided_from_m > self._keep_m

    def _learn(self, *, anew: bool = False) -> None:
        """Correct E immediately for a while; `anew`: it changed some time ago, by an amount yet to be estimated."""
        if anew:
            self._filter.jump(self._jumps)
        self._undecided_from_m = inf
        self._learns_until_s = self._time_s + _LEARNS_S

    def look_for_transients(self, time_s: float) -> bool:
        """Decide on transients in the torques' innovations; True if one was applied."""
        if not self._state["searches"] or self._slips:
            self._forget_transients()
            return False
        for place, watch in self.transients:
            transient = watch.decide(self.arrays.searched_Nm2)
            if transient is not None:
                self._may_be.append((time_s - transient.cycles * self._cycle_s, place, transient))
        self._state["uncertain"] = 0.0
        for began_s, place, transient in list(self._may_be):
            if time_s - began_s > _MAY_BE_S:
                self._may_be.remove((began_s, place, transient))
                continue
            sure = transient if transient.sure and not self._emulated else self._handed_on(began_s, place, transient)
            if sure is not None:
                self._kicked(time_s, began_s, place, sure)
                self._begin_window()
                return True
        return False

    def _handed_on(self, began_s: float, place: int, transient: Transient) -> Transient | None:
        """Transient confirmed by E of the next section, which books the strain that its web brings. If load motors
        emulate it, some cycles late, even its sign is known only from there."""
        changed, deviation = self._booked_behind(place, self._at(began_s))
        would_be, share = -changed / (1.0 + changed), transient.share
        if self._emulated:
            share = copysign(share, would_be)
            transient = replace(
                transient, share=share, deviation=max(transient.deviation, _EMULATED_SHARE * abs(share))
            )
        off = abs(would_be - share)
        readings = abs(changed) > _BOOKED * deviation and off < 3.0 * transient.deviation + _BOOKED_OFF * abs(share)
        return transient if readings else None

    def _booked_behind(self, place: int, kept: _Kept) -> tuple[float, float]:
        """Relative increase of the next section's E over that of this one since `kept`, and its deviation, then
        or now."""
        behind = Unknown(Kind.MODULUS, self.sensitivities.unknowns[place].number + 1)
        if behind not in self.sensitivities.places:
            return 0.0, 1.0
        at = self.sensitivities.places[behind]
        then, readings = self._filter.of_unknowns(kept.posterior), self._filter.of_unknowns(self._filter.posterior)
        # After a sudden change they are not separable yet: that counts, however certain they were before.
        apart = (float(known[at, at] + known[place, place] - 2.0 * known[at, place]) for known, _ in (then, readings))
        deviation = sqrt(max(apart))
        before, now = 1.0 + kept.corrected + then[1], 1.0 + self._corrected + readings[1]
        return float(now[at] / now[place] * before[place] / before[at]) - 1.0, deviation

    def _at(self, time_s: float) -> _Kept:
        """Checkpoint at that time."""
        return next((kept for kept in reversed(self._kept) if kept.time_s <= time_s), self._kept[0])

    def _kicked(self, time_s: float, began_s: float, place: int, transient: Transient) -> None:
        """Apply a transient: E of a section with a carriage has changed. Torques had attributed that to other unknowns;
        now they measure it by the strain of the web leaving the section."""
        self._take_back(began_s)
        unknown = self.sensitivities.unknowns[place]
        factor = self.sensitivities.modulus_factor(unknown.number)
        changes, jumps = np.zeros(len(self.sensitivities.unknowns)), np.zeros_like(self._jumps)
        changes[place] = self._bounded(unknown, factor * transient.share)
        self._hand_on(unknown.number, time_s - began_s, transient, changes)
        changed = np.flatnonzero(self._filter.parameters == place)
        jumps[changed, changed] = (factor * transient.deviation) ** 2
        self._apply(changes)
        self._filter.jump(jumps)
        self._forget_transients()
        self._learn()

    def _hand_on(self, axis: int, since_s: float, transient: Transient, changes: Vector) -> None:
        """Correct the next section's strain for web that has left since the transient with another strain than the
        simulated line's."""
        behind = Unknown(Kind.STRAIN, axis + 1)
        if behind in self.sensitivities.places:
            line, span = self.sensitivities.line, section_spans(self._model, axis)[-1]
            travel_m = abs(line.v_m_s.item(axis)) * since_s
            gone = 1.0 - exp(-travel_m / section_length_m(self._model, axis + 1))
            more = -transient.share / (1.0 + transient.share) * line.strain.item(span)
            changes[self.sensitivities.places[behind]] = self.sensitivities.modulus_factor(axis + 1) * more * gone

    def _forget_transients(self) -> None:
        for _, watch in self.transients:
            watch.reset()
        self._may_be.clear()
        self._state["uncertain"] = 0.0

    def _apply(self, changes: Vector) -> None:
        """Correct the line's unknowns (n,) and restart from the corrected ones."""
        self._corrected = self._corrected + changes
        self.sensitivities.correct(changes)
        self._response.add(len(changes), changes)
        turned = self.sensitivities.renew()
        self._filter.turn(turned)
        self._response.turn(np.asarray(np.linalg.inv(turned), np.float64))
        self.sensitivities.refresh_load_slopes()
        if self._wound_kg_m2.any():
            self._set_inertia()

    def put_tensions(self, tensions_N: Mapping[int, float]) -> None:
        """Set the tensions of the sections after these axes, whatever the encoders' strain; only of those whose strain
        is an unknown."""
        changes = np.zeros(len(self.sensitivities.unknowns))
        for axis, tension_N in tensions_N.items():
            strain = Unknown(Kind.STRAIN, axis)
            if strain in self.sensitivities.places:
                stiffness_N = self._model.stiffness_N(section_spans(self._model, axis)[0] + 1)
                changes[self.sensitivities.places[strain]] = tension_N / stiffness_N - self.sensitivities.strain(axis)
        self._apply(changes)

    def _keep(self, time_s: float) -> None:
        """Take a checkpoint, for `_take_back`."""
        kept = self._kept
        if self._slips or self._travel_m - kept[-1].travel_m < self._keep_every_m:
            return
        kept.append(_Kept(time_s, self._travel_m, self._filter.posterior, self._corrected))
        while len(kept) > 1 and kept[1].travel_m < self._travel_m - self._keep_m:
            kept.popleft()

    def _take_back(self, since_s: float) -> None:
        """Undo the torques' estimates since then of E, and of positions of carriages without a sensor: it was the slip.
        Tensions stay, and are estimated by the torques from now on."""
        earlier, self._learns_until_s = self._at(since_s), -inf
        strains = np.where(self._is_strain, (_STRAIN_AT_REST * self._model.upstream_strain) ** 2, 0.0)
        variances = np.maximum(strains, self._filter.deviations**2)
        self._filter.put_back(earlier.posterior, self._by_torque, variances)
        back = np.where(self._by_torque, earlier.corrected - self._corrected, 0.0)
        moduli = np.where(self._is_modulus, back, 0.0)
        self.sensitivities.rebook(moduli)
        self._corrected = self._corrected + moduli
        self._apply(back - moduli)

    def _bounded(self, unknown: Unknown, change: float) -> float:
        if unknown.kind is Kind.MODULUS:
            at = self.sensitivities.modulus_factor(unknown.number) - 1.0
            return min(max(change, _LEAST_MODULUS - at), _MOST_MODULUS - at)
        return min(max(change, -_MOST_RADIUS), _MOST_RADIUS) if unknown.kind is Kind.RADIUS else change

    def _set_growth(self) -> None:
        """Set remaining share and process noise per window of E and slow errors."""
        lasted_s, first = self._window * self._cycle_s, self._filter.first_offset
        prior = np.zeros((first + len(self._offsets),) * 2)
        changes = len(self._is_modulus) + np.arange(len(self._drifts))
        prior[np.ix_(changes, changes)] = self._drifts
        prior[first:, first:] = np.diag(self._offsets**2)
        self._left = np.where(np.diag(prior) > 0.0, exp(-lasted_s / _SHIFT_S), 1.0)
        self._slow_growth = (1.0 - np.outer(self._left, self._left)) * prior

    def _growth(self, time_s: float) -> tuple[Vector, Vector, float]:
        travel_m, self._state["window_travel_m"] = float(self._state["window_travel_m"]), 0.0
        growth = self._slow_growth.copy()
        for at, unknown in enumerate(self.sensitivities.unknowns):
            if unknown.kind is Kind.CARRIAGE:
                growth[at, at] = (_SLIPPING_M_PER_SQRT_M if self._slips else _CARRIAGE_M_PER_SQRT_M) ** 2 * travel_m
            elif unknown.kind is Kind.RADIUS:
                growth[at, at] = _RADIUS_PER_SQRT_M**2 * travel_m
            elif unknown.kind is Kind.STRAIN:
                slips = self._slips or self._undecided_from_m < inf  # or may
                per_sqrt_s = _SLIPPING_PER_SQRT_S if slips else _STRAIN_PER_SQRT_S
                growth[at, at] = (per_sqrt_s * self._model.upstream_strain) ** 2 * time_s
        return self._left, growth, travel_m

    def _variances(self, count: int, lasted_s: float) -> Vector:
        """Variances of a window of so many cycles: noise of torques, and by their inertia, then of sensors."""
        limits_Nm, swing = np.array(self._limits_Nm), exp(-self._time_s / _SWING_S)
        noise = self.arrays.variances_Nm2 / count + (_LEAST_NOISE_SHARE * limits_Nm) ** 2
        noise += (_SWING_SHARE * limits_Nm * swing) ** 2
        speeds_m_s = self.sensitivities.line.v_m_s[self._rows]
        before, self._speeds_m_s = self._speeds_m_s, speeds_m_s
        rates = self.arrays.rad_per_m[self._rows] * (speeds_m_s - (speeds_m_s if before is None else before)) / lasted_s
        noise += (_INERTIA_SHARE * self.inertia_kg_m2[self._rows] * rates) ** 2
        sensors = self._sensors.variances + (_SWING_SHARE * self._sensors.tensions_N * swing) ** 2
        return np.concatenate([noise, sensors])

    # -- estimates ---------------------------------------------------------------------------------------

    def carriage_deviation_m(self, number: int) -> float:
        """Standard deviation of the position of a carriage, from 1."""
        return self._deviation(Unknown(Kind.CARRIAGE, number))

    def radius_deviation_m(self, axis: int) -> float:
        """Standard deviation of the radius of a reel. Where E is not observable it includes that of the strain."""
        by_strain = 0.0 if self._identifies_moduli else _MODULUS_SHARE * abs(self._model.upstream_strain)
        return self._model.radius_m(axis) * hypot(self._deviation(Unknown(Kind.RADIUS, axis)), by_strain)

    def separable(self, axis: int) -> bool:
        """True if E of the section after an axis is identified."""
        if not self._identifies_moduli or self._is_undecided(axis):
            return False
        return self._modulus_deviation(axis) < 0.5 * _MODULUS_SHARE * self.sensitivities.modulus_factor(axis)

    def modulus_deviation(self, axis: int) -> float:
        """Standard deviation of E in the section after an axis over the model's E; inf if it is not identified."""
        if not self._identifies_moduli or self._is_undecided(axis):
            return inf
        return hypot(self._modulus_deviation(axis), self._model_share)

    def modulus_factor(self, axis: int) -> float:
        """Factor on the model's E of the section after an axis; 1 if it is not identified."""
        return self.sensitivities.modulus_factor(axis) if self._identifies_moduli else 1.0

    def _modulus_deviation(self, axis: int) -> float:
        """Deviation of the corrected E, including the estimated but not yet applied correction."""
        at = self.sensitivities.places[Unknown(Kind.MODULUS, axis)]
        return hypot(self._filter.deviation(at), self._filter.expected(at))

    def _is_undecided(self, axis: int) -> bool:
        """True while a change of E of the section after an axis, or of its neighbour, is undecided, or web of unknown
        strain is still there."""
        if self._travel_m < self._state["known_from_m"]:
            return True
        if self._undecided_from_m == inf:
            return False
        numbers = [self.sensitivities.unknowns[place].number for place, _ in self.transients]
        return axis in numbers or axis - 1 in numbers

    def _deviation(self, unknown: Unknown) -> float:
        return self._filter.deviation(self.sensitivities.places[unknown])
