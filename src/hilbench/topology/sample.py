"""One cycle of a running bench, as the bench, its observers and conditions see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, make_dataclass
from functools import cache
from typing import TYPE_CHECKING, cast

from hilbench.topology.signal_kinds import Signal


class CycleSample:
    """The signals of a bench (`BenchConfig.signals`: units and meaning there), and the number of the cycle.

    Every bench has a class of its own, with its signals as attributes (`sample_type`).
    """

    __slots__ = ()

    if TYPE_CHECKING:
        cycle: int
        t_s: float
        twin_age_cycles: int
        twin_status: int
        loop_closed: int
        bus_bits: int

        def __init__(self, **values: float) -> None: ...
        def __getattr__(self, name: str) -> float: ...
        def __setattr__(self, name: str, value: float) -> None: ...


def sample_type(signals: Sequence[Signal]) -> type[CycleSample]:
    """The class of a bench's samples: every signal an attribute, zero at first."""
    return _sample_type(tuple((signal.name, signal.integer) for signal in signals))


@cache
def _sample_type(signals: tuple[tuple[str, bool], ...]) -> type[CycleSample]:
    named = (("cycle", True), *signals)
    fields = [(name, int if whole else float, field(default=0 if whole else 0.0)) for name, whole in named]
    made = make_dataclass("CycleSample", fields, bases=(CycleSample,), slots=True)
    return cast("type[CycleSample]", made)
