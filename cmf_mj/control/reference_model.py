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

*Bounded*: d multiplies a signal of the demand alone and is in no loop through the leg. A loop that
is stable with d = 0 is stable for every history of d. At rest f is zero: noise moves nothing.

*Converging*: let D = d - d*, d* = 1 / (k K_v) - 1. The right side above is -k D f, and the transfer
function from it to s,

    W = (s + c) / (tau s^2 + (1 + k K_r) s + k K_p),

is strictly positive real for 0 < c < (1 + k K_r) / tau: whatever the speed k if c < 1 / tau. Then,
for H = 1, there are P, Q > 0 such that x = (e, e') and

    V = x' P x + k N D^2 / (rate K_v),   N = level^2 + f^2

have V' = -x' Q x for a constant N without leak and dead zone: the error goes to zero, and D with it
where f does not. Leak and dead zone leave an offset and prevent a drift.

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
from cmf_mj.core.filters import step_matrix


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

    is_active: bool = False  #: Whether the law has a reference model; all else is unused if not.
    frame: float = 1.0  #: T [s].
    position_of_position: float = 1.0  #: Next p_m of p_m.
    position_of_velocity: float = 0.0  #: Next p_m of v_m [s].
    position_of_reference: float = 0.0  #: Next p_m of r.
    velocity_of_position: float = 0.0  #: Next v_m of p_m [1/s].
    velocity_of_velocity: float = 0.0  #: Next v_m of v_m.
    velocity_of_reference: float = 0.0  #: Next v_m of r [1/s].
    position_gain: float = 0.0  #: K_p [1/m].
    rate_gain: float = 0.0  #: K_r [s/m].
    velocity_gain: float = 0.0  #: K_v [s/m].
    acceleration_gain: float = 0.0  #: K_a [s^2/m].
    is_adapting: bool = False  #: Whether the adaptation rate is above 0.
    adaptation_gain: float = 0.0  #: rate K_v a frame [1/m s].
    slope: float = 0.0  #: c [1/s].
    filter_pole: float = 0.0  #: Pole of H, per frame.
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
    next_position, next_velocity = step_matrix([omega**2, damping], omega**2, frame).tolist()
    scale = units.PERCENT / units.INCH
    model = CompiledModel(
        is_active=True,
        frame=frame,
        position_of_position=next_position[0],
        position_of_velocity=next_position[1],
        position_of_reference=next_position[2],
        velocity_of_position=next_velocity[0],
        velocity_of_velocity=next_velocity[1],
        velocity_of_reference=next_velocity[2],
        position_gain=settings.position * scale,
        rate_gain=settings.rate * scale,
        velocity_gain=settings.velocity * scale,
        acceleration_gain=settings.acceleration * scale,
    )
    adaptation = settings.adaptation
    if adaptation is None or adaptation.rate == 0.0:
        return model
    return model._replace(
        is_adapting=True,
        adaptation_gain=frame * adaptation.rate * settings.velocity * scale,
        slope=adaptation.slope,
        filter_pole=float(np.exp(-2.0 * np.pi * adaptation.corner * frame)),
        level=adaptation.level * units.PERCENT,
        dead_zone=adaptation.dead_zone * units.INCH,
        leak=frame * adaptation.leak,
        lowest=adaptation.lowest - 1.0,
        highest=adaptation.highest - 1.0,
    )


def moves_alike(first: CompiledModel, second: CompiledModel) -> bool:
    """Whether two laws have a model of the same motion, whatever their gains."""
    gains_begin = CompiledModel._fields.index("position_gain")  # before it stands the motion
    return first[:gains_begin] == second[:gains_begin]


@compiled
def adapt(model, state, leg, feed_forward, error, velocity_error):  # type: ignore[no-untyped-def]
    """Adapt the factor of one leg, one frame.

    `feed_forward` is f, fraction; `error` e [m]; `velocity_error` v_m - v [m/s].
    """
    pole, input_gain = model.filter_pole, 1.0 - model.filter_pole
    filtered_error = pole * state.error[leg] + input_gain * (velocity_error + model.slope * error)
    regressor = pole * state.feed_forward[leg] + input_gain * feed_forward
    power = pole * state.power[leg] + input_gain * feed_forward * feed_forward
    learned_error = filtered_error - min(max(filtered_error, -model.dead_zone), model.dead_zone)
    factor = (1.0 - model.leak) * state.factor[leg]
    normalisation = model.level * model.level + power
    factor += model.adaptation_gain * learned_error * regressor / normalisation
    state.factor[leg] = min(max(factor, model.lowest), model.highest)
    state.error[leg] = filtered_error
    state.feed_forward[leg] = regressor
    state.power[leg] = power


@compiled
def follow_model(model, state, leg, reference, feedback, output):  # type: ignore[no-untyped-def]
    """The compensator's output of one leg, fraction, with the model's part added, one frame."""
    position, velocity = state.position[leg], state.velocity[leg]
    next_velocity = (
        model.velocity_of_position * position
        + model.velocity_of_velocity * velocity
        + model.velocity_of_reference * reference
    )
    acceleration = (next_velocity - velocity) / model.frame
    feed_forward = model.velocity_gain * velocity + model.acceleration_gain * acceleration
    error = position - feedback.position[leg]
    velocity_error = velocity - feedback.velocity[leg]
    total = output + (1.0 + state.adaptation.factor[leg]) * feed_forward
    total += model.position_gain * error + model.rate_gain * velocity_error
    if model.is_adapting and abs(total) < 1.0:
        adapt(model, state.adaptation, leg, feed_forward, error, velocity_error)
    state.position[leg] = (
        model.position_of_position * position
        + model.position_of_velocity * velocity
        + model.position_of_reference * reference
    )
    state.velocity[leg] = next_velocity
    return total
