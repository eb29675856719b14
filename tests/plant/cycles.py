"""What a bench does cycle by cycle, in plain calls of the rig and of what its load motors emulate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.emulation import lead_s
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, TestRig


def cycle_by_cycle(
    web: LineFollower,
    parameters: ModelParameters,
    load_axes: Sequence[int],
    commands: np.ndarray,
    cycle_s: float,
    *,
    effects: Sequence[EffectEntry] = (),
    sensors: Sequence[str] = (),
    inputs: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> np.ndarray:
    """Positions, torques, tensions, then outputs `sensors` of the emulated `web`, a row for each row (N,) of commands,
    m/s: the torque of what was measured goes out with the next SYNC. `inputs` (n,): told to it in each row.

    effects: of the mechanics of the rig.
    """
    n = parameters.axis_count
    ports = [MotorPort(mode=MotorMode.VELOCITY) for _ in range(n)]
    ports += [MotorPort(mode=MotorMode.TORQUE) for _ in load_axes]
    stand = RigParameters.matching(parameters, [CoupledMotor(axis=axis) for axis in load_axes], effects=effects)
    rig, torques, rows = TestRig(stand, ports), [0.0] * len(load_axes), []
    per_m = [parameters.motor_rad_per_m(axis) for axis in range(1, n + 1)]
    for number, command in enumerate(commands):
        outputs = rig.outputs()
        x = [outputs[f"x{axis}_rad"] / per_m[axis - 1] for axis in range(1, n + 1)]
        if number:
            web.follow(x, cycle_s)
        seen = [web.outputs()[name] for name in sensors]
        rows.append([*x, *(port.torque_Nm for port in ports[:n]), *web.tension_N, *seen])
        for port, v, scale in zip(ports, command, per_m, strict=False):
            port.setpoint = v * scale
        for port, torque in zip(ports[n:], torques, strict=True):
            port.setpoint = torque
        rig.step(cycle_s)
        torques = web.load_torques_Nm(load_axes, [0.0] * n, lead_s(parameters, cycle_s))
        for name, values in inputs.items():
            web.set_input(name, values[number])
    return np.array(rows)


def follow(parameters: ModelParameters, x_m: np.ndarray, boundary: np.ndarray, cycle_s: float) -> np.ndarray:
    """Tensions (n, K) of the web on recorded positions x_m (n, N), between boundaries (n, 2), in one call."""
    follower = LineFollower(parameters)
    follower.reset(x_m[0])
    return follower.follow_rows(x_m, boundary, cycle_s)
