"""The web on measured motion: strain and tension from encoder positions, for the load model and for diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import compiled, entry_point
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.kernel import source_number
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.line import set_effect
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters

#: Longest integration step; the error of a step is of order (v·h/L)^5/120, below rounding on the demonstrator.
_LONGEST_STEP_S = 0.001


@compiled
def _span_rates(
    p: Vector, w: Vector, n: int, k: int, at: int, rate: int, t: float, steps: float, strain_prev: float, f_next: float
) -> None:
    """Rates at `rate` of unstretched and nominal lengths at `at`; w[0:n] positions, w[n:2n] speeds, then K + N more."""
    speed, length_rate, tension = 2 * n, 3 * n, 3 * n + k
    for i in range(n):
        axis = lay.W_SIZE + i * lay.A_SIZE
        w[speed + i] = laws.web_speed_m_s(p, axis, w[i], w[n + i])
    strain = laws.upstream_strain(p, strain_prev, t)
    stiffness = laws.stiffness_N(p, t, steps)
    laws.span_rates(p, k, stiffness, strain, f_next, w, speed, at, length_rate, tension, rate)
    for j in range(k):
        w[rate + k + j] = w[length_rate + j]


@compiled
def roll_on(
    p: Vector,
    s: Vector,
    w: Vector,
    v: Vector,
    strain_prev: float,
    f_next: float,
    duration: float,
    spread_s: float,
    out: Vector,
) -> None:
    """Advance s = [t, positions, unstretched lengths, lengths] with the rollers at constant speeds v.

    Tensions into `out`, with steps of E spread over the next `spread_s` (`laws.step_factor`).
    """
    n, k = int(p[lay.W_AXES]), int(p[lay.W_SPANS])
    count = max(int(np.ceil(duration / _LONGEST_STEP_S - 1e-9)), 1)
    h, size = duration / count, 2 * k
    now = 3 * n + 2 * k
    stage, slopes = now + size, now + 2 * size
    for i in range(n):
        w[n + i] = v[i]
    for j in range(size):
        w[now + j] = s[1 + n + j]
    t0 = s[0]
    steps = 1.0
    for step in range(count if duration > 0.0 else 0):
        t = t0 + step * h
        steps = laws.step_factor(p, t, h)
        for part in range(4):
            ahead = 0.0 if part == 0 else (h if part == 3 else 0.5 * h)
            for i in range(n):
                w[i] = s[1 + i] + v[i] * (step * h + ahead)
            for j in range(size):
                slope = w[slopes + (part - 1) * size + j] if part > 0 else 0.0
                w[stage + j] = w[now + j] + ahead * slope
            _span_rates(p, w, n, k, stage, slopes + part * size, t + ahead, steps, strain_prev, f_next)
        for j in range(size):
            total = w[slopes + j] + 2.0 * (w[slopes + size + j] + w[slopes + 2 * size + j]) + w[slopes + 3 * size + j]
            w[now + j] += h / 6.0 * total
    s[0] = t0 + duration
    for i in range(n):
        s[1 + i] += v[i] * duration
        w[i] = s[1 + i]
    for j in range(size):
        s[1 + n + j] = w[now + j]
    steps = laws.step_factor(p, s[0], spread_s)
    _span_rates(p, w, n, k, now, slopes, s[0], steps, strain_prev, f_next)
    for j in range(k):
        out[j] = w[3 * n + k + j]


FollowCycle = Callable[[Vector, Vector, Vector, Vector, float, float, float, Vector], None]
FollowRows = Callable[[Vector, Vector, Vector, Vector, Vector, float, Vector, Vector], None]
Resistance = Callable[[Vector, int, float, float, float], float]
Modulus = Callable[[Vector, float], float]


def _entry_points(sources: int) -> tuple[FollowCycle, FollowRows, Resistance, Modulus]:
    """Compiled functions that are called from Python; `sources` as in the kernel."""

    @entry_point
    def follow(
        p: Vector, s: Vector, w: Vector, v: Vector, strain_prev: float, f_next: float, duration: float, out: Vector
    ) -> None:
        if sources >= 0:
            roll_on(p, s, w, v, strain_prev, f_next, duration, _LONGEST_STEP_S, out)

    @entry_point
    def follow_rows(
        p: Vector, s: Vector, w: Vector, x: Vector, boundary: Vector, dt: float, v: Vector, out: Vector
    ) -> None:
        for row in range(x.shape[0] if sources >= 0 else 0):
            for i in range(x.shape[1]):
                v[i] = (x[row, i] - s[1 + i]) / dt if row > 0 else 0.0
            before = max(row - 1, 0)
            duration = dt if row > 0 else 0.0
            roll_on(p, s, w, v, boundary[before, 0], boundary[before, 1], duration, _LONGEST_STEP_S, out[row])

    @entry_point
    def resistance(p: Vector, axis: int, x_m: float, v_m_s: float, width_m_s: float) -> float:
        if sources < 0:
            return 0.0
        return laws.measured_resistance_N(p, lay.W_SIZE + axis * lay.A_SIZE, x_m, v_m_s, width_m_s)

    @entry_point
    def modulus(p: Vector, t: float) -> float:
        factor = laws.step_factor(p, t, _LONGEST_STEP_S) if sources >= 0 else 1.0
        acting: float = laws.stiffness_N(p, t, factor) / p[lay.W_SECTION_M2]
        return acting

    return follow, follow_rows, resistance, modulus


_follow_cycle, _follow_rows, _resistance, _modulus = _entry_points(source_number(__file__))


def new_follower_work(layout: Layout) -> Vector:
    """Scratch space of `roll_on`."""
    return np.zeros(3 * layout.axes + 14 * layout.spans)


class SpanFollower:
    """The web of a model on measured roller positions; the rollers turn at constant speed within a cycle.

    Positions at the web (motor angle × nominal radius / gear ratio), (N,). Starts at `x_m` with the spans strained
    by `strain` (default: as the web that enters). Raises ValueError for a model without a web.
    """

    def __init__(self, parameters: ModelParameters, x_m: ArrayLike = 0.0, strain: ArrayLike | None = None):
        self.parameters = parameters.model_copy(update={"web": parameters.required_web})
        self._p = lay.pack(parameters)
        self._layout = Layout.of(self._p)
        n, k = self._layout.axes, self._layout.spans
        self._work = new_follower_work(self._layout)
        self._state = np.zeros(1 + n + 2 * k)
        self._v = np.zeros(n)
        self._boundary = (parameters.upstream_strain, parameters.boundary.downstream_tension_N)
        self._tension = np.zeros(k)
        self._rad_per_m = [parameters.motor_rad_per_m(axis) for axis in range(1, n + 1)]
        self.reset(x_m, strain)

    def reset(self, x_m: ArrayLike, strain: ArrayLike | None = None) -> None:
        """Start again at these positions and strains, at rest; time goes on."""
        n = self._layout.axes
        start = start_state(self._p, self.parameters, strain)
        self._state[1 : 1 + n] = x_m
        self._state[1 + n :] = self._layout.y(start)[4 * n :]
        self._v[:] = 0.0
        self._evaluate()

    def _evaluate(self) -> None:
        _follow_cycle(self._p, self._state, self._work, self._v, *self._boundary, 0.0, self._tension)

    def advance(self, x_m: Sequence[float] | Vector, duration_s: float) -> Vector:
        """The rollers are now at `x_m`, `duration_s` after the last call; the tensions (K,) there, in N.

        Raises ValueError for a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration {duration_s!r} s, expected more than 0")
        n = self._layout.axes
        x = np.asarray(x_m, dtype=np.float64)
        self._v = (x - self._state[1 : 1 + n]) / duration_s
        _follow_cycle(self._p, self._state, self._work, self._v, *self._boundary, duration_s, self._tension)
        self._state[1 : 1 + n] = x  # exactly: no drift from adding up
        return self._tension.copy()

    def predicted_tension_N(self, lead_s: float) -> Vector:
        """The tensions (K,) `lead_s` later if the rollers go on as in the last cycle; changes nothing.

        Makes good the delay between measuring the motion and the load motor's torque.
        """
        state, tension = self._state.copy(), np.empty_like(self._tension)
        _follow_cycle(self._p, state, self._work, self._v, *self._boundary, lead_s, tension)
        return tension

    def set_boundary(self, strain_prev: float, F_next_N: float) -> None:
        """Upstream strain and downstream tension from now on."""
        boundary = (float(strain_prev), float(F_next_N))
        if boundary != self._boundary:
            self._boundary = boundary
            self._evaluate()

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""
        return float(self._state[0])

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,)."""
        return self._tension.copy()

    @property
    def speeds_m_s(self) -> Vector:
        """Speeds of the rollers over the last cycle (N,)."""
        return self._v.copy()

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,)."""
        n, k = self._layout.axes, self._layout.spans
        lengths = self._state[1 + n :].tolist()  # in plain Python: of one span, every cycle, a third of numpy's time
        factor = 1.0 + self._p.item(lay.place("span_length_error", "relative_change"))
        return np.array([lengths[k + j] * factor / lengths[j] - 1.0 for j in range(k)])

    @property
    def youngs_modulus_Pa(self) -> float:
        """E, without the effects on it. Setting it leaves the strain: the tension jumps."""
        return float(self._p[lay.W_MODULUS_PA])

    @youngs_modulus_Pa.setter
    def youngs_modulus_Pa(self, value: float) -> None:
        if not 0.0 < value < np.inf:
            raise ValueError(f"Young's modulus {value!r} Pa, expected a positive number")
        self._p[lay.W_MODULUS_PA] = value
        self._evaluate()

    @property
    def effective_modulus_Pa(self) -> float:
        """E as it acts now, with the effects on it."""
        return float(_modulus(self._p, self._state[0]))

    def set_effect(self, effect_id: str, axis: int | None = None, *, slot: int = 0, **parameters: float) -> None:
        """Give an effect these parameters from now on; the strain stays. Raises as `Line.set_effect`."""
        strain = self.strain
        set_effect(self._p, effect_id, axis, slot, parameters)
        n, k = self._layout.axes, self._layout.spans
        factor = 1.0 + self._p[lay.place("span_length_error", "relative_change")]
        self._state[1 + n : 1 + n + k] = self._state[1 + n + k :] * factor / (1.0 + strain)
        self._evaluate()

    def web_torque_Nm(
        self,
        axis: int,
        v_m_s: float,
        *,
        tension_N: ArrayLike | None = None,
        friction_width_m_s: float = laws.FRICTION_WIDTH_M_S,
    ) -> float:
        """Torque at the motor of `axis` that imitates the web and the roller's resistance: (r/i)·(F_next - F - R(v)).

        For axis 1 F_next is the span's tension and F the upstream one. `tension_N` (K,): tensions to use, default the
        present ones. Dry friction turns over linearly within ±`friction_width_m_s`: imitated by a torque it must not
        flip with the noise of v. Inertia and gear effects can't be imitated by it.
        """
        tensions = self._tension if tension_N is None else np.asarray(tension_N, dtype=float)
        force = 0.0
        if self.parameters.carries_web_load(axis):
            before = tensions[axis - 2] if axis > 1 else self._upstream_tension_N()
            behind = tensions[axis - 1] if axis <= len(tensions) else self._boundary[1]
            force = float(behind - before)
        position_m = self._state.item(axis)
        force -= _resistance(self._p, axis - 1, position_m, float(v_m_s), friction_width_m_s)
        return float(force / self._rad_per_m[axis - 1])

    def _upstream_tension_N(self) -> float:
        strain = float(laws.upstream_strain(self._p, self._boundary[0], self._state[0]))
        return strain * float(self._p[lay.W_UPSTREAM_STIFFNESS_N])


def follow(parameters: ModelParameters, x_m: NDArray[np.float64], boundary: NDArray[np.float64], dt_s: float) -> Vector:
    """Tensions (n, K) of the web on recorded positions x_m (n, N), one compiled call.

    boundary (n, 2): upstream strain and downstream tension (N), each from its row on.
    Raises ValueError for a model without a web or shapes that do not fit.
    """
    start = SpanFollower(parameters, x_m[0])
    n, k = start._layout.axes, start._layout.spans
    if x_m.shape != (len(x_m), n) or boundary.shape != (len(x_m), 2):
        raise ValueError(f"positions {x_m.shape}, boundary {boundary.shape}, expected (n, {n}) and (n, 2)")
    out = np.empty((len(x_m), k))
    x, limits = np.ascontiguousarray(x_m, dtype=float), np.ascontiguousarray(boundary, dtype=float)
    _follow_rows(start._p, start._state, start._work, x, limits, dt_s, start._v, out)
    return out
