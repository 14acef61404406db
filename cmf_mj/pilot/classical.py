"""The classical washout: high-pass filters for motion and angle, and tilt coordination.

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
belong together exactly; `cmf_mj.core.filters` puts them on samples.

The demand A_d of the tilt has the derivatives

    A_d = asin(f / g),    A_d' = f' / (g cos A_d),    A_d'' = (f'' / g + A_d'^2 sin A_d) / cos A_d

with f, f', f'' of the low-pass, which knows its own derivatives. The tilt follows at the rate

    A' = sat(A_d' + (A_d - A) / tau),    |A'| <= R

While sat does not bind, A stays on A_d without lag; a tilt that was held back closes in at the
rate R and joins with the time constant tau. A and A' are continuous; A'' jumps where sat begins or
ends to bind. Over a sample without saturation A comes out exact, e[k+1] = e[k] exp(-T / tau) with
e = A_d - A; with saturation sat's argument is taken as a straight line, an error of the order T^3.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.core.filters import SampledSystem, advance, discretise, settled_state, write_outputs
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.kinematics import rotation
from cmf_mj.pilot.washout_settings import ClassicalSettings, HighPass, ThirdOrder, TiltCoordinated

Array = NDArray[np.float64]


class Matrices(NamedTuple):
    """A system dx/dt = A x + B u, y = C x + D u."""

    a: Array
    b: Array
    c: Array
    d: Array


_ITERATIONS = 8  #: Of the implicit step of the tilt; each contracts by T / (2 tau) or less.


class Sample(NamedTuple):
    """What an algorithm takes in at a frame."""

    euler_rates: Array  #: e [rad/s], (3,).
    slopes: Array  #: Change of the Euler rates over the last interval [rad/s^2], (3,).
    force: Array  #: f1 [m/s^2], (3,).
    known: Array | None = None
    """What a predictive one knows ahead, `inputs` at the knots 2 .. N, (N - 1, 6)."""

    @property
    def inputs(self) -> Array:
        """Euler rates and specific force less that of level rest, (6,)."""
        return np.concatenate([self.euler_rates, self.force + [0.0, 0.0, STANDARD_GRAVITY]])


class HeadMotion(NamedTuple):
    """Motion of the pilot's station in the simulator, inertial axes, with two derivatives."""

    angular: Array  #: Attitude, (3, 3).
    linear: Array  #: Displacement, (3, 3).


class Filter(NamedTuple):
    """A linear filter at work; its arrays are overwritten by each sample."""

    system: SampledSystem
    state: Array  #: (n,).
    inputs: Array  #: Of the last sample, (m,).

    @staticmethod
    def of(system: SampledSystem) -> "Filter":
        """A filter at rest."""
        states, inputs = system.previous_gain.shape
        return Filter(system, np.zeros(states), np.zeros(inputs))

    def start(self, inputs: Array) -> Array:
        """Put it into the state after a long time at constant inputs (m,); its outputs (p,)."""
        self.state[:] = settled_state(self.system, inputs)
        self.inputs[:] = inputs
        outputs = np.empty(len(self.system.output))
        write_outputs(self.system, self.state, self.inputs, outputs)
        return outputs


@allocating
def push_sample(filtering, inputs, out):  # type: ignore[no-untyped-def]
    """Move a filter to the next sample, with inputs (m,), and write its outputs (p,)."""
    work = np.empty(filtering.state.size)
    advance(filtering.system, filtering.state, filtering.inputs, inputs, work)
    filtering.inputs[:] = inputs
    write_outputs(filtering.system, filtering.state, inputs, out)


