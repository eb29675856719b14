"""The tension loops as one linear sampled system: stability and margins.

Deviations from the steady state, at the web: all axes with their velocity PI (sampled) and current loop, the load
motors that emulate the web with their delay and prediction, the twin's simulation of the axes and of the web, and the
bench's tension controllers with their active damping, each at the instants at which it acts. One bus cycle is one
matrix, built exactly (matrix exponentials between the drives' samples). Not included: limits, friction, changes of E
by the synchronizer meanwhile (the estimate is a given number), noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import exp, inf, log, pi

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Matrix
from hilbench.bench.tasks.emulated_web import emulated_web
from hilbench.bench.tasks.web_entering_strain import strains_around
from hilbench.compiled import record_at
from hilbench.control.web_line.swing_damping import SwingDamping, SwingPlant
from hilbench.control.web_line.tension import CONTROLLER, gains_at, tension_controller
from hilbench.plant.matrix_exponential import matrix_exponential
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.emulation import lead_s
from hilbench.topology.config import BenchConfig

#: A current loop is never faster than this in the model (an ideal one would make the matrices singular).
_FASTEST_S = 1e-6
#: Growth per second below which a mode counts as one that stays (standstill is possible at any angle).
_STAYS_PER_S = 0.05
_LOWEST_RAD_S, _POINTS = 0.5, 600


#: E of each span.
Moduli = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """Operating point of the loop: the true web, the line speed, and the twin's estimate of E; a value per span."""

    moduli_Pa: Moduli
    line_speed_m_s: float
    length_factors: tuple[float, ...]  #: of the emulated spans, relative to the load model's
    estimates_Pa: Moduli


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins at an operating point. `gain`: factor by which the loop gain may grow or fall until it is
    unstable; inf where it never is. `phase_deg`: 180 where the gain never is 1."""

    gain: float
    phase_deg: float


def state_names(config: BenchConfig, under_way: Mapping[int, int]) -> list[str]:
    """Names of the states: axes and spans by their numbers, load motors by that of their axis.

    `under_way`: by controlled span, number of damping commands kept. Speeds, forces, integrals of the drives,
    forces of load motors, travel since the last SYNC, tensions of the emulated web at it; the same in the twin;
    commands that act, and those under way; states of controllers and damping.
    """
    axes, spans = range(1, config.shape.axes + 1), range(1, config.shape.spans + 1)
    names = [f"{quantity}{k}{of}" for of in ("", "_sim") for k in axes for quantity in "vfi"]
    names += [f"way{k}" for k in axes]
    names += [f"web{j}{of}" for of in ("", "_sim") for j in spans]
    names += [f"u{k}{when}" for k in axes[:-1] for when in ("", "_next")]
    names += [f"load{k}{what}" for k in config.loaded_axes for what in ("", "_set", "_next")]
    names += [f"{quantity}{j}" for j in config.tension_controls for quantity in ("integral", "elongation")]
    return names + [f"sent{j}_{n}" for j, count in under_way.items() for n in range(count)]


@dataclass(frozen=True)
class TensionLoop:
    """The loops of one bench at one operating point. `closed`: on the twin; else the axes hold their speeds, damped."""

    config: BenchConfig
    point: OperatingPoint
    closed: bool = True
    _places: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = state_names(self.config, {span: len(each.pending) // 2 for span, each in self._damping.items()})
        object.__setattr__(self, "_places", {name: n for n, name in enumerate(names)})

    @cached_property
    def margins(self) -> Margins:
        """The least margins of the controlled spans, each at the velocity command of the axis before it, where its loop
        has one signal only, with the others closed."""
        found = [self._margins_of(span) for span in self.config.tension_controls]
        return Margins(min(margins.gain for margins in found), min(margins.phase_deg for margins in found))

    def _margins_of(self, span: int) -> Margins:
        cycle_s = self.config.cycle_time_s
        omega = np.geomspace(_LOWEST_RAD_S, pi / cycle_s, _POINTS)
        response = self._return_ratio(f"u{span}_next", omega)
        size, angle = np.abs(response), np.angle(-response)  # 0 where 1 + L could vanish
        crossing = (np.sign(response.imag[1:]) != np.sign(response.imag[:-1])) & (response.real[1:] < 0.0)
        gains = np.maximum(size[1:][crossing], 1.0 / size[1:][crossing])
        at_one = np.sign(size[1:] - 1.0) != np.sign(size[:-1] - 1.0)
        phases = np.degrees(np.abs(angle[1:]))[at_one]
        return Margins(float(np.min(gains, initial=inf)), float(np.min(phases, initial=180.0)))

    @cached_property
    def growth_per_s(self) -> float:
        """Growth rate of the slowest mode; below zero where all decay."""
        sizes = np.abs(np.linalg.eigvals(self._cycle @ self._sync()))
        return log(max(float(np.max(sizes)), 1e-12)) / self.config.cycle_time_s

    @property
    def stable(self) -> bool:
        """True if no mode grows."""
        return self.growth_per_s < _STAYS_PER_S

    # -- what is in it -----------------------------------------------------------------------------------

    @cached_property
    def _lengths_m(self) -> dict[int, float]:
        """Lengths of the emulated spans."""
        web = emulated_web(self.config.web_line, self.config.load)
        return {j: web.span_length_m(j) * self.point.length_factors[j - 1] for j in range(1, web.span_count + 1)}

    def _stiffness_N_per_m(self, span: int) -> float:
        return self.point.moduli_Pa[span - 1] * self.config.web_line.section_m2(span) / self._lengths_m[span]

    @cached_property
    def _damping(self) -> dict[int, SwingDamping]:
        """Damping by controlled span."""
        config, found = self.config, {}
        for span, control in config.tension_controls.items():
            plant = SwingPlant.of_model(config.web_line, config.cycle_time_s, span, strains_around(config, span))
            found[span] = SwingDamping(plant, control.swing_damping_ratio, self.point.estimates_Pa[span - 1])
        return found

    def _unit(self, name: str) -> Matrix:
        row = np.zeros(len(self._places))
        row[self._places[name]] = 1.0
        return row

    @cached_property
    def _cycle(self) -> Matrix:
        """Transition matrix from just after a SYNC to just before the next one."""
        sample_s = self.config.drive_parameters.sample_time_s
        samples = max(1, round(self.config.cycle_time_s / sample_s))
        return np.asarray(np.linalg.matrix_power(self._drive_sample(sample_s), samples))

    def _drive_sample(self, sample_s: float) -> Matrix:
        """Velocity loops at their sample, then motion and current loops for its time."""
        at, size, count = self._places, len(self._places), self.config.shape.axes
        model, drives, axes = self.config.web_line, self.config.drive_parameters, range(1, count + 1)
        loops, rates = np.eye(size), np.zeros((size + 2 * count, size + 2 * count))
        held = np.zeros((size + 2 * count, size))
        for number, (k, of) in enumerate((k, of) for of in ("", "_sim") for k in axes):
            v, f, i, squared = f"v{k}{of}", f"f{k}{of}", f"i{k}{of}", model.motor_rad_per_m(k) ** 2
            current_loop_s = max(per_item(drives.current_loop_time_constant_s, k), _FASTEST_S)
            error = -self._unit(v) + (self._unit(f"u{k}") if k < count else 0.0)
            ki_N_per_m = per_item(drives.velocity_ki_Nm_per_rad, k) * squared
            loops[at[i]] = self._unit(i) + ki_N_per_m * sample_s * error
            held[size + number] = loops[at[i]] + per_item(drives.velocity_kp_Nm_s_per_rad, k) * squared * error
            rates[at[f], [at[f], size + number]] = -1.0 / current_loop_s, 1.0 / current_loop_s
            rates[at[v], at[f]] = 1.0 / model.mass_kg(k)
        for motor, k in zip(self.config.load_motors.values(), self.config.loaded_axes, strict=True):
            load_s = max(motor.motor.current_loop_time_constant_s, _FASTEST_S)
            rates[at[f"load{k}"], [at[f"load{k}"], at[f"load{k}_set"]]] = -1.0 / load_s, 1.0 / load_s
            rates[at[f"v{k}"], at[f"load{k}"]] = 1.0 / model.mass_kg(k)
        for k in axes:
            rates[at[f"way{k}"], at[f"v{k}"]] = 1.0
        self._add_simulated_web(rates)
        held[:size] = loops
        return np.asarray((matrix_exponential(rates * sample_s) @ held)[:size])

    def _add_simulated_web(self, rates: Matrix) -> None:
        """Add the twin's spans: pull on the axes, stretch by their speeds; strain is carried with the web."""
        at, model = self._places, self.config.web_line
        for j in range(1, model.span_count + 1):
            web, length_m = f"web{j}_sim", model.span_length_m(j)
            for k, sign in ((j, 1.0), (j + 1, -1.0)):
                if model.carries_web_load(k):
                    rates[at[f"v{k}_sim"], at[web]] = sign / model.mass_kg(k)
            believed = self.point.estimates_Pa[j - 1] * model.section_m2(j) / length_m
            rates[at[web], at[web]] = -self.point.line_speed_m_s / length_m
            rates[at[web], [at[f"v{j + 1}_sim"], at[f"v{j}_sim"]]] = believed, -believed
            if j > 1:
                rates[at[web], at[f"web{j - 1}_sim"]] = self.point.line_speed_m_s / length_m

    def _sync(self, *, opened: str = "") -> Matrix:
        """Transition at SYNC: new commands act, the next ones follow from measurements, except the command `opened`."""
        config, cycle_s = self.config, self.config.cycle_time_s
        model, tick, at = config.web_line, np.eye(len(self._places)), self._places
        count = model.axis_count
        for k in range(1, count):
            tick[at[f"u{k}"]] = self._unit(f"u{k}_next")
        webs = self._webs(cycle_s, {j: self._unit(f"web{j}") for j in range(1, count)})
        if config.loaded_axes:
            ahead = self._webs(lead_s(model, cycle_s), webs)
            for k in config.loaded_axes:
                tick[at[f"load{k}_set"]] = self._unit(f"load{k}_next")
                pull = ahead.get(k, 0.0) - ahead.get(k - 1, 0.0) if model.carries_web_load(k) else 0.0
                tick[at[f"load{k}_next"]] = pull
        transfer = config.twin.transfer
        for j, web in webs.items():
            tick[at[f"web{j}"]] = web
            if transfer.strain:
                tick[at[f"web{j}_sim"]] = self.point.estimates_Pa[j - 1] / self.point.moduli_Pa[j - 1] * web
        for k in range(1, count + 1):
            tick[at[f"way{k}"]] = 0.0
            if transfer.axes:
                tick[at[f"v{k}_sim"]] = self._unit(f"way{k}") / cycle_s
        for name, row in self._commands(webs).items():
            tick[at[name]] = row if name != opened else 0.0
        return tick

    def _webs(self, duration_s: float, before: Mapping[int, Matrix]) -> dict[int, Matrix]:
        """Tensions of the emulated web `duration_s` after those `before`, by the travel since the last SYNC: rollers
        continue as in that cycle."""
        share, found = duration_s / self.config.cycle_time_s, {}
        for j, web in before.items():
            moved = self.point.line_speed_m_s * duration_s / self._lengths_m[j]
            left = exp(-moved)
            # Tension per length that is drawn evenly while the web moves on.
            pull = self._stiffness_N_per_m(j) * ((1.0 - left) / moved if abs(moved) > 1e-9 else 1.0)
            entering = (1.0 - left) * before[j - 1] if j > 1 else 0.0
            travels = (self._unit(f"way{j + 1}") - self._unit(f"way{j}")) * share
            found[j] = left * web + entering + pull * travels
        return found

    def _commands(self, webs: Mapping[int, Matrix]) -> dict[str, Matrix]:
        """Commands that the bench computes from the answers to this SYNC, from the leading axis on."""
        config, cycle_s = self.config, self.config.cycle_time_s
        controls, rows = config.tension_controls, {}
        # Of the axis after the span: its speed without what it damps, and its command.
        speed = command = np.zeros(len(self._places))
        for j in range(config.shape.spans, 0, -1):
            if j in controls:
                gains, pending = self._damping[j].record, self._damping[j].pending[::2]
                rate = (webs[j] - self._unit(f"web{j}")) / (cycle_s * self._stiffness_N_per_m(j))
                elongation = exp(-gains.washout_per_s * cycle_s) * self._unit(f"elongation{j}") + rate * cycle_s
                damping = gains.rate * rate + gains.elongation_per_s * elongation
                for n, gain in enumerate(pending):
                    damping = damping + gain * self._unit(f"sent{j}_{n}")
                rows[f"elongation{j}"] = elongation
                for n in range(len(pending)):
                    rows[f"sent{j}_{n}"] = self._unit(f"sent{j}_{n - 1}") if n else damping
            ahead = j in controls and controls[j].feed_forward == "twin"
            if ahead:
                speed = command + self._by_entering_strain(j)
            if j in controls and self.closed:
                of = controls[j].bandwidth_rad_per_s, controls[j].correction_limit_m_s
                controller = tension_controller(*of, config.web_line, j, strains_around(config, j))
                c = record_at(controller, CONTROLLER)
                kp, ki = gains_at(c, self.point.line_speed_m_s, self.point.estimates_Pa[j - 1])
                error = -self._unit(f"web{j}_sim")
                rows[f"integral{j}"] = self._unit(f"integral{j}") + ki * cycle_s * error
                speed = speed - kp * error - rows[f"integral{j}"]
            if j in controls:
                command = speed + damping
            rows[f"u{j}_next"] = command
        return rows

    def _by_entering_strain(self, span: int) -> Matrix:
        """Feed-forward of a span from the strain in the span before it."""
        if span == 1 or not self.closed:
            return np.zeros(len(self._places))
        stiffness_N = self.point.estimates_Pa[span - 2] * self.config.web_line.section_m2(span - 1)
        return self.point.line_speed_m_s / stiffness_N * self._unit(f"web{span - 1}_sim")

    def responses(self, span: int, omega: float) -> NDArray[np.complex128]:
        """Tension of the emulated span at a frequency, N, as its encoders show it: per m/s added to the command of the
        axis before it, per N at that axis and at the one after it, per N of a tension that the encoders do not show,
        and per N of it that the twin knows."""
        model, cycle_s = self.config.web_line, self.config.cycle_time_s
        pushed = [self._unit(f"v{axis}") * (cycle_s / model.mass_kg(axis)) for axis in (span, span + 1)]
        pulled = np.zeros(len(self._places), complex)
        for axis, sign in ((span, 1.0), (span + 1, -1.0)):
            if axis in self.config.loaded_axes and model.carries_web_load(axis):
                pulled += sign * np.exp(1j * omega * lead_s(model, cycle_s)) * self._unit(f"load{axis}_next")
        known, z = self._unit(f"web{span}_sim"), np.exp(1j * omega * cycle_s)
        entries = self._cycle @ np.transpose([self._unit(f"u{span}_next"), *pushed, pulled, known])
        entries[:, -1] += (z - exp(-self.point.line_speed_m_s * cycle_s / model.span_length_m(span))) * known
        states = np.linalg.solve(z * np.eye(len(entries)) - self._cycle @ self._sync(), entries)
        return np.asarray(self._sync()[self._places[f"web{span}"]] @ states)

    def _return_ratio(self, command: str, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """L(jω) of the loop opened at a command; 1 + L = 0 is the border of stability."""
        opened, row = self._cycle @ self._sync(opened=command), self._sync()[self._places[command]]
        entry = self._cycle @ self._unit(command)
        z = np.exp(1j * omega * self.config.cycle_time_s)
        matrices = z[:, None, None] * np.eye(len(entry)) - opened
        states = np.linalg.solve(matrices, np.broadcast_to(entry[:, None], (len(z), len(entry), 1)))[..., 0]
        return np.asarray(-states @ row)
