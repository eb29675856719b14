"""Simulated measurements of the demonstrator for the tests of the twin."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.plant.models import model
from tests.simulated_measurements import simulated_measurements

from hilbench.estimation.web_line.config import EstimationConfig, SynchronizerConfig
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.offline import Track, run_offline
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.runs.figures import ESTIMATE_BAND, time_to_stay

Array = NDArray[np.float64]

CYCLE_S = 0.002
STEP_S = 3.0
OLD_PA, NEW_PA = 8.7e9, 10.5e9


def times(duration_s: float) -> Array:
    return np.asarray(np.arange(round(duration_s / CYCLE_S)) * CYCLE_S, np.float64)


def stepped(duration_s: float = 6.0, to_Pa: float = NEW_PA) -> Array:
    return np.where(times(duration_s) >= STEP_S, to_Pa, OLD_PA)


def measured(
    modulus_Pa: Array, *, plant: ModelParameters | None = None, speed_m_s: float = 3.0, **options: Any
) -> Measurements:
    """Both axes ramp up within 1 s."""
    plant = plant or model()
    speed = speed_m_s * np.minimum(times(len(modulus_Pa) * CYCLE_S), 1.0)
    return simulated_measurements(plant, np.column_stack([speed, speed]), modulus_Pa, **options)


def tracked(data: Measurements, method: SynchronizerConfig, **twin: Any) -> Track:
    return run_offline(model(), EstimationConfig(estimate=[method], **twin), data)


def time_to_1pct_s(data: Measurements, track: Track, modulus_Pa: Array) -> float | None:
    step = int(np.flatnonzero(np.diff(modulus_Pa))[-1]) + 1
    return time_to_stay(data.t_s, track.E_Pa / modulus_Pa - 1.0, ESTIMATE_BAND, step)
