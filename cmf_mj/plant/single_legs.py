"""The report's original mechanics: six single legs, each a static load and an effective mass.

    m d2x/dt2 = F - W,    m = 7200 lbm,  W = 7200 lbf    (section 2.4.2, Eq 4.1)

The legs share neither payload nor inertia. In `models/single_legs.xml` they are six vertical slide
joints whose weight at standard gravity is exactly the stated load.
"""

from pathlib import Path
from typing import Any

import mujoco
from numpy.typing import ArrayLike

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.plant.headless import headless
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.plant import Plant

EFFECTIVE_MASS = 7200.0 * units.POUND_MASS
"""Effective mass of a leg at the design point [kg] (section 4.1)."""

STATIC_LOAD = 7200.0 * units.POUND_FORCE
"""Static load of a leg at the design point [N] (section 4.1)."""


class SingleLegs(Plant):
    """Plant B: six uncoupled legs behind the same contract as the hexapod.

    >>> cmf_mj.SingleLegs().legs
    6
    """

    name = "single_legs"
    stops_end_strokes = True

    def __init__(
        self,
        hydraulics: str | Path | HydraulicParameters = "hardware",
        *,
        effective_mass: float = EFFECTIVE_MASS,
        static_load: float = STATIC_LOAD,
        timestep: float | None = None,
    ) -> None:
        """Build the six legs.

        Args:
            hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set.
            effective_mass: inertia each leg moves [kg].
            static_load: constant axial load pressing each leg together [N].
            timestep: mechanical step [s]; default one control frame.

        Raises:
            InputError: a mass or step that is not positive, a half stroke other than the model's
                stops, or refused hydraulics.
        """
        if not effective_mass > 0.0:
            raise InputError(f"effective_mass: {effective_mass} kg must be greater than 0")
        spec = mujoco.MjSpec.from_file(str(models.model_path("single_legs.xml")))
        set_timestep(spec.option, timestep)
        # The load is the weight under a gravity of its own: MuJoCo ignores a negative `gravcomp`.
        spec.option.gravity[2] = -static_load / effective_mass
        for leg in range(1, 7):
            spec.body(f"leg_{leg}").mass = effective_mass
        self._drawn = spec.compile()
        bodies = [f"leg_{leg}" for leg in range(1, 7)]
        super().__init__(headless(spec), hydraulics, payload=bodies)

    def place(self, pose: ArrayLike) -> None:
        """Set each leg to its extension at the pose."""
        super().place(pose_to_legs(pose))


def set_timestep(option: Any, timestep: float | None) -> None:
    """Set the mechanical step [s] in the options of a model; None leaves it."""
    if timestep is None:
        return
    if not timestep > 0.0:
        raise InputError(f"timestep: {timestep} s must be greater than 0")
    option.timestep = timestep
