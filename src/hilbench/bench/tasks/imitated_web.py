"""The web that load motors imitate: what of a config makes it, and the load model of it."""

from __future__ import annotations

from hilbench.bench.tasks.load_model import LoadModel
from hilbench.plant.web_line.imitation import lead_s
from hilbench.plant.web_line.line_follower import follower_of
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m
from hilbench.topology.config import BenchConfig, LoadConfig


def imitated_web(model: ModelParameters, load: LoadConfig) -> ModelParameters:
    """The truth of the run: the model's machine without the model's effects, with what `load:` changes and hides.

    The upstream strain stays the model's: it does not follow a change of E in the span.
    """
    changes = load.web.model_dump(exclude_none=True)
    data = model.model_dump()
    data["web"] |= changes
    data["boundary"]["upstream_strain"] = model.upstream_strain
    data["effects"] = [entry.model_dump() for entry in load.effects]
    return ModelParameters.model_validate(data)


def web_load_model(config: BenchConfig) -> LoadModel:
    """The load model of a config's web line and load motors."""
    model, cycle_s = config.web_line, config.cycle_time_s
    machine = follower_of(imitated_web(model, config.load))
    load_axes = config.loaded_axes
    return LoadModel(machine, load_axes, cycle_s, lead_s(model, cycle_s), least_way_m(model), config.load.effects)
