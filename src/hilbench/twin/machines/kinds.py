"""Factory of machines by kind; modules of other kinds are not loaded."""

from __future__ import annotations

from collections.abc import Mapping

from hilbench.compiled import load
from hilbench.machine_kinds import machine_part
from hilbench.topology.blocks import MachineParameters, TwinConfig
from hilbench.topology.signals import Shape
from hilbench.twin.machines.machine import BoundaryInputs, TwinMachine, VectorMachine

_WARM_UP_CYCLES = 100


def new_machine(
    model: MachineParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> TwinMachine:
    """Machine of a model; `boundary_inputs`: last stated boundary inputs."""
    made: TwinMachine = machine_part(model.kind, "twin")(model, config, shape, cycle_s, boundary_inputs)
    return made


def boundary(model: MachineParameters, shape: Shape) -> Mapping[str, float]:
    """Initial values of 6413h, by signal."""
    values: Mapping[str, float] = machine_part(model.kind, "topology").boundary(model, shape)
    return values


def warm_up(model: MachineParameters, config: TwinConfig, shape: Shape, cycle_s: float) -> None:
    """Compile (or load) the cycle's functions on scratch objects before the devices boot."""
    machine = new_machine(model, config, shape, cycle_s, boundary(model, shape).__getitem__)
    if isinstance(machine, VectorMachine):
        load(machine.compiled_cycle)
    axes = range(model.axis_count)
    for k in range(_WARM_UP_CYCLES):
        machine.compare(k * cycle_s, [(0.0, 0.1 + 0.01 * (k % 7)) for _ in axes])
        machine.listen()
        machine.plant.step(cycle_s)
        machine.published()
