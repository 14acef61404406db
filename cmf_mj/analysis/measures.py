"""What a law achieves along one axis, measured on records or computed from a linear loop.

`Measures` join the bandwidths of a response, the measures of a step (`step_response`), and the
damping of a pair of poles (`linear.poles`). A linear loop is stable when all of its poles lie
within the unit circle; one at 1, an integrator's, holds no position.

A damping ratio is read in three ways, which agree for a second-order system without static error:

    damping_ratio          the overshoot over the final value, as everywhere in this project
    demand_damping_ratio   the overshoot over the demanded step, smaller where a law stops short
    peak_damping_ratio     the largest gain over absolute 0 dB, M = 1 / (2 z sqrt(1 - z^2))

The report uses the first (overshoots of 15, 7 and 23 % are 0.5, 0.6 and 0.4) and, for force
feedback, the last (1 dB is 0.5). It does not say which one Table 4-1 has.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    FrequencyResponse,
    bandwidths,
    frequency_response,
)
from cmf_mj.analysis.linear.loop import STEP_DURATION, loop_response, loop_step, loop_steps
from cmf_mj.analysis.linear.poles import (
    PoleDamping,
    are_stable,
    least_damped_mode,
    oscillations,
    slowest_oscillation,
)
from cmf_mj.analysis.spectra import SEGMENT
from cmf_mj.analysis.step_response import (
    StepMetrics,
    damping_from_overshoot,
    measure_step,
    step_metrics,
)
from cmf_mj.core.errors import NoPoseError
from cmf_mj.record.record import Record

FREQUENCIES = np.linspace(0.02, 20.0, 4000)  #: Lines of the bandwidths of a linear loop [Hz].
BAND = (0.1, 10.0)  #: Frequencies of the responses of several axes [Hz].
_AXIS_LINES = np.geomspace(*BAND, 120)
"""Lines of the responses of several axes [Hz], next to those of their poles."""

_NAN = float("nan")


def resonant_damping(peak: float) -> float:
    """Damping ratio of the second-order system whose gain peaks at `peak`: 1 / (2 z sqrt(1 - z^2)).

    NaN for a peak of no more than 1, which every damping ratio above 0.707 has.
    """
    return float(np.sin(0.5 * np.arcsin(1.0 / peak))) if peak > 1.0 else _NAN


class Measures(NamedTuple):
    """What a law achieves along one axis, a degree of freedom or a leg.

    NaN stands for what is not there or was not measured. Steps count in fractions of the step. A
    loop that is unstable, or a machine whose step rings on, has neither bandwidth nor peak nor
    measures of a step: a sweep shows its limit cycle.
    """

    phase_bandwidth_hz: float = _NAN  #: First fall of the phase through -90 deg [Hz].
    gain_bandwidth_hz: float = _NAN  #: First fall of the gain through -3 dB of absolute 0 dB [Hz].
    peak_gain_db: float = _NAN  #: Largest gain [dB].
    later_phase_hz: float = _NAN  #: Last fall through -90 deg, NaN where it falls but once [Hz].
    graze_from_hz: float = _NAN  #: From where the phase grazes -90 deg, see `Bandwidths` [Hz].
    graze_to_hz: float = _NAN  #: Likewise to which frequency [Hz].
    overshoot: float = _NAN  #: Largest excess over the final value.
    damping_ratio: float = _NAN  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float = _NAN  #: Demanded minus reached.
    rise_time: float = _NAN  #: 10 to 90 % of the final value [s].
    settling_time: float = _NAN  #: From the step to staying within 2 % of the final value [s].
    stable: bool = False
    """Verdict on the step, or of a linear loop whether all poles lie within the unit circle."""
    mode_damping_ratio: float = _NAN
    """Of one pair of poles of a linear loop, which the function that measures names."""
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


def measures_from(
    bandwidth: Bandwidths | None = None,
    step: StepMetrics | None = None,
    pair: PoleDamping | None = None,
) -> Measures:
    """Measures of a response, a step and a pair of poles; the pair's alone if the step rings on."""
    pair = pair or PoleDamping()
    measures = Measures(mode_damping_ratio=pair.damping_ratio, mode_frequency_hz=pair.frequency_hz)
    if step is not None and not step.stable:
        return measures
    if bandwidth is not None:
        measures = measures._replace(
            phase_bandwidth_hz=bandwidth.phase_hz,
            gain_bandwidth_hz=bandwidth.gain_hz,
            peak_gain_db=bandwidth.peak_db,
            later_phase_hz=bandwidth.later_phase_hz,
            graze_from_hz=bandwidth.graze_from_hz,
            graze_to_hz=bandwidth.graze_to_hz,
        )
    if step is not None:
        measures = measures._replace(
            overshoot=step.overshoot,
            damping_ratio=step.damping_ratio,
            steady_state_error=step.steady_state_error,
            rise_time=step.rise_time,
            settling_time=step.settling_time,
            stable=step.stable,
        )
    return measures


