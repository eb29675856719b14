"""Descriptions of the kinds of machine with one shaft, for the entry points `hilbench.machines`."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hilbench.machine_kinds import MachineDescription

SERVO_AXIS: Final = MachineDescription(
    parameters="hilbench.plant.servo_axis.parameters:ServoAxisParameters",
    topology="hilbench.topology.servo_axis",
    hardware="hilbench.hardware.rigs:servo_axis",
    twin="hilbench.twin.machines.servo_axis:twin",
    tasks="hilbench.bench.machines.servo_axis:tasks",
    check="hilbench.bench.servo_axis_check:check_servo_axis",
    ranges="hilbench.bench.servo_axis_check:ranges",
    check_steps="hilbench.runs.servo_axis_check:check_steps",
    start_values="hilbench.runs.servo_axis_check:start_values",
    metrics="hilbench.runs.machines.servo_axis:metrics_of",
    panels="hilbench.apps.report.machines.servo_axis:panels_of",
    page="hilbench.apps.pages.live.machines.servo_axis",
    prediction="hilbench.bench.prediction.servo_axis",
    diagnosis="hilbench.diagnosis.servo_axis",
    live_diagnosis="hilbench.live.servo_axis:machine",
    commissioning="hilbench.runs.commissioning:reach_of_shaft",
    fmu_export="hilbench.plant.fmu.export.of_kind:of_axis",
)
#: A servo axis whose mechanics are an FMU.
FMU: Final = replace(
    SERVO_AXIS,
    parameters="hilbench.plant.fmu.axis:FmuAxisParameters",
    hardware="hilbench.hardware.rigs:fmu",
    prediction="",
    live_diagnosis="",
    recorded_as="servo_axis",
)
