"""Web emulation by load motors, whole recordings in one compiled call: the rig's mechanics under the load model.

In each cycle, as on the bench (`hilbench.bench.tasks.load_model`): the web is followed on the rollers' positions at
SYNC, its tension is predicted over the dead time of the emulation, and the load motor gets the torque with the next
SYNC. Between them the axes turn under their drives and the load motor, without a web. Noise and resolution are left
out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, CUBE, MATRIX, REAL, VECTOR, compiled, entry_point, inlined
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import span_kernel as spans
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.offline import Simulation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, pack_rig
from hilbench.plant.web_line.stability import sampled_shaft


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


@inlined
def _motor(n: int, j: int) -> int:
    """Offset of motor row j in the parameters of a machine of n axes."""
    return lay.W_SIZE + n * lay.A_SIZE + j * lay.M_SIZE


@compiled
def _rows(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    web: Vector,
    follower: Vector,
    guess: Vector,
    v: Vector,
    tension: Vector,
    torques: Vector,
    scratch: Vector,
    commands: Vector,
    boundary: Vector,
    samples: int,
    cycle_s: float,
    lead_s: float,
    out: Vector,
    at: int,
) -> None:
    """Row by row observe the rig, follow the web on it, and advance.

    The rig of N axes and M motors: parameters `p` (P,), state `s` (S,), inputs `u`, scratch space `w`. The web of K
    spans on it: parameters `web` of the whole line, `follower` as of `span_kernel.roll_on`, its `scratch` space; room
    for `guess` (as `follower`), speeds `v` (N,), `tension` (K,) and the load motors' `torques` (M - N,), initially
    those that act in the first row. `commands` (n, N) rad/s at the motors, `boundary` (n, 2) upstream strain and
    downstream tension (N), a row of `samples` drive samples each. Rows of 3·M + 2·K columns go into `out` from offset
    `at` on.
    """
    n, m, k = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(web[lay.W_SPANS])
    columns, load = 3 * m + 2 * k, lay.U_MOTORS + n * lay.UM_SIZE + lay.UM_SETPOINT
    kernel.enter(p, s, u, w)
    for row in range(commands.shape[0]):
        place = at + row * columns
        kernel.report(p, s, u, w, out, place)
        before, duration = max(row - 1, 0), cycle_s if row > 0 else 0.0
        if row > 0:
            for i in range(n):
                v[i] = (out[place + i] - follower[1 + i]) / cycle_s
        entering, f_next_N = boundary[before, 0], boundary[before, 1]
        strain_next = laws.downstream_strain(web, f_next_N)
        spans.roll_on(web, follower, scratch, v, entering, f_next_N, strain_next, duration, cycle_s, tension)
        for j in range(k):
            material = follower[1 + n + j]
            out[place + 3 * m + j] = tension[j]
            scale = laws.length_factor(web, lay.W_SIZE + n * (lay.A_SIZE + lay.M_SIZE) + j * lay.SP_SIZE)
            out[place + 3 * m + k + j] = follower[1 + n + k + j] * scale / material - 1.0
        for j in range(len(follower)):
            guess[j] = follower[j]
        guess[0] -= lead_s  # only the motion is predicted: the tension has the present E
        entering, f_next_N = boundary[row, 0], boundary[row, 1]
        strain_next = laws.downstream_strain(web, f_next_N)
        spans.roll_on(web, guess, scratch, v, entering, f_next_N, strain_next, lead_s, cycle_s, tension)
        for j in range(n):
            u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, j]
        for j in range(m - n):
            u[load + j * lay.UM_SIZE] = torques[j]
        kernel.go_on(p, s, u, w, samples)
        # The torque for the measurement at this SYNC is sent with the next.
        upstream_N = laws.upstream_strain(web, boundary[row, 0], follower[0]) * web[lay.W_UPSTREAM_STIFFNESS_N]
        for j in range(m - n):
            i = int(p[_motor(n, n + j) + lay.M_AXIS])
            pull_Nm_per_N = web[lay.W_SIZE + i * lay.A_SIZE + lay.A_WEB_LOAD] / web[_motor(n, i) + lay.M_RAD_PER_M]
            behind_N = tension[i] if i < k else boundary[row, 1]
            torques[j] = (behind_N - (tension[i - 1] if i > 0 else upstream_N)) * pull_Nm_per_N


@entry_point(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, MATRIX, MATRIX, COUNT, REAL, REAL, CUBE)
def _simulate_rows(
    p: Vector,
    s: Vector,
    u: Vector,
    w: Vector,
    web: Vector,
    follower: Vector,
    scratch: Vector,
    commands: Vector,
    boundary: Vector,
    samples: int,
    cycle_s: float,
    lead_s: float,
    out: Vector,
) -> None:
    flat, size = out.reshape(-1), out.shape[1] * out.shape[2]
    n, m, k = int(p[0, lay.W_AXES]), int(p[0, lay.W_MOTORS]), int(web[0, lay.W_SPANS])
    guess = np.zeros(follower.shape[1])
    v, tension, torques = np.zeros(n), np.zeros(k), np.zeros(m - n)
    first = u.copy()
    for b in range(p.shape[0]):
        u[:] = first
        for i in range(n):
            v[i] = commands[0, i] / p[b, lay.W_SIZE + n * lay.A_SIZE + i * lay.M_SIZE + lay.M_RAD_PER_M]
        for j in range(m - n):
            torques[j] = u[lay.U_MOTORS + (n + j) * lay.UM_SIZE + lay.UM_SETPOINT]
        _rows(
            p[b], s[b], u, w, web[b], follower[b], guess, v, tension, torques, scratch, commands, boundary, samples,
            cycle_s, lead_s, flat, b * size,
        )  # fmt: skip


def simulate_emulated(
    emulation: Emulation,
    model: ModelParameters,
    parameters: Vector,
    state: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
) -> Simulation:
    """Simulate recorded velocity commands on the rig of a model of N axes and K spans, the web emulated by load motors.

    parameters: (P,) or (B, P) of the model from `layout.pack`, with effects: those of the axes are in the mechanics,
    those of the web in what is emulated. state: (S,) or (B, S) of the model, not changed; its strains are the emulated
    web's. commands (n, N) m/s at the web, boundary (n, 2) upstream strain and downstream tension (N), a row each cycle.
    Torques and motion of the result are those of the axes; its `state` is the given one.
    Raises ValueError for a cycle that is no multiple of the drives' sample time, or shapes that do not fit.
    """
    many = np.atleast_2d(np.ascontiguousarray(parameters))
    states = np.broadcast_to(np.atleast_2d(state), (len(many), np.shape(state)[-1]))
    n = model.axis_count
    if commands.ndim != 2 or commands.shape[1] != n or np.shape(boundary) != (len(commands), 2):
        raise ValueError(f"commands {commands.shape}, boundary {np.shape(boundary)}, expected (n, {n}) and (n, 2)")
    rigs = rigs_of(emulation, model, many)
    layout = Layout.of(rigs[0])
    starts, followers = _start(layout, rigs, many, states, boundary[0])
    inputs = rig_inputs(layout, n, layout.motor_states(starts[0])[n:, lay.SM_TORQUE_NM])
    rows = np.ascontiguousarray(commands * layout.motor_rows(rigs[0])[:n, lay.M_RAD_PER_M])
    limits = np.ascontiguousarray(boundary, dtype=np.float64)
    samples = samples_per(emulation.cycle_s, many[0, lay.W_SAMPLE_TIME_S])
    of_rig, k = layout.output_size, Layout.of(many[0]).spans
    out = np.empty((len(many), len(rows), of_rig + 2 * k))
    lead = lead_s(model, emulation.cycle_s)

    def run(share: slice) -> None:
        _simulate_rows(
            rigs[share], starts[share], inputs.copy(), layout.new_work(), many[share], followers[share],
            spans.new_follower_work(Layout.of(many[0])), rows, limits, samples, emulation.cycle_s, lead, out[share],
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out = out[0]
    x, v, tau = of_axes(layout, n, out)
    tension, strain = out[..., of_rig : of_rig + k], out[..., of_rig + k :]
    return Simulation(x_m=x, v_m_s=v, tau_Nm=tau, F_N=tension, strain=strain, state=np.asarray(state))


def rig_inputs(layout: Layout, axes: int, load_Nm: Vector | float) -> Vector:
    """Inputs of a rig: its `axes` in velocity mode, its load motors in torque mode, initially with `load_Nm`."""
    inputs = layout.new_inputs()
    motors = layout.motor_inputs(inputs)
    motors[:axes, lay.UM_MODE] = MotorMode.VELOCITY
    motors[axes:, lay.UM_MODE] = MotorMode.TORQUE
    motors[axes:, lay.UM_SETPOINT] = load_Nm
    return inputs


def of_axes(layout: Layout, axes: int, out: Vector) -> tuple[Vector, Vector, Vector]:
    """Positions (m), speeds (m/s) and torques (N·m) of a rig's axes, (..., N) each, from rows of outputs."""
    x, v, tau = (out[..., layout.columns[name]][..., :axes] for name in ("x_m", "v_m_s", "tau_Nm"))
    return x, v, tau


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
    for stand, parameters in zip(rigs, many, strict=True):
        layout.axis_rows(stand)[:, lay.A_FIXED :] = of_model.axis_rows(parameters)[driven, lay.A_FIXED :]
        motors = layout.motor_rows(stand)[: layout.axes]
        motors[:] = of_model.motor_rows(parameters)[driven]
        motors[:, lay.M_AXIS] = np.arange(layout.axes)
    return rigs


