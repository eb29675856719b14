"""The web on measured motion: strain and tension from encoder positions, for the load model and for diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import COUNT, MATRIX, REAL, VECTOR, compiled, entry_point, inlined
from hilbench.plant.effects import EffectPlace, effects_of
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.kernel import source_number
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import (
    KIND,
    axis_names,
    boundary_names,
    checked_positive,
    known_effect,
    moduli_by_name,
    modulus_names,
    set_effect,
    span_names,
)
from hilbench.plant.web_line.splices import WHOLE, Piece, SplicedSpan, has_pieces, put_pieces, spliced_spans
from hilbench.plant.web_line.stations import ONLY_DRIVEN

#: Longest integration step; the error of a step is of order (v·h/L)^5/120, below rounding on the demonstrator.
LONGEST_STEP_S = 0.001

BROKEN = Quantity("broken", "1", "1: the web has torn and pulls no more; 0: it is whole")


#: So many states in front of the positions: time.
_TIME = 1


@inlined
def _first_span(p: Vector) -> int:
    """Where the span rows begin in the parameters."""
    return lay.W_SIZE + int(p[lay.W_AXES]) * lay.A_SIZE + int(p[lay.W_MOTORS]) * lay.M_SIZE


@compiled
def _span_rates(
    p: Vector,
    s: Vector,
    w: Vector,
    n: int,
    k: int,
    at: int,
    rate: int,
    t: float,
    steps: int,
    strain_prev: float,
    f_next: float,
    blur_m: float,
) -> None:
    """Rates (2·K,), m/s, to place `rate` of `w`, of the unstretched and then the nominal lengths (2·K,), m, at `at`.

    p (P,): parameters of the line. s: state of `roll_on`, for the pieces of other web. w: positions (n,), m, and speeds
    (n,), m/s, at its start; behind them room for the web's speeds (n,), then rates of the nominal lengths (k,), and the
    tensions (k,), N, that come with it; factors (k,) of the steps of E at `steps`. t: s since the start. strain_prev:
    of the web that enters; f_next: tension behind the line, N; blur_m: way in a step (`laws.spliced_span_rates`).
    """
    speed, length_rate, tension = 2 * n, 3 * n, 3 * n + k
    first, pieces = _first_span(p), _TIME + n + 2 * k
    for i in range(n):
        axis = lay.W_SIZE + i * lay.A_SIZE
        w[speed + i] = laws.web_speed_m_s(p, axis, w[i], w[n + i])
    strain = laws.upstream_strain(p, strain_prev, t)
    if laws.has_splice(p, s, pieces):
        laws.spliced_span_rates(
            p, s, pieces, first, k, t, strain, f_next, w, steps, speed, at, length_rate, tension, rate, w[0], blur_m
        )
    else:
        laws.span_rates(p, first, k, t, strain, f_next, w, steps, speed, at, length_rate, tension, rate)
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
    """Advance s = [t, positions (N,), unstretched lengths (K,), lengths (K,), pieces], s and m, at constant speeds.

    p (P,): parameters of the line; w: scratch space of `new_follower_work`; v (N,): speeds, m/s; strain_prev: of the
    web that enters; f_next: tension behind the line, N; duration: s, 0 for the tensions alone. Tensions into `out`
    (K,), N, with steps of E spread over the next `spread_s` (`laws.step_factor`).
    """
    n, k = int(p[lay.W_AXES]), int(p[lay.W_SPANS])
    count = max(int(np.ceil(duration / LONGEST_STEP_S - 1e-9)), 1)
    h, size = duration / count, 2 * k
    now = 3 * n + 2 * k
    stage, slopes = now + size, now + 2 * size
    for i in range(n):
        w[n + i] = v[i]
    for j in range(size):
        w[now + j] = s[1 + n + j]
    t0, pieces, first, steps = s[0], _TIME + n + size, _first_span(p), now + 6 * size
    blur = max(abs(v[0]) * (h if duration > 0.0 else LONGEST_STEP_S), lay.LEAST_BLUR_M)
    if laws.has_splice(p, s, pieces):
        strain = laws.upstream_strain(p, strain_prev, t0)
        laws.let_splice_in(p, s, pieces, t0, duration, s[1], v[0], strain)
        web_m = 0.0
        for j in range(k):
            web_m += s[1 + n + j]
        laws.forget_passed(s, pieces, s[1], strain, web_m)
    for step in range(count if duration > 0.0 else 0):
        t = t0 + step * h
        laws.put_step_factors(p, first, k, t, h, w, steps)
        for part in range(4):
            ahead = 0.0 if part == 0 else (h if part == 3 else 0.5 * h)
            for i in range(n):
                w[i] = s[1 + i] + v[i] * (step * h + ahead)
            for j in range(size):
                slope = w[slopes + (part - 1) * size + j] if part > 0 else 0.0
                w[stage + j] = w[now + j] + ahead * slope
            _span_rates(p, s, w, n, k, stage, slopes + part * size, t + ahead, steps, strain_prev, f_next, blur)
        for j in range(size):
            total = w[slopes + j] + 2.0 * (w[slopes + size + j] + w[slopes + 2 * size + j]) + w[slopes + 3 * size + j]
            w[now + j] += h / 6.0 * total
    s[0] = t0 + duration
    for i in range(n):
        s[1 + i] += v[i] * duration
        w[i] = s[1 + i]
    for j in range(size):
        s[1 + n + j] = w[now + j]
    laws.put_step_factors(p, first, k, s[0], spread_s, w, steps)
    _span_rates(p, s, w, n, k, now, slopes, s[0], steps, strain_prev, f_next, blur)
    for j in range(k):
        out[j] = w[3 * n + k + j]


FollowCycle = Callable[[Vector, Vector, Vector, Vector, float, float, float, Vector], None]
FollowTo = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, float, Vector], None]
Pull = Callable[[Vector, Vector, Vector, Vector, Vector, Vector, float, Vector, Vector, Vector, Vector], None]
Show = Callable[[Vector, Vector, Vector, Vector, Vector], None]
FollowRows = Callable[[Vector, Vector, Vector, Vector, Vector, float, Vector, Vector], None]
Resistance = Callable[[Vector, int, float, float, float], float]
Modulus = Callable[[Vector, int, float], float]


@inlined
def _tension_around_N(p: Vector, t: float, boundary: Vector, tension: Vector, span: int) -> float:
    """Of a span, counted from 0; before the first that upstream of the line, behind the last that downstream of it."""
    if span < 0:
        return float(laws.upstream_strain(p, boundary[0], t) * p[lay.W_UPSTREAM_STIFFNESS_N])
    return float(tension[span] if span < len(tension) else boundary[1])


@compiled
def _web_torque_Nm(p: Vector, s: Vector, boundary: Vector, tension: Vector, load: Vector, v: float) -> float:
    """See `SpanFollower.web_torque_Nm`; `load`: roller from 0, rad per m at its motor, whether it carries the web."""
    roller, force = int(load[0]), 0.0
    if load[2] != 0.0:
        behind = _tension_around_N(p, s[0], boundary, tension, roller)
        force = behind - _tension_around_N(p, s[0], boundary, tension, roller - 1)
    direction = laws.measured_direction(v, laws.FRICTION_WIDTH_M_S)
    force -= laws.measured_resistance_N(p, lay.W_SIZE + roller * lay.A_SIZE, s[_TIME + roller], v, direction)
    return float(force / load[1])


@inlined
def _modulus_Pa(p: Vector, span: int, t: float) -> float:
    row = _first_span(p) + span * lay.SP_SIZE
    factor = laws.step_factor(p, row, t, LONGEST_STEP_S)
    return float(laws.stiffness_N(p, row, t, factor) / p[row + lay.SP_SECTION_M2])


def _entry_points(
    sources: int,
) -> tuple[FollowCycle, FollowTo, FollowRows, Pull, Show, Resistance, Modulus]:
    """Compiled functions that are called from Python; `sources` as in the kernel."""

    @entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR)
    def follow_on(
        p: Vector, s: Vector, w: Vector, v: Vector, boundary: Vector, x: Vector, duration: float, out: Vector
    ) -> None:
        n = len(x) if sources >= 0 else 0
        for i in range(n):
            v[i] = (x[i] - s[_TIME + i]) / duration
        roll_on(p, s, w, v, boundary[0], boundary[1], duration, LONGEST_STEP_S, out)
        for i in range(n):
            s[_TIME + i] = x[i]  # exactly: no drift from adding up

    @entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL, VECTOR, MATRIX, VECTOR, VECTOR)
    def pull(
        p: Vector,
        s: Vector,
        ahead: Vector,
        w: Vector,
        v: Vector,
        boundary: Vector,
        lead: float,
        tension: Vector,
        loads: Vector,
        speeds: Vector,
        torques: Vector,
    ) -> None:
        if lead >= 0.0:
            for i in range(len(s) if sources >= 0 else 0):
                ahead[i] = s[i]
            roll_on(p, ahead, w, v, boundary[0], boundary[1], lead, LONGEST_STEP_S, tension)
        for k in range(len(loads)):
            torques[k] = _web_torque_Nm(p, s, boundary, tension, loads[k], speeds[int(loads[k, 0])])

    @entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
    def show(p: Vector, s: Vector, v: Vector, tension: Vector, out: Vector) -> None:
        n, k = len(v) if sources >= 0 else 0, len(tension)
        first = _first_span(p)
        for i in range(n):
            out[i] = s[_TIME + i]
            out[n + i] = v[i]
        for j in range(k):
            unstretched, length = s[_TIME + n + j], s[_TIME + n + k + j]
            out[2 * n + j] = tension[j]
            out[2 * n + k + j] = length * laws.length_factor(p, first + j * lay.SP_SIZE) / unstretched - 1.0
            out[2 * n + 2 * k + j] = _modulus_Pa(p, j, s[0])

    @entry_point(VECTOR, VECTOR, VECTOR, VECTOR, REAL, REAL, REAL, VECTOR)
    def follow(
        p: Vector, s: Vector, w: Vector, v: Vector, strain_prev: float, f_next: float, duration: float, out: Vector
    ) -> None:
        if sources >= 0:
            roll_on(p, s, w, v, strain_prev, f_next, duration, LONGEST_STEP_S, out)

    @entry_point(VECTOR, VECTOR, VECTOR, MATRIX, MATRIX, REAL, VECTOR, MATRIX)
    def follow_rows(
        p: Vector, s: Vector, w: Vector, x: Vector, boundary: Vector, dt: float, v: Vector, out: Vector
    ) -> None:
        for row in range(x.shape[0] if sources >= 0 else 0):
            for i in range(x.shape[1]):
                v[i] = (x[row, i] - s[1 + i]) / dt if row > 0 else 0.0
            before = max(row - 1, 0)
            duration = dt if row > 0 else 0.0
            roll_on(p, s, w, v, boundary[before, 0], boundary[before, 1], duration, LONGEST_STEP_S, out[row])

    @entry_point(VECTOR, COUNT, REAL, REAL, REAL)
    def resistance(p: Vector, row: int, x_m: float, v_m_s: float, width_m_s: float) -> float:
        if sources < 0:
            return 0.0
        direction = laws.measured_direction(v_m_s, width_m_s)
        return laws.measured_resistance_N(p, lay.W_SIZE + row * lay.A_SIZE, x_m, v_m_s, direction)

    @entry_point(VECTOR, COUNT, REAL)
    def modulus(p: Vector, span: int, t: float) -> float:
        return _modulus_Pa(p, span, t) if sources >= 0 else 0.0

    return follow, follow_on, follow_rows, pull, show, resistance, modulus


follow_cycle, _follow_on, _follow_rows, _pull, _show, resistance_N, _modulus = _entry_points(source_number(__file__))


class SpanVectors(NamedTuple):
    """What a `SpanFollower` consists of, for compiled callers."""

    p: Vector  #: parameters of the line
    s: Vector  #: state, as of `roll_on`
    w: Vector  #: scratch space
    v: Vector  #: speeds of the rollers over the last cycle (N,), m/s
    boundary: Vector  #: strain of the web that enters, tension behind the line in N
    tension: Vector  #: of each span (K,), N


@compiled
def follow_to(web: SpanVectors, x1_m: float, x2_m: float, duration_s: float) -> None:
    """The web of two rollers, which are now at these positions, `duration_s` after the last call."""
    web.v[0] = (x1_m - web.s[_TIME]) / duration_s
    web.v[1] = (x2_m - web.s[_TIME + 1]) / duration_s
    follow_cycle(web.p, web.s, web.w, web.v, web.boundary[0], web.boundary[1], duration_s, web.tension)
    web.s[_TIME] = x1_m  # exactly: no drift from adding up
    web.s[_TIME + 1] = x2_m


@compiled
def put_boundary(web: SpanVectors, strain_prev: float, f_next_N: float) -> None:
    """What the neighbouring sections do from now on; tensions are those that come with it."""
    if web.boundary[0] != strain_prev or web.boundary[1] != f_next_N:
        web.boundary[0] = strain_prev
        web.boundary[1] = f_next_N
        follow_cycle(web.p, web.s, web.w, web.v, strain_prev, f_next_N, 0.0, web.tension)


@inlined
def modulus_place(p: Vector) -> int:
    """Where E of the first span stands in the parameters."""
    return _first_span(p) + lay.SP_MODULUS_PA


@inlined
def first_strain(web: SpanVectors) -> float:
    """Strain of the first span, of two rollers."""
    unstretched_m, length_m = web.s[_TIME + 2], web.s[_TIME + 3]
    return float(length_m * laws.length_factor(web.p, _first_span(web.p)) / unstretched_m - 1.0)


@compiled
def first_spliced(web: SpanVectors) -> tuple[bool, float, float]:
    """Whether there are pieces of other web; what they make of the first span, of two rollers (`SplicedSpan`)."""
    pieces = len(web.s) - lay.PIECES_SIZE
    if not web.s[pieces + lay.PIECES_COUNT] > 0.0:
        return False, 1.0, 1.0
    stretch = 1.0 + laws.upstream_strain(web.p, web.boundary[0], web.s[0])
    way_m, unstretched_m = web.s[_TIME], web.s[_TIME + 2]
    factor = laws.series_factor(web.s, pieces, way_m, 0.0, unstretched_m, stretch)
    at_end = 1.0 + laws.change_at(web.s, pieces, way_m, unstretched_m, stretch, lay.LEAST_BLUR_M)
    return True, factor, at_end


def new_follower_work(layout: Layout) -> Vector:
    """Scratch space of `roll_on`."""
    return np.zeros(3 * layout.axes + 15 * layout.spans)


def follower_size(layout: Layout) -> int:
    """Length of the state of `roll_on`."""
    return _TIME + layout.axes + 2 * layout.spans + lay.PIECES_SIZE


@dataclass(frozen=True, slots=True)
class _Memory:
    """What a follower's state holds beside its names: its state vector and the rollers' speeds over the last cycle."""

    state: bytes
    speeds: bytes


class SpanFollower:
    """The web of a model on measured roller positions; the rollers turn at constant speed within a cycle.

    N rollers with N-1 spans; positions at the web (motor angle × nominal radius / gear ratio). Starts at `x_m` (N,)
    with the spans strained by `strain` (K,) (default: as the web that enters). See `hilbench.plant.interface.Follower`.
    Raises ValueError for a model without a web, or one with stations.
    """

    def __init__(self, parameters: ModelParameters, x_m: ArrayLike = 0.0, strain: ArrayLike | None = None):
        if parameters.stations is not None:
            raise ValueError(f"a line with stations, expected {ONLY_DRIVEN}")
        self.parameters = parameters.model_copy(update={"web": parameters.required_web})
        self._p = lay.pack(parameters)
        self._layout = Layout.of(self._p)
        self._moduli = moduli_by_name(self._p)
        n, k = self._layout.axes, self._layout.spans
        self._work = new_follower_work(self._layout)
        self._state = np.zeros(follower_size(self._layout))
        self._v, self._x = np.zeros(n), np.zeros(n)
        self._ahead, self._tension_ahead = np.zeros_like(self._state), np.zeros(k)  # of the web ahead
        self._pulled: Sequence[int] = ()  # axes whose load motors are in the next three
        self._loads, self._torques, self._speeds = np.zeros((0, 3)), np.zeros(0), np.zeros(n)
        self._shown = np.zeros(2 * n + 3 * k)
        self._boundary = np.array([parameters.upstream_strain, parameters.boundary.downstream_tension_N])
        self._tension = np.zeros(k)
        self._stale = False  # tensions are not those of state, boundary and parameters
        self._broken = False
        self._rad_per_m = [parameters.motor_rad_per_m(axis) for axis in range(1, n + 1)]
        self._description = _description(parameters)
        self._names = [quantity.name for quantity in self._description.outputs]
        self.reset(x_m, strain)

    @property
    def vectors(self) -> SpanVectors:
        """What it consists of, for compiled callers: those that move it leave tensions that are up to date."""
        self._stale = False
        return SpanVectors(self._p, self._state, self._work, self._v, self._boundary, self._tension)

    @property
    def _around(self) -> tuple[float, float]:
        """Strain of the web that enters, tension behind the line."""
        return self._boundary.item(0), self._boundary.item(1)

    def describe(self) -> PlantDescription:
        """What it is; see `hilbench.plant.interface.Machine`."""
        return self._description

    def reset(self, positions: ArrayLike, strain: ArrayLike | None = None) -> None:
        """Start again at these positions (N,) and strains (K,), at rest; time goes on."""
        n = self._layout.axes
        start = start_state(self._p, self.parameters, strain)
        self._state[_TIME : _TIME + n] = positions
        self._state[_TIME + n : _TIME + n + 2 * self._layout.spans] = self._layout.y(start)[4 * n :]
        lay.forget_pieces(self._state)
        self._v[:] = 0.0
        self._evaluate()

    def _evaluate(self) -> None:
        follow_cycle(self._p, self._state, self._work, self._v, *self._around, 0.0, self._tension)
        self._stale = False

    def follow(self, positions: Sequence[float] | Vector, duration_s: float) -> None:
        """The rollers are now at `positions` (N,), `duration_s` after the last call.

        Raises ValueError for a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration {duration_s!r} s, expected more than 0")
        self._x[:] = positions
        _follow_on(
            *(self._p, self._state, self._work, self._v, self._boundary, self._x),
            *(duration_s, self._tension),
        )
        self._stale = False

    def predicted_tension_N(self, lead_s: float) -> Vector:
        """The tensions (K,) `lead_s` later if the rollers go on as in the last cycle; changes nothing.

        Makes good the delay between measuring the motion and the load motor's torque.
        """
        self._pull((), lead_s)
        return self._tension_ahead.copy()

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torques at the shafts of load motors on `axes`, of the web `lead_s` ahead; `speeds` (N,) of all rollers, m/s.

        A load motor turns as fast as the axis' motor.
        """
        self._speeds[:] = speeds
        return self._pull(axes, lead_s)

    def web_torque_Nm(self, axis: int, v_m_s: float) -> float:
        """Torque at the motor of `axis` that imitates the web and the roller's resistance: (r/i)·(F_next - F - R(v)).

        F is the tension of the span before roller `axis` (of the first: the upstream one), F_next that of the span
        behind it (of the last: the downstream one), as they are now; `v_m_s`: speed of the roller. Dry friction turns
        over linearly within ±`laws.FRICTION_WIDTH_M_S`: imitated by a torque it must not flip with the noise of v.
        Inertia and gear effects can't be imitated by it.
        """
        self._speeds[axis - 1] = v_m_s
        return self._pull((axis,), None)[0]

    def _pull(self, axes: Sequence[int], lead_s: float | None) -> list[float]:
        """Torques on these axes of the web ahead, whose tensions are in `_tension_ahead` then; None: of that of now."""
        if self._pulled != axes:
            pulled = [(axis - 1, self._rad_per_m[axis - 1], self.parameters.carries_web_load(axis)) for axis in axes]
            self._pulled, self._loads = axes, np.array(pulled, float).reshape(-1, 3)
            self._torques = np.zeros(len(axes))
        if self._broken or lead_s is None:
            self._tension_ahead[:] = self.tension_N
            lead_s = -1.0
        _pull(
            *(self._p, self._state, self._ahead, self._work, self._v, self._boundary, lead_s, self._tension_ahead),
            *(self._loads, self._speeds, self._torques),
        )
        return self._torques.tolist()

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""
        return float(self._state[0])

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,); of a web that has torn none."""
        if self._stale:
            self._evaluate()
        return np.zeros_like(self._tension) if self._broken else self._tension.copy()

    @property
    def speeds_m_s(self) -> Vector:
        """Speeds of the rollers over the last cycle (N,)."""
        return self._v.copy()

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,); of a web that has torn none."""
        return np.zeros(self._layout.spans) if self._broken else np.array(self._strain_of_lengths())

    def _strain_of_lengths(self) -> list[float]:
        n, k = self._layout.axes, self._layout.spans
        # In plain Python: of one span, every cycle, a third of numpy's time.
        lengths = self._state[_TIME + n : _TIME + n + 2 * k].tolist()
        return [lengths[k + j] * self._length_factor(j + 1) / lengths[j] - 1.0 for j in range(k)]

    def _length_factor(self, span: int) -> float:
        return lay.length_factor(self._p, self._layout, span)

    @property
    def effective_moduli_Pa(self) -> Vector:
        """E as it acts now in each span (K,), with the effects on it; of web with a splice in it that of the whole."""
        moduli = np.array([_modulus(self._p, span, self._state[0]) for span in range(self._layout.spans)])
        return moduli * [span.factor for span in self.spliced_spans] if has_pieces(self._state) else moduli

    @property
    def spliced_spans(self) -> list[SplicedSpan]:
        """What pieces of other web make of each span (K,)."""
        n, k = self._layout.axes, self._layout.spans
        if not has_pieces(self._state):
            return [WHOLE] * k
        stretch = 1.0 + float(laws.upstream_strain(self._p, self._boundary[0], self._state[0]))
        unstretched_m = self._state[_TIME + n : _TIME + n + k].tolist()
        return spliced_spans(self._state, self._state.item(_TIME), stretch, unstretched_m)

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Let these be the pieces of other web in it, in the order in which they came in; the strains stay."""
        put_pieces(self._state, pieces)
        self._stale = True

    def outputs(self) -> dict[str, float]:
        """Motion of the rollers, tension and strain of the spans, and E as it acts."""
        n, k, shown = self._layout.axes, self._layout.spans, self._shown
        if self._stale:
            self._evaluate()
        _show(self._p, self._state, self._v, self._tension, shown)
        if self._broken:
            shown[2 * n : 2 * n + 2 * k] = 0.0
        if has_pieces(self._state):
            shown[2 * n + 2 * k :] = self.effective_moduli_Pa
        return dict(zip(self._names, shown.tolist(), strict=True))

    def get_state(self) -> PlantState:
        """The state now; an equal follower goes on from it bit for bit."""
        outputs = self.outputs()
        return PlantState(
            values={quantity.name: outputs[quantity.name] for quantity in self._description.states},
            memory=_Memory(self._state.tobytes(), self._v.tobytes()),
        )

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Go on from a state of an equal follower; or transfer states by name, the others stay.

        Raises ValueError for an unknown name, or a state of another machine.
        """
        if isinstance(state, PlantState):
            memory = state.memory
            if not isinstance(memory, _Memory) or len(memory.state) != self._state.nbytes:
                raise ValueError(f"a state of another machine, expected one of a web on {self._layout.axes} rollers")
            self._state[:] = np.frombuffer(memory.state)
            self._v[:] = np.frombuffer(memory.speeds)
        else:
            self._transfer(state)
        self._evaluate()

    def _transfer(self, values: Mapping[str, float]) -> None:
        n, k = self._layout.axes, self._layout.spans
        names = [quantity.name for quantity in self._description.states]
        places = [names.index(checked_name("state", name, self._description.states)) for name in values]
        for place, value in zip(places, values.values(), strict=True):
            if place < n:
                self._state[_TIME + place] = value
            elif place < 2 * n:
                self._v[place - n] = value
            else:
                self._set_strain(place - 2 * n, value, k)

    def _set_strain(self, span: int, strain: float, spans: int) -> None:
        material = _TIME + self._layout.axes + span
        self._state[material] = self._state[material + spans] * self._length_factor(span + 1) / (1.0 + strain)

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        modulus_Pa = self._moduli.get(name)
        if modulus_Pa is not None:  # in every cycle of a twin
            return float(modulus_Pa.item(0))
        checked_name("parameter", name, self._description.parameters)
        return float(self._broken)

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on; strains stay, so a new E makes the tensions jump.

        Raises ValueError for an unknown name or an impossible value.
        """
        checked_name("parameter", name, self._description.parameters)
        if name == BROKEN.name:
            if value not in (0.0, 1.0):
                raise ValueError(f"{name} = {value!r}, expected 0 or 1")
            self._broken = value != 0.0
        else:
            self._moduli[name][:] = checked_positive(name, value, "Pa")
            self._stale = True

    def set_input(self, name: str, value: float) -> None:
        """What the neighbouring sections do from now on. Raises ValueError for an unknown name."""
        checked_name("input", name, self._description.inputs)
        place = 0 if name == "strain_prev" else 1
        if value != self._boundary.item(place):  # every cycle, and mostly what it was
            self._boundary[place], self._stale = value, True

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Give an effect these parameters from now on; the strain stays.

        Raises ValueError for an effect that is unknown or cannot be imitated, or a wrong axis, span, slot or parameter.
        """
        strain = self._strain_of_lengths()
        set_effect(self._p, effect_id, axis, section, slot, parameters, self._description.effects)
        for at, value in enumerate(strain):
            self._set_strain(at, value, len(strain))
        if effect_id == "splice":
            lay.await_splice(self._state)
        self._stale = True

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Make an effect neutral from now on. Raises as `set_effect`."""
        self.set_effect(effect_id, axis, section=section, slot=slot, **known_effect(effect_id).filled({}))


