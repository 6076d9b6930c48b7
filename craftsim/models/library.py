"""MuJoCo's shared library, whose C functions compiled code calls."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Final

import llvmlite.binding as llvm
import mujoco
from llvmlite import ir


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
