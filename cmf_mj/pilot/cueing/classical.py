"""The classical washout: high-pass filters, tilt coordination, and angles of both.

Structure after Reid and Nahon (UTIAS reports 296, 307 and 319). With f1 the scaled and limited
specific force, e the Euler rates of the scaled and limited angular rate, T from simulator to
inertial axes at the simulator's attitude, g gravity:

    translation   d'' = s^2 / (s^2 + 2 zeta wn s + wn^2) . s / (s + wb) (T f1 + g)    displacement
                        of the pilot's station from neutral, inertial axes
    rotation      A_r = s / (s^2 + 2 zeta wn s + wn^2) e
    tilt          pitch A_t = asin(fL_x / g), roll A_t = -asin(fL_y / g), rate-limited,
                  fL = wl^2 / (s^2 + 2 zeta wl s + wl^2) f1, limited at its input
    attitude      A = A_r + A_t

T f1 + g lacks what the tilt already gives, so that translation and tilt add up to

    f / f1 = H (1 - L) + L

in surge and sway for small angles, H and L the filters: 1 at both ends. The filters are written
with displacement and velocity, or angle, as states, so that position, velocity and acceleration
belong together exactly; `cmf_mj.core.hold` puts them on samples.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.core.compiled import compiled
from cmf_mj.core.hold import Held, advance, hold, read, settled
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.kinematics import rotation
from cmf_mj.pilot.cueing.settings import ClassicalSettings, HighPass, ThirdOrder, Tilted
from cmf_mj.pilot.cueing.tilt import follow, tilt_demand

Matrices = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""A, B, C, D."""


class Classical(NamedTuple):
    """Compiled parameters."""

    rotation: Held  #: Euler rates (3) and their slopes (3) to angles, rates and accelerations (9).
    low_pass: Held  #: Specific force x, y (2) to its low-passed part and two derivatives (6).
    translation: Held  #: T f1 + g (3) to displacement, velocity and acceleration (9).
    tilt_force: float  #: Limit before the low-pass [m/s^2].
    tilt_rate: float  #: R [rad/s].
    recovery: float  #: tau [s].
    interval: float  #: T [s].


class ClassicalState(NamedTuple):
    """State, overwritten by each step."""

    rotation: NDArray[np.float64]
    low_pass: NDArray[np.float64]
    translation: NDArray[np.float64]
    tilt: NDArray[np.float64]  #: Pitch and roll tilt with two derivatives, (2, 3).
    demand: NDArray[np.float64]  #: Their demands, (2, 3).
    turning: NDArray[np.float64]  #: Euler rates and slopes of the last step, (6,).
    pushing: NDArray[np.float64]  #: Low-pass input of the last step, (2,).
    moving: NDArray[np.float64]  #: Translation input of the last step, (3,).


def rotation_filter(axis: HighPass) -> Matrices:
    """Rate and its slope to angle and two derivatives; states integral of angle, angle."""
    wn, zeta = axis.natural_frequency.si, axis.damping.si
    a = np.array([[0.0, 1.0], [-(wn**2), -2.0 * zeta * wn]])
    b = np.array([[0.0, 0.0], [1.0, 0.0]])
    c = np.vstack([[0.0, 1.0], a[1], a[1] @ a])
    d = np.array([[0.0, 0.0], [1.0, 0.0], [a[1, 1], 1.0]])
    return a, b, c, d


def low_pass_filter(axis: Tilted) -> Matrices:
    """Specific force to its low-passed part and two derivatives."""
    wn, zeta = axis.low_pass_frequency.si, axis.low_pass_damping.si
    a = np.array([[0.0, 1.0], [-(wn**2), -2.0 * zeta * wn]])
    b = np.array([[0.0], [wn**2]])
    return a, b, np.vstack([np.eye(2), a[1]]), np.vstack([np.zeros((2, 1)), b[1]])


def translation_filter(axis: ThirdOrder) -> Matrices:
    """Acceleration demanded to displacement and two derivatives."""
    wn, zeta, wb = axis.natural_frequency.si, axis.damping.si, axis.break_frequency.si
    a = np.array([[0.0, 1.0, 0.0], [-(wn**2), -2.0 * zeta * wn, -1.0], [0.0, 0.0, -wb]])
    b = np.array([[0.0], [1.0], [wb]])
    if wb == 0.0:
        a, b = a[:2, :2], b[:2]
    states = len(a)
    return a, b, np.vstack([np.eye(2, states), a[1]]), np.vstack([np.zeros((2, 1)), b[1]])


