"""Conditions on runs: read, checked and evaluated by a short list of what they may hold."""

from __future__ import annotations

import pytest

from hilbench.apps.library.query import parse_condition
from hilbench.errors import UnusableInputError

RUN = {"E": 0.25, "noise": 0.02, "bench": "web", "tags": ("golden", "old"), "load.web.width_m": 0.6, "result": "passed"}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("E > 0.2", True),
        ("E > 0.3", False),
        ("0.2 < E <= 0.25", True),
        ("not E > 0.3", True),
        ("E > 0.3 or noise < 0.03", True),
        ("E > 0.2 and noise > 0.03", False),
        ("abs(E - 0.24) < 0.02", True),
        ("E * 2 + 1 == 1.5", True),
        ("-E < 0", True),
        ("bench == 'web'", True),
        ("bench != 'web'", False),
        ("'golden' in tags", True),
        ("'golden' not in tags", False),
        ("result in ('passed', 'failed')", True),
        ("'we' in bench", True),
        ("load.web.width_m > 0.5", True),
        ("missing > 0.2", False),
        ("not missing > 0.2", False),  # it is not known
        ("missing > 0.2 or E > 0.2", True),
        ("missing is None", True),
        ("E is not None", True),
        ("E / 0 > 1", False),
    ],
)
def test_a_condition_is_true_of_a_run_or_not(text: str, found: bool) -> None:
    assert parse_condition(text).holds(RUN) is found


@pytest.mark.parametrize(
    "text",
    [
        "",
        "E >",
        "__import__('os').system('true')",
        "().__class__",
        "E.__class__()",
        "[x for x in tags]",
        "lambda: 1",
        "(a := 1)",
        "f'{E}'",
        "E[0]",
        "E ** 99999999",
        "open('x')",
        "abs(*tags)",
        "E is bench",
        "(" * 300 + "E" + ")" * 300,
        "not " * 100 + "(" * 90,
        "E > 1 or " * 100 + "E > 1",
        "b'x' == E",
    ],
)
def test_what_is_no_condition_is_told_in_one_line_and_never_executed(text: str) -> None:
    with pytest.raises(UnusableInputError) as caught:
        parse_condition(text)
    assert "\n" not in str(caught.value)
    assert "--where" in str(caught.value)


@pytest.mark.parametrize("text", ["bench > 3", "E and bench == 'web'", "E < 'x'", "-bench < 1", "3 in E"])
def test_texts_and_numbers_are_not_compared(text: str) -> None:
    with pytest.raises(UnusableInputError):
        parse_condition(text).holds(RUN)


def test_the_names_that_it_asks_for_are_known_before_any_run_is_read() -> None:
    assert parse_condition("load.web.width_m > 1 and 'a' in tags or abs(E) < noise").names == {
        "load.web.width_m",
        "tags",
        "E",
        "noise",
    }
