"""Model following and its adaptation: the feed-forward path past the compensator.

A leg is to move as its reference model does, driven by the leg demand r,

    a_m = w^2 (r - p_m) - 2 zeta w v_m,   w = 2 pi natural_frequency,

advanced from frame to frame exactly for a constant demand; a_m below is its mean over the frame
ahead. With the position p and velocity v of the leg and e = p_m - p, the model adds to the
compensator's output

    u_m = (1 + d) f + K_p e + K_r (v_m - v),   f = K_v v_m + K_a a_m.

**Following.** For a leg that integrates a lagged speed, tau v' + v = k u, the feed-forward
f = (v_m + tau a_m) / k makes v = v_m. With K_v = 1 / k, K_a = tau / k and another speed k of the
leg, the error obeys

    tau e'' + (1 + k K_r) e' + k K_p e = (1 - (1 + d) k K_v) (v_m + tau a_m).

**Adaptation.** With s = (v_m - v) + c e, c the `slope`, and H a first-order low-pass filter,

    d' = rate * K_v (H s) (H f) / (level^2 + H f^2) - leak * d,   lowest <= 1 + d <= highest,

H s less a dead zone. It stands still while the valve command is clamped.

*Bounded, whatever happens*: d multiplies a signal of the demand alone. It is in no loop through the
leg, so that a loop that is stable with d = 0 is stable for every history of d within its bounds,
and errors stay below the largest |f| times the highest factor times the peak gain (the integral of
the impulse response's magnitude) from valve command to error. At rest f is zero: noise moves
nothing, and the leak takes the factor back to 1.

*Converging*: let D = d - d*, d* = 1 / (k K_v) - 1. The right side above is -k D f, and the transfer
function from it to s,

    W = (s + c) / (tau s^2 + (1 + k K_r) s + k K_p),

is strictly positive real for 0 < c < (1 + k K_r) / tau: whatever the speed k if c < 1 / tau. Then,
for H = 1, there are P, Q > 0 such that x = (e, e') and

    V = x' P x + k N D^2 / (rate K_v),   N = level^2 + f^2

have V' = -x' Q x for a constant N without leak and dead zone: the error goes to zero, and D with it
where f does not. Leak and dead zone leave an offset and prevent a drift.

The leg is more than that: second lag, leg mode, frame of delay. For a slow adaptation averaging
applies: a sine of angular frequency w in f moves D at -rate K_v k D |H|^2 Re W(jw) |f|^2 / 2 N, by
the W of the whole plant. So D converges where the sum over the demand's spectrum is positive, and
drifts to a bound where it is negative: beyond the frequency where a leg lags its feed-forward by
90 deg. H is there to keep that small. An error integral of gain K_i needs K_i < c K_p besides.

Source: K. S. Narendra and A. M. Annaswamy, Stable Adaptive Systems (1989), for the Lyapunov rule;
P. A. Ioannou and J. Sun, Robust Adaptive Control (1996), for leak, dead zone, projection and
normalisation. The report plans a model reference law (chapter 4 and section 5.2) and gives none.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.law import ReferenceModel
from cmf_mj.core import units
from cmf_mj.core.compiled import compiled
from cmf_mj.core.filters import chain


class AdaptationState(NamedTuple):
    """State of the adaptation, every array (n,)."""

    factor: NDArray[np.float64]  #: d, the factor of the feed-forward less 1.
    error: NDArray[np.float64]  #: H s, the filtered error that it learns from [m/s].
    feed_forward: NDArray[np.float64]  #: H f, fraction.
    power: NDArray[np.float64]  #: H f^2.


class ModelState(NamedTuple):
    """State of the reference model, every array (n,)."""

    position: NDArray[np.float64]  #: p_m [m].
    velocity: NDArray[np.float64]  #: v_m [m/s].
    adaptation: AdaptationState


class CompiledModel(NamedTuple):
    """Compiled parameters, SI: m, m/s, m/s^2; commands as fractions."""

    active: bool = False  #: Whether the law has a reference model; all else is unused if not.
    frame: float = 1.0  #: T [s].
    position_stays: float = 1.0  #: Next p_m of p_m.
    position_of_velocity: float = 0.0  #: Next p_m of v_m [s].
    position_of_reference: float = 0.0  #: Next p_m of r.
    velocity_of_position: float = 0.0  #: Next v_m of p_m [1/s].
    velocity_stays: float = 0.0  #: Next v_m of v_m.
    velocity_of_reference: float = 0.0  #: Next v_m of r [1/s].
    position_gain: float = 0.0  #: K_p [1/m].
    rate_gain: float = 0.0  #: K_r [s/m].
    velocity_gain: float = 0.0  #: K_v [s/m].
    acceleration_gain: float = 0.0  #: K_a [s^2/m].
    adapting: bool = False  #: Whether the adaptation rate is above 0.
    adaptation_gain: float = 0.0  #: rate K_v a frame [1/m s].
    slope: float = 0.0  #: c [1/s].
    stays: float = 0.0  #: Pole of H, per frame.
    level: float = 1.0  #: Feed-forward of the normalisation, fraction.
    dead_zone: float = 0.0  #: Dead zone of s [m/s].
    leak: float = 0.0  #: Part of d lost in a frame.
    lowest: float = 0.0  #: Least d.
    highest: float = 0.0  #: Largest d.


def make_model(settings: ReferenceModel | None, frame: float) -> CompiledModel:
    """Compile the reference model of a law for its control frame [s]; None for none."""
    if settings is None:
        return CompiledModel()
    omega = 2.0 * np.pi * settings.natural_frequency
    damping = 2.0 * settings.damping_ratio * omega
    (p_p, p_v, p_r), (v_p, v_v, v_r) = chain([omega**2, damping], omega**2, frame).tolist()
    scale = units.PERCENT / units.INCH
    fixed = CompiledModel(
        active=True,
        frame=frame,
        position_stays=p_p,
        position_of_velocity=p_v,
        position_of_reference=p_r,
        velocity_of_position=v_p,
        velocity_stays=v_v,
        velocity_of_reference=v_r,
        position_gain=settings.position * scale,
        rate_gain=settings.rate * scale,
        velocity_gain=settings.velocity * scale,
        acceleration_gain=settings.acceleration * scale,
    )
    adaptation = settings.adaptation
    if adaptation is None or adaptation.rate == 0.0:
        return fixed
    return fixed._replace(
        adapting=True,
        adaptation_gain=frame * adaptation.rate * settings.velocity * scale,
        slope=adaptation.slope,
        stays=float(np.exp(-2.0 * np.pi * adaptation.corner * frame)),
        level=adaptation.level * units.PERCENT,
        dead_zone=adaptation.dead_zone * units.INCH,
        leak=frame * adaptation.leak,
        lowest=adaptation.lowest - 1.0,
        highest=adaptation.highest - 1.0,
    )


@compiled
def adapt(model, state, leg, feed_forward, error, rate):  # type: ignore[no-untyped-def]
    """Adapt the factor of one leg, one frame.

    `feed_forward` is f, fraction; `error` e [m]; `rate` v_m - v [m/s].
    """
    stays, passes = model.stays, 1.0 - model.stays
    combined = stays * state.error[leg] + passes * (rate + model.slope * error)
    filtered = stays * state.feed_forward[leg] + passes * feed_forward
    power = stays * state.power[leg] + passes * feed_forward * feed_forward
    learned = combined - min(max(combined, -model.dead_zone), model.dead_zone)
    moved = (1.0 - model.leak) * state.factor[leg]
    moved += model.adaptation_gain * learned * filtered / (model.level * model.level + power)
    state.factor[leg] = min(max(moved, model.lowest), model.highest)
    state.error[leg] = combined
    state.feed_forward[leg] = filtered
    state.power[leg] = power


@compiled
def follow(model, state, leg, reference, feedback, output):  # type: ignore[no-untyped-def]
    """The compensator's output of one leg, fraction, with the model's part added, one frame."""
    position, velocity = state.position[leg], state.velocity[leg]
    next_velocity = (
        model.velocity_of_position * position
        + model.velocity_stays * velocity
        + model.velocity_of_reference * reference
    )
    acceleration = (next_velocity - velocity) / model.frame
    feed_forward = model.velocity_gain * velocity + model.acceleration_gain * acceleration
    error = position - feedback.position[leg]
    rate = velocity - feedback.velocity[leg]
    total = output + (1.0 + state.adaptation.factor[leg]) * feed_forward
    total += model.position_gain * error + model.rate_gain * rate
    if model.adapting and abs(total) < 1.0:
        adapt(model, state.adaptation, leg, feed_forward, error, rate)
    state.position[leg] = (
        model.position_stays * position
        + model.position_of_velocity * velocity
        + model.position_of_reference * reference
    )
    state.velocity[leg] = next_velocity
    return total
