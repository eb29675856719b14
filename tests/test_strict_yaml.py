"""Config files: what plain YAML lets through is refused, with file and line."""

from pathlib import Path
from typing import Literal, Self

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hilbench import strict_yaml
from hilbench.block import Strict
from hilbench.errors import UnusableInputError

CONFIGS = Path(__file__).resolve().parents[1] / "bench_configs"


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    gain: float


class Block(BaseModel):
    model_config = ConfigDict(extra="forbid")
    set_point_N: float = 80.0
    radius_m: float | list[float] = 0.2


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    items: list[Inner] = []
    control: Block | None = None
    by_name: dict[str, Inner] = {}


def write(folder: Path, text: str) -> Path:
    path = folder / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_numbers_without_a_dot_in_the_mantissa_are_numbers(tmp_path):
    data = strict_yaml.load(write(tmp_path, "a: 1e-3\nb: 8.7e9\nc: 65e-6\nd: -2\ne: .5\n")).data
    assert data == {"a": 1e-3, "b": 8.7e9, "c": 65e-6, "d": -2, "e": 0.5}
    assert isinstance(data["a"], float)


def test_a_leading_zero_means_nothing(tmp_path):
    assert strict_yaml.load(write(tmp_path, "a: 010\nb: 0089\nc: 0x1F\nd: 0o17\ne: -07\n")).data == {
        "a": 10,
        "b": 89,
        "c": 31,
        "d": 15,
        "e": -7,
    }


def test_words_of_yaml_1_1_stay_words(tmp_path):
    assert strict_yaml.load(write(tmp_path, "a: on\nb: no\nc: true\nd: 1:30\n")).data == {
        "a": "on",
        "b": "no",
        "c": True,
        "d": "1:30",
    }


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_float_as_python_writes_it_is_read_back(tmp_path_factory, value):
    path = write(tmp_path_factory.mktemp("float"), f"a: {value!r}\n")
    assert strict_yaml.load(path).data["a"] == value


def test_a_repeated_key_names_both_lines(tmp_path):
    with pytest.raises(UnusableInputError, match=r"config\.yaml:3: key 'a' is repeated, first given in line 1"):
        strict_yaml.load(write(tmp_path, "a: 1\nb: 2\na: 3\n"))


def test_a_repeated_key_deep_inside_is_seen(tmp_path):
    with pytest.raises(UnusableInputError, match=r"config\.yaml:4: key 'gain'"):
        strict_yaml.load(write(tmp_path, "name: x\nitems:\n  - gain: 1\n    gain: 2\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\nitems:\n  - gain: 1\n  - gian: 2\n", r"config\.yaml:4: .*gain.* is missing \(and 1 more\)"),
        ("name: x\nextra: 1\n", r"config\.yaml:2: unknown key 'extra'"),
        ("name: x\nitems:\n  - gain: fast\n", r"config\.yaml:3: 'items\.0\.gain' is 'fast', expected: .*number"),
        ("items: []\n", r"config\.yaml:1: 'name' is missing"),
    ],
)
def test_errors_name_line_key_found_and_expected(tmp_path, text, message):
    document = strict_yaml.load(write(tmp_path, text))
    with pytest.raises(UnusableInputError, match=message):
        strict_yaml.validate(document, Outer)


def test_all_that_is_wrong_is_said_in_the_order_of_its_lines(tmp_path):
    base = strict_yaml.load(write(tmp_path, "extra: 1\nitems:\n  - gain: 1\n  - gain: slow\nname: 3\n"))
    with pytest.raises(UnusableInputError) as caught:
        strict_yaml.validate(base.with_value(("control", "set_point_N"), "x", "--set"), Outer)
    said = [str(caught.value), *caught.value.__notes__]
    assert [line.partition(": ")[0].rpartition("/")[2] for line in said] == [
        "--set",
        "config.yaml:1",
        "config.yaml:4",
        "config.yaml:5",
    ]
    assert said[0].endswith("(and 3 more)")
    assert all(line.isprintable() for line in said)


def test_a_key_that_may_hold_two_kinds_of_value_is_one_error_that_names_both(tmp_path):
    document = strict_yaml.load(write(tmp_path, "name: x\ncontrol: {radius_m: wide}\n"))
    with pytest.raises(
        UnusableInputError, match=r"'control.radius_m' is 'wide', expected: .*number.*, or .*list"
    ) as caught:
        strict_yaml.validate(document, Outer)
    assert not hasattr(caught.value, "__notes__")


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("itms: []", "'items'"),
        ("control: {setpoint_N: 90}", "'control.set_point_N'"),
        ("control: {Set_Point_n: 90}", "'control.set_point_N'"),
        ("items: [{gain: 1, gian: 2}]", "'items.0.gain'"),
        ("by_name: {a: {gain: 1, gian: 2}}", "'by_name.a.gain'"),
        ("set_point_N: 90", "'control.set_point_N'"),  # at the wrong place
        ("zzz: 1", None),
    ],
)
def test_an_unknown_key_is_asked_about(tmp_path, text, meant):
    document = strict_yaml.load(write(tmp_path, f"name: x\n{text}\n"))
    with pytest.raises(UnusableInputError) as caught:
        strict_yaml.validate(document, Outer)
    assert str(caught.value).partition(", did you mean ")[2] == (f"{meant}?" if meant else "")


