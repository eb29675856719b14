"""Which effects could be missing: the vocabulary's terms, and for those with an order, frequency or time, which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.terms import Term
from hilbench.plant.effects import EFFECTS, Effect, find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]

#: Stribeck speeds that are tried, as shares of the highest speed.
_STRIBECK_SHARES: Final = (0.01, 0.04, 0.15)
#: Strengths at which an effect is looked at that is far from linear in it: a delay (s).
_PROBES: Final = {"torque_delay": (0.001, 0.003, 0.01, 0.03)}
#: Peaks of a spectrum, and times of a step, that are proposed.
_PEAKS: Final = 2
#: Lowest order or frequency that is looked for, in cycles over the recording; highest and lowest order of a turn.
_LEAST_CYCLES: Final = 4.0
_HIGHEST_ORDER: Final = 64.0
_LEAST_SHARE_OF_A_TURN: Final = 0.5  #: of the roller's
_HIGHEST_ORDER_OF_A_SCREW: Final = 1e4
#: Times of a step that are simulated at first, and among how many that can be told apart it was chosen.
_COARSE: Final = 24
_TIMES: Final = 100.0
#: A step's time is looked for this far from the ends, as a share of the recording.
_EDGE: Final = 0.03
_SEARCHED: Final = ("torque_ripple", "elasticity_step", "elasticity_ramp", "upstream_disturbance")
_TURN = 2.0 * np.pi
#: How far from a spectrum's peak the order or frequency is looked for, in steps, and the step in the spectrum's bins.
_NEAR: Final = 40
_NEAR_STEP: Final = 0.25


class Proposer:
    """Makes terms for one model and recording."""

    def __init__(self, model: ModelParameters, data: Measured) -> None:
        self._model = model
        self._data = data
        self._axes = range(1, model.axis_count + 1)
        speeds = [np.abs(v) for v in data.v_m_s.values()] + [np.abs(data.commands_m_s).ravel()]
        if data.commands_m_s.size == 0 and not data.v_m_s:
            speeds.append(np.abs(np.diff(data.x_m[1])) / data.period_s)
        self._top_m_s = max((float(np.max(v)) for v in speeds if v.size), default=1.0)

    def _term(
        self, effect: Effect, axis: int | None, values: Mapping[str, float], slot: int = 0, multiplicity: float = 1.0
    ) -> Term:
        base = effect.filled({})
        entries = [
            e for e in self._model.effects if (e.effect, e.axis if effect.per_axis else None) == (effect.id, axis)
        ]
        if slot < len(entries):
            base = effect.filled(entries[slot].parameters)
        duration_s = self._data.duration_s
        steps = {
            "speed_m_s": 0.02 * values.get("speed_m_s", 1.0),
            "time_s": 2.0 * self._data.period_s,
            "duration_s": 0.02 * values.get("duration_s", 1.0),
            "frequency_Hz": 0.02 / duration_s,
            "order": 0.1 / max(self._turns(axis) * _TURN, 1.0),
        }
        least = {"frequency_Hz": _LEAST_CYCLES / duration_s, "order": self._least_order(axis)}
        return Term(effect, axis, slot, {**base, **values}, base, steps, multiplicity, least=least)

    def _least_order(self, axis: int | None) -> float:
        """Of a torque ripple: some of its periods are in the recording, and on a machine it comes from what turns."""
        least = _LEAST_CYCLES / max(self._turns(axis), 1e-9)
        if axis is None or self._model.web is None:
            return least
        return max(least, _LEAST_SHARE_OF_A_TURN / self._model.gear_ratio(axis))

    def _entries(self, effect: Effect, axis: int | None) -> list[EffectEntry]:
        """What the diagnosed model has of an effect at a place."""
        return [e for e in self._model.effects if (e.effect, e.axis if effect.per_axis else None) == (effect.id, axis)]

    def _turns(self, axis: int | None) -> float:
        if axis is None or axis not in self._data.x_m:
            return 1.0
        return float(np.ptp(self._data.x_m[axis])) * self._model.motor_rad_per_m(axis) / _TURN

    def plain(self) -> list[Term]:
        """Every effect that needs no search, at every place it can be."""
        terms = []
        for effect in EFFECTS:
            if effect.id in _SEARCHED or not (effect.per_axis or self._model.web):
                continue
            for axis in self._axes if effect.per_axis else (None,):
                if effect.id == "stribeck_friction":
                    speeds = [share * self._top_m_s for share in _STRIBECK_SHARES]
                    terms += [self._term(effect, axis, {"speed_m_s": v}, multiplicity=len(speeds)) for v in speeds]
                elif effect.id in _PROBES:
                    plain, probes = self._term(effect, axis, {}), _PROBES[effect.id]
                    terms += [replace(plain, probe=probe, multiplicity=len(probes)) for probe in probes]
                elif self._possible(effect, axis):
                    terms.append(self._term(effect, axis, {}))
        return terms

    def _possible(self, effect: Effect, axis: int | None) -> bool:
        if effect.id != "backlash" or axis is None:
            return True
        return self._model.motor_mass_kg(axis) > 0.0 and self._model.roller_mass_kg(axis) > 0.0

    def searched(self, whitened: dict[str, Array], present: list[Term], every: int) -> list[Term]:
        """Orders and frequencies at which the whitened residuals, by signal (n,), show something.

        Torques have the sharper peaks, positions the stronger ones. `every`: rows of the recording per row.
        """
        terms = []
        for axis in self._axes:
            if axis in self._data.x_m and axis in self._data.tau_Nm:
                terms += self._ripples(whitened, axis, present, every)
        if self._model.web is not None:
            terms += self._disturbances(whitened, present)
        return terms

    def tuned(self, term: Term, residual: Array, response: Array, every: int) -> Term:
        """The term with the order or frequency near its own at which its response fits best.

        residual (signals, n) and response (2, signals, n) whitened, zero where rows do not count. How strongly and how
        late a machine answers changes with its speed, which moves a spectrum's peak; the response knows of it, and
        turned along the angle (or time) it stands for the orders nearby.
        """
        name, angle = self._angle_rad(term, every)
        if name is None:
            return term
        sine, cosine = response
        shifts = np.arange(-_NEAR, _NEAR + 1) * _NEAR_STEP * _TURN / float(np.ptp(angle))
        turn = np.exp(1j * shifts[:, None] * angle[None, :])
        forward, across = np.sum(sine * residual, axis=0), np.sum(cosine * residual, axis=0)
        b = turn @ (across + 1j * forward)  # along the turned cosine and sine
        even = 0.5 * float(np.sum(sine**2 + cosine**2))
        odd = turn**2 @ (0.5 * np.sum(cosine**2 - sine**2, axis=0) + 1j * np.sum(sine * cosine, axis=0))
        a11, a22, a12 = even + odd.real, even - odd.real, odd.imag
        possible = term.values[name] + shifts >= term.least[name]
        gain = (a22 * b.real**2 - 2.0 * a12 * b.real * b.imag + a11 * b.imag**2) / np.maximum(
            a11 * a22 - a12**2, 1e-12 * even**2 + 1e-300
        )
        best = int(np.argmax(np.where(possible, gain, -np.inf)))
        return replace(term, values={**term.values, name: term.values[name] + float(shifts[best])})

    def _angle_rad(self, term: Term, every: int) -> tuple[str | None, Array]:
        """What the searched shape of a term multiplies, for each row; None for a term without one."""
        if term.effect.id == "torque_ripple" and term.axis is not None:
            return "order", self._data.x_m[term.axis][::every] * self._model.motor_rad_per_m(term.axis)
        if term.effect.id == "upstream_disturbance":
            return "frequency_Hz", _TURN * self._data.t_s[::every]
        return None, np.empty(0)

    @staticmethod
    def _peaks(
        angle_turns: Array, whitened: dict[str, Array], sharp: list[str], lowest: float, highest: float
    ) -> tuple[list[float], float]:
        """The strongest order in the `sharp` signals, then in all."""
        found, count = peaks(angle_turns, np.array([whitened[name] for name in sharp]), highest, lowest)
        others, _ = peaks(angle_turns, np.array(list(whitened.values())), highest, lowest)
        apart = 1.0 / float(np.ptp(angle_turns))
        return found + [order for order in others[:1] if all(abs(order - known) > apart for known in found)], count

    def step_times_s(self) -> tuple[Array, float]:
        """Times at which it is first looked what a step of E would explain, and how far they are apart, s."""
        times = (_EDGE + (1.0 - 2.0 * _EDGE) * (np.arange(_COARSE) + 0.5) / _COARSE) * self._data.duration_s
        return times, float(times[1] - times[0])

    def steps(self, times_s: Array, present: list[Term]) -> list[Term]:
        """Steps of E at these times, if the model can have another one."""
        effect = find_effect("elasticity_step")
        slot = self._slot(effect, None, present) if self._model.web is not None else None
        if slot is None:
            return []
        return [self._term(effect, None, {"time_s": float(t)}, slot, _TIMES) for t in times_s]

    def ramp(self, time_s: float, duration_s: float, present: list[Term]) -> Term | None:
        """A ramp of E, if the model can have another one."""
        effect = find_effect("elasticity_ramp")
        slot = self._slot(effect, None, present) if self._model.web is not None else None
        if slot is None:
            return None
        return self._term(effect, None, {"time_s": time_s, "duration_s": duration_s}, slot, _TIMES * _COARSE / 2.0)

    def _slot(self, effect: Effect, axis: int | None, present: list[Term]) -> int | None:
        slot = len(self._entries(effect, axis)) + sum(term.place == (effect.id, axis) for term in present)
        return slot if slot < effect.slots else None

    def _ripples(self, whitened: dict[str, Array], axis: int, present: list[Term], every: int) -> list[Term]:
        effect = find_effect("torque_ripple")
        slot, turns = self._slot(effect, axis, present), self._turns(axis)
        if slot is None or turns < 2.0 * _LEAST_CYCLES:
            return []
        angle = self._data.x_m[axis][::every] * self._model.motor_rad_per_m(axis) / _TURN
        top = _HIGHEST_ORDER
        if self._data.commands_m_s.size == 0:  # a lone axis may be a screw: its turn is not the "motor's" of the model
            top = _HIGHEST_ORDER_OF_A_SCREW
        orders, count = self._peaks(angle, whitened, [f"tau{axis}_Nm"], self._least_order(axis), top)
        return [self._term(effect, axis, {"order": order}, slot, count) for order in orders]

    def _disturbances(self, whitened: dict[str, Array], present: list[Term]) -> list[Term]:
        effect = find_effect("upstream_disturbance")
        slot = self._slot(effect, None, present)
        if slot is None:
            return []
        highest = min(0.4 / self._data.period_s, 100.0)
        torques = [name for name in whitened if name.startswith("tau")]
        lowest = _LEAST_CYCLES / self._data.duration_s
        frequencies, count = self._peaks(self._data.t_s, whitened, torques, lowest, highest)
        return [self._term(effect, None, {"frequency_Hz": f}, slot, count) for f in frequencies]


def peaks(angle_turns: Array, whitened: Array, highest: float, lowest: float = 0.0) -> tuple[list[float], float]:
    """The strongest orders of residuals over an angle (or time), in cycles a turn, and how many were looked at.

    None is below `lowest`, and none has less than some periods within the angle.

    Residuals (signals, n) are summed in bins of the angle, whose Fourier transform is their correlation with every
    order at once; powers of the signals add.
    """
    start, total = float(angle_turns.min()), float(np.ptp(angle_turns))
    bins = 1 << int(np.ceil(np.log2(max(4.0 * highest * total, 16.0))))
    place = np.minimum(((angle_turns - start) / total * bins).astype(int), bins - 1)
    power = np.zeros(bins // 2 + 1)
    for values in whitened:
        power += np.abs(np.fft.rfft(np.bincount(place, weights=values, minlength=bins))) ** 2
    order = np.arange(len(power)) / total
    power[(order < max(lowest, _LEAST_CYCLES / total)) | (order > highest)] = 0.0
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
    left, middle, right = np.sqrt(power[at - 1 : at + 2])
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(order[at] + np.clip(shift, -0.5, 0.5) * (order[1] - order[0]))
