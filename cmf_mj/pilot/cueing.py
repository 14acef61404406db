"""A flight in the simulator: washout, limits of the machine, what is sensed.

`excursion` compares the peaks of pose and legs, their velocities and accelerations, with the limits
of `motion_limits`. `within_limits` lets the DCL's rate limiters, at the host's rate, hold a
motion back: first the degrees of freedom, then the legs, which share one scale so that the platform
stays on its way. The legs have the last word: while they are held back, a degree of freedom may
pass its limit by a little. What keeps the limits passes to the bit.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.limiter import limit_history, make_leg_limiter, make_pose_limiter
from cmf_mj.facility.host.stream import HostStream
from cmf_mj.machine import models
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.leg_motion import leg_motion_to_pose, pose_motion_to_legs
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion
from cmf_mj.pilot.perception import CueingError, cueing_error
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import WashoutSettings

_POSE_LIMITS = ("displacement", "velocity", "acceleration")
LIMITS = (*_POSE_LIMITS, *(f"leg_{name}" for name in _POSE_LIMITS))
"""What a motion may use up: of the degrees of freedom, and of the legs."""
_TRAVEL = [LIMITS.index("displacement"), LIMITS.index("leg_displacement")]  #: Their rows.


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
    def travel(self) -> float:
        """Largest share of the travel of legs and pose."""
        return float(self.share[_TRAVEL].max())

    @property
    def binding(self) -> str:
        """What comes closest to its limit, or exceeds it most, and where."""
        row, column = np.unravel_index(int(self.share.argmax()), self.share.shape)
        limit = LIMITS[row]
        return f"{limit} of {DOFS[column] if limit in _POSE_LIMITS else f'leg_{column + 1}'}"


def excursion(
    stream: HostStream,
    limits: MotionLimits | None = None,
    machine: str | Path | Machine = models.CMF,
) -> Excursion:
    """Peaks of host frames over the limits of platform and legs, by default the machine's."""
    bounds = load_motion_limits(limits, machine)
    low, high = bounds.operational.T
    legs = pose_to_legs(stream.pose, machine)
    rates = pose_motion_to_legs(stream.pose, stream.velocity, stream.acceleration, machine)
    leg = bounds.leg
    shares = np.array(
        [
            np.maximum(stream.pose / high, stream.pose / low),
            np.abs(stream.velocity) / bounds.velocity,
            np.abs(stream.acceleration) / bounds.acceleration,
            np.abs(legs) / leg.position.si,
            np.abs(rates.velocity) / leg.velocity.si,
            np.abs(rates.acceleration) / leg.acceleration.si,
        ]
    )
    return Excursion(shares.max(axis=1), stream.time[shares.argmax(axis=1)])


def within_limits(
    stream: HostStream,
    limits: MotionLimits | None = None,
    machine: str | Path | Machine = models.CMF,
) -> tuple[HostStream, NDArray[np.bool_]]:
    """Evenly spaced frames from rest, held back where they would leave the limits; and which."""
    if stream.time.size < 2:
        return stream, np.zeros(stream.time.size, dtype=bool)
    bounds = load_motion_limits(limits, machine)
    frame = float(stream.time[-1] - stream.time[0]) / (stream.time.size - 1)
    demand = (stream.pose, stream.velocity, stream.acceleration)
    limited_pose = limit_history(make_pose_limiter(bounds)._replace(frame=frame), *demand)
    pose, velocity = limited_pose.position.copy(), limited_pose.velocity.copy()
    acceleration = limited_pose.acceleration.copy()
    legs = pose_to_legs(pose, machine)
    rates = pose_motion_to_legs(pose, velocity, acceleration, machine)
    limiter = make_leg_limiter(bounds)._replace(frame=frame)
    limited_legs = limit_history(limiter, legs, *rates, together=True)
    rows = (limited_legs.position != legs).any(axis=1)
    if rows.any():
        pose[rows] = legs_to_pose(limited_legs.position[rows], machine)
        velocity[rows], acceleration[rows] = leg_motion_to_pose(
            pose[rows], limited_legs.velocity[rows], limited_legs.acceleration[rows], machine
        )
    is_changed = (pose != stream.pose).any(axis=1)
    return stream._replace(pose=pose, velocity=velocity, acceleration=acceleration), is_changed


class Cue(NamedTuple):
    """A flight as the simulator gives it."""

    settings: WashoutSettings
    aircraft: PilotMotion  #: At the host's frames, from time 0.
    stream: HostStream  #: The host's frames, within the limits.
    limited: NDArray[np.bool_]  #: Frames that the limits held back, (N,).
    excursion: Excursion  #: Of what the washout asked.
    simulator: PilotMotion  #: At the pilot's station, if the machine follows exactly.
    error: CueingError  #: Sensed in flight less sensed in the simulator.
    machine: Machine  #: That it is given with.
    plans: str | None  #: See `Washout.plans`.


def cue(
    motion: PilotMotion,
    washout: str | WashoutSettings = "simona",
    *,
    cab: str | Path | Cab | None = None,
    limits: MotionLimits | None = None,
    rate: float = MOST_RATE,
    lead: float = 0.0,
) -> Cue:
    """Fly a motion at a pilot's station in the simulator, the machine taken as ideal.

    Takes a washout by name, TOML file or loaded parameters, the frames a second `rate` [Hz] and the
    delay `lead` [s] that a predictive one makes up for.
    """
    loaded_cab = load_cab(cab)
    machine = loaded_cab.machine
    algorithm = Washout(washout, cab=loaded_cab, rate=rate, limits=limits, lead=lead)
    aircraft = algorithm.flown(motion)
    demand = algorithm.run(aircraft)
    stream, limited = within_limits(demand, limits, machine)
    simulator = PilotMotion.from_platform(stream, algorithm.station)
    return Cue(
        settings=algorithm.settings,
        aircraft=aircraft,
        stream=stream,
        limited=limited,
        excursion=excursion(demand, limits, machine),
        simulator=simulator,
        error=cueing_error(aircraft, simulator),
        machine=machine,
        plans=algorithm.plans,
    )
