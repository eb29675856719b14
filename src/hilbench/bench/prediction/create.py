"""The look ahead of a config, where it asks for one."""

from __future__ import annotations

from collections.abc import Callable

from hilbench.bench.prediction.task import Prediction
from hilbench.bench.prediction.web_line import LineLook
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.prediction.plan import Asked
from hilbench.topology.config import BenchConfig


def prediction_task(
    config: BenchConfig, state: BenchState, asked: Callable[[], Asked], reference: Reference
) -> Prediction | None:
    """None where the config asks for no prediction."""
    wanted = config.twin.prediction
    if wanted is None:
        return None
    return Prediction(
        LineLook(config, wanted),
        wanted,
        state,
        asked,
        seed=config.seed,
        lockstep=config.pace == "lockstep",
        on_predicted_limit=config.safety.on_predicted_limit,
        reference=reference,
    )
