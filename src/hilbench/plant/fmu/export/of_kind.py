"""Export definitions by kind of machine, with the loops of its drives, or without; or (`load`) of the emulated load.

Raise ValueError with the expected kind for a machine that can't be exported.
"""

from __future__ import annotations

from hilbench.plant.fmu.export import servo_axis
from hilbench.plant.fmu.export import web_line as line
from hilbench.plant.fmu.export.machine import ExportedMachine
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line.parameters import ModelParameters


def of_axis(machine: ServoAxisParameters, *, drives: bool, load: bool) -> ExportedMachine:
    """Export definition of a servo axis."""
    if load:
        raise ValueError("another kind for --load: what load motors emulate of a shaft is no machine by itself")
    return servo_axis.exported_axis(machine, drives=drives)


def of_line(machine: ModelParameters, *, drives: bool, load: bool) -> ExportedMachine:
    """Export definition of a line; of its load on measured motion."""
    return line.exported_load(machine) if load else line.exported_line(machine, drives=drives)