class Classical(NamedTuple):
    """The algorithm at work; its arrays are overwritten by each sample."""

    rotation: Filter
    """Euler rates (3) and their slopes (3) to angles, rates and accelerations (9)."""
    low_pass: Filter  #: Specific force x, y (2) to its low-passed part and two derivatives (6).
    translation: Filter  #: T f1 + g (3) to displacement, velocity and acceleration (9).
    tilt: Array  #: In pitch, and in roll with its sign reversed, with two derivatives, (2, 3).
    demand: Array  #: Demands of the same, (2, 3).
    tilt_force: float  #: Limit before the low-pass [m/s^2].
    tilt_rate: float  #: R [rad/s].
    recovery: float  #: tau [s].
    interval: float  #: T [s].

    def start(self, sample: Sample, head: HeadMotion) -> None:
        """Begin with a sample that was constant for long, without slopes; overwrites `head`."""
        limited_force = np.clip(sample.force[:2], -self.tilt_force, self.tilt_force)
        _tilt_demands(self.low_pass.start(limited_force), self.demand)
        self.tilt[:] = self.demand
        to_inertial = rotation(-self.tilt[1, 0], self.tilt[0, 0], 0.0)
        gravity = np.array([0.0, 0.0, STANDARD_GRAVITY])
        self.translation.start(to_inertial @ sample.force + gravity)
        self.rotation.start(np.concatenate([sample.euler_rates, np.zeros(3)]))
        self.move(sample, head)  # the same inputs again change nothing: this reads the outputs

    def move(self, sample: Sample, head: HeadMotion) -> None:
        """Take in a sample; overwrites the motion of the head."""
        _move(self, sample, head)


def rotation_filter(axis: HighPass) -> Matrices:
    """Rate and its slope to angle and two derivatives; states integral of angle, angle."""
    wn, zeta = axis.natural_frequency.si, axis.damping.si
    a = np.array([[0.0, 1.0], [-(wn**2), -2.0 * zeta * wn]])
    b = np.array([[0.0, 0.0], [1.0, 0.0]])
    c = np.vstack([[0.0, 1.0], a[1], a[1] @ a])
    d = np.array([[0.0, 0.0], [1.0, 0.0], [a[1, 1], 1.0]])
    return Matrices(a, b, c, d)


def low_pass_filter(axis: TiltCoordinated) -> Matrices:
    """Specific force to its low-passed part and two derivatives."""
    wn, zeta = axis.low_pass_frequency.si, axis.low_pass_damping.si
    a = np.array([[0.0, 1.0], [-(wn**2), -2.0 * zeta * wn]])
    return _with_derivatives(a, np.array([[0.0], [wn**2]]))


def translation_filter(axis: ThirdOrder) -> Matrices:
    """Acceleration demanded to displacement and two derivatives."""
    wn, zeta, wb = axis.natural_frequency.si, axis.damping.si, axis.break_frequency.si
    a = np.array([[0.0, 1.0, 0.0], [-(wn**2), -2.0 * zeta * wn, -1.0], [0.0, 0.0, -wb]])
    count = 2 if wb == 0.0 else 3
    return _with_derivatives(a[:count, :count], np.array([[0.0], [1.0], [wb]])[:count])


def _with_derivatives(a: Array, b: Array) -> Matrices:
    """A system that puts out its first state and two derivatives; its second is the first one's."""
    outputs = np.vstack([np.eye(2, len(a)), a[1]])
    return Matrices(a, b, outputs, np.vstack([np.zeros((2, 1)), b[1]]))


def side_by_side(systems: list[Matrices], interval: float) -> SampledSystem:
    """Equal-sized systems as one, its inputs and outputs ordered by signal, then by system."""
    a, b, c, d = (linalg.block_diag(*matrices) for matrices in zip(*systems, strict=True))

    def by_signal(size: int) -> NDArray[np.int64]:
        """Indices by signal, then system, of signals that stand by system, then signal."""
        return np.arange(size).reshape(len(systems), -1).T.ravel()

    inputs, outputs = by_signal(b.shape[1]), by_signal(c.shape[0])
    return discretise(a, b[:, inputs], c[outputs], d[np.ix_(outputs, inputs)], interval)


def make_classical(settings: ClassicalSettings, interval: float) -> Classical:
    """The algorithm at samples `interval` [s] apart; `start` begins."""
    surge, sway, inputs = settings.surge, settings.sway, settings.inputs
    if inputs.tilt_recovery.si <= 0.5 * interval:
        raise InputError(
            f"inputs: tilt_recovery: {inputs.tilt_recovery} is refused; allowed: more than half an "
            f"interval between samples, {0.5 * interval:.4g} s"
        )
    rotations = [rotation_filter(axis) for axis in (settings.roll, settings.pitch, settings.yaw)]
    translations = [translation_filter(axis) for axis in (surge, sway, settings.heave)]
    return Classical(
        rotation=Filter.of(side_by_side(rotations, interval)),
        low_pass=Filter.of(side_by_side([low_pass_filter(surge), low_pass_filter(sway)], interval)),
        translation=Filter.of(side_by_side(translations, interval)),
        tilt=np.zeros((2, 3)),
        demand=np.zeros((2, 3)),
        tilt_force=inputs.tilt_force_limit.si,
        tilt_rate=inputs.tilt_rate.si,
        recovery=inputs.tilt_recovery.si,
        interval=interval,
    )


