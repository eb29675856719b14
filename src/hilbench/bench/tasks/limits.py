"""Limits of a run: each quantity's warning and trip level, looked at in every cycle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import inf

from hilbench.errors import BenchFaultError
from hilbench.topology.safety import Limit, LimitsConfig
from hilbench.topology.sample import CycleSample
from hilbench.twin.virtual_io import TwinStatus

_SYNCHRONIZED = int(TwinStatus.SYNCHRONIZED)
#: A warning is over, and can come again, when the quantity has fallen below this share of its level.
_RELEASE = 0.95


class LimitTripError(BenchFaultError):
    """A quantity went beyond its trip level."""


#: What is watched in a cycle: its name, its value (a size), its unit with a space before it, and its levels.
Watched = tuple[str, float, str, Limit]


class Levels:
    """Which warnings of one run are on."""

    def __init__(self) -> None:
        self._warned: set[str] = set()

    def check(self, t_s: float, quantities: Iterable[Watched]) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity.

        Raises LimitTripError; no number counts as beyond the trip level.
        """
        warnings = []
        for name, value, unit, limit in quantities:
            if limit.trip is not None and not value <= limit.trip:
                raise LimitTripError(
                    f"t = {t_s:.3f} s: {name} is {value:.4g}{unit}, beyond its trip level {limit.trip:g}{unit}"
                )
            if limit.warning is None or value < _RELEASE * limit.warning:
                self._warned.discard(name)
            elif value > limit.warning and name not in self._warned:
                self._warned.add(name)
                text = f"{name} is {value:.4g}{unit}, beyond its warning level {limit.warning:g}{unit}"
                warnings.append((name, text))
        return warnings


def apart(estimate: float, model: float) -> float:
    """How many times an estimate is the model's value, or its inverse; what is not above 0 can't be."""
    ratio = estimate / model
    return max(ratio, 1.0 / ratio) if ratio > 0.0 else inf


def is_synchronized(sample: CycleSample) -> bool:
    """Whether the twin says so."""
    return bool(sample.twin_status & _SYNCHRONIZED)


class LimitWatch:
    """Watches the samples of one run of a web line. `model_modulus_Pa`: what the estimate is compared with."""

    def __init__(self, limits: LimitsConfig, model_modulus_Pa: float, cycle_s: float) -> None:
        self._limits = limits
        self._modulus_Pa = model_modulus_Pa
        self._cycle_s = cycle_s
        self._difference_at_start_m: float | None = None
        self._commanded_difference_m = 0.0
        self._levels = Levels()

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        return self._levels.check(sample.t_s, self._quantities(sample))

    def _quantities(self, sample: CycleSample) -> Iterator[Watched]:
        limits = self._limits
        yield "tension of the web", sample.F_true_N, " N", limits.tension_N
        yield "torque of axis 1", abs(sample.tau1_Nm), " N·m", limits.torque_Nm
        yield "torque of axis 2", abs(sample.tau2_Nm), " N·m", limits.torque_Nm
        yield "torque of the load motor", abs(sample.tau_load_Nm), " N·m", limits.torque_Nm
        yield "speed of axis 1", abs(sample.v1_m_s), " m/s", limits.speed_m_s
        yield "speed of axis 2", abs(sample.v2_m_s), " m/s", limits.speed_m_s
        yield "position difference of the axes", self._position_difference_m(sample), " m", limits.position_difference_m
        if is_synchronized(sample):
            yield "estimate of E over the model's", apart(sample.E_sim_Pa, self._modulus_Pa), "", limits.estimate_ratio

    def _position_difference_m(self, sample: CycleSample) -> float:
        difference_m = sample.x1_m - sample.x2_m
        if self._difference_at_start_m is None:
            self._difference_at_start_m = difference_m
        self._commanded_difference_m += (sample.v1_cmd_m_s - sample.v2_cmd_m_s) * self._cycle_s
        return abs(difference_m - self._difference_at_start_m - self._commanded_difference_m)
