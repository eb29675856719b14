"""One cycle of the twin after the other on measurements that are wrong, late, or of a plant that runs already."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.estimation.runs import CYCLE_S, NEW_PA, OLD_PA, Array, measured, stepped, tracked
from tests.plant.models import effect, model

from hilbench.estimation.plausibility import Plausibility
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line import delay
from hilbench.estimation.web_line.config import (
    ChangepointConfig,
    EkfConfig,
    EstimationConfig,
    LmConfig,
    PidConfig,
    RlsConfig,
)
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.span_estimator import SpanEstimator
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters

GOOD = np.full(2500, OLD_PA)
FROM, TO = 1500, 1800  #: rows in which something is wrong


@dataclass
class Twin:
    tracking: SpanEstimator
    line: Line
    ports: tuple[MotorPort, MotorPort]
    plant: ModelParameters

    def take(self, data: Measurements, row: int) -> None:
        measured = *data.x_m[row], data.tau2_Nm[row], self.ports[1].torque_Nm
        self.tracking.compare(*measured, data.strain_prev[row], data.F_next_N[row])
        for axis, port in enumerate(self.ports):
            port.setpoint = data.v_cmd_m_s[row, axis] * self.plant.motor_rad_per_m(axis + 1)
        self.line.step(CYCLE_S)


def twin(plant: ModelParameters | None = None, **options: object) -> Twin:
    plant = plant or model()
    ports = (MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.VELOCITY))
    line = Line(plant, ports)
    config = EstimationConfig.model_validate({"estimate": [ChangepointConfig()], **options})
    return Twin(SpanEstimator(plant, config, line, CYCLE_S), line, ports, plant)


def rows(data: Measurements) -> Iterator[int]:
    yield from range(len(data.t_s))


def not_a_number(torque: Array) -> None:
    torque[FROM:TO] = np.nan


def frozen(torque: Array) -> None:
    torque[FROM:TO] = torque[FROM]


def saturated(torque: Array) -> None:
    torque[FROM:TO] = model().drives.torque_limit_Nm  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("damage", "problem"),
    [(not_a_number, Problem.INVALID), (frozen, Problem.FROZEN), (saturated, Problem.SATURATED)],
)
@pytest.mark.parametrize("method", [ChangepointConfig(), EkfConfig(), RlsConfig(), LmConfig(), PidConfig()])
def test_bad_torque_holds_the_estimate_and_it_recovers_by_itself(
    damage: Callable[[Array], None], problem: Problem, method: object
) -> None:
    data = measured(GOOD)
    damage(data.tau2_Nm)
    bench = twin(estimate=[method])
    moduli, deviations, problems = [], [], []
    for row in rows(data):
        bench.take(data, row)
        moduli.append(bench.tracking.estimate.youngs_modulus_Pa)
        deviations.append(bench.tracking.estimate.deviation_Pa)
        problems.append(bench.tracking.problem)
    seen = set(problems[FROM:TO])
    # A frozen value is told from a quiet one after 20 cycles.
    first = problems.index(problem)
    assert FROM <= first <= FROM + 20
    assert seen <= {problem, None}
    assert problems[first:TO] == [problem] * (TO - first)
    # A drive that was at its limit has moved away from its command: it is given 50 ms to be back.
    over = TO + 1 + (round(0.05 / CYCLE_S) if problem is Problem.SATURATED else 0)
    assert set(problems[:FROM]) == set(problems[over:]) == {None}
    assert set(problems[TO:over]) <= {problem, None}
    assert len(set(moduli[first:TO])) == 1
    if not isinstance(method, PidConfig):
        # E may have become another one meanwhile; what is known of the rest of the model stays.
        grown_Pa2 = deviations[TO - 1] ** 2 - deviations[first] ** 2
        walked_Pa = 0.01 * method.hold_growth_pct_per_s * OLD_PA  # type: ignore[attr-defined]
        assert grown_Pa2 == pytest.approx(walked_Pa**2 * CYCLE_S * (TO - 1 - first), rel=0.05)
        assert abs(moduli[-1] - OLD_PA) < 3.0 * deviations[-1]
        assert deviations[-1] < 1.1 * deviations[FROM - 1]


def test_a_slack_web_teaches_nothing() -> None:
    data = measured(GOOD)
    # Axis 1 runs ahead by twice the strain for 0.6 s: what comes into the span is longer than what leaves it.
    more = np.zeros(len(GOOD))
    more[FROM:TO] = 2.0 * model().upstream_strain * 3.0
    data.x_m[:, 0] += np.cumsum(more) * CYCLE_S
    bench = twin()
    problems = []
    for row in rows(data):
        bench.take(data, row)
        problems.append(bench.tracking.problem)
    assert Problem.SLACK in problems[FROM : TO + 100]
    assert problems[-1] is None
    assert np.isfinite(bench.tracking.estimate.deviation_Pa)


def test_standstill_under_dry_friction_teaches_nothing() -> None:
    plant = model(effect("coulomb_friction", 2, force_N=3.0))
    data = measured(GOOD, plant=plant, speed_m_s=0.0)
    bench = twin(plant)
    estimates = []
    for row in rows(data):
        bench.take(data, row)
        estimates.append(bench.tracking.estimate)
    # The axes give way a little as the web's pull is released; then they stand.
    stands = estimates[200:]
    assert bench.tracking.problem is Problem.STANDSTILL
    assert len({estimate.youngs_modulus_Pa for estimate in stands}) == 1
    assert np.all(np.diff([estimate.deviation_Pa for estimate in stands]) > 0.0)
    assert not bench.tracking.synchronized


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=60), st.booleans())
@settings(max_examples=40, deadline=None)
def test_no_torque_makes_the_estimate_no_number(torques: list[float], transfer: bool) -> None:
    data = measured(GOOD[:700])
    bench = twin(transfer={"axes": transfer})
    for row in range(600):
        bench.take(data, row)
    for offset, torque in enumerate(torques):
        data.tau2_Nm[600 + offset] = torque
        bench.take(data, 600 + offset)
        estimate = bench.tracking.estimate
        assert np.isfinite(estimate.youngs_modulus_Pa)
        assert estimate.deviation_Pa > 0.0
        assert np.isfinite(bench.line.tension_N[0])


@pytest.mark.parametrize("method", [ChangepointConfig(), EkfConfig(), RlsConfig(), LmConfig(), PidConfig()])
def test_a_torque_that_belongs_to_no_web_makes_no_modulus_that_no_material_has(method: object) -> None:
    data = measured(GOOD)
    data.tau2_Nm[FROM:TO] -= 3.0
    bench = twin(estimate=[method])
    for row in rows(data):
        bench.take(data, row)
        assert 0.0 < bench.tracking.estimate.youngs_modulus_Pa < np.inf


def test_a_method_takes_over_from_another_without_a_jump() -> None:
    data = measured(np.full(2500, NEW_PA))
    bench = twin()
    methods = [EkfConfig(), RlsConfig(), LmConfig(), PidConfig(), ChangepointConfig()]
    for row in rows(data):
        before = bench.tracking.estimate
        switches = row >= 1500 and row % 150 == 0 and bool(methods)
        if switches:
            bench.tracking.use(methods.pop(0))
        bench.take(data, row)
        if switches:
            change_Pa = bench.tracking.estimate.youngs_modulus_Pa - before.youngs_modulus_Pa
            assert abs(change_Pa) < 1e-3 * NEW_PA
        elif row >= 1500:
            assert bench.tracking.estimate.youngs_modulus_Pa == pytest.approx(NEW_PA, rel=0.02)
    assert not methods


def test_on_a_running_plant_it_is_synchronized_once_strain_and_E_are_told_apart() -> None:
    data = measured(np.full(4000, NEW_PA))
    start = 2000  # at 3 m/s, with an E that the twin does not know
    bench = twin()
    bench.tracking.release(strain_uncertainty=0.3)
    synchronized = []
    for row in range(start, 3200):
        bench.take(data, row)
        synchronized.append(bench.tracking.synchronized)
        if bench.tracking.synchronized:
            assert bench.tracking.estimate.youngs_modulus_Pa == pytest.approx(NEW_PA, rel=0.01)
    # What is not known of the strain decays with L/v = 0.33 s: before a span has gone through, nothing tells it from E.
    assert 0.33 < synchronized.index(True) * CYCLE_S < 1.0
    assert all(synchronized[synchronized.index(True) :])


def test_implausible_states_are_not_transferred() -> None:
    data = measured(GOOD)
    bench = twin(transfer={"axes": True})
    for row in range(1500):
        bench.take(data, row)
    assert not bench.tracking.refused
    tension = float(bench.line.tension_N[0])
    data.x_m[1500:, 0] += 0.1
    bench.take(data, 1500)
    assert bench.tracking.refused
    assert float(bench.line.tension_N[0]) == pytest.approx(tension, rel=1e-3)


@pytest.mark.parametrize("delay_cycles", [0, 1, 3, 7])
def test_a_delay_of_the_torque_is_found(delay_cycles: int) -> None:
    rng = np.random.default_rng(0)
    simulated = np.cumsum(rng.standard_normal(6000)) * 0.02
    finder = delay.new_finder(CYCLE_S)
    finder = finder._replace(s=finder.s[0])
    for k in range(6000):
        measured_Nm = simulated[max(k - delay_cycles, 0)] + 0.05 * rng.standard_normal()
        found_s = delay.find(finder, measured_Nm, simulated[k])
    assert found_s == pytest.approx(delay_cycles * CYCLE_S, abs=0.45 * CYCLE_S)


def test_no_delay_is_believed_where_the_torque_does_not_move() -> None:
    rng = np.random.default_rng(0)
    finder = delay.new_finder(CYCLE_S)
    finder = finder._replace(s=finder.s[0])
    assert {delay.find(finder, 0.05 * rng.standard_normal(), 0.0) for _ in range(5000)} == {0.0}


def test_a_late_torque_is_compensated() -> None:
    true = stepped(8.0)
    data, late = measured(true), 5
    delayed = replace(data, tau2_Nm=np.concatenate([np.full(late, data.tau2_Nm[0]), data.tau2_Nm[:-late]]))
    found = tracked(delayed, ChangepointConfig(), torque_delay="estimate")
    ignored = tracked(delayed, ChangepointConfig())
    # At the end of the ramp inertia's torque is gone from the motion before it is gone from the measurement.
    end = slice(round(1.0 / CYCLE_S), round(1.3 / CYCLE_S))
    errors = [float(np.ptp((track.E_Pa / true)[end])) for track in (found, ignored)]
    assert errors[0] < 0.6 * errors[1]
    assert np.abs(found.E_Pa / true - 1.0)[-500:].max() < 2e-3


@pytest.mark.parametrize("change", [0.7, 1.3, 1.4])
def test_a_step_of_e_teaches_no_friction(change: float) -> None:
    """While the loops settle behind it neither torque nor strain is what a web of another E shows at rest."""
    uniform = np.full(3500, OLD_PA)
    steps = np.where(np.arange(3500) < 3000, OLD_PA, change * OLD_PA)
    without, found = (
        {error.name: error.value for error in tracked(measured(true), ChangepointConfig()).errors}
        for true in (uniform, steps)
    )
    assert found["dry_friction_N"] == pytest.approx(without["dry_friction_N"], abs=0.3)
    assert found["torque_offset_Nm"] == pytest.approx(without["torque_offset_Nm"], abs=0.01)


def test_plausibility_needs_a_change_before_it_calls_a_torque_frozen() -> None:
    judge = Plausibility(9.0, 0.0, 1e-6, CYCLE_S)
    assert {judge.problem(1.0, 1e-5, 3.0) for _ in range(100)} == {None}
    assert judge.problem(1.1, 1e-5, 3.0) is None
    answers = [judge.problem(1.1, 1e-5, 3.0) for _ in range(30)]
    assert answers[-1] is Problem.FROZEN
    assert judge.problem(1.2, 1e-5, 3.0) is None
