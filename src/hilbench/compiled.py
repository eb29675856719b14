"""Decorators of compiled functions, typed as the functions they decorate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic
from numpy.typing import NDArray

from hilbench.code_cache import CodeCache

Function = TypeVar("Function", bound=Callable[..., object])
Vector = NDArray[np.float64]
Table = NDArray[np.int64]

#: Types of arguments of an entry point: a float, an int, a bool; arrays of float64 with one to three dimensions and of
#: int64 with one and two, in one piece; tuples of so many floats.
REAL, COUNT, FLAG = types.float64, types.int64, types.boolean
VECTOR, MATRIX, CUBE = (types.Array(types.float64, dimensions, "C") for dimensions in (1, 2, 3))
INDICES, TABLE = (types.Array(types.int64, dimensions, "C") for dimensions in (1, 2))


#: Types of the fields of a NamedTuple of arrays (`table_of`, `arrays_in`): of float64 and of int64, with so many
#: dimensions. A field can be another such NamedTuple, too, Annotated[Any, `record_type`] a vector whose elements have
#: names, and Annotated[Any, `records`] an array of these.
Reals = Annotated[NDArray[np.float64], VECTOR]
Reals2 = Annotated[NDArray[np.float64], MATRIX]
Reals3 = Annotated[NDArray[np.float64], CUBE]
Wholes = Annotated[NDArray[np.int64], INDICES]
Wholes2 = Annotated[NDArray[np.int64], TABLE]


#: A record, and an array of records, in annotations of compiled functions.
Record = Any
Records = Any


def records(kind: np.dtype[Any], dimensions: int = 1) -> Any:
    """Type of an array of records, as a field of a NamedTuple of arrays."""
    return types.Array(numba.from_dtype(kind), dimensions, "C")


Arrays = TypeVar("Arrays", bound=tuple[Any, ...])


def reals(count: int) -> Any:
    """Type of a tuple of so many floats."""
    return types.UniTuple(types.float64, count)


if TYPE_CHECKING:

    def compiled(function: Function) -> Function:
        """Compile on first use; called from compiled code, or from Python in tests. It can't allocate."""
        return function

    def inlined(function: Function) -> Function:
        """Compile, always inlined into the machine code of its callers: for short functions called in every step."""
        return function

    def merged(function: Function) -> Function:
        """Compile by merging into its callers: for a long function with one or two, not compiled by itself as well."""
        return function

    def noinline() -> None:
        """Keep a rarely called compiled function out of line, in its body: its callers stay short."""

    def entry_point(*arguments: Any, allocates: bool = True) -> Callable[[Function], Function]:
        """Called from Python: machine code kept on disk, and other threads run meanwhile. It may allocate, if so said.

        `arguments`: types of the arguments (VECTOR, REAL, … below), for which `hilbench compile` compiles it. Called
        with others it is compiled for them as well, there and then.
        """
        return lambda function: function

    def arrays_in(table: NDArray[np.int64], kind: type[Arrays]) -> Arrays:
        """The NamedTuple of arrays that a `table_of` is made of, in the body of an entry point. The caller who made the
        table keeps them alive."""
        raise NotImplementedError

    def viewed(array: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
        """View of a contiguous array as another type that fits in it a whole number of times, in the body of a compiled
        function; like `array.view(kind)`, for which numba would load half of itself with the machine code
        (25 ms). The array is to be kept."""
        raise NotImplementedError

    def record_in(vector: NDArray[np.float64], at: int, kind: np.dtype[Any]) -> Any:
        """Record in a vector, from offset `at` on, in the body of a compiled function. The vector is to be kept."""
        raise NotImplementedError

    def call_at(function: int, argument: int, table: int, rows: int) -> int:
        """Call another entry point by its `address_of`, in the body of one, with an argument and the address of a
        `table_of` so many rows. Only for functions of (COUNT, TABLE) that return an int64."""
        raise NotImplementedError

else:

    class _LinkedLibrary(JITCodeLibrary):
        """Code of a function that is only linked into its compiled callers: optimised, and made machine code, as part
        of theirs. numba does both for each function by itself, too, which takes as long as all the rest."""

        codegen = SimpleNamespace(set_env=lambda name, environment: None)  # there is no code to give it to

        def get_pointer_to_function(self, name):
            return 0

        def _optimize_final_module(self):
            pass

        def _finalize_final_module(self):
            self._finalized = True

    class _LinkedCompiler(Compiler):
        def _compile_core(self):
            name = self.state.func_id.func_qualname
            self.state.library = _LinkedLibrary(self.state.targetctx.codegen(), name)
            return super()._compile_core()

    class _Linked(CPUDispatcher):
        """Function that is linked into its compiled callers; when Python calls it, it is compiled by itself."""

        @cached_property
        def _by_itself(self):
            return numba.njit(**_OPTIONS)(self.py_func)

        def __call__(self, *arguments):
            return self._by_itself(*arguments)

    # Division as in numpy and C (no check for zero); no fastmath: equal results on every machine.
    # Without NRT, numba's runtime, there are no reference counts: with them a step of the model takes ten times as
    # long, because numba counts an array at every call. What allocates does not compile then.
    # They are never called by a C function's address: the wrapper for that would be compiled for nothing.
    _OPTIONS = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}

    # A callee would take over its caller's `forceinline` unless it says otherwise.
    _LINKED = _OPTIONS | {"nopython": True, "no_cpython_wrapper": True}
    compiled, inlined, merged = (
        partial(_Linked, targetoptions=_LINKED | each, pipeline_class=_LinkedCompiler)
        for each in ({"forceinline": False}, {"forceinline": True}, {"inline": "always"})
    )

    def entry_point(*arguments, allocates=True):
        def decorate(function):
            options = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True, "_nrt": allocates}
            dispatcher = numba.njit(**options)(function)
            dispatcher._cache = CodeCache(function, repr(options))
            dispatcher.arguments = arguments
            return dispatcher

        return decorate

    @intrinsic
    def noinline(typing_context):
        def generate(context, builder, signature, arguments):
            builder.function.attributes.add("noinline")
            return context.get_dummy_value()

        return types.void(), generate

    def _array_at(context, builder, kind, address, *shape):
        from numba.np.arrayobj import make_array, populate_array  # what is only called needs none of it

        found, size = make_array(kind)(context, builder), context.get_abi_sizeof(context.get_data_type(kind.dtype))
        step = context.get_constant(types.intp, size)
        strides = [step]
        for size in reversed(shape[1:]):
            strides.insert(0, builder.mul(strides[0], size))
        populate_array(found, builder.inttoptr(address, found.data.type), shape, strides, step, None)
        return found._getvalue()

    def _numba_type(kind):
        """What numba sees of a field's type."""
        if isinstance(kind, np.dtype):
            return numba.from_dtype(kind)
        return types.NamedTuple([_numba_type(each) for each in _fields(kind)], kind) if isinstance(kind, type) else kind

    @intrinsic
    def arrays_in(typing_context, table, kind):
        result = _numba_type(kind.instance_class)

        def generate(context, builder, signature, arguments):
            from numba.np.arrayobj import make_array

            rows, at = make_array(signature.args[0])(context, builder, arguments[0]), iter(range(1000))

            def field(kind):
                if isinstance(kind, types.BaseTuple):
                    return context.make_tuple(builder, kind, [field(each) for each in kind])
                row = next(at) * TABLE_WIDTH
                cells = [
                    builder.load(builder.gep(rows.data, [context.get_constant(types.intp, row + column)]))
                    for column in range(1 + getattr(kind, "ndim", 0))
                ]
                if isinstance(kind, types.Record):
                    return builder.inttoptr(cells[0], context.get_value_type(kind))
                return _array_at(context, builder, kind, *cells)

            return field(result)

        return result(table, kind), generate

    @intrinsic
    def viewed(typing_context, array, kind):
        result = types.Array(kind.dtype, array.ndim, "C")

        def generate(context, builder, signature, arguments):
            from numba.np.arrayobj import make_array, populate_array

            given, found = make_array(array)(context, builder, arguments[0]), make_array(result)(context, builder)
            before, size = (context.get_abi_sizeof(context.get_data_type(each.dtype)) for each in (array, result))
            step = context.get_constant(types.intp, size)
            *outer, last = cgutils.unpack_tuple(builder, given.shape, array.ndim)
            octets = builder.mul(last, context.get_constant(types.intp, before))
            shape, strides = [*outer, builder.sdiv(octets, step)], [step]
            for width in reversed(shape[1:]):
                strides.insert(0, builder.mul(strides[0], width))
            data = builder.bitcast(given.data, found.data.type)
            populate_array(found, data, shape, strides, step, None)
            return found._getvalue()

        return result(array, kind), generate

    @intrinsic
    def record_in(typing_context, vector, at, kind):
        def generate(context, builder, signature, arguments):
            from numba.np.arrayobj import make_array

            data = make_array(vector)(context, builder, arguments[0]).data
            return builder.bitcast(builder.gep(data, [arguments[1]]), context.get_value_type(kind.dtype))

        return kind.dtype(vector, types.intp, kind), generate

    @intrinsic
    def call_at(typing_context, function, argument, table, rows):
        result = types.int64

        def generate(context, builder, signature, arguments):
            from numba.np.arrayobj import make_array, populate_array

            of_function, of_call = (COUNT, TABLE), context.call_conv
            address, argument, data, rows = arguments
            array = make_array(TABLE)(context, builder)
            width, step = (context.get_constant(types.intp, size) for size in (TABLE_WIDTH, 8))
            strides = [builder.mul(width, step), step]
            populate_array(array, builder.inttoptr(data, array.data.type), [rows, width], strides, step, None)
            kind = of_call.get_function_type(result, of_function).as_pointer()
            callee = builder.inttoptr(address, kind)
            status, found = of_call.call_function(builder, callee, result, of_function, [argument, array._getvalue()])
            with cgutils.if_unlikely(builder, status.is_error):
                of_call.return_status_propagate(builder, status)
            return found

        return result(types.intp, COUNT, types.intp, types.intp), generate


