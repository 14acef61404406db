"""How much of the machine a motion takes, and a motion kept within it.

`excursion` compares the peaks of pose and legs, their velocities and accelerations, with the limits
of `motion_limits`. `within_limits` lets the DCL's rate limiters, at the host's rate, hold a
motion back: first the degrees of freedom, then the legs, which share one scale so that the platform
stays on its way. The legs have the last word: while they are held back, a degree of freedom may
pass its limit by a little. What keeps the limits passes to the bit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.limiter import limit_history, make_leg_limiter, make_pose_limiter
from cmf_mj.facility.host.stream import HostStream
from cmf_mj.machine.kinematics import DOFS, legs_to_pose, pose_to_legs
from cmf_mj.machine.leg_motion import leg_motion_to_pose, pose_motion_to_legs
from cmf_mj.machine.motion_limits import MotionLimits, load_motion_limits

LIMITS = (
    "displacement",
    "velocity",
    "acceleration",
    "leg_displacement",
    "leg_velocity",
    "leg_acceleration",
)
"""What a motion may use up: of the degrees of freedom, and of the legs."""

_LEGS = tuple(f"leg_{leg}" for leg in range(1, 7))


class Excursion(NamedTuple):
    """Peaks of a motion over their limits."""

    share: NDArray[np.float64]
    """Peak over limit, a row for each of `LIMITS`, a column for each degree of freedom or leg,
    (6, 6)."""
    time: NDArray[np.float64]  #: When [s], (6, 6).

    @property
    def largest(self) -> float:
        """Largest share of a limit."""
        return float(self.share.max())

    @property
    def binding(self) -> str:
        """What comes closest to its limit, or exceeds it most, and where."""
        row, column = np.unravel_index(int(self.share.argmax()), self.share.shape)
        return f"{LIMITS[row]} of {(DOFS if row < 3 else _LEGS)[column]}"


class LimitedMotion(NamedTuple):
    """A motion within the limits."""

    stream: HostStream
    limited: NDArray[np.bool_]  #: Frames that differ from the demand, (N,).


def excursion(stream: HostStream, limits: MotionLimits | None = None) -> Excursion:
    """Peaks of host frames over the limits of platform and legs, by default those of Table 2-1."""
    bounds = limits or load_motion_limits()
    low, high = bounds.operational.T
    legs = pose_to_legs(stream.pose)
    rates = pose_motion_to_legs(stream.pose, stream.velocity, stream.acceleration)
    leg = bounds.leg
    used = np.array(
        [
            np.maximum(stream.pose / high, stream.pose / low),
            np.abs(stream.velocity) / bounds.velocity,
            np.abs(stream.acceleration) / bounds.acceleration,
            np.abs(legs) / leg.position.si,
            np.abs(rates.velocity) / leg.velocity.si,
            np.abs(rates.acceleration) / leg.acceleration.si,
        ]
    )
    return Excursion(used.max(axis=1), stream.time[used.argmax(axis=1)])


def within_limits(stream: HostStream, limits: MotionLimits | None = None) -> LimitedMotion:
    """Evenly spaced frames, held back where they would leave the limits; they begin at rest."""
    if stream.time.size < 2:
        return LimitedMotion(stream, np.zeros(stream.time.size, dtype=bool))
    bounds = limits or load_motion_limits()
    frame = float(stream.time[-1] - stream.time[0]) / (stream.time.size - 1)
    demand = (stream.pose, stream.velocity, stream.acceleration)
    platform = limit_history(make_pose_limiter(bounds)._replace(frame=frame), *demand)
    pose, velocity, acceleration = (values.copy() for values in platform[:3])
    legs = pose_to_legs(pose)
    rates = pose_motion_to_legs(pose, velocity, acceleration)
    limited = limit_history(
        make_leg_limiter(bounds)._replace(frame=frame), legs, *rates, together=True
    )
    moved = (limited.position != legs).any(axis=1)
    if moved.any():
        pose[moved] = legs_to_pose(limited.position[moved])
        velocity[moved], acceleration[moved] = leg_motion_to_pose(
            pose[moved], limited.velocity[moved], limited.acceleration[moved]
        )
    changed = (pose != stream.pose).any(axis=1)
    return LimitedMotion(
        stream._replace(pose=pose, velocity=velocity, acceleration=acceleration), changed
    )
