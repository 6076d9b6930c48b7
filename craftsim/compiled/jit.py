"""Compilation of rules and controllers: numba in nopython mode, one signature a function, with an own cache.

Compiled functions must not allocate arrays. They then need no reference counting (``_nrt``), which would take ten times
as long as the rules themselves, and can all be inlined.

The wrapper through which Python calls a function takes as long to compile as the function. It is compiled at the first
call from Python; functions that only other compiled functions call have none.

A function that Python calls rarely (:func:`seldom`) runs as plain Python at first, which is faster than compiling it.

numba's supported hooks (``pipeline_class``, locators of cache files, new typings) change the passes of a function and
where its file is; none names code by its content, keeps a callee's machine code once for all callers, adds a wrapper
later, or remembers the signatures of operators. Hence dispatcher, code library and lookup of signatures are overridden
here; tests/discrete/test_compiled.py checks cache, callees and wrappers with the numba that is installed.
"""

from __future__ import annotations

import ctypes
import gc
import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from functools import cached_property, partial, update_wrapper
from importlib import import_module
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast, overload

import numpy as np
from llvmlite import binding as llvm
from numba.core import bytecode, config, sigutils, types, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

from craftsim.compiled import code_cache
from craftsim.compiled.progress import PROGRESS_LOG

_OPTIONS: Final[dict[str, Any]] = {
    "nopython": True,
    "error_model": "numpy",
    "_nrt": False,
}

Need = tuple[str, str, tuple[types.Type, ...]]
"""Module, name and argument types of a function that machine code calls, and that must be there before it."""

F = TypeVar("F", bound=Callable[..., Any])
INTERPRETED_S = 1.0
"""CPU time that calls of a function in plain Python may take before it is compiled (:func:`seldom`)."""

Record = Any
"""One of :func:`records` in a compiled function: its fields are attributes, and writing to them changes the array."""


@overload
def compiled(function: F) -> F: ...
@overload
def compiled(*, inline: bool = True) -> Callable[[F], F]: ...
def compiled(function: F | None = None, *, inline: bool = True) -> F | Callable[[F], F]:
    """Compile a function with numba at its first call; NUMBA_DISABLE_JIT=1 leaves it plain Python.

    Its code is inlined into its callers unless ``inline`` is off: a large one with many callers is better compiled
    once.
    """
    options = {"forceinline": inline, "no_cfunc_wrapper": inline}

    def decorate(function: F) -> F:
        if config.DISABLE_JIT:
            return function
        return cast(F, _Compiled(function, {}, options))

    if function is None:
        return decorate
    return decorate(function)


def plain(function: F, instead: Mapping[str, Callable[..., Any]] | None = None) -> F:
    """Return a function as plain Python, and all that it calls, for what is called too rarely to compile.

    With ``instead`` these functions, by name, are called in place of those of the same names.
    """
    function = getattr(function, "py_func", function)
    code = function.__code__
    names = function.__globals__
    functions = {}
    for name in _names(code):
        if name in names:
            functions[name] = _not_compiled(name, names[name], instead)
    cells = tuple(
        CellType(_not_compiled("", cell.cell_contents, instead))
        for cell in function.__closure__ or ()
    )
    return cast(F, update_wrapper(FunctionType(code, functions, closure=cells), function))


def _not_compiled(name: str, value: Any, instead: Mapping[str, Callable[..., Any]] | None) -> Any:
    """Return what plain Python uses for a value that compiled code knows by a name."""
    if instead is not None:
        if name in instead:
            return instead[name]
        # Where nothing is compiled these are functions of Python's.
        if isinstance(value, _Compiled | FunctionType):
            return plain(value, instead)
    elif isinstance(value, _Compiled):
        return value.plain
    return value


def seldom(function: F) -> F:
    """Return a compiled function that is compiled only once its calls have taken INTERPRETED_S as plain Python.

    If it is compiled already, or in the cache, it is used at once. Its arguments are numbers and arrays of numbers.
    """
    if config.DISABLE_JIT:
        return function
    compiled = cast(_Compiled, function)
    left_s = math.inf

    def call(*arguments: Any) -> Any:
        nonlocal left_s
        if left_s == math.inf:
            if compiled.is_there(arguments):
                left_s = 0.0
            else:
                left_s = INTERPRETED_S
        if left_s <= 0:
            return compiled(*arguments)
        began_s = time.thread_time()
        try:
            return compiled.plain(*arguments)
        finally:
            left_s -= time.thread_time() - began_s

    return cast(F, call)


