"""Emulation of a web line by load motors, whole recordings in one compiled call (`simulation`): the rig's mechanics
under the load model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Vector, record_at, table_of
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_follower, line_kernel, simulation
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.offline import Simulation, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, pack_rig
from hilbench.plant.web_line.stability import sampled_shaft
from hilbench.plant.web_line.stations import station_name


@dataclass(frozen=True)
class Emulation:
    """Settings of a bench's web emulation: its cycle, the load motors on shafts of axes, the set-point resolution."""

    #: Emulated part, for messages.
    part: ClassVar[str] = "web"

    cycle_s: float
    load_motors: tuple[CoupledMotor, ...]
    #: Resolution of each axis's velocity command, m/s at the web; None if unknown.
    resolution_m_s: tuple[float, ...] | None = None

    @classmethod
    def usual(cls, model: ModelParameters, cycle_s: float) -> Emulation:
        """Default emulation: a load motor at the last roller or, with stations, wherever the web loads a roller."""
        axes = range(1, model.axis_count + 1)
        loaded = axes[-1:] if model.stations is None else [axis for axis in axes if model.carries_web_load(axis)]
        return cls(cycle_s, tuple(CoupledMotor(axis=axis) for axis in loaded))

    def as_taken(self, commands_m_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocity commands (n, N), m/s, rounded to the drives' units."""
        if self.resolution_m_s is None:
            return commands_m_s
        units = np.array(self.resolution_m_s)
        return np.asarray(np.round(commands_m_s / units) * units)


def lead_s(model: ModelParameters, cycle_s: float) -> float:
    """Dead time from measured motion to the torque of a load motor, by a model; the tension is predicted over it.

    Raises ValueError for a model without drives.
    """
    return emulation_delay_s(sampled_shaft(model, cycle_s=cycle_s))


def simulate_emulated(
    emulation: Emulation,
    model: ModelParameters,
    parameters: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
    *,
    state: Vector | None = None,
    sensors: Sequence[str] = (),
    forces_N: Mapping[str, NDArray[np.float64]] = MappingProxyType({}),
) -> Simulation:
    """Simulate recorded velocity commands on the rig of a model of N axes, its line emulated by load motors.

    parameters: (P,) or (B, P) of the model from `layout.pack`, with effects: those of the axes are in the mechanics,
    others in the emulation. commands (n, N) m/s at the web, boundary (n, 2) upstream strain and downstream tension (N),
    a row each cycle. state: (S,) or (B, S) of the model, not changed; without one, at rest. `sensors`: stations by
    name; `forces_N`: by station (n,), on carriages with a stated force. Motion and torques of the result are those of
    the axes; its `state` is the line's.
    Raises ValueError for a cycle that is no multiple of the drives' sample time, or shapes that do not fit.
    """
    many, n = np.array(np.atleast_2d(parameters)), model.axis_count
    if commands.ndim != 2 or commands.shape[1] != n or np.shape(boundary) != (len(commands), 2):
        raise ValueError(f"commands {commands.shape}, boundary {np.shape(boundary)}, expected (n, {n}) and (n, 2)")
    of_line = Layout.of(many[0])
    if state is None:
        lines = np.array([start_state(one, model) for one in many])
    else:
        lines = np.array(np.broadcast_to(np.atleast_2d(state), (len(many), of_line.state_size)), order="C")
    rigs, rows = rigs_of(emulation, model, many), lay.driven_rows(many[0])
    layout = Layout.of(rigs[0])
    starts = _starts(layout, rigs, many, lines, boundary[0])
    for one, line in zip(many, lines, strict=True):
        line_follower.hold(one)
        lay.refresh_modes(one, line)
    axes = range(1, n + 1)
    per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
    pulls = np.array([float(model.carries_web_load(axis)) for axis in axes]) / per_m
    sensor_rows = np.array(_rows_of(model, sensors), np.int64)
    sample_s = many.item(0, lay.W_SAMPLE_TIME_S)
    samples = samples_per(emulation.cycle_s, sample_s)
    out = np.empty((len(many), len(commands), layout.output_size + 2 * of_line.spans + len(sensor_rows)))
    at_motors, limits = np.ascontiguousarray(commands * per_m), np.ascontiguousarray(boundary, dtype=np.float64)
    history = np.array([0.0, 0.0, sample_s, line_follower.step_s(model)])
    times = np.array([emulation.cycle_s, lead_s(model, emulation.cycle_s)])
    stations = {each.station.name: each.station for each in model.carriages}
    pushed, bases = np.array(_rows_of(model, [*forces_N]), np.int64), np.array([stations[k].force_N for k in forces_N])
    forces = np.column_stack([*forces_N.values()]) if forces_N else np.empty((len(commands), 0))

    def run(share: slice) -> None:
        load = simulation.WebLoad(
            many[share], lines[share], of_line.new_inputs(), of_line.new_work(), np.zeros(of_line.output_size),
            history.copy(), np.zeros(n, line_kernel.ROLLER), np.array(rows, np.int64), sensor_rows, pulls, limits,
            pushed, forces, bases, np.zeros(len(bases)), np.zeros(of_line.state_size), np.zeros(n), np.zeros(n), times,
        )  # fmt: skip
        simulation.simulate(
            rigs[share], starts[share], _rig_inputs(layout, n), layout.new_work(), at_motors, limits, samples,
            out[share].reshape(-1), out.shape[2], table_of(load), simulation.NOTHING,
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out, lines = out[0], lines[0]
    of_rig, k = layout.output_size, of_line.spans
    x, v, tau = (out[..., layout.columns[name]][..., :n] for name in ("x_m", "v_m_s", "tau_Nm"))
    tension, strain = out[..., of_rig : of_rig + k], out[..., of_rig + k : of_rig + 2 * k]
    sensors_m = out[..., of_rig + 2 * k :] if len(sensors) else None
    return Simulation(x, v, tau, tension, strain, lines, sensors_m)


def _rig_inputs(layout: Layout, axes: int) -> Vector:
    """Inputs of a rig: its `axes` in velocity mode, its load motors in torque mode."""
    inputs = layout.new_inputs()
    motors = layout.motor_inputs(inputs)
    motors[:axes].mode, motors[axes:].mode = MotorMode.VELOCITY, MotorMode.TORQUE
    return inputs


def rigs_of(emulation: Emulation, model: ModelParameters, many: Vector) -> Vector:
    """Rig parameters (B, P) for models (B, P), with the models' effects on axes and drives."""
    without_effects = model.model_copy(update={"effects": ()})
    # Their rotors are included in the model's roller inertia.
    load_motors = [
        coupled.model_copy(update={"motor": coupled.motor.model_copy(update={"inertia_kg_m2": 0.0})})
        for coupled in emulation.load_motors
    ]
    template = pack_rig(RigParameters.matching(without_effects, load_motors))
    rigs = np.tile(template, (len(many), 1))
    layout, of_model, driven = Layout.of(template), Layout.of(many[0]), list(lay.driven_rows(many[0]))
    effects = lay.column(lay.AXIS, "m_per_turned_rad") + 1  # and all columns behind it
    for stand, parameters in zip(rigs, many, strict=True):
        of_stand, of_parameters = layout.matrices(stand), of_model.matrices(parameters)
        of_stand["axis"][:, effects:] = of_parameters["axis"][driven, effects:]
        of_stand["motor"][: layout.axes] = of_parameters["motor"][driven]
        layout.motor_rows(stand).axis[: layout.axes] = np.arange(layout.axes)
    return rigs


def _starts(layout: Layout, rigs: Vector, many: Vector, lines: Vector, boundary: Vector) -> Vector:
    """States (B, S) of the rigs for states `lines` of the models. `boundary` (2,): upstream strain and downstream
    tension (N) at the start."""
    of_model = Layout.of(many[0])
    rows = np.array(lay.driven_rows(many[0]))
    n, axes, k = len(rows), of_model.axes, of_model.spans
    starts = np.zeros((len(many), layout.state_size))
    for stand, start, parameters, line in zip(rigs, starts, many, lines, strict=True):
        y = of_model.y(line)
        layout.y(start)[:] = y[: 4 * axes].reshape(4, axes)[:, rows].ravel()
        motors = layout.motor_states(start)
        motors[:n] = of_model.motor_states(line)[rows]
        if np.any(y[axes : 2 * axes]):  # running: the load motors already have torque
            strain = y[4 * axes + k :] / y[4 * axes : 4 * axes + k] - 1.0
            of_spans = of_model.span_rows(parameters)
            tension = strain * of_spans.modulus_Pa * of_spans.section_m2
            entering_N = boundary[0] * record_at(parameters, lay.WEB).upstream_stiffness_N
            around = np.array([entering_N, *tension, boundary[1]])
            of_loads = layout.motor_rows(stand)[n:]
            loaded = rows[of_loads.axis.astype(int)]
            pull = (around[loaded + 1] - around[loaded]) / of_loads.rad_per_m
            motors.torque_Nm[n:] = motors.command_Nm[n:] = motors.integral_Nm[n:] = pull
        lay.refresh_modes(stand, start)
    return starts


def _rows_of(model: ModelParameters, names: Sequence[str]) -> list[int]:
    """Rows of carriages and reels among the axes of a line, by name."""
    rollers = model.line_rollers
    rows = {station_name(roller.station): row for row, roller in enumerate(rollers)}
    rows |= {each.station.name: row for row, each in enumerate(model.carriages, len(rollers))}
    return [rows[name] for name in names]
