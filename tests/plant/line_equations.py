"""A line with idlers, carriages and reels, in angles and real radii: the equations once more, for scipy."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, pi, sin

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray


@dataclass(frozen=True)
class Roller:
    """Driven by `gear` times the torque of its motor, or an idler (gear 0)."""

    radius_m: float
    inertia_kg_m2: float
    gear: float = 0.0
    viscous_N_s_per_m: float = 0.0
    winds: float = 0.0  #: -1 off, 1 on
    core_m: float = 0.0

    def radius_at(self, angle: float, thickness_m: float) -> float:
        return self.radius_m + self.winds * thickness_m * angle / (2.0 * pi)


@dataclass(frozen=True)
class Carriage:
    spans: tuple[int, ...]
    mass_kg: float
    force_N: float
    spring_N_per_m: float = 0.0
    viscous_N_s_per_m: float = 0.0
    arm_m: float = 0.0

    def adds(self, q: float) -> tuple[float, float]:
        """To each of its strands, and how that grows with q."""
        return (self.arm_m * sin(q / self.arm_m), cos(q / self.arm_m)) if self.arm_m else (q, 1.0)


@dataclass(frozen=True)
class LineEquations:
    rollers: list[Roller]
    lengths_m: list[float]
    stiffness_N: float
    width_m: float
    thickness_m: float
    strain_prev: float
    upstream_N: float
    downstream_N: float
    carriages: list[Carriage] = field(default_factory=list)
    density_kg_m3: float = 0.0

    def run(self, torques_Nm: Array, row_s: float, v0_m_s: float) -> dict[str, Array]:
        """Motion and tensions at the start of each row; torque commands (n, driven) of motors behind a lag of 1 ms."""
        n, k, c = len(self.rollers), len(self.lengths_m), len(self.carriages)
        driven = [i for i, roller in enumerate(self.rollers) if roller.gear]
        y = np.concatenate(
            [
                np.zeros(n),
                [v0_m_s / roller.radius_m for roller in self.rollers],
                np.array(self.lengths_m) / (1.0 + self.strain_prev),
                np.zeros(2 * c + len(driven)),
            ]
        )

        def forces(y: Array) -> tuple[Array, Array]:
            lengths = np.array(self.lengths_m)
            for number, carriage in enumerate(self.carriages):
                lengths[list(carriage.spans)] += carriage.adds(y[2 * n + k + number])[0]
            strain = lengths / y[2 * n : 2 * n + k] - 1.0
            return np.maximum(self.stiffness_N * strain, 0.0), strain

        def derivative(_: float, y: Array, command: Array) -> Array:
            angle, omega, tau = y[:n], y[n : 2 * n], y[2 * n + k + 2 * c :]
            q, dq = y[2 * n + k : 2 * n + k + c], y[2 * n + k + c : 2 * n + k + 2 * c]
            tension, strain = forces(y)
            around = np.concatenate([[self.upstream_N], tension, [self.downstream_N]])
            flow = np.concatenate([[self.strain_prev], strain])
            v, d_omega = np.empty(n), np.empty(n)
            for i, roller in enumerate(self.rollers):
                r, inertia = roller.radius_at(angle[i], self.thickness_m), roller.inertia_kg_m2
                before, behind = around[i], around[i + 1]
                if roller.winds:
                    inertia += 0.5 * pi * self.density_kg_m3 * self.width_m * (r**4 - roller.core_m**4)
                    before, behind = (0.0, behind) if i == 0 else (before, 0.0)
                v[i] = omega[i] * r
                moment = r * (behind - before) - roller.radius_m**2 * roller.viscous_N_s_per_m * omega[i]
                if roller.gear:
                    moment += roller.gear * tau[driven.index(i)]
                d_omega[i] = moment / inertia
            # What goes over roller i carries the strain of the web before it.
            passes = v / (1.0 + flow)
            unstretched = passes[:-1] - passes[1:]
            ddq = np.empty(c)
            for number, carriage in enumerate(self.carriages):
                pull = carriage.adds(q[number])[1] * sum(tension[span] for span in carriage.spans)
                drag = carriage.spring_N_per_m * q[number] + carriage.viscous_N_s_per_m * dq[number]
                ddq[number] = (carriage.force_N - pull - drag) / carriage.mass_kg
            return np.concatenate([omega, d_omega, unstretched, dq, ddq, (command - tau) / 0.001])

        states, tensions = [], []
        for command in torques_Nm:
            states.append(y)
            tensions.append(forces(y)[0])
            solved = solve_ivp(
                derivative, (0.0, row_s), y, method="DOP853", rtol=1e-10, atol=1e-13, args=(np.atleast_1d(command),)
            )
            y = solved.y[:, -1]
        found = np.array(states)
        radii = [
            [roller.radius_at(angle, self.thickness_m) for roller, angle in zip(self.rollers, row[:n], strict=True)]
            for row in found
        ]
        return {
            "speed_m_s": found[:, n : 2 * n] * [roller.radius_m for roller in self.rollers],
            "tension_N": np.array(tensions),
            "position_m": found[:, 2 * n + k : 2 * n + k + c],
            "radius_m": np.array(radii),
        }
