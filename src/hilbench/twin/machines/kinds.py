"""Factory of machines by kind; modules of other kinds are not loaded."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.topology.blocks import MachineParameters, TwinConfig
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_shape import forces_at_start, sensors_at_start
from hilbench.twin.machines.machine import BoundaryInputs, TwinMachine, VectorMachine

_WARM_UP_CYCLES = 100


def maker(model: MachineParameters) -> Callable[[TwinConfig, Shape, float, BoundaryInputs], TwinMachine]:
    """Constructor of a model's machine (`new_machine`); imports its modules."""
    if isinstance(model, ServoAxisParameters):
        from hilbench.twin.machines.servo_axis import ServoAxisTwin

        return lambda config, _, cycle_s, boundary_inputs: ServoAxisTwin(model, config, cycle_s, boundary_inputs)
    if model.stations is not None:
        from hilbench.twin.machines.web_line_with_stations import LineWithStationsTwin

        return lambda config, shape, cycle_s, boundary_inputs: LineWithStationsTwin(
            model, config, shape, cycle_s, boundary_inputs
        )
    from hilbench.twin.machines.web_line import WebLineTwin

    return lambda config, _, cycle_s, boundary_inputs: WebLineTwin(model, config, cycle_s, boundary_inputs)


def new_machine(
    model: MachineParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> TwinMachine:
    """Machine of a model; `boundary_inputs`: last stated boundary inputs."""
    return maker(model)(config, shape, cycle_s, boundary_inputs)


def boundary(model: MachineParameters, shape: Shape) -> Mapping[str, float]:
    """Initial values of 6413h, by signal."""
    if isinstance(model, ServoAxisParameters):
        return {}
    from hilbench.twin.machines import web_line

    return web_line.boundary(model) | sensors_at_start(model, shape) | forces_at_start(model, shape)


def warm_up(model: MachineParameters, config: TwinConfig, shape: Shape, cycle_s: float) -> None:
    """Compile (or load) the cycle's functions on scratch objects before the devices boot."""
    machine = new_machine(model, config, shape, cycle_s, boundary(model, shape).__getitem__)
    axes = range(model.axis_count)
    for k in range(_WARM_UP_CYCLES):
        machine.compare(k * cycle_s, [(0.0, 0.1 + 0.01 * (k % 7)) for _ in axes])
        machine.listen()
        machine.plant.step(cycle_s)
        machine.published()


def warm_up_in_vectors(model: MachineParameters, config: TwinConfig, shape: Shape, cycle_s: float) -> None:
    """Compile (or load) the functions of a machine in vectors."""
    machine = new_machine(model, config, shape, cycle_s, boundary(model, shape).__getitem__)
    if isinstance(machine, VectorMachine):
        machine.warm_up_in_vectors()