def _description(parameters: ModelParameters) -> PlantDescription:
    count = parameters.span_count
    axes, spans = axis_names(parameters.axis_count, "m"), span_names(count)
    moduli = (
        Quantity(f"E{k}_Pa", "Pa", f"Young's modulus as it acts in span {k}, with the effects on it")
        for k in range(1, count + 1)
    )
    return PlantDescription(
        kind=KIND,
        position_unit="m",
        axes=parameters.axis_count,
        motors=(),
        states=(*axes, *spans[parameters.span_count :]),
        inputs=boundary_names(),
        outputs=(*axes, *spans, *moduli),
        parameters=(*modulus_names(count), BROKEN),
        effects=tuple(effect.id for effect in effects_of(KIND) if effect.enters(EffectPlace.LOAD)),
    )


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


def follow_on(
    p: Vector,
    model: ModelParameters,
    x_m: NDArray[np.float64],
    boundary: NDArray[np.float64],
    dt_s: float,
    strain: float,
) -> tuple[Vector, Vector]:
    """Tensions (n, K) on positions as `follow`, by a parameter vector (P,) of the model with other effects, from spans
    that are strained by `strain` on; and the strains (K,) at the end."""
    web = SpanFollower(model)
    web._p[:] = p
    web.reset(x_m[0], np.full(web._layout.spans, strain))
    out = np.empty((len(x_m), web._layout.spans))
    x, limits = np.ascontiguousarray(x_m, dtype=float), np.ascontiguousarray(boundary, dtype=float)
    _follow_rows(web._p, web._state, web._work, x, limits, dt_s, web._v, out)
    return out, web.strain
