"""Web line of N driven rollers: the last axis leads at line speed, the others follow the one after them, with a
tension controller where the span between has one; load motors emulate the web."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState, TwinState
from hilbench.bench.tasks.emulated_web import emulated_web, web_load_model
from hilbench.bench.tasks.load_model import LoadTask
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.saturation import SaturationWatch
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs
from hilbench.bench.tasks.tension_compensation import CompensationTask
from hilbench.bench.tasks.tension_feed_forward import FeedForwardTask
from hilbench.bench.tasks.tension_probing import Probing
from hilbench.bench.tasks.tension_task import AxisTask, LoopNames, TensionTask
from hilbench.bench.tasks.tension_watch import TensionWatch, watched_loops
from hilbench.bench.tasks.watches import QuietWatch
from hilbench.bench.tasks.web_axes import WebAxis
from hilbench.bench.tasks.web_entering_strain import EnteringStrain, strains_around
from hilbench.bench.tasks.web_limits import limit_watch
from hilbench.bench.tasks.web_positions import CarriageForceTask, CarriageStops, PositionTask
from hilbench.bench.tasks.web_reels import LoadCells, MeasuredReel, ReelSpeeds, ReelTorqueTask, ReelTravel
from hilbench.bench.tasks.web_standstill_excitation import StandstillExcitation, excitation_amplitudes_m
from hilbench.bench.tasks.web_winding_control import DancerPosition
from hilbench.cycle_program import python_stage
from hilbench.errors import BenchFaultError
from hilbench.estimation.problems import Problem
from hilbench.exchange.exchange import Inputs
from hilbench.plant.measured_motion import HasFollowed
from hilbench.plant.web_line.sections import section_model
from hilbench.plant.web_line.stations import LineCarriage, Reel, force_input, reel_name
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.sample import CycleSample, sample_type
from hilbench.topology.signals import Shape
from hilbench.topology.web_line import sensors_at_start
from hilbench.topology.web_line_config import CompensationConfig, ProbingConfig, TensionControlConfig, loops_of
from hilbench.topology.web_line_signals import LINE_SPEED_SIGNAL

#: Age of the twin's data, in cycles, up to which a line without tension control rides it out.
_TWIN_AGE = TensionControlConfig().twin_age_limit_cycles
#: Time for which load torques are held from which on the operator is warned, and from which on it is a fault, s: a span
#: of web at walking speed passes through in the first, and the tension watch gives up after the second.
_LONG_HOLD_S, _LONGEST_HOLD_S = 1.0, 5.0
#: Cycles between two checks for an open tension loop.
_LOOK_CYCLES = 50


def tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
    """The tasks of the config's web line."""
    model, cycle_s, limits, reports = config.web_line, config.cycle_time_s, config.safety.limits, state.reports
    controls = config.tension_controls
    line_speed = Reference(LINE_SPEED, config.quick_stop_per_s2 * cycle_s)
    drives = list(config.drives)
    by_axis = {config.shape.axis_before(span): control for span, control in controls.items()}
    positioned = {
        config.shape.axis_before(carriage.first_span): carriage
        for carriage in model.carriages
        if carriage.station.name in config.position_controls
    }
    rises_s = {axis: each.set_point_rise_s for axis, each in by_axis.items() if each.feed_forward == "twin"}
    loops: dict[int, TensionTask] = {}
    plan = FeedForwardTask(section_model(model), cycle_s, line_speed, loops, rises_s) if rises_s else None
    torqued = config.reel_controls
    leads = max(axis for axis in range(1, model.axis_count + 1) if axis not in torqued)
    leading = WebAxis(drives[leads - 1], leads, line_speed)
    reels = [
        ReelTorqueTask(control, drives[axis - 1], axis, leading, leads, model, config.shape, state)
        for axis, control in torqued.items()
    ]
    axes: list[WebAxis | TensionTask | PositionTask] = [leading]
    forces: list[CarriageForceTask] = []
    compensating: list[CompensationTask] = []
    for axis in range(leads - 1, 0, -1):
        if axis in torqued:
            continue
        control = by_axis.get(axis)
        carriage = positioned.get(axis)
        if carriage is not None:
            axes.append(_position_task(config, axis, carriage, axes[-1]))
            force = config.position_controls[carriage.station.name].force
            if force is not None:
                forces.append(CarriageForceTask(force, model, carriage, axis, axes[-1], axes[-2], state))
            continue
        if control is None:
            axes.append(WebAxis(drives[axis - 1], axis, axes[-1], plan))
            continue
        own_plan, entering = (plan, neighbour_strains(config, axis)) if axis in rises_s else (None, ())
        travels = _trajectories(config, axis)
        loops[axis] = TensionTask(config, state, control, drives[axis - 1], axes[-1], travels, own_plan, entering)
        axes.append(loops[axis])
        for each in loops_of(CompensationConfig, config.controllers.values()):
            if each.effects:
                compensating.append(CompensationTask(config, each, reports, loops[axis]))
    of_spans = {loop.names.span: loop for loop in loops.values()}
    watched = watched_loops(model, loops.values(), config.twin)
    watch = [TensionWatch(watched, model, config.twin, state.twin, cycle_s)] if watched else []
    moved = _rest_movement(config, [each.moved for each in reversed(axes) if not isinstance(each, PositionTask)])
    probing = [_probing(config, state, of_spans, line_speed, moved)] if of_spans else []
    sensors = sensors_at_start(emulated_web(model, config.load), config.shape)
    boundary = BoundaryTask(model.upstream_strain, model.boundary.downstream_tension_N, sensors)
    load = WebLoadTask(config, partial(reports.note, "load model"))
    return MachineTasks(
        reference=line_speed,
        quantities=(
            line_speed,
            *loops.values(),
            *reels,
            *forces,
            *(axis for axis in axes if isinstance(axis, PositionTask)),
            load.model,
            *probing,
        ),
        control=(
            *(boundary, *probing, *([plan] if plan else []), *axes, *compensating),
            *(*reels, *_reel_speeds(config, leading), *forces),
            *(load, *([LoadCells(model, config.shape)] if config.shape.cells else []), *watch),
        ),
        watches=(
            WebAlarms(loops.values(), state.twin, stop_on_break=config.safety.on_web_break == "stop"),
            *(CarriageStops(each) for each in model.carriages if each.station.name in config.load.measured),
            OpenLoops(list(loops.values()), line_speed, config.safety.loop_open_s, state),
            QuietWatch("limits", limit_watch(limits, model, cycle_s, config.shape), reports),
            QuietWatch("saturation", SaturationWatch(config), reports),
        ),
        twin_age_limit_cycles=max((control.twin_age_limit_cycles for control in controls.values()), default=_TWIN_AGE),
        warm_up=load.model.warm_up,
        holds={drive: _spans_beside(config.shape, axis) for axis, drive in enumerate(drives, 1)},
    )


