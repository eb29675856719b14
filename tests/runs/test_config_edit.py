"""A value is set in a config as in any text: comments and layout stay, and YAML reads what was meant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hilbench import strict_yaml
from hilbench.errors import UnusableInputError
from hilbench.runs.config_text import edited, write_value

TEXT = """\
# a stand
drives:                       # in the direction of the web
  axis1:                      # the first
    {node_id: 1, eds: a.eds}  # in one line
  axis2:
    node_id: 2                # the second
    eds: "b.eds"
    units:
      velocity_rad_s: 0.5     # measured
  axis3: {}
name: line
"""


@pytest.mark.parametrize(
    ("location", "value", "line"),
    [
        (("drives", "axis2", "node_id"), 7, "    node_id: 7                # the second"),
        (("drives", "axis2", "eds"), "c.eds", "    eds: c.eds"),
        (("drives", "axis1", "eds"), "c d.eds", "    {node_id: 1, eds: c d.eds}  # in one line"),
        (
            ("drives", "axis1", "parameters", "6085h"),
            200,
            "    {node_id: 1, eds: a.eds, parameters: {6085h: 200}}  # in one line",
        ),
        (("drives", "axis2", "units", "velocity_rad_s"), 1e-05, "      velocity_rad_s: 1e-05     # measured"),
        (("drives", "axis2", "units", "position_rad"), 0.25, "      position_rad: 0.25"),
        (("drives", "axis2", "parameters", "605Ah"), 2, "    parameters: {605Ah: 2}"),
        (("drives", "axis3", "node_id"), 3, "  axis3: {node_id: 3}"),
        (("stand",), "pilot: 1", "stand: 'pilot: 1'"),
    ],
)
def test_a_value_is_set_and_all_else_stays(location: tuple[str, ...], value: Any, line: str) -> None:
    after = edited(TEXT, location, value, "file")
    assert line in after.splitlines()
    kept = [each for each in TEXT.splitlines() if each not in after.splitlines()]
    assert len(kept) <= 1
    document = strict_yaml.Document(Path("file"), strict_yaml_data(TEXT), {})
    assert strict_yaml_data(after) == document.with_value(location, value, "here").data


def strict_yaml_data(text: str) -> Any:
    return strict_yaml.parse_value(text, "text")


def test_what_is_no_mapping_gets_no_key() -> None:
    with pytest.raises(UnusableInputError, match=r"file: 'name\.first' can't be set in it"):
        edited(TEXT, ("name", "first"), 1, "file")


def test_a_file_that_would_be_no_config_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "line.yaml"
    config = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
    path.write_text(f"include: {config}\nname: line\n")
    with pytest.raises(UnusableInputError, match="a text of the form"):
        write_value(path, ("name",), "no name at all")
    assert path.read_text() == f"include: {config}\nname: line\n"


KEYS = st.sampled_from(["a", "b", "60A9h", "units"])
VALUES = st.one_of(
    st.integers(-(2**31), 2**32), st.floats(allow_nan=False, allow_infinity=False), st.text("ab 1.#:,{}'-", max_size=8)
)
TREES = st.recursive(VALUES, lambda below: st.dictionaries(KEYS, below, max_size=3), max_leaves=8)


@given(
    st.dictionaries(KEYS, TREES, min_size=1, max_size=4),
    st.lists(KEYS, min_size=1, max_size=3),
    VALUES,
    st.sampled_from([True, False, None]),
)
def test_whatever_stood_there_reads_back_with_the_value(
    data: dict[str, Any], location: list[str], value: Any, flow: bool | None
) -> None:
    text = yaml.safe_dump(data, default_flow_style=flow, sort_keys=False)
    before = strict_yaml_data(text)
    try:
        after = strict_yaml_data(edited(text, location, value, "file"))
    except UnusableInputError:
        return
    assert after == strict_yaml.Document(Path("file"), before, {}).with_value(location, value, "here").data
