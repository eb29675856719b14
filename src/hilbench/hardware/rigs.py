"""The rig of each kind of machine: what the simulated drives turn."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.machine_kinds import machine_part
from hilbench.plant.interface import Plant
from hilbench.plant.motor_port import MotorPort
from hilbench.processes import log
from hilbench.topology.config import BenchConfig


def new_rig(config: BenchConfig, ports: Sequence[MotorPort], seed: int = 0) -> Plant:
    """The rig of a config's machine; ports in the order axes, load motors."""
    rig: Plant = machine_part(config.machine.kind, "hardware")(config, ports, seed)
    return rig


def fmu(config: BenchConfig, ports: Sequence[MotorPort], seed: int) -> Plant:
    """The mechanics of an FMU, with drive, load motor and sensors."""
    from hilbench.plant.fmu.axis import FmuAxisParameters
    from hilbench.plant.fmu.shaft import FmuRig

    assert isinstance(config.machine, FmuAxisParameters), "of this kind"
    return FmuRig(config.machine, config.servo_rig_parameters(), ports, seed, log)


def servo_axis(config: BenchConfig, ports: Sequence[MotorPort], seed: int) -> Plant:
    """The shaft that is really there, with its motor and the load motor."""
    from hilbench.plant.servo_axis.shaft import ServoRig

    return ServoRig(config.servo_rig_parameters(), ports, seed)


def web_line(config: BenchConfig, ports: Sequence[MotorPort], seed: int) -> Plant:
    """The driven rollers, without the web."""
    from hilbench.plant.web_line.rig import TestRig

    return TestRig(config.rig_parameters(), tuple(ports), seed)
