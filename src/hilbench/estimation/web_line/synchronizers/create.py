"""Factory of the configured synchronizer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hilbench.estimation.web_line.config import SynchronizerConfig
from hilbench.estimation.web_line.synchronizers.base import Plant, Synchronizer
from hilbench.estimation.web_line.synchronizers.changepoint import ChangepointSynchronizer
from hilbench.estimation.web_line.synchronizers.ekf import EkfSynchronizer
from hilbench.estimation.web_line.synchronizers.input_observer import InputSynchronizer
from hilbench.estimation.web_line.synchronizers.pid import PidSynchronizer
from hilbench.estimation.web_line.synchronizers.rls import RlsSynchronizer
from hilbench.estimation.web_line.synchronizers.window import GlobalSynchronizer, LmSynchronizer

#: By the name of the method in configs.
_METHODS: Mapping[str, Callable[[Any, Plant], Synchronizer]] = {
    "pid": PidSynchronizer,
    "rls": RlsSynchronizer,
    "ekf": EkfSynchronizer,
    "lm": LmSynchronizer,
    "global": GlobalSynchronizer,
    "changepoint": ChangepointSynchronizer,
    "input": InputSynchronizer,
}


def new_synchronizer(config: SynchronizerConfig, plant: Plant) -> Synchronizer:
    """New synchronizer for this plant, with the plant's E as its first guess."""
    return _METHODS[config.method](config, plant)
