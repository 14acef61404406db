"""The steady oscillation at the end of a run, which a law that is unstable settles on."""

from typing import NamedTuple

import numpy as np

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.record.record import Record

_TAIL = 4.0  #: Length of the oscillation examined [s].
_LEAST_AMPLITUDE = 10.0 * units.PSI  #: Amplitude below which the oscillation has died down [Pa].


class LimitCycle(NamedTuple):
    """A steady oscillation of leg 1."""

    frequency: float  #: [Hz]; NaN where the oscillation has died down.
    amplitude: float  #: Half the swing of cap less rod pressure [Pa].
    acceleration: float  #: Largest reading of the accelerometer [m/s^2].


def limit_cycle(record: Record) -> LimitCycle:
    """The oscillation over the last 4 s; raises `InputError` for a shorter record."""
    tail, duration = round(_TAIL * record.rate), record.time.size / record.rate
    if duration < _TAIL:
        raise InputError(f"record: {duration:.3g} s are too short; allowed: {_TAIL:g} s or more")
    pressure = (record["cap_pressure"] - record["rod_pressure"])[-tail:, 0]
    pressure = pressure - pressure.mean()
    amplitude = float(np.ptp(pressure)) / 2.0
    acceleration = float(np.abs(record["leg_acceleration"][-tail:, 0]).max())
    if amplitude < _LEAST_AMPLITUDE:
        return LimitCycle(float("nan"), amplitude, acceleration)
    spectrum = np.abs(np.fft.rfft(pressure * np.hanning(tail)))
    return LimitCycle(float(np.argmax(spectrum) / _TAIL), amplitude, acceleration)
