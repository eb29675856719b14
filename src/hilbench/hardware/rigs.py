"""The rig of each kind of machine: what the simulated drives turn."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.effect import MachineKind
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.interface import Plant
from hilbench.plant.motor_port import MotorPort
from hilbench.processes import log
from hilbench.topology.config import BenchConfig


def new_rig(config: BenchConfig, ports: Sequence[MotorPort], seed: int = 0) -> Plant:
    """The rig of a config's machine; ports in the order axes, load motors."""
    if isinstance(config.machine, FmuAxisParameters):
        from hilbench.plant.fmu.shaft import FmuRig

        return FmuRig(config.machine, config.servo_rig_parameters(), ports, seed, log)
    if config.machine_kind is MachineKind.SERVO_AXIS:
        from hilbench.plant.servo_axis.rig import ServoRig

        return ServoRig(config.servo_rig_parameters(), ports, seed)
    from hilbench.plant.web_line.rig import TestRig

    return TestRig(config.rig_parameters(), tuple(ports), seed)
