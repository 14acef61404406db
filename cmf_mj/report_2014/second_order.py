"""The second-order analysis of section 3.4: what position, rate and acceleration feedback do.

The plant of Eq 3.1 with feedback of its position, rate and acceleration (Figure 3-12) is

    G_3 = w^2 / ((1 + K_a w^2) s^2 + (2 zeta w + K_r w^2) s + (1 + K_p) w^2)           Eq 3.4

and so again of second order: with a = 1 + K_a w^2 and b = 1 + K_p

    natural frequency  w sqrt(b / a),   damping ratio  (2 zeta + K_r w) / (2 sqrt(a b)),
    gain at rest       1 / b

Eqs 3.1 to 3.3 are this with gains left at zero. Position feedback raises the frequency and lowers
the damping ratio, rate feedback damps, acceleration feedback adds mass: it lowers both.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, cast

import numpy as np
from scipy import optimize

from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.analysis.measures import Measures
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name

Variant = Literal["printed", "corrected"]
"""Which reading of an equation: as printed, or with its misprint put right."""

Gain = Literal["position_gain", "rate_gain", "acceleration_gain"]
"""Names of the three gains."""

GAINS: tuple[Gain, ...] = ("position_gain", "rate_gain", "acceleration_gain")
"""The three gains in the order of Eqs 3.2 to 3.4."""

_USED = {"3.1": 0, "3.2": 1, "3.3": 2, "3.4": 3}
"""How many of the gains each equation has."""

_HALF_POWER = 10.0 ** (-3.0 / 20.0)
"""Gain of -3 dB."""


class FeedbackLoop(NamedTuple):
    """A plant of second order and the gains of the feedback around it (Figure 3-12)."""

    natural_frequency: float  #: w of the plant [rad/s].
    damping_ratio: float  #: zeta of the plant.
    position_gain: float = 0.0  #: K_p.
    rate_gain: float = 0.0  #: K_r [s].
    acceleration_gain: float = 0.0  #: K_a [s^2].


def _checked(loop: FeedbackLoop) -> tuple[float, float]:
    """The factors a and b of the module's equations."""
    if not loop.natural_frequency > 0.0:
        raise InputError(f"natural_frequency: {loop.natural_frequency} rad/s must be above 0")
    a = 1.0 + loop.acceleration_gain * loop.natural_frequency**2
    b = 1.0 + loop.position_gain
    if not a > 0.0:
        least = -1.0 / loop.natural_frequency**2
        raise InputError(f"acceleration_gain: {loop.acceleration_gain} s^2 must be above {least:g}")
    if not b > 0.0:
        raise InputError(f"position_gain: {loop.position_gain} must be above -1")
    return a, b


def feedback_model(
    number: str, loop: FeedbackLoop, variant: Variant = "corrected"
) -> UnitTransferFunction:
    """Eq 3.1, 3.2, 3.3 or 3.4 with numbers; gains that the equation lacks are ignored.

    As printed, Eq 3.2 closes the loop with a gain of 1 whatever K_p is.
    """
    used_gains = GAINS[: _USED[check_name("number", number, _USED)]]
    gains = {name: getattr(loop, name) for name in used_gains}
    if number == "3.2" and variant == "printed":
        gains["position_gain"] = 1.0
    used = FeedbackLoop(loop.natural_frequency, loop.damping_ratio, **gains)
    a, b = _checked(used)
    square = used.natural_frequency**2
    damping = 2.0 * used.damping_ratio * used.natural_frequency + used.rate_gain * square
    below, name = [a, damping, b * square], f"Eq_{number.replace('.', '_')}"
    signals = {"inputs": "command", "outputs": "position", "name": name}
    return UnitTransferFunction([square], below, 0.0, input_unit="1", output_unit="1", **signals)


