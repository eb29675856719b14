"""Web line on measured motion of its driven rollers: for load models, measured strains and diagnosis.

Strains follow from mass conservation; parts without a motor (idlers, dancers, accumulators) have an unmeasured motion
of their own. Both are simulated by the kernel of the closed line, with the driven rollers held to their measured
motion. A driven roller turns at constant speed within a cycle, or, where a line with parts without a motor accelerates
in steps, along a parabola: those need tension for their acceleration, all the time. Its simulated mass is infinite, and
its gear has no play.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import Vector, table_of
from hilbench.plant.effect import EffectPlace
from hilbench.plant.effects import effects_of
from hilbench.plant.interface import PlantDescription, Quantity, checked_name
from hilbench.plant.measured_motion import HasFollowed, InStep, MeasuredMotion
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_cycle, line_kernel
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_cycle import LineCycle, LoadedLine
from hilbench.plant.web_line.modes import needed_substeps
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import KIND
from hilbench.plant.web_line.splices import Piece, put_pieces
from hilbench.plant.web_line.stations import Reel

BROKEN = Quantity("broken", "1", "1: the web has torn and pulls no more; 0: it is whole")


def hold(p: Vector) -> None:
    """Make the driven rollers of a line immovable, in its parameters (P,), except by measured motion."""
    layout = lay.Layout.of(p)
    for axis, motor in zip(layout.axis_rows(p), layout.motor_rows(p), strict=False):  # load motors have no axis
        if axis.number > 0.0:
            axis.motor_mass_kg, axis.roller_mass_kg = 0.0, np.inf
            axis.wound_kg = axis.backlash.gap_rad = 0.0
            motor.feed_forward.fill(0.0)


def step_s(parameters: ModelParameters) -> float:
    """Longest integration step that the free rollers of a line on measured motion allow; infinite without any."""
    if parameters.stations is None:
        return np.inf
    return float(lay.pack(parameters)[lay.W_SAMPLE_TIME_S]) / needed_substeps(parameters)


class PerturbedCopies:
    """Followers (F,) of one line on the same measured motion, each with position offsets, in one call. Their outputs
    may be changed; `put` writes them back."""

    def __init__(self, lines: Sequence[LineFollower]) -> None:
        layout, count = lines[0]._layout, len(lines[0].driven_rows)
        self._x = np.zeros(count)
        #: Position offsets of the driven rollers (F, N), m.
        self.offsets_m = np.zeros((len(lines), count))
        self.tensions_N = np.zeros((len(lines), layout.spans))  #: as last shown, (F, K)
        self.motions = np.zeros((len(lines), layout.y_size))  #: integrated quantities (F, Y), see `Layout.y`
        #: Radii of the first line's driven rollers (N,) over those at the start; 1 of one that is no reel.
        self.ratios = np.ones(count)
        shared = line_kernel.Copies(self._x, self.offsets_m, self.tensions_N, self.motions, self.ratios)
        self._kept = shared, *(line.followed for line in lines)
        self.table = table_of(self._kept)  #: of `line_kernel.follow`

    def follow(self, positions: Sequence[float] | Vector, duration_s: float) -> None:
        """Move the driven rollers to `positions` (N,), m, `duration_s` after the last call."""
        self._x[:] = positions
        line_kernel.follow(duration_s, 0, len(self.offsets_m), self.table)

    def show(self) -> Self:
        """Update the outputs after changes of the lines."""
        line_kernel.follow(0.0, 0, len(self.offsets_m), self.table)
        return self

    def put(self) -> None:
        """Write `motions` back to the lines."""
        line_kernel.follow(0.0, 1, len(self.offsets_m), self.table)


class StateTransfer:
    """Transfer of web and undriven parts' state from a follower to an equal closed line; also of driven rollers on
    `axes`, from 1."""

    def __init__(self, follower: LineFollower, line: Line, axes: Sequence[int] = ()) -> None:
        n, k = follower._layout.axes, follower._layout.spans
        rows = follower.driven_rows[np.array(axes, int) - 1].tolist()
        places = [*follower.further_places, *rows, *(n + row for row in rows)]
        # Roller and motor turn together.
        at = [*places, *(2 * n + place for place in places), *range(4 * n, 4 * n + 2 * k)]
        self.at = np.array(at)  #: of what is transferred, in the integrated quantities
        self._line, self._from, self._to = line, follower.motion, line._layout.y(line._state)

    def __call__(self) -> None:
        """Transfer the present state."""
        self._to[self.at] = self._from[self.at]
        lay.refresh_modes(self._line._p, self._line._state)
        self._line._observe()


class LineFollower(Line):
    """Simulation of all that the web of a model runs over, on measured positions (N,) of its driven rollers, at the
    web.

    See `hilbench.plant.interface.Follower`; states and outputs are those of the closed line, with the effective E
    (`E1_Pa` …) in addition. Raises ValueError for a model without a web.
    """

    def __init__(self, parameters: ModelParameters) -> None:
        self.parameters = parameters.model_copy(update={"web": parameters.required_web})
        self._torn_Pa: Vector | None = None
        super().__init__(self.parameters)
        hold(self._p)
        count, carries = len(self._driven), parameters.carries_web_load
        self._rows = np.array(self._driven, np.int64)
        history = np.array([0.0, 0.0, self._p[lay.W_SAMPLE_TIME_S], step_s(self.parameters)])
        rollers = np.zeros(count, line_kernel.ROLLER)
        #: With the motion history of the driven rollers.
        self.followed = line_kernel.FollowedLine(self.vectors, history, rollers, self._rows)
        loads = [(axis, parameters.motor_rad_per_m(axis + 1), carries(axis + 1)) for axis in range(count)]
        self._all_loads = np.array(loads, line_cycle.LOAD)
        self._alone, self._table = PerturbedCopies([self]), table_of(self.followed)
        self._loaded: dict[tuple[int, ...], tuple[LoadedLine, NDArray[np.int64]]] = {}
        self._described = _description(self._description)
        self._forget_motion()
        self._observe()

    def _forget_motion(self) -> None:
        """Forget the motion history of the driven rollers."""
        self.followed.history[:2] = 0.0
        self.followed.rollers[:] = 0.0

    def describe(self) -> PlantDescription:
        """Description; see `hilbench.plant.interface.Machine`."""
        return self._described

    def reset(self, positions: ArrayLike, strain: ArrayLike | None = None) -> None:
        """Restart at these positions (N,) and strains (K,), at rest, carriages as at the start; time goes on."""
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
        """Move the driven rollers to `positions` (N,), `duration_s` after the last call.

        Raises ValueError for a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration {duration_s!r} s, expected more than 0")
        self._alone.follow(positions, duration_s)

    def follow_rows(self, x_m: NDArray[np.float64], boundary: NDArray[np.float64], cycle_s: float) -> Vector:
        """Tensions (n, K) on positions (n, N) as `follow`; the first row is the present position. `boundary` (n, 2):
        strain of the web that enters, tension after the line in N, each from its row on.

        Raises ValueError for shapes that do not fit.
        """
        n = len(self._rows)
        if x_m.shape != (len(x_m), n) or boundary.shape != (len(x_m), 2):
            raise ValueError(f"positions {x_m.shape}, boundary {boundary.shape}, expected (n, {n}) and (n, 2)")
        tensions = np.empty((len(x_m), self._layout.spans))
        x, limits = np.ascontiguousarray(x_m, dtype=float), np.ascontiguousarray(boundary, dtype=float)
        line_kernel.follow_rows(self._table, x, np.zeros(n), limits, cycle_s, tensions)
        return tensions

    def follow_on(
        self, p: Vector, x_m: NDArray[np.float64], boundary: NDArray[np.float64], cycle_s: float, strain: Vector
    ) -> tuple[Vector, Vector]:
        """`follow_rows` from the start, with strains `strain` (K,) at first; and the final strains (K,).

        From now on the parameter vector is `p` (P,): the model's with other effects.
        """
        self._p[:] = p
        hold(self._p)
        self._state[lay.S_COUNT] = 0.0
        self.reset(x_m[0], strain)
        return self.follow_rows(x_m, boundary, cycle_s), self.strain

    @property
    def motion(self) -> Vector:
        """View of the integrated quantities (`Layout.y`): a change acts at once, `set_state` updates the outputs."""
        return self._layout.y(self._state)

    @motion.setter
    def motion(self, values: Vector) -> None:
        self._layout.y(self._state)[:] = values

    def radius_ratio(self, axis: int) -> float:
        """Radius of a reel, of a driven axis from 1, over that at the start; 1 of another roller."""
        return self._alone.show().ratios.item(axis - 1)

    def predicted_tension_N(self, lead_s: float) -> Vector:
        """Tensions (K,) predicted `lead_s` ahead with the driven rollers' present motion; changes nothing."""
        if not lead_s > 0.0:
            return self.tension_N
        tension: Vector = self._pulled((), lead_s).ahead[self._layout.columns["F_N"]].copy()
        return tension

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torques at the shafts of load motors on `axes`, by the line predicted `lead_s` ahead; `speeds` (N,) of the
        driven rollers, m/s. A load motor turns as fast as the axis's motor.

        They emulate the web and the roller's resistance: (r/i)·(F_next - F - R(v)). F is the tension of the span before
        the roller, F_next that of the span after it; of a reel one of them, with its present radius in place of the
        nominal.
        """
        found: list[float] = self._pulled(tuple(axes), max(lead_s, 0.0), speeds).torques.tolist()
        return found

    def in_step(self, motion: MeasuredMotion, axes: Sequence[int]) -> LineInStep:
        """Compiled follower with load motors on `axes`; see `hilbench.plant.measured_motion.FollowsInStep`."""
        return LineInStep(self, motion, axes)

    def loaded(self, axes: tuple[int, ...]) -> tuple[LoadedLine, NDArray[np.int64]]:
        """Vectors, and their table, of this line with load motors on these axes."""
        if axes not in self._loaded:
            loads = self._all_loads[np.array(axes, int) - 1]
            speeds, guess, ahead = (np.zeros(len(each)) for each in (self._driven, self._state, self._out))
            torques_Nm, lead_s, moduli_Pa = (np.zeros(count) for count in (len(axes), 1, self._layout.spans))
            loaded = LoadedLine(self.followed, loads, speeds, guess, ahead, torques_Nm, lead_s, moduli_Pa)
            self._loaded[axes] = loaded, table_of(loaded)
        return self._loaded[axes]

    def _pulled(self, axes: tuple[int, ...], lead_s: float, speeds: Sequence[float] = ()) -> LoadedLine:
        """Update load torques, by the line predicted `lead_s` ahead, and E of its spans."""
        loaded, table = self.loaded(axes)
        if axes:
            loaded.speeds[:] = speeds
        loaded.lead_s[0] = lead_s
        line_cycle.follow(line_cycle.PULL, table)
        return loaded

    @property
    def is_torn(self) -> bool:
        """True if the web is broken."""
        return self._torn_Pa is not None

    @property
    def places_of_outputs(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Indices of the described outputs: in the kernel's report; in the integrated quantities; rows of the reels,
        whose radii follow, and then E of the spans."""
        reels = [row for row, roller in enumerate(self.parameters.line_rollers) if isinstance(roller.station, Reel)]
        columns = [place for place, _ in self._columns]  # at the web: unscaled
        return np.array(columns, np.int64), np.array(self.further_places, np.int64), np.array(reels, np.int64)

    def web_torque_Nm(self, axis: int, v_m_s: float) -> float:
        """Load torque of one axis at the present tensions."""
        return self.load_torques_Nm([axis], [v_m_s] * len(self._driven), 0.0)[0]

    @property
    def driven_rows(self) -> NDArray[np.int64]:
        """Rows of the driven rollers, (N,)."""
        return self._rows

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,); 0 for a broken web."""
        return np.zeros(self._layout.spans) if self.is_torn else super().tension_N

    @property
    def effective_moduli_Pa(self) -> Vector:
        """Present E of each span (K,), with effects, including a splice in it; of a broken web as if it were whole."""
        torn = self.is_torn
        self._tear(False)
        moduli_Pa = self._pulled((), 0.0).moduli.copy()
        self._tear(torn)
        return moduli_Pa

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,); 0 for a broken web."""
        return np.zeros(self._layout.spans) if self.is_torn else super().strain

    def put_pieces(self, pieces: Sequence[Piece]) -> None:
        """Set the pieces of other web, in the order in which they came in; the strains stay."""
        put_pieces(self._state, pieces)
        self._observe()

    def outputs(self) -> dict[str, float]:
        """Outputs of the closed line, and the effective E; tension and strain are 0 for a broken web."""
        spans, moduli = range(1, self._layout.spans + 1), self.effective_moduli_Pa.tolist()
        found = super().outputs() | {f"E{span}_Pa": moduli[span - 1] for span in spans}
        if self.is_torn:
            found |= {name: 0.0 for span in spans for name in (f"F{span}_N", f"strain{span}")}
        return found

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        checked_name("parameter", name, self._described.parameters)
        torn = self.is_torn
        if name == BROKEN.name:
            return float(torn)
        self._tear(False)
        value = super().parameter(name)
        self._tear(torn)
        return value

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        checked_name("parameter", name, self._described.parameters)
        if name == BROKEN.name:
            if value not in (0.0, 1.0):
                raise ValueError(f"{name} = {value!r}, expected 0 or 1")
            self._tear(value != 0.0)
        else:
            torn = self.is_torn
            self._tear(False)
            super().set_parameter(name, value)
            self._tear(torn)
        self._observe()

    def _tear(self, torn: bool) -> None:
        """Break the web, or restore it."""
        moduli = self._layout.span_rows(self._p).modulus_Pa
        if torn and self._torn_Pa is None:
            self._torn_Pa = moduli.copy()
            moduli[:] = 0.0
        elif not torn and self._torn_Pa is not None:
            moduli[:] = self._torn_Pa
            self._torn_Pa = None


class LineInStep(InStep):
    """Compiled step of a `LineFollower` on measured motion; see `hilbench.plant.measured_motion.InStep`."""

    def __init__(self, line: LineFollower, motion: MeasuredMotion, axes: Sequence[int]) -> None:
        self._line = line
        loaded, further = line.loaded(tuple(axes))[0], np.zeros(len(line.driven_rows))
        shown, values, at = np.zeros(len(line.describe().outputs)), np.zeros(0), np.zeros(0, np.int64)
        columns, states, reels = line.places_of_outputs
        arrays = LineCycle(loaded, motion.vectors, further, columns, states, reels, shown, values, at)
        super().__init__(line_cycle.follow, line_cycle.FOLLOWED, loaded.torques, arrays)

    @property
    def usable(self) -> bool:
        """True if the web is not broken."""
        return not self._line.is_torn

    def has_followed(self, code: int) -> HasFollowed:
        """Result of a step by its return code."""
        return HasFollowed.NOT if code == line_cycle.NOTHING else HasFollowed.ALL


def _description(line: PlantDescription) -> PlantDescription:
    """Description of the follower of a closed line: without motors, and without the rollers' inertias as parameters."""
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
