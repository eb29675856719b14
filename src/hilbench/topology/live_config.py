"""Bench config of the live diagnosis."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hilbench.block import Block


class LiveDiagnosisConfig(Block):
    """A process of its own that compares model and measurement while the bench runs, and names what the model lacks."""

    model_changes: Literal["propose", "apply"] | None = Field(
        default=None,
        description="apply: the twin switches to the model that was found; propose: an operator approves first; "
        "where it is not given, propose on real drives and apply on simulated ones",
    )
    window_s: float = Field(
        default=12.0,
        ge=6.0,
        le=120.0,
        description="data after an effect has begun that it is named from; where they do not suffice, twice as much",
    )
    trial_s: float = Field(
        default=6.0, ge=5.0, le=60.0, description="new data on which a changed model has to be better than the old one"
    )
    memory_s: float = Field(default=180.0, ge=60.0, le=3600.0, description="samples that are kept")
