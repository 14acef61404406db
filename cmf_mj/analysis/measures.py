"""What a law achieves along one axis, measured on records or computed from a linear loop.

A damping ratio is read in three ways, which agree for a second-order system without static error:

    damping_ratio          the overshoot over the final value, as everywhere in this project
    demand_damping_ratio   the overshoot over the demanded step, smaller where a law stops short
    peak_damping_ratio     the largest gain over absolute 0 dB, M = 1 / (2 z sqrt(1 - z^2))

The report uses the first (overshoots of 15, 7 and 23 % are 0.5, 0.6 and 0.4) and, for force
feedback, the last (1 dB is 0.5). It does not say which one Table 4-1 has.
"""

from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    FrequencyResponse,
    bandwidths,
    frequency_response,
)
from cmf_mj.analysis.linear.loop import STEP_DURATION, loop_response, loop_step
from cmf_mj.analysis.response.spectra import SEGMENT
from cmf_mj.analysis.step_response import (
    StepMetrics,
    damping_from_overshoot,
    measure_step,
    resonant_damping,
    step_metrics,
)
from cmf_mj.core.errors import NoPoseError
from cmf_mj.core.units import FRAME
from cmf_mj.record.record import Record

FREQUENCIES = np.linspace(0.02, 20.0, 4000)
"""Lines the bandwidths of a linear loop are read from [Hz]."""

OSCILLATING = 0.9
"""Damping ratio below which a pair of poles oscillates; above, it may be two equal real poles."""

_INSIDE = 1.0 - 1e-9
"""Modulus below which a pole counts as within the unit circle, not as an integrator's."""

_NAN = float("nan")


class Measures(NamedTuple):
    """What a law achieves along one axis, a degree of freedom or a leg.

    NaN stands for what is not there or was not measured: a crossing beyond the lines, a damping
    ratio without an overshoot. Steps count in fractions of the step. A loop that is unstable, or
    a machine whose step rings on, has neither bandwidth nor peak nor measures of a step: what a
    sweep shows then is mostly its limit cycle.
    """

    phase_bandwidth_hz: float = _NAN  #: First fall of the phase through -90 deg [Hz].
    gain_bandwidth_hz: float = _NAN
    """First fall of the gain through -3 dB, from absolute 0 dB [Hz]."""
    peak_gain_db: float = _NAN  #: Largest gain [dB].
    later_phase_hz: float = _NAN  #: Last fall through -90 deg, NaN where it falls but once [Hz].
    graze_from_hz: float = _NAN
    """Where the phase grazes -90 deg, from which frequency on; see `Bandwidths` [Hz]."""
    graze_to_hz: float = _NAN  #: Likewise to which frequency [Hz].
    overshoot: float = _NAN  #: Largest excess over the final value.
    damping_ratio: float = _NAN  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float = _NAN  #: Demanded minus reached.
    rise_time: float = _NAN  #: 10 to 90 % of the final value [s].
    settling_time: float = _NAN  #: From the step to staying within 2 % of the final value [s].
    stable: bool = False
    """Of records the verdict on the step, of a linear loop whether all poles lie within the unit
    circle; False where nothing was judged."""
    mode_damping_ratio: float = _NAN
    """Of one pair of poles of a linear loop, negative where it grows; which one says the function
    that measures. NaN from records."""
    mode_frequency_hz: float = _NAN  #: Modulus of that pair [Hz].

    @property
    def static_gain(self) -> float:
        """Gain at rest: what is reached of the demand."""
        return 1.0 - self.steady_state_error

    @property
    def demand_damping_ratio(self) -> float:
        """Damping ratio from the overshoot over the demanded step."""
        return damping_from_overshoot(self.static_gain * (1.0 + self.overshoot) - 1.0)

    @property
    def peak_damping_ratio(self) -> float:
        """Damping ratio from the largest gain over absolute 0 dB; NaN where unstable."""
        return resonant_damping(10.0 ** (self.peak_gain_db / 20.0)) if self.stable else _NAN


def joined(
    widths: Bandwidths | None = None,
    step: StepMetrics | None = None,
    mode: tuple[float, float] = (_NAN, _NAN),
) -> Measures:
    """Measures from those of a response, of a step and of a mode; what is absent is NaN.

    A step that rings on leaves those of the mode alone. `mode` is the damping ratio and the
    frequency [Hz] of a pair of poles.
    """
    measures = Measures(mode_damping_ratio=mode[0], mode_frequency_hz=mode[1])
    if step is not None and not step.stable:
        return measures
    values: dict[str, Any] = dict(zip(Measures._fields, widths or (), strict=False))
    values |= step._asdict() if step is not None else {}
    values.pop("residual", None)
    return measures._replace(**values)


