"""One kind of sensor: bandwidth, gain, bias, noise, resolution and range, in that order.

    y = saturate(resolve((1 + e) H(truth) + bias + sigma n)),   sigma^2 = density^2 rate / 2

H is a first-order low-pass at the bandwidth (`cmf_mj.core.filters`). The noise is that of the
output: white from 0 to half the frame rate with the given one-sided density, not shaped by the
bandwidth.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core import filters
from cmf_mj.core.compiled import compiled
from cmf_mj.electronics.sensors.noise import four_normals, key_schedule, stream_key
from cmf_mj.electronics.sensors.settings import ChannelSettings
from cmf_mj.electronics.stages import low_pass, steps


class SensorChannel(NamedTuple):
    """Compiled parameters of one kind of sensor, SI."""

    low_pass: NDArray[np.float64]  #: Sections (s, 6) of H; none for an unlimited bandwidth.
    gain: NDArray[np.float64]  #: 1 + e of each leg or axis, (n,); none where all are exact.
    lowest: float  #: Least reading, -inf for none.
    highest: float  #: Largest reading, inf for none.
    bias: float
    deviation: float  #: Standard deviation sigma of the noise in one frame.
    resolution: float  #: Step between readings, 0 for none.
    keys: NDArray[np.uint64]  #: Round keys of the noise, (10, 2).


def make_channel(name: str, settings: ChannelSettings, rate: float, seed: int) -> SensorChannel:
    """Derive a channel from its settings for a rate of frames [Hz]; its name chooses the noise."""

    def size(field: str, absent: float) -> float:
        quantity = getattr(settings, field)
        return absent if quantity is None else float(quantity.si)

    corner = size("bandwidth", 0.0) / (2.0 * np.pi)
    return SensorChannel(
        filters.low_pass(1 if corner else 0, corner, rate),
        np.array([1.0 + error.si for error in settings.gain_errors]),
        size("lowest", -np.inf),
        size("highest", np.inf),
        size("bias", 0.0),
        size("noise_density", 0.0) * float(np.sqrt(rate / 2.0)),
        size("resolution", 0.0),
        key_schedule(stream_key(seed, name)),
    )


@compiled
def read(channel, state, frame, truth, reading):  # type: ignore[no-untyped-def]
    """Readings (n,) of one frame, whose number chooses the noise; may overwrite the truth."""
    count = truth.shape[0]
    low_pass(channel.low_pass, state, truth, reading)
    if channel.gain.shape[0] > 0:
        for i in range(count):
            reading[i] *= channel.gain[i]
    if channel.bias != 0.0:
        for i in range(count):
            reading[i] += channel.bias
    if channel.deviation > 0.0:
        for group in range((count + 3) // 4):
            normals = four_normals(channel.keys, frame, group)
            for k in range(min(4, count - 4 * group)):
                reading[4 * group + k] += channel.deviation * normals[k]
    for i in range(count):
        if channel.resolution > 0.0:
            reading[i] = steps(reading[i], channel.resolution) * channel.resolution
        reading[i] = min(max(reading[i], channel.lowest), channel.highest)
