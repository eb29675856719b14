"""Factory of the configured synchronizer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

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
from hilbench.estimation.web_line.synchronizers.base import Plant, Synchronizer
from hilbench.estimation.web_line.synchronizers.changepoint import ChangepointSynchronizer
from hilbench.estimation.web_line.synchronizers.ekf import EkfSynchronizer
from hilbench.estimation.web_line.synchronizers.global_search import GlobalSynchronizer
from hilbench.estimation.web_line.synchronizers.input_observer import InputSynchronizer
from hilbench.estimation.web_line.synchronizers.lm import LmSynchronizer
from hilbench.estimation.web_line.synchronizers.pid import PidSynchronizer
from hilbench.estimation.web_line.synchronizers.rls import RlsSynchronizer

_KINDS: Mapping[type[SynchronizerConfig], Callable[[Any, Plant], Synchronizer]] = {
    PidConfig: PidSynchronizer,
    RlsConfig: RlsSynchronizer,
    EkfConfig: EkfSynchronizer,
    LmConfig: LmSynchronizer,
    GlobalConfig: GlobalSynchronizer,
    ChangepointConfig: ChangepointSynchronizer,
    InputConfig: InputSynchronizer,
}


def new_synchronizer(config: SynchronizerConfig, plant: Plant) -> Synchronizer:
    """New synchronizer for this plant, with the plant's E as its first guess."""
    return _KINDS[type(config)](config, plant)
