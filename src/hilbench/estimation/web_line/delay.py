"""A constant delay of the measured torque: found from data, and taken out by looking at everything else later, too."""

from __future__ import annotations

from collections import deque
from math import exp, floor

import numpy as np

from hilbench.estimation.web_line.balance import BalanceSample

#: Longest delay that is looked for.
LONGEST_S = 0.05
#: How far back the evidence for a delay reaches.
_MEMORY_S = 30.0
#: Steps of the delay that is told, in cycles, and how far the found one must be from it before it moves: the balance is
#: looked at so much earlier, where each change moves a running roller's position by speed times change.
_STEP, _HYSTERESIS = 0.25, 0.4
#: Improvement of the squared error, in standard deviations of the noise, from which a delay is believed.
_EVIDENCE = 25.0


class DelayFinder:
    """Compares the changes of the measured torque with those of the simulated one, some cycles ago.

    For each whole number of cycles the squared differences of the second differences (over a fixed lag, so that
    offsets and trends don't matter) are averaged; the minimum, refined by a parabola, is the delay. It is believed
    once it explains the measurement better than no delay beyond what noise does.
    """

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._count = max(2, round(LONGEST_S / cycle_s)) + 1
        self._lag = max(2, round(0.03 / cycle_s))
        length = self._count + self._lag + 1
        self._simulated = np.zeros(length)
        self._real = np.zeros(self._lag + 1)
        self._errors = np.zeros(self._count)
        self._noise = 0.0
        self._keep = exp(-cycle_s / _MEMORY_S)
        self._seen = 0
        self.delay_s = 0.0

    def update(self, torque_real_Nm: float, torque_sim_Nm: float) -> float:
        """Take one cycle; returns the delay in s that is believed now."""
        self._simulated = np.roll(self._simulated, 1)
        self._real = np.roll(self._real, 1)
        self._simulated[0], self._real[0] = torque_sim_Nm, torque_real_Nm
        self._seen += 1
        if self._seen < len(self._simulated):
            return self.delay_s
        change_real = self._real[0] - self._real[-1]
        change_sim = self._simulated[: self._count] - self._simulated[self._lag : self._lag + self._count]
        self._errors = self._keep * self._errors + (change_real - change_sim) ** 2
        self._noise = self._keep * self._noise + 1.0
        best_s = self._best_s()
        if abs(best_s - self.delay_s) > _HYSTERESIS * self._cycle_s:
            step_s = _STEP * self._cycle_s
            self.delay_s = step_s * round(best_s / step_s)
        return self.delay_s

    def _best_s(self) -> float:
        errors = self._errors
        best = int(np.argmin(errors))
        floor_Nm2 = errors[best] / max(self._noise, 1.0)
        if errors[0] - errors[best] <= _EVIDENCE * 2.0 * floor_Nm2 and self.delay_s == 0.0:
            return 0.0
        if 0 < best < self._count - 1:
            before, at, after = errors[best - 1 : best + 2]
            bend = before - 2.0 * at + after
            shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
            return float((best + shift) * self._cycle_s)
        return best * self._cycle_s


class DelayLine:
    """Past balance samples, to be paired with a torque that is late."""

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._past: deque[tuple[float, float, float, float]] = deque(maxlen=round(LONGEST_S / cycle_s) + 3)

    def reset(self) -> None:
        """Forget the past."""
        self._past.clear()

    def pair(self, sample: BalanceSample, torque_force_N: float, delay_s: float) -> BalanceSample | None:
        """The balance at the time the torque belongs to; None until the past reaches back so far.

        `torque_force_N` is the part of `sample.force_N` that comes from the torque, the late one.
        """
        rest_N = sample.force_N - torque_force_N
        self._past.appendleft((sample.x2_m, rest_N, sample.web_per_Pa, sample.velocity_m_s))
        if delay_s == 0.0:
            return sample
        cycles = delay_s / self._cycle_s
        whole = floor(cycles)
        if whole + 1 >= len(self._past):
            return None
        share = cycles - whole
        newer, older = self._past[whole], self._past[whole + 1]
        x2, rest, web, speed = (a + (b - a) * share for a, b in zip(newer, older, strict=True))
        return BalanceSample(x2, rest + torque_force_N, web, speed)
