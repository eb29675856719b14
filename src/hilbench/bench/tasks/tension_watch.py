"""Independent check of the twin's tension: block means of torques and encoders in the intervals of `tension_bounds`.

Where the twin is beyond one of them its tension loop opens, with E by torques and encoders for the ratio of speeds, and
closes again when the twin has been within it for a while. Each cycle only adds to sums; every tenth of a second
they are judged, in the same compiled stage.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import sqrt
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.state import TwinState
from hilbench.bench.tasks import tension_bounds as bounds
from hilbench.bench.tasks.task import MANY, CompiledStages, Outputs, StagedTask
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Wholes,
    Wholes2,
    arrays_in,
    compiled,
    entry_point,
    load,
    of_record,
    record_at,
    record_type,
    records,
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

#: Duration of a block; ten of them are a mean over 1 s, two turns of a roller of 0.2 m at 2.5 m/s.
_BLOCK_S = 0.1
#: Share of a drive's torque limit from which what its torque shows is the limit.
_AT_LIMIT = 0.98
#: What turns with a roller is in no block mean: a deviation of those, not a known force.
_TURNING = ("unbalance", "torque_ripple", "torque_ripple_load")

#: Outcome of `run`: the verdict on a twin has changed.
_LOOK = CONTINUE + 1
#: Of a line: cycles of a block and how many it has; the cycle in which it began; samples whose positions are of one
#: instant; the leading axis' command; 1 if that, or the twin's model, has changed, or a torque is at its limit;
#: sum of the tension
#: after the line; a cycle in s; tolerance of position differences, m; strain after the line; 1 if a block has
#: begun, and 1 if the web's state matches the rollers.
_LINE = record_type(
    *("cycles", "counted", "began", "paired", "command_m_s", "changed", "next_sum_N"),
    *("cycle_s", "travel_m", "downstream", "has_block", "has_web"),
)
#: Of an axis, when a block began and since: position, speed, sum of torques; its limit.
_AXIS = record_type("at_m", "at_m_s", "sum_Nm", "limit_Nm")
#: Of a span: sums of the twin's tension and E; set-point; whether that changed; cycles with an open loop.
_SUMS = record_type("twin_N", "twin_Pa", "goal_N", "goal_changed", "open")
#: Of a span: index of the roller behind it, and of its section where its strain is known, else NOWHERE.
_PLACED = record_type("first", "section", of=np.int64)
_NOWHERE = -1
#: Places in a sample of each axis, of the line, and of each span: tension and E of the twin, set-point, and whether the
#: loop is closed.
_AXIS_AT = record_type("position", "speed", "torque", of=np.int64)
_LINE_AT = record_type("command", "strain_prev", "F_next", "cycle", "status", of=np.int64)
_SPAN_AT = record_type("tension", "modulus", "goal", "closed", of=np.int64)


class _Arrays(NamedTuple):
    """What the compiled stage works on: a sample and places in it; of the line with its axes (N,) and sections
    (N − 1,); of the loops (K,), with rings of the last blocks (K, BLOCKS)."""

    values: Reals
    words: Wholes
    axes_at: Annotated[Any, records(_AXIS_AT)]
    line_at: Annotated[Any, _LINE_AT]
    spans_at: Annotated[Any, records(_SPAN_AT)]
    parameters: Reals
    rollers: Annotated[Any, records(bounds.ROLLER)]
    motion: Annotated[Any, records(bounds.MOTION)]
    axes: Annotated[Any, records(_AXIS)]
    line: Annotated[Any, _LINE]
    coherence: Reals
    now_m: Reals  #: positions of the axes
    last_m: Reals  #: the last ones that were of one instant
    travel_m: Reals  #: since these
    length_m: Reals  #: of the sections
    unstretched_m: Reals
    strain: Reals
    strain_sum: Reals
    figures: Annotated[Any, records(bounds.SPAN)]
    states: Annotated[Any, records(bounds.STATE)]
    rings: Annotated[Any, records(bounds.BLOCK, 2)]
    sums: Annotated[Any, records(_SUMS)]
    placed: Annotated[Any, records(_PLACED)]
    block: Annotated[Any, bounds.BLOCK]


@compiled
def _begin(a: _Arrays) -> None:
    """A block."""
    line, at = a.line, a.line_at
    for j in range(len(a.axes)):
        axis = a.axes[j]
        axis.at_m, axis.at_m_s = a.values[a.axes_at[j].position], a.values[a.axes_at[j].speed]
        axis.sum_Nm = 0.0
    line.counted, line.began, line.has_block = 0.0, a.words[at.cycle], 1.0
    line.paired, line.changed, line.next_sum_N = 0.0, 0.0, 0.0
    line.command_m_s = a.values[at.command]
    for k in range(len(a.strain_sum)):
        a.strain_sum[k] = 0.0
    for k in range(len(a.sums)):
        sums = a.sums[k]
        sums.twin_N, sums.twin_Pa, sums.goal_changed, sums.open = 0.0, 0.0, 0.0, 0.0
        sums.goal_N = a.values[a.spans_at[k].goal]


@compiled
def _add(a: _Arrays) -> None:
    """Add a cycle to a block."""
    line, at = a.line, a.line_at
    for j in range(len(a.axes)):
        torque_Nm = a.values[a.axes_at[j].torque]
        a.axes[j].sum_Nm += torque_Nm
        if abs(torque_Nm) >= a.axes[j].limit_Nm:
            line.changed = 1.0
    if a.values[at.command] != line.command_m_s or a.words[at.status] & MODEL_CHANGING != 0:
        line.changed = 1.0
    line.next_sum_N += a.values[at.F_next]
    line.counted += 1.0
    for k in range(len(a.sums)):
        sums, of_span = a.sums[k], a.spans_at[k]
        sums.twin_N += a.values[of_span.tension]
        sums.twin_Pa += a.values[of_span.modulus]
        if a.values[of_span.goal] != sums.goal_N:
            sums.goal_changed = 1.0
        if a.words[of_span.closed] == 0:
            sums.open += 1.0


@compiled
def _follow(a: _Arrays) -> None:
    """The web by mass conservation, where the positions are of one instant."""
    line, axes = a.line, len(a.axes)
    for j in range(axes):
        a.now_m[j] = a.values[a.axes_at[j].position]
    if not coherent(a.coherence, a.now_m, line.travel_m):
        return
    before = a.values[a.line_at.strain_prev]
    if line.has_web == 0.0:  # at rest, and strained as the web upstream
        for k in range(axes - 1):
            a.strain[k] = before
            a.unstretched_m[k] = a.length_m[k] / (1.0 + before)
        line.has_web = 1.0
    else:
        for j in range(axes):
            a.travel_m[j] = a.now_m[j] - a.last_m[j]
        bounds.stretch(a.unstretched_m, a.strain, a.length_m, a.travel_m, before, line.downstream)
    for j in range(axes):
        a.last_m[j] = a.now_m[j]
    for k in range(axes - 1):
        a.strain_sum[k] += a.strain[k]
    line.paired += 1.0


@compiled
def _move(a: _Arrays, lasted_s: float) -> None:
    """Means of the axes over a block."""
    for j in range(len(a.axes)):
        motion, axis, at = a.motion[j], a.axes[j], a.axes_at[j]
        motion.torque_Nm = axis.sum_Nm / a.line.counted
        motion.speed_m_s = (a.values[at.position] - axis.at_m) / lasted_s
        motion.rate_m_s2 = (a.values[at.speed] - axis.at_m_s) / lasted_s


@compiled
def _fill(a: _Arrays, k: int, lasted_s: float) -> None:
    """Fill a block's values of a span other than the momentum balance."""
    line, sums, section, block = a.line, a.sums[k], a.placed[k].section, a.block
    block.twin_N, block.twin_Pa = sums.twin_N / line.counted, sums.twin_Pa / line.counted
    block.stretch_m2 = 0.0
    if section != _NOWHERE and line.paired > 0.0:
        block.stretch_m2 = a.figures[k].section_m2 * a.strain_sum[section] / line.paired
    block.block_s = lasted_s
    block.closed = 1.0 if sums.open == 0.0 else 0.0
    block.unchanged = 1.0 if line.changed == 0.0 and sums.goal_changed == 0.0 else 0.0


