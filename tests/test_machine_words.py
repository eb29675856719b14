"""The code names no machine: the web line stands in modules of its own, and the rest says less and less of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.machine_words import elsewhere, found_in, is_its_own

#: As many as there are. It is lowered with what goes, not raised: a new machine is no reason to name an old one.
#: What belongs to one kind is a part of its description (`hilbench.machine_kinds`).
CEILING = 306


@pytest.mark.slow
def test_no_more_words_of_the_web_line_stand_where_they_do_not_belong() -> None:
    found = elsewhere()
    said = ", ".join(f"{path} {words.total()}" for path, words in found.items())
    assert sum(words.total() for words in found.values()) <= CEILING, said


def test_words_of_names_and_strings_count_comments_and_docstrings_do_not() -> None:
    source = '''"""A web."""
from hilbench.plant.web_line import span  # tension

def pull(axis1, F_simTension_N):
    """Of the span."""
    return f"no web at {axis1}: 'tension'", "websites", axis10, youngs_modulus
'''
    assert found_in(source) == {"web": 2, "span": 1, "axis1": 2, "tension": 2, "youngs": 1}


@pytest.mark.parametrize(
    ("path", "own"),
    [
        ("plant/web_line/kernel.py", True),
        ("bench/tasks/tension_cycle.py", True),
        ("bench/tasks/limits.py", False),
        ("apps/cli/website.py", False),
    ],
)
def test_a_module_of_the_web_line_says_so_in_its_path(path: str, own: bool) -> None:
    assert is_its_own(Path(path)) is own
