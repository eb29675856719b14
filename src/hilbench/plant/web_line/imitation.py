"""A web that a load motor imitates, whole recordings in one compiled call: the stand's mechanics under the load model.

What the bench does each cycle (`hilbench.bench.tasks.load_model`): the web is followed on the rollers' positions at
SYNC, its tension is predicted over the delay of the imitation, and the load motor gets the torque with the next SYNC.
Between them the axes turn under their drives and the load motor, without a web. Noise and resolution are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled, entry_point
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.sampled_shaft import imitation_delay_s
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import span as spans
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.offline import Simulation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, pack_rig
from hilbench.plant.web_line.stability import sampled_shaft

_AXES, _MOTORS = 2, 3
#: Columns of a row: motion and torque of the stand's three motors, then tension and strain of the imitated web.
_STAND_COLUMNS = 3 * _MOTORS
_COLUMNS = _STAND_COLUMNS + 2
#: What follows the web (`span.roll_on`): time, positions, unstretched length, length.
_MATERIAL, _LENGTH, _FOLLOWER_SIZE = 1 + _AXES, 2 + _AXES, 3 + _AXES


@dataclass(frozen=True)
class Imitation:
    """How a bench imitates the web: its cycle, the load motor on the shaft of axis 2, and whole units of set points."""

    cycle_s: float
    load_motor: LoadMotorParameters = field(default_factory=LoadMotorParameters)
    #: What the drives of both axes round a velocity command to, m/s at the web; None if that is not known.
    resolution_m_s: tuple[float, float] | None = None

    def as_taken(self, commands_m_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocity commands (n, 2), m/s, in the drives' whole units."""
        if self.resolution_m_s is None:
            return commands_m_s
        units = np.array(self.resolution_m_s)
        return np.asarray(np.round(commands_m_s / units) * units)


def lead_s(model: ModelParameters, cycle_s: float) -> float:
    """From measured motion to the torque of a load motor, by a model: over so long its tension is predicted.

    Raises ValueError for a model without drives.
    """
    return imitation_delay_s(sampled_shaft(model, cycle_s=cycle_s))


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
    scratch: Vector,
    commands: Vector,
    boundary: Vector,
    samples: int,
    cycle_s: float,
    lead_s: float,
    out: Vector,
    at: int,
) -> None:
    """Row by row observe the stand (p, s, u, w), follow the web on it (`web`, `follower`), and advance."""
    load = lay.U_MOTORS + _AXES * lay.UM_SIZE + lay.UM_SETPOINT
    second = lay.W_SIZE + _AXES * lay.A_SIZE + lay.M_SIZE
    pull_Nm_per_N = web[lay.W_SIZE + lay.A_SIZE + lay.A_WEB_LOAD] / web[second + lay.M_RAD_PER_M]
    torque = u[load]
    kernel.enter(p, s, u, w)
    for row in range(commands.shape[0]):
        place = at + row * _COLUMNS
        kernel.report(p, s, u, w, out, place)
        before, duration = max(row - 1, 0), cycle_s if row > 0 else 0.0
        if row > 0:
            for i in range(_AXES):
                v[i] = (out[place + i] - follower[1 + i]) / cycle_s
        spans.roll_on(web, follower, scratch, v, boundary[before, 0], boundary[before, 1], duration, cycle_s, tension)
        out[place + _STAND_COLUMNS] = tension[0]
        out[place + _STAND_COLUMNS + 1] = follower[_LENGTH] * laws.length_factor(web) / follower[_MATERIAL] - 1.0
        for j in range(_FOLLOWER_SIZE):
            guess[j] = follower[j]
        guess[0] -= lead_s  # only the motion is predicted: the tension has the E of now
        spans.roll_on(web, guess, scratch, v, boundary[row, 0], boundary[row, 1], lead_s, cycle_s, tension)
        for j in range(_AXES):
            u[lay.U_MOTORS + j * lay.UM_SIZE + lay.UM_SETPOINT] = commands[row, j]
        u[load] = torque
        kernel.go_on(p, s, u, w, samples)
        torque = (boundary[row, 1] - tension[0]) * pull_Nm_per_N


SimulateImitated = Callable[..., None]


