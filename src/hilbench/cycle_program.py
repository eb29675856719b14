"""Compiled stages of a cycle, run one after the other for many cycles in one call.

Every stage is an entry point `function(argument, table) -> code` that Python can call by itself as well. As long
as each returns its regular code, a cycle needs no Python; where one returns another code Python does
its part of that stage, and the program continues after it. So a stage is defined once, for both modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.compiled import TABLE, Table, address_of, arrays_in, call_at, entry_point, record_type, records, table_of

Function = Callable[[int, Table], int]

#: Regular return code of a stage, unless another is given.
CONTINUE = 0
#: That of a stage which Python runs.
_HANDED_OVER = 1
#: A row of the program: address of the function (0: Python's), its argument, address and length of its table, its
#: regular return code.
_STAGE = record_type("function", "argument", "table", "rows", "continues", of=np.int64)
#: Its state: cycles to run, and the stage to begin with; cycles that were run whole; the stage that has returned
#: something else, and what; -1: none.
_STATE = record_type("cycles", "first", "done", "stopped", "code", of=np.int64)


class _Program(NamedTuple):
    stages: Annotated[Any, records(_STAGE)]
    state: Annotated[Any, _STATE]


class CompiledStage:
    """A compiled stage of a cycle: `function`, with `argument` and the table of `arrays`, which it keeps.

    `table`: that of the arrays, if there is one already.
    `fallback`: Python's part where it returns anything but `continues`; true if the next cycle may still follow
    without Python.
    """

    __slots__ = ("argument", "arrays", "continues", "fallback", "function", "table")

    def __init__(
        self,
        function: Function,
        argument: int,
        arrays: Sequence[Any],
        *,
        fallback: Callable[[int], bool],
        continues: int = CONTINUE,
        table: Table | None = None,
    ) -> None:
        self.function, self.argument, self.arrays = function, argument, arrays
        self.table = table_of(arrays) if table is None else table
        self.fallback, self.continues = fallback, continues

    def __call__(self) -> bool:
        """Run the stage alone; returns as `fallback`."""
        code = self.function(self.argument, self.table)
        return code == self.continues or self.fallback(code)


class StageAbortedError(Exception):
    """A stage could not finish; the interpreter resumes the cycle at this stage."""


def _hand_over(_: int, _table: Table) -> int:
    return _HANDED_OVER


def python_stage(work: Callable[[], object]) -> CompiledStage:
    """Stage that is all Python's. The next cycle may follow without it unless `work` returns False."""
    return CompiledStage(_hand_over, 0, (), fallback=lambda _: work() is not False)


def _address(function: Function) -> int:
    return 0 if function is _hand_over else address_of(function)


def never(code: int) -> bool:
    """Fallback of a stage without a part in Python."""
    raise AssertionError(f"a compiled piece of a cycle has returned {code}")


class CycleProgram:
    """Compiled stages in their order. If the table of one changes the program is to be made anew."""

    def __init__(self, pieces: Sequence[CompiledStage]) -> None:
        self._pieces = tuple(pieces)
        rows = [
            (_address(each.function), each.argument, each.table.ctypes.data, len(each.table), each.continues)
            for each in self._pieces
        ]
        self._state = np.zeros(1, _STATE)
        self._program = _Program(np.array(rows, _STAGE), self._state)
        self._table = table_of(self._program)
        self._at = self._state[0]
        self.stopped_at = -1  #: the stage whose part Python does, or has done last

    def run(self, cycles: int) -> int:
        """Run so many cycles, or fewer, where Python has the next one. Returns the number run. Fallbacks may raise;
        `done` and `stopped_at` show where."""
        at, pieces = self._at, self._pieces
        at["cycles"], at["first"], at["done"] = cycles, 0, 0
        while _run(self._table):
            stopped = self.stopped_at = int(at["stopped"])
            if not pieces[stopped].fallback(int(at["code"])):
                at["cycles"] = 1
            if stopped + 1 == len(pieces):
                at["done"] += 1
                at["cycles"] -= 1
                at["first"] = 0
            else:
                at["first"] = stopped + 1
        return self.done

    @property
    def done(self) -> int:
        """Cycles of the last `run` until now that were run whole."""
        return int(self._at["done"])


#: run(table of a `_Program`): true if a stage has returned to Python.
@entry_point(TABLE)
def _run(table: Table) -> bool:
    program = arrays_in(table, _Program)
    stages, state = program.stages, program.state
    first = state.first
    while state.cycles > 0:
        for k in range(first, len(stages)):
            stage = stages[k]
            code = _HANDED_OVER
            if stage.function != 0:
                code = call_at(stage.function, stage.argument, stage.table, stage.rows)
            if code != stage.continues:
                state.stopped, state.code = k, code
                return True
        first = 0
        state.done += 1
        state.cycles -= 1
    return False
