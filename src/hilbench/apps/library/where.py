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

from hilbench.errors import UnusableInputError

#: None is what is not known.
Value = float | str | bool | tuple[str, ...] | None
_Evaluate = Callable[[Mapping[str, Any]], Value]

_LONGEST: Final = 500
_NUMBERS: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
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
    _evaluate: _Evaluate

    def holds(self, values: Mapping[str, Any]) -> bool:
        """Whether it is true of a run with these values; of a name that is not among them nothing is known.

        Raises UnusableInputError for a text that is compared with a number.
        """
        try:
            return self._evaluate(values) is True
        except (TypeError, OverflowError) as error:
            raise _unusable(self.text, " ".join(str(error).split())) from error


def parse_condition(text: str) -> Condition:
    """Raises UnusableInputError for what is no condition."""
    if len(text) > _LONGEST:
        raise _unusable(text[:40] + "…", f"{len(text)} characters, expected at most {_LONGEST}")
    names: set[str] = set()
    try:
        evaluate = _node(ast.parse(text.strip(), mode="eval").body, text, names)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        message = error.msg if isinstance(error, SyntaxError) else str(error)
        raise _unusable(text, f"is none ({' '.join(message.split())}), {_EXPECTED}") from error
    return Condition(text, frozenset(names), evaluate)


def _unusable(text: str, problem: str) -> UnusableInputError:
    return UnusableInputError(f"--where {text!r}", problem)


def _node(node: ast.expr, text: str, names: set[str]) -> _Evaluate:
    """How a part of a condition is evaluated. Raises UnusableInputError for one that has no place in it."""
    match node:
        case ast.Constant(value=bool() | int() | float() | str() | None as value):
            constant: Value = float(value) if isinstance(value, int) and not isinstance(value, bool) else value
            return lambda values: constant
        case ast.Name() | ast.Attribute():
            name = ast.unparse(node) if _is_dotted(node) else None
            if name is None:
                raise _unusable(text, f"'{ast.unparse(node)}', expected a name")
            names.add(name)
            return lambda values: values.get(name)
        case ast.BoolOp(op=op, values=parts):
            decisive = isinstance(op, ast.Or)
            each = [_node(part, text, names) for part in parts]
            return lambda values: _joined([part(values) for part in each], decisive)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            inner = _node(operand, text, names)
            return lambda values: None if (found := inner(values)) is None else not found
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            inner, factor = _node(operand, text, names), -1.0 if isinstance(sign, ast.USub) else 1.0
            return lambda values: None if (found := inner(values)) is None else factor * _number(found)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _NUMBERS:
            return _arithmetic(_NUMBERS[type(op)], _node(left, text, names), _node(right, text, names))
        case ast.Compare(left=left, ops=ops, comparators=others):
            if any(isinstance(op, ast.Is | ast.IsNot) for op in ops) and not _is_for_none(ops, others):
                raise _unusable(text, f"'is', expected 'is None' or 'is not None', {_EXPECTED}")
            return _comparison(ops, [_node(each, text, names) for each in (left, *others)])
        case ast.Call(func=ast.Name(id="abs"), args=[argument], keywords=[]):
            inner = _node(argument, text, names)
            return lambda values: None if (found := inner(values)) is None else abs(_number(found))
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            each = [_node(part, text, names) for part in parts]
            return lambda values: tuple(part(values) for part in each)  # type: ignore[misc]
    raise _unusable(text, f"'{ast.unparse(node)}' has no place in it, {_EXPECTED}")


def _is_dotted(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) or (isinstance(node, ast.Attribute) and _is_dotted(node.value))


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return value


def _joined(found: list[Value], decisive: bool) -> Value:
    """And, or (`decisive`: the value of one that settles it), with what is unknown."""
    for value in found:
        if value is not None and not isinstance(value, bool):
            raise TypeError(f"{value!r} is neither true nor false")
    if decisive in found:
        return decisive
    return None if None in found else not decisive


def _arithmetic(apply: Callable[[float, float], float], left: _Evaluate, right: _Evaluate) -> _Evaluate:
    def evaluate(values: Mapping[str, Any]) -> Value:
        a, b = left(values), right(values)
        if a is None or b is None or (apply is operator.truediv and b == 0.0):
            return None
        return apply(_number(a), _number(b))

    return evaluate


def _is_for_none(ops: list[ast.cmpop], others: list[ast.expr]) -> bool:
    return len(ops) == 1 and isinstance(others[0], ast.Constant) and others[0].value is None


def _comparison(ops: list[ast.cmpop], parts: list[_Evaluate]) -> _Evaluate:
    """One comparison after the other, as ``0.1 < x < 0.2``."""

    def evaluate(values: Mapping[str, Any]) -> Value:
        found = [part(values) for part in parts]
        if isinstance(ops[0], ast.Is | ast.IsNot):
            return (found[0] is None) == isinstance(ops[0], ast.Is)
        if None in found:
            return None
        return all(_ORDERS[type(op)](a, b) for op, a, b in zip(ops, found, found[1:], strict=False))

    return evaluate
