"""Whether telemetry is what it says: axes, signs, units, gravity and time, by mechanics.

Three quantities that are sent apart belong together. With the Euler angles e, their rates e', the
specific force f, the angular rate w, the path's speed V and climb h' where they are known, T of
Eq 2.2 and the heading as the direction of the path,

    rates     w = B(e) e'
    force     f = T^T (a - g),    a = d/dt (V cos c cos yaw, V cos c sin yaw, -h'),  sin c = h' / V

If speed and height are unknown, the only thing known of a is that its mean has no vertical part.

Each `Doubt` is a change that would mend an error, such as another sign. Of all changes of attitude,
rate and force together the least

    sum over the axes of ln(r + r0),  plus ln 2 for each change

is taken, r being the rms of what does not fit on an axis: a change has to halve what does not fit,
one from degrees has to quarter it. A doubt that would not matter on these data is one that they
cannot show.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY
from cmf_mj.facility.host.stream import make_stream
from cmf_mj.pilot.motion import PilotMotion, gravity_in_body, interpolated

Array = NDArray[np.float64]

_RATE = 20.0  #: At which telemetry is compared [Hz].

_MEAN = 1.0
"""Of the moving mean before that [s]: faster motion is at the station, not on the path."""

_FLOOR = {"rate": 0.003, "force": 0.15, "vertical": 0.5}
"""r0: what does not count [rad/s, m/s^2]; the last without speed and height."""

_CHANGE = np.log(2.0)

_GAP, _LEAST_GAP = 3.0, 0.1
"""Intervals are gaps that are longer than this many of the median, and than this [s]."""


class Telemetry(NamedTuple):
    """What a simulator sent, in SI and body axes if it is what it says."""

    time: Array  #: [s], (N,).
    specific_force: Array  #: [m/s^2], (N, 3).
    angular_rate: Array  #: [rad/s], (N, 3).
    attitude: Array  #: Roll, pitch, yaw [rad], (N, 3).
    speed: Array  #: Along the path [m/s], NaN where unknown, (N,).
    height: Array  #: [m], NaN where unknown, (N,).


class Doubt(NamedTuple):
    """A change that would mend an error."""

    channel: str  #: attitude, rate or force.
    said: str  #: The error, in words.
    mend: Callable[[Array, Array], Array]  #: Of the channel and the attitude, each (N, 3).


class TelemetryVerdict(NamedTuple):
    """What a check found."""

    errors: tuple[str, ...]  #: In words; empty if there is none.
    unseen: tuple[str, ...]  #: Errors that these data could not show.


def _swapped(*order: int) -> Callable[[Array, Array], Array]:
    return lambda values, _: values[:, order]


def _times(*factors: float) -> Callable[[Array, Array], Array]:
    return lambda values, _: values * factors


def _gravity(times: float) -> Callable[[Array, Array], Array]:
    return lambda values, attitude: values + times * gravity_in_body(attitude)


_SIGNS = ((-1, 1, 1), (1, -1, 1), (1, 1, -1))
_SWAPS = ((1, 0, 2), (0, 2, 1), (2, 1, 0))


def _axes(channel: str, what: str, names: Sequence[str]) -> list[Doubt]:
    signs = [
        Doubt(channel, f"{what} {name} has the wrong sign", _times(*sign))
        for name, sign in zip(names, _SIGNS, strict=True)
    ]
    for order in _SWAPS:
        first, second = (name for k, name in enumerate(names) if order[k] != k)
        signs.append(Doubt(channel, f"{what} {first} and {second} are swapped", _swapped(*order)))
    return signs


_DEGREES = "the angles are in deg, not in rad", "the angular rates are in deg/s, not in rad/s"

DOUBTS = (
    *_axes("attitude", "the angle of", ("roll", "pitch", "yaw")),
    Doubt("attitude", _DEGREES[0], _times(DEGREE)),
    *_axes("rate", "the angular rate", ("p", "q", "r")),
    Doubt("rate", _DEGREES[1], _times(DEGREE)),
    *_axes("force", "the specific force", ("x", "y", "z")),
    Doubt("force", "the specific force is in g, not in m/s^2", _times(STANDARD_GRAVITY)),
    Doubt("force", "gravity is left out: these are accelerations", _gravity(-1.0)),
    Doubt("force", "gravity is in twice", _gravity(1.0)),
    Doubt("force", "all three specific forces have the wrong sign", _times(-1.0)),
)
"""Errors that are looked for."""

_FINE = {name: Doubt(name, "", lambda values, _: values) for name in ("attitude", "rate", "force")}


def check(telemetry: Telemetry) -> TelemetryVerdict:
    """Say what is wrong with telemetry, in words, and what could not be seen."""
    errors = _time_errors(telemetry.time)
    if any(said.endswith("ms?") for said in errors):
        telemetry = telemetry._replace(time=1e-3 * telemetry.time)
    rising = np.diff(telemetry.time, prepend=-np.inf) > 0.0
    kept = Telemetry._make(values[rising] for values in telemetry)
    if kept.time.size < 2 or kept.time[-1] - kept.time[0] < 4.0 * _MEAN:
        return TelemetryVerdict((*errors, f"less than {4.0 * _MEAN:g} s of data"), ())
    costs = _Costs(kept)
    ways = {
        name: [_FINE[name], *(doubt for doubt in DOUBTS if doubt.channel == name)] for name in _FINE
    }
    found = sorted((costs.of(*way), _said(way), way) for way in product(*ways.values()))
    least, said, best = found[0]
    if len(said) == 1:  # what fits as well is as likely
        said = (" or ".join(o[0] for c, o, _ in found if len(o) == 1 and c - least < _CHANGE),)
    errors += said
    base, unseen = costs.misfit(*best), []
    for doubt in DOUBTS:
        tried = [doubt if doubt.channel == was.channel else was for was in best]
        if doubt not in best and costs.misfit(*tried) - base < _CHANGE:
            unseen.append(doubt.said)
    return TelemetryVerdict(tuple(errors), tuple(unseen))


def _said(way: Sequence[Doubt]) -> tuple[str, ...]:
    return tuple(doubt.said for doubt in way if doubt.said)


def _time_errors(time: Array) -> list[str]:
    steps, errors = np.diff(time), list[str]()
    usual = float(np.median(steps)) if steps.size else 0.0
    if (steps <= 0.0).any():
        row = int((steps <= 0.0).argmax()) + 1
        errors.append(f"time does not rise at row {row}, {time[row]:g} s")
    for row in np.flatnonzero(steps > max(_GAP * usual, _LEAST_GAP))[:3]:
        errors.append(f"a gap of {steps[row]:.3g} s after {time[row]:g} s; usual: {usual:.3g} s")
    if usual > 1.0:
        errors.append(f"time steps are {usual:g} s: is time in ms?")
    return errors


class _Costs:
    """Misfits of telemetry with a change in each channel."""

    def __init__(self, telemetry: Telemetry) -> None:
        """Bring all to even times."""
        time = telemetry.time - telemetry.time[0]
        even = np.arange(0.0, time[-1], 1.0 / _RATE)
        self._channels = {
            "attitude": telemetry.attitude,
            "rate": interpolated(even, time, telemetry.angular_rate),
            "force": interpolated(even, time, telemetry.specific_force),
        }
        self._time, self._even = time, even
        path = np.column_stack([telemetry.speed, telemetry.height])
        self._path = interpolated(even, time, path) if np.isfinite(path).all() else None
        self._belongs, self._part = cache(self._expected), cache(self._measured)

    def of(self, *way: Doubt) -> float:
        """The misfit, and what the changes cost."""
        units = sum(said in _DEGREES for said in _said(way))  # dearer: what is small fits easily
        return self.misfit(*way) + _CHANGE * (len(_said(way)) + units)

    def misfit(self, attitude: Doubt, rate: Doubt, force: Doubt) -> float:
        """Sum of ln(r + r0) over the six axes."""
        return self._part(attitude, rate) + self._part(attitude, force)

    def _measured(self, attitude: Doubt, change: Doubt) -> float:
        angles, rates, force = self._belongs(attitude)
        values = change.mend(self._channels[change.channel], angles)
        apart = _mean(values - (rates if change.channel == "rate" else force))
        if change.channel == "force" and self._path is None:
            # On the whole nothing rises or falls; along and across it may do what it likes.
            level = Rotation.from_euler("ZYX", angles[: len(apart), ::-1]).apply(apart)
            return float(np.log(_FLOOR["vertical"] + abs(level[:, 2].mean())))
        rms = np.sqrt((apart**2).mean(axis=0))
        if attitude.said == _DEGREES[0] and change.said == _DEGREES[1]:
            rms /= DEGREE  # if both shrink alike, nothing fits better
        return float(np.log(rms + _FLOOR[change.channel]).sum())

    def _expected(self, attitude: Doubt) -> tuple[Array, Array, Array]:
        """Attitude, and the rate and the force that belong to it."""
        angles = attitude.mend(self._channels["attitude"], self._channels["attitude"])
        angles = interpolated(self._even, self._time, np.unwrap(angles, axis=0))
        pose, velocity, acceleration = np.zeros((3, len(angles), 6))
        pose[:, 3:], velocity[:, 3:] = angles, np.gradient(angles, 1.0 / _RATE, axis=0)
        if self._path is not None:
            speed, height = self._path.T
            acceleration[:, :3] = _acceleration(speed, height, angles[:, 2])
        path = make_stream(self._even, pose, velocity, acceleration)
        motion = PilotMotion.from_platform(path, np.zeros(3))
        return angles, motion.angular_rate, motion.specific_force


def _mean(values: Array) -> Array:
    """Moving mean without its ends."""
    count = round(_MEAN * _RATE)
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return np.asarray((sums[count:] - sums[:-count]) / count)


def _acceleration(speed: Array, height: Array, heading: Array) -> Array:
    """Of a path that goes where the nose points, north, east, down [m/s^2], (N, 3)."""
    climb = np.gradient(height, 1.0 / _RATE)
    level = np.sqrt(np.maximum(speed**2 - climb**2, 0.0))
    velocity = np.column_stack([level * np.cos(heading), level * np.sin(heading), -climb])
    return np.asarray(np.gradient(velocity, 1.0 / _RATE, axis=0))
