"""Choice of the twin of a web line; modules of lines with stations are imported for these alone."""

from __future__ import annotations

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.signals import Shape
from hilbench.twin.machines.machine import BoundaryInputs, TwinMachine
from hilbench.twin.machines.web_line import WebLineTwin


def twin(
    model: ModelParameters, config: TwinConfig, shape: Shape, cycle_s: float, boundary_inputs: BoundaryInputs
) -> TwinMachine:
    """Twin of a line."""
    if model.stations is None:
        return WebLineTwin(model, config, cycle_s, boundary_inputs)
    from hilbench.twin.machines.web_line_with_stations import LineWithStationsTwin

    return LineWithStationsTwin(model, config, shape, cycle_s, boundary_inputs)
