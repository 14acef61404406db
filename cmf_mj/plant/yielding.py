"""Motion bases that stand on what yields: a floor on springs, or legs on soft mounts."""

from typing import NamedTuple

import mujoco
import numpy as np

from cmf_mj.plant.hexapod import Hexapod, hexapod_spec
from cmf_mj.plant.plant import Plant

_PIN_IMPEDANCE, _PIN_DAMPING_TIME = 1e-3, 1e-4  #: d of soft pins; damping over stiffness [s].


class Floor(NamedTuple):
    """What the legs stand on where it yields: a mass on equal springs in x, y and z."""

    mass: float  #: [kg].
    stiffness: float  #: In each direction [N/m].
    damping_ratio: float = 0.03  #: With the machine on it, its legs rigid.


def on_floor(plant: Plant, floor: Floor) -> Hexapod:
    """A motion base whose legs stand on a floor, which does not tilt.

    Its springs bear the weight of all where it is without one.
    """
    cab = plant.cab_parameters
    spec = hexapod_spec(cab, sliding=True)
    total_mass, body = sum(body.mass for body in spec.bodies) + floor.mass, spec.body("floor")
    body.mass, body.inertia, body.explicitinertial = floor.mass, [floor.mass] * 3, True
    for axis in "xyz":
        joint = spec.joint(f"floor_{axis}")
        joint.stiffness[0] = floor.stiffness
        joint.damping[0] = 2.0 * floor.damping_ratio * np.sqrt(floor.stiffness * total_mass)
    spec.joint("floor_z").springref = total_mass * -spec.option.gravity[2] / floor.stiffness
    return Hexapod(cab, plant.parameters, spec=spec, timestep=plant.model.opt.timestep)


def on_mounts(plant: Plant, stiffness: float) -> Plant:
    """A motion base whose legs yield with that stiffness [N/m] between rod ends and platform.

    A soft pin of MuJoCo of impedance d, with the inverse mass w of its ends that the compiler found
    in the pose it began in, is a spring k and a damper c for K = k (1 - d) w and B = c (1 - d) w as
    its direct settings, beside a mass d / (1 - d) / w, here a thousandth.
    """

    def soften(model: mujoco.MjModel) -> None:
        for leg in range(1, 7):
            pin, ends = model.equality(f"gimbal_{leg}"), (f"rod_{leg}", "platform")
            inverse_mass = sum(model.body_invweight0[model.body(end).id, 0] for end in ends)
            direct_stiffness = stiffness * (1.0 - _PIN_IMPEDANCE) * inverse_mass
            pin.solref[:] = -direct_stiffness, -_PIN_DAMPING_TIME * direct_stiffness
            pin.solimp[:2] = _PIN_IMPEDANCE

    return plant.changed(plant.parameters, soften)
