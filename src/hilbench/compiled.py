"""The decorator of compiled functions, typed as what it decorates."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

if TYPE_CHECKING:

    def compiled(function: Function) -> Function:
        """Compile on first use; called from compiled code, or from Python in tests."""
        return function

    def entry_point(function: Function) -> Function:
        """The same, machine code kept on disk, and other threads run meanwhile; called from Python."""
        return function

else:
    # Division as in numpy and C (no check for zero); no fastmath: equal results on every machine.
    compiled = numba.njit(error_model="numpy")
    entry_point = numba.njit(error_model="numpy", cache=True, nogil=True)
