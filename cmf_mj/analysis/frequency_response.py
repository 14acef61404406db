"""Frequency responses from records, and the bandwidths read off them.

A response goes from the DCL's leg demand to the leg feedback, both transformed to the degree of
freedom by `legs_to_pose`, as the report does, or of a single leg; host delay and DCU are outside.
The estimator is H1,

    H1 = S_xy / S_xx,    coherence = |S_xy|^2 / (S_xx S_yy)

unbiased here because the demand is free of noise: periodic records are averaged over their whole
periods after the first, others by Welch's method (`cmf_mj.analysis.spectra`, which has
the others).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.measurable import (
    DRIVEN_SHARE,
    check_alike,
    demand_share,
    dof_history,
    least_demand,
)
from cmf_mj.analysis.periodic import matrix_response, periodic_response, sine_response, stitch
from cmf_mj.analysis.spectra import (
    SEGMENT,
    Estimate,
    Estimator,
    mean_of_both,
    report_response,
    welch_response,
)
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record
from cmf_mj.signals.composite import OrthogonalMultisines
from cmf_mj.signals.signal import Signal
from cmf_mj.signals.single import Multisine

_HIGHEST = 10.5  #: Highest line of rounds [Hz], above the 10 Hz of Table 2-3.

GRAZE = 10.0  #: Distance of the phase from -90 deg within which it counts as grazing [deg].

LINGER = 4.0  #: How many times as far the phase goes about -90 deg as before where it lingers.

NOISE = 2.0  #: How far above -90 deg the phase must come back to fall through it once more [deg].


class FrequencyResponse(control.FrequencyResponseData):  # type: ignore[misc]
    """A python-control frequency response that also carries its coherence and its bound.

    >>> response = cmf_mj.FrequencyResponse([1.0, -1.0j], [1.0, 2.0], [1.0, 0.9], [0.0, 0.1])
    >>> response.coherence
    [1.0, 0.9]
    """

    def __init__(
        self,
        response: NDArray[np.complex128],
        omega: NDArray[np.float64],
        coherence: NDArray[np.float64],
        bound: NDArray[np.float64] | None = None,
        **keywords: Any,
    ) -> None:
        """Wrap a SISO response at `omega` [rad/s], (K,); `keywords` as of python-control."""
        keywords.setdefault("name", "response")  # python-control cannot plot a nameless one
        super().__init__(response, omega, **keywords)
        self.coherence = coherence
        """Coherence of each line, 0 to 1, (K,)."""
        self.bound = bound if bound is not None else np.full(np.shape(coherence), np.nan)
        """Radius of the circle about each line's response that holds the true one with 95 %
        probability, (K,): random error only; infinite from one average, NaN where not known."""

    @property
    def frequency(self) -> NDArray[np.float64]:
        """Frequencies [Hz], (K,)."""
        return np.asarray(self.omega) / (2.0 * np.pi)

    @property
    def response(self) -> NDArray[np.complex128]:
        """Complex response, (K,)."""
        return np.asarray(self.frdata[0, 0])

    def at(self, lines: NDArray[np.bool_]) -> "FrequencyResponse":
        """The response at some of its lines, chosen by a mask (K,)."""
        parts = (self.response, np.asarray(self.omega), self.coherence, self.bound)
        return FrequencyResponse(*(np.asarray(part)[lines] for part in parts))

    @property
    def gain_db(self) -> NDArray[np.float64]:
        """Gain [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.response))

    @property
    def phase_deg(self) -> NDArray[np.float64]:
        """Phase unwrapped from the lowest line, which lies within +-180 deg, [deg], (K,)."""
        return np.degrees(np.unwrap(np.angle(self.response)))


class Bandwidths(NamedTuple):
    """Where a response leaves its pass band; NaN where it does not within the measured lines.

    At a lightly damped pair the phase may dip, come back and fall again. It *grazes* -90 deg where
    it comes back to within `GRAZE` of it after having left, or lingers there: on a scale of log
    frequency it takes more than four times as far from `GRAZE` above to `GRAZE` below as for the
    `GRAZE` before (a second-order system 1.9 to 2.3 times, of a damping ratio up to 3). A small
    change of the machine or of the amplitude then moves `phase_hz` about between both ends.
    """

    phase_hz: float  #: First frequency at which the phase falls through -90 deg [Hz].
    gain_hz: float
    """First frequency at which the gain falls through -3 dB, from absolute 0 dB [Hz]."""
    peak_db: float  #: Largest gain [dB].
    later_phase_hz: float
    """Last fall of the phase through -90 deg after it came back to `NOISE` above it [Hz]; NaN where
    it falls but once."""
    graze_from_hz: float
    """Where the phase grazes -90 deg, its first fall through `GRAZE` above it [Hz]; else NaN."""
    graze_to_hz: float  #: Likewise its last fall through `GRAZE` below [Hz].


