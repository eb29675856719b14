"""An estimate whose deviation is inf is its model's: whoever shows it says so, and no figure judges it."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hilbench.apps.monitor.picture import BusPicture
from hilbench.apps.pages.live.listener import live_panels
from hilbench.apps.report.chart import Chart
from hilbench.apps.report.machines.web_line import panels_of
from hilbench.apps.report.panel import ShownRun
from hilbench.can.frame import Frame
from hilbench.exchange.nodes import Nodes
from hilbench.results.recording import Recording
from hilbench.runs.config import load
from hilbench.runs.metrics import judge
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs"
ROWS, CYCLE_S, MODULUS_PA = 2000, 0.003, 8.7e9


@pytest.fixture(scope="module")
def bench() -> BenchConfig:
    """Its twin tells E of span 3."""
    return load(SHIPPED / "line_with_dancer.yaml")[0]


def recorded(bench: BenchConfig, deviation_Pa: np.ndarray) -> Recording:
    """All even, but for a step of the set-point in the middle."""
    channels = {signal.name: np.zeros(ROWS) for signal in bench.signals}
    channels |= {
        "t_s": CYCLE_S * np.arange(ROWS),
        "F3_ref_N": np.where(np.arange(ROWS) < ROWS // 2, 90.0, 100.0),
        "E3_true_Pa": np.full(ROWS, MODULUS_PA),
        "E3_sim_Pa": np.full(ROWS, MODULUS_PA),
        "E3_sd_Pa": deviation_Pa,
    }
    return Recording(channels)


def drawn(bench: BenchConfig, deviation_Pa: np.ndarray) -> Chart:
    (picture,) = (each for each in panels_of(bench.shape).pictures if each.name == "elasticity3")
    run = ShownRun(recorded(bench, deviation_Pa))
    assert "estimated" not in picture.words(run)
    (chart,) = picture.charts(run)
    return chart


def test_a_report_has_it_as_the_models_from_end_to_end(bench: BenchConfig) -> None:
    chart = drawn(bench, np.full(ROWS, inf))
    assert [curve.name for curve in chart.curves] == ["true", "of the model"]
    assert all(not np.any(np.isinf([band.low, band.high])) for band in chart.bands)


def test_a_report_says_from_when_on_it_is_estimated(bench: BenchConfig) -> None:
    deviation_Pa = np.where(np.arange(ROWS) < 500, inf, 1e8)
    _, estimated, of_the_model = drawn(bench, deviation_Pa).curves
    assert (estimated.name, of_the_model.name) == ("estimated", "of the model")
    for values, of_rows in ((estimated.values, slice(500, None)), (of_the_model.values, slice(500))):
        rows = np.zeros(ROWS, bool)
        rows[of_rows] = True
        assert np.array_equal(np.isfinite(values), rows)


def test_a_report_of_what_is_estimated_says_nothing_else(bench: BenchConfig) -> None:
    assert [curve.name for curve in drawn(bench, np.full(ROWS, 1e8)).curves] == ["true", "estimated"]


@pytest.mark.parametrize(("deviation_Pa", "heading"), [(inf, "E3 true / of the model"), (1e8, "E3 true / estimated")])
def test_the_terminal_says_which_it_is(bench: BenchConfig, deviation_Pa: float, heading: str) -> None:
    of_span = {"E3_true_Pa": MODULUS_PA, "E3_sim_Pa": MODULUS_PA, "E3_sd_Pa": deviation_Pa}
    sample = cast("CycleSample", SimpleNamespace(**of_span))
    (panel,) = (panel for panel in panels_of(bench.shape).panels if panel.name == "elasticity3")
    assert panel.text(sample, of_span) == (heading, "8700 / 8700 N/mm²")


def test_the_figures_of_its_steps_say_that_nothing_tells_it(bench: BenchConfig) -> None:
    for deviation_Pa, known in ((inf, False), (1e8, True)):
        judged = judge(recorded(bench, np.full(ROWS, deviation_Pa)).channels)
        assert (judged.metrics()["E3_final_error_pct"] is not None) is known
        assert ("that of its model" in judged.reason("E3_final_error_pct")) is not known


def test_the_monitor_says_so_while_it_is_so(bench: BenchConfig) -> None:
    picture, io = BusPicture(bench), Nodes(bench).io
    (quality,) = (
        pdo
        for pdo, content in zip(io.sent, io.data.sent, strict=True)
        if "E3_sd_Pa" in [signal.name for signal in content.signals]
    )
    (trend,) = (trend for trend in picture.trends if trend.signal == "E3_sim_Pa")
    for deviation_Pa, heading, of_the_model in ((inf, "E3 of the model", ["E3_sim_Pa"]), (1e8, "E3", [])):
        picture.take([Frame(quality.cob_id, quality.pack((deviation_Pa, 0.0)))])
        assert trend.heading == heading
        assert picture.as_data()["of_the_model"] == of_the_model


def test_the_page_has_a_curve_for_each(bench: BenchConfig) -> None:
    (panel,) = (panel for panel in live_panels(bench) if panel.name == "elasticity3")
    of_twin = [(each.name, each.estimated, each.deviation) for each in panel.series if each.signal == "E3_sim_Pa"]
    assert of_twin == [("estimated", True, "E3_sd_Pa"), ("of the model", False, "E3_sd_Pa")]
    rollers = load(SHIPPED / "line_two_spans.yaml")[0]
    (panel,) = (panel for panel in live_panels(rollers) if panel.name == "elasticity1")
    assert [each.name for each in panel.series] == ["true", "estimated"]