def _entry_point(sources: int) -> SimulateImitated:
    """The compiled function; `sources` as in the kernel."""

    @entry_point
    def rows(
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
        guess, v, tension = np.zeros(_FOLLOWER_SIZE), np.zeros(_AXES), np.zeros(1)
        first = u.copy()
        for b in range(p.shape[0] if sources >= 0 else 0):
            u[:] = first
            v[:] = commands[0, :] / p[b, lay.W_SIZE + _AXES * lay.A_SIZE + lay.M_RAD_PER_M]
            _rows(
                p[b], s[b], u, w, web[b], follower[b], guess, v, tension, scratch, commands, boundary, samples,
                cycle_s, lead_s, flat, b * size,
            )  # fmt: skip

    return rows


_simulate_rows = _entry_point(kernel.source_number(spans.__file__, __file__))


def simulate_imitated(
    imitation: Imitation,
    model: ModelParameters,
    parameters: Vector,
    state: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
) -> Simulation:
    """Simulate recorded velocity commands on the stand of a model, the web imitated at axis 2.

    parameters: (P,) or (B, P) of the model from `layout.pack`, with effects: those of the axes are in the mechanics,
    those of the web in what is imitated. state: (S,) or (B, S) of the model, not changed; its strain is the imitated
    web's. commands (n, 2) m/s at the web, boundary (n, 2) upstream strain and downstream tension (N), a row each cycle.
    Torques and motion of the result are those of the two axes; its `state` is the given one.
    Raises ValueError for a cycle that is no multiple of the drives' sample time, or shapes that do not fit.
    """
    many = np.atleast_2d(np.ascontiguousarray(parameters))
    states = np.broadcast_to(np.atleast_2d(state), (len(many), np.shape(state)[-1]))
    if commands.ndim != 2 or commands.shape[1] != _AXES or np.shape(boundary) != (len(commands), 2):
        raise ValueError(f"commands {commands.shape}, boundary {np.shape(boundary)}, expected (n, 2) and (n, 2)")
    stands = _stands(imitation, model, many)
    layout = Layout.of(stands[0])
    starts, followers = _start(layout, stands, many, states, boundary[0])
    inputs = layout.new_inputs()
    motors = layout.motor_inputs(inputs)
    motors[:, lay.UM_MODE] = (MotorMode.VELOCITY, MotorMode.VELOCITY, MotorMode.TORQUE)
    motors[-1, lay.UM_SETPOINT] = layout.motor_states(starts[0])[-1, lay.SM_TORQUE_NM]
    rows = np.ascontiguousarray(commands * layout.motor_rows(stands[0])[:_AXES, lay.M_RAD_PER_M])
    limits = np.ascontiguousarray(boundary, dtype=np.float64)
    samples = samples_per(imitation.cycle_s, many[0, lay.W_SAMPLE_TIME_S])
    out = np.empty((len(many), len(rows), _COLUMNS))
    lead = lead_s(model, imitation.cycle_s)

    def run(share: slice) -> None:
        _simulate_rows(
            stands[share], starts[share], inputs.copy(), layout.new_work(), many[share], followers[share],
            spans.new_follower_work(Layout.of(many[0])), rows, limits, samples, imitation.cycle_s, lead, out[share],
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out = out[0]
    columns = layout.columns
    x, v, tau = (out[..., columns[name]][..., :_AXES] for name in ("x_m", "v_m_s", "tau_Nm"))
    tension, strain = out[..., _STAND_COLUMNS : _STAND_COLUMNS + 1], out[..., _STAND_COLUMNS + 1 :]
    return Simulation(x_m=x, v_m_s=v, tau_Nm=tau, F_N=tension, strain=strain, state=np.asarray(state))


def _stands(imitation: Imitation, model: ModelParameters, many: Vector) -> Vector:
    """(B, P): the stands of models (B, P), with what the models' effects make of axes and drives."""
    plain = model.model_copy(update={"effects": ()})
    # Its rotor is part of the inertia that the model gives the roller.
    load_motor = imitation.load_motor.model_copy(update={"inertia_kg_m2": 0.0})
    template = pack_rig(RigParameters.matching(plain, [CoupledMotor(axis=_AXES, motor=load_motor)]))
    stands = np.tile(template, (len(many), 1))
    layout, of_model = Layout.of(template), Layout.of(many[0])
    for stand, parameters in zip(stands, many, strict=True):
        effects = of_model.axis_rows(parameters)[:, lay.A_WEB_LOAD + 1 :]
        layout.axis_rows(stand)[:, lay.A_WEB_LOAD + 1 :] = effects
        layout.motor_rows(stand)[:_AXES] = of_model.motor_rows(parameters)
    return stands


def _start(layout: Layout, stands: Vector, many: Vector, states: Vector, boundary: Vector) -> tuple[Vector, Vector]:
    """States (B, S) of the stands and (B, 1 + N + 2·K) of the webs, for states (B, S) of the models."""
    of_model = Layout.of(many[0])
    starts, followers = np.zeros((len(many), layout.state_size)), np.zeros((len(many), _FOLLOWER_SIZE))
    for stand, start, follower, parameters, state in zip(stands, starts, followers, many, states, strict=True):
        y = of_model.y(state)
        layout.y(start)[:] = y[: 4 * _AXES]
        follower[1 : 1 + _AXES], follower[1 + _AXES :] = y[:_AXES], y[4 * _AXES :]
        motors = layout.motor_states(start)
        motors[:_AXES] = of_model.motor_states(state)
        if np.any(y[_AXES : 2 * _AXES]):  # under way: the load motor has been pulling
            strain = y[4 * _AXES + 1] / y[4 * _AXES] - 1.0
            tension = strain * parameters[lay.W_MODULUS_PA] * parameters[lay.W_SECTION_M2]
            pull = (boundary[1] - tension) / layout.motor_rows(stand)[-1, lay.M_RAD_PER_M]
            motors[-1, [lay.SM_TORQUE_NM, lay.SM_COMMAND_NM, lay.SM_INTEGRAL_NM]] = pull
        lay.refresh_modes(stand, start)
    return starts, followers
