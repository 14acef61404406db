"""Calls MuJoCo's C functions from compiled code.

The frame loop is compiled by Numba and releases the interpreter lock, so it cannot go through
MuJoCo's Python bindings. MuJoCo's C interface takes two pointers, which the bindings expose as
`MjModel._address` and `MjData._address`; a function's address comes from the library that the
bindings have loaded. Addresses are arguments, so that compiled code is cached across processes.
"""

import copy
import ctypes
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

# The run that MuJoCo's warnings end names them; they are not to be appended to a file
# MUJOCO_LOG.TXT of the working folder.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(logging.getLogger("mujoco").info)


@lru_cache
def _library() -> ctypes.CDLL:
    """The MuJoCo library that the Python bindings have loaded."""
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    return ctypes.CDLL(str(next(path for name in names for path in sorted(folder.glob(name)))))


class Stepper(NamedTuple):
    """What the compiled loop needs of MuJoCo: three addresses and views of MjData."""

    model: int  #: Address of the mjModel.
    quiet: int  #: Address of the same without sensors, for steps whose sensors nobody reads.
    data: int  #: Address of the mjData.
    position_stage: int  #: Address of mj_step1: kinematics and position sensors at this state.
    force_stage: int  #: Address of mj_step2: forces, acceleration and integration.
    motors: NDArray[np.int64]  #: Indices of the hydraulic motors, (n,).
    length: NDArray[np.float64]  #: Lengths of all motors, fresh after the position stage, (nu,).
    ctrl: NDArray[np.float64]  #: Forces of all motors [N], (nu,).
    payload: NDArray[np.float64]  #: External force and torque on bodies, world's axes, (nbody, 6).
    payload_bodies: NDArray[np.int64]  #: Bodies an overload rests on, in equal parts.
    sensordata: NDArray[np.float64]  #: All sensors.
    site: NDArray[np.float64]  #: Places of all sites in the world [m], (nsite, 3).
    qpos: NDArray[np.float64]  #: Generalised positions.
    neutral: NDArray[np.float64]  #: Lengths of the hydraulic motors at neutral, (n,).
    warnings: NDArray[np.int32]  #: How often MuJoCo has warned since the start, by kind.


def address(function: str) -> int:
    """Address of a MuJoCo C function of the library that the Python bindings use."""
    pointer = ctypes.cast(getattr(_library(), function), ctypes.c_void_p).value
    assert pointer is not None
    return pointer


class _Clock:
    """MuJoCo's clock `mjcb_time`, which its bindings set, and how many runs do without it."""

    lock = threading.Lock()
    runs = 0  #: Runs that do without it now.
    address: int | None = None  #: Address of the clock meanwhile.


@contextmanager
def without_clock() -> Iterator[None]:
    """Let MuJoCo step without timing its parts, which takes a fifteenth of a step.

    `MjData.timer` counts in no thread meanwhile; the last to leave sets the clock again.
    """
    clock = ctypes.c_void_p.in_dll(_library(), "mjcb_time")
    with _Clock.lock:
        if _Clock.runs == 0:
            _Clock.address, clock.value = clock.value, None
        _Clock.runs += 1
    try:
        yield
    finally:
        with _Clock.lock:
            _Clock.runs -= 1
            if _Clock.runs == 0:
                clock.value = _Clock.address


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


def headless(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a copy of a model without cameras, lights, and geoms that touch and weigh nothing.

    A geom stays where it can collide (`contype` or `conaffinity`) or where its body moves and has
    no inertia of its own, so that it weighs what its geoms do. With the last geom go meshes,
    materials and textures.
    """
    headless_spec = spec.copy()
    for geom in list(headless_spec.geoms):
        gives_weight = geom.parent.name != "world" and not geom.parent.explicitinertial
        if not (geom.contype or geom.conaffinity or gives_weight):
            headless_spec.delete(geom)
    visuals = [*headless_spec.cameras, *headless_spec.lights]
    if not headless_spec.geoms:
        visuals += [*headless_spec.meshes, *headless_spec.materials, *headless_spec.textures]
    for element in visuals:
        headless_spec.delete(element)
    return headless_spec.compile()


def without_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model whose steps compute no sensor."""
    copied = copy.copy(model)
    copied.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    return copied


def saved_model(model: mujoco.MjModel) -> bytes:
    """A compiled model as MuJoCo saves it."""
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()
