"""Limit calculations with graceful deceleration: a demand made feasible, frame by frame.

One channel (a leg or a degree of freedom) has the position range [low, high], the largest speed V
and the largest acceleration A. With T the frame, p the output and v[k] = (p[k] - p[k-1]) / T:

**Bounds.** Braking at A from v leaves the positions p + T (v - A T) + T (v - 2 A T) + ... Within
the distance R to a limit the next velocity may be at most

    b(R) = (R / T + A T n (n + 1) / 2) / (n + 1),    n = floor((sqrt(1 + 8 R / (A T^2)) - 1) / 2),

the braking parabola in discrete time: from b(R) at A the channel stops on the limit exactly. So

    max(v - A T, -V, -b(p - low)) <= v' <= min(v + A T, V, b(high - p))

is never empty once it holds, and a channel in it keeps all three limits for ever, whatever the
demand does.

**Demand.** With d the demand and the lag e = d - p, the wish is

    p'[k+1] = d[k+1] - e',    e' = e - sgn(e) T c(|e|),

where c is b with a share of A, `rejoin` A. It follows the demand's own motion and closes in on it
along a parabola that ends, after a finite number of frames, at e' = 0 to the bit; a demand
that accelerates by less than the other share, and moves slower than V, is then rejoined without
overshoot. With e = 0 the wish is the demand itself: while the demand keeps the bounds the output
*is* the demand, bit by bit, with no lag. The output is the wish, moved into the bounds. There is no
integral that could wind up: the lag is the difference of two positions. A demand outside the range
is skipped at the limit and met on its way back, at its own speed.

`step` bounds each channel alone. Legs limited alone distort the pose. `step_together` shares one
scale: from rest all channels follow one straight line between old and new demand, and when one
can go no further all brake together and wait. It brakes in proportion, v - s v with
s = A T / max |v| (the least over channels with their own A), and takes the largest share of the way
from there to the wish that all bounds allow and from which braking in proportion still ends within
all ranges. That takes longer than braking alone: a slow channel near its limit with a fast one is
held back earlier. Do not change between the two in motion.

Not limited: jerk. Parabolas are those of Zanasi, Guarino Lo Bianco and Tonielli (Automatica 36,
2000) in the deadbeat form of discrete time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.compiled import allocating, compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import FRAME
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.motion_limits import load_motion_limits

_HALVINGS = 40  #: Bisections for the shared scale, resolving it to 1e-12.


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
    travel = np.full(legs, leg.position.si)
    return make_limiter(
        -travel,
        travel,
        np.full(legs, leg.velocity.si),
        np.full(legs, leg.acceleration.si),
        leg.rejoin.si,
        frame,
    )


def make_pose_limiter(limits: MotionLimits | None = None, frame: float = FRAME) -> Limiter:
    """Limiter of pose demands: operational limits of Table 2-1 and the rates assumed with them."""
    limits = limits or load_motion_limits()
    low, high = limits.operational.T
    return make_limiter(
        low, high, limits.velocity, limits.acceleration, limits.leg.rejoin.si, frame
    )


def start(limiter: Limiter, position: ArrayLike) -> LimiterState:
    """State of a limiter at rest at `position` (n,), moved into the range."""
    at = np.clip(np.array(position, dtype=float), limiter.low, limiter.high)
    return LimiterState(at, np.zeros(at.size), np.zeros(at.size))


@compiled
def stopping_velocity(distance, acceleration, frame):  # type: ignore[no-untyped-def]
    """b(R): largest velocity of the next frame after which braking stops within a distance R."""
    if distance <= 0.0:
        return 0.0
    unit = acceleration * frame * frame
    n = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * distance / unit) - 1.0))
    return (distance / frame + 0.5 * acceleration * frame * n * (n + 1.0)) / (n + 1.0)


@compiled
def _screened(limiter, i, lag, position, demand):  # type: ignore[no-untyped-def]
    """The demand, at most one range beyond the limits; the last one for one that is no number."""
    if np.isnan(demand):
        return position + lag
    reach = limiter.high[i] - limiter.low[i]
    return min(max(demand, limiter.low[i] - reach), limiter.high[i] + reach)


@compiled
def _remaining(lag, closing, frame):  # type: ignore[no-untyped-def]
    """e': the lag after one frame on the parabola of deceleration `closing`."""
    size = abs(lag)
    if size <= closing * frame * frame:
        return 0.0
    left = size - frame * stopping_velocity(size, closing, frame)
    return left if lag > 0.0 else -left


@compiled
def _accept(limiter, state, i, demand, position, motion):  # type: ignore[no-untyped-def]
    """Put a position out and renew the state; demanded rates pass only with their position."""
    frame, speed, limit = limiter.frame, limiter.velocity[i], limiter.acceleration[i]
    before = state.velocity[i]
    now = (position - state.position[i]) / frame
    change = (now - before) / frame
    state.position[i] = position
    state.velocity[i] = now
    state.lag[i] = demand - position
    motion[0, i] = position
    if state.lag[i] != 0.0 or not np.isfinite(motion[1, i] + motion[2, i]):
        motion[1, i] = now + 0.5 * frame * change
        motion[2, i] = change
    motion[1, i] = min(max(motion[1, i], -speed), speed)
    motion[2, i] = min(max(motion[2, i], -limit), limit)


