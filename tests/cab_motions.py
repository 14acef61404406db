"""Motions of an aircraft's pilot for the tests of cueing."""

import numpy as np
from numpy.typing import NDArray

from cmf_mj.pilot.motion import PilotMotion

G = 9.80665


def level(seconds: float = 20.0, rate: float = 80.0) -> PilotMotion:
    """Level flight, unaccelerated."""
    zero = np.zeros((round(seconds * rate), 3))
    return PilotMotion(np.arange(len(zero)) / rate, zero - [0.0, 0.0, G], zero, zero)


def pushed(axis: int, history: NDArray[np.float64]) -> PilotMotion:
    """Level flight with a specific force (N,) at 80 Hz added along one axis."""
    flown = level(len(history) / 80.0)
    force = flown.specific_force.copy()
    force[:, axis] += history
    return PilotMotion(flown.time, force, flown.angular_rate, flown.attitude)


def turned(axis: int, history: NDArray[np.float64]) -> PilotMotion:
    """Level flight with an angular rate (N,) at 80 Hz added about one axis."""
    flown = level(len(history) / 80.0)
    rate = flown.angular_rate.copy()
    rate[:, axis] += history
    return PilotMotion(flown.time, flown.specific_force, rate, flown.attitude)


def sustained(size: float, seconds: float = 60.0, at: float = 1.0) -> NDArray[np.float64]:
    """Nothing, then `size` from the time `at` on, at 80 Hz."""
    return np.where(np.arange(round(seconds * 80)) >= round(at * 80), size, 0.0)


def turn_entry(bank: float = 20.0, rate: float = 10.0, speed: float = 120.0) -> PilotMotion:
    """A coordinated turn: smooth roll to `bank` [deg] at up to `rate` [deg/s], no side force."""
    time = np.arange(40 * 80) / 80.0
    span = 2.0 * bank / rate
    share = np.clip((time - 5.0) / span, 0.0, 1.0)
    angle = np.radians(bank) * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
    rolling = np.radians(bank) / span * (1.0 - np.cos(2 * np.pi * share))
    turning = G * np.tan(angle) / speed
    zero = np.zeros(time.size)
    return PilotMotion(
        time,
        np.column_stack([zero, zero, -G / np.cos(angle)]),
        np.column_stack([rolling, turning * np.sin(angle), turning * np.cos(angle)]),
        np.column_stack([angle, zero, np.cumsum(turning) / 80.0]),
    )
