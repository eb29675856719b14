"""The decorators of compiled functions, typed as what they decorate."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numba
from numba import types
from numba.extending import intrinsic

from hilbench.hidden import hidden

# On the first call numba imports scipy.linalg, to see whether products of matrices can be compiled; that takes longer
# than to load the machine code, in each process of a bench. They can: scipy is installed, and imported where one is.
with hidden("scipy.linalg"):
    from numba.np import arraymath
arraymath._HAVE_BLAS = True

Function = TypeVar("Function", bound=Callable[..., object])

if TYPE_CHECKING:

    def compiled(function: Function) -> Function:
        """Compile on first use; called from compiled code, or from Python in tests. It can't allocate."""
        return function

    def inlined(function: Function) -> Function:
        """The same, always put into the machine code of its callers: for short functions called in every step."""
        return function

    def merged(function: Function) -> Function:
        """The same for a long function with one caller or two: it is not compiled by itself as well."""
        return function

    def noinline() -> None:
        """In the body of a compiled function that is called rarely: it stays a call, and its callers stay short."""

    def entry_point(function: Function) -> Function:
        """Called from Python: machine code kept on disk, and other threads run meanwhile. It may allocate."""
        return function

else:
    # Division as in numpy and C (no check for zero); no fastmath: equal results on every machine.
    # Without NRT, numba's runtime, there are no reference counts: with them a step of the model takes ten times as
    # long, because numba counts an array at every call. What allocates does not compile then.
    # A callee would take over its caller's `forceinline` unless it says otherwise.
    compiled = numba.njit(error_model="numpy", _nrt=False, forceinline=False)
    inlined = numba.njit(error_model="numpy", _nrt=False, forceinline=True)
    merged = numba.njit(error_model="numpy", _nrt=False, inline="always")
    entry_point = numba.njit(error_model="numpy", cache=True, nogil=True)

    @intrinsic
    def noinline(typing_context):
        def generate(context, builder, signature, arguments):
            builder.function.attributes.add("noinline")
            return context.get_dummy_value()

        return types.void(), generate


def number_of_sources(*files: str) -> int:
    """A number that changes with the content of these source files.

    numba keeps machine code by the file of the function alone, and would run old code after a change of what it calls;
    what a closure holds is part of its key, so an entry point that calls other files' functions holds this number.
    """
    text = b"".join(Path(name).read_bytes() for name in files)
    return int.from_bytes(sha256(text).digest()[:7], "big")
