"""Scenario tables and Python experiments: what is refused, and the shipped one as a user runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.errors import UnusableInputError
from hilbench.runs.scenario import Expectation, read_scenario
from hilbench.runs.steps import load_experiment

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,line_sped\n0,1\n1,2\n", r"table.csv:2: column 'line_sped', expected one of line_speed_m_s"),
        ("t_s,line_speed_m_s\n0,fast\n1,2\n", r"table.csv:2: line_speed_m_s is 'fast', expected a number"),
        ("t_s,line_speed_m_s\n1,1\n0.5,2\n", r"table.csv:3: t_s is 0.5, expected no earlier"),
        ("t_s,expect:F_N\n0,1;2\n1,\n", r"table.csv:2: column 'expect:F_N', expected a signal"),
        ("t_s,expect:F_sim_N\n0,2;1\n1,\n", r"table.csv:2: expect:F_sim_N is '2;1', expected low up to high"),
        ("t_s,expect:F_sim_N\n0,1;2;3\n1,\n", r"table.csv:2: .*'1;2;3', expected .* a delay before 1 s"),
        ("t_s,line_speed_m_s\n0,1\n", r"table.csv: 1 row\(s\), expected at least two"),
        ("t_s,line_speed_m_s\n0,1,2\n1\n", r"table.csv:2: 3 cells, expected 2"),
    ],
)
def test_a_table_that_cannot_be_run_is_named_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(UnusableInputError, match=said):
        read_scenario(tmp_path / "table.csv")


def test_yaml_and_csv_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,ramp:line_speed_m_s,expect:F_sim_N\n0,0,\n1,2,;85;0.5\n2,,-\n3,2,\n")
    rows = '- {t_s: 0, "ramp:line_speed_m_s": 0}\n- {t_s: 1, "ramp:line_speed_m_s": 2, "expect:F_sim_N": ";85;0.5"}\n'
    (tmp_path / "a.yaml").write_text(rows + '- {t_s: 2, "expect:F_sim_N": "-"}\n- {t_s: 3, "ramp:line_speed_m_s": 2}\n')
    table = read_scenario(tmp_path / "a.csv")
    assert table == read_scenario(tmp_path / "a.yaml")
    assert table.expectations == [Expectation("F_sim_N", float("-inf"), 85.0, 1.5, 2.0)]
    assert table.ramps == {"line_speed_m_s": [(0.0, 0.0), (1.0, 2.0), (3.0, 2.0)]}


def test_a_python_file_without_the_function_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"scenario.py: no function 'creep_up'"):
        load_experiment(SHIPPED / "scenario.py", "creep_up")
    (tmp_path / "bad.py").write_text("x = 1\ny = x / 0\n")
    with pytest.raises(UnusableInputError, match=r"bad.py:2: ZeroDivisionError"):
        load_experiment(tmp_path / "bad.py", "experiment")
