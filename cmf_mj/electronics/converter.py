"""Analogue to digital conversion of the DCL's feedback: anti-alias filter, range, resolution.

    v = s y                      volts of a sensor signal, s = full-scale volts / full scale
    w = H(v)                     analogue Butterworth low-pass before sampling
    c = clip(round(w / q), -2^(b-1), 2^(b-1) - 1),   q = 2 full-scale volts / 2^b
    y_digital = q c / s

H runs at the frame rate by the bilinear transform, pre-warped to its corner
(`cmf_mj.core.filters`).

Aliasing. The simulation has no contents above half the frame rate f_s = 2048 Hz, so nothing folds
in it. On the machine a tone at f appears at |f - f_s round(f / f_s)|, damped to |H(f)|.

Everything is off in the set `off`, the default: readings pass bit for bit. The facility published
neither bits nor range nor filter; the set `sixteen_bit` is assumed.
"""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core import filters
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Acceleration, Kind, Length, Pressure, Quantity, Speed, Voltage
from cmf_mj.core.settings import Loader, Name, Settings
from cmf_mj.core.units import FRAME

CONVERTER_SETS = ("off", "sixteen_bit")  #: Names of the shipped sets.

_BELOW_HALF_RATE = Kind(("Hz", "rad/s"), below=np.pi / FRAME)


class FullScale(Settings):
    """Reading of each channel at full-scale volts."""

    position: Length
    velocity: Speed
    acceleration: Acceleration
    cap_pressure: Pressure
    rod_pressure: Pressure


class ConverterSettings(Settings):
    """The analogue input card and its anti-alias filter."""

    name: Name  #: Name of the set.
    quantise: bool  #: Whether range and resolution act.
    bits: Annotated[int, Field(ge=4, le=32)]  #: Resolution b of the converter.
    volts: Voltage  #: Full-scale volts, either way.
    filter_order: Annotated[int, Field(ge=0, le=8)]  #: Order of the anti-alias filter; 0 for none.
    filter_corner: Annotated[Quantity, AfterValidator(_BELOW_HALF_RATE.check)]  #: Its -3 dB corner.
    full_scale: FullScale


class Converter(NamedTuple):
    """Compiled parameters of one channel."""

    low_pass: NDArray[np.float64]  #: Anti-alias filter, sections (s, 6).
    quantise: bool  #: Whether range and resolution act.
    step: float  #: Smallest change of the reading, q / s [SI].
    codes: float  #: 2^(b-1): codes are -codes to codes - 1.


load_converters = Loader(
    ConverterSettings,
    Path(__file__).with_name("converters.toml"),
    what="converters",
    names=CONVERTER_SETS,
    default="off",
    based=False,
)
"""Loads converter settings: `off`, `sixteen_bit`, or a file of one table with all that
`converters.toml` has."""


def make_converters(settings: ConverterSettings, frame: float = FRAME) -> LegFeedback:
    """Derive the `Converter` of each channel for a control frame [s]."""
    corner = settings.filter_corner.si / (2.0 * np.pi)
    if not corner < 0.5 / frame:
        text = f"half the control rate, {0.5 / frame:g} Hz"
        raise InputError(f"filter_corner: {corner:g} Hz must be below {text}")
    sections = filters.low_pass(settings.filter_order, corner, 1.0 / frame)
    codes = 2.0 ** (settings.bits - 1)

    def channel(name: str) -> Any:
        full_scale = getattr(settings.full_scale, name).si
        return Converter(sections, settings.quantise, full_scale / codes, codes)

    return LegFeedback(**{name: channel(name) for name in LegFeedback._fields})


def converter_state(converters: Any, feedback: LegFeedback) -> LegFeedback:
    """Filter states (n, s, 2) of `make_converters` that have seen the feedback for a long time."""
    pairs = zip(converters, feedback, strict=True)
    return LegFeedback(*(filters.settled_filter_state(x.low_pass, values) for x, values in pairs))


@compiled
def convert_channel(converter, state, analogue, digital):  # type: ignore[no-untyped-def]
    """One channel of all legs (n,) after filter, range and resolution [SI].

    `digital` may be `analogue` itself.
    """
    filters.filter_all(converter.low_pass, state, analogue, digital)
    if converter.quantise:
        for leg in range(analogue.shape[0]):
            code = in_steps(digital[leg], converter.step)
            code = min(max(code, -converter.codes), converter.codes - 1.0)
            digital[leg] = code * converter.step


@compiled
def convert_all(converters, states, analogue, digital):  # type: ignore[no-untyped-def]
    """All channels of all legs, one frame; both are a `LegFeedback` and may be the same."""
    for channel in range(5):
        convert_channel(converters[channel], states[channel], analogue[channel], digital[channel])


@compiled
def in_steps(value, resolution):  # type: ignore[no-untyped-def]
    """The value in whole steps of the resolution; halves go up."""
    return np.floor(value / resolution + 0.5)
