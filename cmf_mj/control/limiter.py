"""Limit calculations with graceful deceleration: a demand made feasible, frame by frame.

One channel (a leg or a degree of freedom) has the position range [low, high], the largest speed V
and the largest acceleration A. With T the frame, p the output and v[k] = (p[k] - p[k-1]) / T:

**Bounds.** Braking at A from v leaves the positions p + T (v - A T) + T (v - 2 A T) + ... Within
the distance R to a limit the next velocity may be at most

    b(R) = (R / T + A T n (n + 1) / 2) / (n + 1),    n = floor((sqrt(1 + 8 R / (A T^2)) - 1) / 2),

the braking parabola in discrete time: from b(R) at A the channel stops on the limit exactly. So

    max(v - A T, -V, -b(p - low)) <= v' <= min(v + A T, V, b(high - p))

is never empty once it holds, and a channel in it keeps all three limits for ever.

**Demand.** With d the demand and the lag e = d - p, the wish is

    p'[k+1] = d[k+1] - e',    e' = e - sgn(e) T c(|e|),

where c is b with a share of A, `rejoin` A. The wish closes in on the demand along a parabola that
ends, after a finite number of frames, at e' = 0 to the bit, without overshoot where the demand
accelerates by less than the other share and moves slower than V. The output is the wish, moved into
the bounds: while the demand keeps them the output *is* the demand, bit by bit. Nothing winds up:
the lag is the difference of two positions. The output waits at a limit for a demand outside.

`step` bounds each channel alone, which distorts the pose of legs. `step_together` shares one scale:
from rest all channels follow one straight line between old and new demand, and all brake together
when one can go no further. It brakes in proportion, v - s v with s = A T / max |v| (the least over
channels with their own A), and takes the largest share of the way from there to the wish that all
bounds allow and from which braking in proportion still ends within all ranges. That takes longer
than braking alone. Do not change between the two in motion.

Jerk has no limit. Source: R. Zanasi, C. Guarino Lo Bianco, A. Tonielli, Automatica 36 (2000).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import FRAME
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.motion_limits import load_motion_limits

_HALVINGS = 40  #: Bisections that find the shared scale to 1e-12.


class Limiter(NamedTuple):
    """Compiled limits, every array (n,), SI."""

    low: NDArray[np.float64]  #: Lowest position [m or rad].
    high: NDArray[np.float64]  #: Highest position [m or rad].
    velocity: NDArray[np.float64]  #: V [1/s of the position].
    acceleration: NDArray[np.float64]  #: A [1/s^2 of the position].
    rejoin: float  #: Share of A that closes in on the demand, above 0, at most 1.
    frame: float  #: T [s].


class LimiterState(NamedTuple):
    """State of the limiter, every array (n,)."""

    position: NDArray[np.float64]  #: p, the position put out last.
    velocity: NDArray[np.float64]  #: v, the change of the last two positions over T.
    lag: NDArray[np.float64]  #: e, the last demand less p; exactly 0 while the demand is followed.


def make_limiter(
    low: ArrayLike,
    high: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    rejoin: float = 0.5,
    frame: float = FRAME,
) -> Limiter:
    """Limiter of channels with any positions, speeds and accelerations, (n,) each."""
    channels = {"low": low, "high": high, "velocity": velocity, "acceleration": acceleration}
    arrays = {name: np.array(values, dtype=float) for name, values in channels.items()}
    return Limiter(**arrays, rejoin=rejoin, frame=frame)


def make_leg_limiter(
    limits: MotionLimits | None = None, legs: int = 6, frame: float = FRAME
) -> Limiter:
    """Limiter of leg demands: working stroke, leg speed and acceleration; default the CMF's."""
    leg = (limits or load_motion_limits()).leg
    travel, velocity = np.full(legs, leg.position.si), np.full(legs, leg.velocity.si)
    acceleration = np.full(legs, leg.acceleration.si)
    return make_limiter(-travel, travel, velocity, acceleration, leg.rejoin.si, frame)


def make_pose_limiter(limits: MotionLimits | None = None, frame: float = FRAME) -> Limiter:
    """Limiter of pose demands: operational limits of Table 2-1 and the rates assumed with them."""
    limits = limits or load_motion_limits()
    (low, high), rejoin = limits.operational.T, limits.leg.rejoin.si
    return make_limiter(low, high, limits.velocity, limits.acceleration, rejoin, frame)


