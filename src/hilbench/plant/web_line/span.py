"""Web on measured motion: strain and tension from encoder positions, for the load model and for diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import interpreted
from hilbench.plant.effect import EffectPlace
from hilbench.plant.effects import effects_of
from hilbench.plant.in_step import CompiledInStep
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.measured_motion import HasFollowed, MeasuredMotion
from hilbench.plant.web_line import follower_cycle, laws, span_kernel
from hilbench.plant.web_line import layout as lay
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
from hilbench.plant.web_line.span_kernel import POSITIONS, SpanVectors
from hilbench.plant.web_line.splices import WHOLE, Piece, SplicedSpan, has_pieces, put_pieces, spliced_spans
from hilbench.plant.web_line.stations import ONLY_DRIVEN

_downstream_strain = interpreted(laws.downstream_strain)

BROKEN = Quantity("broken", "1", "1: the web has torn and pulls no more; 0: it is whole")


@dataclass(frozen=True, slots=True)
class _Memory:
    """State of a follower beyond its named states: its state vector and the rollers' speeds over the last cycle."""

    state: bytes
    speeds: bytes


class SpanFollower:
    """Simulation of the web on measured roller positions; the rollers turn at constant speed within a cycle.

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
        self._work = span_kernel.new_follower_work(self._layout)
        self._state = np.zeros(span_kernel.follower_size(self._layout))
        self._v, self._x = np.zeros(n), np.zeros(n)
        self._ahead, self._tension_ahead = np.zeros_like(self._state), np.zeros(k)  # of the predicted web
        self._pulled: Sequence[int] = ()  # axes of the load motors in the next three
        self._loads, self._torques, self._speeds = np.zeros((0, 3)), np.zeros(0), np.zeros(n)
        self._shown = np.zeros(2 * n + 3 * k)
        behind_N = parameters.boundary.downstream_tension_N
        self._boundary = np.array([parameters.upstream_strain, behind_N, _downstream_strain(self._p, behind_N), 0.0])
        self._tension = np.zeros(k)
        self._stale = False  # tensions are not up to date with state, boundary and parameters
        self._broken = False
        self._rad_per_m = [parameters.motor_rad_per_m(axis) for axis in range(1, n + 1)]
        self._description = _description(parameters)
        self._names = [quantity.name for quantity in self._description.outputs]
        self.reset(x_m, strain)

    @property
    def vectors(self) -> SpanVectors:
        """Vectors of the follower, for compiled callers, which have to keep the tensions up to date."""
        self._stale = False
        return SpanVectors(self._p, self._state, self._work, self._v, self._boundary, self._tension)

    def describe(self) -> PlantDescription:
        """Description; see `hilbench.plant.interface.Machine`."""
        return self._description

    def reset(self, positions: ArrayLike, strain: ArrayLike | None = None) -> None:
        """Restart at these positions (N,) and strains (K,), at rest; time goes on."""
        n = self._layout.axes
        start = start_state(self._p, self.parameters, strain)
        self._state[POSITIONS : POSITIONS + n] = positions
        self._state[POSITIONS + n : POSITIONS + n + 2 * self._layout.spans] = self._layout.y(start)[4 * n :]
        lay.forget_pieces(self._state)
        self._v[:] = 0.0
        self._evaluate()

    def _evaluate(self) -> None:
        self._go_on(0.0)

    def follow(self, positions: Sequence[float] | Vector, duration_s: float) -> None:
        """Move the rollers to `positions` (N,), `duration_s` after the last call.

        Raises ValueError for a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration {duration_s!r} s, expected more than 0")
        self._x[:] = positions
        self._go_on(duration_s)

    def _go_on(self, duration_s: float) -> None:
        """Move to the positions `_x`; for duration 0 compute the tensions at the present ones."""
        span_kernel.follow(
            *(self._p, self._state, self._work, self._v, self._boundary, self._x),
            *(duration_s, self._tension),
        )
        self._stale = False

    def follow_on(
        self, p: Vector, x_m: NDArray[np.float64], boundary: NDArray[np.float64], dt_s: float, strain: Vector
    ) -> tuple[Vector, Vector]:
        """Tensions (n, K) on positions (n, N) as `follow`, starting with strains `strain` (K,); and the final strains
        (K,).

        From now on the parameter vector is `p` (P,): the model's with other effects.
        """
        self._p[:] = p
        self._state[:] = 0.0
        self.reset(x_m[0], strain)
        return self.follow_rows(x_m, boundary, dt_s), self.strain

    def follow_rows(self, x_m: NDArray[np.float64], boundary: NDArray[np.float64], dt_s: float) -> Vector:
        """Tensions (n, K) on positions (n, N) as `follow`; the first row is the present position. `boundary` (n, 2):
        strain of the web that enters, tension after the line in N."""
        out = np.empty((len(x_m), self._layout.spans))
        x, limits = np.ascontiguousarray(x_m, dtype=float), np.ascontiguousarray(boundary, dtype=float)
        span_kernel.follow_rows(self._p, self._state, self._work, x, limits, dt_s, self._v, out)
        return out

    def predicted_tension_N(self, lead_s: float) -> Vector:
        """Tensions (K,) predicted `lead_s` ahead at the rollers' present speeds; changes nothing.

        Compensates the dead time between measuring the motion and the load motor's torque.
        """
        self._pull((), lead_s)
        return self._tension_ahead.copy()

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torques at the shafts of load motors on `axes`, by the web `lead_s` ahead; `speeds` (N,) of all rollers, m/s.

        A load motor turns as fast as the axis's motor.
        """
        self._speeds[:] = speeds
        return self._pull(axes, lead_s)

    def web_torque_Nm(self, axis: int, v_m_s: float) -> float:
        """Torque at the motor of `axis` that emulates the web and the roller's resistance: (r/i)·(F_next - F - R(v)).

        F is the present tension of the span before roller `axis` (of the first: the upstream one), F_next that of the
        span after it (of the last: the downstream one); `v_m_s`: speed of the roller. Dry friction is linear within
        ±`laws.FRICTION_WIDTH_M_S`: emulated by a torque it must not flip with the noise of v. Inertia and gear effects
        can't be emulated by it.
        """
        self._speeds[axis - 1] = v_m_s
        return self._pull((axis,), None)[0]

    def _pull(self, axes: Sequence[int], lead_s: float | None) -> list[float]:
        """Torques on these axes by the predicted web (tensions into `_tension_ahead`); None: by the present one."""
        if self._pulled != axes:
            self._pulled, self._loads = axes, self._pulled_by(axes)
            self._torques = np.zeros(len(axes))
        if self._broken or lead_s is None:
            self._tension_ahead[:] = self.tension_N
            lead_s = -1.0
        span_kernel.pull(
            *(self._p, self._state, self._ahead, self._work, self._v, self._boundary, lead_s, self._tension_ahead),
            *(self._loads, self._speeds, self._torques),
        )
        return self._torques.tolist()

    def _pulled_by(self, axes: Sequence[int]) -> Vector:
        """Rows of `span_kernel.pull` for load motors on these axes."""
        pulled = [(axis - 1, self._rad_per_m[axis - 1], self.parameters.carries_web_load(axis)) for axis in axes]
        return np.array(pulled, float).reshape(-1, 3)

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> SpansInStep:
        """Compiled follower with load motors on `axes`; see `hilbench.plant.measured_motion.FollowsInStep`."""
        return SpansInStep(self, motion, axes)

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""
        return float(self._state[0])

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,); 0 for a broken web."""
        if self._stale:
            self._evaluate()
        return np.zeros_like(self._tension) if self._broken else self._tension.copy()

    @property
    def speeds_m_s(self) -> Vector:
        """Speeds of the rollers over the last cycle (N,)."""
        return self._v.copy()

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,); 0 for a broken web."""
        return np.zeros(self._layout.spans) if self._broken else np.array(self._strain_of_lengths())

    @property
    def first_strain(self) -> float:
        """Strain of the first span."""
        if self._broken:
            return 0.0
        first, state = POSITIONS + self._layout.axes, self._state  # scalars: faster than numpy, several times a cycle
        return state.item(first + self._layout.spans) * self._length_factor(1) / state.item(first) - 1.0

    def _strain_of_lengths(self) -> list[float]:
        n, k = self._layout.axes, self._layout.spans
        # Scalar access: with one span, every cycle, a third of numpy's time.
        lengths = self._state[POSITIONS + n : POSITIONS + n + 2 * k].tolist()
        return [lengths[k + j] * self._length_factor(j + 1) / lengths[j] - 1.0 for j in range(k)]

    def _length_factor(self, span: int) -> float:
        return lay.length_factor(self._p, self._layout, span)

    @property
    def effective_moduli_Pa(self) -> Vector:
        """Present E of each span (K,) with effects, including a splice in it."""
        moduli = np.array([span_kernel.modulus_Pa(self._p, span, self._state[0]) for span in range(self._layout.spans)])
        return moduli * [span.factor for span in self.spliced_spans] if has_pieces(self._state) else moduli

    @property
    def spliced_spans(self) -> list[SplicedSpan]:
        """Effect of the pieces of other web on each span (K,)."""
        n, k = self._layout.axes, self._layout.spans
        if not has_pieces(self._state):
            return [WHOLE] * k
        stretch = 1.0 + float(laws.upstream_strain(self._p, self._boundary[0], self._state[0]))
        unstretched_m = self._state[POSITIONS + n : POSITIONS + n + k].tolist()
        return spliced_spans(self._state, self._state.item(POSITIONS), stretch, unstretched_m)

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Set the pieces of other web, in the order in which they came in; the strains stay."""
        put_pieces(self._state, pieces)
        self._stale = True

    def outputs(self) -> dict[str, float]:
        """Motion of the rollers, tension and strain of the spans, and E with effects."""
        n, k, shown = self._layout.axes, self._layout.spans, self._shown
        if self._stale:
            self._evaluate()
        span_kernel.show(self._p, self._state, self._v, self._tension, shown)
        if self._broken:
            shown[2 * n : 2 * n + 2 * k] = 0.0
        if has_pieces(self._state):
            shown[2 * n + 2 * k :] = self.effective_moduli_Pa
        return dict(zip(self._names, shown.tolist(), strict=True))

    def get_state(self) -> PlantState:
        """Present state; an equal follower continues from it bit for bit."""
        outputs = self.outputs()
        return PlantState(
            values={quantity.name: outputs[quantity.name] for quantity in self._description.states},
            memory=_Memory(self._state.tobytes(), self._v.tobytes()),
        )

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal follower; or transfer states by name, the others stay.

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
                self._state[POSITIONS + place] = value
            elif place < 2 * n:
                self._v[place - n] = value
            else:
                self._set_strain(place - 2 * n, value, k)

    def _set_strain(self, span: int, strain: float, spans: int) -> None:
        material = POSITIONS + self._layout.axes + span
        self._state[material] = self._state[material + spans] * self._length_factor(span + 1) / (1.0 + strain)

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        modulus_Pa = self._moduli.get(name)
        if modulus_Pa is not None:  # in every cycle of a twin
            return float(modulus_Pa.item(0))
        checked_name("parameter", name, self._description.parameters)
        return float(self._broken)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on; strains stay, so a new E makes the tensions jump.

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
        """Set a boundary input from now on. Raises ValueError for an unknown name."""
        checked_name("input", name, self._description.inputs)
        place = 0 if name == "strain_prev" else 1
        if value != self._boundary.item(place):  # every cycle, mostly unchanged
            self._boundary[place], self._stale = value, True
            if place == 1:
                self._boundary[2] = _downstream_strain(self._p, value)

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect's parameters from now on; the strain stays.

        Raises ValueError for an effect that is unknown or cannot be emulated, or a wrong axis, span, slot or parameter.
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


