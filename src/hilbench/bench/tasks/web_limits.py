"""Limits of a run of a web line: tensions, torques, speeds, how far apart the axes are, how far off E is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.limits import Levels, Limited, Watched, apart, is_synchronized, least_told, load_motor_labels
from hilbench.compiled import FLAG, INDICES, MATRIX, VECTOR, entry_point, number_of_sources
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.safety import LimitsConfig
from hilbench.topology.sample import CycleSample, PlacesIn
from hilbench.topology.signals import Shape

Vector = NDArray[np.float64]
Places = NDArray[np.int64]


def limited(limits: LimitsConfig, shape: Shape) -> list[Limited]:
    """What has limits and is a signal of a line: tensions of the spans, torques of the axes and of the load motors,
    speeds of the axes."""
    axes, spans = range(1, shape.axes + 1), range(1, shape.spans + 1)
    labels = load_motor_labels(shape.load_motors)
    tensions = [
        Limited(
            f"tension of span {span}" if shape.spans > 1 else "tension of the web",
            f"F{shape.numbered(span)}_true_N",
            "N",
            limits.tension_N,
        )
        for span in spans
    ]
    torques = [Limited(f"torque of axis {k}", f"tau{k}_Nm", "N·m", limits.torque_Nm) for k in axes]
    torques += [
        Limited(f"torque of {labels[name]}", f"tau_{name}_Nm", "N·m", limits.torque_Nm) for name in shape.load_motors
    ]
    speeds = [Limited(f"speed of axis {k}", f"v{k}_m_s", "m/s", limits.speed_m_s) for k in axes]
    return [*tensions, *torques, *speeds]


#: Figures of `_is_quiet`: a cycle, s; the least difference of positions, m, and ratio of E that are told; whether there
#: has been a sample since the drives were enabled.
_CYCLE_S, _APART_M, _RATIO, _STARTED = range(4)
#: Of each axis with the one behind it, m: difference of their positions at the start, what their set points have added
#: up to since, and how far they are off that.
_AT_START_M, _COMMANDED_M, _SIZE_M, _APART_ROWS = range(4)


def _entry_point(sources: int) -> Callable[[Vector, Places, Vector, Vector, Vector, Vector, bool], bool]:
    """For Python; `sources` as in `compiled.number_of_sources`."""

    @entry_point(VECTOR, INDICES, VECTOR, VECTOR, VECTOR, MATRIX, FLAG)
    def is_quiet(
        values: Vector,
        at: Places,
        told_from: Vector,
        figures: Vector,
        models_Pa: Vector,
        off_m: Vector,
        knows_modulus: bool,
    ) -> bool:
        """Whether everything is so small that there is nothing to say, as in nearly every cycle.

        `at`, in `values`: sizes (of `told_from`), then positions and set points of the axes, and E of `models_Pa`.
        """
        if sources < 0:
            return False
        sizes, pairs = len(told_from), off_m.shape[1]
        position, command, modulus = sizes, sizes + pairs + 1, sizes + 2 * (pairs + 1)
        loud = 0
        for k in range(pairs):
            apart_m = values[at[position + k]] - values[at[position + k + 1]]
            if figures[_STARTED] == 0.0:
                off_m[_AT_START_M, k] = apart_m
            off_m[_COMMANDED_M, k] += (values[at[command + k]] - values[at[command + k + 1]]) * figures[_CYCLE_S]
            off_m[_SIZE_M, k] = abs(apart_m - off_m[_AT_START_M, k] - off_m[_COMMANDED_M, k])
            loud += not off_m[_SIZE_M, k] < figures[_APART_M]
        figures[_STARTED] = 1.0
        for k in range(sizes):
            loud += not -told_from[k] < values[at[k]] < told_from[k]
        for k in range(len(models_Pa) if knows_modulus else 0):
            ratio = values[at[modulus + k]] / models_Pa[k]
            loud += not (ratio > 0.0 and max(ratio, 1.0 / ratio) < figures[_RATIO])
        return loud == 0

    return is_quiet


_is_quiet = _entry_point(number_of_sources(__file__))


class LimitWatch:
    """Watches the samples of one run of a web line. `model`: with whose E the estimate is compared."""

    def __init__(self, limits: LimitsConfig, model: ModelParameters, cycle_s: float, shape: Shape) -> None:
        self._limits = limits
        self._levels = Levels()
        axes, spans = range(1, shape.axes + 1), range(1, shape.spans + 1)
        watched = limited(limits, shape)
        self._limited = [(each.name, each.signal, f" {each.unit}", each.limit) for each in watched]
        self._tensions = {f"F{shape.numbered(span)}_true_N" for span in spans}
        self._moduli = [(f"E{shape.numbered(span)}_sim_Pa", model.youngs_modulus_Pa(span)) for span in shape.estimated]
        self._differences = [
            f"position difference of {f'axes {axis} and {axis + 1}' if shape.axes > 2 else 'the axes'}"
            for axis in axes[:-1]
        ]
        signals = [each.signal for each in watched]
        signals += [f"x{axis}_m" for axis in axes] + [f"v{axis}_cmd_m_s" for axis in axes]
        signals += [name for name, _ in self._moduli]
        self._at = PlacesIn(signals)
        self._told_from = np.array([least_told(each.limit) for each in watched])
        figures = cycle_s, least_told(limits.position_difference_m), least_told(limits.estimate_ratio), 0.0
        self._figures = np.array(figures)
        self._models_Pa = np.array([modulus_Pa for _, modulus_Pa in self._moduli])
        self._apart = np.zeros((_APART_ROWS, len(self._differences)))
        # Compiled, or loaded, before anybody waits for a cycle.
        values, at = np.zeros(len(signals)), np.arange(len(signals))
        _is_quiet(values, at, self._told_from, self._figures.copy(), self._models_Pa, self._apart.copy(), True)

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        knows_modulus = is_synchronized(sample)
        quiet = _is_quiet(
            sample.reals,
            self._at.of(sample),
            self._told_from,
            self._figures,
            self._models_Pa,
            self._apart,
            knows_modulus,
        )
        if quiet and self._levels.quiet:
            return []
        return self._levels.check(sample.t_s, self._quantities(sample, self._apart[_SIZE_M].tolist()))

    def _quantities(self, sample: CycleSample, apart_m: Sequence[float]) -> Iterator[Watched]:
        limits = self._limits
        for name, signal, unit, limit in self._limited:
            value = getattr(sample, signal)
            yield name, value if signal in self._tensions else abs(value), unit, limit
        for name, difference_m in zip(self._differences, apart_m, strict=True):
            yield name, difference_m, " m", limits.position_difference_m
        if is_synchronized(sample):
            for signal, modulus_Pa in self._moduli:
                ratio = apart(getattr(sample, signal), modulus_Pa)
                yield "estimate of E over the model's", ratio, "", limits.estimate_ratio
