"""Whether telemetry is what it says: axes, signs, units, gravity and time, by mechanics.

Three quantities that are sent apart belong together. With the Euler angles e, their rates e', the
specific force f, the angular rate w, the path's speed V and climb h' where they are known, T of
Eq 2.2 and the heading as the direction of the path,

    rates     w = B(e) e'
    force     f = T^T (a - g),    a = d/dt (V cos c cos yaw, V cos c sin yaw, -h'),  sin c = h' / V

If speed and height are unknown, the only thing known of a is that its mean has no vertical part.

Each `Correction` would mend one error, such as a wrong sign. Of all corrections of attitude, rate
and force together the one is taken with the least

    sum over the axes of ln(r + r0),  plus ln 2 for each correction

where r is the rms of what does not fit on an axis: a correction has to halve that on one axis, one
from degrees has to quarter it. One that alters the sum by less than ln 2 is reported as an error
that these data cannot show.
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
_WINDOW = 1.0
"""Length of the moving mean over which misfits are compared [s]; faster is not on the path."""
_SHORTEST = 4.0 * _WINDOW  #: Least length of telemetry [s].
_TOLERANCE = {"rate": 0.003, "force": 0.15, "vertical": 0.5}
"""r0: misfits that do not count [rad/s, m/s^2, m/s^2]; the last without speed and height."""
_LEAST_GAIN = np.log(2.0)  #: By which a correction has to lower the sum.
_GAP_FACTOR, _LEAST_GAP = 3.0, 0.1
"""Intervals are gaps that are longer than this many times the median [-], and than this [s]."""


class Telemetry(NamedTuple):
    """What a simulator sent, in SI and body axes if it is what it says."""

    time: Array  #: [s], (N,).
    specific_force: Array  #: [m/s^2], (N, 3).
    angular_rate: Array  #: [rad/s], (N, 3).
    attitude: Array  #: Roll, pitch, yaw [rad], (N, 3).
    speed: Array  #: Along the path [m/s], (N,). One NaN, of speed or height, drops the whole path.
    height: Array  #: Up [m], NaN where unknown, (N,).


class Correction(NamedTuple):
    """A change of a channel that would mend an error."""

    error: str  #: In words.
    matrix: Array  #: From values to values, (3, 3).
    gravity: float = 0.0  #: How many times gravity in the attitude is added.
    price: float = 1.0  #: [ln 2]. Of degrees 2, since smaller numbers leave smaller misfits.

    def apply(self, values: Array, attitude: Array) -> Array:
        """The channel without the error, each (N, 3)."""
        return values @ self.matrix.T + self.gravity * gravity_in_body(attitude)


class TelemetryVerdict(NamedTuple):
    """What a check found."""

    errors: tuple[str, ...]  #: In words; empty if there is none.
    unseen: tuple[str, ...]  #: Errors that these data could not show.


_UNIT = np.eye(3)


def _swap_matrix(i: int, k: int) -> Array:
    """Matrix that swaps two axes."""
    matrix = np.eye(3)
    matrix[[i, k]] = matrix[[k, i]]
    return matrix


def _axis_errors(channel: str, *axes: str) -> list[Correction]:
    """No error, the sign of each axis, the swap of each pair."""
    signs = [
        Correction(f"{channel} {name} has the wrong sign", _UNIT - 2.0 * np.outer(axis, axis))
        for name, axis in zip(axes, _UNIT, strict=True)
    ]
    swaps = [
        Correction(f"{channel} {axes[i]} and {axes[k]} are swapped", _swap_matrix(i, k))
        for i, k in ((0, 1), (1, 2), (0, 2))
    ]
    return [Correction("", _UNIT, price=0.0), *signs, *swaps]


_ANGLES_IN_DEG = Correction("the angles are in deg, not in rad", DEGREE * _UNIT, price=2.0)
_RATES_IN_DEG = Correction(
    "the angular rates are in deg/s, not in rad/s", DEGREE * _UNIT, price=2.0
)
CORRECTIONS = (
    [*_axis_errors("the angle of", "roll", "pitch", "yaw"), _ANGLES_IN_DEG],
    [*_axis_errors("the angular rate", "p", "q", "r"), _RATES_IN_DEG],
    [
        *_axis_errors("the specific force", "x", "y", "z"),
        Correction("the specific force is in g, not in m/s^2", STANDARD_GRAVITY * _UNIT),
        Correction("gravity is left out: these are accelerations", _UNIT, -1.0),
        Correction("gravity is in twice", _UNIT, 1.0),
        Correction("all three specific forces have the wrong sign", -_UNIT),
    ],
)
"""Of attitude, rate and force, A, R and F of them; the first of each changes nothing."""


def check_telemetry(telemetry: Telemetry) -> TelemetryVerdict:
    """Say what is wrong with telemetry, in words, and what could not be seen."""
    errors, unit = _time_errors(telemetry.time)
    telemetry = telemetry._replace(time=to_si(unit, telemetry.time))
    is_rising = _longest_rising(telemetry.time)
    rising = Telemetry._make(values[is_rising] for values in telemetry)
    if rising.time.size < 2 or rising.time[-1] - rising.time[0] < _SHORTEST:
        return TelemetryVerdict((*errors, f"less than {_SHORTEST:g} s of data"), ())
    misfit = _misfits(rising)
    prices = np.ix_(*([item.price for item in channel] for channel in CORRECTIONS))
    cost = misfit + _LEAST_GAIN * sum(prices)
    cheapest = [Combination(*row) for row in np.argwhere(cost < cost.min() + _LEAST_GAIN)]
    best, *runners_up = sorted(cheapest, key=lambda combination: cost[combination])
    if len(best.errors) == 1:  # what fits as well is as likely
        equally_likely = [item.errors for item in (best, *runners_up) if len(item.errors) == 1]
        errors.append(" or ".join(error for (error,) in equally_likely))
    else:
        errors += best.errors
    return TelemetryVerdict(tuple(errors), _unseen(misfit, best))


class Combination(NamedTuple):
    """A correction of each channel, by its place in `CORRECTIONS`; 0 changes nothing."""

    attitude: int
    rate: int
    force: int

    @property
    def errors(self) -> list[str]:
        """Errors of the channels that are changed."""
        corrections = zip(CORRECTIONS, self, strict=True)
        return [channel[place].error for channel, place in corrections if place]


def _unseen(misfit: Array, best: Combination) -> tuple[str, ...]:
    """Errors that alter the misfit (A, R, F) of the best combination too little to be shown."""
    errors = []
    for name, channel in zip(Combination._fields, CORRECTIONS, strict=True):
        for place, correction in enumerate(channel):
            altered = misfit[best._replace(**{name: place})] - misfit[best]
            if place not in (0, getattr(best, name)) and altered < _LEAST_GAIN:
                errors.append(correction.error)
    return tuple(errors)


def _time_errors(stamps: Array) -> tuple[list[str], str]:
    """Errors of time stamps, and the unit in which they seem to be: s, ms or us."""
    median_step = float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0
    unit = "s"
    if median_step > 1.0:
        unit = "ms" if median_step < 1e3 else "us"
    time, step = to_si(unit, stamps), to_si(unit, median_step)
    steps, errors = np.diff(time), list[str]()
    if (steps <= 0.0).any():
        row = int((steps <= 0.0).argmax()) + 1
        errors.append(f"time does not rise at row {row}, {time[row]:g} s")
    for row in np.flatnonzero(steps > max(_GAP_FACTOR * step, _LEAST_GAP))[:3]:
        errors.append(f"a gap of {steps[row]:.3g} s after {time[row]:g} s; usual: {step:.3g} s")
    if unit != "s":
        errors.append(f"time steps are {median_step:g} s: is time in {unit}?")
    return errors, unit


def _longest_rising(time: Array) -> NDArray[np.bool_]:
    """Which rows are of the longest stretch whose times rise, (N,); a clock set back ends one."""
    latest = np.maximum.accumulate(time)
    rising = np.diff(latest, prepend=-np.inf) > 0.0
    stretch = np.cumsum(latest - time > _LEAST_GAP)
    longest = np.bincount(stretch[rising], minlength=1).argmax()
    return np.asarray(rising & (stretch == longest))


def _misfits(telemetry: Telemetry) -> Array:
    """Sum of ln(r + r0) over the axes for each correction of attitude, rate, force, (A, R, F)."""
    time = telemetry.time - telemetry.time[0]
    even_time = np.arange(0.0, time[-1], 1.0 / _RATE)
    rate = interpolated(even_time, time, telemetry.angular_rate)
    force = interpolated(even_time, time, telemetry.specific_force)
    path = interpolated(even_time, time, np.column_stack([telemetry.speed, telemetry.height]))
    known_path = path if np.isfinite(path).all() else None
    misfits = []
    for attitude in CORRECTIONS[0]:
        angles = np.unwrap(attitude.apply(telemetry.attitude, telemetry.attitude), axis=0)
        angles = interpolated(even_time, time, angles)
        rates, forces = _expected(even_time, angles, known_path)
        rate_costs = _rate_costs(rate, rates, angles, in_deg=attitude is _ANGLES_IN_DEG)
        force_costs = _force_costs(force, forces, angles, path_known=known_path is not None)
        misfits.append(np.add.outer(rate_costs, force_costs))
    return np.array(misfits)


def _rate_costs(rate: Array, expected: Array, angles: Array, *, in_deg: bool) -> list[Array]:
    """Sum of ln(r + r0) over p, q, r for each correction of rates (K, 3), (R,)."""
    costs = []
    for correction in CORRECTIONS[1]:
        rms = _rms(correction.apply(rate, angles) - expected)
        if in_deg and correction is _RATES_IN_DEG:
            rms /= DEGREE  # both in rad, not deg, shrinks the misfit: compare it in the same unit
        costs.append(np.log(rms + _TOLERANCE["rate"]).sum())
    return costs


def _force_costs(force: Array, expected: Array, angles: Array, *, path_known: bool) -> list[Array]:
    """Sum of ln(r + r0) over x, y, z for each correction of forces (K, 3), (F,).

    If the path is unknown, of its acceleration only the mean along the vertical is, which is 0.
    """
    misfits = [correction.apply(force, angles) - expected for correction in CORRECTIONS[2]]
    if path_known:
        return [np.log(_rms(values) + _TOLERANCE["force"]).sum() for values in misfits]
    to_inertial = Rotation.from_euler("ZYX", angles[:, ::-1])
    sinks = (to_inertial.apply(values)[:, 2].mean() for values in misfits)
    return [np.log(_TOLERANCE["vertical"] + abs(sink)) for sink in sinks]


def _expected(time: Array, angles: Array, path: Array | None) -> tuple[Array, Array]:
    """Rate and force that belong to attitudes, and to speed and height on the path if known."""
    pose, velocity, acceleration = np.zeros((3, len(angles), 6))
    pose[:, 3:], velocity[:, 3:] = angles, np.gradient(angles, 1.0 / _RATE, axis=0)
    if path is not None:  # which goes where the nose points: north, east, down
        speed, height = path.T
        climb, heading = np.gradient(height, 1.0 / _RATE), angles[:, 2]
        horizontal_speed = np.sqrt(np.maximum(speed**2 - climb**2, 0.0))
        north, east = horizontal_speed * np.cos(heading), horizontal_speed * np.sin(heading)
        path_velocity = np.column_stack([north, east, -climb])
        acceleration[:, :3] = np.gradient(path_velocity, 1.0 / _RATE, axis=0)
    stream = make_stream(time, pose, velocity, acceleration)
    motion = PilotMotion.from_platform(stream, np.zeros(3))
    return motion.angular_rate, motion.specific_force


def _rms(values: Array) -> Array:
    """Root mean square of the moving mean, by axis, (3,)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, round(_WINDOW * _RATE), axis=0)
    return np.asarray(np.sqrt((windows.mean(axis=-1) ** 2).mean(axis=0)))
