"""Laws in hydraulic modes, bound to the machine that they run on.

A law has the modes of the CMF's cabs, and of any other cab or plant that its table names. For any
other cab they are computed, from the same nominal plant as the CMF's: the cab on its machine's
hydraulic set, of the CMF `hardware`, at neutral.
"""

from functools import lru_cache

import numpy as np

from cmf_mj.control.coordinates import MODES, Modes
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.models import CMF
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod, oil_modes
from cmf_mj.plant.plant import Plant


def nominal_modes(plant: Plant) -> Modes:
    """Hydraulic modes of a plant at neutral: orthonormal shapes of its reflected mass.

    The plant has six legs, whose oil springs are alike there.
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
        follow_pose=isinstance(plant, Hexapod),
    )


@lru_cache
def modes_of_cab(cab: Cab) -> Modes:
    """Hydraulic modes of a cab on its machine's hydraulic set, at neutral."""
    return nominal_modes(Hexapod(cab))


def bound(law: Law, machine: str | Cab | Plant) -> Law:
    """A law bound to a machine, at its control rate and with the sizes of its legs.

    Args:
        law: in legs, which needs no modes, or in hydraulic modes.
        machine: plant or cab, or name of a plant without cabs, which has neither.

    Raises:
        InputError: a law in hydraulic modes has none of a CMF's cab or of a plant without cabs.
    """
    if isinstance(machine, Plant):
        return bound(law, machine.law_key).on(machine.machine)
    if isinstance(machine, str):
        return law.bound_to(machine)
    law = law.on(machine.machine)
    stated = machine.name in law.modes or (machine.own and machine.machine.name == CMF)
    if law.coordinates == "legs" or stated:
        return law.bound_to(machine.name)
    return law.model_copy(update={"modes": {machine.name: modes_of_cab(machine)}})