def address_of(function: Callable[..., Any], arguments: tuple[types.Type, ...]) -> int:
    """Return the address of a function's machine code, for callers in C.

    The function is compiled with ``inline=False``, and takes and returns 64-bit integers.
    """
    if config.DISABLE_JIT:
        return _address_in_python(function, len(arguments))
    code = cast(_Compiled, function)
    with global_compiler_lock:
        code.bring(arguments)
        result = code.overloads[arguments]
        # Saving code in the cache completes it; there may be no cache.
        result.library._ensure_finalized()
        # What numba knows of the symbols of code from the cache is not complete; the engine that loaded it has them.
        engine = result.library.codegen._engine._ee
        address: int = engine.get_function_address(result.fndesc.llvm_cfunc_wrapper_name)
    if not address:
        raise ImportError(f"numba has no machine code of {function.__name__}")
    return address


_callbacks: Final[list[Any]] = []
"""Callbacks that native code may call, and that must stay."""


def _address_in_python(function: Callable[..., Any], n_arguments: int) -> int:
    """Return the address of a function in plain Python."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * n_arguments)
    callback = kind(function)
    _callbacks.append(callback)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return address


class _Compiled(CPUDispatcher):
    """A compiled function: numba's, with signatures without literals and enums, and with our cache."""

    def __init__(
        self, py_func: Callable[..., Any], locals: Any, targetoptions: dict[str, Any]
    ) -> None:
        super().__init__(py_func, locals, _OPTIONS | targetoptions)
        self._for_python = False
        """Python has called it: code that is compiled from then on has a wrapper."""
        self._wrapped: set[tuple[types.Type, ...]] = set()
        self._callable: set[tuple[types.Type, ...]] = set()
        """Signatures for which other compiled functions can call it, or take it in."""

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """Compile it for a call from Python."""
        self._for_python = True
        return super()._compile_for_args(*args, **kws)

    def compile(self, sig: Any) -> Any:
        """Compile it for a signature, or read from the cache what has been compiled; return what Python calls."""
        arguments = tuple(map(_plain, sigutils.normalize_signature(sig)[0]))
        with global_compiler_lock:
            if arguments not in (self._wrapped if self._for_python else self.overloads):
                self._load_or_compile(arguments)
            return self.overloads[arguments].entry_point

    def is_there(self, values: tuple[Any, ...]) -> bool:
        """Return whether Python can call it with such arguments without compiling it."""
        arguments = tuple(_plain(self.typeof_pyval(value)) for value in values)
        with global_compiler_lock:
            before = self._for_python
            self._for_python = True
            self._for_python = (
                arguments in self._wrapped or self._load(self._name(arguments)) or before
            )
            return arguments in self._wrapped

    @cached_property
    def plain(self) -> Callable[..., Any]:
        """It, and all that it calls, as plain Python."""
        return plain(self.py_func)

    def bring(self, arguments: tuple[types.Type, ...]) -> None:
        """Compile or load it for machine code that calls it by name."""
        with global_compiler_lock:
            if arguments in self._callable:
                return
            for_python = self._for_python
            entry = self.overloads.get(arguments)
            self._for_python = False
            try:
                self._load_or_compile(arguments)
            finally:
                self._for_python = for_python
            if arguments in self._wrapped:
                self.overloads[arguments] = entry

    def _load_or_compile(self, arguments: tuple[types.Type, ...]) -> None:
        name = self._name(arguments)
        if self._load(name):
            return
        with _progress(self), code_cache.alone(), _signatures_remembered():
            # Another process may have compiled it in the meantime.
            if self._load(name):
                return
            self.overloads.pop(arguments, None)
            inner = partial(_InnerCompiler, self.content)
            if self._for_python:
                self._compiler.pipeline_class = Compiler
            else:
                self._compiler.pipeline_class = inner
            self._compiler.targetoptions = self.targetoptions | {
                "no_cpython_wrapper": not self._for_python
            }
            super().compile(arguments)
            library = self.overloads[arguments].library
            library.needs = set[Need]()
            for inner in library._linking_libraries:
                if hasattr(inner, "needs"):
                    library.needs |= inner.needs | inner.itself
            called = not self._for_python and not self.targetoptions["forceinline"]
            if called:
                library.itself = {(self.py_func.__module__, self.__name__, arguments)}
            else:
                library.itself = set()
            code_cache.save_code(name, self.overloads[arguments])

    def _name(self, arguments: tuple[types.Type, ...]) -> str:
        """Return what it is called in the cache."""
        if self._for_python:
            kind = "entry"
        elif self.targetoptions["forceinline"]:
            kind = "part"
        else:
            kind = "called"
        return f"{self.py_func.__module__}.{self.__name__}.{kind} {self.content} {arguments}"

    def _load(self, name: str) -> bool:
        result = code_cache.load_code(name, self.targetctx, _bring)
        if result is not None:
            self._insert_into_context(result)
            self.add_overload(result)
        return result is not None

    def _insert_into_context(self, result: Any) -> None:
        self.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])

    def add_overload(self, result: Any) -> None:
        """Take what has been compiled for a signature; Python may call it if there is a wrapper."""
        if self._for_python:
            self._wrapped.add(tuple(result.signature.args))
            super().add_overload(result)
            return
        if result.entry_point is None:
            # What tells it from others in numba's table.
            result = result._replace(entry_point=object())
            self._insert_into_context(result)
        self.overloads[tuple(result.signature.args)] = result
        self._callable.add(tuple(result.signature.args))

    @cached_property
    def content(self) -> str:
        """A digest of all that its compiled code depends on: its module and code, and the compiled functions and the
        constants that it refers to, and so on. Comments, docstrings and whatever else is in these files do not count.

        What is kept in the cache imports the modules of all functions in it: one that moved must not be found there."""
        code = self.py_func.__code__
        doc = self.py_func.__doc__
        constants = list(code.co_consts)
        for i, constant in enumerate(constants):
            if constant is doc:
                constants[i] = None
        code = code.replace(co_consts=tuple(constants))
        refers_to = map(_text, self._refers_to())
        parts = (_OPTIONS, self.targetoptions, self.py_func.__module__, _text(code), *refers_to)
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def _refers_to(self) -> Iterator[Any]:
        function = self.py_func
        yield function.__defaults__
        for cell in function.__closure__ or ():
            yield cell.cell_contents
        for name in _names(function.__code__):
            if name in function.__globals__:
                value = function.__globals__[name]
                yield value
                if isinstance(value, ModuleType):
                    yield from (getattr(value, n, None) for n in _names(function.__code__))

    def calls(self) -> set[_Compiled]:
        """Return all compiled functions that it calls, and that these call, and so on; and itself."""
        functions = {self}
        pending = [self]
        while pending:
            for value in pending.pop()._refers_to():
                if isinstance(value, _Compiled) and value not in functions:
                    functions.add(value)
                    pending.append(value)
        return functions


