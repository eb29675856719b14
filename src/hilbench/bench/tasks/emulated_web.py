"""The web that load motors emulate: its parameters from a config, and its load model."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

from hilbench.bench.tasks.load_model import LoadModel
from hilbench.plant.fmu.follower import FmuFollower
from hilbench.plant.interface import Follower
from hilbench.plant.sample_coherence import play
from hilbench.plant.web_line.emulation import lead_s
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_travel_m
from hilbench.topology.blocks import LoadConfig
from hilbench.topology.config import BenchConfig


def emulated_web(model: ModelParameters, load: LoadConfig) -> ModelParameters:
    """The truth of the run: the model's machine without the model's effects, with what `load:` changes and hides.

    The strains around the line stay the model's: they do not follow a change of E in a span.
    """
    changes = load.web.model_dump(exclude_none=True)
    data = model.model_dump()
    data["web"] |= changes
    data["boundary"] |= {"upstream_strain": model.upstream_strain, "downstream_strain": model.downstream_strain}
    data["effects"] = [entry.model_dump() for entry in load.effects]
    return ModelParameters.model_validate(data)


def web_load_model(config: BenchConfig, report: Callable[[str], None] = print) -> LoadModel:
    """The load model of a config's web line and load motors; `report` gets what an FMU in it logs."""
    model, cycle_s, load_axes = config.web_line, config.cycle_time_s, config.loaded_axes
    machine: Follower
    if config.load.fmu is None:
        machine = LineFollower(emulated_web(model, config.load))
    else:
        truths = [quantity.name for quantity in LineFollower(model).describe().outputs]
        kind, unit = config.machine.machine_kind, model.position_unit
        machine = FmuFollower(config.load.fmu, kind, unit, model.axis_count, cycle_s, truths, report)
    least_m = least_travel_m(model, cycle_s)
    own_play = None if isfinite(least_m) else play(model.position_unit, cycle_s)
    lead = lead_s(model, cycle_s)
    return LoadModel(machine, load_axes, cycle_s, lead, least_m, config.load.effects, own_play)
