"""Evidence for effects that a model lacks: what no effect can be is not accepted."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.estimation.web_line.unmodelled_evidence import EVIDENCE, look


def accepted(dry_friction: float, least: float) -> tuple[int, float]:
    """The accepted set of an offset (1) and a dry friction (2) that the data put at this many usual deviations, and the
    friction that is compensated."""
    evidence, target = np.zeros(1, EVIDENCE), np.zeros(2)
    evidence["count"], evidence["places"][0, :2], evidence["groups"][0, :2] = 2, (0, 1), (0, 1)
    evidence["least"][0, :2] = -np.inf, least
    covariance = np.diag([0.9, 0.01])
    mean = np.array([0.0, dry_friction * (1.0 - 0.01)])
    look(evidence[0], mean, covariance, np.ones(2), np.zeros(2), target)
    return int(evidence["accepted"][0]), float(target[1])


@pytest.mark.parametrize("friction", [3.0, -3.0])
def test_a_friction_that_the_data_show_is_accepted(friction: float) -> None:
    chosen, compensated = accepted(friction, -np.inf)
    assert chosen == 2
    assert compensated == pytest.approx(friction, rel=0.02)


def test_a_friction_that_would_push_is_not_accepted() -> None:
    assert accepted(-3.0, -0.3) == (0, 0.0)
    assert accepted(3.0, -0.3)[0] == 2
