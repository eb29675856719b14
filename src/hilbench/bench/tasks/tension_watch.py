"""Independent check of the twin's tension: block means of torques and encoders in the intervals of `tension_bounds`.

Where the twin is beyond one of them its tension loop opens, with E by torques and encoders for the ratio of speeds, and
closes again when the twin has been within it for a while. Each cycle only adds to sums; every tenth of a second
they are judged, in the same compiled stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.state import TwinState
from hilbench.bench.tasks import tension_bounds as bounds
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs, PerSample
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.bench.tasks.tension_trust import VirtualSensorSupervision
from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    floats,
    integers,
    interpreted,
    table_of,
)
from hilbench.cycle_program import CONTINUE, CompiledStage
from hilbench.estimation.problems import TORQUE_SHIFT, UNDECIDED
from hilbench.estimation.web_line.config import EstimationConfig, ModelErrorsConfig, PidConfig
from hilbench.exchange.exchange import Inputs
from hilbench.plant.parameters import per_item
from hilbench.plant.sample_coherence import coherence_state, coherent
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import axes_before_spans, section_model
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.plant.web_line.stations import CarriageStation, Idler, Reel
from hilbench.topology.sample import CycleSample
from hilbench.twin.virtual_io import MODEL_CHANGING

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Places = NDArray[np.int64]

#: Duration of a block; ten of them are a mean over 1 s, two turns of a roller of 0.2 m at 2.5 m/s.
_BLOCK_S = 0.1
#: Share of a drive's torque limit from which what its torque shows is the limit.
_AT_LIMIT = 0.98
#: What turns with a roller is in no block mean: a deviation of those, not a known force.
_TURNING = ("unbalance", "torque_ripple", "torque_ripple_load")

#: The twin switches to another model.
#: Outcome of `run`: the verdict on a twin has changed.
_LOOK = CONTINUE + 1
# Rows of the table.
(_VALUES, _WORDS, _AT, _PARAMETERS, _ROLLERS, _MOTION, _BEGUN, _LINE, _COHERENCE, _POSITIONS, _WEB) = range(11)
(_FIGURES, _STATES, _RINGS, _SUMS, _PLACED, _BLOCK) = range(11, 17)
#: Of a line: cycles of a block and how many it has; the cycle in which it began; samples whose positions are of one
#: instant; the leading axis' command; 1 if that, or the twin's model, has changed, or a torque is at its limit;
#: sum of the tension
#: after the line; a cycle in s; tolerance of position differences, m; strain after the line; 1 if a block has
#: begun, and 1 if the web's state matches the rollers.
_CYCLES, _COUNTED, _BEGAN, _PAIRED, _COMMAND_M_S, _CHANGED, _NEXT_SUM_N = range(7)
_CYCLE_S, _TRAVEL_M, _DOWNSTREAM, _HAS, _HAS_WEB, _LINE_SIZE = range(7, 13)
#: Of an axis, when a block began and since: position, speed, sum of torques; its limit.
_AT_M, _AT_M_S, _SUM_NM, _LIMIT_NM, _BEGUN_SIZE = range(5)
#: Of the axes' positions: now, the last that were of one instant, and the travels since.
_NOW_M, _LAST_M, _TRAVEL, _POSITIONS_SIZE = range(4)
#: Of the web in the sections: length, unstretched, strain, sum of strains.
_LENGTH_M, _UNSTRETCHED_M, _STRAIN, _STRAIN_SUM, _WEB_SIZE = range(5)
#: Of a span: sums of the twin's tension and E; set-point; whether that changed; cycles with an open loop.
_TWIN_SUM_N, _TWIN_SUM_PA, _GOAL_N, _GOAL_CHANGED, _OPEN, _SUMS_SIZE = range(6)
#: Of a span: index of the roller behind it, and of its section where its strain is known, else NOWHERE.
_FIRST, _SECTION, _PLACED_SIZE = range(3)
_NOWHERE = -1
#: Places in a sample: position, speed, torque of each axis, then these, then of each span tension and E of the twin,
#: set-point, whether the loop is closed.
_OF_AXIS, _OF_LINE, _OF_SPAN = 3, 5, 4
_COMMAND_AT, _PREV_AT, _NEXT_AT, _CYCLE_AT, _STATUS_AT = range(5)


@compiled
def _begin(values: Vector, words: Places, at: Places, begun: Matrix, line: Vector, web: Matrix, sums: Matrix) -> None:
    """A block."""
    axes = begun.shape[1]
    for j in range(axes):
        begun[_AT_M, j], begun[_AT_M_S, j] = values[at[3 * j]], values[at[3 * j + 1]]
        begun[_SUM_NM, j] = 0.0
    line[_COUNTED], line[_BEGAN], line[_HAS] = 0.0, words[at[_OF_AXIS * axes + _CYCLE_AT]], 1.0
    line[_PAIRED], line[_CHANGED], line[_NEXT_SUM_N] = 0.0, 0.0, 0.0
    line[_COMMAND_M_S] = values[at[_OF_AXIS * axes + _COMMAND_AT]]
    web[_STRAIN_SUM] = 0.0
    for k in range(len(sums)):
        goal = at[_OF_AXIS * axes + _OF_LINE + _OF_SPAN * k + 2]
        sums[k] = 0.0
        sums[k, _GOAL_N] = values[goal]


@compiled
def _add(values: Vector, words: Places, at: Places, begun: Matrix, line: Vector, sums: Matrix) -> None:
    """Add a cycle to a block."""
    axes = begun.shape[1]
    for j in range(axes):
        torque_Nm = values[at[3 * j + 2]]
        begun[_SUM_NM, j] += torque_Nm
        if abs(torque_Nm) >= begun[_LIMIT_NM, j]:
            line[_CHANGED] = 1.0
    of_line = at[_OF_AXIS * axes :]
    status = words[of_line[_STATUS_AT]]
    if values[of_line[_COMMAND_AT]] != line[_COMMAND_M_S] or status & MODEL_CHANGING != 0:
        line[_CHANGED] = 1.0
    line[_NEXT_SUM_N] += values[of_line[_NEXT_AT]]
    line[_COUNTED] += 1.0
    for k in range(len(sums)):
        of_span = of_line[_OF_LINE + _OF_SPAN * k :]
        sums[k, _TWIN_SUM_N] += values[of_span[0]]
        sums[k, _TWIN_SUM_PA] += values[of_span[1]]
        if values[of_span[2]] != sums[k, _GOAL_N]:
            sums[k, _GOAL_CHANGED] = 1.0
        if words[of_span[3]] == 0:
            sums[k, _OPEN] += 1.0


@compiled
def _follow(values: Vector, at: Places, line: Vector, coherence: Vector, positions: Matrix, web: Matrix) -> None:
    """The web by mass conservation, where the positions are of one instant."""
    axes = positions.shape[1]
    now_m, last_m, travel_m = positions[_NOW_M], positions[_LAST_M], positions[_TRAVEL]
    for j in range(axes):
        now_m[j] = values[at[3 * j]]
    if not coherent(coherence, now_m, line[_TRAVEL_M]):
        return
    of_line = at[_OF_AXIS * axes :]
    if line[_HAS_WEB] == 0.0:  # at rest, and strained as the web upstream
        for k in range(axes - 1):
            web[_STRAIN, k] = values[of_line[_PREV_AT]]
            web[_UNSTRETCHED_M, k] = web[_LENGTH_M, k] / (1.0 + web[_STRAIN, k])
        line[_HAS_WEB] = 1.0
    else:
        for j in range(axes):
            travel_m[j] = now_m[j] - last_m[j]
        before, behind = values[of_line[_PREV_AT]], line[_DOWNSTREAM]
        bounds.stretch(web[_UNSTRETCHED_M], web[_STRAIN], web[_LENGTH_M], travel_m, before, behind)
    for j in range(axes):
        last_m[j] = now_m[j]
    for k in range(axes - 1):
        web[_STRAIN_SUM, k] += web[_STRAIN, k]
    line[_PAIRED] += 1.0


@compiled
def _move(values: Vector, at: Places, begun: Matrix, counted: float, lasted_s: float, motion: Matrix) -> None:
    """Means of the axes over a block."""
    for j in range(len(motion)):
        motion[j, bounds.TORQUE_NM] = begun[_SUM_NM, j] / counted
        motion[j, bounds.SPEED_M_S] = (values[at[3 * j]] - begun[_AT_M, j]) / lasted_s
        motion[j, bounds.RATE_M_S2] = (values[at[3 * j + 1]] - begun[_AT_M_S, j]) / lasted_s


@compiled
def _fill(line: Vector, web: Matrix, sums: Vector, placed: Places, f: Vector, lasted_s: float, block: Vector) -> None:
    """Fill a block's values other than the momentum balance."""
    counted, section = line[_COUNTED], placed[_SECTION]
    block[bounds.TWIN_N], block[bounds.TWIN_PA] = sums[_TWIN_SUM_N] / counted, sums[_TWIN_SUM_PA] / counted
    block[bounds.STRETCH_M2] = 0.0
    if section != _NOWHERE and line[_PAIRED] > 0.0:
        block[bounds.STRETCH_M2] = f[bounds.SECTION_M2] * web[_STRAIN_SUM, section] / line[_PAIRED]
    block[bounds.BLOCK_S] = lasted_s
    block[bounds.CLOSED] = 1.0 if sums[_OPEN] == 0.0 else 0.0
    block[bounds.UNCHANGED] = 1.0 if line[_CHANGED] == 0.0 and sums[_GOAL_CHANGED] == 0.0 else 0.0