#: run(0, table of `_Arrays`): CONTINUE, or that the verdict on a twin has changed.
@entry_point(COUNT, TABLE)
def _run(_: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    line = a.line
    _follow(a)
    if line.has_block == 0.0:
        _begin(a)
        return CONTINUE
    _add(a)
    if line.counted < line.cycles:
        return CONTINUE
    lasted_s = (a.words[a.line_at.cycle] - line.began) * line.cycle_s
    _move(a, lasted_s)
    code = CONTINUE
    for k in range(len(a.sums)):
        _fill(a, k, lasted_s)
        block, mean_s = a.block, bounds.BLOCKS * lasted_s
        block.tension_N = line.next_sum_N / line.counted
        block.line_m_s = a.motion[len(a.motion) - 1].speed_m_s
        bounds.momentum_balance(a.parameters, a.figures[k], a.rollers, a.motion, a.placed[k].first, mean_s, block)
        if bounds.judge(a.figures[k], a.states[k], a.rings[k], block):
            code = _LOOK
    _begin(a)
    return code


class TensionWatch(StagedTask):
    """Opens tension loops whose twin is physically implausible, until it is plausible again.

    `loops`: each with whether its twin's E follows a step within `tension_bounds.PERSISTS_S`.
    """

    def __init__(
        self,
        loops: Mapping[TensionTask, bool],
        model: ModelParameters,
        twin_config: EstimationConfig,
        twin: TwinState,
        cycle_s: float,
    ) -> None:
        self._loops, self._twin, self._back_cycle = tuple(loops), twin, twin.back_cycle
        axes, errors = model.axis_count, twin_config.model_errors
        sections = section_model(model)
        usual_N = max(loop.set_point_N for loop in loops)
        limits_Nm = [
            per_item(sections.drives.torque_limit_Nm, k + 1) if sections.drives else np.inf for k in range(axes)
        ]
        self._axes = np.zeros(axes, _AXIS)
        self._axes["limit_Nm"] = _AT_LIMIT * np.array(limits_Nm)
        self._line_array, self._coherence = np.zeros(1, _LINE), coherence_state(axes)
        self._line = record_at(self._line_array, _LINE)
        self._line.cycles, self._line.cycle_s = max(1, round(_BLOCK_S / cycle_s)), cycle_s
        self._line.travel_m, self._line.downstream = least_travel_m(model, cycle_s), model.downstream_strain
        known = model.stations is None and twin_config.web_at_rest == "as_upstream"
        estimated = twin_config.by_span(model.span_count) if known else ()
        placed = [
            (loop.names.axis, loop.names.span - 1 if loop.names.span in estimated else _NOWHERE) for loop in loops
        ]
        self._states = np.zeros(len(loops), bounds.STATE)
        self._of_model = {
            "parameters": lay.pack(
                sections.model_copy(update={"effects": tuple(e for e in sections.effects if e.effect not in _TURNING)})
            ),
            "rollers": np.array([_roller(sections, k, errors, usual_N) for k in range(1, axes + 1)], bounds.ROLLER),
            "figures": np.array([_figures(model, sections, errors, *each) for each in loops.items()], bounds.SPAN),
            "placed": np.array(placed, _PLACED),
            "length_m": np.array([sections.span_length_m(k) for k in range(1, axes)]),
        }
        self._reported = [bounds.NOTHING] * len(loops)
        twin.refusals = 0
        load(_run)

    def _on(self, sample: CycleSample) -> CompiledStage:
        kind, axes, loops = type(sample), len(self._axes), len(self._loops)
        of_axes = [name for k in range(1, axes + 1) for name in (f"x{k}_m", f"v{k}_m_s", f"tau{k}_Nm")]
        of_line = [f"v{axes}_cmd_m_s", "strain_prev", "F_next_N", "cycle", "twin_status"]
        of_spans = [
            name
            for each in (loop.names for loop in self._loops)
            for name in (each.twin.tension, each.twin.modulus, each.set_point, each.closed)
        ]
        arrays = _Arrays(
            values=sample.reals,
            words=sample.wholes,
            axes_at=kind.places(of_axes).view(_AXIS_AT),
            line_at=kind.places(of_line),
            spans_at=kind.places(of_spans).view(_SPAN_AT),
            axes=self._axes,
            motion=np.zeros(axes, bounds.MOTION),
            line=self._line_array,
            coherence=self._coherence,
            **{name: np.zeros(axes) for name in ("now_m", "last_m", "travel_m")},
            **{name: np.zeros(axes - 1) for name in ("unstretched_m", "strain", "strain_sum")},
            states=self._states,
            rings=np.zeros((loops, bounds.BLOCKS), bounds.BLOCK),
            sums=np.zeros(loops, _SUMS),
            block=np.zeros(1, bounds.BLOCK),
            **self._of_model,
        )
        return CompiledStage(_run, 0, arrays, fallback=self._report)

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Take a cycle."""
        self._look_for_a_new_twin()
        if any(emergency.code in (TORQUE_SHIFT, UNDECIDED) for emergency in inputs.emergencies):
            self._states["constant_s"] = 0.0  # a difference is to be learned anew
            self._states["known"][self._states["reported"] == bounds.NOTHING] = 0.0
        super().after(sample, inputs)

    def stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stage of the watch; there are no EMCY messages in such cycles."""

        def cycles() -> int:
            self._look_for_a_new_twin()
            return MANY

        return CompiledStages(after=[self._on(sample)], cycles=cycles)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The drives are off: nothing is known of the web or the twin when they are enabled again."""
        self._line.has_block = self._line.has_web = 0.0
        self._coherence[:] = coherence_state(len(self._axes))
        self._begin_anew()

    def _look_for_a_new_twin(self) -> None:
        """Begin anew with a twin that was taken back: it is another one."""
        if self._twin.back_cycle != self._back_cycle:
            self._back_cycle = self._twin.back_cycle
            self._begin_anew()

    def _begin_anew(self) -> None:
        self._states[:] = np.zeros(1, bounds.STATE)
        self._report(_LOOK)

    def _report(self, _: int) -> bool:
        """Open loops, or let them close, by the verdicts on their twin."""
        for k, (loop, state) in enumerate(zip(self._loops, self._states, strict=True)):
            verdict, before = float(state["reported"]), self._reported[k]
            if verdict != bounds.NOTHING and state["assumed_Pa"] > 0.0:
                loop.assume_modulus(float(state["assumed_Pa"]))
            self._reported[k] = verdict
            if verdict == before:
                continue
            if verdict == bounds.NOTHING:
                loop.trust.allow()
            else:
                self._twin.refusals = (self._twin.refusals or 0) + 1
                loop.trust.refuse(_reason(loop.names.span if len(self._axes) > 2 else 0, state))
        return True


def _reason(span: int, state: Any) -> str:
    """Text: which value is beyond which interval, and why."""
    where, verdict = f" of span {span}" if span else "", state["reported"]
    if verdict == bounds.MODULUS:
        found_Pa, low_Pa, high_Pa = state[["mean_Pa", "low_Pa", "high_Pa"]].item()
        return (
            f"E{where} by the twin is {found_Pa:.4g} Pa, torques and encoders allow {max(low_Pa, 0.0):.4g} to "
            f"{high_Pa:.4g} Pa with any usual errors of the model"
        )
    found_N, low_N, high_N = state[["mean_N", "low_N", "high_N"]].item()
    why = "with any usual errors of the model" if verdict == bounds.TENSION else "by how they have changed since"
    return f"tension{where} by the twin is {found_N:.1f} N, the torques allow {low_N:.1f} to {high_N:.1f} N {why}"


def watched_loops(
    model: ModelParameters, tasks: Iterable[TensionTask], twin: EstimationConfig
) -> dict[TensionTask, bool]:
    """Loops, as `TensionWatch` takes them, of the spans after which there are driven rollers and idlers alone, up to
    the end of the line: their tension follows from the torques. A dancer, an accumulator or a reel there would add to
    the momentum balance."""
    rollers, before = model.line_rollers, axes_before_spans(model)
    methods = twin.by_span(model.span_count)
    found = {}
    for task in tasks:
        first = before.index(task.names.axis)  # of the section, from 0
        behind = rollers[first + 1 :]
        if not any(isinstance(roller.station, CarriageStation | Reel) for roller in behind):
            method = methods.get(task.names.span) or next(iter(methods.values()))
            found[task] = not isinstance(method, PidConfig)
    return found


def _roller(model: ModelParameters, axis: int, errors: ModelErrorsConfig, usual_N: float) -> tuple[float, ...]:
    """Figures of a driven roller, as `tension_bounds.ROLLER`."""
    ratio, mass_kg = model.motor_rad_per_m(axis), model.mass_kg(axis)
    friction_N = 0.01 * errors.friction_pct * usual_N
    limit_Nm = per_item(model.drives.torque_limit_Nm, axis) if model.drives else 0.0
    return of_record(
        bounds.ROLLER,
        rad_per_m=ratio,
        mass_kg=mass_kg,
        radius_m=model.radius_m(axis),
        dry_N=friction_N,
        viscous=friction_N / errors.at_speed_m_s,
        offset_N=0.01 * errors.torque_offset_pct * limit_Nm * ratio,
        scale=0.01 * errors.torque_scale_pct,
        inertia_kg=0.01 * errors.inertia_pct * mass_kg,
        unbalance_N=0.01 * errors.unbalance_pct * usual_N,
    )


def _figures(
    model: ModelParameters,
    sections: ModelParameters,
    errors: ModelErrorsConfig,
    loop: TensionTask,
    follows_at_once: bool,
) -> tuple[float, ...]:
    """Figures of a watched span, as `tension_bounds.SPAN`."""
    axis, usual_N = loop.names.axis, loop.set_point_N
    stiffness_N, behind = sections.stiffness_N(axis), sections.axis_count - axis
    friction_N = 0.01 * errors.friction_pct * usual_N * sqrt(behind)
    at = next(number for number, roller in enumerate(model.line_rollers) if roller.axis == axis)
    idlers = [roller.station for roller in model.line_rollers[at:] if isinstance(roller.station, Idler)]
    return of_record(
        bounds.SPAN,
        usual_N=usual_N,
        usual_m2=usual_N / sections.youngs_modulus_Pa(axis),
        section_m2=sections.section_m2(axis),
        next_N=model.boundary.downstream_tension_N,
        strain_share=0.01 * errors.strain_pct,
        creep_share=0.01 * errors.creep_pct,
        warms_N=friction_N,
        of_speed=friction_N / errors.at_speed_m_s,
        eccentric_N=sqrt(2.0) * 1e-6 * errors.eccentricity_um * stiffness_N / sections.span_length_m(axis),
        changes=follows_at_once,
        idlers_kg=sum(idler.inertia_kg_m2 / idler.radius_m**2 for idler in idlers),
        idlers_dry_N=sum(idler.roller_coulomb_friction_N for idler in idlers),
        idlers_viscous=sum(idler.roller_viscous_friction_N_s_per_m for idler in idlers),
    )
