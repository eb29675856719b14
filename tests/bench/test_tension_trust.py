"""May the tension loop close on the twin? By what it says of itself, its age, and its numbers."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest
from tests.bench.samples import sample_of_two_axes

from hilbench.bench.tasks.tension_trust import PLACES, TRUSTED, TrustArrays, VirtualSensorSupervision, judged
from hilbench.compiled import interpreted, record_at
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import TensionControlConfig
from hilbench.twin.virtual_io import TwinStatus

SYNCHRONIZED = int(TwinStatus.RUNNING | TwinStatus.SYNCHRONIZED)
HIGHEST_N = 300.0
CYCLE_S = 0.002
_judged = interpreted(judged)
CONFIG = TensionControlConfig(twin_age_limit_cycles=10, twin_deviation_limit_pct=30.0)


def sample(**changes: Any) -> CycleSample:
    good = {"F_sim_N": 80.0, "E_sim_Pa": 8.7e9, "E_sd_Pa": 1e8, "twin_status": SYNCHRONIZED}
    return sample_of_two_axes(**(good | changes))


def believes(trust: VirtualSensorSupervision, sample: CycleSample) -> bool:
    """A cycle on: whether the loop may be closed on the twin's data in a sample."""
    arrays = trust.arrays(type(sample))
    kinds = arrays.figures.dtype, arrays.state.dtype, PLACES
    found = _judged(TrustArrays(*map(record_at, arrays, kinds)), sample.reals, sample.wholes)
    if found != TRUSTED:
        trust.doubts(found, sample)
    return trust.trusted


def trusting() -> VirtualSensorSupervision:
    trust = VirtualSensorSupervision(CONFIG, HIGHEST_N, CYCLE_S)
    assert believes(trust, sample())
    return trust


def test_the_loop_stays_open_until_the_twin_calls_itself_synchronized() -> None:
    trust = VirtualSensorSupervision(CONFIG, HIGHEST_N, CYCLE_S)
    assert not believes(trust, sample(twin_status=int(TwinStatus.RUNNING)))
    assert trust.doubt == "not synchronized yet"
    assert believes(trust, sample())
    assert trust.doubt == ""


def test_a_closed_loop_stays_closed_while_the_twin_is_not_sure_of_itself() -> None:
    trust = trusting()
    assert believes(trust, sample(twin_status=int(TwinStatus.RUNNING | TwinStatus.HOLDING)))
    assert trust.doubt == ""


DOUBTS = [
    ({"twin_age_cycles": 11}, "more than 10 cycles old"),
    ({"F_sim_N": nan}, "no web's: tension nan N"),
    ({"F_sim_N": inf}, "no web's: tension inf N"),
    ({"E_sim_Pa": nan}, "E nan Pa"),
    ({"E_sim_Pa": 0.0}, "E 0 Pa"),
    ({"E_sim_Pa": 1e30}, "E 1e+30 Pa"),
    ({"F_sim_N": -1.1}, "-1.1 N is outside 0 to 300 N"),
    ({"F_sim_N": 300.1}, "300.1 N is outside 0 to 300 N"),
]


@pytest.mark.parametrize(("changes", "why"), DOUBTS)
def test_a_doubt_opens_the_loop_and_is_named(changes: dict[str, float], why: str) -> None:
    trust = trusting()
    assert not believes(trust, sample(**changes))
    assert why in trust.doubt


def test_a_twin_that_refuses_what_is_measured_is_doubted_when_that_lasts() -> None:
    refuses = sample(twin_status=int(TwinStatus.RUNNING | TwinStatus.TRANSFER_REFUSED))
    sure = sample(twin_status=SYNCHRONIZED | int(TwinStatus.TRANSFER_REFUSED))
    trust, cycles = trusting(), 125
    for _ in range(cycles):
        assert believes(trust, refuses)
    assert all(believes(trust, sure) for _ in range(2 * cycles)), "a jump of an encoder"
    assert [believes(trust, refuses) for _ in range(cycles + 1)][-1] is False
    assert "does not follow what is measured" in trust.doubt


def test_a_deviation_above_its_limit_opens_the_loop_when_it_outlasts_a_step_of_E() -> None:
    trust, cycles, unsure = trusting(), 125, sample(E_sd_Pa=0.31 * 8.7e9)
    assert all(believes(trust, unsure) for _ in range(cycles))
    assert believes(trust, sample()), "a new E was found"
    assert [believes(trust, unsure) for _ in range(cycles + 1)] == [True] * cycles + [False]
    assert "deviation of E is above 30 %" in trust.doubt


def test_after_a_doubt_the_loop_closes_only_on_a_twin_that_is_synchronized_again() -> None:
    trust = trusting()
    believes(trust, sample(twin_age_cycles=11))
    assert not believes(trust, sample(twin_status=int(TwinStatus.RUNNING)))
    assert "cycles old" in trust.doubt
    assert believes(trust, sample())


@pytest.mark.parametrize(
    "changes",
    [
        {"twin_age_cycles": 10},
        {"F_sim_N": -0.9},
        {"F_sim_N": HIGHEST_N},
        {"E_sd_Pa": 0.29 * 8.7e9},
        {"E_sd_Pa": inf},  # of a method which has none
    ],
)
def test_what_is_at_its_limit_is_no_doubt(changes: dict[str, float]) -> None:
    assert believes(trusting(), sample(**changes))


def test_a_twin_that_was_lost_is_not_trusted_until_it_is_synchronized_again() -> None:
    trust = trusting()
    trust.forget("the twin is reset")
    assert not believes(trust, sample(twin_status=int(TwinStatus.RUNNING)))
    assert trust.doubt == "the twin is reset"


def test_a_deviation_that_swings_about_its_limit_opens_the_loop_once_until_it_is_well_below() -> None:
    trust = trusting()
    swings = [believes(trust, sample(E_sd_Pa=share * 8.7e9)) for share in (0.29, 0.31) * 200]
    assert swings == sorted(swings, reverse=True), "opened and closed again"
    assert (swings[0], swings[-1]) == (True, False)
    assert [believes(trust, sample(E_sd_Pa=share * 8.7e9)) for share in (0.25, 0.23, 0.29)] == [False, True, True]
