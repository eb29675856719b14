"""Compiled stages of a cycle, run one after the other for many cycles in one call.

Every stage is an entry point `function(argument, table) -> code` that Python can call by itself as well. As long
as each returns its regular code, a cycle needs no Python; where one returns another code Python does
its part of that stage, and the program continues after it. So a stage is defined once, for both modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, INDICES, TABLE, TABLE_WIDTH, address_of, call_at, entry_point

Table = NDArray[np.int64]
Function = Callable[[int, Table], int]

#: Regular return code of a stage, unless another is given.
CONTINUE = 0
#: Columns of the program's table: address of the function, its argument, address and length of its table, its
#: regular return code.
_FUNCTION, _ARGUMENT, _TABLE, _ROWS, _CONTINUE, _COLUMNS = range(6)
#: Its state: cycles to run, and the stage to begin with; cycles that were run whole; the stage that has returned
#: something else, and what; -1: none.
_CYCLES, _FIRST, _DONE, _STOPPED, _CODE, _STATE = range(6)


class CompiledStage:
    """A compiled stage of a cycle: `function`, with `argument` and a table of the vectors that `keeps` keeps.

    `fallback`: Python's part where it returns anything but `continues`; true if the next cycle may still follow
    without Python.
    """

    __slots__ = ("argument", "continues", "fallback", "function", "keeps", "table")

    def __init__(
        self,
        function: Function,
        argument: int,
        table: Table,
        *,
        fallback: Callable[[int], bool],
        continues: int = CONTINUE,
        keeps: object = None,
    ) -> None:
        self.function, self.argument, self.table = function, argument, table
        self.fallback, self.continues, self.keeps = fallback, continues, keeps

    def __call__(self) -> bool:
        """Run the stage alone; returns as `fallback`."""
        code = self.function(self.argument, self.table)
        return code == self.continues or self.fallback(code)


class StageAbortedError(Exception):
    """A stage could not finish; the interpreter resumes the cycle at this stage."""


def never(code: int) -> bool:
    """Fallback of a stage without a part in Python."""
    raise AssertionError(f"a compiled piece of a cycle has returned {code}")


class CycleProgram:
    """Compiled stages in their order. If the table of one changes the program is to be made anew."""

    def __init__(self, pieces: Sequence[CompiledStage]) -> None:
        self._pieces = tuple(pieces)
        rows = [
            (address_of(each.function), each.argument, each.table.ctypes.data, len(each.table), each.continues)
            for each in self._pieces
        ]
        self._rows = np.array(rows, np.int64).reshape(-1, _COLUMNS)
        self._state = np.zeros(_STATE, np.int64)
        self._at = self._state.data
        self.stopped_at = -1  #: the stage whose part Python does, or has done last

    def run(self, cycles: int) -> int:
        """Run so many cycles, or fewer, where Python has the next one. Returns the number run. Fallbacks may raise;
        `done` and `stopped_at` show where."""
        at, pieces = self._at, self._pieces
        at[_CYCLES], at[_FIRST], at[_DONE] = cycles, 0, 0
        while _run(self._rows, self._state):
            stopped = self.stopped_at = at[_STOPPED]
            if not pieces[stopped].fallback(at[_CODE]):
                at[_CYCLES] = 1
            if stopped + 1 == len(pieces):
                at[_DONE] += 1
                at[_CYCLES] -= 1
                at[_FIRST] = 0
            else:
                at[_FIRST] = stopped + 1
        return self.done

    @property
    def done(self) -> int:
        """Cycles of the last `run` until now that were run whole."""
        return int(self._at[_DONE])


def _entry_point() -> Callable[[Table, NDArray[np.int64]], bool]:
    """Make the entry point that Python calls."""

    @entry_point(TABLE, INDICES)
    def run(pieces: Table, state: NDArray[np.int64]) -> bool:
        first = state[_FIRST]
        while state[_CYCLES] > 0:
            for k in range(first, len(pieces)):
                row = pieces[k]
                code = call_at(row[_FUNCTION], row[_ARGUMENT], row[_TABLE], row[_ROWS])
                if code != row[_CONTINUE]:
                    state[_STOPPED], state[_CODE] = k, code
                    return True
            first = 0
            state[_DONE] += 1
            state[_CYCLES] -= 1
        return False

    return run


#: run(the program's table, its state): true if a stage has returned to Python.
_run = _entry_point()


def _handing_over() -> Function:
    """Make the stage that returns to Python."""

    @entry_point(COUNT, TABLE)
    def hand_over(code: int, _: Table) -> int:
        return code

    return hand_over


_hand_over = _handing_over()


def python_stage(act: Callable[[], bool]) -> CompiledStage:
    """Stage that Python runs in each cycle; returns as `fallback` of `CompiledStage`."""
    table = np.zeros((0, TABLE_WIDTH), np.int64)
    return CompiledStage(_hand_over, CONTINUE + 1, table, fallback=lambda _: act(), keeps=table)
