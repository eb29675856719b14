"""Compiled pieces of a cycle in a chain, and what Python does between them."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, arrays_in, entry_point, record_type
from hilbench.cycle_program import CompiledStage, CycleProgram, StageAbortedError, never


class Total(NamedTuple):
    total: Annotated[Any, record_type("sum", "bound")]


@entry_point(COUNT, TABLE)
def add(summand: int, table: NDArray[np.int64]) -> int:
    """One more in the sum; 1, and nothing done, where it is at its bound."""
    total = arrays_in(table, Total).total
    if total.sum == total.bound:
        return 1
    total.sum += summand
    return 0


class Sum:
    """A sum, and how often it has come to its bound."""

    def __init__(self, bound: float = np.inf) -> None:
        self.vector = np.array([0.0, bound])
        self.stops = 0
        self.continues = True

    def piece(self, summand: int) -> CompiledStage:
        return CompiledStage(add, summand, Total(self.vector), fallback=self._stopped)

    def _stopped(self, code: int) -> bool:
        assert code == 1
        self.stops += 1
        self.vector[0] += 0.5
        return self.continues


def test_pieces_run_in_their_order_in_each_cycle() -> None:
    one = Sum()
    chain = CycleProgram([one.piece(2), one.piece(3)])
    assert chain.run(10) == 10
    assert one.vector[0] == 50.0
    assert one.stops == 0


def test_a_piece_is_called_by_itself_as_well() -> None:
    one = Sum(bound=2.0)
    assert one.piece(2)()
    assert one.piece(2)()  # at its bound, which is Python's part
    assert one.vector[0] == 2.5
    assert one.stops == 1


def test_python_has_its_part_in_the_middle_of_a_cycle_and_the_chain_goes_on_behind_it() -> None:
    one, other = Sum(bound=4.0), Sum()
    chain = CycleProgram([other.piece(1), one.piece(2), other.piece(10)])
    assert chain.run(5) == 5
    assert one.stops == 1
    assert one.vector[0] == 2 * 4 + 0.5
    assert other.vector[0] == 55.0


def test_python_may_have_the_next_cycle() -> None:
    one, other = Sum(bound=4.0), Sum()
    one.continues = False
    assert CycleProgram([one.piece(2), other.piece(1)]).run(5) == 3
    assert other.vector[0] == 3.0, "the cycle itself is run to its end"
    assert CycleProgram([other.piece(1), one.piece(2)]).run(5) == 5


def test_what_python_raises_leaves_the_chain_where_it_was() -> None:
    one, before, behind = Sum(bound=2.0), Sum(), Sum()

    def leave(code: int) -> bool:
        raise StageAbortedError

    chain = CycleProgram([before.piece(1), CompiledStage(add, 2, Total(one.vector), fallback=leave), behind.piece(1)])
    with pytest.raises(StageAbortedError):
        chain.run(5)
    assert (chain.done, chain.stopped_at) == (1, 1)
    assert (before.vector[0], behind.vector[0]) == (2.0, 1.0)


def test_what_is_never_pythons_says_so() -> None:
    one = Sum(bound=0.0)
    with pytest.raises(AssertionError, match="has returned 1"):
        CycleProgram([CompiledStage(add, 1, Total(one.vector), fallback=never)]).run(1)
