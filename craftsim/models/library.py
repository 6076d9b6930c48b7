"""MuJoCo's shared library, whose C functions compiled code calls, and its memory."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, Final

import llvmlite.binding as llvm
import mujoco
from llvmlite import ir
from numba.core import config, types
from numba.extending import intrinsic


def _library_file() -> str:
    folder = Path(mujoco.__file__).parent
    for name in ("libmujoco.*", "mujoco.dll"):
        for file in folder.glob(name):
            return str(file)
    raise ImportError(
        f"MuJoCo's library is not in {folder}; install it again: pip install --force-reinstall mujoco"
    )


_FILE: Final = _library_file()
LIBRARY: Final = ctypes.CDLL(_FILE)
"""Its functions and tables."""
# Compiled code finds them by name.
llvm.load_library_permanently(_FILE)
# The bindings have MuJoCo read a clock 15 times a step for MjData.timer, which takes 4 % of a step.
ctypes.c_void_p.in_dll(LIBRARY, "mjcb_time").value = None
_engines: Final[list[llvm.ExecutionEngine]] = []


def machine_code(module: ir.Module) -> llvm.ExecutionEngine:
    """Return what has the addresses of a module's functions. They stay: MuJoCo may call them from any thread."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(str(module)), machine)
    engine.finalize_object()
    _engines.append(engine)
    return engine


if config.DISABLE_JIT:

    def _pointer(kind: Any) -> Any:
        return lambda address: ctypes.cast(int(address), ctypes.POINTER(kind))

    doubles_at = _pointer(ctypes.c_double)
    words_at = _pointer(ctypes.c_int64)
    integers_at = _pointer(ctypes.c_int32)
    bytes_at = _pointer(ctypes.c_uint8)
else:

    def _pointer(kind: Any) -> Any:
        """Return a function of an address that gives a pointer to numbers of a kind."""
        pointer = types.CPointer(kind)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(pointer))

        @intrinsic
        def cast(typing: Any, address: Any) -> Any:
            return pointer(types.int64), generate

        return cast

    doubles_at = _pointer(types.float64)
    words_at = _pointer(types.int64)
    integers_at = _pointer(types.int32)
    bytes_at = _pointer(types.uint8)
