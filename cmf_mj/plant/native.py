"""Calls MuJoCo's C functions from compiled code.

The frame loop is compiled by Numba and releases the interpreter lock, so it cannot go through
MuJoCo's Python bindings: two transitions a frame would cost as much as the step itself. MuJoCo's
C interface takes two plain pointers, which the bindings expose as `MjModel._address` and
`MjData._address`; the function's own address comes from the library the bindings have loaded.
`call(address, model, data)` is then one indirect call. Addresses are arguments, never constants
of the compiled code, so the compilation caches across processes.
"""

import ctypes
import logging
from pathlib import Path
from typing import Any

import mujoco
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

# The run that MuJoCo's warnings end names them; they are not to be appended to a file
# MUJOCO_LOG.TXT of the working folder.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(logging.getLogger("mujoco").info)


def address(function: str) -> int:
    """Address of a MuJoCo C function of the library that the Python bindings use."""
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    library = next(path for name in names for path in sorted(folder.glob(name)))
    pointer = ctypes.cast(getattr(ctypes.CDLL(str(library)), function), ctypes.c_void_p).value
    assert pointer is not None
    return pointer


_SIGNATURE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


def call(function: int, model: int, data: int) -> None:
    """Call `void function(const mjModel*, mjData*)`; the interpreted twin of the compiled call."""
    _SIGNATURE(function)(model, data)


@intrinsic
def _call(typing_context: Any, function: Any, model: Any, data: Any) -> Any:
    signature = types.void(types.intp, types.intp, types.intp)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = cgutils.voidptr_t
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        target = builder.inttoptr(arguments[0], kind)
        builder.call(target, [builder.inttoptr(a, pointer) for a in arguments[1:]])
        return context.get_dummy_value()

    return signature, generate


@overload(call, jit_options={"forceinline": True})
def _compiled_call(function, model, data):  # type: ignore[no-untyped-def]
    return lambda function, model, data: _call(function, model, data)
