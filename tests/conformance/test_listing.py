"""What a file of cases may hold: actions that there are, with the arguments that they take."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.apps.conformance.listing import Group
from hilbench.errors import UnusableInputError
from hilbench.strict_yaml import load, validate

CASE = "SDO:\n  cases:\n    1:\n      title: a case\n      clause: none\n      do: [{}]\n"


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ("raed", "expected an action, one of "),
        ("{read: {key: 1000, expected: x}}", "expected an object as 1017h or 1016h:1"),
        ("{nmt: RUN}", "RUN"),
        ("{forget: 1}", "unknown key .*forget"),
        ("{set_up: {kind: 1, inhibition: 2}}", "inhibition"),
    ],
)
def test_a_step_that_cannot_be_done_is_refused_with_its_place(tmp_path: Path, step: str, problem: str) -> None:
    file = tmp_path / "cases.yaml"
    file.write_text(CASE.replace("{}", step))
    with pytest.raises(UnusableInputError, match=problem) as refused:
        validate(load(file), Group, ("SDO",))
    assert str(refused.value).startswith(f"{file}:")
