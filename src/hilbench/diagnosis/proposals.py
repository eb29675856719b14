"""Candidates for missing effects: the vocabulary's terms, and of those with an order, frequency or time, which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.residual_analysis import spectrum_over
from hilbench.diagnosis.terms import Place, Term
from hilbench.plant.effect import Domain, Effect, MachineSizes, ProbeOver, Section
from hilbench.plant.model_file import Machine
from hilbench.plant.web_line.parameters import ModelParameters

#: Peaks of a spectrum, and times of a step, that are proposed.
_PEAKS: Final = 2
#: Lowest order or frequency that is looked for, in cycles over the recording; highest and lowest order of a turn.
_LEAST_CYCLES: Final = 4.0
#: Highest frequency that is looked for, as a share of the rows'.
_OF_THE_ROWS: Final = 0.4
_HIGHEST_ORDER: Final = 64.0
_LEAST_SHARE_OF_A_TURN: Final = 0.5  #: of the roller's
#: The slowest share of a motion, and the share of its largest step from row to row from which an axis moves.
_SLOWEST, _MOVES = 0.1, 0.02
#: Angle that a roller (an arm) has to turn to distinguish a torque by its angle from a spring or an offset: over less
#: a sine is straight within some per cent.
_LEAST_ARC_RAD: Final = 1.0
#: Turns of the motor from which an order is looked for (over less a ripple is any law of the position), and from which
#: whole orders can be distinguished.
_LEAST_TURNS, _RESOLVED = 0.5, 4.0
#: Times of a step that are simulated at first, and the number of distinguishable ones among which it was chosen.
_COARSE: Final = 24
_TIMES: Final = 100.0
#: A step's time is looked for this far from the ends, as a share of the recording.
_EDGE: Final = 0.03
#: Rows of these are not proposed until it is known where to look.
_SEARCHED: Final = (
    ProbeOver.MOTOR_ANGLE,
    ProbeOver.TIME,
    ProbeOver.ONSET,
    ProbeOver.ONSET_AND_DURATION,
    ProbeOver.PASSAGE,
)
#: Deviations by which the mean square of a while must stand out for something to have passed then, and in how many
#: steps times are looked at around it.
_OUTSTANDING, _AROUND_A_BURST = 8.0, 4
#: Finite-difference step of a parameter that shapes a law, as a share of it.
_SHAPE_STEP: Final = 0.02
_TURN = 2.0 * np.pi
#: How far from a spectrum's peak the order or frequency is looked for, in steps, and the step in the spectrum's bins.
_NEAR: Final = 40
_NEAR_STEP: Final = 0.25


class Proposer:
    """Makes terms for one model and recording, of the effects that its kind of machine has."""

    def __init__(
        self, model: Machine, data: Measured, vocabulary: Sequence[Effect] | None = None, *, any_arc: bool = False
    ) -> None:
        """`vocabulary`: by default that of the machine; `any_arc`: whether torques that go with the angle are looked
        for however little of a turn there is."""
        self._any_arc = any_arc
        known = machines.vocabulary(model) if vocabulary is None else vocabulary
        self._model = model
        self._data = data
        # What a drive's loops are is found from its commands, motion and torque, not by what it does to a machine.
        possible = [effect for effect in known if effect.per_axis or not machines.is_lone(model)]
        self._vocabulary = [effect for effect in possible if not effect.nuisance]
        self._axes = range(1, model.axis_count + 1)
        speeds = [np.abs(v) for v in data.v_m_s.values()] + [np.abs(data.commands_m_s).ravel()]
        if data.commands_m_s.size == 0 and not data.v_m_s:
            speeds.append(np.abs(np.diff(data.x_m[1])) / data.period_s)
        self._usual_m_s = float(np.median(np.concatenate([v for v in speeds[-2:] if v.size] or [np.ones(1)])))
        self._top_m_s = max((float(np.max(v)) for v in speeds if v.size), default=1.0)
        self._torque_Nm = max(rms(tau) for tau in data.tau_Nm.values())

    def sizes(self, axis: int | None) -> MachineSizes:
        """Usual sizes at an axis of the machine (None: the first), by its model and how it ran."""
        usual = self._top_m_s, self._torque_Nm, self._data.period_s
        found: MachineSizes = machines.of_kind(self._model).sizes(self._model, axis, *usual)
        return found

    def waves(self, orders: Sequence[float]) -> dict[Place, list[Term]]:
        """Terms of each effect with an order, at these orders, for each axis whose torque is recorded."""
        return {
            Place(effect.id, axis): [self._term(effect, axis, {effect.probe.parameter: order}) for order in orders]
            for effect in self._over(ProbeOver.MOTOR_ANGLE)
            for axis in self._axes
            if axis in self._data.tau_Nm and effect.probe is not None and not effect.probe.by_torque
        }

    def once_a_turn(self, term: Term) -> list[Term]:
        """Effects with an order once a turn in place of a term that goes round with the motor: nothing of them is
        searched for then; none for another term."""
        if not term.has_phase or term.effect.domain is not Domain.POSITION_MEASUREMENT:
            return []
        waves = [wave for (wave,) in self.waves([1.0]).values()]
        return [replace(wave, held=frozenset({wave.effect.probe.parameter})) for wave in waves if wave.effect.probe]

    def known(self, effect: Effect, axis: int | None, values: Mapping[str, float]) -> Term:
        """An effect that is known to be there, with values to start a fit from: nothing of it is searched for."""
        term = self._term(effect, axis, values)
        return replace(term, aimed=term.is_sudden)

    def _term(
        self,
        effect: Effect,
        axis: int | None,
        values: Mapping[str, float],
        slot: int = 0,
        multiplicity: float = 1.0,
        part: str | None = None,
        section: Section | None = None,
    ) -> Term:
        base, entries = effect.filled({}), machines.entries_at(self._model, effect, axis, section)
        if slot < len(entries):
            base = effect.filled(entries[slot].parameters)
        filled = {**base, **values}
        size = effect.parameter(part or effect.strength[0]).size.on(self.sizes(axis))
        steps = {name: _SHAPE_STEP * value for name, value in filled.items()}
        least: dict[str, float] = {}
        if effect.probe is not None:
            searched = effect.probe.parameter
            match effect.probe.over:
                case ProbeOver.ONSET | ProbeOver.ONSET_AND_DURATION | ProbeOver.PASSAGE:
                    steps[searched] = 2.0 * self._data.period_s
                case ProbeOver.TIME:
                    steps[searched] = 0.02 / self._data.duration_s
                    least[searched] = _LEAST_CYCLES / self._data.duration_s
                case ProbeOver.MOTOR_ANGLE:
                    steps[searched] = 0.1 / max(self._turns(axis) * _TURN, 1.0)
                    least[searched] = self._least_order(axis)
        return Term(
            effect, axis, slot, filled, base, steps, size, multiplicity, least=least, part=part, section=section
        )

    def _least_order(self, axis: int | None) -> float:
        """Least order of a torque ripple: some periods are in the recording, and on a machine it comes from what
        turns."""
        least = _LEAST_CYCLES / max(self._turns(axis), 1e-9)
        if axis is None or machines.is_lone(self._model):
            return least
        return max(least, _LEAST_SHARE_OF_A_TURN / self._model.gear_ratio(axis))

    def _turns(self, axis: int | None) -> float:
        if axis is None or axis not in self._data.x_m:
            return 1.0
        return float(np.ptp(self._data.x_m[axis])) * self._model.motor_rad_per_unit(axis) / _TURN

    def direct(self) -> list[Term]:
        """Every effect that needs no search, at every place it can be."""
        terms = []
        for effect in self._vocabulary:
            for axis, section in machines.places(self._model, effect):
                if self._possible(effect, axis, section):
                    terms += self._looks(effect, axis, section)
        return terms

    def _looks(self, effect: Effect, axis: int | None, section: Section | None) -> list[Term]:
        """The terms with which an effect is looked at at one place; none of one that is searched for."""
        probe = effect.probe
        if probe is None:
            parts: list[str | None] = list(effect.strength) if len(effect.strength) > 1 else [None]
            return [self._term(effect, axis, {}, part=part, section=section) for part in parts]
        if probe.over in _SEARCHED:
            return []
        count = len(probe.tried)
        if probe.over is ProbeOver.SHARES_OF_TOP_SPEED:
            speeds = [share * self._top_m_s for share in probe.tried]
            return [self._term(effect, axis, {probe.parameter: v}, multiplicity=count, section=section) for v in speeds]
        if probe.over is ProbeOver.FREQUENCIES:
            shown = [f for f in probe.tried if f * self._data.duration_s > _LEAST_CYCLES and f < self._highest_Hz()]
            return [self._term(effect, axis, {probe.parameter: f}, multiplicity=count, section=section) for f in shown]
        term = self._term(effect, axis, {}, section=section)
        return [replace(term, probe=times * term.size, multiplicity=count) for times in probe.tried]

    def _possible(self, effect: Effect, axis: int | None, section: Section | None) -> bool:
        its = (one for one in self._model.effects if one.effect == effect.id)
        if effect.per_section and section is None and any(one.section is not None for one in its):
            return False  # an effect of all spans that the model has in some of them already
        # In less than a turn an encoder's error once a turn is one of its scale, or a torque that goes with the angle.
        if effect.domain is Domain.POSITION_MEASUREMENT and axis in self._data.x_m and self._turns(axis) < 1.0:
            return False
        if effect.domain is Domain.ROLLER_TORQUE and axis in self._data.x_m and not self._any_arc:
            turned_rad = self._turns(axis) * _TURN / self._model.gear_ratio(axis)
            if turned_rad < _LEAST_ARC_RAD:
                return False
        if not effect.needs_gear or axis is None:
            return True
        return bool(machines.of_kind(self._model).turns_apart(self._model, axis))

    def _over(self, over: ProbeOver) -> list[Effect]:
        """The effects that are searched for over this."""
        return [effect for effect in self._vocabulary if effect.probe is not None and effect.probe.over is over]

    def searched(self, whitened: dict[str, Array], present: list[Term], every: int) -> list[Term]:
        """Orders and frequencies at which the whitened residuals, by signal (n,), show something.

        Torques have the sharper peaks, positions the stronger ones. `every`: rows of the recording per row.
        """
        terms = []
        for effect in self._over(ProbeOver.MOTOR_ANGLE):
            for axis in self._axes:
                if axis in self._data.x_m and axis in self._data.tau_Nm:
                    residuals = self._by_torque(effect, axis, whitened, every)
                    terms += self._waves(effect, axis, residuals, present, every)
        for effect in self._over(ProbeOver.TIME):
            terms += self._waves(effect, None, whitened, present, every)
        return terms

    def _by_torque(self, effect: Effect, axis: int, whitened: dict[str, Array], every: int) -> dict[str, Array]:
        """The residuals as they count for an effect: of one that grows with the torque, times that torque."""
        if effect.probe is None or not effect.probe.by_torque:
            return whitened
        torque = self._data.tau_Nm[axis][::every] / max(self._torque_Nm, 1e-300)
        return {name: values * torque for name, values in whitened.items()}

    def tuned(self, term: Term, residual: Array, response: Array, every: int) -> tuple[Term, float]:
        """The term with the order or frequency near its own at which its response fits best, and the fall of the sum of
        squares there; as it is, and infinite, of a term without one.

        residual (signals, n) and response (2, signals, n) whitened, zero where rows do not count. How strongly and how
        late a machine answers changes with its speed, which moves a spectrum's peak; the response knows of it, and
        turned along the angle (or time) it represents the orders nearby.
        """
        name, angle = self.searched_angle_rad(term, every)
        if name is None:
            return term, float("inf")
        sine, cosine = response
        step = _NEAR_STEP * _TURN / float(np.ptp(angle))
        shifts = np.arange(-_NEAR, _NEAR + 1) * step
        # Along the turned cosine and sine, and what a turn of both makes of their squares.
        along = np.sum(cosine * residual, axis=0) + 1j * np.sum(sine * residual, axis=0)
        uneven = 0.5 * np.sum(cosine**2 - sine**2, axis=0) + 1j * np.sum(sine * cosine, axis=0)
        even = 0.5 * float(np.sum(sine**2 + cosine**2))
        b, odd = np.empty(len(shifts), complex), np.empty(len(shifts), complex)
        turn, further = np.exp(1j * shifts[0] * angle), np.exp(1j * step * angle)
        for k in range(len(shifts)):
            b[k], odd[k] = turn @ along, turn**2 @ uneven
            turn *= further
        a11, a22, a12 = even + odd.real, even - odd.real, odd.imag
        possible = term.values[name] + shifts >= term.least[name]
        gain = (a22 * b.real**2 - 2.0 * a12 * b.real * b.imag + a11 * b.imag**2) / np.maximum(
            a11 * a22 - a12**2, 1e-12 * even**2 + 1e-300
        )
        best = int(np.argmax(np.where(possible, gain, -np.inf)))
        found = replace(term, values={**term.values, name: term.values[name] + float(shifts[best])})
        return found, float(gain[best])

    def searched_angle_rad(self, term: Term, every: int) -> tuple[str | None, Array]:
        """Phase that the searched shape of a term multiplies, for each row; None for a term without one."""
        probe = term.effect.probe
        if probe is not None and probe.over is ProbeOver.MOTOR_ANGLE and term.axis is not None:
            return probe.parameter, self._data.x_m[term.axis][::every] * self._model.motor_rad_per_unit(term.axis)
        if probe is not None and probe.over is ProbeOver.TIME:
            return probe.parameter, _TURN * self._data.t_s[::every]
        return None, np.empty(0)

    def plainer(self, term: Term, present: list[Term]) -> list[Term]:
        """In the place of a wave that grows with the torque those of its order that do not."""
        probe = term.effect.probe
        if not by_torque(term) or probe is None:
            return []
        found = []
        for effect in self._over(probe.over):
            slot = self._slot(effect, term.axis, present)
            if slot is not None and term.effect.is_alike(effect) and effect is not term.effect:
                order = {probe.parameter: term.values[probe.parameter]}
                found.append(self._term(effect, term.axis, order, slot, term.multiplicity))
        return found

    def at_whole_orders(self, term: Term) -> list[Term]:
        """A term with an order at the nearest whole number of times a turn, of the motor and of what it drives, and
        held there; none where the recording does not distinguish such orders."""
        probe = term.effect.probe
        if probe is None or probe.over is not ProbeOver.MOTOR_ANGLE or term.axis is None:
            return []
        order, turns = term.values[probe.parameter], self._turns(term.axis)
        found = []
        for per_turn in {1.0, 1.0 / self._model.gear_ratio(term.axis)}:
            whole = round(order / per_turn) * per_turn
            if whole > 0.0 and per_turn * turns > _RESOLVED:
                found.append(
                    replace(term, values={**term.values, probe.parameter: whole}, held=frozenset({probe.parameter}))
                )
        return found

    def sudden(self) -> list[Effect]:
        """The effects that set in at once, at a time that is searched for."""
        return [] if self._data.settled else self._over(ProbeOver.ONSET)

    def onset_times_s(self) -> tuple[Array, float]:
        """Times at which it is first looked what a sudden effect would explain, and how far they are apart, s."""
        times = (_EDGE + (1.0 - 2.0 * _EDGE) * (np.arange(_COARSE) + 0.5) / _COARSE) * self._data.duration_s
        return times, float(times[1] - times[0])

    def passing(self) -> list[Effect]:
        """The effects that come at a time that is searched for, and go again."""
        return [] if self._data.settled else self._over(ProbeOver.PASSAGE)

    def passage_times_s(
        self, whitened: dict[str, Array], rows: NDArray[np.bool_], every: int = 1
    ) -> tuple[Array, float]:
        """Times at which something may have come, and how far they are apart, s; none where none is beyond the noise.

        whitened: residuals (n,) by signal; rows (n,): those that count; every: rows of the recording per row.
        A while is as long as the web needs through the first span; what passes in it has come in the one before, or as
        much earlier as the web needs through all spans.
        """
        if not isinstance(self._model, ModelParameters):
            return np.empty(0), 0.0
        speed_m_s = max(self._usual_m_s, 1e-3)
        while_s = self._model.span_length_m(1) / speed_m_s
        lengths = [self._model.span_length_m(section) for section in range(1, self._model.span_count + 1)]
        earlier = round(_AROUND_A_BURST * (1.0 + sum(lengths) / lengths[0]))
        window = max(8, round(while_s / (self._data.period_s * every)))
        alike, usable = np.ones(window), np.asarray(rows, np.float64)
        power = np.convolve(sum(values**2 for values in whitened.values()) * usable, alike, "same")
        count = np.convolve(usable, alike, "same") * len(whitened)
        mean = np.where(count > 0.5 * window, power / np.maximum(count, 1.0), 0.0)
        usual = float(np.median(mean[mean > 0.0])) if np.any(mean > 0.0) else 1.0
        step_s, times = while_s / _AROUND_A_BURST, []
        for _ in range(_PEAKS):
            at = int(np.argmax(mean))
            if mean[at] <= usual * (1.0 + _OUTSTANDING * float(np.sqrt(2.0 / (window * len(whitened))))):
                break
            times += [self._data.t_s[at * every] + k * step_s for k in range(-earlier, 2)]
            mean[max(at - 2 * window, 0) : at + 2 * window] = 0.0
        return np.unique([time for time in times if time > 0.0]), step_s

    def onsets(self, effect: Effect, times_s: Array, present: list[Term], section: Section | None = None) -> list[Term]:
        """A sudden effect at each of these times (n,), if the model can have another one there."""
        axis = self._axes[0] if effect.per_axis else None  # only a lone axis has one of its own
        slot = self._slot(effect, axis, present, section)
        if slot is None or effect.probe is None:
            return []
        name = effect.probe.parameter
        return [self._term(effect, axis, {name: float(t)}, slot, _TIMES, section=section) for t in times_s]

    def gradual(
        self, effect: Effect, time_s: float, duration_s: float, present: list[Term], section: Section | None = None
    ) -> list[Term]:
        """Terms that grow over a time into what the sudden `effect` is at once, if the model can have another one
        there."""
        terms = []
        for other in self._over(ProbeOver.ONSET_AND_DURATION):
            slot = self._slot(other, None, present, section)
            if other.at_once == effect.id and slot is not None and other.probe is not None:
                values = {other.probe.parameter: time_s, other.probe.duration: duration_s}
                terms.append(self._term(other, None, values, slot, _TIMES * _COARSE / 2.0, section=section))
        return terms

    def at_once(self, term: Term, present: list[Term]) -> list[Term]:
        """A gradual term as the sudden effect in its middle, with its strength; none of a term that is not gradual."""
        if term.effect.at_once is None:
            return []
        middle_s = np.array([term.time_s + 0.5 * term.duration_s])
        (effect,) = (known for known in self.sudden() if known.id == term.effect.at_once)
        found = self.onsets(effect, middle_s, present, term.section)
        return [sudden.of_strength(term.coordinates()[:1]) for sudden in found]

    def _slot(
        self, effect: Effect, axis: int | None, present: list[Term], section: Section | None = None
    ) -> int | None:
        """Free slot of an effect at a place; one of all spans takes one of each."""
        entries = machines.entries_at(self._model, effect, axis, section)
        there = [term for term in present if (term.effect.id, term.axis) == (effect.id, axis)]
        slot = len(entries) + sum(section is None or term.section in (None, section) for term in there)
        return slot if slot < effect.slots else None

    def _waves(
        self, effect: Effect, axis: int | None, whitened: dict[str, Array], present: list[Term], every: int
    ) -> list[Term]:
        """Terms of an effect at the strongest orders of an axis's motor, or frequencies (None), of residuals (n,)."""
        slot = self._slot(effect, axis, present)
        if slot is None or effect.probe is None or (axis is not None and self._turns(axis) < _LEAST_TURNS):
            return []
        if axis is None:
            turns, lowest = self._data.t_s[::every], _LEAST_CYCLES / self._data.duration_s
            highest, sharp = min(self._highest_Hz() / every, 100.0), "tau"
        else:
            turns = self._data.x_m[axis][::every] * self._model.motor_rad_per_unit(axis) / _TURN
            lowest, highest, sharp = self._least_order(axis), min(_HIGHEST_ORDER, _followed(turns)), f"tau{axis}_Nm"
        # The strongest order in the sharp signals, then in all.
        orders, count = peaks(turns, np.array([whitened[n] for n in whitened if sharp in n]), highest, lowest)
        others, _ = peaks(turns, np.array(list(whitened.values())), highest, lowest)
        apart = 1.0 / float(np.ptp(turns))
        orders += [order for order in others[:1] if all(abs(order - known) > apart for known in orders)]
        return [self._term(effect, axis, {effect.probe.parameter: order}, slot, count) for order in orders]

    def _highest_Hz(self) -> float:
        """Highest frequency that is looked for in the rows of the recording."""
        return _OF_THE_ROWS / self._data.period_s


