"""Machine code of compiled functions on disk: numba's cache, with a key of all that a function is made of.

numba's key is the file of the function alone: it would run old code after a change of a callee, or of a constant
that is compiled in. Here the key has the bytecode of the function and of each compiled function that it calls, and the
values of all that they name.

It is machine code for every processor of its architecture (x86-64, say), not for this one alone: what is compiled on
one machine runs on all, and a wheel can hold it. The results are the same bits, the step of a web line takes as long.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple, get_type_hints

import numba
import numpy as np
from numba import config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, InTreeCacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.runtime.nrt import rtsys

os.environ.setdefault("NUMBA_CPU_NAME", "generic")  # of child processes, too
config.reload_config()

#: Modules whose functions numba knows by their names, or that only name types; its own version is in each key.
_NOT_OURS = ("math", "numpy", "numba", "typing")


class _Nowhere(InTreeCacheLocator):
    """The package's own folder, where neither it nor the user's can be written: hilbench can still be used."""

    def ensure_cache_path(self) -> None:
        pass


class _Places(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _Nowhere]  # noqa: RUF012  # as numba has it


class CodeCache(FunctionCache):
    """Machine code on disk; where the package's folder can't be written, code compiled there when hilbench was
    installed is read in addition."""

    _impl_class = _Places

    def __init__(self, function: Callable[..., object], options: str) -> None:
        """`options`: options of its compilation."""
        super().__init__(function)
        self._options = options
        folders = _folders(self.cache_path, Path(function.__code__.co_filename))
        stamp = self._impl.locator.get_source_stamp()
        self._files = [IndexDataCacheFile(folder, self._impl.filename_base, stamp) for folder in folders]

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The machine code, None where it is not on disk. What numba compiles with it loads when it does: before any
        function is loaded, as numba does it, that takes longer than the function."""
        rtsys.initialize(target)
        key = self._index_key(signature, target.codegen())
        data = next((data for file in self._files if (data := file.load(key)) is not None), None)
        return None if data is None else self._impl.rebuild(target, data)

    def _save_overload(self, signature: Any, data: Any) -> None:
        if not isinstance(self._impl.locator, _Nowhere):
            with suppress(
                OSError
            ):  # no space: what was compiled is used all the same, and compiled again the next time
                super()._save_overload(signature, data)

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        return (*super()._index_key(signature, codegen)[:2], self._options, made_of(self._py_func))


def is_kept(source: Path, name: str) -> bool | None:
    """Whether there is machine code of a function of this source file as it is now, by this numba; None: there is not,
    and nowhere to keep it. Imports and loads nothing; what the function calls in other files is not looked at."""
    place = _place_of(source)
    stamp, version = place.get_source_stamp(), numba.__version__.encode()
    index = f"{source.stem}.{name}-*.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    for folder in _folders(place.get_cache_path(), source):
        for text in map(Path.read_bytes, Path(folder).glob(index)):
            if stamp in text and version in text:
                return True
    return None if isinstance(place, _Nowhere) else False


def _folders(kept: str, source: Path) -> list[str]:
    """Where machine code of a source file is looked for: where it is kept, and beside the file, unless a folder was
    asked for."""
    installed = str(source.parent / "__pycache__")
    return [kept] if os.environ.get("NUMBA_CACHE_DIR") else list(dict.fromkeys((kept, installed)))


def _place_of(source: Path) -> Any:
    """Where numba keeps what is compiled of a source file."""
    locators: list[Any] = _Places._locator_classes
    found = (each.from_function(_place_of, str(source)) for each in locators)
    return next(place for place in found if place is not None)


def made_of(function: Callable[..., object]) -> str:
    """A number of all that the machine code of a function depends on. Raises TypeError for a value that it names of
    which that is not known."""
    reached, ahead = {function: None}, [function]
    while ahead:
        for callee in _parts(ahead.pop()).callees:
            if callee not in reached:
                reached[callee] = None
                ahead.append(callee)
    return sha256("".join(_parts(each).digest for each in reached).encode()).hexdigest()


class _Parts(NamedTuple):
    """Parts of a function: a digest of its own, and the functions that it calls."""

    digest: str
    callees: tuple[FunctionType, ...]


@cache
def _parts(function: Any) -> _Parts:
    code, cells = function.__code__, [cell.cell_contents for cell in function.__closure__ or ()]
    named = function.__globals__ | dict(zip(code.co_freevars, cells, strict=True))
    own, callees = [f"{function.__module__}.{function.__qualname__}"], list[FunctionType]()
    for part in _parts_of_code(code, named):
        (own if isinstance(part, str) else callees).append(part)  # type: ignore[arg-type]
    return _Parts(sha256("\n".join(own).encode()).hexdigest(), tuple(callees))


def _parts_of_code(code: CodeType, named: dict[str, Any]) -> Iterator[str | FunctionType]:
    yield code.co_code.hex()
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _parts_of_code(value, named)
        else:
            yield repr(value)
    for name in (*code.co_names, *code.co_freevars):
        if name in named:
            yield from _parts_of_value(name, named[name], code.co_names)


def _parts_of_value(name: str, value: Any, attributes: tuple[str, ...]) -> Iterator[str | FunctionType]:
    if isinstance(value, Dispatcher):
        yield repr(sorted(value.targetoptions.items()))
        yield value.py_func
    elif isinstance(value, _Intrinsic):
        yield value._defn
    elif isinstance(value, FunctionType):
        yield name if value.__module__.partition(".")[0] in _NOT_OURS else value
    elif isinstance(value, ModuleType):
        yield name
        for each in attributes:
            if value.__name__.partition(".")[0] not in _NOT_OURS and hasattr(value, each):
                yield from _parts_of_value(each, getattr(value, each), attributes)
    elif isinstance(value, tuple):
        for each in value:
            yield from _parts_of_value(name, each, attributes)
    else:
        yield f"{name} {_text_of(value)}"


def _fields_of(record: Any) -> str:
    """Names and types of the fields of a record of arrays (`compiled.arrays_in`), and of records in it."""
    hints = get_type_hints(record, include_extras=True) if hasattr(record, "_fields") else {}
    return repr({name: getattr(hint, "__metadata__", None) or _fields_of(hint) for name, hint in hints.items()})


def _text_of(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype.descr} {value.shape} {sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, np.dtype):
        return str(value.descr)
    if isinstance(value, type):  # a record of arguments
        return f"{value.__module__}.{value.__qualname__} {_fields_of(value)}"
    if isinstance(value, types.ExternalFunction):
        return f"{value} {value.sig}"
    if value is None or isinstance(value, bool | int | float | str | bytes | BuiltinFunctionType | types.Type):
        return repr(value)
    raise TypeError(f"{value!r} ({type(value).__name__}): a compiled function names it, expected a number or a record")
