"""What a law is tuned on: nominal modes of each cab, and valves that are not nominal."""

import numpy as np

from cmf_mj.control.coordinates import MODES, Modes
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod, oil_modes
from cmf_mj.plant.parameters.hydraulics import ActuatorChanges, HydraulicParameters
from cmf_mj.plant.plant import Plant

CABS = ("gfd", "rfd", "ifd")
"""The cabs of the facility, lightest first."""

MISMATCH = 0.1
"""Half width of the uniform distribution of each actuator's valve gain about the nominal."""


def nominal_modes(plant: Plant) -> Modes:
    """Hydraulic modes of a plant at neutral: orthonormal shapes of its reflected mass.

    Args:
        plant: with six legs, whose oil springs are alike there.

    Raises:
        InputError: another number of legs, or springs that are not alike.
    """
    if plant.legs != MODES:
        raise InputError(f"plant: {plant.name} has {plant.legs} legs; hydraulic modes need {MODES}")
    hydraulics = plant.hydraulics
    springs = stiffness(hydraulics.cylinder, hydraulics.oil.bulk_modulus, np.zeros(MODES))
    if np.ptp(springs) > 1e-9 * springs.max():
        raise InputError(
            f"hydraulics: springs of {plant.parameters.name} are {springs.min():.6g} to "
            f"{springs.max():.6g} N/m; they must be alike"
        )
    frequency, shapes = oil_modes(plant.reflected_mass(), springs)
    mass = 1.0 / np.sum(shapes**2, axis=0)
    shapes = shapes * np.sqrt(mass)
    shapes = shapes * np.sign(shapes[np.abs(shapes).argmax(axis=0), range(MODES)])
    return Modes(
        source=f"{plant.name} {plant.cab}".strip() + f", {plant.parameters.name} set, at neutral",
        frequency=tuple((frequency / (2.0 * np.pi)).tolist()),
        mass=tuple((mass / units.POUND_MASS).tolist()),
        shape=tuple(tuple(row) for row in shapes.T.tolist()),
    )


def valve_gains(seed: int | None, actuators: int = MODES) -> np.ndarray:
    """Valve gain of each actuator over the nominal; ones for no seed."""
    if seed is None:
        return np.ones(actuators)
    return 1.0 + MISMATCH * np.random.default_rng(seed).uniform(-1.0, 1.0, actuators)


def mismatched(parameters: HydraulicParameters, seed: int | None) -> HydraulicParameters:
    """A hydraulic set whose legs 1 to 6 have the speeds of `valve_gains`.

    Args:
        parameters: the nominal set, all actuators alike.
        seed: of the random gains; None for the nominal set.
    """
    if seed is None:
        return parameters
    speed = parameters.leg_speed
    changed = {
        f"leg_{leg + 1}": ActuatorChanges.model_validate(
            {"leg_speed": speed.model_copy(update={"value": speed.value * float(gain)})}
        )
        for leg, gain in enumerate(valve_gains(seed))
    }
    return parameters.model_copy(
        update={"name": f"{parameters.name}, gains {seed}", "actuators": changed}
    )


def nominal_plants() -> dict[str, Hexapod]:
    """The hexapod with each cab, hardware set."""
    return {cab: Hexapod(cab) for cab in CABS}
