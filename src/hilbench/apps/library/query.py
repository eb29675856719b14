"""Query of runs: by name, bench, result, tag, time, and a condition on what is known of them."""

from __future__ import annotations

import ast
import operator
import re
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatchcase
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from hilbench.apps.library.index import STATES, RunEntry, read_entry, runs_in
from hilbench.apps.library.live_run import continues
from hilbench.did_you_mean import did_you_mean
from hilbench.errors import UnusableInputError, one_line
from hilbench.results.run_folder import RunFolder

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
    """A condition as one types it, ``E_time_to_1pct_s > 0.2 and 'golden' not in tags``, and the names that it uses:
    metrics, keys of configs, and what else is known of a run.

    Python's grammar is used for reading; what it may hold is a short list (comparisons, and, or, not, + - * /, abs,
    numbers, texts, names), and each of them is evaluated here. Nothing is ever executed. What a run does not have is
    unknown, as NULL is in SQL: a comparison with it is neither true nor false, and the run is not found; `is None` asks
    for that.
    """

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


_AGE: Final = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d|w)")
_SECONDS: Final = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}

#: What a condition may ask of a run, beside its metrics and the keys of its settings.
FIELDS: Final[dict[str, Callable[[RunEntry], Any]]] = {
    named: attrgetter(name)
    for name, field in RunEntry.model_fields.items()
    if (named := field.serialization_alias or name) not in ("report", "problem", "metrics", "settings", "verdicts")
} | {
    "name": lambda run: run.name,
    "began": lambda run: run.began,
    "fault": lambda run: run.fault or None,
    "notes": lambda run: "\n".join(run.notes),
}


@dataclass(frozen=True)
class Query:
    """Conditions on runs; None and empty: any. `name` and `bench` with * and ?; times since 1970, s."""

    name: str | None = None
    bench: str | None = None
    results: Sequence[str] = ()
    tags: Sequence[str] = ()
    since_s: float | None = None
    until_s: float | None = None
    where: Condition | None = None

    @classmethod
    def parse(
        cls, since: str | None = None, until: str | None = None, where: str | None = None, **as_typed: Any
    ) -> Query:
        """Parse a query as it is typed: its fields, `since` and `until` as a date or an age (``7d``); None: not given.
        Raises UnusableInputError."""
        for result in as_typed.get("results") or ():
            if result not in STATES:
                raise UnusableInputError("--result", f"'{result}', expected one of {', '.join(STATES)}")
        now_s = time.time()
        return cls(
            since_s=None if since is None else moment_s("--since", since, now_s),
            until_s=None if until is None else moment_s("--until", until, now_s),
            where=None if where is None else parse_condition(where),
            **{key: given for key, given in as_typed.items() if given is not None},
        )

    @property
    def asks(self) -> bool:
        """True if there is any condition."""
        return self != Query()

    def finds(self, run: RunEntry) -> bool:
        """True if a run meets the conditions."""
        return (
            (self.name is None or fnmatchcase(run.name, self.name) or fnmatchcase(run.path, self.name))
            and (self.bench is None or fnmatchcase(run.bench, self.bench))
            and (not self.results or run.state in self.results)
            and all(tag in run.tags for tag in self.tags)
            and (self.since_s is None or run.began_s >= self.since_s)
            and (self.until_s is None or run.began_s < self.until_s)
            and (self.where is None or self.where.holds(values_of(run, self.where.names)))
        )


def find_run(run: str, base: Path, announce: Callable[[str], None] = lambda text: None) -> RunFolder:
    """The folder of a run, by its path, or as `Library.find` has it. Raises UnusableInputError."""
    path = Path(run)
    if path.is_dir() or not base.is_dir():
        return RunFolder.open(path)
    return Library(base, announce).find(run)


def entry_of(folder: RunFolder) -> RunEntry:
    """Entry of one run, with all its metrics."""
    path = folder.path.resolve()
    return _as_it_is(path.parent, read_entry(path.parent, path.name))


