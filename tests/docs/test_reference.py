"""The generated reference says what the code has, and equations come out without a script."""

from __future__ import annotations

from typing import Any

import pytest
from tools.docs_hook import on_page_content
from tools.reference import ROOT, pages, unit_of_key

from hilbench.plant.effects import EFFECTS, STATION_EFFECTS
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.metrics import all_metrics
from hilbench.topology.signals import signals_of, smallest_shapes


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return pages()


def rows(page: str) -> dict[str, list[str]]:
    """Rows of its tables by their first cell; of several the last."""
    cells = [line[2:-2].replace("\\|", "¦").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    return {row[0].strip("`"): row for row in cells}


def test_every_key_of_a_config_is_there_with_its_meaning(made: dict[str, str]) -> None:
    page = made["reference/config.md"]
    schema = ExperimentConfig.model_json_schema()
    blocks: list[dict[str, Any]] = [schema, *schema["$defs"].values()]
    keys = {key for block in blocks for key in block.get("properties", {})}
    assert keys <= rows(page).keys()
    without = [line for line in page.splitlines() if line.startswith("| `") and line.endswith("|  |")]
    assert without == []


def test_a_key_has_type_unit_and_default(made: dict[str, str]) -> None:
    found = rows(made["reference/config.md"])
    assert found["cycle_time_s"][1:4] == ["number ≥ 0.0005, ≤ 0.1", "s", "`0.002`"]
    assert found["mirroring"][1:4] == ["`listen` or `copy`", "", "`listen`"]
    assert found["width_m"][1:4] == ["number ≥ 0.001, ≤ 100 or list of number ≥ 0.001, ≤ 100", "m", "required"]
    assert found["speed_m_s"][3] == "`{warning: 8, trip: 10}`"


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("kp_Pa_per_Nm_s", "Pa/(N·m·s)"),
        ("velocity_kp_Nm_s_per_rad", "N·m·s/rad"),
        ("quick_stop_m_s2", "m/s²"),
        ("velocity_limit_m_s", "m/s"),
        ("drift_pct_per_sqrt_s", "%/√s"),
        ("jumps_per_s", "1/s"),
        ("inertia_kg_m2", "kg·m²"),
        ("virtual_tpdo_every", ""),
    ],
)
def test_the_unit_of_a_key_is_read_from_its_end(key: str, unit: str) -> None:
    assert unit_of_key(key) == unit


def test_effects_metrics_signals_and_objects_are_all_there(made: dict[str, str]) -> None:
    effects = made["reference/effects.md"]
    for effect in EFFECTS + STATION_EFFECTS:
        assert f"## {effect.id}" in effects
        assert {parameter.name for parameter in effect.parameters} <= rows(effects).keys()
    shift = effects.partition("## elasticity_shift")[2].partition("## ")[0]
    assert rows(shift)["relative_change"][2:5] == ["0", "-0.95", "10"]
    assert set(all_metrics()) <= rows(made["reference/metrics.md"]).keys()
    for kind, shape in smallest_shapes().items():
        assert {signal.name for signal in signals_of(kind, shape)} <= rows(made["reference/signals.md"]).keys()
    objects = rows(made["reference/objects.md"])
    assert objects["6041h"][1:5] == ["Statusword", "UNSIGNED16", "ro", "yes"]
    assert objects["1014h"][5] == "`$NODEID + 80h`"
    assert objects["1006h"][6] == "1e-06 s"


def test_every_command_is_there_with_its_options_and_examples(made: dict[str, str]) -> None:
    page = made["reference/commands.md"]
    for command in ("run CONFIG", "sdo write", "config new", "monitor", "estop"):
        assert f"## hilbench {command.split(' CONFIG')[0]}\n" in page
    assert "    hilbench run bench_configs/web_section_step.yaml --seed 7\n" in page
    assert rows(page)["--out <path>"]


def test_every_module_is_there_with_what_it_is(made: dict[str, str]) -> None:
    page = made["reference/packages.md"]
    assert "## apps.doctor\n" in page
    assert rows(page)["web_line.kernel"][1].endswith(".")
    modules = [path for path in (ROOT / "src" / "hilbench").rglob("*.py") if path.name[0] != "_"]
    assert sum(line.startswith("| `") for line in page.splitlines()) == len(modules)
    assert [line for line in page.splitlines() if line.startswith("| `") and line.endswith("|  |")] == []


def test_equations_become_mathml_and_code_stays_code() -> None:
    html = on_page_content(
        '<pre><code class="language-math">a &lt; \\frac{b}{2}\n</code></pre>'
        "<p>$<code>x^2</code>$ costs <code>5$</code></p>"
    )
    assert html.startswith('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">')
    assert "<mfrac>" in html
    assert "<msup>" in html
    assert html.endswith("costs <code>5$</code></p>")
