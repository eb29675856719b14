"""Actions of cases by name, and the types of the arguments that `cases/*.yaml` gives them.

An action is a public function of the device under test in a module of cases: one exchange (`write`, `ask`, `nmt`), or
an examination that is no list of exchanges. A case names it alone, with its first argument (`nmt: START`), or with
several by their names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from enum import EnumType
from functools import cache
from inspect import Parameter, isfunction, signature
from types import ModuleType
from typing import Annotated, Any, Final, get_origin

from pydantic import BaseModel, BeforeValidator, create_model

from hilbench.block import Strict
from hilbench.canopen import object_store

#: Abort codes (CiA 301, table 22) by name; two that the simulated device never sends: the length does not match, in
#: either direction, and "sub-index can't be written, sub-index 0 must be 0 for write access".
ABORT_CODES: Final[Mapping[str, int]] = {
    **{name: code for name, code in vars(object_store).items() if name.isupper() and isinstance(code, int)},
    "WRONG_LENGTH": 0x06070010,
    "COUNT_NOT_ZERO": 0x06010003,
}
#: The same as digits of a frame, for patterns.
ABORT_DIGITS: Final = {name: code.to_bytes(4, "little").hex() for name, code in ABORT_CODES.items()}
_KEY: Final = re.compile(r"([0-9A-F]{4})h(?::(\d+))?")
#: Actions by name.
ACTIONS: Final[dict[str, Callable[..., object]]] = {}


def _key(given: object) -> tuple[int, int]:
    found = _KEY.fullmatch(str(given))
    if found is None:
        raise ValueError("expected an object as 1017h or 1016h:1")
    return int(found[1], 16), int(found[2] or 0)


#: Index and sub-index: "1017h", "1016h:1".
Key = Annotated[tuple[int, int], BeforeValidator(_key)]
AbortCode = Annotated[int, BeforeValidator(lambda name: ABORT_CODES.get(name, name))]
#: Data in hexadecimal digits.
Digits = Annotated[bytes, BeforeValidator(lambda digits: bytes.fromhex(str(digits)))]


def register(*modules: ModuleType) -> None:
    """Make the public functions of modules of cases actions."""
    for module in modules:
        made = (each for each in vars(module).values() if isfunction(each) and each.__module__ == module.__name__)
        ACTIONS.update({each.__name__: each for each in made if not each.__name__.startswith("_")})


@cache
def _arguments(name: str) -> type[BaseModel]:
    fields: dict[str, Any] = {}
    taken = signature(ACTIONS[name], eval_str=True).parameters.values()
    for each in [each for each in taken if each.kind is not Parameter.VAR_POSITIONAL][1:]:
        kind = each.annotation
        if isinstance(kind, EnumType):
            kind = Annotated[kind, BeforeValidator(lambda member, kind=kind: kind.__members__.get(member, member))]
        elif get_origin(kind) is Sequence:
            kind = Annotated[kind, BeforeValidator(lambda given: given if isinstance(given, list) else [given])]
        fields[each.name] = (kind, ... if each.default is Parameter.empty else each.default)
    return create_model(name, __base__=Strict, **fields)


def _bound(given: object) -> Callable[[object], object]:
    """An action with its arguments, as a case has it."""
    name, value = next(iter(given.items())) if isinstance(given, dict) and len(given) == 1 else (given, {})
    if not isinstance(name, str) or name not in ACTIONS:
        raise ValueError(f"expected an action, one of {', '.join(sorted(ACTIONS))}")
    model = _arguments(name)
    known = model.model_fields
    if not isinstance(value, dict) or not known.keys() >= value.keys():
        value = {next(iter(known), name): value}
    arguments = vars(model.model_validate(value))
    return lambda dut: ACTIONS[name](dut, **arguments)


#: An action with its arguments.
Action = Annotated[Callable[..., object], BeforeValidator(_bound)]