def _spans_beside(shape: Shape, axis: int) -> str:
    """The spans whose tension a driven axis holds, up to the next driven one on either side, in words."""
    spans = [span for span in range(1, shape.spans + 1) if shape.axis_before(span) in (axis - 1, axis)]
    if len(spans) == 1:
        return f"the tension of span {spans[0]}"
    between = "and" if len(spans) == 2 else "to"
    return f"the tensions of spans {spans[0]} {between} {spans[-1]}"


def _probing(
    config: BenchConfig,
    state: BenchState,
    loops: Mapping[int, TensionTask],
    line_speed: Reference,
    at_rest: StandstillExcitation | None,
) -> Probing:
    """Probes of the loop of a span at which E is found, the first that is to be probed; none where there is none."""
    controls = config.tension_controls
    at_estimates = [span for span in config.shape.estimated if span in loops]
    probed = [span for span in at_estimates if controls[span].probes.mode != "off"] or at_estimates
    found = controls[probed[0]].probes if probed else ProbingConfig()
    loop = loops[probed[0]] if probed else next(iter(loops.values()))
    of_all = [LoopNames.of(loop.names.drive, span, config.shape).twin for span in config.shape.estimated]
    return Probing(found, loop, line_speed, state, at_rest, of_all)


def _rest_movement(config: BenchConfig, axes: Sequence[Any]) -> StandstillExcitation | None:
    """Standstill excitation of a line of driven rollers, by its records of the `axes` in their direction; None if not
    permitted."""
    controls, model = config.tension_controls, config.web_line
    travel_mm = max((control.probes.at_rest_mm for control in controls.values()), default=0.0)
    if travel_mm == 0.0:
        return None
    usual_N = max(control.set_point_N for control in controls.values())
    set_points_N = [
        controls[span].set_point_N if span in controls else usual_N for span in range(1, model.span_count + 1)
    ]
    positions_m = attrgetter(*(f"x{axis}_m" for axis in range(1, model.axis_count + 1)))
    travel_m = 1e-3 * travel_mm
    pulled_m = excitation_amplitudes_m(model, set_points_N, travel_m)
    return StandstillExcitation(axes[-1], axes, positions_m, travel_m, pulled_m, config.cycle_time_s)


