"""What a machine of any kind is as an FMU."""

from __future__ import annotations

from hilbench.plant.fmu.export import servo_axis
from hilbench.plant.fmu.export import web_line as line
from hilbench.plant.fmu.export.machine import ExportedMachine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters


def exported(machine: ModelParameters | ServoAxisParameters, *, drives: bool, load: bool) -> ExportedMachine:
    """With the loops of its drives, or without; or (`load`) what its load motors emulate, on measured motion.

    Raises ValueError, which says what is expected instead, for what can't be exported.
    """
    if isinstance(machine, ServoAxisParameters):
        if load:
            raise ValueError("another kind for --load: what load motors emulate of a shaft is no machine by itself")
        return servo_axis.exported_axis(machine, drives=drives)
    return line.exported_load(machine) if load else line.exported_line(machine, drives=drives)