#: run(0, table of `TensionWatch`): CONTINUE, or that the verdict on a twin has changed.
@entry_point(COUNT, TABLE)
def _run(_: int, table: Places) -> int:
    if len(table) == 0:
        return CONTINUE
    values, words, at = floats(table, _VALUES, (1,)), integers(table, _WORDS, (1,)), integers(table, _AT, (1,))
    begun, line, web = floats(table, _BEGUN, (1, 2)), floats(table, _LINE, (1,)), floats(table, _WEB, (1, 2))
    sums, placed = floats(table, _SUMS, (1, 2)), integers(table, _PLACED, (1, 2))
    _follow(values, at, line, floats(table, _COHERENCE, (1,)), floats(table, _POSITIONS, (1, 2)), web)
    if line[_HAS] == 0.0:
        _begin(values, words, at, begun, line, web, sums)
        return CONTINUE
    _add(values, words, at, begun, line, sums)
    if line[_COUNTED] < line[_CYCLES]:
        return CONTINUE
    motion, rollers = floats(table, _MOTION, (1, 2)), floats(table, _ROLLERS, (1, 2))
    figures, states, rings = (
        floats(table, _FIGURES, (1, 2)),
        floats(table, _STATES, (1, 2)),
        floats(table, _RINGS, (1, 2, 3)),
    )
    block, p = floats(table, _BLOCK, (1,)), floats(table, _PARAMETERS, (1,))
    lasted_s = (words[at[_OF_AXIS * begun.shape[1] + _CYCLE_AT]] - line[_BEGAN]) * line[_CYCLE_S]
    _move(values, at, begun, line[_COUNTED], lasted_s, motion)
    code = CONTINUE
    for k in range(len(sums)):
        _fill(line, web, sums[k], placed[k], figures[k], lasted_s, block)
        block[bounds.TENSION_N] = line[_NEXT_SUM_N] / line[_COUNTED]
        block[bounds.LINE_M_S] = motion[len(motion) - 1, bounds.SPEED_M_S]
        mean_s = bounds.BLOCKS * lasted_s
        bounds.momentum_balance(p, figures[k], rollers, motion, placed[k, _FIRST], mean_s, block)
        if bounds.judge(figures[k], states[k], rings[k], block):
            code = _LOOK
    _begin(values, words, at, begun, line, web, sums)
    return code


