"""The drawing of a line: all that the web runs over is in it, in its order, with the tensions of the run."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from hilbench.apps.report.web_line_drawing import LineNotes, drawing, line_picture
from hilbench.plant.web_line.parameters import load_model
from hilbench.results.recording import Recording
from hilbench.runs.config import load_with_overrides
from hilbench.topology.signals import signals_of

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"


def texts(svg: str) -> list[str]:
    """In the order in which they are drawn."""
    return [str(each.text) for each in ET.fromstring(svg).iter() if each.tag.endswith("text")]


def places_of(svg: str, *words: str) -> list[int]:
    return [next(n for n, text in enumerate(texts(svg)) if word in text) for word in words]


@pytest.mark.parametrize("name", ["koc_2002", "giannoccaro_2016", "kuhm_2012"])
def test_published_lines_can_be_drawn(name: str) -> None:
    picture = drawing(load_model(CONFIGS / "published" / f"{name}.yaml"), LineNotes())
    assert ET.fromstring(picture.svg).tag.endswith("svg")


def test_reels_cells_and_traction_stand_in_the_direction_of_the_web() -> None:
    svg = drawing(load_model(CONFIGS / "published" / "koc_2002.yaml"), LineNotes()).svg
    found = places_of(svg, "unwinder 1", "cell1", "axis 2", "cell2", "rewinder 3")
    assert found == sorted(found)


def test_an_accumulator_says_how_many_strands_it_has_and_numbers_the_first_and_the_last() -> None:
    svg = drawing(load_model(CONFIGS / "published" / "kuhm_2012.yaml"), LineNotes(tensions_N={1: 290.0, 18: 300.4})).svg
    assert "store, 18 strands" in texts(svg)
    assert {"span 1", "290.0 N", "span 18", "300.4 N"} <= set(texts(svg))


def test_a_run_s_line_has_its_drives_by_name_and_its_tensions_beside_the_set_points() -> None:
    config = CONFIGS / "line_three_spans.yaml"
    bench = load_with_overrides(config).config
    t_s = np.arange(0.0, 10.0, 0.003)
    known = {"t_s": t_s, "v4_cmd_m_s": np.clip(t_s, 0.0, 2.0), "F2_true_N": np.full(len(t_s), 94.26)}
    known |= {"F2_ref_N": np.full(len(t_s), 95.0)}
    signals = signals_of("web_line", bench.shape)
    recording = Recording({each.name: known.get(each.name, np.zeros(len(t_s))) for each in signals})
    (picture,) = line_picture(config, recording)
    assert {"1 infeed", "2 print_1", "3 print_2", "4 outfeed", "94.3 N", "(set-point 95 N)"} <= set(texts(picture.svg))


def test_the_only_span_of_a_line_has_its_tension_beside_the_set_point() -> None:
    bench = load_with_overrides(CONFIGS / "web_section_step.yaml").config
    t_s = np.arange(0.0, 10.0, 0.002)
    known = {"t_s": t_s, "v2_cmd_m_s": np.clip(t_s, 0.0, 3.0), "F_true_N": np.full(len(t_s), 79.96)}
    known |= {"F_ref_N": np.full(len(t_s), 80.0)}
    channels = {each.name: known.get(each.name, np.zeros(len(t_s))) for each in signals_of("web_line", bench.shape)}
    (picture,) = line_picture(CONFIGS / "web_section_step.yaml", Recording(channels))
    assert {"1 axis1", "2 axis2", "span 1, 1 m", "80.0 N", "(set-point 80 N)"} <= set(texts(picture.svg))


def test_another_machine_and_a_config_that_is_not_understood_have_no_drawing(tmp_path: Path) -> None:
    t_s = np.arange(0.0, 1.0, 0.002)
    recording = Recording({"t_s": t_s})
    assert line_picture(CONFIGS / "servo_axis.yaml", recording) == []
    broken = tmp_path / "config.yaml"
    broken.write_text("name: [", encoding="utf-8")
    assert line_picture(broken, recording) == []
