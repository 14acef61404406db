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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.core.units import DEGREE, STANDARD_GRAVITY, to_si
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
    """A change of a channel that would mend an error."""

    said: str  #: The error, in words.
    matrix: Array  #: From values to values, (3, 3).
    gravity: float = 0.0  #: How many times gravity in the attitude is added.
    price: float = 1.0  #: In `_CHANGE`; a unit's is higher, since what is small fits easily.

    def mend(self, values: Array, attitude: Array) -> Array:
        """The channel without the error, each (N, 3)."""
        return values @ self.matrix.T + self.gravity * gravity_in_body(attitude)


class TelemetryVerdict(NamedTuple):
    """What a check found."""

    errors: tuple[str, ...]  #: In words; empty if there is none.
    unseen: tuple[str, ...]  #: Errors that these data could not show.


def _axes(what: str, *names: str) -> list[Doubt]:
    """No change of a channel, and those of its axes."""
    one = np.eye(3)
    signs = [
        Doubt(f"{what} {name} has the wrong sign", one - 2.0 * np.outer(axis, axis))
        for name, axis in zip(names, one, strict=True)
    ]
    swaps = [
        Doubt(f"{what} {names[i]} and {names[k]} are swapped", one[order])
        for i, k, order in ((0, 1, [1, 0, 2]), (1, 2, [0, 2, 1]), (0, 2, [2, 1, 0]))
    ]
    return [Doubt("", one, price=0.0), *signs, *swaps]


_ONE = np.eye(3)
_DEGREES = (
    Doubt("the angles are in deg, not in rad", DEGREE * _ONE, price=2.0),
    Doubt("the angular rates are in deg/s, not in rad/s", DEGREE * _ONE, price=2.0),
)
DOUBTS = (
    [*_axes("the angle of", "roll", "pitch", "yaw"), _DEGREES[0]],
    [*_axes("the angular rate", "p", "q", "r"), _DEGREES[1]],
    [
        *_axes("the specific force", "x", "y", "z"),
        Doubt("the specific force is in g, not in m/s^2", STANDARD_GRAVITY * _ONE),
        Doubt("gravity is left out: these are accelerations", _ONE, -1.0),
        Doubt("gravity is in twice", _ONE, 1.0),
        Doubt("all three specific forces have the wrong sign", -_ONE),
    ],
)
"""Errors of attitude, rate and force that are looked for; the first of each is none."""


def check_telemetry(telemetry: Telemetry) -> TelemetryVerdict:
    """Say what is wrong with telemetry, in words, and what could not be seen."""
    errors, unit = _time_errors(telemetry.time)
    telemetry = telemetry._replace(time=to_si(unit, telemetry.time))
    rows = _longest_rising(telemetry.time)
    kept = Telemetry._make(values[rows] for values in telemetry)
    if kept.time.size < 2 or kept.time[-1] - kept.time[0] < 4.0 * _MEAN:
        return TelemetryVerdict((*errors, f"less than {4.0 * _MEAN:g} s of data"), ())
    misfit, prices = _misfits(kept), ([doubt.price for doubt in doubts] for doubts in DOUBTS)
    cost = misfit + _CHANGE * sum(np.ix_(*prices))
    ways = [tuple(way) for way in np.argwhere(cost < cost.min() + _CHANGE)]
    best, *others = sorted(ways, key=lambda way: cost[way])
    if len(_said(best)) == 1:  # what fits as well is as likely
        alike = [said[0] for said in map(_said, [best, *others]) if len(said) == 1]
        errors.append(" or ".join(alike))
    else:
        errors += _said(best)
    unseen = []
    for channel, doubts in enumerate(DOUBTS):
        for number, doubt in enumerate(doubts):
            tried = (*best[:channel], number, *best[channel + 1 :])
            if number not in (0, best[channel]) and misfit[tried] - misfit[best] < _CHANGE:
                unseen.append(doubt.said)
    return TelemetryVerdict(tuple(errors), tuple(unseen))


def _said(way: tuple[int, ...]) -> list[str]:
    """The errors of attitude, rate and force, by their places in `DOUBTS`."""
    return [doubts[k].said for doubts, k in zip(DOUBTS, way, strict=True) if k]


