"""Model of a driven roller's response to its command, ahead of its measurement."""

from __future__ import annotations

from hilbench.plant.parameters import per_item
from hilbench.plant.sampling import samples_per
from hilbench.plant.web_line.parameters import ModelParameters


class RollerMotion:
    """Response of a driven roller to its velocity command: m·v' = kp·(u - v) + ki·∫(u - v), sampled as its drive does;
    the web pulls at both sides alike."""

    def __init__(self, model: ModelParameters, axis: int, cycle_s: float) -> None:
        loops, ratio = model.drives, model.motor_rad_per_m(axis)
        assert loops is not None, "a bench's model has drives"
        self._mass_kg = model.mass_kg(axis)
        self._kp_N_s_per_m = per_item(loops.velocity_kp_Nm_s_per_rad, axis) * ratio**2
        self._ki_N_per_m = per_item(loops.velocity_ki_Nm_per_rad, axis) * ratio**2
        self._samples = samples_per(cycle_s, loops.sample_time_s)
        self._sample_s = loops.sample_time_s
        self.reset()

    def reset(self) -> None:
        """Reset to rest."""
        self.speed_m_s = self._integral_N = 0.0  #: speed at the end of the last cycle computed

    def acceleration_m_s2(self, command_m_s: float) -> float:
        """The mean of the next cycle, with this command."""
        before_m_s = self.speed_m_s
        for _ in range(self._samples):
            error_m_s = command_m_s - self.speed_m_s
            self._integral_N += self._ki_N_per_m * error_m_s * self._sample_s
            force_N = self._kp_N_s_per_m * error_m_s + self._integral_N
            self.speed_m_s += force_N / self._mass_kg * self._sample_s
        return (self.speed_m_s - before_m_s) / (self._samples * self._sample_s)
