"""Factory of the configured synchronizer."""

from __future__ import annotations

from hilbench.estimation.web_line.config import (
    ChangepointConfig,
    EkfConfig,
    GlobalConfig,
    InputConfig,
    LmConfig,
    PidConfig,
    RlsConfig,
    SynchronizerConfig,
)
from hilbench.estimation.web_line.synchronizers.base import Synchronizer
from hilbench.estimation.web_line.synchronizers.changepoint import ChangepointSynchronizer
from hilbench.estimation.web_line.synchronizers.ekf import EkfSynchronizer
from hilbench.estimation.web_line.synchronizers.global_search import GlobalSynchronizer
from hilbench.estimation.web_line.synchronizers.input_observer import InputSynchronizer
from hilbench.estimation.web_line.synchronizers.lm import LmSynchronizer
from hilbench.estimation.web_line.synchronizers.pid import PidSynchronizer
from hilbench.estimation.web_line.synchronizers.plant import Plant
from hilbench.estimation.web_line.synchronizers.rls import RlsSynchronizer


def new_synchronizer(config: SynchronizerConfig, plant: Plant) -> Synchronizer:
    """New synchronizer for this plant, with the plant's E as its first guess."""
    match config:
        case PidConfig():
            return PidSynchronizer(config, plant.youngs_modulus_Pa)
        case RlsConfig():
            return RlsSynchronizer(config, plant)
        case EkfConfig():
            return EkfSynchronizer(config, plant)
        case LmConfig():
            return LmSynchronizer(config, plant)
        case GlobalConfig():
            return GlobalSynchronizer(config, plant)
        case ChangepointConfig():
            return ChangepointSynchronizer(config, plant)
        case InputConfig():
            return InputSynchronizer(config, plant)
