"""One cycle of a running bench, as the bench, its observers and conditions see it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class CycleSample:
    """The signals of `hilbench.topology.signals` (units and meaning there), and the number of the cycle."""

    cycle: int = 0
    t_s: float = 0.0
    v1_cmd_m_s: float = 0.0
    v2_cmd_m_s: float = 0.0
    x1_m: float = 0.0
    x2_m: float = 0.0
    v1_m_s: float = 0.0
    v2_m_s: float = 0.0
    tau1_Nm: float = 0.0
    tau2_Nm: float = 0.0
    strain_prev: float = 0.0
    F_next_N: float = 0.0
    F_ref_N: float = 0.0
    tau_load_Nm: float = 0.0
    tau_load_cmd_Nm: float = 0.0
    x_load_m: float = 0.0
    F_sim_N: float = 0.0
    E_sim_Pa: float = 0.0
    E_sd_Pa: float = 0.0
    tau2_sim_Nm: float = 0.0
    tau2_residual_Nm: float = 0.0
    twin_age_cycles: int = 0
    twin_status: int = 0
    loop_closed: int = 0
    E_true_Pa: float = 0.0
    F_true_N: float = 0.0
    strain_true: float = 0.0
    bus_bits: int = 0
    statusword1: int = 0
    statusword2: int = 0
    statusword_load: int = 0
