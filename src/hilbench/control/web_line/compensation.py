"""Compensation of what turns with the rollers around a span, by the velocity of the axis before it.

A disturbance of order n of a roller's angle φ makes the tension swing as Re(D·e^{inφ}). A command Re(C·e^{inφ}) beside
the tension loop adds G·C, G the response of the closed loops at ω = n·φ'. With a disturbance Z in its own unit (of an
eccentric roller metres, of a ripple N·m) and its response B, D = B·Z:

    C = −(B/G)·Z,        Z ← Z + μ·F/B        after a turn in which F was left

So Z is what is known, or learned turn by turn, and stays at another speed. F comes from one of two balances:

    F = Σ (i/r)·τ − iω·Σ m·v      of the rollers behind the span: sees eccentricity, which no encoder does; takes a
                                  ripple of their torque for tension
    F = (E·S/L)·(v2 − v1)/(iω + v/L)  mass conservation: sees what rollers do, whatever their torques are
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor, log, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Reals2, Reals3, compiled, interpreted, record_type
from hilbench.control.web_line.feed_forward import lead_m_s

#: Share of what is left that a change takes away, of the first ones (against an error of the response of 60°), and of
#: later ones: noise is learned less.
_LEARNS_MOST, _LEARNS_LEAST = 0.6, 0.1
#: Turns over which the swing without compensation is averaged at most; a turn's own is as near to it if it lasts.
_AVERAGED, _LASTS = 8, 0.5
#: Swing relative to that without compensation from which it makes things worse, and down to which it is to come.
_WORSE, _HELPS = 1.1, 0.8
#: What is known, and right, leaves less of it; where more of it comes back it is learned as fast as at first.
_KNOWN_LEAVES, _ANEW = 0.5, 0.5
#: Share of the limit up to which more is learned.
_OF_LIMIT = 0.999
#: Turns in a row that are worse until it is taken back; turns after a change of which the first is not learned from.
_WORSE_TURNS, _TURNS_PER_CHANGE = 2, 2
#: Changes after which it is to help; how often it is tried.
_CHANGES, _TRIALS = 8, 3
#: Mean speeds of two turns of a steady line differ by less than this share.
_STEADY = 2e-3

#: A turn of the roller before the span: angle at its start, cycles and sums, and of the last turns means and the trend.
TURN = record_type(
    *("radius_m", "limit_m_s", "start_rad", "cycles", "is_steady", "force_N", "momentum_Ns"),
    *("mean_force_N", "mean_momentum_Ns", "before_N", "trend_N"),
)
#: An order of the angle of a roller, behind the span or before it; sums of a turn by cosine and sine, of force and
#: momentum what deviates from the last means.
ORDER = record_type(
    *("order", "radius_m", "behind"),
    *("force_c", "force_s", "momentum_c", "momentum_s", "stretch_c", "stretch_s"),
)
#: Speeds of the tables of commands, evenly in their logarithm: below the first nothing is compensated.
LEAST_M_S, MOST_M_S, SPEEDS = 0.05, 50.0, 64
_PER_SPEED = (SPEEDS - 1) / log(MOST_M_S / LEAST_M_S)
#: Speed up to which dry friction grows: while a roller sticks none is led.
_STICKS_M_S = 0.01
Complexes = NDArray[np.complex128]


@compiled
def _at(speed_m_s: float) -> float:
    """Place of a speed in the tables."""
    return log(min(max(speed_m_s, LEAST_M_S), 0.999 * MOST_M_S) / LEAST_M_S) * _PER_SPEED


@compiled
def begin_turn(t: Any, orders: Any, angle_rad: float) -> None:
    """Begin a turn: no sums yet."""
    t.start_rad, t.cycles, t.force_N, t.momentum_Ns = angle_rad, 0.0, 0.0, 0.0
    for k in range(len(orders)):
        o = orders[k]
        o.force_c = o.force_s = o.momentum_c = o.momentum_s = o.stretch_c = o.stretch_s = 0.0


@compiled
def compensate(
    t: Any, orders: Any, commands: Reals3, x1_m: float, x2_m: float, speed_m_s: float, seen: tuple[float, float, float]
) -> float:
    """Correction of the velocity before the span, from the positions at its ends, m/s; sums up what is `seen` in this
    cycle: force and momentum of the rollers behind the span, and how fast it is stretched.

    `commands` (orders, `SPEEDS`, 2): amplitudes by cosine and sine. Zero in reverse and near standstill.
    """
    if not LEAST_M_S <= speed_m_s < MOST_M_S:
        begin_turn(t, orders, x1_m / t.radius_m)
        t.mean_momentum_Ns = 0.0
        return 0.0
    force_N, momentum_Ns, stretch_m_s = seen
    t.cycles += 1.0
    t.force_N += force_N
    t.momentum_Ns += momentum_Ns
    at, correction_m_s = floor(_at(speed_m_s)), 0.0
    share = _at(speed_m_s) - at
    for k in range(len(orders)):
        o = orders[k]
        angle_rad = o.order * (x1_m if o.behind == 0.0 else x2_m) / o.radius_m
        c, s = cos(angle_rad), sin(angle_rad)
        low, high = commands[k, at], commands[k, at + 1]
        correction_m_s += c * (low[0] + share * (high[0] - low[0])) - s * (low[1] + share * (high[1] - low[1]))
        o.force_c += c * (force_N - t.mean_force_N)
        o.force_s += s * (force_N - t.mean_force_N)
        o.momentum_c += c * (momentum_Ns - t.mean_momentum_Ns)
        o.momentum_s += s * (momentum_Ns - t.mean_momentum_Ns)
        o.stretch_c += c * stretch_m_s
        o.stretch_s += s * stretch_m_s
    return float(min(max(correction_m_s, -t.limit_m_s), t.limit_m_s))


@compiled
def end_turn(t: Any, angle_rad: float) -> bool:
    """Say if a turn is complete, and whether the speed was even in it."""
    if abs(angle_rad - t.start_rad) < 2.0 * pi:
        return False
    force_N, momentum_Ns = t.force_N / t.cycles, t.momentum_Ns / t.cycles
    t.is_steady = 1.0 if abs(momentum_Ns - t.mean_momentum_Ns) < _STEADY * momentum_Ns else 0.0
    t.trend_N, t.before_N = min(abs(force_N - t.mean_force_N), abs(force_N - t.before_N)), t.mean_force_N
    t.mean_force_N, t.mean_momentum_Ns = force_N, momentum_Ns
    return True


@compiled
def friction_lead_m_s(rollers: Any, frictions_N: Reals2, speed_m_s: float) -> float:
    """Lead of the command before the span over the one behind it for the friction of the rollers at its ends, `ROLLER`
    (2,): their drives hold a constant one, and give way while it changes. `frictions_N` (2, `SPEEDS`)."""
    at, part, found_m_s = floor(_at(abs(speed_m_s))), min(max(speed_m_s / _STICKS_M_S, -1.0), 1.0), 0.0
    share = _at(abs(speed_m_s)) - at
    for k in range(len(rollers)):
        friction_N = part * (frictions_N[k, at] + share * (frictions_N[k, at + 1] - frictions_N[k, at]))
        found_m_s += (1.0 - 2.0 * k) * lead_m_s(rollers[k], 0.0, friction_N)
    return found_m_s


_place = interpreted(_at)


def by_speed(table: Complexes, speed_m_s: float) -> complex:
    """Value of a table at a speed."""
    return complex(np.interp(_place(speed_m_s), np.arange(SPEEDS), table))


@dataclass
class Compensated:
    """What is compensated at one order: `gain` and `response` are G in N per m/s and B in N per unit, by speed; `known`
    is D in N, by speed, of what the model knows; `least_N`: swing below which nothing is done."""

    gain: Complexes
    response: Complexes
    known: Complexes
    besides_N: complex  #: what turns with the roller behind the span as well, known: of its unbalance
    limit_m_s: float
    least_N: float
    learned: complex = 0.0  #: Z beyond what is known
    is_on: bool = False
    trials: int = 0
    before: complex = 0.0  #: swing without compensation, N
    before_m_s: float = 1.0  #: and the line's speed then
    changes: int = 0
    turns: int = 0  #: since the last change
    worse: int = 0  #: turns in a row
    swing_N: float = 0.0  #: of the last turn,
    without_N: float = 0.0  #: and what it would be without compensation

    @property
    def command(self) -> Complexes:
        """Amplitude of the command by speed, m/s, within the limit."""
        wanted = -(self.known + self.learned * self.response) / self.gain
        found: Complexes = wanted * np.minimum(1.0, self.limit_m_s / np.maximum(np.abs(wanted), LEAST_M_S * 1e-9))
        return found if self.is_on else 0.0 * found

    def take(self, left_N: complex, trend_N: float, speed_m_s: float) -> str:
        """Take the swing of a turn at an even speed; one that has more of a trend than of a swing is none. Returns "",
        or what became of the compensation: "on", "helps", "wrong" (what is known), "worse" or "useless"."""
        self.swing_N, response = abs(left_N), by_speed(self.response, speed_m_s)
        if trend_N > max(self.swing_N, self.least_N) or not np.isfinite(by_speed(self.gain, speed_m_s)):
            return ""
        self.turns += 1
        if not self.is_on:
            return self._observe(left_N, speed_m_s)
        self.without_N = abs(self.before * response / by_speed(self.response, self.before_m_s))
        is_tried = self.changes == 0 and bool(np.any(self.known))
        share = _KNOWN_LEAVES if is_tried else _WORSE
        if self.swing_N > max(share * self.without_N, self.least_N + (0.0 if is_tried else self.without_N)):
            self.worse += 1
            return self._off("wrong" if is_tried else "worse") if self.worse >= _WORSE_TURNS else ""
        self.worse = 0
        if self.turns < _TURNS_PER_CHANGE:
            return ""
        if self.changes == _CHANGES - 1 and self.swing_N > _HELPS * self.without_N:
            self.trials = _TRIALS
            return self._off("useless")
        if self.changes >= _CHANGES and self.swing_N > _ANEW * self.without_N:
            self.changes = 1
        self._learn(left_N, speed_m_s)
        if self.changes != _CHANGES:
            return ""
        self.trials = 0
        return "helps"

    def _observe(self, left_N: complex, speed_m_s: float) -> str:
        """Take a swing without compensation: begin with it where it is large, or known."""
        self.before += (left_N - self.before) / min(self.turns, _AVERAGED)
        self.before_m_s = speed_m_s
        known, lasts = bool(np.any(self.known)), abs(left_N - self.before) < _LASTS * abs(self.before)
        if self.turns < _TURNS_PER_CHANGE or self.trials >= _TRIALS:
            return ""
        if not (known or (lasts and abs(self.before) > self.least_N)):
            return ""
        self.is_on, self.trials, self.changes, self.worse, self.turns = True, self.trials + 1, 0, 0, 0
        if not known:
            self._learn(left_N, speed_m_s)
        return "on"

    def _learn(self, left_N: complex, speed_m_s: float) -> None:
        """Take a share of what is left away, as far as the limit lets it act at this speed."""
        share = max(_LEARNS_LEAST, min(_LEARNS_MOST, 2.0 / (1.0 + self.changes)))
        learned = self.learned + share * left_N / by_speed(self.response, speed_m_s)
        before, self.learned = self.learned, learned
        if abs(by_speed(self.command, speed_m_s)) > _OF_LIMIT * self.limit_m_s:
            self.learned = before
        self.changes, self.turns = self.changes + 1, 0

    def _off(self, why: str) -> str:
        self.is_on, self.learned, self.before, self.turns = False, 0.0, 0.0, 0
        self.known = np.zeros(SPEEDS, complex)
        return why