class _Part(JITCodeLibrary):
    """Code of an inlined function: it becomes machine code with its callers, not by itself."""

    def _optimize_final_module(self) -> None:
        """Inline what it calls; what is inlined itself is optimised where it ends up."""
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> Any:
        """Return its code as it stands."""
        return self.serialize_using_bitcode()


class _Called(JITCodeLibrary):
    """Code of a function that is not inlined: it becomes machine code once, and callers refer to it by name."""

    _shared_module: Any

    def _get_module_for_linking(self) -> Any:
        """Return an empty module: callers resolve the function by name when they are loaded."""
        self._ensure_finalized()
        if self._shared_module is None:
            self._shared_module = llvm.parse_assembly(
                str(self._codegen._create_empty_module(self.name))
            )
        return self._shared_module


class _InnerCompiler(Compiler):
    """Compiles a function that other compiled functions call, under a name that depends on its content alone."""

    def __init__(
        self,
        content: str,
        typing: Any,
        target: Any,
        _: None,
        args: Any,
        result: Any,
        flags: Any,
        names: Any,
    ) -> None:
        flags.no_compile = True
        self._content = content
        library = (_Part if flags.forceinline else _Called)(target.codegen(), "inner")
        library.enable_object_caching()
        super().__init__(typing, target, library, args, result, flags, names)

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        """Compile a function as numba does, but for its number, which becomes a part of its name."""
        self.state.func_id = bytecode.FunctionIdentity.from_function(func)
        self.state.func_id.unique_id = int(self._content[:15], 16)
        untyped_passes.ExtractByteCode().run_pass(self.state)
        self.state.lifted = ()
        self.state.lifted_from = None
        return self._compile_bytecode()


