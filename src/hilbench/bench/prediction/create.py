"""The look ahead of a config, where it asks for one; most need not load what one is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hilbench.bench.prediction.task import LimitReading, Prediction
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.plant.fmu.axis import FmuAxisParameters
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.prediction.config import PredictionConfig
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
        look_of(config, wanted),
        wanted,
        state,
        asked,
        seed=config.seed,
        lockstep=config.pace == "lockstep",
        on_predicted_limit=config.safety.on_predicted_limit,
        reference=reference,
    )


def look_of(config: BenchConfig, prediction: PredictionConfig) -> LimitReading:
    """How the machine of a config looks ahead. Its futures can be run (`foreseeable`)."""
    if isinstance(config.machine, ServoAxisParameters):
        from hilbench.bench.prediction.servo_axis import ShaftLook

        return ShaftLook(config, prediction)
    from hilbench.bench.prediction.web_line import LineLook

    return LineLook(config, prediction)


def foreseeable(config: BenchConfig) -> Mapping[str, str]:
    """The quantities whose courses futures follow, by path, each with the signal that shows it; none of a machine whose
    futures nobody can run."""
    if isinstance(config.machine, FmuAxisParameters):
        return {}
    if isinstance(config.machine, ServoAxisParameters):
        from hilbench.bench.prediction.servo_axis import FORESEEN

        return FORESEEN
    from hilbench.bench.prediction.web_line import foreseen

    return foreseen(config)