def start(limiter: Limiter, position: ArrayLike) -> LimiterState:
    """State of a limiter at rest at `position` (n,), moved into the range."""
    p = np.clip(np.array(position, dtype=float), limiter.low, limiter.high)
    return LimiterState(position=p, velocity=np.zeros(p.size), lag=np.zeros(p.size))


@compiled
def stopping_velocity(distance, acceleration, frame):  # type: ignore[no-untyped-def]
    """b(R): largest velocity of the next frame after which braking stops within a distance R."""
    if distance <= 0.0:
        return 0.0
    unit = acceleration * frame * frame
    n = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * distance / unit) - 1.0))
    return (distance / frame + 0.5 * acceleration * frame * n * (n + 1.0)) / (n + 1.0)


@compiled
def _clip_demand(limiter, i, lag, position, demand):  # type: ignore[no-untyped-def]
    """The demand, at most one range beyond the limits; the last one for one that is no number."""
    if np.isnan(demand):
        return position + lag
    width = limiter.high[i] - limiter.low[i]
    return min(max(demand, limiter.low[i] - width), limiter.high[i] + width)


@compiled
def _closed_lag(lag, deceleration, frame):  # type: ignore[no-untyped-def]
    """e': the lag after one frame on the parabola of a deceleration."""
    size = abs(lag)
    if size <= deceleration * frame * frame:
        return 0.0
    remaining = size - frame * stopping_velocity(size, deceleration, frame)
    return remaining if lag > 0.0 else -remaining


@compiled
def _put_out(limiter, state, i, demand, position, motion):  # type: ignore[no-untyped-def]
    """Put a position out and renew the state; demanded rates pass only with their position."""
    frame = limiter.frame
    largest_velocity, largest_acceleration = limiter.velocity[i], limiter.acceleration[i]
    velocity = (position - state.position[i]) / frame
    acceleration = (velocity - state.velocity[i]) / frame
    state.position[i] = position
    state.velocity[i] = velocity
    state.lag[i] = demand - position
    motion[0, i] = position
    if state.lag[i] != 0.0 or not np.isfinite(motion[1, i] + motion[2, i]):
        motion[1, i] = velocity + 0.5 * frame * acceleration
        motion[2, i] = acceleration
    motion[1, i] = min(max(motion[1, i], -largest_velocity), largest_velocity)
    motion[2, i] = min(max(motion[2, i], -largest_acceleration), largest_acceleration)


@compiled
def step(limiter, state, motion):  # type: ignore[no-untyped-def]
    """One frame of channels limited each alone: motion (3, n) in place.

    Demanded positions become those put out; NaN repeats the last demand. Velocities and
    accelerations are clamped to V and A while the demand is followed, and become those of the
    output otherwise.
    """
    frame = limiter.frame
    for i in range(motion.shape[1]):
        acceleration, speed = limiter.acceleration[i], limiter.velocity[i]
        p, v = state.position[i], state.velocity[i]
        demand = _clip_demand(limiter, i, state.lag[i], p, motion[0, i])
        position = demand - _closed_lag(state.lag[i], limiter.rejoin * acceleration, frame)
        wish = (position - p) / frame
        change = acceleration * frame
        velocity = min(max(wish, v - change, -speed), v + change, speed)
        # Ranges go last: where round-off parts the bounds, it does not add up to leave a range.
        velocity = min(velocity, stopping_velocity(limiter.high[i] - p, acceleration, frame))
        velocity = max(velocity, -stopping_velocity(p - limiter.low[i], acceleration, frame))
        if velocity != wish:
            position = p + frame * velocity
        position = min(max(position, limiter.low[i]), limiter.high[i])
        _put_out(limiter, state, i, demand, position, motion)


@compiled
def _braking_time(stop_time, frame):  # type: ignore[no-untyped-def]
    """Travel per velocity of a frame and all after it, braking in proportion for a stop time."""
    n = np.floor(stop_time / frame)
    if n == 0.0:
        return frame
    return frame * (1.0 + n - 0.5 * frame * n * (n + 1.0) / stop_time)


@compiled
def _is_feasible(limiter, state, base, wish, share):  # type: ignore[no-untyped-def]
    """Whether all channels may move `share` of the way from `base` to `wish`."""
    frame = limiter.frame
    stop_time = 0.0
    for i in range(base.shape[0]):
        velocity = base[i] + share * (wish[i] - base[i])
        acceleration = limiter.acceleration[i]
        if abs(velocity) > limiter.velocity[i]:
            return False
        if abs(velocity - state.velocity[i]) > acceleration * frame * (1.0 + 1e-12):
            return False
        stop_time = max(stop_time, abs(velocity) / acceleration)
    braking_time = _braking_time(stop_time, frame)
    for i in range(base.shape[0]):
        velocity = base[i] + share * (wish[i] - base[i])
        p = state.position[i]
        distance = limiter.high[i] - p if velocity > 0.0 else p - limiter.low[i]
        if braking_time * abs(velocity) > distance:
            return False
    return True