def values_of(run: RunEntry, names: Collection[str]) -> dict[str, Any]:
    """Values of a run by these names."""
    known = {**run.settings, **{name: FIELDS[name](run) for name in FIELDS.keys() & {*names}}, **run.metrics}
    values = {name: known[name] for name in names if name in known}
    return {name: float(value) if type(value) is int else value for name, value in values.items()}


def seconds_of(place: str, text: str) -> float:
    """A time span such as ``90d``, ``12h``, ``30min``, s. Raises UnusableInputError."""
    found = _AGE.fullmatch(text.strip())
    if found is None:
        raise UnusableInputError(place, f"'{text}', expected a time such as 90d, 12h, 30min or 2w")
    return float(found[1]) * _SECONDS[found[2]]


def moment_s(place: str, text: str, now_s: float) -> float:
    """A date (``2026-11-01``, ``2026-11-01 14:30``, local time) or an age (``7d``), s since 1970."""
    if _AGE.fullmatch(text.strip()):
        return now_s - seconds_of(place, text)
    try:
        return datetime.fromisoformat(text.strip()).timestamp()
    except ValueError:
        raise UnusableInputError(place, f"'{text}', expected a date such as 2026-11-01, or an age such as 7d") from None


class Library:
    """The runs in a folder, through its index. `announce` gets a line when many folders are to be read."""

    def __init__(self, base: Path, announce: Callable[[str], None] = lambda text: None) -> None:
        if not base.is_dir():
            raise UnusableInputError(base, "no such folder, expected that in which the run folders are")
        self.base = base
        self._announce = announce

    def runs(self, query: Query | None = None, names: Iterable[str] = ()) -> list[RunEntry]:
        """Runs that meet the query, the newest first.

        Raises UnusableInputError for a name in the condition, or among those of values to be shown, that nothing has.
        """
        query = query or Query()
        runs = [_as_it_is(self.base, run) for run in runs_in(self.base, self._announce)]
        known = {*FIELDS, *(name for run in runs for name in (*run.metrics, *run.settings))}
        for name in sorted(query.where.names) if query.where is not None else ():
            if name not in known and runs:
                raise UnusableInputError(
                    "--where",
                    f"'{name}' is nothing that a run here has{did_you_mean(name, known) or ','} expected a metric, "
                    f"a key that was set, or one of {', '.join(FIELDS)}",
                )
        found = [run for run in runs if query.finds(run)]
        for name in names:
            if name not in known and found:
                raise UnusableInputError(
                    name, f"is nothing that a run here has, expected a metric or field{did_you_mean(name, known)}"
                )
        return found

    def find(self, run: str) -> RunFolder:
        """The folder of a run: its name in the library, or the only one that begins so; ``last``: the newest.

        Raises UnusableInputError for one that is not there.
        """
        path = self.base / run
        if (path / "config.yaml").is_file():
            return RunFolder.open(path)
        runs = runs_in(self.base, self._announce)
        if run == "last" and runs:
            return RunFolder.open(self.base / runs[0].path)
        meant = [each.path for each in runs if each.path.startswith(run) or each.name.startswith(run)]
        if len(meant) == 1:
            return RunFolder.open(self.base / meant[0])
        if meant:
            raise UnusableInputError(
                run, f"begins the names of {len(meant)} runs, expected one: {', '.join(meant[:3])}…"
            )
        known = did_you_mean(run, [each.path for each in runs])
        raise UnusableInputError(run, f"no run of that name in {self.base}, expected a run folder or its name{known}")


def _as_it_is(base: Path, run: RunEntry) -> RunEntry:
    """A run without a result either goes on or was cut off; no file of its folder says which."""
    if run.state != "unfinished" or not continues(RunFolder(base / run.path)):
        return run
    return run.model_copy(update={"state": "running"})
