"""Creation of a config's prediction, where it asks for one; most configs need not load its modules."""

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


def look_of(config: BenchConfig, prediction: PredictionConfig) -> LimitReading:
    """Prediction model of a config's machine, which must be `foreseeable`."""
    if isinstance(config.machine, ServoAxisParameters):
        from hilbench.bench.prediction.servo_axis import ShaftLook

        return ShaftLook(config, prediction)
    from hilbench.bench.prediction.web_line import LineLook

    return LineLook(config, prediction)


def foreseeable(config: BenchConfig) -> Mapping[str, str]:
    """Quantities whose trajectories predictions follow, by path, each with its signal; empty for a machine
    that can't be predicted."""
    if isinstance(config.machine, FmuAxisParameters):
        return {}
    if isinstance(config.machine, ServoAxisParameters):
        from hilbench.bench.prediction.servo_axis import FORESEEN

        return FORESEEN
    from hilbench.bench.prediction.web_line import foreseen

    return foreseen(config)
