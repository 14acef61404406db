"""The mechanics about rest, in actuator coordinates.

With l the extensions, T the motion of the machine per actuator velocity and F(l) the static forces,

    M_leg d2l/dt2 = dF - D dl/dt - G dl,    M_leg = T' M T,  D = T' d(-passive)/dv T,  G = dF/dl

M is MuJoCo's full inertia, armature included. G is the change of the static forces with the
configuration: gravity, and springs of joints and tendons. It is the Hessian of the potential in the
extensions, hence symmetric. Velocity products vanish at rest.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.plant.plant import Plant

_STEP = 1e-3
"""Displacement [m] and speed [m/s] of the central differences; their error is below 1e-6."""


class Mechanics(NamedTuple):
    """The linear mechanics of n actuators."""

    extension: NDArray[np.float64]  #: l [m], (n,).
    load: NDArray[np.float64]  #: F [N], (n,), positive pressing the legs together.
    mass: NDArray[np.float64]  #: M_leg [kg], (n, n).
    damping: NDArray[np.float64]  #: D [N s/m], (n, n).
    stiffness: NDArray[np.float64]  #: G [N/m], (n, n).


def linear_mechanics(plant: Plant, pose: ArrayLike | None = None) -> Mechanics:
    """Linearise the mechanics at rest in a configuration, default neutral; the plant is left there.

    Raises `InputError` for dry friction in the model, a stop or contact that bears there, a leg on
    its stop, or cylinders that do not determine the motion.
    """
    mass = plant.reflected_mass(pose)
    _check_smooth(plant)
    model, data = plant.model, plant.data
    load, extension, motion = plant.static_load(), plant.extensions(), plant.leg_motion()
    rest = data.qpos.copy()
    stiffness, damping = np.empty_like(mass), np.empty_like(mass)
    for leg, direction in enumerate(motion.T):
        along = np.ascontiguousarray(direction)
        static, moving = [], []
        for step in (_STEP, -_STEP):
            data.qpos[:] = rest
            mujoco.mj_integratePos(model, data.qpos, along, step)
            static.append(plant.static_load())
            data.qpos[:], data.qvel[:] = rest, step * direction
            mujoco.mj_forward(model, data)
            moving.append(motion.T @ (data.qfrc_bias - data.qfrc_passive))
            data.qvel[:] = 0.0
        stiffness[:, leg] = (static[0] - static[1]) / (2.0 * _STEP)
        damping[:, leg] = (moving[0] - moving[1]) / (2.0 * _STEP)
    mujoco.mj_forward(model, data)
    return Mechanics(extension, load, mass, damping, stiffness)


def _check_smooth(plant: Plant) -> None:
    model, data = plant.model, plant.data
    for kind, losses, name in (
        ("joint", model.dof_frictionloss, lambda i: model.joint(model.dof_jntid[i]).name),
        ("tendon", model.tendon_frictionloss, lambda i: model.tendon(i).name),
    ):
        for i in np.flatnonzero(losses):
            raise InputError(
                f"frictionloss: {kind} {name(i)!r} of the model has dry friction of "
                f"{losses[i]:g}, which has no linearisation; allowed: 0"
            )
    if (data.efc_type[: data.nefc] != mujoco.mjtConstraint.mjCNSTR_EQUALITY).any():
        raise InputError("pose: a stop or a contact of the model bears there; there must be none")
    cylinder, extension = plant.hydraulics.cylinder, plant.extensions()
    free = cylinder.half_stroke - cylinder.minimum_gap
    for leg in np.flatnonzero(np.abs(extension) >= free):
        raise InputError(
            f"pose: puts {plant.actuators[leg]} at {extension[leg]:.4f} m; "
            f"allowed: +-{free[leg]:.4f} m"
        )
