"""The independent line: parameters, what is hidden in it, the experiments it is run through, what its sensors give.

    line = Line(hidden=[effect("coulomb_friction", 2, force_N=4.0)], loops=Loops(kp=(1.2, 0.8)))
    record = line.record("identification", seed=1)
    record.channels["tau2_Nm"], record.truth["F_true_N"]

Effects have the ids, parameters and units of the product's vocabulary; `hysteresis`, `passing_splices` and
`quadratic_drag` are there for what it may not explain. Simulating a minute takes less than a second of CPU.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tests.independent_line import physics as ph

Array = NDArray[np.float64]
Hidden = Mapping[str, Any]

#: Cycle in which commands change, s.
CYCLE_S = 0.002
#: The step of the published experiment: from 8700 to 10500 N/mm².
STEP_OF_E: Hidden = {
    "effect": "elasticity_step",
    "axis": None,
    "parameters": {"time_s": 23.0, "relative_change": 10500.0 / 8700.0 - 1.0},
}
#: Corners of the speed of axis 2: time (share of the recording), speed (m/s); tension steps follow in `_experiment`.
_IDENTIFICATION = (
    (0.0, 0.0), (0.015, 0.0), (0.076, 3.0), (0.215, 3.0), (0.24, 4.0), (0.335, 4.0), (0.38, 1.5), (0.49, 1.5),
    (0.52, 3.0), (0.70, 3.0), (0.77, 0.3), (0.83, 0.3), (0.865, 3.0), (0.94, 3.0), (0.985, 0.0), (1.0, 0.0),
)  # fmt: skip
#: Profiles and their usual lengths, s.
PROFILES: Mapping[str, float] = {"identification": 66.0, "production": 46.0}


def effect(name: str, axis: int | None = None, **parameters: float) -> Hidden:
    """An effect at an axis (None: the web), as a model file writes it."""
    return {"effect": name, "axis": axis, "parameters": parameters}


@dataclass(frozen=True)
class Loops:
    """The drives' loops: factors on the gains that the model file has, by axis, and what else delays."""

    kp: tuple[float, ...] = (1.0, 1.0)
    ki: tuple[float, ...] = (1.0, 1.0)
    lag_s: tuple[float, ...] = (0.001, 0.001)  #: of the current loops
    sample_s: tuple[float, ...] = (0.001, 0.001)
    late_s: tuple[float, ...] = (0.0, 0.0)  #: by which a command is late at a drive
    trapezoidal: bool = False  #: whether they integrate so


class Courses(NamedTuple):
    """What an experiment asks of a line, and what changes in it meanwhile: a value a cycle, (n,)."""

    speed_m_s: Array  #: of axis 2
    tension_N: Array  #: that is wanted
    wander: Array  #: of the speed ratio
    sensor_noise_N: Array  #: of the tension that is controlled
    modulus: Array  #: factor on E
    friction: Array  #: factor on the friction of both rollers


@dataclass(frozen=True)
class Record:
    """Channels as a recording has them, and what only a simulation knows."""

    channels: dict[str, Array]
    truth: dict[str, Array]  #: F_true_N, E_true_Pa, strain; motion and the motors' torques without noise


