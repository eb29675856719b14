"""The tension loop as one linear sampled system: how stable it is, and with what margins.

Deviations from the steady state, at the web: both axes with their velocity PI (sampled) and current loop, the load
motor that imitates the web with its delay and prediction, the twin's simulation of both axes and of the web, and the
bench's tension controller with its active damping, each at the instants at which it acts. One bus cycle is one matrix,
built exactly (matrix exponentials between the drives' samples). Not in it: limits, friction, what the synchronizer
does to E meanwhile (the estimate is a given number), noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import exp, inf, log, pi

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from hilbench.bench.tasks.swing_damping import DampingGains, SwingPlant, damping_gains
from hilbench.bench.tasks.tension_control import TensionController
from hilbench.plant.parameters import per_item
from hilbench.plant.sampled_shaft import imitation_delay_s
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stability import sampled_shaft
from hilbench.topology.config import BenchConfig

Matrix = NDArray[np.float64]

#: A current loop is never faster than this in the model (an ideal one would make the matrices singular).
_FASTEST_S = 1e-6
#: Growth per second below which a mode counts as one that stays (standstill is possible at any angle).
_STAYS_PER_S = 0.05
_LOWEST_RAD_S, _POINTS = 0.5, 600

_STATES = (
    *("v1", "f1", "i1", "v2", "f2", "i2", "load"),  # speeds, forces of the drives and of the load motor, integrals
    *("way1", "way2", "web"),  # ways since the last SYNC, tension of the imitated web at it
    *("v1_sim", "f1_sim", "i1_sim", "v2_sim", "f2_sim", "i2_sim", "web_sim"),  # the same in the twin
    *("u1", "u1_next", "load_set", "load_next"),  # commands that act, and those on their way
    *("integral", "elongation"),  # of the controller and of the damping
)
_AXES = (("v1", "f1", "i1", "u1"), ("v2", "f2", "i2", ""))
_SIMULATED = (("v1_sim", "f1_sim", "i1_sim", "u1"), ("v2_sim", "f2_sim", "i2_sim", ""))


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """Where the loop is looked at: the true web, the line speed, and the E that the twin believes."""

    youngs_modulus_Pa: float
    line_speed_m_s: float
    span_length_m: float
    estimate_Pa: float


@dataclass(frozen=True, slots=True)
class Margins:
    """Of one operating point. `gain`: factor by which the loop's gain may grow or fall before it is unstable; inf
    where it never is. `phase_deg`: 180 where the gain never is 1. `growth_per_s`: of the slowest mode, below zero
    where all decay."""

    gain: float
    phase_deg: float
    growth_per_s: float


@dataclass(frozen=True, slots=True)
class _Axis:
    mass_kg: float
    kp_N_s_per_m: float
    ki_N_per_m: float
    current_loop_s: float

    @classmethod
    def of(cls, model: ModelParameters, axis: int) -> _Axis:
        assert model.drives is not None, "a bench's model has drives"
        ratio = model.motor_rad_per_m(axis)
        return cls(
            model.mass_kg(axis),
            per_item(model.drives.velocity_kp_Nm_s_per_rad, axis) * ratio**2,
            per_item(model.drives.velocity_ki_Nm_per_rad, axis) * ratio**2,
            max(per_item(model.drives.current_loop_time_constant_s, axis), _FASTEST_S),
        )


@dataclass(frozen=True)
class TensionLoop:
    """The loop of one bench at one operating point. `closed`: on the twin; else axis 1 holds its speed, damped."""

    config: BenchConfig
    point: OperatingPoint
    closed: bool = True
    _places: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        sent = tuple(f"sent{n}" for n in range(len(self._damping.pending)))
        object.__setattr__(self, "_places", {name: n for n, name in enumerate((*_STATES, *sent))})

    @cached_property
    def margins(self) -> Margins:
        """Margins at the velocity command of axis 1, where the loop has one signal only."""
        cycle_s = self.config.cycle_time_s
        omega = np.geomspace(_LOWEST_RAD_S, pi / cycle_s, _POINTS)
        response = self._return_ratio(omega)
        size, angle = np.abs(response), np.angle(-response)  # 0 where 1 + L could vanish
        crossing = (np.sign(response.imag[1:]) != np.sign(response.imag[:-1])) & (response.real[1:] < 0.0)
        gains = np.maximum(size[1:][crossing], 1.0 / size[1:][crossing])
        at_one = np.sign(size[1:] - 1.0) != np.sign(size[:-1] - 1.0)
        phases = np.degrees(np.abs(angle[1:]))[at_one]
        return Margins(float(np.min(gains, initial=inf)), float(np.min(phases, initial=180.0)), self.growth_per_s)

    @cached_property
    def growth_per_s(self) -> float:
        """Of the slowest mode; below zero where all decay."""
        sizes = np.abs(np.linalg.eigvals(self._cycle @ self._sync(feedback=True)))
        return log(max(float(np.max(sizes)), 1e-12)) / self.config.cycle_time_s

    @property
    def stable(self) -> bool:
        """Whether nothing grows."""
        return self.growth_per_s < _STAYS_PER_S

    def course(self, tension_N: float, duration_s: float) -> NDArray[np.float64]:
        """Tension of the web each cycle, beyond the steady one, after it was off by `tension_N` (n,)."""
        state = np.zeros(len(self._places))
        state[self._places["web"]] = tension_N
        turn, course = self._cycle @ self._sync(feedback=True), []
        for _ in range(round(duration_s / self.config.cycle_time_s)):
            course.append(state[self._places["web"]])
            state = turn @ state
        return np.array(course)

    # -- what is in it -----------------------------------------------------------------------------------

    @property
    def _stiffness_N_per_m(self) -> float:
        point = self.point
        return point.youngs_modulus_Pa * self.config.web_line.required_web.section_m2 / point.span_length_m

    @cached_property
    def _damping(self) -> DampingGains:
        plant = SwingPlant.of_model(self.config.web_line, self.config.cycle_time_s)
        return damping_gains(plant, self.config.tension_control.swing_damping_ratio, self.point.estimate_Pa)

    def _unit(self, name: str) -> Matrix:
        row = np.zeros(len(self._places))
        row[self._places[name]] = 1.0
        return row

    @cached_property
    def _cycle(self) -> Matrix:
        """From just after a SYNC to just before the next one."""
        drives = self.config.web_line.drives
        assert drives is not None, "a bench's model has drives"
        samples = max(1, round(self.config.cycle_time_s / drives.sample_time_s))
        return np.asarray(np.linalg.matrix_power(self._drive_sample(drives.sample_time_s), samples))

    def _drive_sample(self, sample_s: float) -> Matrix:
        """Velocity loops at their sample, then motion and current loops for its time."""
        model, size = self.config.web_line, len(self._places)
        at, axes = self._places, [_Axis.of(model, axis) for axis in (1, 2)]
        load_motor = next(iter(self.config.load_motors.values()))
        loops, rates = np.eye(size), np.zeros((size + 4, size + 4))
        held = np.zeros((size + 4, size))
        for number, (v, f, i, u) in enumerate((*_AXES, *_SIMULATED)):
            axis = axes[number % 2]
            error = -self._unit(v) + (self._unit(u) if u else 0.0)
            loops[at[i]] = self._unit(i) + axis.ki_N_per_m * sample_s * error
            held[size + number] = loops[at[i]] + axis.kp_N_s_per_m * error
            rates[at[f], [at[f], size + number]] = -1.0 / axis.current_loop_s, 1.0 / axis.current_loop_s
            rates[at[v], at[f]] = 1.0 / axis.mass_kg
        load_s = max(load_motor.motor.current_loop_time_constant_s, _FASTEST_S)
        rates[at["load"], [at["load"], at["load_set"]]] = -1.0 / load_s, 1.0 / load_s
        rates[at["v2"], at["load"]] = 1.0 / axes[1].mass_kg
        rates[at["way1"], at["v1"]] = rates[at["way2"], at["v2"]] = 1.0
        if model.carries_web_load(1):
            rates[at["v1_sim"], at["web_sim"]] = 1.0 / axes[0].mass_kg
        if model.carries_web_load(2):
            rates[at["v2_sim"], at["web_sim"]] = -1.0 / axes[1].mass_kg
        span_m = model.span_length_m(1)
        believed = self.point.estimate_Pa * model.required_web.section_m2 / span_m
        rates[at["web_sim"], at["web_sim"]] = -self.point.line_speed_m_s / span_m
        rates[at["web_sim"], [at["v2_sim"], at["v1_sim"]]] = believed, -believed
        held[:size] = loops
        return np.asarray((expm(rates * sample_s) @ held)[:size])

    def _sync(self, *, feedback: bool) -> Matrix:
        """At SYNC: new commands take effect, what was measured becomes the next ones."""
        tick, at = np.eye(len(self._places)), self._places
        tick[at["u1"]], tick[at["load_set"]] = self._unit("u1_next"), self._unit("load_next")
        shaft = sampled_shaft(self.config.web_line, cycle_s=self.config.cycle_time_s)
        web, ahead = self._web_now(self.config.cycle_time_s), imitation_delay_s(shaft)
        loaded = self.config.web_line.carries_web_load(2)
        tick[at["web"]] = web
        tick[at["load_next"]] = -self._web_later(web, ahead) if loaded else 0.0
        tick[at["way1"]] = tick[at["way2"]] = 0.0
        transfer = self.config.twin.transfer
        if transfer.strain:
            tick[at["web_sim"]] = self.point.estimate_Pa / self.point.youngs_modulus_Pa * web
        if transfer.axes:
            for v, way in (("v1_sim", "way1"), ("v2_sim", "way2")):
                tick[at[v]] = self._unit(way) / self.config.cycle_time_s
        for name, row in self._controller(web).items():
            tick[at[name]] = row
        if not feedback:
            tick[at["u1_next"]] = 0.0
        return tick

    def _web_now(self, cycle_s: float) -> Matrix:
        """Tension of the imitated web at this SYNC, by the ways since the last one."""
        left = exp(-self.point.line_speed_m_s * cycle_s / self.point.span_length_m)
        return np.asarray(left * self._unit("web") + self._pull(cycle_s) * (self._unit("way2") - self._unit("way1")))

    def _web_later(self, web: Matrix, ahead_s: float) -> Matrix:
        """The same `ahead_s` later, when the rollers go on as in the last cycle."""
        left = exp(-self.point.line_speed_m_s * ahead_s / self.point.span_length_m)
        ways = (self._unit("way2") - self._unit("way1")) * (ahead_s / self.config.cycle_time_s)
        return np.asarray(left * web + self._pull(ahead_s) * ways)

    def _pull(self, duration_s: float) -> float:
        """Tension per length that is drawn evenly within `duration_s` while the web moves on."""
        moved = self.point.line_speed_m_s * duration_s / self.point.span_length_m
        return self._stiffness_N_per_m * ((1.0 - exp(-moved)) / moved if abs(moved) > 1e-9 else 1.0)

    def _controller(self, web: Matrix) -> dict[str, Matrix]:
        """What the bench computes from the answers to this SYNC."""
        config, cycle_s, gains = self.config, self.config.cycle_time_s, self._damping
        rate = (web - self._unit("web")) / (cycle_s * self._stiffness_N_per_m)
        elongation = exp(-gains.washout_per_s * cycle_s) * self._unit("elongation") + rate * cycle_s
        damping = gains.rate * rate + gains.elongation_per_s * elongation
        for n, gain in enumerate(gains.pending):
            damping = damping + gain * self._unit(f"sent{n}")
        rows = {"elongation": elongation}
        for n in range(len(gains.pending)):
            rows[f"sent{n}"] = self._unit(f"sent{n - 1}") if n else damping
        rows["u1_next"] = damping
        if self.closed:
            kp, ki = TensionController.of_model(config.tension_control, config.web_line).gains(
                self.point.line_speed_m_s, self.point.estimate_Pa
            )
            error = -self._unit("web_sim")
            rows["integral"] = self._unit("integral") + ki * cycle_s * error
            rows["u1_next"] = damping - kp * error - rows["integral"]
        return rows

    def _return_ratio(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """L(jω) of the loop opened at axis 1's command; 1 + L = 0 is the border of stability."""
        opened, command = self._cycle @ self._sync(feedback=False), self._sync(feedback=True)[self._places["u1_next"]]
        entry = self._cycle @ self._unit("u1_next")
        z = np.exp(1j * omega * self.config.cycle_time_s)
        matrices = z[:, None, None] * np.eye(len(entry)) - opened
        states = np.linalg.solve(matrices, np.broadcast_to(entry[:, None], (len(z), len(entry), 1)))[..., 0]
        return np.asarray(-states @ command)