def _time_errors(stamps: Array) -> tuple[list[str], str]:
    """Errors of time stamps, and the unit in which they seem to be: s, ms or us."""
    usual = float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
    unit = "s" if usual <= 1.0 else "ms" if usual < 1e3 else "us"
    time, step = to_si(unit, stamps), to_si(unit, usual)
    steps, errors = np.diff(time), list[str]()
    if (steps <= 0.0).any():
        row = int((steps <= 0.0).argmax()) + 1
        errors.append(f"time does not rise at row {row}, {time[row]:g} s")
    for row in np.flatnonzero(steps > max(_GAP * step, _LEAST_GAP))[:3]:
        errors.append(f"a gap of {steps[row]:.3g} s after {time[row]:g} s; usual: {step:.3g} s")
    if unit != "s":
        errors.append(f"time steps are {usual:g} s: is time in {unit}?")
    return errors, unit


def _longest_rising(time: Array) -> NDArray[np.bool_]:
    """Which rows are of the longest stretch whose times rise, (N,); a clock set back ends one."""
    latest = np.maximum.accumulate(time)
    rising = np.diff(latest, prepend=-np.inf) > 0.0
    stretch = np.cumsum(latest - time > _LEAST_GAP)
    longest = np.bincount(stretch[rising], minlength=1).argmax()
    return np.asarray(rising & (stretch == longest))


def _misfits(sent: Telemetry) -> Array:
    """Sum of ln(r + r0) over the six axes for each change of attitude, rate and force."""
    time = sent.time - sent.time[0]
    even = np.arange(0.0, time[-1], 1.0 / _RATE)
    rate, force, path = (
        interpolated(even, time, values)
        for values in (
            sent.angular_rate,
            sent.specific_force,
            np.column_stack([sent.speed, sent.height]),
        )
    )
    known = bool(np.isfinite(path).all())
    rows = []
    for attitude in DOUBTS[0]:
        angles = np.unwrap(attitude.mend(sent.attitude, sent.attitude), axis=0)
        angles = interpolated(even, time, angles)
        rates, forces = _expected(even, angles, path if known else None)
        turned = []
        for doubt in DOUBTS[1]:
            rms = _rms(doubt.mend(rate, angles) - rates)
            if attitude is _DEGREES[0] and doubt is _DEGREES[1]:
                rms /= DEGREE  # if both shrink alike, nothing fits better
            turned.append(np.log(rms + _FLOOR["rate"]).sum())
        apart = [doubt.mend(force, angles) - forces for doubt in DOUBTS[2]]
        if known:
            pushed = [np.log(_rms(values) + _FLOOR["force"]).sum() for values in apart]
        else:  # on the whole nothing rises or falls; along and across it may do what it likes
            level = Rotation.from_euler("ZYX", angles[:, ::-1])
            rises = (level.apply(values)[:, 2].mean() for values in apart)
            pushed = [np.log(_FLOOR["vertical"] + abs(rise)) for rise in rises]
        rows.append(np.add.outer(turned, pushed))
    return np.array(rows)


def _expected(time: Array, angles: Array, path: Array | None) -> tuple[Array, Array]:
    """Rate and force that belong to attitudes, and to speed and height on the path if known."""
    pose, velocity, acceleration = np.zeros((3, len(angles), 6))
    pose[:, 3:], velocity[:, 3:] = angles, np.gradient(angles, 1.0 / _RATE, axis=0)
    if path is not None:  # which goes where the nose points: north, east, down
        speed, height = path.T
        climb = np.gradient(height, 1.0 / _RATE)
        level, heading = np.sqrt(np.maximum(speed**2 - climb**2, 0.0)), angles[:, 2]
        along = np.column_stack([level * np.cos(heading), level * np.sin(heading), -climb])
        acceleration[:, :3] = np.gradient(along, 1.0 / _RATE, axis=0)
    stream = make_stream(time, pose, velocity, acceleration)
    motion = PilotMotion.from_platform(stream, np.zeros(3))
    return motion.angular_rate, motion.specific_force


def _mean(values: Array) -> Array:
    """Moving mean without its ends."""
    window = np.lib.stride_tricks.sliding_window_view(values, round(_MEAN * _RATE), axis=0)
    return np.asarray(window.mean(axis=-1))


def _rms(values: Array) -> Array:
    """Root mean square of the moving mean, by axis."""
    return np.asarray(np.sqrt((_mean(values) ** 2).mean(axis=0)))