@dataclass(frozen=True)
class WatchedLoop:
    """A tension loop that is watched: what opens it, and whether its twin's E follows a step within
    `tension_bounds.PERSISTS_S`."""

    task: TensionTask
    trust: VirtualSensorSupervision
    follows_at_once: bool


class TensionWatch(CyclicTask):
    """Opens tension loops whose twin is physically implausible, until it is plausible again."""

    def __init__(
        self,
        loops: Sequence[WatchedLoop],
        model: ModelParameters,
        twin_config: EstimationConfig,
        twin: TwinState,
        cycle_s: float,
    ) -> None:
        self._loops, self._twin, self._back_cycle = tuple(loops), twin, twin.back_cycle
        axes, errors = model.axis_count, twin_config.model_errors
        sections = section_model(model)
        self._parameters = lay.pack(
            sections.model_copy(update={"effects": tuple(e for e in sections.effects if e.effect not in _TURNING)})
        )
        usual_N = max(loop.task.set_point_N for loop in loops)
        self._rollers = np.array([_roller(sections, axis, errors, usual_N) for axis in range(1, axes + 1)])
        self._motion = np.zeros((axes, bounds.MOTION))
        self._begun, self._positions = np.zeros((_BEGUN_SIZE, axes)), np.zeros((_POSITIONS_SIZE, axes))
        limits_Nm = [
            per_item(sections.drives.torque_limit_Nm, k + 1) if sections.drives else np.inf for k in range(axes)
        ]
        self._begun[_LIMIT_NM] = _AT_LIMIT * np.array(limits_Nm)
        self._line, self._coherence = np.zeros(_LINE_SIZE), coherence_state(axes)
        self._line[_CYCLES] = max(1, round(_BLOCK_S / cycle_s))
        travel_m = least_travel_m(model, cycle_s)
        self._line[[_CYCLE_S, _TRAVEL_M, _DOWNSTREAM]] = cycle_s, travel_m, model.downstream_strain
        self._web = np.zeros((_WEB_SIZE, axes - 1))
        self._web[_LENGTH_M] = [sections.span_length_m(k) for k in range(1, axes)]
        self._figures = np.array([_figures(model, sections, loop, errors) for loop in loops])
        known = model.stations is None and twin_config.web_at_rest == "as_upstream"
        estimated = twin_config.by_span(model.span_count) if known else ()
        self._placed = np.array(
            [[loop.task.names.axis, loop.task.span - 1 if loop.task.span in estimated else _NOWHERE] for loop in loops],
            np.int64,
        )
        self._states = np.zeros((len(loops), bounds.STATE))
        self._rings = np.zeros((len(loops), bounds.BLOCK, bounds.BLOCKS))
        self._sums, self._block = np.zeros((len(loops), _SUMS_SIZE)), np.zeros(bounds.BLOCK)
        self._reported = [bounds.NOTHING] * len(loops)
        twin.refusals = 0
        self._piece = PerSample(self._on)
        _run(0, np.zeros((0, TABLE_WIDTH), np.int64))  # compiled, or loaded, before a cycle waits for it

    def _on(self, sample: CycleSample) -> CompiledStage:
        kind, axes = type(sample), len(self._rollers)
        names = [name for k in range(1, axes + 1) for name in (f"x{k}_m", f"v{k}_m_s", f"tau{k}_Nm")]
        names += [f"v{axes}_cmd_m_s", "strain_prev", "F_next_N", "cycle", "twin_status"]
        for loop in self._loops:
            of = loop.task.names
            names += [of.twin.tension, of.twin.modulus, of.set_point, of.closed]
        kept = (
            *(sample.reals, sample.wholes, kind.places(names), self._parameters, self._rollers, self._motion),
            *(self._begun, self._line, self._coherence, self._positions, self._web),
            *(self._figures, self._states, self._rings, self._sums, self._placed, self._block),
        )
        return CompiledStage(_run, 0, table_of(kept), fallback=self._report, keeps=kept)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Take a cycle."""
        self._look_for_a_new_twin()
        if any(emergency.code in (TORQUE_SHIFT, UNDECIDED) for emergency in inputs.emergencies):
            for state in self._states:
                _change_conditions(state)
        self._piece(sample)()

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage of the watch; there are no EMCY messages in such cycles."""

        def cycles() -> int:
            self._look_for_a_new_twin()
            return MANY

        return CompiledStages(after=[self._piece(sample)], cycles=cycles)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The drives are off: nothing is known of the web or the twin when they are enabled again."""
        self._line[[_HAS, _HAS_WEB]] = 0.0
        self._coherence[:] = coherence_state(len(self._rollers))
        self._begin_anew()

    def _look_for_a_new_twin(self) -> None:
        """Begin anew with a twin that was taken back: it is another one."""
        if self._twin.back_cycle != self._back_cycle:
            self._back_cycle = self._twin.back_cycle
            self._begin_anew()

    def _begin_anew(self) -> None:
        self._states[:] = 0.0
        self._report(_LOOK)

    def _report(self, _: int) -> bool:
        """Open loops, or let them close, by the verdicts on their twin."""
        for k, (loop, state) in enumerate(zip(self._loops, self._states, strict=True)):
            verdict, before = state.item(bounds.REPORTED), self._reported[k]
            if verdict != bounds.NOTHING and state.item(bounds.ASSUMED_PA) > 0.0:
                loop.task.assume_modulus(state.item(bounds.ASSUMED_PA))
            self._reported[k] = verdict
            if verdict == before:
                continue
            if verdict == bounds.NOTHING:
                loop.trust.allow()
            else:
                self._twin.refusals = (self._twin.refusals or 0) + 1
                loop.trust.refuse(_reason(loop.task.names.span if len(self._rollers) > 2 else 0, state))
        return True


def _reason(span: int, state: Vector) -> str:
    """Text: which value is beyond which interval, and why."""
    where, verdict = f" of span {span}" if span else "", state.item(bounds.REPORTED)
    if verdict == bounds.MODULUS:
        found_Pa, low_Pa, high_Pa = state[[bounds.MEAN_PA, bounds.LOW_PA, bounds.HIGH_PA]].tolist()
        return (
            f"E{where} by the twin is {found_Pa:.4g} Pa, torques and encoders allow {max(low_Pa, 0.0):.4g} to "
            f"{high_Pa:.4g} Pa with any usual errors of the model"
        )
    found_N, low_N, high_N = state[[bounds.MEAN_N, bounds.LOW_N, bounds.HIGH_N]].tolist()
    why = "with any usual errors of the model" if verdict == bounds.TENSION else "by how they have changed since"
    return f"tension{where} by the twin is {found_N:.1f} N, the torques allow {low_N:.1f} to {high_N:.1f} N {why}"


_change_conditions = interpreted(bounds.change_conditions)


def watched_loops(
    model: ModelParameters,
    tasks: Sequence[TensionTask],
    trusts: Sequence[VirtualSensorSupervision],
    twin: EstimationConfig,
) -> list[WatchedLoop]:
    """Loops of the spans after which there are driven rollers and idlers alone, up to the end of the line: their
    tension follows from the torques. A dancer, an accumulator or a reel there would add to the momentum balance."""
    rollers, before = model.line_rollers, axes_before_spans(model)
    methods = twin.by_span(model.span_count)
    found = []
    for task, trust in zip(tasks, trusts, strict=True):
        first = before.index(task.names.axis)  # of the section, from 0
        behind = rollers[first + 1 :]
        if not any(isinstance(roller.station, CarriageStation | Reel) for roller in behind):
            method = methods.get(task.span) or next(iter(methods.values()))
            found.append(WatchedLoop(task, trust, not isinstance(method, PidConfig)))
    return found


def _roller(model: ModelParameters, axis: int, errors: ModelErrorsConfig, usual_N: float) -> Vector:
    """Figures of a driven roller."""
    r, ratio, mass_kg = np.zeros(bounds.ROLLER), model.motor_rad_per_m(axis), model.mass_kg(axis)
    friction_N = 0.01 * errors.friction_pct * usual_N
    limit_Nm = per_item(model.drives.torque_limit_Nm, axis) if model.drives else 0.0
    r[[bounds.RAD_PER_M, bounds.MASS_KG, bounds.RADIUS_M]] = ratio, mass_kg, model.radius_m(axis)
    r[bounds.DRY_N], r[bounds.VISCOUS] = friction_N, friction_N / errors.at_speed_m_s
    r[bounds.OFFSET_N] = 0.01 * errors.torque_offset_pct * limit_Nm * ratio
    r[bounds.SCALE], r[bounds.INERTIA_KG] = 0.01 * errors.torque_scale_pct, 0.01 * errors.inertia_pct * mass_kg
    r[bounds.UNBALANCE_N] = 0.01 * errors.unbalance_pct * usual_N
    return r


def _figures(model: ModelParameters, sections: ModelParameters, loop: WatchedLoop, errors: ModelErrorsConfig) -> Vector:
    """Figures of a watched span."""
    f, axis, usual_N = np.zeros(bounds.SPAN), loop.task.names.axis, loop.task.set_point_N
    stiffness_N, behind = sections.stiffness_N(axis), sections.axis_count - axis
    friction_N = 0.01 * errors.friction_pct * usual_N * sqrt(behind)
    f[bounds.USUAL_N], f[bounds.USUAL_M2] = usual_N, usual_N / sections.youngs_modulus_Pa(axis)
    f[bounds.SECTION_M2], f[bounds.NEXT_N] = sections.section_m2(axis), model.boundary.downstream_tension_N
    f[bounds.STRAIN_SHARE], f[bounds.CREEP_SHARE] = 0.01 * errors.strain_pct, 0.01 * errors.creep_pct
    f[bounds.WARMS_N], f[bounds.OF_SPEED] = friction_N, friction_N / errors.at_speed_m_s
    f[bounds.ECCENTRIC_N] = sqrt(2.0) * 1e-6 * errors.eccentricity_um * stiffness_N / sections.span_length_m(axis)
    f[bounds.CHANGES] = loop.follows_at_once
    at = next(number for number, roller in enumerate(model.line_rollers) if roller.axis == axis)
    idlers = [roller.station for roller in model.line_rollers[at:] if isinstance(roller.station, Idler)]
    f[bounds.IDLERS_KG] = sum(idler.inertia_kg_m2 / idler.radius_m**2 for idler in idlers)
    f[bounds.IDLERS_DRY_N] = sum(idler.roller_coulomb_friction_N for idler in idlers)
    f[bounds.IDLERS_VISCOUS] = sum(idler.roller_viscous_friction_N_s_per_m for idler in idlers)
    return f