@compiled
def step(limiter, state, motion):  # type: ignore[no-untyped-def]
    """One frame of channels limited each alone: motion (3, n) in place.

    Demanded positions become those put out; NaN repeats the last demand. Velocities and
    accelerations are clamped to V and A while the demand is followed, and become those of the
    output otherwise.
    """
    frame = limiter.frame
    for i in range(motion.shape[1]):
        limit, speed = limiter.acceleration[i], limiter.velocity[i]
        at, before = state.position[i], state.velocity[i]
        demand = _screened(limiter, i, state.lag[i], at, motion[0, i])
        position = demand - _remaining(state.lag[i], limiter.rejoin * limit, frame)
        wish = (position - at) / frame
        velocity = min(max(wish, before - limit * frame, -speed), before + limit * frame, speed)
        # Ranges go last: where round-off parts the bounds, it does not add up to leave a range.
        velocity = min(velocity, stopping_velocity(limiter.high[i] - at, limit, frame))
        velocity = max(velocity, -stopping_velocity(at - limiter.low[i], limit, frame))
        if velocity != wish:
            position = at + frame * velocity
        position = min(max(position, limiter.low[i]), limiter.high[i])
        _accept(limiter, state, i, demand, position, motion)


@compiled
def _reach(ratio, frame):  # type: ignore[no-untyped-def]
    """Travel per velocity of one frame and of all after it, braking in proportion.

    Every channel stops with that of the largest |v| / A, which is `ratio`.
    """
    n = np.floor(ratio / frame)
    if n == 0.0:
        return frame
    return frame * (1.0 + n - 0.5 * frame * n * (n + 1.0) / ratio)


@compiled
def _fits(limiter, state, base, wish, share):  # type: ignore[no-untyped-def]
    """Whether all channels may move `share` of the way from `base` to `wish`."""
    frame = limiter.frame
    ratio = 0.0
    for i in range(base.shape[0]):
        velocity = base[i] + share * (wish[i] - base[i])
        limit = limiter.acceleration[i]
        if abs(velocity) > limiter.velocity[i]:
            return False
        if abs(velocity - state.velocity[i]) > limit * frame * (1.0 + 1e-12):
            return False
        ratio = max(ratio, abs(velocity) / limit)
    reach = _reach(ratio, frame)
    for i in range(base.shape[0]):
        velocity = base[i] + share * (wish[i] - base[i])
        at = state.position[i]
        left = limiter.high[i] - at if velocity > 0.0 else at - limiter.low[i]
        if reach * abs(velocity) > left:
            return False
    return True


@allocating
def step_together(limiter, state, motion, base, wish):  # type: ignore[no-untyped-def]
    """One frame as `step`, all channels on one scale; `base` and `wish` (n,) are workspace.

    Returned is the share of the way from braking to the wish; 1 while the demand is followed.
    """
    frame = limiter.frame
    channels = motion.shape[1]
    ratio, far = 0.0, 0.0
    for i in range(channels):
        ratio = max(ratio, abs(state.velocity[i]) / limiter.acceleration[i])
        far = max(far, abs(state.lag[i]) / limiter.acceleration[i])
    brake = 1.0 - frame / ratio if ratio > frame else 0.0
    reach = _reach(max(ratio - frame, 0.0), frame)
    # The lag closes in proportion too, in units of each channel's acceleration.
    closing = _remaining(far, limiter.rejoin, frame) / far if far > 0.0 else 0.0
    for i in range(channels):
        at = state.position[i]
        motion[0, i] = _screened(limiter, i, state.lag[i], at, motion[0, i])
        wish[i] = (motion[0, i] - closing * state.lag[i] - at) / frame
        base[i] = brake * state.velocity[i]
        # By induction within the range; the bound keeps round-off from adding up.
        left = limiter.high[i] - at if base[i] > 0.0 else at - limiter.low[i]
        base[i] = min(max(base[i], -left / reach), left / reach)
    share = 1.0
    if not _fits(limiter, state, base, wish, 1.0):
        share, beyond = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (share + beyond)
            if _fits(limiter, state, base, wish, middle):
                share = middle
            else:
                beyond = middle
    for i in range(channels):
        at, demand = state.position[i], motion[0, i]
        if share == 1.0:
            position = demand - closing * state.lag[i]
        else:
            position = at + frame * (base[i] + share * (wish[i] - base[i]))
        position = min(max(position, limiter.low[i]), limiter.high[i])
        _accept(limiter, state, i, demand, position, motion)
    return share


class LimitedMotion(NamedTuple):
    """A limited motion, every array (N, n) but the share."""

    position: NDArray[np.float64]  #: p [m or rad].
    velocity: NDArray[np.float64]  #: Velocity at the frames, as handed on with p.
    acceleration: NDArray[np.float64]  #: Acceleration at the frames, as handed on with p.
    share: NDArray[np.float64]
    """What `step_together` returned (N,); 1 throughout for channels limited alone."""


@allocating
def _limit_history(limiter, state, motions, share, together):  # type: ignore[no-untyped-def]
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
        _limit_history(limiter, start(limiter, position[0]), motions, share, together)
    p, v, a = np.ascontiguousarray(motions.transpose(1, 0, 2))
    return LimitedMotion(p, v, a, share)
