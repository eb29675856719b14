"""How the same is done to each node: one after the other, or beside each other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

Node = TypeVar("Node")
Answer = TypeVar("Answer")


class ForEachNode(Protocol):
    """As `map`, and as `Executor.map`: results in the order of the nodes; the first failure in this order is raised."""

    def __call__(self, do: Callable[[Node], Answer], nodes: Iterable[Node], /) -> Iterator[Answer]: ...
