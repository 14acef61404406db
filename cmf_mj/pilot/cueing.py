"""A flight in the simulator: washout, limits of the machine, what is sensed; and gains for it.

`excursion` compares the peaks of pose and legs, their velocities and accelerations, with the limits
of `motion_limits`. `within_limits` lets the DCL's rate limiters, at the host's rate, hold a
motion back: first the degrees of freedom, then the legs, which share one scale so that the platform
stays on its way. The legs have the last word: while they are held back, a degree of freedom may
pass its limit by a little. What keeps the limits passes to the bit.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.limiter import limit_history, make_leg_limiter, make_pose_limiter
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.units import STANDARD_GRAVITY
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
from cmf_mj.pilot.perception import CueingError, Senses, cueing_error
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import WashoutSettings, load_washout

LIMITS = (
    *("displacement", "velocity", "acceleration"),
    *("leg_displacement", "leg_velocity", "leg_acceleration"),
)
"""What a motion may use up: of the degrees of freedom, and of the legs."""

DRIVES = ("lane_change", "slalom", "braking", "s_curve", "urban")
"""Names of the drives of `drive`."""

_HALVINGS = 20  #: Bisections for the factor on the gains, which resolve it to 1e-6.


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
        return f"{LIMITS[row]} of {DOFS[column] if row < 3 else f'leg_{column + 1}'}"


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
    platform = limit_history(make_pose_limiter(bounds)._replace(frame=frame), *demand)
    pose, velocity, acceleration = (values.copy() for values in platform[:3])
    legs = pose_to_legs(pose, machine)
    rates = pose_motion_to_legs(pose, velocity, acceleration, machine)
    limiter = make_leg_limiter(bounds)._replace(frame=frame)
    limited = limit_history(limiter, legs, *rates, together=True)
    moved = (limited.position != legs).any(axis=1)
    if moved.any():
        pose[moved] = legs_to_pose(limited.position[moved], machine)
        velocity[moved], acceleration[moved] = leg_motion_to_pose(
            pose[moved], limited.velocity[moved], limited.acceleration[moved], machine
        )
    changed = (pose != stream.pose).any(axis=1)
    return stream._replace(pose=pose, velocity=velocity, acceleration=acceleration), changed


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


def _algorithm(
    washout: str | WashoutSettings, cab: Cab, rate: float, limits: MotionLimits | None
) -> Washout:
    return Washout(washout, station=cab.station, rate=rate, machine=cab.machine, limits=limits)


def cue(
    motion: PilotMotion,
    washout: str | WashoutSettings = "simona",
    *,
    cab: str | Path | Cab | None = None,
    limits: MotionLimits | None = None,
    senses: Senses | str | None = None,
    rate: float = MOST_RATE,
) -> Cue:
    """Fly a motion at a pilot's station in the simulator, the machine taken as ideal.

    Takes a washout by name, TOML file or loaded parameters, and the frames a second `rate` [Hz].
    """
    carried = load_cab(cab)
    algorithm = _algorithm(washout, carried, rate, limits)
    flown = algorithm.flown(motion)
    demanded = algorithm.run(flown)
    stream, limited = within_limits(demanded, limits, carried.machine)
    simulator = PilotMotion.from_platform(stream, algorithm.station)
    return Cue(
        algorithm.settings,
        flown,
        stream,
        limited,
        excursion(demanded, limits, carried.machine),
        simulator,
        cueing_error(flown, simulator, senses),
        carried.machine,
    )


class Tuned(NamedTuple):
    """Gains that just use the envelope."""

    settings: WashoutSettings
    factor: float  #: On the gains that were tuned.
    excursion: Excursion  #: Of the flight with them.
    binding: str  #: What limits the gains: a limit of the machine, or the largest gain allowed.


def tune(
    motion: PilotMotion,
    washout: str | WashoutSettings = "simona",
    *,
    cab: str | Path | Cab | None = None,
    dofs: tuple[str, ...] = DOFS,
    share: float = 1.0,
    largest_gain: float = 1.0,
    limits: MotionLimits | None = None,
    rate: float = MOST_RATE,
) -> Tuned:
    """Scale gains by one factor so that a flight just uses its share of the machine's limits.

    Bisection on the largest share of any limit, which mostly grows with the gains; where it does
    not, the result is a factor at which it crosses, not always the largest. Only the gains of
    `dofs` are scaled, and none of them above `largest_gain`. Refuses what cannot reach the share.
    """
    for name, value in (("share", share), ("largest_gain", largest_gain)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: {value} must be greater than 0")
    settings = load_washout(washout)
    for dof in dofs:
        check_name("dofs", dof, DOFS)
    scaled = np.array([dof in dofs for dof in DOFS])
    if not (settings.gains[scaled] > 0.0).any():
        raise InputError(f"dofs: {', '.join(dofs)} have no gain above 0 to scale")
    carried = load_cab(cab)

    def tried(factor: float) -> Tuned:
        changed = settings.with_gains(np.where(scaled, factor, 1.0) * settings.gains)
        demanded = _algorithm(changed, carried, rate, limits).run(motion)
        use = excursion(demanded, limits, carried.machine)
        return Tuned(changed, factor, use, use.binding)

    top = tried(largest_gain / float(settings.gains[scaled].max()))
    if top.excursion.largest <= share:
        return top._replace(binding="largest gain")
    high, best = top.factor, tried(0.0)
    if best.excursion.largest > share:
        raise InputError(
            f"dofs: the gains left alone use {best.excursion.largest:.3g} of {best.binding}; "
            f"allowed: {share}"
        )
    for _ in range(_HALVINGS):
        middle = tried(0.5 * (best.factor + high))
        if middle.excursion.largest <= share:
            best = middle
        else:
            high = middle.factor
    return best


def _between(time: NDArray[np.float64], begin: float, end: float, rise: float) -> NDArray[Any]:
    """1 from `begin` + `rise` to `end`, 0 before `begin` and after `end` + `rise`, smooth, (N,)."""
    up, down = (np.clip((time - at) / rise, 0.0, 1.0) for at in (begin, end))
    return 0.5 * (np.cos(np.pi * down) - np.cos(np.pi * up))


def drive(name: str) -> PilotMotion:
    """The motion of a road vehicle's driver at 80 Hz, level, by name of `DRIVES`.

    The forward force is dv/dt, the side force v r with r the yaw rate; all corners are cosines.
    """
    check_name("name", name, DRIVES)
    time = np.arange(round(40.0 * MOST_RATE)) / MOST_RATE
    forward, side, start = np.zeros(time.size), np.zeros(time.size), 20.0
    if name == "lane_change":  # out and back again, each one sine of 4 s
        for begin, sign in ((5.0, 1.0), (20.0, -1.0)):
            sine = np.sin(0.5 * np.pi * (time - begin))
            side += sign * 2.5 * sine * ((time >= begin) & (time < begin + 4.0))
    elif name == "slalom":
        side = 2.5 * np.sin(0.5 * np.pi * (time - 5.0)) * _between(time, 5.0, 29.0, 2.0)
    elif name == "braking":  # to rest from 20 m/s, with a jolt at the end
        forward = -4.0 * _between(time, 8.0, 13.0, 0.4) + 1.5 * _between(time, 22.0, 32.0, 1.5)
    elif name == "s_curve":
        side = 2.0 * (_between(time, 5.0, 13.0, 2.0) - _between(time, 15.0, 23.0, 2.0))
    else:  # start, corner, brake, start, two corners, brake
        start = 0.0
        for begin, end, size in ((3.0, 8.0, 2.0), (12.0, 14.0, -2.5), (20.0, 25.0, 1.8)):
            forward += size * _between(time, begin, end, 1.0)
        forward -= 3.0 * _between(time, 32.0, 36.0, 0.7)
        for begin, end, size in ((15.5, 18.0, 2.2), (26.0, 28.0, -2.5), (29.5, 31.5, 2.0)):
            side += size * _between(time, begin, end, 0.8)
    speed = np.maximum(start + np.cumsum(forward) / MOST_RATE, 0.0)
    yaw_rate = side / np.maximum(speed, 5.0)
    zero = np.zeros(time.size)
    return PilotMotion(
        time,
        np.column_stack([forward, side, zero - STANDARD_GRAVITY]),
        np.column_stack([zero, zero, yaw_rate]),
        np.column_stack([zero, zero, np.cumsum(yaw_rate) / MOST_RATE]),
    )


class Judgement(NamedTuple):
    """Objective measures of a cueing; forces and rates as sensed, less those of the start."""

    force_error: float  #: Root mean square of the specific force's error vector [m/s^2].
    rate_error: float  #: Likewise of the angular rate [rad/s].
    force_shape: float  #: Correlation of the specific forces, the three axes as one vector.
    rate_shape: float  #: Likewise of the angular rate.
    false_cues: int  #: Number.
    false_size: float  #: Sum of their peaks over their thresholds.
    tilting: float  #: Share of the time with a roll or pitch rate error above its threshold.
    workspace: float  #: Root mean square of the legs over their working travel.
    travel: float  #: Largest share of the travel of legs and pose.
    limited: int  #: Frames that the limits held back.


def judge(cued: Cue) -> Judgement:
    """Measure a cueing.

    A false cue is a time in which the simulator's force along an axis is sensed beyond its
    threshold while the aircraft's is not, or points the other way. A correlation is that of all
    three axes as one vector, 0 of what does not move.
    """
    error, legs = cued.error, pose_to_legs(cued.stream.pose, cued.machine)
    shapes, sensed = [], []
    for name in ("specific_force", "angular_rate"):
        pair = [getattr(motion, name) for motion in (error.aircraft, error.simulator)]
        pair = [values - values[0] for values in pair]
        size = float(np.linalg.norm(pair[0]) * np.linalg.norm(pair[1]))
        shapes.append(float(np.sum(pair[0] * pair[1])) / size if size > 0.0 else 0.0)
        sensed.append(pair)
    flown, felt = (values / error.threshold[:3] for values in sensed[0])
    false = (np.abs(felt) > 1.0) & ((np.abs(flown) < 1.0) | (felt * flown < 0.0))
    begun = np.diff(false.astype(int), axis=0, prepend=0) > 0
    number = np.cumsum(begun, axis=0) * false
    peaks = [
        float(np.abs(felt[number[:, axis] == cue, axis]).max())
        for axis in range(3)
        for cue in range(1, number[:, axis].max() + 1)
    ]
    total = np.sqrt(np.mean(error.error**2, axis=0))
    turning = np.abs(error.error[:, 3:5]) > error.threshold[3:5]
    working = cued.machine.working_stroke
    return Judgement(
        float(np.linalg.norm(total[:3])),
        float(np.linalg.norm(total[3:])),
        shapes[0],
        shapes[1],
        len(peaks),
        float(np.sum(peaks)),
        float(turning.any(axis=1).mean()),
        float(np.sqrt(np.mean(legs**2)) / working),
        float(cued.excursion.share[[0, 3]].max()),
        int(cued.limited.sum()),
    )
