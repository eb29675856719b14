"""Machine code of compiled functions on disk, and numba ready to run it within milliseconds."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding
from numba import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, InTreeCacheLocator
from numba.core.runtime import nrtdynmod
from numba.core.runtime.nrt import rtsys
from numba.core.typing.typeof import typeof_impl
from numba.np import numpy_support


class _Installed(InTreeCacheLocator):
    """The package's own folder, where it can't be written."""

    def ensure_cache_path(self) -> None:
        pass


def _tried_once(kind: type[Any]) -> type[Any]:
    """numba tries for each function whether its folder can be written, with a file; once a folder is enough."""
    tried: dict[str, OSError | None] = {}

    def ensure_cache_path(locator: Any) -> None:
        folder = locator.get_cache_path()
        if folder not in tried:
            tried[folder] = None
            try:
                kind.ensure_cache_path(locator)
            except OSError as error:
                tried[folder] = error
        problem = tried[folder]
        if problem is not None:
            raise problem

    return type(kind.__name__, (kind,), {"ensure_cache_path": ensure_cache_path})


class _Places(CompileResultCacheImpl):
    """As numba's; where neither the package's folder nor the user's can be written, hilbench can still be used."""

    _locator_classes = [*map(_tried_once, CompileResultCacheImpl._locator_classes), _Installed]  # noqa: RUF012  # as numba has it

    def rebuild(self, target: Any, payload: Any) -> Any:
        """As numba's, but what is compiled with the function in it reads the intermediate code when it is: to read that
        takes nine tenths of the time to load a function."""
        (name, kind, (machine_code, intermediate)), description, *rest = payload
        engine = target.codegen()._engine
        engine._defined_symbols |= {description.llvm_func_name, description.llvm_cpython_wrapper_name}
        found = super().rebuild(target, ((name, kind, (machine_code, _no_code())), description, *rest))
        library = found.library

        def module_for_linking() -> Any:
            del library._get_module_for_linking
            library._shared_module = binding.parse_bitcode(intermediate)
            engine._load_defined_symbols(library._shared_module)
            return library._shared_module

        library._get_module_for_linking = module_for_linking
        return found


@cache
def _no_code() -> bytes:
    nothing: bytes = binding.parse_assembly("").as_bitcode()
    return nothing


class KeptCode(FunctionCache):
    """Machine code on disk as numba keeps it, and beside that what was compiled when hilbench was installed.

    numba has one place, the first that can be written: the package's own folder, else the user's cache. Who may only
    read the package would compile all of it anew.
    """

    _impl_class = _Places

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        folder = str(Path(function.__code__.co_filename).parent / "__pycache__")
        stamp = self._impl.locator.get_source_stamp()
        self._files = [self._cache_file]
        if folder != self.cache_path and not os.environ.get("NUMBA_CACHE_DIR"):
            self._files.append(IndexDataCacheFile(folder, self._impl.filename_base, stamp))
        self._kept: set[Any] = set()  # types of arguments for which it has been found

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The machine code, None where it is not on disk. What numba knows of all that can be compiled it loads when
        something is compiled: before any function is loaded, as numba does it, that takes longer than the function."""
        rtsys.initialize(target)
        return self._load_overload(signature, target)

    def _load_overload(self, signature: Any, target: Any) -> Any:
        data = self._data(signature, target.codegen())
        return None if data is None else self._impl.rebuild(target, data)

    def _data(self, signature: Any, codegen: Any) -> Any:
        """What was kept for these arguments, as it was saved; None: nothing."""
        key = self._index_key(signature, codegen)
        return next((data for file in self._files if (data := file.load(key)) is not None), None)

    def holds(self, signature: Any, target: Any) -> bool:
        """Whether the machine code for these arguments is on disk."""
        if signature not in self._kept:
            key = self._index_key(signature, target.codegen())
            if not any(key in each._load_index() for each in self._files):
                return False
            self._kept.add(signature)
        return True

    def _save_overload(self, signature: Any, data: Any) -> None:
        if self._makes_folder():
            super()._save_overload(signature, data)

    def _makes_folder(self) -> bool:
        """Have the folder to save to; False where none can be written."""
        if isinstance(self._impl.locator, _Installed):
            return False
        Path(self.cache_path).mkdir(parents=True, exist_ok=True)
        return True


class _KeptRuntime(KeptCode):
    """The same of numba's runtime, whose few functions numba compiles anew in each process (20 ms)."""

    def library(self, target: Any) -> Any:
        """The functions, compiled for this target."""
        codegen = target.codegen()
        data = self._data((), codegen)
        if data is not None:
            return codegen.unserialize_library(data)
        module, library = nrtdynmod.create_nrt_module(target)
        library.enable_object_caching()
        library.add_ir_module(module)
        library.finalize()
        if self._makes_folder():
            self._cache_file.save(self._index_key((), codegen), library.serialize_using_object_code())
        return library


def _runtime(target: Any) -> Any:
    """In the place of numba's `compile_nrt_functions`."""
    return _KeptRuntime(_runtime).library(target)


nrtdynmod.compile_nrt_functions = _runtime
_type_of_any_array = typeof_impl.dispatch(np.ndarray)


@typeof_impl.register(np.ndarray)
def _type_of_array(array: Any, context: Any) -> Any:
    """As numba's, which loads all of numpy's masked arrays (8 ms) to refuse one."""
    if type(array) is not np.ndarray:
        return _type_of_any_array(array, context)
    kind, layout = numpy_support.from_dtype(array.dtype), numpy_support.map_layout(array)
    return types.Array(kind, array.ndim, layout, readonly=not array.flags.writeable)
