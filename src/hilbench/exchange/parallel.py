"""Interface for doing the same to each node: one after the other, or in parallel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

Node = TypeVar("Node")
Answer = TypeVar("Answer")


class ForEachNode(Protocol):
    """Callable like `map` or `Executor.map`: results in node order; the first failure in this order is raised."""

    def __call__(self, do: Callable[[Node], Answer], nodes: Iterable[Node], /) -> Iterator[Answer]: ...