def _trajectories(config: BenchConfig, section: int) -> Callable[[CycleSample], tuple[float, float]] | None:
    """Web travel at the ends of a section with a reel of measured radius there; None without."""
    reels = {reel.axis: reel for reel in _measured_reels(config)}
    if not reels.keys() & {section, section + 1}:
        return None
    before, behind = (
        ReelTravel(reels[axis]) if axis in reels else attrgetter(f"x{axis}_m") for axis in (section, section + 1)
    )
    return lambda sample: (before(sample), behind(sample))


def _position_task(config: BenchConfig, axis: int, carriage: LineCarriage, leader: AxisTask) -> PositionTask:
    """The axis before a carriage that has a loop of its position."""
    station, drive = carriage.station, list(config.drives)[axis - 1]
    control = config.position_controls[station.name]
    loop = DancerPosition(station, control.bandwidth_rad_per_s, control.correction_limit_m_s)
    set_point_m = station.position_m if control.set_point_m is None else control.set_point_m
    return PositionTask(drive, axis, control, loop, leader, set_point_m, config.cycle_time_s)


def _measured_reels(config: BenchConfig) -> list[MeasuredReel]:
    """The reels whose radius has a sensor."""
    model, drives, found = config.web_line, list(config.drives), list[MeasuredReel]()
    for roller in model.line_rollers:
        if roller.axis and isinstance(roller.station, Reel) and reel_name(roller.station) in config.load.measured:
            signal = f"r_{reel_name(roller.station)}_meas_m"
            found.append(MeasuredReel(drives[roller.axis - 1], roller.axis, signal, model.radius_m(roller.axis)))
    return found


def _reel_speeds(config: BenchConfig, leader: AxisTask) -> list[ReelSpeeds]:
    """Task that sets the reels' speeds by their radius; none for a line without reels."""
    reels = [reel for reel in _measured_reels(config) if reel.axis not in config.shape.torqued]
    line_speed = LINE_SPEED_SIGNAL if config.shape.winds else ""
    return [ReelSpeeds(reels, leader, line_speed)] if reels or line_speed else []


def neighbour_strains(config: BenchConfig, axis: int) -> tuple[EnteringStrain, EnteringStrain]:
    """Strains of the web before and after the section that follows a driven axis: around the line those of the model,
    else those of the twin for the span there; while it has none, the wanted ones."""
    shape = config.shape
    first = next(span for span in range(1, shape.spans + 1) if shape.axis_before(span) == axis)
    wanted = strains_around(config, first)
    before = [span for span in shape.simulated if shape.axis_before(span) == axis - 1]
    behind = [span for span in shape.simulated if shape.axis_before(span) == axis + 1]
    return (
        _simulated_strain(config, before[-1] if before else None, wanted[0]),
        _simulated_strain(config, behind[0] if behind else None, wanted[1]),
    )


def _simulated_strain(config: BenchConfig, span: int | None, wanted: float) -> EnteringStrain:
    if span is None:
        return EnteringStrain(wanted)
    model, shape = config.web_line, config.shape
    known = shape.shows(span)
    section_m2 = model.stiffness_N(span) / model.youngs_modulus_Pa(known)
    return EnteringStrain(wanted, f"F{shape.numbered(span)}_sim_N", f"E{shape.numbered(known)}_sim_Pa", section_m2)