def by_torque(term: Term) -> bool:
    """True if it is a wave that grows with the torque."""
    return term.effect.probe is not None and term.effect.probe.by_torque


def _followed(angle_turns: Array) -> float:
    """The highest order whose cycles rows at these angles (n,) can follow in the slowest tenth of the motion: of a
    higher one they show a lower one in its place, as often as rows come."""
    turned = np.abs(np.diff(angle_turns))
    moving = turned[turned > _MOVES * float(np.max(turned))]
    return 0.5 / float(np.quantile(moving, _SLOWEST)) if len(moving) else _HIGHEST_ORDER


def peaks(angle_turns: Array, whitened: Array, highest: float, lowest: float = 0.0) -> tuple[list[float], float]:
    """The strongest orders of residuals over an angle (or time), in cycles a turn, and how many were looked at.

    None is below `lowest`, and none has less than some periods within the angle. Residuals: (signals, n).
    """
    order, power = spectrum_over(angle_turns, whitened, highest)
    power[(order < max(lowest, _LEAST_CYCLES / float(np.ptp(angle_turns)))) | (order > highest)] = 0.0
    count = float(np.count_nonzero(power))
    found = []
    for _ in range(_PEAKS):
        at = int(np.argmax(power))
        if power[at] == 0.0:
            break
        found.append(_refined(order, power, at))
        power[max(at - 3, 0) : at + 4] = 0.0
    return found, count


def _refined(order: Array, power: Array, at: int) -> float:
    """The peak between bins, by a parabola through the square roots."""
    if not 0 < at < len(power) - 1:
        return float(order[at])
    before, middle, after = np.sqrt(power[at - 1 : at + 2])
    bend = before - 2.0 * middle + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(order[at] + np.clip(shift, -0.5, 0.5) * (order[1] - order[0]))
