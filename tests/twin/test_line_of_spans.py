"""E of every span of a line by itself, each with its deviation, and its tension."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from tests.twin.beside_a_line import Array, BesideALine, line_model
from tests.twin.independent_spans import IndependentSpans

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.exchange.nodes import Nodes
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
#: When E steps in the run of three spans, and in which; 0: in all at once.
STEPS = ((2.5, 2, 10.5e9), (3.7, 1, 10.0e9), (4.9, 3, 7.4e9), (6.1, 0, 8.7e9))
SPANS = (1, 2, 3)


@cache
def three_spans() -> RunOutcome:
    """The shipped line on the bench, with other steps."""
    folder = Path(mkdtemp())
    steps: list[dict[str, Any]] = [{"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 1.0}}]
    for at_s, span, to_Pa in STEPS:
        path = f"load.web.span{span}.youngs_modulus_Pa" if span else "load.web.youngs_modulus_Pa"
        steps += [{"hold": {"until_s": at_s}}, {"step": {"path": path, "to": to_Pa}}]
    given = load_with_overrides(
        CONFIGS / "line_three_spans.yaml",
        bus=f"embedded:{folder.name}",
        changes=[f"steps={[*steps, {'hold': {'duration_s': 1.2}}]}", "criteria=[]"],
    )
    return run_experiment(given, folder / "runs", participants=Participants.IN_PROCESS)


@cache
def found() -> dict[str, Array]:
    """Its recording."""
    channels = read_recording(three_spans().folder.recording).channels
    return {name: np.asarray(values) for name, values in channels.items()}


def stepped(span: int) -> list[float]:
    """Times at which E of a span steps, s."""
    return [at_s for at_s, of, _ in STEPS if of in (span, 0)]


@pytest.mark.slow
@pytest.mark.parametrize("span", SPANS)
def test_a_step_of_e_in_one_span_or_all_at_once_is_found_within_300_ms(span: int) -> None:
    values = found()
    error = values[f"E{span}_sim_Pa"] / values[f"E{span}_true_Pa"] - 1.0
    assert three_spans().result.faults == []
    for at_s in stepped(span):
        after = (values["t_s"] >= at_s + 0.3) & (values["t_s"] < at_s + 1.2)
        assert np.max(np.abs(error[after])) < 0.01


@pytest.mark.parametrize("span", SPANS)
def test_a_step_of_e_in_another_span_is_taken_for_none_of_this_one(span: int) -> None:
    values = found()
    error = values[f"E{span}_sim_Pa"] / values[f"E{span}_true_Pa"] - 1.0
    for at_s, of, _ in STEPS:
        if of not in (span, 0):
            before = np.mean(error[(values["t_s"] >= at_s - 0.2) & (values["t_s"] < at_s)])
            after = (values["t_s"] >= at_s) & (values["t_s"] < at_s + 1.2)
            assert np.max(np.abs(error[after] - before)) < 0.003


@pytest.mark.parametrize("span", SPANS)
def test_the_simulated_tension_of_each_span_is_the_true_one_again_within_300_ms(span: int) -> None:
    values = found()
    error_N = values[f"F{span}_sim_N"] - values[f"F{span}_true_N"]
    for at_s, _, _ in STEPS:
        after = (values["t_s"] >= at_s + 0.3) & (values["t_s"] < at_s + 1.2)
        assert np.max(np.abs(error_N[after])) < 1.0


@pytest.mark.parametrize("span", SPANS)
def test_the_deviation_of_each_holds_its_error(span: int) -> None:
    values = found()
    moving = values["t_s"] > 1.5
    error_Pa = np.abs(values[f"E{span}_sim_Pa"] - values[f"E{span}_true_Pa"])[moving]
    assert np.mean(error_Pa <= 1.96 * values[f"E{span}_sd_Pa"][moving]) > 0.95
    assert np.median(values[f"E{span}_sd_Pa"][moving]) < 0.15 * 8.7e9


@pytest.mark.slow
def test_metrics_and_report_tell_of_each_span() -> None:
    metrics = three_spans().result.metrics
    for span in SPANS:
        assert metrics[f"E{span}_final_error_pct"] is not None
    page = write_report(three_spans().folder).read_text(encoding="utf-8")
    assert [f"Young’s modulus in span {span}" in page for span in SPANS] == [True] * 3
    # A step of all spans is one of each, and told once.
    assert page.count("E +17.6 %") == page.count("E2 +17.6 %") == 0


def test_each_estimate_has_pdos_of_its_own() -> None:
    nodes = Nodes(load_with_overrides(CONFIGS / "line_three_spans.yaml").config)
    assert [tuple(signal.name for signal in pdo.signals) for pdo in nodes.io.data.sent] == [
        names for k in SPANS for names in ((f"F{k}_sim_N", f"E{k}_sim_Pa"), (f"E{k}_sd_Pa", f"tau{k + 1}_residual_Nm"))
    ]
    assert [pdo.name for pdo in nodes.io.tpdos] == [f"TPDO{k}" for k in range(1, 8)]


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        ("[{span: 2, method: rls}, {span: 2, method: ekf}]", "each span at most once: E of a span is found in one way"),
        ("[{span: 1, method: rls}, {method: ekf}]", "one entry without a span for all of them"),
        ("[{span: 1, method: rls}, {span: 4, method: rls}]", "a span of 1 to 3, '4' is none"),
        ("[{span: 1, method: rls}, {span: 2, method: input}]", "another method than 'input'"),
    ],
)
def test_what_a_line_cannot_estimate_is_refused_in_one_line(estimate: str, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said) as refused:
        load_with_overrides(CONFIGS / "line_three_spans.yaml", changes=[f"twin.estimate={estimate}", "criteria=[]"])
    assert "\n" not in str(refused.value)


def estimation(*entries: dict[str, Any]) -> EstimationConfig:
    return EstimationConfig.model_validate({"estimate": list(entries)} if entries else {})


def test_a_span_without_an_estimate_goes_with_the_nearest_that_has_one() -> None:
    model = line_model(4.0, 5.0, 6.0)
    both = BesideALine(model, estimation({"span": 2, "method": "changepoint"}))
    both.go(0.5, 1.0)
    for span in SPANS:
        both.line.set_parameter(f"span{span}.youngs_modulus_Pa", 9.5e9)
    both.go(1.5)
    assert [both.twin.plant.parameter(f"span{k}.youngs_modulus_Pa") for k in SPANS] == pytest.approx(
        [9.5e9] * 3, rel=0.01
    )
    first, last = ({"method": "changepoint", "span": span} for span in (1, 3))
    apart = BesideALine(model, estimation(first, last))
    apart.go(0.5, 1.0)
    apart.line.set_parameter("span1.youngs_modulus_Pa", 9.5e9)
    apart.go(1.5)
    assert [apart.twin.plant.parameter(f"span{k}.youngs_modulus_Pa") for k in SPANS] == pytest.approx(
        [9.5e9, 9.5e9, 8.7e9], rel=0.01
    )


def test_creep_over_a_roller_between_two_spans_that_the_model_has_is_no_other_e() -> None:
    """By creep the next span gets less web than the roller turns, and how much goes with the tension there."""
    creep = {"effect": "web_slip", "span": 2, "parameters": {"creep_per_N": 1e-5}}
    around = {"upstream_tension_N": 80.0, "downstream_tension_N": 60.0}
    both = BesideALine(line_model(1.0, 1.5, 1.2, boundary=around, effects=[creep]))
    both.go(0.5, 2.0)
    both.go(4.0)
    told, last = both.table(), slice(-300, None)
    assert np.mean(told["F2_true_N"][last] - told["F3_true_N"][last]) > 2.0
    for span in SPANS:
        assert np.mean(told[f"E{span}_sim_Pa"][last]) == pytest.approx(8.7e9, rel=0.005)
        assert np.mean(told[f"F{span}_sim_N"][last] - told[f"F{span}_true_N"][last]) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("speed_m_s", [2.0, -2.0])
@pytest.mark.parametrize("estimated", [SPANS, (1, 3)])
def test_creep_over_every_roller_is_no_other_e_nor_tension_in_either_direction(
    speed_m_s: float, estimated: tuple[int, ...]
) -> None:
    """In reverse it lets more web out of the span behind a roller than that turns."""
    lengths_m, creeps = (1.0, 1.5, 1.2), (2e-5, 1e-5, 1.5e-5)
    around = {"upstream_tension_N": 80.0, "downstream_tension_N": 60.0}
    effects = [
        {"effect": "web_slip", "span": span, "parameters": {"creep_per_N": creep}}
        for span, creep in zip(SPANS, creeps, strict=True)
    ]
    both = BesideALine(
        line_model(*lengths_m, boundary=around, effects=effects),
        EstimationConfig.model_validate(
            {"estimate": [{"span": span, "method": "changepoint"} for span in estimated], "unmodelled_torque_Nm": 0.0}
        ),
        line=IndependentSpans(lengths_m, creeps, 80.0, 60.0),
        torque_noise_Nm=0.005,
    )
    rows: list[tuple[float, ...]] = []

    def keep() -> None:
        plant = both.twin.plant
        moduli = (plant.parameter(f"span{span}.youngs_modulus_Pa") for span in SPANS)
        rows.append((*both.line.tension_N, *plant.tension_N, *moduli))

    both.go(0.5, speed_m_s)
    both.go(3.0)
    both.go(4.0, each_cycle=keep)
    true_N, sim_N, moduli_Pa = np.mean(rows, axis=0).reshape(3, len(SPANS))
    # Without creep 64.1 N in reverse, 76.7 N forward.
    assert true_N[0] == pytest.approx(61.3 if speed_m_s < 0.0 else 69.3, abs=0.1)
    assert moduli_Pa == pytest.approx(8.7e9, rel=0.01)
    assert sim_N == pytest.approx(true_N, abs=0.15)


@pytest.mark.slow
def test_a_twin_that_joins_a_running_line_finds_web_and_e_of_one_span_after_the_other() -> None:
    """It is told the strain upstream, not that in the spans: the line has drawn those tighter meanwhile."""
    both = BesideALine(line_model(1.0, 1.5))
    both.line.set_parameter("span1.youngs_modulus_Pa", 8.0e9)
    both.line.set_state({"strain1": 1.15 * float(both.line.strain[0]), "strain2": 1.1 * float(both.line.strain[1])})
    both.go(0.3, 1.5, with_twin=False)
    both.go(0.33)
    assert not both.twin.synchronized
    both.go(4.0)
    assert both.twin.synchronized
    told = both.table()
    for span in (1, 2):
        assert told[f"E{span}_sim_Pa"][-1] == pytest.approx(told[f"E{span}_true_Pa"][-1], rel=0.01)
        assert told[f"F{span}_sim_N"][-1] == pytest.approx(told[f"F{span}_true_N"][-1], abs=1.0)


def test_another_method_is_used_at_every_span() -> None:
    both = BesideALine(line_model(2.0, 2.0))
    both.go(0.5, 1.0)
    both.go(1.0)
    both.twin.use_method(4)
    both.line.set_parameter("span2.youngs_modulus_Pa", 9.5e9)
    both.go(2.0)
    assert both.table()["E2_sim_Pa"][-1] == pytest.approx(9.5e9, rel=0.01)
    with pytest.raises(ValueError, match="several spans"):
        both.twin.use_method(7)
