"""Export definition of a machine of any kind."""

from __future__ import annotations

from hilbench.plant.fmu.export import servo_axis
from hilbench.plant.fmu.export import web_line as line
from hilbench.plant.fmu.export.machine import ExportedMachine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters


def exported(machine: ModelParameters | ServoAxisParameters, *, drives: bool, load: bool) -> ExportedMachine:
    """Export definition with the loops of its drives, or without; or (`load`) of the emulated load, on measured motion.

    Raises ValueError with the expected kind for a machine that can't be exported.
    """
    if isinstance(machine, ServoAxisParameters):
        if load:
            raise ValueError("another kind for --load: what load motors emulate of a shaft is no machine by itself")
        return servo_axis.exported_axis(machine, drives=drives)
    return line.exported_load(machine) if load else line.exported_line(machine, drives=drives)
