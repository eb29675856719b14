"""Conditions on runs as one types them: ``E_time_to_1pct_s > 0.2 and 'golden' not in tags``.

Python's grammar is used for reading; what it may hold is a short list (comparisons, and, or, not, + - * /, abs,
numbers, texts, names), and each of them is evaluated here. Nothing is ever executed. What a run does not have is
unknown, as NULL is in SQL: a comparison with it is neither true nor false, and the run is not found; `is None` asks for
that.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from hilbench.errors import UnusableInputError, one_line

_LONGEST: Final = 500
_NUMBERS: Final[dict[type[ast.AST], Callable[..., float | None]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: lambda a, b: a / b if b else None,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_ORDERS: Final[dict[type[ast.cmpop], Callable[[Any, Any], bool]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.In: lambda item, among: item in among,
    ast.NotIn: lambda item, among: item not in among,
}
_EXPECTED: Final = "expected a condition such as E_time_to_1pct_s > 0.2 and bench == 'servo_axis'"


@dataclass(frozen=True)
class Condition:
    """A condition, and the names that it uses: metrics, keys of configs, and what else is known of a run."""

    text: str
    names: frozenset[str]
    _tree: ast.expr

    def holds(self, values: Mapping[str, Any]) -> bool:
        """True if it holds for a run with these values; of a name that is not among them nothing is known.

        Raises UnusableInputError for a text that is compared with a number.
        """
        try:
            return _value(self._tree, values.get) is True
        except (TypeError, OverflowError) as error:
            raise _unusable(self.text, one_line(error)) from error


def parse_condition(text: str) -> Condition:
    """Raises UnusableInputError for what is no condition."""
    if len(text) > _LONGEST:
        raise _unusable(text[:40] + "…", f"{len(text)} characters, expected at most {_LONGEST}")
    names: set[str] = set()
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        _value(tree, names.add)  # of what nothing is known: each part of it is looked at
    except (SyntaxError, ValueError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        message = error.msg if isinstance(error, SyntaxError) else str(error)
        raise _unusable(text, f"is none ({' '.join(message.split())}), {_EXPECTED}") from error
    return Condition(text, frozenset(names), tree)


def _unusable(text: str, problem: str) -> UnusableInputError:
    return UnusableInputError(f"--where {text!r}", problem)


def _value(node: ast.expr, known: Callable[[str], Any]) -> Any:
    """Value of a part of a condition; None is what is not known. Raises ValueError for one that has no place in it,
    TypeError for one that is of another kind than it should be."""
    match node:
        case ast.Constant(value=bool() | int() | float() | str() | None):
            return node.value
        case ast.Name() | ast.Attribute() if all(part.isidentifier() for part in ast.unparse(node).split(".")):
            return known(ast.unparse(node))
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return tuple(_value(part, known) for part in parts)
        case ast.BoolOp(op=op, values=parts):
            return _joined([_value(part, known) for part in parts], decisive=isinstance(op, ast.Or))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return None if (found := _value(operand, known)) is None else not found
        case ast.Compare(left=left, ops=[ast.Is() | ast.IsNot() as op], comparators=[ast.Constant(value=None)]):
            return (_value(left, known) is None) == isinstance(op, ast.Is)
        case ast.Compare(left=left, ops=ops, comparators=others):
            if not all(type(op) in _ORDERS for op in ops):
                raise ValueError("'is', expected 'is None' or 'is not None'")
            compared = [_value(part, known) for part in (left, *others)]
            if None in compared:
                return None
            return all(_ORDERS[type(op)](a, b) for op, a, b in zip(ops, compared, compared[1:], strict=False))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _NUMBERS:
            return _of_numbers(_NUMBERS[type(op)], _value(operand, known))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _NUMBERS:
            return _of_numbers(_NUMBERS[type(op)], _value(left, known), _value(right, known))
        case ast.Call(func=ast.Name(id="abs"), args=[argument], keywords=[]):
            return _of_numbers(abs, _value(argument, known))
    raise ValueError(f"'{ast.unparse(node)}' has no place in it")


def _joined(found: list[Any], decisive: bool) -> bool | None:
    """And, or (`decisive`: the value of one that settles it), with what is unknown."""
    for value in found:
        if value is not None and not isinstance(value, bool):
            raise TypeError(f"{value!r} is neither true nor false")
    if decisive in found:
        return decisive
    return None if None in found else not decisive


def _of_numbers(apply: Callable[..., float | None], *values: Any) -> float | None:
    for value in values:
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise TypeError(f"{value!r} is no number")
    return None if None in values else apply(*values)
