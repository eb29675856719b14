"""The decorators of compiled functions, typed as what they decorate."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numba
from numba import types
from numba.extending import intrinsic

Function = TypeVar("Function", bound=Callable[..., object])

if TYPE_CHECKING:

    def compiled(function: Function) -> Function:
        """Compile on first use; called from compiled code, or from Python in tests."""
        return function

    def inlined(function: Function) -> Function:
        """The same, put into the machine code of its callers: for what is called several times in every step."""
        return function

    def merged(function: Function) -> Function:
        """The same for long functions with one or two callers: never compiled by themselves."""
        return function

    def kept_apart() -> None:
        """In the body of a compiled function that is called rarely: it stays a call, its callers stay short."""

    def entry_point(function: Function) -> Function:
        """The same, machine code kept on disk, and other threads run meanwhile; called from Python."""
        return function

else:
    # Division as in numpy and C (no check for zero); no fastmath: equal results on every machine.
    compiled = numba.njit(error_model="numpy", forceinline=False, _nrt=False)
    inlined = numba.njit(error_model="numpy", forceinline=True, _nrt=False)
    merged = numba.njit(error_model="numpy", inline="always", _nrt=False)

    @intrinsic
    def kept_apart(typing_context):
        def generate(context, builder, signature, arguments):
            builder.function.attributes.add("noinline")
            return context.get_dummy_value()

        return types.void(), generate

    entry_point = numba.njit(error_model="numpy", cache=True, nogil=True)


def number_of_sources(*files: str) -> int:
    """A number that changes with the content of these source files.

    numba keeps machine code by the file of the function alone, and would run old code after a change of what it calls;
    what a closure holds is part of its key, so an entry point that calls other files' functions holds this number.
    """
    text = b"".join(Path(name).read_bytes() for name in files)
    return int.from_bytes(sha256(text).digest()[:7], "big")
