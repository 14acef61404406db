"""Hydraulic modes of the hexapod over its envelope, cab by cab.

With the valves shut the platform rings on the oil of its legs,

    M_leg(x) d2l/dt2 + K(x) l = 0,    M_leg = J^-T M J^-1,

M the inertia about the centroid, J = dl/dx and K the springs of the oil columns, all of
them functions of the pose x. A mode of frequency w and leg shape s (s' M_leg s = 1) has

    mass a leg feels       1 / s's
    share of a degree d    p_d (M p)_d,   p = J^-1 s,   M = J' M_leg J,   their sum is 1

so that single legs have one mode of the mass of their payload. The envelope is every pose within
the operational limits (Table 2-1) whose legs stay within their working stroke (section 3.2.1).

A law in hydraulic modes is bound to the machine that it runs on. It has the modes of the CMF's
cabs, and of any other cab or plant that its table names. For any other cab they are computed for
the cab on its machine's hydraulic set, of the CMF `hardware`, at neutral.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from cmf_mj.control.coordinates import MODES, Modes
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine import kinematics
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod, HydraulicModes, oil_modes
from cmf_mj.plant.plant import Plant


def nominal_modes(plant: Plant) -> Modes:
    """Hydraulic modes at neutral of a plant with six legs, whose oil springs are alike there."""
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

    The machine is a plant or a cab, or the name of a plant without cabs. Raises `InputError` for a
    law in hydraulic modes that has none of a CMF's cab or of a plant without cabs.
    """
    if isinstance(machine, Plant):
        return bound(law, machine.law_key).for_machine(machine.machine)
    if isinstance(machine, str):
        return law.bound_to(machine)
    law = law.for_machine(machine.machine)
    has_modes = machine.name in law.modes or (machine.unchanged and machine.machine.name == CMF)
    if law.coordinates == "legs" or has_modes:
        return law.bound_to(machine.name)
    return law.model_copy(update={"modes": {machine.name: modes_of_cab(machine)}})


class Sweep(NamedTuple):
    """Frequencies along one degree of freedom."""

    dof: str
    excursion: NDArray[np.float64]  #: (n,) [m or rad].
    frequency_hz: NDArray[np.float64]  #: (n, 6) [Hz].


class EnvelopeModes(NamedTuple):
    """Modes over the whole envelope."""

    modes: tuple[HydraulicModes, ...]  #: At the sampled poses.
    worst: HydraulicModes  #: Where the lowest mode is lowest.

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies there, (n, 6) [Hz]."""
        return np.array([modes.frequency_hz for modes in self.modes])


def reserve(pose: ArrayLike, plant: Hexapod) -> NDArray[np.float64]:
    """Stroke left to the leg nearest its working limit [m] at poses (..., 6), < 0 beyond it."""
    return plant.machine.working_stroke - np.abs(pose_to_legs(pose, plant.machine)).max(axis=-1)


def sweep(plant: Hexapod, dof: str, *, count: int = 21) -> Sweep:
    """Frequencies along one degree of freedom, neutral included, denser to the ends.

    An even `count`, at least 2, becomes the odd one above it.
    """
    if count < 2:
        raise InputError(f"count: {count} must be at least 2")
    index = DOFS.index(dof)
    reach = kinematics.excursion_envelope(None, plant.machine)[index]
    allowed = load_motion_limits(None, plant.machine).operational[index]
    low, high = max(reach[0], allowed[0]), min(reach[1], allowed[1])
    share = np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 2 * (count // 2) + 1))
    excursions = np.where(share < 0.0, -low, high) * share
    poses = np.zeros((excursions.size, 6))
    poses[:, index] = excursions
    frequencies = [plant.hydraulic_modes(pose).frequency_hz for pose in poses]
    return Sweep(dof, excursions, np.array(frequencies))


def envelope_poses(plant: Hexapod, count: int, *, seed: int = 0) -> NDArray[np.float64]:
    """Neutral, and poses spread over the envelope by a scrambled Sobol sequence, (count, 6)."""
    low, high = load_motion_limits(None, plant.machine).operational.T
    from scipy.stats import qmc  # slow to import, and who binds a law needs none of it

    sequence = qmc.Sobol(6, seed=seed)
    poses = [np.zeros(6)]
    while len(poses) < count:
        candidates = low + (high - low) * sequence.random(256)
        poses += list(candidates[reserve(candidates, plant) >= 0.0])
    return np.array(poses[:count])


def over_envelope(
    plant: Hexapod,
    *,
    samples: int = 1000,
    rounds: int = 200,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> EnvelopeModes:
    """Modes over the whole envelope, and the pose where the lowest mode is lowest.

    The worst pose is sought by differential evolution from the lowest of the sampled poses, at
    least 90; with 200 generations (`rounds`) the frequency is within 1e-4. `progress` is called
    with (done, in all).
    """
    if samples < 90:
        raise InputError(f"samples: {samples} must be at least 90")
    poses = envelope_poses(plant, samples, seed=seed)
    sampled_modes = tuple(plant.hydraulic_modes(pose) for pose in poses)
    sampled_hz = np.array([modes.frequency_hz[0] for modes in sampled_modes])
    report, generations = progress or (lambda done, total: None), itertools.count(2)
    report(1, rounds + 1)

    def lowest_hz(pose: NDArray[np.float64]) -> float:
        stroke = float(reserve(pose, plant))
        if stroke < 0.0:  # beyond the mechanical stroke the plant has no modes
            return float(sampled_hz.max()) - stroke
        return float(plant.hydraulic_modes(pose).frequency_hz[0])

    search = optimize.differential_evolution(
        lowest_hz,
        load_motion_limits(None, plant.machine).operational.tolist(),
        init=poses[np.argsort(sampled_hz)[:90]],
        maxiter=rounds,
        tol=1e-6,
        rng=np.random.default_rng(seed),
        callback=lambda intermediate_result: report(min(next(generations), rounds), rounds + 1),
        polish=False,
    )
    report(rounds + 1, rounds + 1)
    return EnvelopeModes(sampled_modes, plant.hydraulic_modes(search.x))