def frequency_response(
    record: Record, dof: str | None = None, *, segment: float = SEGMENT, estimator: Estimator = "h1"
) -> FrequencyResponse:
    """Estimate the response from leg demand to leg feedback in one degree of freedom.

    The record is of a chirp, multisine or any other broad excitation; `dof` may be a leg, `leg_1`
    and so on, and is by default what the command moved. `segment` is the length of Welch's segments
    [s], for records that are not periodic. The `estimator` is `h1` or `report`, that of Appendix A,
    with its segments, or over the periods of a multisine the mean of H1 and H2.

    The lines lie within the excited band. Raises `InputError` without excitation in this degree of
    freedom, and for a record shorter than a segment or legs that no pose has.

    >>> command = cmf_mj.signals.multisine("heave", 0.005, period=4.0, periods=2)
    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", command)
    >>> response = cmf_mj.frequency_response(record)
    >>> bool(response.coherence.min() > 0.9)
    True
    """
    check_name("estimator", estimator, get_args(Estimator))
    command = record.excitation
    chosen = dof if dof is not None else command.axis
    demand = dof_history(record, "leg_reference", chosen)
    feedback = dof_history(record, "leg_position", chosen)
    if np.ptp(demand) < least_demand(record, chosen):
        raise InputError(
            f"dof: the record holds no demand in {chosen}; it moved {command.axis or 'another'}"
        )
    if isinstance(command, Multisine):
        periodic = excited_response(demand, feedback, record.rate, command)
        return _wrapped(mean_of_both(periodic) if estimator == "report" else periodic)
    # The rest before the excitation is the base line; it also lets the start-up settle.
    begin = max(round(command.lead * record.rate) - 1, 0)
    x = demand[begin:] - demand[begin]
    y = feedback[begin:] - feedback[begin]
    if estimator == "report":
        band = _band(command, record.rate, segment)
        return _wrapped(report_response(x, y, record.rate, band=band))
    return _wrapped(excited_response(x, y, record.rate, command, segment))


def excited_response(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    rate: float,
    command: Signal,
    segment: float = SEGMENT,
) -> Estimate:
    """Response by H1, over whole periods of a multisine, by Welch's method otherwise.

    x and y are (N,), `command` is the excitation, `Record.signal`. Raises `InputError` for a period
    that is not a whole number of samples, or a record shorter than a segment.
    """
    if not isinstance(command, Multisine):
        band = _band(command, rate, segment)
        return welch_response(x, y, rate, segment=segment, band=band, pad=True)
    samples = round(command.period * rate)
    if abs(samples - command.period * rate) > 1e-9:
        raise InputError(f"record_every: a period is not a whole number of samples at {rate}")
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    orders = np.arange(frequency.size)
    lines = (orders % 2 == 1) & (frequency >= command.start - 1e-9)
    lines &= frequency <= command.stop + 1e-9
    whole = slice(command.periods * samples)
    return periodic_response(x[whole], y[whole], rate, command.period, orders[lines])


def _band(command: Signal, rate: float, segment: float) -> tuple[float, float]:
    """Lines that an excitation drives and segments resolve [Hz]."""
    low, high = command.band or (0.0, rate / 4.0)
    return max(low, 2.0 / segment), high


def rounds_response(
    records: Sequence[Record], dof: str | None = None, *, estimator: Estimator = "h1"
) -> FrequencyResponse:
    """One response from several records of single sines, such as the facility's five rounds.

    `h1`: where a record carries its dwells, each is fitted by least squares over whole cycles.
    Records without are put end to end, estimated by Welch's method, and of its lines those are kept
    that the demand drives. `report`: as Appendix A does it, all records end to end in their order,
    a straight line taken off, and its estimator over the whole, all lines up to 10.5 Hz, those
    between the sines too. `dof` is a degree of freedom or a leg, default the one the first command
    moved. Raises `InputError` for no records, no demand, one record given twice, and records that
    differ in rate, axis, law or machine.
    """
    check_name("estimator", estimator, get_args(Estimator))
    if not records:
        raise InputError("records: none given; at least one is needed")
    rates = sorted({record.rate for record in records})
    if len(rates) > 1:
        raise InputError(f"records: rates are {', '.join(map(str, rates))} Hz; must be one")
    check_alike(records)
    chosen = dof if dof is not None else records[0].signal.axis
    pairs = [
        tuple(dof_history(record, name, chosen) for name in ("leg_reference", "leg_position"))
        for record in records
    ]
    if max(np.ptp(x) for x, _ in pairs) < max(least_demand(r, chosen) for r in records):
        raise InputError(f"dof: the records hold no demand in {chosen}")
    band = (2.0 / SEGMENT, _HIGHEST)
    if estimator == "report":
        x, y = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        return _wrapped(report_response(x, y, rates[0], band=band))
    if all(record.signal.dwells for record in records):
        fits = []
        for record, (x, y) in zip(records, pairs, strict=True):
            per_frame = record.rate / record.signal.rate
            for dwell in record.signal.dwells:
                # Inwards to whole samples; the fit takes the whole cycles that are left.
                first = int(np.ceil(dwell.start * per_frame))
                last = int((dwell.start + dwell.frames) * per_frame) + 1
                fits.append(
                    sine_response(x[first:last], y[first:last], record.rate, dwell.frequency)
                )
        return _wrapped(stitch(fits))
    x, y = (
        np.concatenate([part - part[0] for part in parts]) for parts in zip(*pairs, strict=True)
    )
    estimate = welch_response(x, y, rates[0], band=band, pad=True)
    driven = demand_share(x, rates[0], estimate.frequency) > DRIVEN_SHARE
    return _wrapped(estimate).at(driven)


