"""What is left of webs that nothing was known of at the start, against a line of spans that is simulated."""

from __future__ import annotations

import numpy as np
import pytest
from tests.twin.beside_a_line import BesideALine, line_model

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.initial_strains import InitialStrains, initial_strains
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.line_follower import LineFollower

LENGTHS_M = (1.0, 2.5, 1.5)
CREEPS = [EffectEntry(effect="web_slip", span=span, parameters={"creep_per_N": 4e-6}) for span in (1, 3)]
SPEED_M_S, CYCLE_S = 2.0, 0.002


@pytest.mark.parametrize("effects", [[], CREEPS])
@pytest.mark.parametrize("span", [0, 1, 2])
def test_a_strain_that_is_off_goes_through_the_line_as_its_shares_say(span: int, effects: list[EffectEntry]) -> None:
    model = line_model(*LENGTHS_M, effects=[effect.model_dump() for effect in effects])
    lines = [LineFollower(model), LineFollower(model)]  # as it is, and as it is believed to be
    strains = np.full(3, model.upstream_strain)
    off = np.where(np.arange(3) == span, 1e-6, 0.0)
    for line, more in zip(lines, (0.0, off), strict=True):
        line.set_input("strain_prev", model.upstream_strain)
        line.set_input("F_next_N", 80.0)
        line.reset([0.0] * 4, strain=list(strains + more))
    webs = initial_strains(model)
    for cycle in range(1, round(1.5 / CYCLE_S)):
        for line in lines:
            line.follow([SPEED_M_S * cycle * CYCLE_S] * 4, CYCLE_S)
        for each in range(3):
            webs.move(each, SPEED_M_S, CYCLE_S)
    apart = (np.asarray(lines[1].strain) - np.asarray(lines[0].strain)) / 1e-6
    assert apart == pytest.approx(webs.shares[:, span], abs=0.01)


def test_rollers_that_go_to_and_fro_bring_back_what_they_have_taken() -> None:
    webs = InitialStrains(LENGTHS_M, [0.0] * 3, [1.0] * 3)
    for cycle in range(10_000):
        webs.move(0, 1.3e-3 * np.sign(np.sin(8.0 * cycle * CYCLE_S)), CYCLE_S)
    assert webs.shares[0, 0] > 0.999


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_web_enters_known_only_when_those_that_it_comes_from_are(direction: float) -> None:
    webs = InitialStrains(LENGTHS_M, [0.0] * 3, [1.0] * 3)
    order = [0, 1, 2] if direction > 0.0 else [2, 1, 0]
    for known in order:
        for span in order:
            webs.move(span, direction * SPEED_M_S, CYCLE_S)
        assert webs.enters_known(known)
        if known != order[-1]:
            assert not webs.enters_known(order[-1])
        webs.know(known)


@pytest.mark.parametrize(("shares", "believed"), [((0.6, 1.2), 0.5), ((1.3, 0.7), 1.8)])
def test_webs_at_rest_are_known_half_a_second_behind_a_ramp(shares: tuple[float, float], believed: float) -> None:
    model = line_model(2.5, 4.0)
    beside = BesideALine(model, EstimationConfig(web_at_rest="unknown", youngs_modulus_Pa=believed * 8.7e9))
    beside.line.set_input("strain_prev", model.upstream_strain)
    beside.line.set_input("F_next_N", 70.0)
    beside.line.set_state({f"strain{k}": share * model.upstream_strain for k, share in enumerate(shares, 1)})
    beside.go(2.0, with_twin=False)
    beside.go(4.0)
    assert not beside.twin.synchronized
    beside.go(7.0, 2.0)
    beside.go(8.5)
    found = beside.table()
    joined, later = found["t_s"] > 2.1, found["t_s"] > 7.5
    for span in (1, 2):
        error = found[f"E{span}_sim_Pa"] / found[f"E{span}_true_Pa"] - 1.0
        deviation = found[f"E{span}_sd_Pa"] / found[f"E{span}_true_Pa"]
        assert np.mean(np.abs(error[joined]) <= 1.96 * deviation[joined]) > 0.95
        assert np.abs(error[later]).max() < 0.01
        assert np.abs(found[f"F{span}_sim_N"] - found[f"F{span}_true_N"])[later][200:].max() < 1.0