_signatures: Final[dict[Any, Any]] = {}
_look_up: Final = types.BaseFunction.get_call_type


def _signature(function: Any, context: Any, arguments: Any, keywords: Any) -> Any:
    """Return the signature of a call, looked up once: numba tries all overloads of an operator whenever it is used."""
    key = function, tuple(arguments), tuple(keywords.items())
    if key not in _signatures:
        _signatures[key] = _look_up(function, context, arguments, keywords)
    return _signatures[key]


@contextmanager
def _signatures_remembered() -> Iterator[None]:
    before = types.BaseFunction.get_call_type
    types.BaseFunction.get_call_type = _signature
    try:
        yield
    finally:
        types.BaseFunction.get_call_type = before


_functions: Final[set[_Compiled]] = set()
"""The functions that this process has compiled, and those that it is about to."""
_depth = 0


@contextmanager
def _progress(function: _Compiled) -> Iterator[None]:
    """Compile a function in the block, and in blocks within it all that it calls; log how far that is."""
    global _depth
    outermost = not _depth
    collects = gc.isenabled()
    if outermost:
        # An eighth of the time would go into looking for garbage in what numba still needs.
        gc.disable()
        _functions.update(inner for inner in function.calls() if not inner.overloads)
        _say()
    _depth += 1
    try:
        yield
    finally:
        _depth -= 1
        if outermost:
            if collects:
                gc.enable()
            # Others were not called.
            _functions.intersection_update([inner for inner in _functions if inner.overloads])
        _say()


def _say() -> None:
    done = sum(bool(function.overloads) for function in _functions)
    PROGRESS_LOG.info("compiling, on the first run only: %d of %d functions", done, len(_functions))


def _bring(needs: set[Need]) -> None:
    """Compile or load the functions that the machine code of another one calls."""
    for module, name, arguments in sorted(needs, key=str):
        getattr(import_module(module), name).bring(arguments)


def _plain(kind: types.Type) -> types.Type:
    """Return a type without literal values and enums: an integer for both."""
    kind = types.unliteral(kind)
    if isinstance(kind, types.IntEnumMember):
        return types.int64
    return kind


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a code reads, as globals or attributes."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _text(value: Any) -> str:
    """Return a text that differs where compiled code that refers to the value differs."""
    if isinstance(value, _Compiled):
        return value.content
    if isinstance(value, CodeType):
        return repr(
            (value.co_code, value.co_names, value.co_varnames, [*map(_text, value.co_consts)])
        )
    if isinstance(value, tuple):
        return repr([*map(_text, value)])
    if isinstance(value, np.ndarray):
        return repr((value.dtype, value.shape, value.tobytes()))
    if isinstance(value, type) and issubclass(value, Enum):
        return repr([(member.name, member.value) for member in value])
    if isinstance(value, Enum):
        return repr((type(value).__qualname__, value.name, value.value))
    if isinstance(value, int | float | complex | str | bytes | np.generic | np.dtype | None):
        return f"{type(value).__name__} {value!r}"
    # Types, modules, and functions of Python's and NumPy's; numba takes no other objects.
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)}"


def records(count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return zeroed records for compiled functions, which read and write ``array[i].field``."""
    array = np.zeros(count, dtype)
    # Without the compiler, records need a type of their own for that; with it, that type is slow to recognise.
    if config.DISABLE_JIT:
        return array.view(np.recarray)
    return array


def layout(**fields: str | np.dtype[np.void]) -> np.dtype[np.void]:
    """Return a type of records: by kind and shape the names of its fields, or by name a type of records.

    Example:
        >>> layout(f8="x y", i8x4="motors").names
        ('x', 'y', 'motors')
    """
    type_fields: list[Any] = []
    for key, value in fields.items():
        kind, *shape = key.split("x")
        if isinstance(value, str):
            type_fields += [(name, kind, tuple(map(int, shape))) for name in value.split()]
        else:
            type_fields.append((key, value))
    return np.dtype(type_fields, align=True)
