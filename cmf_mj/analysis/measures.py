"""What a law achieves along one axis, measured on records or computed from a linear loop.

With y0 the rest before a step, y1 the mean of the last second and r the demanded step,

    overshoot           OS = max((y - y1) / (y1 - y0))
    damping ratio       zeta = -ln OS / sqrt(pi^2 + ln^2 OS)     second order, from overshoot
    steady-state error  (r - (y1 - y0)) / r
    rise time           10 % to 90 % of y1 - y0,   settling time into 2 % of it

A run is *stable* when its ringing ends or is ending: over the last second no leg swings more than
2 % of the largest leg step, or the swing is less than 0.75 of that three seconds earlier. A mode at
3 Hz then has a damping ratio of at least 0.005; a limit cycle has a ratio of 1. It also holds its
position: no leg ends farther from its demand than a leg would that stood still. A linear loop is
stable when all of its poles lie within the unit circle; one at 1, an integrator's, holds no
position.

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
from cmf_mj.analysis.linear.loop import STEP_DURATION, loop_response, loop_step
from cmf_mj.analysis.measurable import checked_legs, dof_history, least_demand
from cmf_mj.analysis.spectra import SEGMENT
from cmf_mj.core.errors import InputError, NoPoseError
from cmf_mj.core.units import FRAME
from cmf_mj.record.record import Record
from cmf_mj.signals.single import Step

TAIL = 1.0  #: Length of the window that gives the final value and the verdict [s].

NO_OVERSHOOT = 1e-3
"""Overshoot below which a step response counts as having none (damping ratio 0.91)."""

RESIDUAL = 0.02  #: Swing over the last window, relative to the leg step, that counts as settled.

DECAY = 0.75  #: Swing of the last window over that of `DECAY_TIME` earlier that counts as ending.

DECAY_TIME = 3.0  #: Distance of the two windows of the verdict [s].

REST, REST_TIME = 0.1, 0.25
"""Motion before the step, over the step, and the time it is looked for in [s], up to which a
response counts as one from rest."""

LEAST_RATE = 64.0
"""Least sampling rate [Hz]: four samples a cycle of the legs' fastest modes, 15 Hz, of whose swing
they show 0.71 or more."""


class StepMetrics(NamedTuple):
    """Measures of one step; fractions of the step unless a unit is given.

    >>> cmf_mj.StepMetrics._fields[:3]
    ('overshoot', 'damping_ratio', 'steady_state_error')
    """

    overshoot: float  #: Largest excess over the final value.
    damping_ratio: float  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float  #: Demanded minus reached.
    rise_time: float  #: 10 to 90 % [s].
    settling_time: float  #: From the step to staying within 2 % of the final value [s].
    residual: float
    """Largest leg swing of the last second over the largest leg step; NaN of a linear loop."""
    stable: bool  #: The verdict.


def damping_from_overshoot(overshoot: float) -> float:
    """Damping ratio of the second-order system with this overshoot; 0 from 1, NaN without one."""
    if not 0.0 < overshoot < 1.0:
        return 0.0 if overshoot >= 1.0 else float("nan")
    logarithm = np.log(overshoot)
    return float(-logarithm / np.hypot(np.pi, logarithm))


def resonant_damping(peak: float) -> float:
    """Damping ratio of the second-order system whose gain peaks at `peak`: 1 / (2 z sqrt(1 - z^2)).

    NaN for a peak of no more than 1, which every damping ratio above 0.707 has.
    """
    return float(np.sin(0.5 * np.arcsin(1.0 / peak))) if peak > 1.0 else float("nan")


def measure_step(
    reached: NDArray[np.float64], rate: float, *, final: float, demanded: float = 1.0
) -> StepMetrics:
    """Measure a step response of a stable system, one that ends, at `final`.

    `reached` is the motion from rest, sampled from the step on, (N,); `demanded` is the step.
    """
    shape = reached / final
    overshoot = float(shape.max() - 1.0)
    ten = int(np.argmax(shape >= 0.1))
    ninety = int(np.argmax(shape >= 0.9))
    outside = np.flatnonzero(np.abs(shape - 1.0) > 0.02)
    inside = int(outside[-1]) + 1 if outside.size else 0
    return StepMetrics(
        overshoot=overshoot,
        damping_ratio=damping_from_overshoot(overshoot if overshoot >= NO_OVERSHOOT else 0.0),
        steady_state_error=1.0 - final / demanded,
        rise_time=(ninety - ten) / rate,
        settling_time=inside / rate,
        residual=float("nan"),
        stable=True,
    )


def step_metrics(record: Record, dof: str | None = None) -> StepMetrics:
    """Measure a step response from leg demand to leg feedback in one degree of freedom.

    The record is of a `signals.step` that goes on for at least five seconds after the step, another
    is refused; `dof` is by default what the command moved. Where the legs have gone so far apart
    that no pose has them, the run is unstable and the measures of shape are NaN.

    >>> command = cmf_mj.signals.step("heave", 0.0254, duration=6.5)
    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", command)
    >>> round(cmf_mj.step_metrics(record).overshoot, 2)
    0.22
    """
    command, rate = record.signal_as(Step), record.rate
    chosen = dof if dof is not None else command.dof
    if rate < LEAST_RATE:
        raise InputError(f"record_every: {rate:g} samples a second; allowed: from {LEAST_RATE:g}")
    begin, end = float(record.time[0]), float(record.time[-1]) + 1.0 / rate
    if end - command.at < DECAY_TIME + 2.0 * TAIL - 1e-6 or begin >= command.at:
        raise InputError(
            f"record: must begin before the step at {command.at:g} s and must go on for "
            f"{DECAY_TIME + 2.0 * TAIL} s after the step; it has {begin:g} to {end:g} s"
        )
    checked_legs(record, "leg_position", chosen)
    demand = dof_history(record, "leg_reference", chosen)
    at = int(np.searchsorted(record.time, command.at - 1e-9))
    demanded = float(demand[-1] - demand[at - 1])
    if abs(demanded) < least_demand(record, chosen):
        raise InputError(f"dof: the record holds no step in {chosen}; it moved {command.dof}")
    residual, stable = _verdict(record)
    try:
        feedback = dof_history(record, "leg_position", chosen)
    except NoPoseError:
        nan = float("nan")
        return StepMetrics(nan, nan, nan, nan, nan, residual, False)
    tail = round(TAIL * rate)
    rest = float(feedback[at - 1])
    final = float(feedback[-tail:].mean())
    size = final - rest
    before = float(np.ptp(feedback[max(at - round(REST_TIME * rate), 0) : at]))
    if stable and before > REST * abs(demanded):
        raise InputError(
            f"record: moves by {before:.3g} m or rad in the {REST_TIME} s before a step of "
            f"{abs(demanded):.3g}; allowed: {REST:g} of it, so a larger step or a later one"
        )
    measured = measure_step(feedback[at:] - rest, rate, final=size, demanded=demanded)
    if stable and not measured.rise_time > 0.0:
        raise InputError(
            f"record: goes from 10 to 90 % of the step within a sample of {1.0 / rate:.4g} s; "
            "allowed: a motion, in a record that shows it"
        )
    return measured._replace(residual=residual, stable=stable and not ends_off_demand(record))


def _verdict(record: Record) -> tuple[float, bool]:
    legs: NDArray[np.float64] = record["leg_position"]
    reference = record["leg_reference"]
    size = float(np.abs(reference[-1] - reference[0]).max())
    tail, back = round(TAIL * record.rate), round(DECAY_TIME * record.rate)
    last = float(np.ptp(legs[-tail:], axis=0).max())
    earlier = float(np.ptp(legs[-tail - back : -back], axis=0).max())
    residual = last / size
    return residual, bool(residual < RESIDUAL or last < DECAY * earlier)


def ends_off_demand(record: Record) -> bool:
    """Whether a step ends with a leg farther from its demand than if it had stood still.

    With x the legs' mean of the last second less their rest, r the step of their demands, both (n,)
    [m], that is max |x - r| > max |r|: a law without position feedback, or with its sign turned.
    """
    legs, reference = record["leg_position"], record["leg_reference"]
    demanded = reference[-1] - reference[0]
    moved = legs[-round(TAIL * record.rate) :].mean(axis=0) - legs[0]
    return bool(np.abs(moved - demanded).max() > np.abs(demanded).max())


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


def measures_from(
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
    if widths is not None:
        measures = measures._replace(
            phase_bandwidth_hz=widths.phase_hz,
            gain_bandwidth_hz=widths.gain_hz,
            peak_gain_db=widths.peak_db,
            later_phase_hz=widths.later_phase_hz,
            graze_from_hz=widths.graze_from_hz,
            graze_to_hz=widths.graze_to_hz,
        )
    of_step = step._asdict() if step is not None else {}
    return measures._replace(**{name: of_step[name] for name in of_step if name != "residual"})


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
    return measures_from(widths, step_metrics(step, dof))


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
        return measures_from(mode=mode)
    static = float(np.real(np.atleast_2d(control.dcgain(loop))[0, 0]))
    _, reached = loop_step(loop, duration)
    step = measure_step(reached, 1.0 / loop.dt, final=static)
    lines = np.asarray(frequencies, dtype=np.float64)
    return measures_from(bandwidths(loop_response(loop, lines)), step, mode)


def are_stable(poles: NDArray[np.complex128]) -> bool:
    """The verdict on a discrete loop: whether all of its poles lie within the unit circle."""
    return bool((np.abs(poles) < _INSIDE).all())


def holds_position(poles: NDArray[np.complex128]) -> bool:
    """Whether a discrete loop holds its position: no real pole at 1 or beyond."""
    return not bool((poles.real[np.abs(poles.imag) < 1e-9] >= _INSIDE).any())


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