@dataclass(frozen=True)
class Line:
    """One line. Defaults are those of the published demonstrator's web section; SI."""

    radius_m: float = 0.2
    inertia_kg_m2: float = 1.167
    gear_ratio: float = 5.0
    motor_inertia_kg_m2: float = 0.001
    modulus_Pa: float = 8.7e9
    width_m: float = 0.5
    thickness_m: float = 65e-6
    length_m: float = 1.0
    upstream_N: float = 80.0
    downstream_N: float = 70.0
    kp_Nm_s_per_rad: float = 1.5
    ki_Nm_per_rad: float = 30.0
    limit_Nm: float = 9.0
    top_share: float = 1.0  #: of the profile's speeds
    loops: Loops = field(default_factory=Loops)
    hidden: Sequence[Hidden] = ()
    bristle_N_per_m: float = 2e5  #: stiffness of dry friction before it slides
    noise: float = 1.0  #: factor on the three that follow
    torque_noise_Nm: float = 0.05
    speed_noise_m_s: float = 1e-4
    position_noise_m: float = 3e-7
    encoder_counts: float = 2.0**20  #: per turn of the motor
    row_s: float = 0.002
    jitter_s: float = 0.0  #: standard deviation of when a row is read; both axes are read at once
    without: Sequence[str] = ()  #: channels that are not recorded
    measured_tension_N: float | None = None  #: noise of a tension sensor, if there is one
    controls_force: bool = False  #: the tension is held by a sensor of force; else by the strain at the nominal E
    tension_kp: float = 8.0  #: of its controller: correction of the speed ratio per strain that is missing
    tension_ki_per_s: float = 0.8

    def record(self, profile: str = "identification", seed: int = 0, duration_s: float | None = None) -> Record:
        """Run a profile of `PROFILES` from rest. The same arguments give the same bits."""
        duration_s = PROFILES[profile] if duration_s is None else duration_s
        rng = np.random.default_rng([seed, 17])
        return self._run(self._experiment(profile, duration_s, rng), rng)

    def record_courses(self, courses: Courses, seed: int = 0) -> Record:
        """Run an experiment of one's own from rest. The same arguments give the same bits."""
        return self._run(courses, np.random.default_rng([seed, 17]))

    def _run(self, courses: Courses, rng: np.random.Generator) -> Record:
        """Of several spans `tension_N`, `wander` and `sensor_noise_N` are (K, n)."""
        cycles = len(courses.speed_m_s)
        rows = int(np.floor((cycles - 1) * CYCLE_S / self.row_s + 1e-9)) + 1
        t = np.arange(rows) * self.row_s
        read = t + (np.clip(rng.standard_normal(rows), -3.0, 3.0) * self.jitter_s if self.jitter_s else 0.0)
        read = np.clip(read, 0.0, (cycles - 1) * CYCLE_S)
        axes, ripples = self._axes()
        late = np.stack([np.maximum(read - axis[ph.DELAY_S], 0.0) for axis in axes])
        speed_m_s, *of_spans, modulus, friction = courses
        wanted, wander, noise = (np.atleast_2d(each) for each in of_spans)
        out, webs = ph.run(self._webs(), axes, ripples, speed_m_s, wanted, wander, noise, modulus, friction, read, late)
        record = self._sensed(np.asarray(t, np.float64), out, webs, axes, rng)
        if courses.tension_N.ndim == 1:
            record.channels["F_ref_N"] = np.interp(t, np.arange(cycles) * CYCLE_S, courses.tension_N)
        return record

    def _noise(self, rng: np.random.Generator, rows: int) -> Array:
        """Of positions, speeds and torques of each axis: (3, N, rows)."""
        return rng.standard_normal((3, self.rollers, rows))

    def _sensed(self, t: Array, out: Array, webs: Array, axes: Array, rng: np.random.Generator) -> Record:
        count_m = 2.0 * np.pi * self.radius_m / self.gear_ratio / self.encoder_counts
        channels: dict[str, Array] = {"t_s": np.round(t, 9)}
        truth: dict[str, Array] = {}
        noise = self.noise * self._noise(rng, len(t))
        for k in range(self.rollers):
            command, x, v, torque = out[:, k]
            channels[f"v{k + 1}_cmd_m_s"] = command.copy()
            channels[f"x{k + 1}_m"] = np.round((x + self.position_noise_m * noise[0, k]) / count_m) * count_m
            channels[f"v{k + 1}_m_s"] = np.round(v + self.speed_noise_m_s * noise[1, k], 6)
            torque_Nm = torque + axes[k, ph.OFFSET] + self.torque_noise_Nm * noise[2, k]
            channels[f"tau{k + 1}_Nm"] = np.round(torque_Nm, 4)
            truth |= {
                f"x{k + 1}_true_m": x.copy(),
                f"v{k + 1}_true_m_s": v.copy(),
                f"tau{k + 1}_true_Nm": torque.copy(),
            }
        channels["strain_prev"] = np.full(len(t), self._strain_prev)
        channels["F_next_N"] = np.full(len(t), self.downstream_N)
        for number, (tension, strain, modulus) in zip(self._numbers, webs.swapaxes(0, 1), strict=True):
            truth |= {f"F{number}_true_N": tension.copy(), f"strain{number}": strain.copy()}
            truth[f"E{number}_true_Pa"] = modulus * self.modulus_Pa
            if self.measured_tension_N is not None:
                sensor = self.noise * self.measured_tension_N * rng.standard_normal(len(t))
                channels[f"F{number}_meas_N"] = tension + sensor
        for name in self.without:
            del channels[name]
        return Record(channels, truth)

    @property
    def rollers(self) -> int:
        """Driven ones."""
        return 2

    @property
    def _numbers(self) -> Sequence[str]:
        """Of the spans, as signals have them."""
        return ("",)

    def _webs(self) -> Array:
        """What `physics` knows of the webs, by span."""
        return self._web()[None]

    @property
    def _stiffness_N(self) -> float:
        return self.modulus_Pa * self.width_m * self.thickness_m

    @property
    def _strain_prev(self) -> float:
        return self.upstream_N / self._stiffness_N

    @property
    def model(self) -> dict[str, Any]:
        """What a model file knows of this line: nothing of what is hidden, nothing of how its loops differ."""
        return {
            "web": {
                "youngs_modulus_Pa": self.modulus_Pa,
                "width_m": self.width_m,
                "thickness_m": self.thickness_m,
                "span_length_m": self.length_m,
            },
            "rollers": {
                "radius_m": self.radius_m,
                "inertia_kg_m2": self.inertia_kg_m2,
                "gear_ratio": self.gear_ratio,
            },
            "motors": {"inertia_kg_m2": self.motor_inertia_kg_m2},
            "drives": {
                "velocity_kp_Nm_s_per_rad": self.kp_Nm_s_per_rad,
                "velocity_ki_Nm_per_rad": self.ki_Nm_per_rad,
                "torque_limit_Nm": self.limit_Nm,
                "current_loop_time_constant_s": 0.001,
                "sample_time_s": 0.001,
            },
            "boundary": {"upstream_tension_N": self.upstream_N, "downstream_tension_N": self.downstream_N},
        }

    def _experiment(self, profile: str, duration_s: float, rng: np.random.Generator) -> Courses:
        n = round(duration_s / CYCLE_S) + 1
        t = np.arange(n) * CYCLE_S
        f_ref = np.full(n, self.upstream_N)
        if profile == "production":
            v2 = 3.0 * np.clip((t - 1.0) / 5.0, 0.0, 1.0)
            wander = np.zeros(n)
            noise_N = 1.0
        elif profile == "identification":
            at, speed = np.array(_IDENTIFICATION).T
            v2 = np.interp(t, at * duration_s, speed)
            part = np.floor(t / 3.1).astype(int)
            part[t < 0.1 * duration_s] = 0
            f_ref *= np.concatenate([[1.0], rng.choice([1.0, 1.19, 0.81, 1.0, 1.25, 0.88], part.max() + 1)])[part]
            walk = np.cumsum(rng.standard_normal(n)) * np.sqrt(CYCLE_S)
            wander = 0.03 * self._strain_prev * (walk - np.linspace(walk[0], walk[-1], n))
            quick = rng.choice([-1.0, 1.0], int(duration_s / 0.7) + 2)[np.floor(t / 0.7).astype(int)]
            wander += 0.03 * self._strain_prev * quick * ((t > 0.55 * duration_s) & (t < 0.9 * duration_s))
            noise_N = 3.0
        else:
            raise ValueError(f"profile {profile!r}, expected one of {', '.join(PROFILES)}")
        sensor = self.noise * noise_N * rng.standard_normal(n)
        return Courses(self.top_share * v2, f_ref, wander, sensor, np.ones(n), np.ones(n))

    def _web(self) -> Array:
        web = np.zeros(ph.WEB)
        web[[ph.LENGTH, ph.STIFFNESS, ph.UPSTREAM_N, ph.DOWNSTREAM_N, ph.STRAIN_PREV]] = (
            self.length_m, self._stiffness_N, self.upstream_N, self.downstream_N, self._strain_prev,
        )  # fmt: skip
        web[[ph.STEP_TIME, ph.RAMP_S, ph.SPLICE_EVERY]] = np.inf, 1.0, np.inf
        web[[ph.CYCLE_S, ph.TENSION_KP, ph.TENSION_KI]] = CYCLE_S, self.tension_kp, self.tension_ki_per_s
        web[[ph.SENSOR_S, ph.SENSES_FORCE]] = 0.05, float(self.controls_force)
        for item in self.hidden:
            values = item["parameters"]
            match item["effect"]:
                case "elasticity_shift":
                    web[ph.SHIFT] = values["relative_change"]
                case "elasticity_step":
                    web[[ph.STEP_TIME, ph.STEP_CHANGE]] = values["time_s"], values["relative_change"]
                case "elasticity_ramp":
                    web[[ph.RAMP_TIME, ph.RAMP_S, ph.RAMP_CHANGE]] = (
                        values["time_s"], values["duration_s"], values["relative_change"],
                    )  # fmt: skip
                case "elasticity_drift":
                    web[ph.DRIFT] = values["rate_per_s"]
                case "web_slip":
                    web[ph.CREEP] = values["creep_per_N"]
                case "strain_offset":
                    web[ph.STRAIN_OFFSET] = values["strain"]
                case "span_length_error":
                    web[ph.LENGTH_ERROR] = values["relative_change"]
                case "web_damping":
                    web[ph.DAMPING_S] = values["time_constant_s"]
                case "upstream_disturbance":
                    web[[ph.WAVE_N, ph.WAVE_HZ, ph.WAVE_PHASE]] = (
                        values["amplitude_N"], values["frequency_Hz"], values.get("phase_rad", 0.0),
                    )  # fmt: skip
                case "splice":
                    web[[ph.SPLICE_TIME, ph.SPLICE_LENGTH, ph.SPLICE_CHANGE]] = (
                        values["time_s"], values["length_m"], values["relative_change"],
                    )  # fmt: skip
                case "passing_splices":
                    web[[ph.SPLICE_EVERY, ph.SPLICE_LENGTH, ph.SPLICE_CHANGE]] = (
                        values["every_m"], values["length_m"], values["relative_change"],
                    )  # fmt: skip
                case other if other not in _AXIS_PARAMETERS and other not in _RIPPLES:
                    raise ValueError(f"the independent line can't hide '{other}'")
        return web

    def _axes(self) -> tuple[Array, Array]:
        axes = np.zeros((self.rollers, ph.AXIS))
        motor = self.gear_ratio**2 * self.motor_inertia_kg_m2 / self.radius_m**2
        axes[:, ph.RADIUS], axes[:, ph.GEAR], axes[:, ph.MOTOR_MASS] = self.radius_m, self.gear_ratio, motor
        axes[:, ph.MASS] = motor + self.inertia_kg_m2 / self.radius_m**2
        axes[:, ph.KP] = self.kp_Nm_s_per_rad * np.array(self.loops.kp)
        axes[:, ph.KI] = self.ki_Nm_per_rad * np.array(self.loops.ki)
        axes[:, ph.LAG_S], axes[:, ph.SAMPLE_S] = self.loops.lag_s, self.loops.sample_s
        axes[:, ph.LATE_S], axes[:, ph.TRAPEZOID] = self.loops.late_s, float(self.loops.trapezoidal)
        axes[:, ph.LIMIT], axes[:, ph.BRISTLE] = self.limit_Nm, self.bristle_N_per_m
        axes[:, ph.STRIBECK_V], axes[:, ph.PLAY_WIDTH] = 1.0, 0.6
        ripples: list[list[list[float]]] = [[] for _ in range(self.rollers)]
        for item in self.hidden:
            name, values = item["effect"], item["parameters"]
            if name in _AXIS_PARAMETERS:
                if name == "inertia_mismatch":
                    axes[item["axis"] - 1, [ph.MASS, ph.MOTOR_MASS]] *= 1.0 + values["relative_change"]
                    continue
                for parameter, column in _AXIS_PARAMETERS[name].items():
                    axes[item["axis"] - 1, column] = values.get(parameter, 0.0)
            elif name in _RIPPLES:
                strength = values[_RIPPLES[name]]
                row = [strength, values["order"], values.get("phase_rad", 0.0), float(name == "torque_ripple_load")]
                ripples[item["axis"] - 1].append(row)
        table = np.zeros((self.rollers, max(1, *map(len, ripples)), ph.RIPPLE))
        for k in range(self.rollers):
            for n, row in enumerate(ripples[k]):
                table[k, n] = row
        return axes, table


