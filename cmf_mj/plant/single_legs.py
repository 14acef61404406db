"""The report's original mechanics: six single legs, each a static load and an effective mass.

    m d2x/dt2 = F - W,    of the CMF m = 7200 lbm, W = 7200 lbf    (section 2.4.2, Eq 4.1)

The legs share neither payload nor inertia. In `models/single_legs.xml` they are six vertical slide
joints under a gravity of W / m, so that their weight is W.
"""

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.plant.native import headless
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of
from cmf_mj.plant.plant import Plant, set_timestep


class DesignPoint(NamedTuple):
    """What one leg alone carries."""

    effective_mass: float  #: Inertia that it moves [kg].
    static_load: float  #: Axial load at rest [N].


def design_point(machine: Machine) -> DesignPoint:
    """The design point of a machine's file; what is missing is derived for heave, its first cab.

    Legs whose unit vectors have the vertical parts n_j share payload and weight alike:

        m = M / sum n_j^2,    W = M g / sum n_j

    So the CMF's GFD would have 7199.5 lbm and 5992 lbf; the report states 7200 lbm and 7200 lbf.
    """
    geometry, payload_mass = machine.geometry, load_cab(None, machine).payload.mass
    upward = (geometry.lower[:, 2] - geometry.upper[:, 2]) / geometry.neutral
    effective_mass = payload_mass / float(upward @ upward)
    static_load = payload_mass * units.STANDARD_GRAVITY / float(upward.sum())
    stated = machine.single_leg
    return DesignPoint(
        effective_mass if stated.effective_mass is None else stated.effective_mass.si,
        static_load if stated.static_load is None else stated.static_load.si,
    )


class SingleLegs(Plant):
    """Plant B: six uncoupled legs behind the same contract as the hexapod.

    >>> cmf_mj.SingleLegs().legs
    6
    """

    name = "single_legs"
    stops_end_strokes = True

    def __init__(
        self,
        hydraulics: str | Path | HydraulicParameters | None = None,
        *,
        machine: str | Path | Machine = models.CMF,
        effective_mass: float | None = None,
        static_load: float | None = None,
        timestep: float | None = None,
    ) -> None:
        """Build the six legs.

        Args:
            hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set; default that of
                the machine.
            machine: by name, TOML file or loaded.
            effective_mass: inertia each leg moves [kg]; default `design_point`.
            static_load: constant axial load pressing each leg together [N]; default likewise.
            timestep: mechanical step [s]; default as `set_timestep`.
        """
        motion_base = load_machine(machine)
        default = design_point(motion_base)
        mass = default.effective_mass if effective_mass is None else effective_mass
        load = default.static_load if static_load is None else static_load
        if not 0.0 < mass < np.inf:
            raise InputError(f"effective_mass: {mass} kg must be greater than 0 and finite")
        if not np.isfinite(load):
            raise InputError(f"static_load: {load} N must be finite")
        spec = mujoco.MjSpec.from_file(str(models.model_path("single_legs.xml")))
        set_timestep(spec.option, timestep, motion_base.frame)
        # The load is the weight under a gravity of its own: MuJoCo ignores a negative `gravcomp`.
        spec.option.gravity[2] = -load / mass
        names = [f"leg_{leg}" for leg in range(1, 7)]  # of bodies and joints
        for name in names:
            spec.body(name).mass = mass
            spec.joint(name).range = np.array([-1.0, 1.0]) * motion_base.half_stroke
        model_with_geoms = spec.compile()
        parameters = hydraulics_of(motion_base, hydraulics)
        super().__init__(headless(spec), parameters, payload=names, machine=motion_base)
        self._model_with_geoms = model_with_geoms

    def place(self, pose: ArrayLike) -> None:
        """Put the legs at rest at their extensions, which are `qpos`, at a pose (6,), z down."""
        super().place(pose_to_legs(pose, self.machine))