@allocating
def step_together(limiter, state, motion, base, wish):  # type: ignore[no-untyped-def]
    """One frame as `step`, all channels on one scale; `base` and `wish` (n,) are workspace.

    Returned is the share of the way from braking to the wish; 1 while the demand is followed.
    """
    frame = limiter.frame
    channels = motion.shape[1]
    stop_time, largest_lag = 0.0, 0.0
    for i in range(channels):
        stop_time = max(stop_time, abs(state.velocity[i]) / limiter.acceleration[i])
        largest_lag = max(largest_lag, abs(state.lag[i]) / limiter.acceleration[i])
    braking_share = 1.0 - frame / stop_time if stop_time > frame else 0.0
    braking_time = _braking_time(max(stop_time - frame, 0.0), frame)
    # The lag closes in proportion too, in units of each channel's acceleration.
    lag_share = 0.0
    if largest_lag > 0.0:
        lag_share = _closed_lag(largest_lag, limiter.rejoin, frame) / largest_lag
    for i in range(channels):
        p = state.position[i]
        motion[0, i] = _clip_demand(limiter, i, state.lag[i], p, motion[0, i])
        wish[i] = (motion[0, i] - lag_share * state.lag[i] - p) / frame
        base[i] = braking_share * state.velocity[i]
        # By induction within the range; the bound keeps round-off from adding up.
        distance = limiter.high[i] - p if base[i] > 0.0 else p - limiter.low[i]
        base[i] = min(max(base[i], -distance / braking_time), distance / braking_time)
    share = 1.0
    if not _is_feasible(limiter, state, base, wish, 1.0):
        share, infeasible_share = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (share + infeasible_share)
            if _is_feasible(limiter, state, base, wish, middle):
                share = middle
            else:
                infeasible_share = middle
    for i in range(channels):
        p, demand = state.position[i], motion[0, i]
        if share == 1.0:
            position = demand - lag_share * state.lag[i]
        else:
            position = p + frame * (base[i] + share * (wish[i] - base[i]))
        position = min(max(position, limiter.low[i]), limiter.high[i])
        _put_out(limiter, state, i, demand, position, motion)
    return share


class LimitedMotion(NamedTuple):
    """A limited motion, every array (N, n) but the share."""

    position: NDArray[np.float64]  #: p [m or rad].
    velocity: NDArray[np.float64]  #: Velocity at the frames, as handed on with p.
    acceleration: NDArray[np.float64]  #: Acceleration at the frames, as handed on with p.
    share: NDArray[np.float64]  #: Return values of `step_together`, (N,); 1 if limited alone.


@allocating
def _write_history(limiter, state, motions, share, together):  # type: ignore[no-untyped-def]
    base, wish = np.zeros(motions.shape[2]), np.zeros(motions.shape[2])
    for k in range(motions.shape[0]):
        if together:
            share[k] = step_together(limiter, state, motions[k], base, wish)
        else:
            step(limiter, state, motions[k])


def limit_history(
    limiter: Limiter,
    demand: ArrayLike,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    *,
    together: bool = False,
) -> LimitedMotion:
    """Limit a whole history (N, n), starting at rest at its first row.

    Velocities and accelerations that are not demanded are the changes of the output. With
    `together` all channels share one scale.
    """
    position = np.array(demand, dtype=float)
    if position.ndim != 2 or position.shape[1] != limiter.low.size:
        raise InputError(
            f"demand: shape is {position.shape}; it must be (frames, {limiter.low.size})"
        )
    motions = np.full((position.shape[0], 3, position.shape[1]), np.nan)
    motions[:, 0] = position
    for row, name, values in ((1, "velocity", velocity), (2, "acceleration", acceleration)):
        if values is not None:
            if np.shape(values) != position.shape:
                raise InputError(
                    f"{name}: shape is {np.shape(values)}; demand has {position.shape}"
                )
            motions[:, row] = values
    share = np.ones(position.shape[0])
    if position.shape[0]:
        _write_history(limiter, start(limiter, position[0]), motions, share, together)
    parts = np.ascontiguousarray(motions.transpose(1, 0, 2))  # position, velocity, acceleration
    return LimitedMotion(parts[0], parts[1], parts[2], share)
