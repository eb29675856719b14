"""The machine code that a run needs, compiled on all cores before it starts, saying how far that is.

Which functions a run of a kind calls is in needed_code.json, those that take longest first; `tools/needed_code.py`
writes it. What is not in it is compiled when it is called.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hilbench.code_cache import is_kept

if TYPE_CHECKING:
    from hilbench.topology.config import BenchConfig

#: A room that calls most of another one: the cycle of the twin is that of its estimator, and more.
_WITH = {"twin": "estimation"}
#: How often it is looked how much has been compiled, s.
_LOOK_EVERY_S = 1.0
#: Some take longer than others: so often it is said all the same how far it is, s.
_WORD_EVERY_S = 10.0
_LIST, _PACKAGE = Path(__file__).with_name("needed_code.json"), Path(__file__).resolve().parents[2]


class Function(NamedTuple):
    """An entry point of a module of hilbench."""

    module: str
    name: str

    @property
    def source(self) -> Path:
        """Its file."""
        return _PACKAGE.joinpath(*self.module.split(".")[1:]).with_suffix(".py")


def kind_of(config: BenchConfig) -> str:
    """Kind of needed_code.json: the machine's, with what else its runs compute."""
    kind, shape = config.machine.machine_kind, config.shape
    if shape.has_stations or shape.reels:
        return f"{kind} with stations"
    return f"{kind} of several axes" if shape.axes > 2 else kind


def needed(kind: str) -> list[Function]:
    """Compiled functions that a run of a kind calls, those that take longest first."""
    return [Function(module, name) for module, name in loads(_LIST.read_text(encoding="utf-8"))[kind]]


def missing(config: BenchConfig) -> list[Function]:
    """Functions that a run of this config calls and that have no machine code on disk; none where none could be kept:
    each process of the run compiles what it calls."""
    functions = needed(kind_of(config))
    kept = [is_kept(each.source, each.name) for each in functions]
    return [] if None in kept else [each for each, there in zip(functions, kept, strict=True) if not there]


def compile_on_all_cores(functions: list[Function], announce: Callable[[str, float], None]) -> None:
    """Compile and keep machine code; `announce`: how much has been done, and which share of all that is."""
    from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait  # most runs need none of it
    from multiprocessing import get_context

    from hilbench.apps.commands.compile import compile_functions, end_with_parent

    chains = _chains(functions)
    processes, kept = min(len(os.sched_getaffinity(0)), len(chains)), 0
    next_word_s = time.monotonic() + _WORD_EVERY_S
    announce(f"compiling {len(functions)} functions, once on this machine: a minute or two", 0.0)
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=end_with_parent) as pool:
        under_way = {pool.submit(compile_functions, chain) for chain in chains}
        while under_way:
            done, under_way = wait(under_way, _LOOK_EVERY_S, FIRST_EXCEPTION)
            for chain in done:
                chain.result()
            before, kept = kept, sum(is_kept(each.source, each.name) is True for each in functions)
            if kept > before or time.monotonic() >= next_word_s:
                next_word_s = time.monotonic() + _WORD_EVERY_S
                announce(f"compiled {kept} of {len(functions)}", kept / len(functions))
    if kept < len(functions):
        announce(f"{len(functions) - kept} could not be kept (is there no space?): they are compiled again", 1.0)


def _chains(functions: list[Function]) -> list[list[Function]]:
    """Functions for one process each, because they call the same functions, which a process compiles once:
    the functions of a room, small ones first; the room with most of them to compile comes first."""
    chains: dict[str, list[Function]] = {}
    for each in functions:
        room = each.module.split(".")[1]
        chains.setdefault(_WITH.get(room, room), []).insert(0, each)
    return list(chains.values())
