"""Whole recordings in one compiled call: for the diagnosis, the synchronizers' tests, and plots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import Vector
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import simulation
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.parameters import ModelParameters


@dataclass(frozen=True, slots=True)
class Simulation:
    """Simulation result; arrays of shape (…, n, number of motors or spans), values at the start of each row."""

    x_m: Vector  #: motor positions at the web, by nominal radius
    v_m_s: Vector
    tau_Nm: Vector  #: measured torques, motor side
    F_N: Vector
    strain: Vector
    state: Vector  #: at the end, to continue from
    #: Readings of station sensors, (…, n, stations): positions of carriages, radii of reels, m.
    sensors_m: Vector | None = None
    #: Means of the measured torques over the time since the previous row; None of an emulated line.
    mean_tau_Nm: Vector | None = None


def start_state(parameters: Vector, model: ModelParameters, strain: ArrayLike | None = None) -> Vector:
    """State at rest, at position zero (carriages at the model's positions); every span strained by `strain`.

    Default: as the web that enters.
    """
    spans = Layout.of(parameters).spans
    lengths = np.array([model.span_length_m(k + 1) for k in range(spans)])
    layout = Layout.of(parameters)
    carriages = [(spans + 1 + number, each.station.position_m) for number, each in enumerate(model.carriages)]
    for row, x_m in carriages:
        carriage = layout.axis_rows(parameters)[row]
        lengths[int(carriage.first_span) : int(carriage.last_span) + 1] += lay.strand_length_m(carriage, x_m)
    state = lay.new_state(parameters, np.asarray(model.upstream_strain if strain is None else strain), lengths)
    for row, x_m in carriages:
        layout.y(state)[[row, 2 * layout.axes + row]] = x_m
    return state


def simulate(
    parameters: Vector,
    state: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
    dt_s: float,
    mode: MotorMode = MotorMode.VELOCITY,
    length_rates_m_s: ArrayLike = 0.0,
) -> Simulation:
    """Simulate recorded commands.

    parameters: (P,) from `layout.pack`, or (B, P) for B variants, shared out among all cores; state: (S,) or (B, S),
    not changed.
    commands: (n, M) set points at the web by `mode`: m/s, m, or N·m (torque, motor side), each held for `dt_s`.
    boundary: (n, 2) upstream strain and downstream tension (N). length_rates_m_s: (K,) L' of the spans.
    Raises ValueError when `dt_s` is no multiple of the sample time, or shapes do not fit.
    """
    many = np.atleast_2d(np.ascontiguousarray(parameters))
    layout = Layout.of(many[0])
    rows = np.ascontiguousarray(commands, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != layout.motors or np.shape(boundary) != (len(rows), 2):
        raise ValueError(
            f"commands {rows.shape}, boundary {np.shape(boundary)}, expected (n, {layout.motors}) and (n, 2)"
        )
    if mode != MotorMode.TORQUE:
        rows = rows * layout.motor_rows(many[0]).rad_per_m
    states = np.array(np.broadcast_to(np.atleast_2d(state), (len(many), layout.state_size)), order="C")
    inputs = layout.new_inputs()
    layout.length_rates(inputs)[:] = length_rates_m_s
    layout.motor_inputs(inputs).mode = mode
    samples = samples_per(dt_s, many[0, lay.W_SAMPLE_TIME_S])
    out = np.empty((len(many), len(rows), layout.output_size))
    limits = np.ascontiguousarray(boundary, dtype=np.float64)

    def run(share: slice) -> None:
        simulation.simulate(
            many[share], states[share], inputs.copy(), layout.new_work(), rows, limits, samples,
            out[share].reshape(-1), out.shape[2], simulation.NOTHING, simulation.NOTHING,
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out, states = out[0], states[0]
    columns = layout.columns
    return Simulation(
        x_m=out[..., columns["x_m"]],
        v_m_s=out[..., columns["v_m_s"]],
        tau_Nm=out[..., columns["tau_Nm"]],
        F_N=out[..., columns["F_N"]],
        strain=out[..., columns["strain"]],
        state=states,
        mean_tau_Nm=out[..., columns["mean_tau_Nm"]],
    )
