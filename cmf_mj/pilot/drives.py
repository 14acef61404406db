"""Drives of a road vehicle, as they are or drawn under a seed: manoeuvres to judge washouts on."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import check_name
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.pilot.motion import MOST_RATE, PilotMotion

DRIVES = ("lane_change", "slalom", "braking", "s_curve", "urban")
"""Names of the drives of `drive`."""


def _pulse(time: NDArray[np.float64], begin: float, end: float, rise: float) -> NDArray[Any]:
    """1 from `begin` + `rise` to `end`, 0 before `begin` and after `end` + `rise`, smooth, (N,)."""
    up, down = (np.clip((time - start) / rise, 0.0, 1.0) for start in (begin, end))
    return 0.5 * (np.cos(np.pi * down) - np.cos(np.pi * up))


def drive(name: str, seed: int | None = None) -> PilotMotion:
    """The motion of a road vehicle's driver at 80 Hz, level, by name of `DRIVES`.

    The forward force is dv/dt, also where brakes bring v to 0, the side force v r with r the yaw
    rate, from 5 m/s on, and 5 m/s r below; corners are cosines, those of `lane_change` of sines. A
    seed draws the pace, 0.8 to 1.25 times, the side and, in the order below, the size of each
    force, 0.7 to 1.3 times. All last 40 s; a slow pace leaves out what would come later.
    """
    check_name("name", name, DRIVES)
    generator = np.random.default_rng(seed)
    pace, side_sign = 1.0, 1.0
    if seed is not None:
        pace, side_sign = generator.uniform(0.8, 1.25), generator.choice([-1.0, 1.0])

    def drawn_size(size: float) -> float:
        return size if seed is None else size * generator.uniform(0.7, 1.3)

    time = np.arange(round(40.0 * MOST_RATE)) / MOST_RATE
    phase = time * pace

    def pulse(size: float, begin: float, end: float, rise: float) -> NDArray[Any]:
        return drawn_size(size) * _pulse(phase, begin, end, rise)

    forward, side, start_speed = np.zeros(time.size), np.zeros(time.size), 20.0
    if name == "lane_change":  # out and back again, each one sine of 4 s
        for begin, size in ((5.0, 2.5), (20.0, -2.5)):
            is_turning = (phase >= begin) & (phase < begin + 4.0)
            side += drawn_size(size) * np.sin(0.5 * np.pi * (phase - begin)) * is_turning
    elif name == "slalom":
        sine = np.sin(0.5 * np.pi * (phase - 5.0))
        side = drawn_size(2.5) * sine * _pulse(phase, 5.0, 29.0, 2.0)
    elif name == "braking":  # as they are, to rest from 20 m/s, and on after 8 s
        forward = pulse(-4.0, 8.0, 13.0, 0.4) + pulse(1.5, 22.0, 32.0, 1.5)
    elif name == "s_curve":
        side = pulse(2.0, 5.0, 13.0, 2.0) - pulse(2.0, 15.0, 23.0, 2.0)
    else:  # start, corner, brake, start, two corners, brake
        start_speed = 0.0
        for begin, end, size in ((3.0, 8.0, 2.0), (12.0, 14.0, -2.5), (20.0, 25.0, 1.8)):
            forward += pulse(size, begin, end, 1.0)
        forward -= pulse(3.0, 32.0, 36.0, 0.7)
        for begin, end, size in ((15.5, 18.0, 2.2), (26.0, 28.0, -2.5), (29.5, 31.5, 2.0)):
            side += pulse(size, begin, end, 0.8)
    side *= side_sign
    speed = start_speed + np.cumsum(forward) / MOST_RATE
    reversing = np.maximum(-np.minimum.accumulate(speed), 0.0)  # brakes stop a car, and no more
    speed += reversing
    forward = forward + np.diff(reversing, prepend=0.0) * MOST_RATE
    yaw_rate = side / np.maximum(speed, 5.0)
    zero, yaw = np.zeros(time.size), np.cumsum(yaw_rate) / MOST_RATE
    force = np.column_stack([forward, side, zero - STANDARD_GRAVITY])
    rate, attitude = np.column_stack([zero, zero, yaw_rate]), np.column_stack([zero, zero, yaw])
    return PilotMotion(time, force, rate, attitude)
