"""Block `prediction:` of a config's twin."""

from __future__ import annotations

from pydantic import Field, PositiveFloat

from hilbench.block import Block


class PredictionConfig(Block):
    """Prediction by the twin: it simulates the next seconds repeatedly from the present estimate, and reports limits
    that will be crossed."""

    every_s: PositiveFloat = Field(default=0.1, le=10.0, description="how often it looks ahead; whole cycles")
    horizon_s: PositiveFloat = Field(default=5.0, le=60.0, description="how far it looks ahead")
    futures: int = Field(default=64, ge=16, le=1024, description="how many futures it draws each time")
    announce_above: float = Field(
        default=0.5, gt=0, lt=1, description="probability from which a crossing of a limit is announced"
    )
    act_above: float = Field(
        default=0.9,
        gt=0,
        lt=1,
        description="probability from which the bench acts on it (safety: on_predicted_limit)",
    )
