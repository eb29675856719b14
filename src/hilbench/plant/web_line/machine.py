"""Description of a web line, for the entry points `hilbench.machines`."""

from __future__ import annotations

from typing import Final

from hilbench.machine_kinds import MachineDescription

WEB_LINE: Final = MachineDescription(
    parameters="hilbench.plant.web_line.parameters:ModelParameters",
    topology="hilbench.topology.web_line",
    hardware="hilbench.hardware.rigs:web_line",
    twin="hilbench.twin.machines.web_line:twin",
    tasks="hilbench.bench.machines.web_line:tasks",
    check="hilbench.bench.web_line_check:check_web_line",
    ranges="hilbench.bench.machines.web_line_ranges:ranges",
    check_steps="hilbench.runs.web_line_check:check_steps",
    start_values="hilbench.runs.web_line_values:start_values",
    metrics="hilbench.runs.machines.web_line:metrics_of",
    panels="hilbench.apps.report.machines.web_line:panels_of",
    page="hilbench.apps.pages.live.machines.web_line",
    prediction="hilbench.bench.prediction.web_line",
    diagnosis="hilbench.diagnosis.web_line_machine",
    live_diagnosis="hilbench.live.web_line:machine",
    commissioning="hilbench.runs.web_line_reach:reach_of_line",
    fmu_export="hilbench.plant.fmu.export.of_kind:of_line",
)
