"""Models as the loop steps them: without what is only looked at, and without what nobody reads.

MuJoCo moves the frame of every geom, camera and light in each step, some 300 of the shipped
machine. None of them acts on a body: a run of the headless model gives the same bits.
"""

import copy

import mujoco
import numpy as np


def headless(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a copy of a model without cameras, lights, and geoms that touch and weigh nothing.

    A geom stays where it can collide (`contype` or `conaffinity`) or where its body moves and has
    no inertia of its own, so that it weighs what its geoms do. With the last geom go meshes,
    materials and textures.

    Raises:
        ValueError: what `MjSpec.compile` raises.
    """
    bare = spec.copy()
    for geom in list(bare.geoms):
        weighs = geom.parent.name != "world" and not geom.parent.explicitinertial
        if not (geom.contype or geom.conaffinity or weighs):
            bare.delete(geom)
    seen = [bare.cameras, bare.lights]
    if not bare.geoms:
        seen += [bare.meshes, bare.materials, bare.textures]
    for kind in seen:
        for thing in list(kind):
            bare.delete(thing)
    return bare.compile()


def quiet(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model whose steps compute no sensor."""
    without = copy.copy(model)
    without.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    return without


def saved(model: mujoco.MjModel) -> bytes:
    """A compiled model as MuJoCo saves it."""
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()