def matrix_frequency_response(record: Record) -> control.FrequencyResponseData:
    """The full 6 by 6 response from pose demand to pose feedback, of one run.

    The record is of `signals.orthogonal_multisines` in all six degrees of freedom. Each column is
    measured at its lines and interpolated to the lines of all, NaN outside them; m and rad per m
    and rad, outputs in rows.
    """
    command = record.signal_as(OrthogonalMultisines)
    record.excitation  # noqa: B018 - refused here if the record is too slow
    whole = slice(round(command.period * record.rate) * command.periods)
    machine = recorded_machine(record.metadata)
    demand, feedback = (
        legs_to_pose(record[name][whole], machine) for name in ("leg_reference", "leg_position")
    )
    how = (record.rate, command.period)
    frequency, response = matrix_response(demand, feedback, *how, band=command.band)
    names = {"inputs": [f"{dof}_demand" for dof in DOFS], "outputs": list(DOFS)}
    matrix, omega = np.moveaxis(response, 0, -1), 2.0 * np.pi * frequency
    return control.FrequencyResponseData(matrix, omega, name="response", **names)


def _wrapped(estimate: Estimate) -> FrequencyResponse:
    omega = 2.0 * np.pi * estimate.frequency
    return FrequencyResponse(estimate.response, omega, estimate.coherence, estimate.radius)


def bandwidths(response: control.FrequencyResponseData) -> Bandwidths:
    """Read -90 deg and -3 dB bandwidth and peak gain off a SISO response.

    Crossings are interpolated linearly between lines; -3 dB counts from absolute 0 dB, so a law
    with a static error starts below it.

    >>> lag = control.frequency_response(control.tf([1], [0.01, 0.2, 1]), [1, 5, 9, 11, 20])
    >>> round(cmf_mj.bandwidths(lag).phase_hz, 1)
    1.6
    """
    frequency = np.asarray(response.omega) / (2.0 * np.pi)
    return line_bandwidths(frequency, np.asarray(response.frdata[0, 0]))


def line_bandwidths(frequency: ArrayLike, response: NDArray[np.complex128]) -> Bandwidths:
    """`bandwidths` of a complex response (K,) at lines [Hz], (K,), ascending."""
    lines = np.asarray(frequency, dtype=np.float64)
    if lines.size == 0:
        raise InputError("response: has no lines; allowed: at least 1")
    gain = 20.0 * np.log10(np.abs(response))
    phase = np.degrees(np.unwrap(np.angle(response))) + 90.0
    through = falls(lines, phase, 0.0)
    back = lines[(phase > NOISE) & (lines > through[0])]
    again = back.size and through[-1] > back[-1]
    later = float(through[-1]) if again else float("nan")
    gain_hz = float(falls(lines, gain, -3.0)[0])
    return Bandwidths(float(through[0]), gain_hz, float(gain.max()), later, *_graze(lines, phase))


def falls(
    frequency: NDArray[np.float64], values: NDArray[np.float64], level: float
) -> NDArray[np.float64]:
    """Frequencies at which values fall through a level, NaN alone where they do not."""
    i = np.flatnonzero((values[1:] < level) & (values[:-1] >= level))
    if i.size == 0:
        return np.array([np.nan])
    share = (level - values[i]) / (values[i + 1] - values[i])
    return np.asarray(frequency[i] + share * (frequency[i + 1] - frequency[i]))


def _graze(frequency: NDArray[np.float64], phase: NDArray[np.float64]) -> tuple[float, float]:
    """Both ends of the band in which the phase over -90 deg grazes 0; NaN where it does not."""
    before, above, below = (falls(frequency, phase, n * GRAZE) for n in (2, 1, -1))
    again = max(above.size, below.size) > 1
    lingers = np.log(below[-1] / above[0]) > LINGER * np.log(above[0] / before[0])
    return (float(above[0]), float(below[-1])) if again or lingers else (float("nan"), float("nan"))