class BoundaryTask(CyclicTask):
    """Boundary inputs of the twin in addition to the axes, drives enabled or not: the web outside the line,
    and the stations' sensors; until these report, their values at the start."""

    def __init__(self, strain_prev: float, tension_next_N: float, sensors: Mapping[str, float]) -> None:
        self._strain_prev = strain_prev
        self._tension_next_N = tension_next_N
        self._at_start = dict(sensors)
        self._moved = False

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Strain upstream of the line, tension downstream of it, positions, radii and tensions."""
        sample.strain_prev = outputs["strain_prev"] = self._strain_prev
        sample.F_next_N = outputs["F_next_N"] = self._tension_next_N
        for signal, value in self._at_start.items():
            outputs[signal] = getattr(sample, signal) if self._moved else value

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Note that the sensors report now."""
        self._moved = True

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """The sample shows all of it, and keeps it."""
        shown = {name: name for name in ("strain_prev", "F_next_N", *self._at_start)}
        return CompiledStages(cycles=lambda: MANY if self._moved else 0, shown=shown)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Boundary inputs with the drives disabled; stations are as at the start when they are enabled again."""
        self._moved = False
        self.before(sample, outputs)


class WebLoadTask(LoadTask):
    """The load motors pull at the shafts of their axes as the emulated web would."""

    def __init__(self, config: BenchConfig, report: Callable[[str], None]) -> None:
        super().__init__(list(config.load_motors), web_load_model(config, report))
        self._report, self._held_s = report, 0.0
        shape = config.shape
        axes = range(1, shape.axes + 1)
        positions, speeds = [f"x{k}_m" for k in axes], [f"v{k}_m_s" for k in axes]
        self._positions, self._speeds = attrgetter(*positions), attrgetter(*speeds)
        truth = [
            (f"{signal}{shape.numbered(span)}_true{unit}", output)
            for span in range(1, shape.spans + 1)
            for signal, unit, output in (
                ("F", "_N", f"F{span}_N"),
                ("strain", "", f"strain{span}"),
                ("E", "_Pa", f"E{span}_Pa"),
            )
        ]
        truth += [(f"{x}_{name}_true_{unit}", f"{x}_{name}_{unit}") for x, unit, name in _of_stations(shape)]
        measured = [each for each in _of_stations(shape) if each[0] != "v" and each[2] in shape.measured]
        truth += [(f"{x}_{name}_meas_{unit}", f"{x}_{name}_{unit}") for x, unit, name in measured]
        names = [quantity.name for quantity in self.model.machine.describe().outputs]
        #: Of the signals among what the model's machine is.
        self._places = [(signal, names.index(output)) for signal, output in truth]
        self._forces = [(signal, force_input(name)) for name, signal in shape.forces]
        kind = sample_type(config.signals)
        followed = kind.places([*positions, *speeds, *(f"tau_{name}_cmd_Nm" for name in config.load_motors)])
        shown = [each for signal, place in self._places for each in (kind.place(signal), place)]
        self._at = np.array([*followed, *shown], np.int64)  # as of `InStep.follow`

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Let the web follow the measured motion; record its true state."""
        late = inputs.axes_late
        followed = self.model.follow_in(sample.reals, self._at, late=late)
        if followed is None:
            self.follow(sample, self._positions(sample), self._speeds(sample), late=late)
        if followed is not HasFollowed.ALL:
            self._show(sample)
        self._push(sample)

    def _push(self, sample: CycleSample) -> None:
        """Set the forces on the carriages as commanded."""
        for signal, name in self._forces:
            self.model.set_value(name, getattr(sample, signal))

    def _check_held(self, sample: CycleSample) -> None:
        """Warn of load torques that are held for long: the emulated web no longer follows. Raises BenchFaultError."""
        held_before_s, self._held_s = self._held_s, self.model.held_s
        if self._held_s < _LONG_HOLD_S:
            return
        text = f"load torques are held for {self._held_s:.1f} s: no measured positions of all axes were of one SYNC"
        if held_before_s < _LONG_HOLD_S:
            self._report(text)
        if self._held_s >= _LONGEST_HOLD_S:
            raise BenchFaultError(f"t = {sample.t_s:.3f} s: load model: {text}")

    def _show(self, sample: CycleSample) -> None:
        true = self.model.outputs()
        for signal, place in self._places:
            setattr(sample, signal, true[place])
        self._check_held(sample)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages | None:
        """Compiled stage that follows the measured motion, and Python's that sets forces on carriages."""

        def fallback(_: HasFollowed) -> bool:
            self._show(sample)
            return True

        pushes = [python_stage(partial(self._push, sample))] if self._forces else []
        return self._follows(sample, self._at, fallback, *pushes)