@pytest.mark.parametrize(
    "text",
    [
        "a: [1, 2\n",
        "a: b: c\n",
        "\ta: 1\n",
        "!!python/object/apply:os.system ['true']\n",
        "a: *nowhere\n",
        "\x00",
        "a: " + 5000 * "9",
        "a: " + 2000 * "[",
        100_000 * "[",
        100_000 * "- " + "a",
        "a: !!float x\n",
    ],
)
def test_broken_or_hostile_text_is_one_line(tmp_path, text):
    with pytest.raises(UnusableInputError) as caught:
        strict_yaml.load(write(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "config.yaml" in str(caught.value)


@pytest.mark.parametrize("text", ["\x00", "a\x07", "\udc80", "[1, 2", "*nowhere"])
def test_a_value_that_is_none_is_one_line_that_names_its_place(text):
    with pytest.raises(UnusableInputError, match=r"^--set: ") as caught:
        strict_yaml.parse_value(text, "--set")
    assert "\n" not in str(caught.value)


def keys_with_lines(document: strict_yaml.Document) -> list[tuple[str, int]]:
    """The last key of each value's location, and the line of its place."""
    return [
        (where[-1], int(place.rpartition(":")[2]))
        for where, place in document.places.items()
        if where and isinstance(where[-1], str)
    ]


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_each_key_of_a_shipped_config_stands_where_its_place_says(path):
    lines = path.read_text().splitlines()
    found = keys_with_lines(strict_yaml.load(path))
    assert found
    assert [key for key, line in found if f"{key}:" not in lines[line - 1]] == []


def test_the_error_of_a_file_says_what_was_found(tmp_path):
    with pytest.raises(UnusableInputError, match=r"config\.yaml:2: not valid YAML: .*'@'"):
        strict_yaml.load(write(tmp_path, "a: 1\nb: @x\n"))


def test_unreadable_file(tmp_path):
    with pytest.raises(UnusableInputError, match="cannot be read"):
        strict_yaml.load(tmp_path / "absent.yaml")


def test_a_value_given_by_an_option_is_named_by_it_and_a_merge_keeps_the_places(tmp_path):
    base = strict_yaml.load(write(tmp_path, "name: a\nitems:\n  - gain: 1\n  - gain: x\n"))
    (tmp_path / "top").mkdir()
    top = strict_yaml.load(write(tmp_path / "top", "name: b\n"))
    with pytest.raises(UnusableInputError, match=r"config.yaml:4: 'items.1.gain' is 'x'"):
        strict_yaml.validate(top.over(base), Outer)
    changed = top.over(base).with_value(("items", 1, "gain"), "y", "--set")
    with pytest.raises(UnusableInputError, match=r"--set: 'items.1.gain' is 'y'"):
        strict_yaml.validate(changed, Outer)
    assert strict_yaml.validate(changed.with_value(("items", 1, "gain"), 2, "--set"), Outer).items[1].gain == 2
    with pytest.raises(UnusableInputError, match="a position from 0 to 1"):
        changed.with_value(("items", 2, "gain"), 2, "--set")


class Limited(Strict):
    least: float = Field(default=1.0, ge=0.5)
    most: int = Field(default=1, lt=10)
    word: Literal["a", "b"] = "a"
    flag: bool = True
    text: str = "x"
    names: list[str] = Field(default=[], max_length=2)
    file: Path = Path()
    block: dict[str, float] = Field(default={})

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.most > 5 and self.word == "b":
            raise ValueError(f"word b with most {self.most}, expected 5 at most")
        return self


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("least: 0.1", "'least' is 0.1, expected: 0.5 or more"),
        ("least: x", "'least' is 'x', expected: a number"),
        ("most: 10", "'most' is 10, expected: less than 10"),
        ("most: 1.5", "'most' is 1.5, expected: a whole number"),
        ("word: c", "'word' is 'c', expected: 'a' or 'b'"),
        ("flag: 3", "'flag' is 3, expected: true or false"),
        ("text: [1]", "'text' is [1], expected: a text"),
        ("names: 1", "'names' is 1, expected: a list"),
        ("names: [a, b, c]", "'names' is ['a', 'b', 'c'], expected: 2 entries at most"),
        ("file: 1", "'file' is 1, expected: the name of a file"),
        ("block: 1", "'block' is 1, expected: a block of keys"),
        ("{least: 0.1, text: 1}", "'least' is 0.1, expected: 0.5 or more (and 1 more)"),
    ],
)
def test_what_was_expected_is_said_in_a_persons_words(tmp_path, text, said):
    document = strict_yaml.load(write(tmp_path, f"{text}\n"))
    with pytest.raises(UnusableInputError) as caught:
        strict_yaml.validate(document, Limited)
    assert caught.value.problem == said


def test_an_error_of_a_block_names_the_option_that_changed_something_in_it(tmp_path):
    document = strict_yaml.load(write(tmp_path, "most: 7\n"))
    changed = document.with_value(("word",), "b", "--set word=b")
    with pytest.raises(UnusableInputError) as caught:
        strict_yaml.validate(changed, Limited)
    assert str(caught.value) == (
        f"--set word=b in {tmp_path / 'config.yaml'}:1: word b with most 7, expected 5 at most"
    )