def sweep_response(
    sweep: Record, dof: str | None = None, *, segment: float = SEGMENT
) -> FrequencyResponse | None:
    """Response of a sweep, or None where the legs go so far apart that no platform joins them.

    Single legs can; the verdict on the step then says unstable.
    """
    try:
        return frequency_response(sweep, dof, segment=segment)
    except NoPoseError:
        return None


def measure_records(
    sweep: Record, step: Record, dof: str | None = None, *, segment: float = SEGMENT
) -> Measures:
    """Measure a law on records of a sweep and of a step of at least five seconds."""
    response = sweep_response(sweep, dof, segment=segment)
    widths = bandwidths(response) if response is not None else None
    return joined(widths, step_metrics(step, dof))


def measure_loop(
    loop: control.StateSpace,
    *,
    frequencies: ArrayLike = FREQUENCIES,
    duration: float = STEP_DURATION,
) -> Measures:
    """Measure a closed loop of one reference and one output, discrete at 2048 Hz.

    Its mode is the slowest that oscillates, all there is of an unstable loop. `frequencies` [Hz]
    are the lines the bandwidths are read from, `duration` is the length of the step [s].
    """
    poles = np.asarray(loop.poles(), dtype=complex)
    pairs = oscillations(poles, loop.dt)
    pairs = pairs[-pairs.real < OSCILLATING * np.abs(pairs)]
    mode = _mode(pairs, np.abs(pairs))
    if not are_stable(poles):
        return joined(mode=mode)
    static = float(np.real(np.atleast_2d(control.dcgain(loop))[0, 0]))
    _, reached = loop_step(loop, duration)
    step = measure_step(reached, 1.0 / loop.dt, final=static)
    lines = np.asarray(frequencies, dtype=np.float64)
    return joined(bandwidths(loop_response(loop, lines)), step, mode)


def are_stable(poles: NDArray[np.complex128]) -> bool:
    """The verdict on a discrete loop: whether all of its poles lie within the unit circle."""
    return bool((np.abs(poles) < _INSIDE).all())


def oscillations(poles: NDArray[np.complex128], frame: float = FRAME) -> NDArray[np.complex128]:
    """Continuous poles [rad/s] above the real axis of a loop discrete in frames [s]."""
    upper: NDArray[np.complex128] = poles[poles.imag > 1e-9]
    return np.asarray(np.log(upper) / frame, dtype=complex)


def least_damped_mode(
    poles: NDArray[np.complex128],
    highest_hz: float = 50.0,
    lowest_hz: float = 0.0,
    frame: float = FRAME,
) -> tuple[float, float]:
    """Damping ratio and frequency [Hz] of the least damped pair of a loop between frequencies.

    The loop is discrete in frames [s].
    """
    pairs = oscillations(poles, frame)
    size = np.abs(pairs)
    pairs = pairs[(size < 2.0 * np.pi * highest_hz) & (size > 2.0 * np.pi * lowest_hz)]
    return _mode(pairs, -pairs.real / np.abs(pairs))


def _mode(pairs: NDArray[np.complex128], rank: NDArray[np.float64]) -> tuple[float, float]:
    """Damping ratio and frequency of the pair of the lowest rank."""
    if pairs.size == 0:
        return _NAN, _NAN
    pair = pairs[np.argmin(rank)]
    return float(-pair.real / np.abs(pair)), float(np.abs(pair) / (2.0 * np.pi))


def crosstalk(response: NDArray[np.complex128], unit: ArrayLike) -> NDArray[np.float64]:
    """Largest gains from the demand of one axis to the motion of another, (n, n).

    `response` is (n, n, K), outputs in rows; lines that are NaN are passed over. Rows are moved by
    columns and count in `unit`, what motion of each axis counts alike, such as 0.33 in and 0.2 deg,
    (n,): 1 is as much as was asked for. The diagonal is NaN.
    """
    size = np.asarray(unit, dtype=float)
    gains = np.nanmax(np.abs(response), axis=-1) * size[None, :] / size[:, None]
    np.fill_diagonal(gains, np.nan)
    return np.asarray(gains)