class SpansInStep(CompiledInStep):
    """Compiled step of a `SpanFollower` on measured motion; see `hilbench.plant.measured_motion.InStep`."""

    def __init__(self, web: SpanFollower, motion: MeasuredMotion, axes: Sequence[int]) -> None:
        self._web, torques_Nm = web, np.zeros(len(axes))
        of_web = web._p, web._state, web._ahead, web._work, web._v, web._boundary, web._tension, web._tension_ahead
        of_motion = motion.state, motion.travels, motion.positions, motion.speeds
        kept = *of_web, web._pulled_by(axes), torques_Nm, web._shown, *of_motion
        super().__init__(follower_cycle.follow, follower_cycle.FOLLOWED, torques_Nm, kept)

    @property
    def usable(self) -> bool:
        """True if the web is not broken."""
        return not self._web._broken

    @property
    def is_shown(self) -> bool:
        """True if nothing was changed since the last step."""
        return not self._web._stale

    def has_followed(self, code: int) -> HasFollowed:
        """Result of a step by its return code; see `InStep`."""
        if code == follower_cycle.NOTHING:
            return HasFollowed.NOT
        self._web._stale = False
        return HasFollowed.TORQUES if code == follower_cycle.WITH_PIECES else HasFollowed.ALL


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
    n = start._layout.axes
    if x_m.shape != (len(x_m), n) or boundary.shape != (len(x_m), 2):
        raise ValueError(f"positions {x_m.shape}, boundary {boundary.shape}, expected (n, {n}) and (n, 2)")
    return start.follow_rows(x_m, boundary, dt_s)
