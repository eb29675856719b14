"""`check` of a random machine beside its run (tools/random_machines.py); docs/fault_tests.md counts all of them."""

from __future__ import annotations

import pytest
from tools.random_machines import Case, drawn, in_short, tried


@pytest.mark.parametrize(
    ("seed", "told"),
    [
        (9, True),
        (14, False),
        pytest.param(165, False, id="motors stronger than their EDS file's", marks=pytest.mark.slow),
        pytest.param(177, False, id="torque just below the limit in ramps", marks=pytest.mark.slow),
        pytest.param(168, True, id="the web pulls a roller away when it is enabled"),
    ],
)
def test_what_check_tells_of_a_machine_is_what_its_run_shows_and_a_whole_web_is_not_broken(
    seed: int, told: bool
) -> None:
    case = tried(Case(str(seed), in_short(drawn(seed))))
    assert not case.refused
    assert case.agrees
    assert bool(case.warned) == told
    assert not case.alarm


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(39, id="spans settle one after another behind a step of E"),
        pytest.param(143, id="spans settle slowly behind a step of E"),
        pytest.param(8, id="a single block of the torque is off before E steps"),
        pytest.param(55, id="other web is suspected when it is long through"),
        pytest.param(98, id="a ramp begins within a block"),
        pytest.param(118, id="a ramp takes many times the tension"),
        pytest.param(136, id="E steps by little more than the noise"),
        pytest.param(200, id="the torque is off by its noise when a step of E is judged"),
    ],
)
def test_a_whole_web_neither_breaks_nor_slips_and_no_torque_shifts(seed: int) -> None:
    case = tried(Case(str(seed), in_short(drawn(seed))))
    assert not case.refused
    assert not case.alarm