def side_by_side(systems: list[Matrices], interval: float) -> Held:
    """Systems with equal numbers of inputs and outputs as one, its n-th inputs side by side."""
    a, b, c, d = (linalg.block_diag(*parts) for parts in zip(*systems, strict=True))
    count = len(systems)
    inputs = np.arange(b.shape[1]).reshape(count, -1).T.ravel()
    outputs = np.arange(c.shape[0]).reshape(count, -1).T.ravel()
    return hold(a, b[:, inputs], c[outputs], d[np.ix_(outputs, inputs)], interval)


def make_classical(settings: ClassicalSettings, interval: float) -> Classical:
    """Compiled parameters at samples `interval` [s] apart."""
    turns = (settings.roll, settings.pitch, settings.yaw)
    moves = (settings.surge, settings.sway, settings.heave)
    return Classical(
        side_by_side([rotation_filter(axis) for axis in turns], interval),
        side_by_side([low_pass_filter(axis) for axis in (settings.surge, settings.sway)], interval),
        side_by_side([translation_filter(axis) for axis in moves], interval),
        settings.inputs.tilt_force_limit.si,
        settings.inputs.tilt_rate.si,
        settings.inputs.tilt_recovery.si,
        interval,
    )


def start_classical(
    classical: Classical, euler_rates: NDArray[np.float64], force: NDArray[np.float64]
) -> ClassicalState:
    """State after a long time at constant Euler rates (3,) and specific force f1 (3,)."""
    pushing = np.clip(force[:2], -classical.tilt_force, classical.tilt_force)
    low_pass = settled(classical.low_pass, pushing)
    demand = np.zeros((2, 3))
    _tilt_demands(classical, low_pass, pushing, demand)
    attitude = np.array([-demand[1, 0], demand[0, 0], 0.0])
    moving = rotation(*attitude) @ force + np.array([0.0, 0.0, STANDARD_GRAVITY])
    turning = np.concatenate([euler_rates, np.zeros(3)])
    return ClassicalState(
        settled(classical.rotation, turning),
        low_pass,
        settled(classical.translation, moving),
        demand.copy(),
        demand,
        turning,
        pushing,
        moving,
    )


@compiled
def _tilt_demands(classical, low_pass, pushing, demand):  # type: ignore[no-untyped-def]
    passed = np.empty(6)
    read(classical.low_pass, low_pass, pushing, passed)
    for axis in range(2):
        tilt_demand(passed[axis::2], demand[axis])


@compiled
def move_classical(classical, state, euler_rates, slopes, force, angular, linear):  # type: ignore[no-untyped-def]
    """One sample.

    Args:
        classical: `Classical`.
        state: `ClassicalState`, overwritten.
        euler_rates: e (3,) [rad/s].
        slopes: their change over the last interval [rad/s^2], (3,).
        force: f1 (3,) [m/s^2].
        angular: attitude and two derivatives, (3, 3), overwritten.
        linear: displacement of the pilot's station and two derivatives, inertial axes, (3, 3),
            overwritten.
    """
    work = np.empty(9)
    turning = np.empty(6)
    turning[:3], turning[3:] = euler_rates, slopes
    advance(classical.rotation, state.rotation, state.turning, turning, work)
    read(classical.rotation, state.rotation, turning, angular.reshape(9))
    state.turning[:] = turning

    pushing = np.empty(2)
    demand = np.empty((2, 3))
    for axis in range(2):
        pushing[axis] = min(max(force[axis], -classical.tilt_force), classical.tilt_force)
    advance(classical.low_pass, state.low_pass, state.pushing, pushing, work)
    _tilt_demands(classical, state.low_pass, pushing, demand)
    for axis in range(2):
        follow(
            state.tilt[axis],
            state.demand[axis],
            demand[axis],
            classical.tilt_rate,
            classical.recovery,
            classical.interval,
        )
    state.pushing[:] = pushing
    state.demand[:] = demand
    for order in range(3):
        angular[order, 1] += state.tilt[0, order]
        angular[order, 0] -= state.tilt[1, order]

    moving = rotation(angular[0, 0], angular[0, 1], angular[0, 2]) @ force
    moving[2] += STANDARD_GRAVITY
    advance(classical.translation, state.translation, state.moving, moving, work)
    read(classical.translation, state.translation, moving, linear.reshape(9))
    state.moving[:] = moving
