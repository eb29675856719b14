"""Creation of a config's prediction, where it asks for one; most configs need not load its modules."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hilbench.bench.prediction.task import Look, Prediction
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.machine_kinds import has, machine_part
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.plan import Asked
from hilbench.topology.config import BenchConfig


def prediction_task(
    config: BenchConfig, state: BenchState, asked: Callable[[], Asked], reference: Reference
) -> Prediction | None:
    """Create the prediction task; None where the config asks for no prediction."""
    wanted = config.twin.prediction
    if wanted is None:
        return None
    return Prediction(
        look_of(config, wanted),
        wanted,
        state,
        asked,
        seed=config.seed,
        lockstep=config.pace == "lockstep",
        on_predicted_limit=config.safety.on_predicted_limit,
        reference=reference,
    )


def look_of(config: BenchConfig, prediction: PredictionConfig) -> Look:
    """Prediction model of a config's machine, which must be `foreseeable`."""
    look: Look = machine_part(config.machine.kind, "prediction").look(config, prediction)
    return look


def foreseeable(config: BenchConfig) -> Mapping[str, str]:
    """Quantities whose trajectories predictions follow, by path, each with its signal; empty for a machine
    that can't be predicted."""
    kind = config.machine.kind
    return machine_part(kind, "prediction").foreseen(config) if has(kind, "prediction") else {}
