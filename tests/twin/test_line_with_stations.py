"""The twin of a line with dancers and reels finds where they stand, what they have on them, and E where it shows."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tiers import slow
from tests.twin.beside_stations import CYCLE_S, Array, BesideStations, beside, dancer_line, guided_line, winding_line
from tests.twin.independent_dancer import IndependentDancer
from tests.twin.independent_winding import IndependentWinding

from hilbench.estimation.web_line.config import EstimationConfig

SPRUNG = {"spring_N_per_m": 800.0, "spring_rest_m": 0.1}
#: Of the web beside the dancer, two strands.
BESIDE_THE_DANCER_M = 4.0


def after(found: dict[str, Array], time_s: float) -> np.ndarray:
    """Rows from so long after the first on."""
    return found["t_s"] >= found["t_s"][0] + time_s


def off_by(found: dict[str, Array], name: str) -> Array:
    """What the twin has more than what is true."""
    return found[f"{name}_sim_m"] - found[f"{name}_true_m"]


def web_within_1_percent(found: dict[str, Array]) -> bool:
    """Whether from 0.5 s on the length beside the dancer is known so well."""
    return bool(np.all(2.0 * np.abs(off_by(found, "x_dancer")[after(found, 0.5)]) <= 0.01 * BESIDE_THE_DANCER_M))


def honest(found: dict[str, Array], name: str, deviations: float = 4.0) -> bool:
    """Whether what is off stays within so many stated deviations, from 1 s on."""
    rows = after(found, 1.0)
    return bool(np.all(np.abs(off_by(found, name)[rows]) <= deviations * found[f"{name}_sd_m"][rows]))


def test_a_sprung_dancer_that_stands_elsewhere_than_believed_is_found_by_the_tension() -> None:
    line = beside(dancer_line(position_m=0.1, **SPRUNG), dancer_line(position_m=0.05, **SPRUNG))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0)
    line.go(2.5, 1.01, 1.0, 1.0002)
    found = line.table()
    assert abs(off_by(found, "x_dancer")[0]) > 0.02
    assert web_within_1_percent(found)
    assert honest(found, "x_dancer")
    assert found["x_dancer_sd_m"][-1] < 0.003


def test_a_twin_that_joins_under_way_finds_a_sprung_dancer() -> None:
    line = beside(dancer_line(spring_N_per_m=800.0), dancer_line(spring_N_per_m=800.0))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0, with_twin=False)
    line.go(2.0, 1.1, 1.0, 1.0002, with_twin=False)
    line.go(4.0, 1.0, 1.0, 1.0002)
    found = line.table()
    assert abs(off_by(found, "x_dancer")[0]) > 0.02
    assert web_within_1_percent(found)
    assert honest(found, "x_dancer")
    assert not line.twin.separable
    assert np.all(np.isinf(found["E4_sd_Pa"]))
    settled = after(found, 1.0)
    for span in (1, 4):
        assert np.max(np.abs(found[f"F{span}_sim_N"] - found[f"F{span}_true_N"])[settled]) < 1.5


@pytest.mark.parametrize("speed_m_s", [1.0, *slow(0.5, 2.0)])
def test_a_web_that_a_twin_joins_under_way_does_not_swing_for_it(speed_m_s: float) -> None:
    """The measurement with which it is let go is the first that is compared: no way of two cycles in one."""
    believed = dancer_line()
    line = BesideStations(IndependentDancer(), believed, believed, measured=("dancer",))  # type: ignore[arg-type]
    speeds = [speed_m_s] * 3
    line.go(1.0, *speeds, ramp_s=1.0, with_twin=False)
    line.go(1.5, *speeds, with_twin=False)
    line.go(2.5, *speeds)
    found = line.table()
    off_N = np.abs(found["F4_sim_N"] - found["F4_true_N"])
    # It begins with the tension that the model has.
    assert abs(found["F4_true_N"][0] - 80.0) > 1.0
    assert np.max(off_N) < abs(found["F4_true_N"][0] - 80.0) + 1.0
    assert np.max(off_N[after(found, 0.1)]) < 1.0
    assert np.max(np.abs(off_by(found, "x_dancer"))) < 2e-4


def test_of_a_dancer_with_a_constant_force_that_is_joined_the_twin_says_that_it_knows_no_place() -> None:
    line = beside(dancer_line(), dancer_line())
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0, with_twin=False)
    line.go(2.0, 1.1, 1.0, 1.0, with_twin=False)
    line.go(3.0, 1.0, 1.0, 1.0)
    found = line.table()
    assert off_by(found, "x_dancer")[-1] == pytest.approx(-0.05, abs=0.01)
    assert found["x_dancer_sd_m"][-1] == pytest.approx(0.4 / np.sqrt(12.0), rel=0.05)


def test_a_measured_dancer_is_where_its_sensor_says() -> None:
    line = beside(dancer_line(position_m=0.1), dancer_line(), measured=("dancer",))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0)
    line.go(2.0, 1.05, 1.0, 1.0)
    found = line.table()
    assert np.ptp(found["x_dancer_true_m"]) > 0.02
    assert np.max(np.abs(off_by(found, "x_dancer")[after(found, 0.5)])) < 5e-4
    assert honest(found, "x_dancer")


def test_a_wrong_E_is_found_behind_a_dancer_with_its_deviation() -> None:
    true_Pa = 1.2 * 8.7e9
    balanced = {"force_N": 192.0, "next_N": 96.0}
    line = beside(dancer_line(true_Pa, **balanced), dancer_line(**balanced))
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0)
    line.go(4.0, 1.0, 1.0, 1.0001)
    found = line.table()
    error, deviation = found["E4_sim_Pa"] - true_Pa, found["E4_sd_Pa"]
    assert abs(error[0]) > 0.1 * true_Pa
    settled = after(found, 0.5)
    assert np.max(np.abs(error[settled])) < 0.03 * true_Pa
    assert np.all(np.abs(error[settled]) < 3.0 * deviation[settled])
    assert line.twin.separable


@pytest.mark.parametrize("factor", [1.2, *slow(0.8, 1.0)])
def test_a_load_cell_tells_E_and_tension_where_no_torque_does(factor: float) -> None:
    """Of no roller the torque says anything of the web. The cell is 0.3 % off: so are tension and E."""
    true = IndependentDancer(modulus_Pa=np.full(4, factor * 8.7e9), force_N=factor * 160.0, next_N=factor * 80.0)
    believed = dancer_line().model_copy(update={"web_load": False})
    line = BesideStations(true, believed, believed, measured=("guide",))  # type: ignore[arg-type]
    line.go(1.0, 1.0, 1.0, 1.0, ramp_s=1.0)
    line.go(2.0, 1.0, 1.0, 1.0)
    true.modulus_Pa = np.array([1.0, 1.0, 0.85, 0.85]) * factor * 8.7e9
    line.go(3.5, 1.0, 1.0, 1.0)
    found = line.table()
    true_Pa = np.where(found["t_s"] > 2.0, 0.85, 1.0) * factor * 8.7e9
    error = found["E4_sim_Pa"] / true_Pa - 1.0
    settled = after(found, 0.5) & ~((found["t_s"] > 2.0) & (found["t_s"] < 2.5))
    assert np.max(np.abs(error[settled])) < 0.01
    assert np.all(np.abs(error[settled]) * true_Pa[settled] < 2.0 * found["E4_sd_Pa"][settled])
    assert np.max(np.abs(found["F4_sim_N"] / found["F4_true_N"] - 1.0)[settled]) < 0.01
    assert line.twin.separable


@pytest.mark.parametrize(("factor", "duration_s"), [(1.2, 2.6), *slow((1.2, 10.0), (0.85, 10.0), (1.0, 10.0))])
def test_E_of_a_line_that_a_twin_joins_at_rest_is_found_and_does_not_drift_as_the_speed_changes(
    factor: float, duration_s: float
) -> None:
    true = IndependentWinding((0.25, 0.15, 0.12), modulus_Pa=factor * 2e8, held=True)
    line = BesideStations(true, winding_line(), winding_line(), measured=("unwinder", "rewinder"))
    line.go(0.3, 0.0, 0.0, 0.0)
    line.go(1.3, 2.0, 2.0006, 2.0012, ramp_s=1.0)
    line.go(duration_s - 1.0, 2.0, 2.0006, 2.0012)
    line.go(duration_s, 1.0, 1.0003, 1.0006, ramp_s=0.7)
    found = line.table()
    error = found["E2_sim_Pa"] / (factor * 2e8) - 1.0
    assert np.max(np.abs(error[after(found, 0.2)])) < 0.01
    assert np.all(found["E2_sd_Pa"][after(found, 0.2)] < 0.03 * factor * 2e8)


@pytest.mark.parametrize(
    ("factor", "strained"),
    [(1.1, (1.5, 0.6)), *slow((0.85, (0.6, 1.4)), (1.2, (0.6, 1.5)), (1.0, (1.0, 1.0)), (1.22, (1.6, 1.2)))],
)
def test_a_web_at_rest_between_idlers_that_nobody_knows_is_told_with_E_once_it_has_left(
    factor: float, strained: tuple[float, float]
) -> None:
    """E `factor` of what is believed, both sections strained so many times as the web upstream."""
    true, believed = guided_line(factor * 8.7e9), guided_line()
    line = beside(true, believed, config=EstimationConfig(web_at_rest="unknown"))
    strains = {f"strain{span}": strained[span > 2] * true.upstream_strain for span in range(1, 5)}
    line.line.set_state(strains)
    line.go(0.5, 0.0, 0.0, 0.0, with_twin=False)
    line.go(1.5, 0.0, 0.0, 0.0)
    rests = len(line.table()["t_s"])
    line.go(3.5, 3.0, 3.0, 3.0, ramp_s=2.0)
    line.go(6.5, 3.0, 3.0, 3.0)
    found = line.table()
    error, deviation = found["E4_sim_Pa"] / (factor * 8.7e9) - 1.0, found["E4_sd_Pa"] / 8.7e9
    assert np.all(np.isinf(deviation[:rests]))  # until the web of all spans has left, after 9 m
    told = np.isfinite(deviation)
    assert np.count_nonzero(told) > 0.9 / CYCLE_S
    assert np.mean(np.abs(error[told]) <= 1.96 * deviation[told]) > 0.95
    assert np.max(np.abs(error[told])) < 0.03
    tensions = [name for name in found if name.endswith("_sim_N")]
    assert len(tensions) == 2
    for name in tensions:
        apart_N = found[name] - found[name.replace("sim", "true")]
        assert np.max(np.abs(apart_N[rests // 2 : rests])) < 2.0  # what they pull with shows at rest
        assert np.max(np.abs(apart_N[told])) < 0.04 * 80.0


@pytest.mark.parametrize(
    ("factor", "strained"), [(1.1, (1.5, 0.6)), *slow((0.85, (0.6, 1.4)), (1.2, (0.6, 1.5)), (1.0, (1.0, 1.0)))]
)
def test_a_web_at_rest_between_measured_reels_that_nobody_knows_is_told_as_one_between_idlers(
    factor: float, strained: tuple[float, float]
) -> None:
    true = IndependentWinding((0.25, 0.15, 0.12), modulus_Pa=factor * 2e8, held=True, strained=strained)
    reels = ("unwinder", "rewinder")
    unknown = EstimationConfig(web_at_rest="unknown")
    line = BesideStations(true, winding_line(), winding_line(), measured=reels, config=unknown)
    speeds = [share * 3.0 for share in (1.0, 1.0003, 1.0006)]
    line.go(0.5, 0.0, 0.0, 0.0, with_twin=False)
    line.go(1.5, 0.0, 0.0, 0.0)
    rests = len(line.table()["t_s"])
    line.go(3.5, *speeds, ramp_s=2.0)
    line.go(6.5, *speeds)
    found = line.table()
    error, deviation = found["E2_sim_Pa"] / (factor * 2e8) - 1.0, found["E2_sd_Pa"] / (factor * 2e8)
    told = np.isfinite(deviation)
    assert not told[:rests].any()
    assert np.count_nonzero(told) > 0.9 / CYCLE_S
    assert np.all(np.abs(error[told]) <= 1.96 * deviation[told])
    assert np.max(np.abs(error[told])) < 0.03
    for name in ("F1", "F2"):
        apart_N = found[f"{name}_sim_N"] - found[f"{name}_true_N"]
        assert np.max(np.abs(apart_N[rests // 2 : rests])) < 2.0
        assert np.max(np.abs(apart_N)[told]) < 0.04 * 80.0


@pytest.mark.parametrize(("factor", "strained"), [(1.1, 1.3), *slow((0.85, 0.7))])
@pytest.mark.slow
def test_of_a_web_at_rest_beside_a_measured_dancer_that_nobody_knows_the_tension_is_told_and_E_is_not(
    factor: float, strained: float
) -> None:
    """The carriage keeps the tension of its web, whatever E is; the web behind is strained as that, and its draw."""
    behind = np.full(2, strained * 2.829e-4)
    held = np.full(2, 80.0 / (factor * 8.7e9 * 0.5 * 65e-6))
    true = IndependentDancer(modulus_Pa=np.full(4, factor * 8.7e9), strains=np.concatenate([held, behind]))
    unknown, believed = EstimationConfig(web_at_rest="unknown"), dancer_line()
    line = BesideStations(true, believed, believed, measured=("dancer",), config=unknown)  # type: ignore[arg-type]
    line.go(0.5, 0.0, 0.0, 0.0, with_twin=False)
    line.go(1.5, 0.0, 0.0, 0.0)
    line.go(3.5, 2.0, 2.0002, 2.0004, ramp_s=2.0)
    line.go(7.0, 2.0, 2.0002, 2.0004)
    found = line.table()
    assert np.all(np.isinf(found["E4_sd_Pa"]))
    for name in ("F1", "F4"):
        apart_N = found[f"{name}_sim_N"] - found[f"{name}_true_N"]
        assert np.max(np.abs(apart_N[found["t_s"] > 1.0])) < 1.0
    assert np.max(np.abs(found["x_dancer_sim_m"] - found["x_dancer_true_m"])) < 5e-4


@pytest.mark.parametrize(
    ("factor", "speed_m_s", "seed"), [(1.2, 3.0, 1), *slow((0.8, 1.0, 2), (1.2, 0.5, 2), (0.9, 2.0, 3), (1.0, 2.0, 4))]
)
def test_E_between_measured_reels_that_are_joined_under_way_is_told_once_other_web_has_come(
    factor: float, speed_m_s: float, seed: int
) -> None:
    true = IndependentWinding((0.25, 0.15, 0.12), modulus_Pa=factor * 2e8, held=True)
    line = BesideStations(true, winding_line(), winding_line(), measured=("unwinder", "rewinder"), seed=seed)
    speeds = [share * speed_m_s for share in (1.0, 1.0003, 1.0006)]
    line.go(1.5, *speeds, ramp_s=1.0, with_twin=False)
    line.go(2.5, *speeds, with_twin=False)
    line.go(2.5 + 1.6 * 5.0 / speed_m_s, *speeds)
    found = line.table()
    assert np.all(np.isinf(found["E2_sd_Pa"][~after(found, 4.9 / speed_m_s)]))
    gone = after(found, 5.5 / speed_m_s)
    error_Pa, deviation_Pa = found["E2_sim_Pa"] / factor - 2e8, found["E2_sd_Pa"] / factor
    assert np.all(np.abs(error_Pa[gone]) < 2.0 * deviation_Pa[gone])
    assert np.max(deviation_Pa[gone]) < 0.03 * 2e8
    assert line.twin.separable


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_radii_without_a_sensor_are_found_over_the_whole_reel(seed: int) -> None:
    """Unwound from 120 to 61 mm, with a web 3 % thicker than believed, both reels 1.5 and 1 % other than believed."""
    true = IndependentWinding((0.12 * 1.015, 0.15, 0.1 * 0.99), thickness_m=1.03e-3, modulus_Pa=2e8 / 1.03)
    line = BesideStations(true, winding_line((0.1218, 0.099)), winding_line((0.12, 0.1)), seed=seed)
    line.go(2.0, 2.0, 2.0, 2.0, ramp_s=2.0)
    line.go(18.0, 2.0, 2.0003, 2.0006)
    found = line.table()
    assert found["r_unwinder_true_m"][-1] < 0.5 * found["r_unwinder_true_m"][0]
    for reel in ("r_unwinder", "r_rewinder"):
        assert abs(off_by(found, reel)[0]) > 0.005 * found[f"{reel}_true_m"][0]
        rows = after(found, 1.0)
        assert np.max(np.abs(off_by(found, reel) / found[f"{reel}_true_m"])[rows]) < 0.002
        assert honest(found, reel)
