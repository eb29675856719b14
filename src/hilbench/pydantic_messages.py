"""Readable text of the expected value in pydantic's errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic_core import ErrorDetails

#: Texts by the type of an error, with its limit.
_WORDS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("list_type", "tuple_type", "frozen_set_type", "set_type"), "a list"),
    **dict.fromkeys(("dict_type", "mapping_type", "model_type", "model_attributes_type"), "a block of keys"),
    **dict.fromkeys(("literal_error", "enum"), "{expected}"),
    "finite_number": "a finite number",
    "greater_than": "more than {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "less than {lt}",
    "less_than_equal": "{le} at most",
    "multiple_of": "a multiple of {multiple_of}",
    "path_type": "the name of a file",
    "path_not_file": "a file that is there",
    "string_type": "a text",
    "string_too_short": "a text of {min_length} or more characters",
    "string_too_long": "a text of {max_length} characters at most",
    "string_pattern_mismatch": "a text of the form {pattern}",
    "too_short": "{min_length} or more entries",
    "too_long": "{max_length} entries at most",
}


def expected(details: ErrorDetails) -> str:
    """Expected value, in one line; the message of a validator of ours as it is."""
    limits = {name: _number(value) for name, value in details.get("ctx", {}).items()}
    try:
        return _WORDS[details["type"]].format(**limits)
    except KeyError:  # of ours, or already a text of this function
        message = details["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
        return " ".join(message.removeprefix("Input should be ").split())


def _number(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value