def sweep_response(
    sweep: Record, dof: str | None = None, *, segment: float = SEGMENT
) -> FrequencyResponse | None:
    """Response of a sweep, or None where single legs go too far apart for a platform."""
    try:
        return frequency_response(sweep, dof, segment=segment)
    except NoPoseError:
        return None


def measure_records(
    sweep: Record, step: Record, dof: str | None = None, *, segment: float = SEGMENT
) -> Measures:
    """Measure a law on records of a sweep and of a step of at least five seconds."""
    response = sweep_response(sweep, dof, segment=segment)
    bandwidth = bandwidths(response) if response is not None else None
    return measures_from(bandwidth, step_metrics(step, dof))


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
    pair = slowest_oscillation(poles, loop.dt)
    if not are_stable(poles):
        return measures_from(pair=pair)
    static_gain = float(np.real(np.atleast_2d(control.dcgain(loop))[0, 0]))
    _, reached = loop_step(loop, duration)
    step = measure_step(reached, 1.0 / loop.dt, final=static_gain)
    lines = np.asarray(frequencies, dtype=np.float64)
    return measures_from(bandwidths(loop_response(loop, lines)), step, pair)


class AxisMeasures(NamedTuple):
    """Measures of a linear loop of several axes."""

    measures: tuple[Measures, ...]  #: By axis.
    response: NDArray[np.complex128] | None  #: (n, n, K), outputs in rows; None if unstable.


def measure_axes(loop: control.StateSpace) -> AxisMeasures:
    """Measure each axis of a discrete loop from n demands to n motions.

    Lines are 120 from 0.1 to 10 Hz and those of the loop's poles there. Its mode is the least
    damped, all there is of an unstable loop.
    """
    poles = np.linalg.eigvals(np.asarray(loop.A))
    pair = least_damped_mode(poles, frame=loop.dt)
    axis_count = int(loop.noutputs)
    if not are_stable(poles):
        return AxisMeasures((measures_from(pair=pair),) * axis_count, None)
    pole_hz = np.abs(oscillations(poles, loop.dt)) / (2.0 * np.pi)
    lowest, highest = BAND
    lines = np.union1d(_AXIS_LINES, pole_hz[(pole_hz > lowest) & (pole_hz < highest)])
    omega = 2.0 * np.pi * lines
    response = np.asarray(control.frequency_response(loop, omega).frdata)
    steps = loop_steps(loop)
    static_gains = np.real(np.asarray(np.atleast_2d(control.dcgain(loop))))
    measures = []
    for axis in range(axis_count):
        axis_response = control.FrequencyResponseData(response[axis, axis], omega)
        final, reached = float(static_gains[axis, axis]), steps[:, axis, axis]
        step = measure_step(reached, 1.0 / loop.dt, final=final)
        measures.append(measures_from(bandwidths(axis_response), step, pair))
    return AxisMeasures(tuple(measures), response)
