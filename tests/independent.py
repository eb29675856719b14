"""Recordings that hilbench has not made: two are kept here, others may lie beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from hilbench.plant.web_line.parameters import EffectEntry

KEPT = Path(__file__).with_name("recordings")
_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "recordings"
MODEL = KEPT / "model.yaml"


def recording(name: str) -> Path:
    """Of an independent simulator. Skips the test where there is none of this name."""
    for folder in (KEPT, _BESIDE):
        if (path := folder / f"{name}.csv.gz").exists():
            return path
    pytest.skip(f"no recording {name} beside the checkout")


def real(name: str) -> Path:
    """Of a real machine; none of these is kept here. Skips the test where there is none of this name."""
    if (path := _BESIDE / "real" / f"{name}.csv.gz").exists():
        return path
    pytest.skip(f"no recording {name} beside the checkout")


def hidden_in(name: str) -> list[EffectEntry]:
    """What that simulator's machine has beside the model."""
    labels = yaml.safe_load((KEPT / "labels.yaml").read_text(encoding="utf-8"))[f"{name}.csv.gz"]
    return [EffectEntry.model_validate(label) for label in labels]
