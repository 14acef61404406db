"""Hydraulic modes of the hexapod over its envelope, cab by cab.

With the valves shut the platform rings on the oil of its legs,

    M_leg(x) d2l/dt2 + K(x) l = 0,    M_leg = J^-T M J^-1,

M the inertia about the centroid, J = dl/dx and K the springs of the oil columns, all of
them functions of the pose x. A mode of frequency w and leg shape s (s' M_leg s = 1) has

    mass a leg feels       1 / s's
    share of a degree d    p_d (M p)_d,   p = J^-1 s,   M = J' M_leg J,   their sum is 1

so that single legs have one mode of the mass of their payload. The envelope is every pose within
the operational limits (Table 2-1) whose legs stay within their working stroke (section 3.2.1).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize
from scipy.stats import qmc

from cmf_mj import kinematics
from cmf_mj.kinematics import DOFS, WORKING_STROKE, pose_to_legs
from cmf_mj.motion_limits import MotionLimits, load_motion_limits
from cmf_mj.plant import Hexapod


class ModeSet(NamedTuple):
    """The six modes at one pose, lowest first."""

    cab: str
    pose: NDArray[np.float64]
    """(6,) [m, rad], z down."""
    reflected_mass: NDArray[np.float64]
    """M_leg [kg], (6, 6)."""
    frequency_hz: NDArray[np.float64]
    """(6,) [Hz]."""
    leg_mass: NDArray[np.float64]
    """Mass a leg feels in each mode [kg], (6,)."""
    leg_shape: NDArray[np.float64]
    """A column a mode, unit reflected mass, (6, 6)."""
    pose_shape: NDArray[np.float64]
    """The same as platform motion [m, rad], (6, 6)."""
    share: NDArray[np.float64]
    """Part of each degree of freedom (rows) in the kinetic energy of each mode (columns)."""


class Sweep(NamedTuple):
    """Frequencies along one degree of freedom."""

    dof: str
    excursion: NDArray[np.float64]
    """(n,) [m or rad]."""
    frequency_hz: NDArray[np.float64]
    """(n, 6) [Hz]."""


class PlaneMap(NamedTuple):
    """Frequencies over two degrees of freedom, all others at neutral."""

    dofs: tuple[str, str]
    first: NDArray[np.float64]
    """Excursions of the first degree of freedom [m or rad], (n,)."""
    second: NDArray[np.float64]
    """Of the second, (m,)."""
    frequency_hz: NDArray[np.float64]
    """(n, m, 6) [Hz], NaN outside the envelope."""


class Range(NamedTuple):
    """Frequencies over the whole envelope."""

    poses: NDArray[np.float64]
    """Poses looked at, (n, 6)."""
    frequency_hz: NDArray[np.float64]
    """(n, 6) [Hz]."""
    worst: ModeSet
    """Where the lowest mode is lowest."""


def modes_at(plant: Hexapod, pose: ArrayLike | None = None) -> ModeSet:
    """Modes at a pose, (6,) [m, rad], z down; default neutral."""
    target = np.zeros(6) if pose is None else kinematics.one_pose(pose)
    found = plant.hydraulic_modes(target)
    mass = plant.reflected_mass(target)
    jacobian = kinematics.pose_jacobian(target, plant.geometry)
    momentum = jacobian.T @ mass @ found.leg_shape
    return ModeSet(
        plant.cab,
        target,
        mass,
        found.frequency / (2.0 * np.pi),
        1.0 / np.sum(found.leg_shape**2, axis=0),
        found.leg_shape,
        found.pose_shape,
        found.pose_shape * momentum,
    )


def reserve(pose: ArrayLike, plant: Hexapod) -> float:
    """Stroke left to the leg nearest its working limit [m], negative beyond it."""
    legs = pose_to_legs(np.asarray(pose, dtype=float), plant.geometry)
    return WORKING_STROKE - float(np.abs(legs).max())


def _frequencies(plant: Hexapod, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    return plant.hydraulic_modes(pose).frequency / (2.0 * np.pi)


def _excursions(plant: Hexapod, dof: int, limits: MotionLimits, count: int) -> NDArray[np.float64]:
    """Evenly spaced excursions over the envelope of one degree of freedom, neutral among them."""
    reach = kinematics.excursion_envelope(WORKING_STROKE, plant.geometry)[dof]
    low = max(reach[0], limits.operational[dof, 0])
    high = min(reach[1], limits.operational[dof, 1])
    half = count // 2
    return np.concatenate([np.linspace(low, 0.0, half + 1)[:-1], np.linspace(0.0, high, half + 1)])


def sweep(
    plant: Hexapod, dof: str, *, count: int = 21, limits: MotionLimits | None = None
) -> Sweep:
    """Frequencies along one degree of freedom, neutral included.

    Args:
        plant: the hexapod.
        dof: degree of freedom.
        count: excursions, odd.
        limits: of motion; default the shipped ones.
    """
    index = DOFS.index(dof)
    excursions = _excursions(plant, index, limits or load_motion_limits(), count)
    poses = np.zeros((excursions.size, 6))
    poses[:, index] = excursions
    return Sweep(dof, excursions, np.array([_frequencies(plant, pose) for pose in poses]))


def plane_map(
    plant: Hexapod,
    dofs: tuple[str, str],
    *,
    count: int = 21,
    limits: MotionLimits | None = None,
) -> PlaneMap:
    """Frequencies over two degrees of freedom.

    Args:
        plant: the hexapod.
        dofs: two different degrees of freedom.
        count: excursions along each, odd.
        limits: of motion; default the shipped ones.

    Raises:
        ValueError: twice the same or an unknown degree of freedom.
    """
    if dofs[0] == dofs[1] or not set(dofs) <= set(DOFS):
        raise ValueError(f"dofs: {dofs} must be two different ones of {', '.join(DOFS)}")
    allowed = limits or load_motion_limits()
    indices = [DOFS.index(dof) for dof in dofs]
    first, second = (_excursions(plant, index, allowed, count) for index in indices)
    frequencies = np.full((first.size, second.size, 6), np.nan)
    pose = np.zeros(6)
    for i, j in np.ndindex(first.size, second.size):
        pose[indices] = first[i], second[j]
        # The ends of the axes lie on the envelope itself.
        if reserve(pose, plant) >= -1e-9:
            frequencies[i, j] = _frequencies(plant, pose)
    return PlaneMap(dofs, first, second, frequencies)


def envelope_poses(
    plant: Hexapod, count: int, *, seed: int = 0, limits: MotionLimits | None = None
) -> NDArray[np.float64]:
    """Neutral, and poses spread over the envelope by a scrambled Sobol sequence, (count, 6).

    Args:
        plant: the hexapod.
        count: poses.
        seed: of the scrambling.
        limits: of motion; default the shipped ones.
    """
    low, high = (limits or load_motion_limits()).operational.T
    source = qmc.Sobol(6, seed=seed)
    found = [np.zeros(6)]
    while len(found) < count:
        drawn = low + (high - low) * source.random(256)
        found += [pose for pose in drawn if reserve(pose, plant) >= 0.0]
    return np.array(found[:count])


def over_envelope(
    plant: Hexapod,
    *,
    samples: int = 1000,
    rounds: int = 200,
    seed: int = 0,
    limits: MotionLimits | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Range:
    """Frequencies over the whole envelope, and the pose where the lowest mode is lowest.

    The worst pose is sought by differential evolution from the lowest of the sampled poses, the
    stroke of the legs a constraint.

    Args:
        plant: the hexapod.
        samples: poses looked at, at least 90.
        rounds: generations of the search, at most; with 200 the frequency is within 1e-4.
        seed: of samples and search.
        limits: of motion; default the shipped ones.
        progress: called with (done, in all) now and then.

    Raises:
        ValueError: fewer than 90 samples.
    """
    if samples < 90:
        raise ValueError(f"samples: {samples} must be at least 90")
    allowed = limits or load_motion_limits()
    poses = envelope_poses(plant, samples, seed=seed, limits=allowed)
    frequencies = np.array([_frequencies(plant, pose) for pose in poses])
    tell = progress or (lambda done, total: None)
    tell(1, rounds + 1)
    done = 1

    def passed(intermediate_result: optimize.OptimizeResult) -> None:
        nonlocal done
        done += 1
        tell(min(done, rounds), rounds + 1)

    def lowest(pose: NDArray[np.float64]) -> float:
        # Beyond the mechanical stroke there is no plant to ask.
        if reserve(pose, plant) < 0.0:
            return float(frequencies.max()) - reserve(pose, plant)
        return float(_frequencies(plant, pose)[0])

    found = optimize.differential_evolution(
        lowest,
        list(zip(*allowed.operational.T, strict=True)),
        init=poses[np.argsort(frequencies[:, 0])[:90]],
        maxiter=rounds,
        tol=1e-6,
        rng=np.random.default_rng(seed),
        callback=passed,
        polish=False,
    )
    tell(rounds + 1, rounds + 1)
    return Range(poses, frequencies, modes_at(plant, found.x))


def swinging(
    plant: Hexapod, modes: ModeSet, mode: int, *, stroke: float, frames: int
) -> Sequence[NDArray[np.float64]]:
    """Configurations of one period of a mode, for an animation.

    Args:
        plant: the hexapod; it is left in the last configuration.
        modes: modes at the pose about which it swings.
        mode: index of the mode, 0 the lowest.
        stroke: largest leg motion [m].
        frames: configurations in a period.

    Returns:
        MuJoCo's qpos of each.

    Raises:
        ValueError: a leg would leave its mechanical stroke.
    """
    shape = modes.pose_shape[:, mode] * stroke / np.abs(modes.leg_shape[:, mode]).max()
    found = []
    for phase in 2.0 * np.pi * np.arange(frames) / frames:
        plant.place(modes.pose + np.sin(phase) * shape)
        found.append(plant.data.qpos.copy())
    return found