def _start(layout: Layout, rigs: Vector, many: Vector, states: Vector, boundary: Vector) -> tuple[Vector, Vector]:
    """States (B, S) of the rigs and of the webs (as of `span_kernel.roll_on`), for states of the models.

    `boundary` (2,): upstream strain and downstream tension (N) at the start.
    """
    of_model = Layout.of(many[0])
    n, k = of_model.axes, of_model.spans
    starts, followers = np.zeros((len(many), layout.state_size)), np.zeros((len(many), spans.follower_size(of_model)))
    for stand, start, follower, parameters, state in zip(rigs, starts, followers, many, states, strict=True):
        y = of_model.y(state)
        layout.y(start)[:] = y[: 4 * n]
        follower[1 : 1 + n], follower[1 + n : 1 + n + 2 * k] = y[:n], y[4 * n :]
        motors = layout.motor_states(start)
        motors[:n] = of_model.motor_states(state)
        if np.any(y[n : 2 * n]):  # running: the load motors already have torque
            strain = y[4 * n + k :] / y[4 * n : 4 * n + k] - 1.0
            of_spans = of_model.span_rows(parameters)
            tension = strain * of_spans[:, lay.SP_MODULUS_PA] * of_spans[:, lay.SP_SECTION_M2]
            around = np.array([boundary[0] * parameters[lay.W_UPSTREAM_STIFFNESS_N], *tension, boundary[1]])
            rows = layout.motor_rows(stand)[n:]
            axes = rows[:, lay.M_AXIS].astype(int)
            pull = (around[axes + 1] - around[axes]) / rows[:, lay.M_RAD_PER_M]
            motors[n:, [lay.SM_TORQUE_NM, lay.SM_COMMAND_NM, lay.SM_INTEGRAL_NM]] = pull[:, np.newaxis]
        lay.refresh_modes(stand, start)
    return starts, followers
