"""Choice of the kind of machine of a config. Modules of other kinds are not loaded."""

from __future__ import annotations

from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.state import BenchState
from hilbench.plant.effect import MachineKind
from hilbench.topology.config import BenchConfig


def machine_tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
    """The tasks of a config's machine; what they report and know of the twin is in `state`."""
    if config.machine_kind is MachineKind.SERVO_AXIS:
        from hilbench.bench.machines import servo_axis

        return servo_axis.tasks(config, state)
    from hilbench.bench.machines import web_line

    return web_line.tasks(config, state)
