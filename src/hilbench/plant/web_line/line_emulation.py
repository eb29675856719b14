"""Emulation of a line with idlers, dancers, accumulators and reels, whole recordings in one compiled call.

As `emulation`, with the line of `line_follower` in place of the web: its driven rollers are held to the rig's motion at
each SYNC, parts without a motor move freely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, CUBE, INDICES, MATRIX, REAL, VECTOR, compiled, entry_point, inlined
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import kernel, laws, line_follower, places, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation, lead_s, of_axes, rig_inputs, rigs_of
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.line_kernel import ACCELERATION_S, gained_m_s, turn
from hilbench.plant.web_line.offline import Simulation, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import station_name

Rows = NDArray[np.int64]


@inlined
def _show(p: Vector, s: Vector, sensors: Rows, out: Vector, at: int) -> None:
    """Write the readings of `sensors` (rows of the line) to `out` from offset `at` on, m."""
    for j in range(len(sensors)):
        axis, x = places.axis(sensors[j]), s[lay.S_Y + sensors[j]]
        out[at + j] = p[axis + lay.A_RADIUS_M] * reels.radius_ratio(p, axis, x) if reels.is_reel(p, axis) else x


@compiled
def _pull(
    p: Vector, s: Vector, boundary: Vector, row: int, rows: Rows, pulls: Vector, seen: Vector, loads: Vector
) -> None:
    """Load torque at the motor of each driven axis, `loads` (N,) N·m, by the line's tensions in `seen`; `pulls` (N,):
    N·m per N, with reels as at the start."""
    _, m, k = places.counts(p)
    for i in range(len(rows)):
        at, x = rows[i], s[lay.S_Y + rows[i]]
        reel = reels.is_reel(p, places.axis(at))
        before, behind = 0.0, 0.0
        if at > 0:
            before = seen[3 * m + at - 1]
        elif not reel:
            upstream = laws.upstream_strain(p, boundary[row, 0], s[lay.S_COUNT] * p[lay.W_SAMPLE_TIME_S])
            before = upstream * p[lay.W_UPSTREAM_STIFFNESS_N]
        if at < k:
            behind = seen[3 * m + at]
        elif not reel:
            behind = boundary[row, 1]
        ratio = reels.radius_ratio(p, places.axis(at), x) if reel else 1.0
        loads[i] = (behind - before) * ratio * pulls[i]


@compiled
def _run(
    p: Vector, s: Vector, u: Vector, w: Vector, web: Vector, line: Vector, line_u: Vector, line_w: Vector, rows: Rows,
    sensors: Rows, pulls: Vector, guess: Vector, room: Vector, seen: Vector, commands: Vector, boundary: Vector,
    samples: int, cycle_s: float, lead_s: float, step_s: float, pushed: Rows, forces: Vector, more: Vector, out: Vector,
    at: int,
) -> None:  # fmt: skip
    """Row by row observe the rig, follow the line on it, and advance; as `emulation._rows`.

    The rig of N axes: `p`, `s`, `u`, `w`; the line: parameters `web`, state `line`, `line_u`, `line_w`, its driven
    rollers at `rows` (N,). Room for a `guess` of its state, for mean speeds, speeds, accelerations and loads (4, N),
    and for its outputs `seen`. Carriages `pushed`, rows of the line, get `forces` (n, C), each of which acts to the
    next row; `more` (C,): forces added by effects.
    """
    n, m, k, axes = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(web[lay.W_SPANS]), int(web[lay.W_AXES])
    columns, load = 3 * m + 2 * k + len(sensors), lay.U_MOTORS + n * lay.UM_SIZE + lay.UM_SETPOINT
    mean, v, a, loads = room[0], room[1], room[2], room[3]
    sample_s = web[lay.W_SAMPLE_TIME_S]
    for i in range(n):
        mean[i] = v[i] = a[i] = loads[i] = 0.0
    kernel.enter(p, s, u, w)
    for row in range(commands.shape[0]):
        place = at + row * columns
        kernel.report(p, s, u, w, out, place)
        line_u[lay.U_STRAIN_PREV], line_u[lay.U_F_NEXT_N] = boundary[row, 0], boundary[row, 1]
        if row > 0:
            for j in range(len(pushed)):
                web[places.axis(pushed[j]) + lay.A_FORCE_N] = forces[row - 1, j] + more[j]
            for i in range(n):
                mean_m_s = (out[place + i] - line[lay.S_Y + rows[i]]) / cycle_s
                if row > 1:
                    a[i] += cycle_s / (cycle_s + ACCELERATION_S) * ((mean_m_s - mean[i]) / cycle_s - a[i])
                mean[i] = mean_m_s
                v[i] = mean_m_s - 0.5 * gained_m_s(a[i], cycle_s)
            turn(web, line, line_u, line_w, rows, v, a, cycle_s, sample_s, step_s)
            for i in range(n):
                line[lay.S_Y + rows[i]] = out[place + i]
                line[lay.S_Y + 2 * axes + rows[i]] = out[place + i]
        kernel.enter(web, line, line_u, line_w)
        kernel.report(web, line, line_u, line_w, seen, 0)
        for j in range(2 * k):
            out[place + 3 * m + j] = seen[3 * int(web[lay.W_MOTORS]) + j]
        _show(web, line, sensors, out, place + 3 * m + 2 * k)
        for j in range(len(line)):
            guess[j] = line[j]
        for i in range(n):
            v[i] = line[lay.S_Y + axes + rows[i]]
        turn(web, guess, line_u, line_w, rows, v, a, lead_s, sample_s, step_s)
        kernel.enter(web, guess, line_u, line_w)
        kernel.report(web, guess, line_u, line_w, seen, 0)
        for j in range(n):
            u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, j]
        for j in range(m - n):  # the torque for the measurement at the previous SYNC
            u[load + j * lay.UM_SIZE] = loads[int(p[places.motor(n, n + j) + lay.M_AXIS])]
        kernel.go_on(p, s, u, w, samples)
        _pull(web, line, boundary, row, rows, pulls, seen, loads)


@entry_point(
    MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, INDICES, INDICES, VECTOR, MATRIX, MATRIX, COUNT,
    REAL, REAL, REAL, INDICES, MATRIX, VECTOR, CUBE,
)  # fmt: skip
def _simulate(
    p: Vector, s: Vector, u: Vector, w: Vector, web: Vector, line: Vector, line_u: Vector, line_w: Vector,
    rows: Rows, sensors: Rows, pulls: Vector, commands: Vector, boundary: Vector, samples: int, cycle_s: float,
    lead_s: float, step_s: float, pushed: Rows, forces: Vector, bases: Vector, out: Vector,
) -> None:  # fmt: skip
    flat, size = out.reshape(-1), out.shape[1] * out.shape[2]
    guess, room = np.zeros(line.shape[1]), np.zeros((4, len(rows)))
    seen = np.zeros(3 * int(web[0, lay.W_MOTORS]) + 2 * int(web[0, lay.W_SPANS]))
    first, more = u.copy(), np.zeros(len(pushed))
    for b in range(p.shape[0]):
        u[:] = first
        for j in range(len(pushed)):
            more[j] = web[b, places.axis(pushed[j]) + lay.A_FORCE_N] - bases[j]
        _run(
            p[b], s[b], u, w, web[b], line[b], line_u, line_w, rows, sensors, pulls, guess, room, seen, commands,
            boundary, samples, cycle_s, lead_s, step_s, pushed, forces, more, flat, b * size,
        )  # fmt: skip


def simulate_emulated_line(
    emulation: Emulation,
    model: ModelParameters,
    parameters: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
    sensors: Sequence[str] = (),
    forces_N: Mapping[str, NDArray[np.float64]] = MappingProxyType({}),
) -> Simulation:
    """Simulate recorded velocity commands, from rest, on the rig of a model with stations emulated by load motors.

    parameters: (P,) or (B, P) of the model from `layout.pack`, with effects: those of the axes are in the mechanics,
    others in the emulation. commands (n, N) m/s at the web, boundary (n, 2) upstream strain and downstream tension (N),
    a row each cycle; `sensors`: stations by name; `forces_N`: by station (n,), on carriages with a stated force. Motion
    and torques of the result are those of the axes. Raises ValueError for a cycle that is no multiple of the drives'
    sample time.
    """
    many = np.array(np.atleast_2d(parameters))
    rigs = rigs_of(emulation, model, many)
    layout, of_line = Layout.of(rigs[0]), Layout.of(many[0])
    starts = np.zeros((len(many), layout.state_size))
    lines = np.array([start_state(one, model) for one in many])
    for stand, start, one, line in zip(rigs, starts, many, lines, strict=True):
        line_follower.hold(one)
        of_line.axis_rows(one)[:, lay.place("backlash", "gap_rad")] = 0.0  # gears are the rig's
        lay.refresh_modes(stand, start)
        lay.refresh_modes(one, line)
    n = model.axis_count
    inputs, axes = rig_inputs(layout, n, 0.0), range(1, n + 1)
    per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
    pulls = np.array([float(model.carries_web_load(axis)) for axis in axes]) / per_m
    rows = np.array(lay.driven_rows(many[0]), np.int64)
    sensor_rows, samples = np.array(_rows_of(model, sensors), np.int64), samples_per(emulation.cycle_s, _sample_s(many))
    out = np.empty((len(many), len(commands), layout.output_size + 2 * of_line.spans + len(sensor_rows)))
    at_motors, limits = np.ascontiguousarray(commands * per_m), np.ascontiguousarray(boundary, dtype=np.float64)
    lead, longest_s = lead_s(model, emulation.cycle_s), line_follower.step_s(model)

    stations = {each.station.name: each.station for each in model.carriages}
    pushed, bases = np.array(_rows_of(model, [*forces_N]), np.int64), np.array([stations[k].force_N for k in forces_N])
    forces = np.column_stack([*forces_N.values()]) if forces_N else np.empty((len(commands), 0))

    def run(share: slice) -> None:
        _simulate(
            rigs[share], starts[share], inputs.copy(), layout.new_work(), many[share], lines[share],
            of_line.new_inputs(), of_line.new_work(), rows, sensor_rows, pulls, at_motors, limits, samples,
            emulation.cycle_s, lead, longest_s, pushed, forces, bases, out[share],
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out, lines = out[0], lines[0]
    of_rig, k = layout.output_size, of_line.spans
    x, v, tau = of_axes(layout, n, out)
    tension, strain = out[..., of_rig : of_rig + k], out[..., of_rig + k : of_rig + 2 * k]
    return Simulation(x, v, tau, tension, strain, lines, out[..., of_rig + 2 * k :])


def _sample_s(many: Vector) -> float:
    return many.item(0, lay.W_SAMPLE_TIME_S)


def _rows_of(model: ModelParameters, names: Sequence[str]) -> list[int]:
    """Rows of carriages and reels among the axes of a line, by name."""
    rollers = model.line_rollers
    rows = {station_name(roller.station): row for row, roller in enumerate(rollers)}
    rows |= {each.station.name: row for row, each in enumerate(model.carriages, len(rollers))}
    return [rows[name] for name in names]