def _of_stations(shape: Shape) -> list[tuple[str, str, str]]:
    """Signals of carriages and reels: symbol, unit, and the name of the station."""
    of_carriages = [(symbol, unit, name) for name in shape.carriages for symbol, unit in (("x", "m"), ("v", "m_s"))]
    return of_carriages + [("r", "m", name) for name in shape.reels]


class OpenLoops(CyclicTask):
    """Reports tension loops open for `limit_s` while tension is wanted (the line moves, or the set-point differs from
    that at the start): a notice with the cause, and marks in the journal. Checked every `_LOOK_CYCLES` cycles."""

    def __init__(self, loops: Sequence[TensionTask], line_speed: Reference, limit_s: float, state: BenchState) -> None:
        self._loops, self._line_speed, self._limit_s, self._state = loops, line_speed, limit_s, state
        self._set_points_N = [loop.set_point_N for loop in loops]
        self._since_s: dict[TensionTask, float] = {}
        self._reported: set[TensionTask] = set()

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Look, when it is time to."""
        if sample.cycle % _LOOK_CYCLES:
            return
        for loop, at_start_N in zip(self._loops, self._set_points_N, strict=True):
            if loop.closed:
                self._closed(loop, sample)
            elif self._line_speed.present == 0.0 and loop.set_point_N == at_start_N:
                self._since_s.pop(loop, None)
            else:
                since_s = max(self._since_s.setdefault(loop, sample.t_s), loop.opened_s)
                if sample.t_s - since_s >= self._limit_s and loop not in self._reported:
                    self._open(loop, sample, since_s)

    def _open(self, loop: TensionTask, sample: CycleSample, since_s: float) -> None:
        self._reported.add(loop)
        name, axis = loop.names.of_loop, loop.names.axis
        self._state.journal(Change(int(sample.cycle), "loop_open", name, since_s))
        self._state.reports.note(
            "tension",
            f"{name} open for {sample.t_s - since_s:.1f} s while tension is asked for, axis {axis} follows the ratio "
            f"of speeds: {loop.trust.doubt}; criteria on this tension are not judged",
            kind=name,
        )

    def _closed(self, loop: TensionTask, sample: CycleSample) -> None:
        self._since_s.pop(loop, None)
        if loop in self._reported:
            self._reported.remove(loop)
            self._state.journal(Change(int(sample.cycle), "loop_closed", loop.names.of_loop))

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Stages without work until the next check; a loop that is closed needs none."""

        def cycles() -> int:
            busy = self._reported or not all(loop.closed for loop in self._loops)
            return -int(sample.cycle + 1) % _LOOK_CYCLES if busy else MANY

        return CompiledStages(cycles=cycles)


class WebAlarms(CyclicTask):
    """The twin's alarms of the web: slip and a break open the tension loops, a break is a fault where wanted."""

    def __init__(self, loops: Iterable[TensionTask], twin: TwinState, *, stop_on_break: bool) -> None:
        self._loops = tuple(loops)
        self._twin = twin
        self._stop_on_break = stop_on_break

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        """Look at the EMCY messages of this cycle. Raises BenchFaultError at a web break."""
        if self._twin.away:  # it works off the SYNCs that it has missed, and does not know the present
            return
        for emergency in inputs.emergencies:
            if emergency.code in (Problem.WEB_BREAK, Problem.SLIP):
                for loop in self._loops:
                    loop.trust.forget(str(emergency))
            if emergency.code == Problem.WEB_BREAK and self._stop_on_break:
                raise BenchFaultError(f"t = {sample.t_s:.3f} s: {emergency.node} reports a web break{emergency.where}")

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """No stage: there it sends nothing."""
        return CompiledStages()