_AXIS_PARAMETERS: Mapping[str, Mapping[str, int]] = {
    "coulomb_friction": {"force_N": ph.COULOMB},
    "viscous_friction": {"coefficient_N_s_per_m": ph.VISCOUS},
    "stribeck_friction": {"force_N": ph.STRIBECK, "speed_m_s": ph.STRIBECK_V},
    "friction_asymmetry": {"viscous_difference_N_s_per_m": ph.ASYMMETRY},
    "quadratic_drag": {"coefficient_N_s2_per_m2": ph.QUADRATIC},
    "load_dependent_friction": {"share": ph.LOAD_SHARE},
    "roller_eccentricity": {"amplitude_m": ph.ECCENTRICITY, "phase_rad": ph.ECCENTRICITY_PHASE},
    "unbalance": {"amplitude_Nm": ph.UNBALANCE, "phase_rad": ph.UNBALANCE_PHASE},
    "torque_scale": {"relative_change": ph.SCALE},
    "torque_offset": {"offset_Nm": ph.OFFSET},
    "torque_delay": {"delay_s": ph.DELAY_S},
    "backlash": {"gap_rad": ph.GAP},
    "inertia_mismatch": {},
    "hysteresis": {"force_N": ph.PLAY_N},
}
_RIPPLES: Mapping[str, str] = {"torque_ripple": "amplitude_Nm", "torque_ripple_load": "relative_amplitude"}