def characteristics(loop: FeedbackLoop) -> Measures:
    """Natural frequency, damping and bandwidths of the loop of Eq 3.4.

    Bandwidths and peak count from the static gain, which K_p lowers; the mode is the loop's. With
    damping ratio z, natural frequency w, c = 1 - 2 z^2 and h = 10^(-3/20) the phase is -90 deg at
    w, the gain is down by 3 dB at w sqrt(c + sqrt(c^2 + h^-2 - 1)), and it peaks by 1 / (2 z sqrt(1
    - z^2)) below z = 0.707.
    """
    a, b = _checked(loop)
    natural = loop.natural_frequency * np.sqrt(b / a)
    turned = 2.0 * loop.damping_ratio + loop.rate_gain * loop.natural_frequency
    damping = turned / (2.0 * np.sqrt(a * b))
    frequency = float(natural / units.HERTZ)
    mode = Measures(mode_damping_ratio=float(damping), mode_frequency_hz=frequency)
    if damping <= 0.0:
        return mode
    c = 1.0 - 2.0 * damping**2
    peak = 1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2)) if c > 0.0 else 1.0
    over = np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2)) if damping < 1.0 else 0.0
    return mode._replace(
        phase_bandwidth_hz=frequency,
        gain_bandwidth_hz=float(frequency * np.sqrt(c + np.sqrt(c**2 + _HALF_POWER**-2 - 1.0))),
        peak_gain_db=float(20.0 * np.log10(peak)),
        overshoot=float(over),
        steady_state_error=1.0 - 1.0 / b,
        stable=True,
    )


class GainEffect(NamedTuple):
    """A loop with one gain varied."""

    gain: Gain  #: Which gain.
    value: float  #: Its value [1, s or s^2].
    loop: FeedbackLoop  #: The loop with it.
    result: Measures  #: What the loop does.


def gain_effect(loop: FeedbackLoop, gain: Gain, values: Sequence[float]) -> tuple[GainEffect, ...]:
    """The effect of one gain on frequency, damping and bandwidths, the others as in `loop`."""
    check_name("gain", gain, GAINS)
    loops = [loop._replace(**{gain: float(value)}) for value in values]
    return tuple(
        GainEffect(gain, float(value), varied, characteristics(varied))
        for value, varied in zip(values, loops, strict=True)
    )


RATE_BANDWIDTH_HZ, ACCELERATION_BANDWIDTH_HZ = 1.08, 1.06
"""-3 dB bandwidths of Figure 3-14 with position and rate feedback, and with acceleration [Hz]."""


def bandwidth_example(
    plant_damping: float = 0.1, loop_damping: float = 0.7, position_gain: float = 1.0
) -> dict[str, FeedbackLoop]:
    """Three loops with the bandwidths of Figure 3-14, whose plant and gains are not printed.

    `position`, `rate` and `acceleration`, each with the gains of those before it: rate feedback is
    added to reach `loop_damping`, then acceleration feedback. The plant's frequency puts the second
    at 1.08 Hz, K_a then the third at 1.06 Hz. The arguments' values are assumed.

    `loop_damping` lies above that with position feedback alone and below 0.706, where the -3 dB
    bandwidth is the natural frequency: from there on acceleration feedback widens it at first.
    """
    bare = characteristics(FeedbackLoop(units.HERTZ, plant_damping, position_gain))
    highest = 0.5 / _HALF_POWER
    if not bare.mode_damping_ratio <= loop_damping < highest:
        raise InputError(
            f"loop_damping: {loop_damping} must be at least {bare.mode_damping_ratio:.3g}, that of "
            f"position feedback alone, and below {highest:.3g}"
        )
    # At a plant frequency of 1 Hz first; all frequencies scale with it.
    rate = (2.0 * loop_damping * np.sqrt(1.0 + position_gain) - 2.0 * plant_damping) / units.HERTZ
    unscaled = FeedbackLoop(units.HERTZ, plant_damping, position_gain, float(rate))
    ratio = RATE_BANDWIDTH_HZ / characteristics(unscaled).gain_bandwidth_hz
    damped = unscaled._replace(
        natural_frequency=unscaled.natural_frequency * ratio, rate_gain=unscaled.rate_gain / ratio
    )
    unit = damped.natural_frequency**-2

    def excess(added: float) -> float:
        heavier = damped._replace(acceleration_gain=added * unit)
        return characteristics(heavier).gain_bandwidth_hz - ACCELERATION_BANDWIDTH_HZ

    added = cast("float", optimize.brentq(excess, 0.0, 1.0))
    return {
        "position": damped._replace(rate_gain=0.0),
        "rate": damped,
        "acceleration": damped._replace(acceleration_gain=added * unit),
    }


def gain_effects(steps: int = 41) -> tuple[GainEffect, ...]:
    """Each gain of section 3.4 varied from nothing to twice its size in `bandwidth_example`."""
    loop = bandwidth_example()["acceleration"]
    effects: list[GainEffect] = []
    for gain in GAINS:
        effects += gain_effect(loop, gain, list(np.linspace(0.0, 2.0 * getattr(loop, gain), steps)))
    return tuple(effects)