@allocating
def _tilt_demands(low_passed, demand):  # type: ignore[no-untyped-def]
    """Write A_d, A_d', A_d'' of pitch and minus roll (2, 3) of f, f', f'' along x and y (6,)."""
    for axis in range(2):
        force, out = low_passed[axis::2], demand[axis]
        sine = force[0] / STANDARD_GRAVITY
        cosine = np.sqrt(1.0 - sine * sine)
        out[0] = np.arcsin(sine)
        out[1] = force[1] / (STANDARD_GRAVITY * cosine)
        out[2] = (force[2] / STANDARD_GRAVITY + out[1] * out[1] * sine) / cosine


@allocating
def _saturation_integral(value, limit):  # type: ignore[no-untyped-def]
    """Integral of sat from 0 to `value`."""
    size = abs(value)
    return 0.5 * value * value if size <= limit else limit * size - 0.5 * limit * limit


@allocating
def _mean_saturation(first, last, limit):  # type: ignore[no-untyped-def]
    """Mean of sat along the straight line from `first` to `last`."""
    if abs(last - first) <= 1e-9 * limit:
        return min(max(0.5 * (first + last), -limit), limit)
    integral = _saturation_integral(last, limit) - _saturation_integral(first, limit)
    return integral / (last - first)


@allocating
def follow(tilt, demand, new_demand, limit, recovery, interval):  # type: ignore[no-untyped-def]
    """Move the tilt A, A', A'' (3,) in place by one sample of T = `interval` [s].

    `demand` and `new_demand` are A_d and its derivatives (3,) at the sample before and at this one,
    `limit` is R [rad/s], `recovery` tau [s], above T / 2.
    """
    error = demand[0] - tilt[0]
    sought_rate = demand[1] + error / recovery
    angle = new_demand[0] - error * np.exp(-interval / recovery)
    new_error = new_demand[0] - angle
    new_sought_rate = new_demand[1] + new_error / recovery
    if max(abs(sought_rate), abs(new_sought_rate)) > limit:
        for _ in range(_ITERATIONS):
            angle = tilt[0] + interval * _mean_saturation(sought_rate, new_sought_rate, limit)
            new_error = new_demand[0] - angle
            new_sought_rate = new_demand[1] + new_error / recovery
    tilt[0] = angle
    if abs(new_sought_rate) > limit:
        tilt[1], tilt[2] = np.copysign(limit, new_sought_rate), 0.0
    else:
        tilt[1], tilt[2] = new_sought_rate, new_demand[2] - new_error / recovery**2


@allocating
def _move(classical, sample, head):  # type: ignore[no-untyped-def]
    rates_and_slopes = np.empty(6)
    rates_and_slopes[:3], rates_and_slopes[3:] = sample.euler_rates, sample.slopes
    push_sample(classical.rotation, rates_and_slopes, head.angular.reshape(9))

    force, limit = sample.force, classical.tilt_force
    limited_force, low_passed, demand = np.empty(2), np.empty(6), np.empty((2, 3))
    for axis in range(2):
        limited_force[axis] = min(max(force[axis], -limit), limit)
    push_sample(classical.low_pass, limited_force, low_passed)
    _tilt_demands(low_passed, demand)
    limits = (classical.tilt_rate, classical.recovery, classical.interval)
    for axis in range(2):
        follow(classical.tilt[axis], classical.demand[axis], demand[axis], *limits)
    classical.demand[:] = demand
    for order in range(3):
        head.angular[order, 1] += classical.tilt[0, order]
        head.angular[order, 0] -= classical.tilt[1, order]

    roll, pitch, yaw = head.angular[0]
    acceleration = rotation(roll, pitch, yaw) @ force
    acceleration[2] += STANDARD_GRAVITY
    push_sample(classical.translation, acceleration, head.linear.reshape(9))
