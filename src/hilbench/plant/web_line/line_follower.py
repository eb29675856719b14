"""A line with idlers, dancers, accumulators and reels on measured motion of its driven rollers: for load models.

What no motor drives has a motion of its own, which nobody measures: it is simulated by the kernel of the closed line,
with the driven rollers held to their measured motion. A driven roller turns at constant speed within a cycle, or where
the line speeds up in steps along a parabola: what has no motor needs tension for its acceleration, all the time. It is
so heavy that nothing moves it, and no web loads it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from hilbench.compiled import COUNT, REAL, VECTOR, entry_point
from hilbench.plant.effect import EffectPlace
from hilbench.plant.effects import effects_of
from hilbench.plant.interface import PlantDescription, Quantity, checked_name
from hilbench.plant.web_line import kernel, laws, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.modes import needed_substeps
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import KIND
from hilbench.plant.web_line.span import BROKEN, SpanFollower
from hilbench.plant.web_line.span_kernel import resistance_N
from hilbench.plant.web_line.stations import Reel

#: Of a driven roller: a pull of 1 kN makes it 1e-9 m/s faster in a second.
_HELD_KG: Final = 1e12
#: E·S of a web that has torn, as a share of what it was: nothing pulls.
_TORN: Final = 1e-12
#: Longest integration step where no roller asks for a shorter one, as of a web on driven rollers alone.
LONGEST_STEP_S: Final = 0.001
#: Over which the acceleration of driven rollers is averaged: positions are counted, and load motors must not chase
#: their own swings with it. Less acceleration is none, m/s².
ACCELERATION_S: Final = 0.05
LEAST_M_S2: Final = 0.02

RadiusRatio = Callable[[Vector, int, float], float]


def _entry_point(sources: int) -> RadiusRatio:
    """Compiled, and called from Python; `sources` as in the kernel."""

    @entry_point(VECTOR, COUNT, REAL)
    def radius_ratio(p: Vector, row: int, x_m: float) -> float:
        axis = lay.W_SIZE + row * lay.A_SIZE
        ratio: float = reels.radius_ratio(p, axis, x_m) if sources >= 0 and reels.is_reel(p, axis) else 1.0
        return ratio

    return radius_ratio


_radius_ratio = _entry_point(kernel.source_number(__file__))


def follower_of(parameters: ModelParameters) -> SpanFollower | LineFollower:
    """The follower of a web line: of driven rollers alone the web's, else that of all that the web runs over.

    Raises ValueError for a model without a web.
    """
    return SpanFollower(parameters) if parameters.stations is None else LineFollower(parameters)


def hold(p: Vector) -> None:
    """Let nothing move the driven rollers of a line, by its parameters (P,), but what is measured."""
    for row in lay.driven_rows(p):
        axis = lay.Layout.of(p).axis_rows(p)[row]
        axis[lay.A_MOTOR_MASS_KG], axis[lay.A_ROLLER_MASS_KG] = 0.0, _HELD_KG
        axis[lay.A_WOUND_KG] = axis[lay.A_WEB_LOAD] = 0.0


def step_s(parameters: ModelParameters) -> float:
    """Longest integration step of a line on measured motion."""
    sample_s = float(lay.pack(parameters)[lay.W_SAMPLE_TIME_S])
    return min(sample_s / needed_substeps(parameters), LONGEST_STEP_S)


class LineFollower(Line):
    """All that the web of a model runs over, on measured positions (N,) of its driven rollers, at the web.

    See `hilbench.plant.interface.Follower`; states and outputs are those of the closed line, with E as it acts
    (`E1_Pa` …) beside them. Raises ValueError for a model without a web.
    """

    def __init__(self, parameters: ModelParameters) -> None:
        self.parameters = parameters.model_copy(update={"web": parameters.required_web})
        self._torn_Pa: Vector | None = None
        super().__init__(self.parameters)
        self._sample_s = float(self._p[lay.W_SAMPLE_TIME_S])
        self._step_s = step_s(self.parameters)
        hold(self._p)
        n, rows = self._layout.axes, np.array(self._driven)
        #: Where the driven rollers (N,) stand in what is integrated: positions and speeds, of roller and motor.
        self._at, self._at_motor = rows, 2 * n + rows
        self._speed, self._speed_of_motor = n + rows, 3 * n + rows
        self._carries = [parameters.carries_web_load(axis) for axis in range(1, parameters.axis_count + 1)]
        self._rad_per_m = [parameters.motor_rad_per_m(axis) for axis in range(1, parameters.axis_count + 1)]
        self._described = _description(self._description)
        self._guess = self._state.copy()
        self._forget_motion()
        self._observe()

    def _forget_motion(self) -> None:
        """Nothing is known of what the driven rollers did."""
        self._mean_m_s: Vector | None = None  # speeds in the last cycle (N,), and its duration
        self._duration_s = 0.0
        self._m_s2 = np.zeros(len(self._driven))

    def describe(self) -> PlantDescription:
        """What it is; see `hilbench.plant.interface.Machine`."""
        return self._described

    def reset(self, positions: ArrayLike, strain: ArrayLike | None = None) -> None:
        """Start again at these positions (N,) and strains (K,), at rest, carriages as at the start; time goes on."""
        count = self._state[lay.S_COUNT]
        self._state[:] = start_state(self._p, self.parameters, strain)
        self._state[lay.S_COUNT] = count
        n, y = self._layout.axes, self._layout.y(self._state)
        for row, position in zip(self._driven, np.atleast_1d(np.asarray(positions, dtype=float)), strict=True):
            y[row] = y[2 * n + row] = position
        lay.forget_pieces(self._state)
        self._forget_motion()
        self._observe()

    def follow(self, positions: Sequence[float] | Vector, duration_s: float) -> None:
        """The driven rollers are now at `positions` (N,), `duration_s` after the last call.

        Raises ValueError for a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration {duration_s!r} s, expected more than 0")
        y, now_m = self._layout.y(self._state), np.asarray(positions, dtype=float)
        mean_m_s = (now_m - y[self._at]) / duration_s
        self._see_acceleration(mean_m_s, duration_s)
        gained_m_s = self._gained_m_s(duration_s)
        self._turn(self._state, mean_m_s - 0.5 * gained_m_s, gained_m_s, duration_s)
        y[self._at] = y[self._at_motor] = now_m  # exactly: no drift from adding up
        self._observe()

    def _see_acceleration(self, mean_m_s: Vector, duration_s: float) -> None:
        """Take the mean speeds of the driven rollers (N,) over the time since the last call."""
        if self._mean_m_s is not None:
            apart_s = 0.5 * (duration_s + self._duration_s)
            share = duration_s / (duration_s + ACCELERATION_S)
            self._m_s2 += share * ((mean_m_s - self._mean_m_s) / apart_s - self._m_s2)
        self._mean_m_s, self._duration_s = mean_m_s, duration_s

    def _gained_m_s(self, duration_s: float) -> Vector:
        """What the driven rollers (N,) gain of speed in that time, as they go on."""
        return np.where(np.abs(self._m_s2) < LEAST_M_S2, 0.0, self._m_s2) * duration_s

    def _turn(self, state: Vector, speeds_m_s: Vector, gained_m_s: Vector, duration_s: float) -> None:
        """Let the line run with driven rollers that begin with these speeds (N,) and gain so much, by as many steps as
        their drives have samples; they have the speeds of the end then."""
        y = self._layout.y(state)
        steps = max(round(duration_s / self._sample_s), 1) if gained_m_s.any() else 1
        for step in range(steps):
            y[self._speed] = y[self._speed_of_motor] = speeds_m_s + (step + 0.5) / steps * gained_m_s
            self._go_on(state, duration_s / steps)
        y[self._speed] = y[self._speed_of_motor] = speeds_m_s + gained_m_s

    @property
    def motion(self) -> Vector:
        """View of what is integrated (`Layout.y`): a change acts at once, `set_state` brings outputs up to it."""
        return self._layout.y(self._state)

    @motion.setter
    def motion(self, values: Vector) -> None:
        self._layout.y(self._state)[:] = values

    def radius_ratio(self, axis: int) -> float:
        """Radius of a reel, of a driven axis from 1, over that at the start; 1 of another roller."""
        row = self._driven[axis - 1]
        return float(_radius_ratio(self._p, row, self._layout.y(self._state).item(row)))

    def predicted_tension_N(self, lead_s: float) -> Vector:
        """The tensions (K,) `lead_s` later if the driven rollers go on as until now; changes nothing."""
        if not lead_s > 0.0:
            return self.tension_N
        self._guess[:] = self._state
        speeds_m_s = self._layout.y(self._guess)[self._speed]
        self._turn(self._guess, speeds_m_s, self._gained_m_s(lead_s), lead_s)
        out = np.empty_like(self._out)
        kernel.observe(self._p, self._guess, self._inputs, self._work, out)
        tension: Vector = out[self._layout.columns["F_N"]]
        return tension

    def _go_on(self, state: Vector, duration_s: float) -> None:
        """Let the line run by any time: the samples of drives, which are off, are cut to fit it."""
        p = self._p
        time_s, samples = state.item(lay.S_COUNT) * self._sample_s, max(round(duration_s / self._sample_s), 1)
        sample_s = duration_s / samples
        p[lay.W_SAMPLE_TIME_S] = sample_s
        p[lay.W_SUBSTEPS] = ceil(sample_s / self._step_s - 1e-9)
        state[lay.S_COUNT] = time_s / sample_s
        self._refresh_directions(state)
        kernel.advance(p, state, self._inputs, self._work, samples)
        p[lay.W_SAMPLE_TIME_S] = self._sample_s
        state[lay.S_COUNT] = (time_s + duration_s) / self._sample_s

    def _refresh_directions(self, state: Vector) -> None:
        """Dry friction of the driven rollers goes by their measured motion."""
        n = self._layout.axes
        modes = lay.S_Y + self._layout.y_size + lay.SA_DIRECTION
        for row in self._driven:
            speed = state.item(lay.S_Y + n + row)
            state[modes + row * lay.SA_SIZE] = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else 0.0

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torques at the shafts of load motors on `axes`, of the line `lead_s` ahead; `speeds` (N,) of the driven
        rollers, m/s. A load motor turns as fast as the axis' motor."""
        tension = self.predicted_tension_N(lead_s)
        return [self.web_torque_Nm(axis, speeds[axis - 1], tension_N=tension) for axis in axes]

    def web_torque_Nm(self, axis: int, v_m_s: float, *, tension_N: ArrayLike | None = None) -> float:
        """Torque at the motor of `axis` that imitates the web and the roller's resistance: (r/i)·(F_next - F - R(v)).

        F is the tension of the span before the roller, F_next that of the span behind it; of a reel one of them, with
        its present radius in the place of the nominal. `tension_N` (K,): tensions to use, default the present ones.
        """
        tensions = self.tension_N if tension_N is None else np.asarray(tension_N, dtype=float)
        row, force = self._driven[axis - 1], 0.0
        x_m = self._layout.y(self._state).item(row)
        if self._carries[axis - 1]:
            station = self.parameters.line_rollers[row].station
            wound = station.type if isinstance(station, Reel) else None
            before = tensions[row - 1] if row else 0.0 if wound else self._upstream_tension_N()
            behind = tensions[row] if row < len(tensions) else 0.0 if wound else self._inputs[lay.U_F_NEXT_N]
            force = float(behind - before) * _radius_ratio(self._p, row, x_m)
        force -= resistance_N(self._p, row, x_m, float(v_m_s), laws.FRICTION_WIDTH_M_S)
        return float(force / self._rad_per_m[axis - 1])

    def _upstream_tension_N(self) -> float:
        strain = float(laws.upstream_strain(self._p, self._inputs[lay.U_STRAIN_PREV], self.time_s))
        return strain * float(self._p[lay.W_UPSTREAM_STIFFNESS_N])

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,); of a web that has torn none."""
        return np.zeros(self._layout.spans) if self._torn_Pa is not None else super().tension_N

    @property
    def effective_moduli_Pa(self) -> Vector:
        """E as it acts now in each span (K,), with the effects on it."""
        spans = range(1, self._layout.spans + 1)
        moduli = self._layout.span_rows(self._p)[:, lay.SP_MODULUS_PA] if self._torn_Pa is None else self._torn_Pa
        return np.array([self.elasticity_factor(span) for span in spans]) * moduli

    def outputs(self) -> dict[str, float]:
        """Those of the closed line, and E as it acts; a web that has torn has neither tension nor strain."""
        spans, moduli = range(1, self._layout.spans + 1), self.effective_moduli_Pa.tolist()
        found = super().outputs() | {f"E{span}_Pa": moduli[span - 1] for span in spans}
        if self._torn_Pa is not None:
            found |= {name: 0.0 for span in spans for name in (f"F{span}_N", f"strain{span}")}
        return found

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        checked_name("parameter", name, self._described.parameters)
        torn = self._torn_Pa is not None
        if name == BROKEN.name:
            return float(torn)
        self._tear(False)
        value = super().parameter(name)
        self._tear(torn)
        return value

    def set_parameter(self, name: str, value: float) -> None:
        """Give a parameter a value from now on. Raises ValueError for an unknown name or an impossible value."""
        checked_name("parameter", name, self._described.parameters)
        if name == BROKEN.name:
            if value not in (0.0, 1.0):
                raise ValueError(f"{name} = {value!r}, expected 0 or 1")
            self._tear(value != 0.0)
        else:
            torn = self._torn_Pa is not None
            self._tear(False)
            super().set_parameter(name, value)
            self._tear(torn)
        self._observe()

    def _tear(self, torn: bool) -> None:
        """Let the web pull nothing any more, or again."""
        moduli = self._layout.span_rows(self._p)[:, lay.SP_MODULUS_PA]
        if torn and self._torn_Pa is None:
            self._torn_Pa = moduli.copy()
            moduli *= _TORN
        elif not torn and self._torn_Pa is not None:
            moduli[:] = self._torn_Pa
            self._torn_Pa = None


def _description(line: PlantDescription) -> PlantDescription:
    """Of the follower of a closed line: it has no motors, its rollers' inertia is nobody's to change."""
    spans = sum(quantity.name.startswith("strain") for quantity in line.states)
    moduli = tuple(
        Quantity(f"E{k}_Pa", "Pa", f"Young's modulus as it acts in span {k}, with the effects on it")
        for k in range(1, spans + 1)
    )
    return PlantDescription(
        kind=line.kind,
        position_unit=line.position_unit,
        axes=line.axes,
        motors=(),
        states=line.states,
        inputs=line.inputs,
        outputs=(*line.outputs, *moduli),
        parameters=(*(each for each in line.parameters if not each.name.startswith("roller_inertia")), BROKEN),
        effects=tuple(effect.id for effect in effects_of(KIND) if effect.enters(EffectPlace.LOAD)),
    )
