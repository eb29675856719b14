"""Base models of our files: keys are known; in a config or model file, numbers are checked, too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from math import isfinite
from typing import Any, Final, Self, get_args

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from hilbench.pydantic_messages import expected

#: No SI value of a bench is larger, or, except zero, smaller: values beyond break the arithmetic, not a bench.
LARGEST: Final = 1e13
LEAST: Final = 1e-15


class Strict(BaseModel):
    """Base of everything that is read from a file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class Block(Strict):
    """Base of blocks that a person writes: texts and truth values in place of a number are refused as well, and numbers
    beyond `LARGEST` or, except zero, below `LEAST` in size."""

    @model_validator(mode="wrap")
    @classmethod
    def _numbers_are_numbers(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        found = dict(_problems(cls, data)) if isinstance(data, Mapping) else {}
        if not found:
            return handler(data)
        errors: list[InitErrorDetails] = []
        try:
            handler(data)
        except ValidationError as error:  # a field's own message is more specific
            errors = [_error(each["type"], expected(each), each["loc"], each["input"]) for each in error.errors()]
        except ArithmeticError:  # as such numbers do it
            pass
        named = {each["loc"][0] for each in errors if each.get("loc")}
        errors += [_error("number", text, (key,), data[key]) for key, text in found.items() if key not in named]
        raise ValidationError.from_exception_data(cls.__name__, errors)


def problem_at(block: type[BaseModel], location: tuple[str, ...], text: str, found: object) -> ValidationError:
    """Error of a validator of a whole block about a value in it: `text` is what is expected."""
    return ValidationError.from_exception_data(block.__name__, [_error("fits", text, location, found)])


def _error(kind: str, text: str, location: tuple[int | str, ...], found: object) -> InitErrorDetails:
    return InitErrorDetails(type=PydanticCustomError(kind, text), loc=location, input=found)


def _problems(block: type[BaseModel], data: Mapping[Any, Any]) -> Iterator[tuple[str, str]]:
    for key, value in data.items():
        kinds = _kinds(block, key) if key in block.model_fields else frozenset()
        if float in kinds or int in kinds:
            for problem in filter(None, (_problem(leaf, kinds) for leaf in _leaves(value))):
                yield key, problem
                break


def _problem(leaf: object, kinds: frozenset[type]) -> str:
    if (isinstance(leaf, bool) and bool not in kinds) or (isinstance(leaf, str) and str not in kinds):
        return "a number"
    if isinstance(leaf, bool) or not isinstance(leaf, int | float):
        return ""
    if isinstance(leaf, float) and not isfinite(leaf):
        return "a finite number"
    # An integer is a count, an identifier or bits of an object, which its field bounds.
    if (float in kinds or isinstance(leaf, float)) and leaf and not LEAST <= abs(leaf) <= LARGEST:
        return f"a number of a size from {LEAST:g} to {LARGEST:g}, or 0"
    return ""


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


@cache
def _kinds(block: type[BaseModel], field: str) -> frozenset[type]:
    """Simple types that a field takes, also inside lists and unions; none for a nested block, which has its own."""
    found: set[type] = set()
    left: list[Any] = [block.model_fields[field].annotation]
    while left:
        kind = left.pop()
        inner = get_args(kind)
        if inner:
            left += inner
        elif isinstance(kind, str):
            found.add(str)  # a literal
        elif isinstance(kind, type):
            if issubclass(kind, BaseModel):
                return frozenset()
            found.add(kind)
    return frozenset(found)
