"""Machine code of a kernel for a shared library, from numba's own LLVM code: the same operations, in the same order.

Numba's optimized code is compiled once more for any processor of this kind (without newer vector units): IEEE
arithmetic gives the same bits, and `exp`, `sin` and `cos` are those of the C library in both.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hilbench.code_cache import made_of
from hilbench.plant.fmu.export.machine import Kernel

#: Arguments of a kernel: five vectors, a count, a time.
_VECTORS: Final = 5


@dataclass(frozen=True)
class ObjectCode:
    """Object file, and the name of the kernel in it (numba's calling convention)."""

    code: bytes
    symbol: str


def object_code(kernel: Kernel) -> ObjectCode:
    """Object code of a kernel; compiled once on a machine (up to a minute), then cached for the user."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hilbench"
    kept = folder / f"fmu-{kernel.name}-{made_of(kernel.function)}-{_versions()}.o"
    name = kept.with_suffix(".symbol")
    if kept.is_file() and name.is_file():
        return ObjectCode(kept.read_bytes(), name.read_text(encoding="ascii"))
    made = _compiled(kernel.function)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in ((name, made.symbol.encode("ascii")), (kept, made.code)):
            part = path.with_name(f"{path.name}.{os.getpid()}")
            part.write_bytes(content)
            part.replace(path)
    except OSError:
        pass  # not cached, the next export takes as long again
    return made


def _versions() -> str:
    import llvmlite
    import numba

    return f"{numba.__version__}-{llvmlite.__version__}"


def _compiled(function: Callable[..., None]) -> ObjectCode:
    import numba
    from llvmlite import binding
    from numba import types

    vector = types.float64[::1]
    signature = types.void(*[vector] * _VECTORS, types.int64, types.float64)
    njit: Any = numba.njit  # its stubs lack some of its options
    decorate = njit(signature, error_model="numpy", _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    dispatcher: Any = decorate(function)
    compiled = dispatcher.overloads[signature.args]
    module = binding.parse_assembly(compiled.library.get_llvm_str())
    triple = binding.get_process_triple()
    machine = binding.Target.from_triple(triple).create_target_machine(reloc="pic", codemodel="default", opt=3)
    return ObjectCode(machine.emit_object(module), compiled.fndesc.llvm_func_name)