#: Columns of a `table_of`: address, and up to three lengths.
TABLE_WIDTH = 4


def _fields(kind: type[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Types of the fields of a NamedTuple of arrays: numba's of an array, numpy's of a record, another NamedTuple."""
    hints = get_type_hints(kind, include_extras=True).values()
    return tuple([hint.__metadata__[0] if hasattr(hint, "__metadata__") else hint for hint in hints])


def _flat(arrays: Sequence[Any]) -> Iterator[tuple[str, Any, NDArray[Any]]]:
    """Name, type and array of each row of the table of a NamedTuple of arrays, or of several of these."""
    if not hasattr(arrays, "_fields"):
        for each in arrays:
            yield from _flat(each)
        return
    for name, kind, array in zip(arrays._fields, _fields(type(arrays)), arrays, strict=True):  # type: ignore[arg-type]
        if isinstance(kind, type):
            yield from _flat(array)
        else:
            yield name, kind, array


def table_of(arrays: Sequence[Any]) -> NDArray[np.int64]:
    """Table of the addresses and shapes of the arrays of a NamedTuple, or of several of these, a row each: for an entry
    point with more arrays than a call from Python should pass one by one (70 ns each). The caller keeps them.

    Raises ValueError for an array that is not as its field says, or not in one piece.
    """
    rows = list(_flat(arrays))
    table = np.zeros((len(rows), TABLE_WIDTH), np.int64)
    for row, (name, kind, array) in zip(table, rows, strict=True):
        fits = (
            array.nbytes == kind.itemsize
            if isinstance(kind, np.dtype)
            else (array.ndim, numba.from_dtype(array.dtype)) == (kind.ndim, kind.dtype)
        )
        if not fits or not array.flags.c_contiguous:
            raise ValueError(f"{name} is an array of {array.dtype} {array.shape}, expected {kind} in one piece")
        row[: 1 + array.ndim] = (array.ctypes.data, *array.shape)
    return table


def rows_of(kind: type[tuple[Any, ...]]) -> int:
    """Rows of the `table_of` a NamedTuple of arrays."""
    return sum(rows_of(each) if isinstance(each, type) else 1 for each in _fields(kind))


def record_type(*names: str, of: type[np.generic] = np.float64) -> np.dtype[Any]:
    """Type of a record of floats, or of int64: a vector's elements by their names."""
    return np.dtype([(name, of) for name in names])


def of_record(kind: np.dtype[Any], **values: float) -> tuple[float, ...]:
    """Values of a record in the order of its fields; those that are not given are 0.

    Raises ValueError for a name that it has not.
    """
    record = np.zeros(1, kind)
    for name, value in values.items():
        record[name] = value
    found: tuple[float, ...] = record[0].item()
    return found


def record_at(vector: NDArray[Any], kind: np.dtype[Any]) -> Any:
    """Record at the start of a vector, with its fields as attributes; in compiled code `viewed(vector, kind)[0]`."""
    return vector[: kind.itemsize // 8].view(kind).view(np.recarray)[0]


def address_of(function: Callable[[int, NDArray[np.int64]], int]) -> int:
    """Address of the machine code of an entry point of (COUNT, TABLE), for `call_at`; compiled, or loaded, if need
    be. It is valid as long as the process lives."""
    load(function)
    dispatcher: Any = function
    found = dispatcher.overloads[dispatcher.arguments]
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))


def load(*functions: Callable[..., Any]) -> None:
    """Compile entry points, or load their machine code, before a cycle has to wait for it."""
    for function in functions:
        dispatcher: Any = function
        dispatcher.compile(dispatcher.arguments)


def interpreted(function: Function) -> Function:
    """Python version of a compiled function that calls no other, for rare calls by itself. Compiling
    it, in each process anew, takes a tenth of a second."""
    plain: Function = function.py_func  # type: ignore[attr-defined]
    return plain


def entry_points(module: ModuleType) -> list[Any]:
    """The entry points that a module defines: numba's dispatchers, with the types of their `arguments`."""
    return [
        each
        for each in vars(module).values()
        # `isinstance` would call its metaclass, that of abstract classes, for each name in each module.
        if type(each) is CPUDispatcher and hasattr(each, "arguments") and each.__module__ == module.__name__
    ]
