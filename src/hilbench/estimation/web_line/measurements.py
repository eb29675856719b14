"""Measurements of a web line for its twin: rows of a recording, or of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

from hilbench.arrays import Array


@dataclass(frozen=True, slots=True)
class Measurements:
    """Inputs of a twin, one row a cycle; SI, positions and velocities at the web, torque at the motor."""

    t_s: Array  #: (n,)
    v_cmd_m_s: Array  #: (n, 2)
    x_m: Array  #: (n, 2)
    tau2_Nm: Array  #: (n,)
    strain_prev: Array  #: (n,)
    F_next_N: Array  #: (n,)

    @property
    def cycle_s(self) -> float:
        """Time between two rows."""
        return float((self.t_s[-1] - self.t_s[0]) / (len(self.t_s) - 1))
