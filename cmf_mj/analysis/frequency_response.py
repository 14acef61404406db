"""Frequency responses from records, and the bandwidths and crosstalk read off them.

A response goes from the DCL's leg demand to the leg feedback, both transformed to the degree of
freedom by `legs_to_pose`, as the report does, or of a single leg; host delay and DCU are outside.
The estimator is H1 (`cmf_mj.analysis.spectra`), unbiased because the demand is free of noise:
periodic records are averaged over their whole periods after the first, others by Welch's method.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, get_args

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.measurable import (
    DRIVEN_SHARE,
    check_one_session,
    demand_share,
    dof_history,
    least_demand,
)
from cmf_mj.analysis.periodic import matrix_response, periodic_response, sine_response, stitch
from cmf_mj.analysis.spectra import (
    SEGMENT,
    Complex,
    Estimate,
    Estimator,
    Real,
    mean_of_h1_and_h2,
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

_ROUNDS_BAND = (2.0 / SEGMENT, 10.5)  #: Lines of rounds [Hz], to above the 10 Hz of Table 2-3.
_GRAZE = 10.0  #: Distance of the phase from -90 deg within which it counts as grazing [deg].
_LINGER = 4.0
"""Octaves that the phase takes from `_GRAZE` above -90 deg to as much below, over those that it
takes for the `_GRAZE` before, from which it counts as lingering."""
_PHASE_NOISE = 2.0  #: How far above -90 deg the phase must come back to fall once more [deg].


class FrequencyResponse(control.FrequencyResponseData):  # type: ignore[misc]
    """A python-control frequency response that also carries its coherence and its bound.

    >>> response = cmf_mj.FrequencyResponse([1.0, -1.0j], [1.0, 2.0], [1.0, 0.9], [0.0, 0.1])
    >>> response.coherence
    [1.0, 0.9]
    """

    def __init__(
        self,
        response: Complex,
        omega: Real,
        coherence: Real,
        bound: Real | None = None,
        **keywords: Any,
    ) -> None:
        """Wrap a SISO response at `omega` [rad/s], (K,); `keywords` as of python-control."""
        keywords.setdefault("name", "response")  # python-control cannot plot a nameless one
        super().__init__(response, omega, **keywords)
        self.coherence = coherence
        """Coherence of each line, 0 to 1, (K,)."""
        self.bound = bound if bound is not None else np.full(np.shape(coherence), np.nan)
        """Radius of the 95 % circle about each response, (K,); NaN where not known."""

    @property
    def frequency(self) -> Real:
        """Frequencies [Hz], (K,)."""
        return np.asarray(self.omega) / (2.0 * np.pi)

    @property
    def response(self) -> Complex:
        """Complex response, (K,)."""
        return np.asarray(self.frdata[0, 0])

    def at(self, mask: NDArray[np.bool_]) -> "FrequencyResponse":
        """The response at some of its lines, chosen by a `mask` (K,)."""
        arrays = (self.response, np.asarray(self.omega), self.coherence, self.bound)
        return FrequencyResponse(*(np.asarray(array)[mask] for array in arrays))

    @property
    def gain_db(self) -> Real:
        """Gain [dB], (K,)."""
        return 20.0 * np.log10(np.abs(self.response))

    @property
    def phase_deg(self) -> Real:
        """Phase unwrapped from the lowest line, which lies within +-180 deg, [deg], (K,)."""
        return np.degrees(np.unwrap(np.angle(self.response)))


class Bandwidths(NamedTuple):
    """Where a response leaves its pass band; NaN where it does not within the measured lines.

    At a lightly damped pair the phase may dip, come back and fall again. It *grazes* -90 deg where
    it comes back to within 10 deg of it after having left, or lingers there: on a scale of log
    frequency it takes more than four times as far from 10 deg above to 10 deg below as for the
    10 deg before (a second-order system 1.9 to 2.3 times, of a damping ratio up to 3). A small
    change of the machine or of the amplitude then moves `phase_hz` about between both ends.
    """

    phase_hz: float  #: First frequency at which the phase falls through -90 deg [Hz].
    gain_hz: float  #: First frequency at which the gain falls through -3 dB of absolute 0 dB [Hz].
    peak_db: float  #: Largest gain [dB].
    later_phase_hz: float
    """Last fall of the phase through -90 deg after a return to 2 deg above it [Hz], or NaN."""
    graze_from_hz: float  #: Its first fall through 10 deg above -90 deg where it grazes that [Hz].
    graze_to_hz: float  #: Likewise its last fall through 10 deg below [Hz].


def frequency_response(
    record: Record, dof: str | None = None, *, segment: float = SEGMENT, estimator: Estimator = "h1"
) -> FrequencyResponse:
    """Estimate the response from leg demand to leg feedback in one degree of freedom.

    The record is of a chirp, multisine or any other broad excitation, whose band the lines lie in;
    `dof` may be a leg, `leg_1` and so on, and is by default what the command moved. `segment` is
    the length of Welch's segments [s], for records that are not periodic. The `estimator` is `h1`
    or `report`, that of Appendix A, over the periods of a multisine the mean of H1 and H2. Raises
    `InputError` without excitation, for a record shorter than a segment or legs without a pose.

    >>> command = cmf_mj.signals.multisine("heave", 0.005, period=4.0, periods=2)
    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", command)
    >>> response = cmf_mj.frequency_response(record)
    >>> bool(response.coherence.min() > 0.9)
    True
    """
    check_name("estimator", estimator, get_args(Estimator))
    command = record.excitation
    axis = dof if dof is not None else command.axis
    demand = dof_history(record, "leg_reference", axis)
    feedback = dof_history(record, "leg_position", axis)
    if np.ptp(demand) < least_demand(record, axis):
        moved = command.axis or "another"
        raise InputError(f"dof: the record holds no demand in {axis}; it moved {moved}")
    if isinstance(command, Multisine):
        h1 = excited_response(demand, feedback, record.rate, command)
        return _as_response(mean_of_h1_and_h2(h1) if estimator == "report" else h1)
    # The rest before the excitation is the base line; it also lets the start-up settle.
    begin = max(round(command.lead * record.rate) - 1, 0)
    x = demand[begin:] - demand[begin]
    y = feedback[begin:] - feedback[begin]
    if estimator == "report":
        band = _band(command, record.rate, segment)
        return _as_response(report_response(x, y, record.rate, band=band))
    return _as_response(excited_response(x, y, record.rate, command, segment))


def excited_response(
    x: Real,
    y: Real,
    rate: float,
    command: Signal,
    segment: float = SEGMENT,
) -> Estimate:
    """Response by H1, over whole periods of a multisine, by Welch's method otherwise; x, y (N,)."""
    if not isinstance(command, Multisine):
        band = _band(command, rate, segment)
        return welch_response(x, y, rate, segment=segment, band=band, pad=True)
    samples = round(command.period * rate)
    if abs(samples - command.period * rate) > 1e-9:
        raise InputError(f"record_every: a period is not a whole number of samples at {rate}")
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    orders = np.arange(frequency.size)
    is_excited = (orders % 2 == 1) & (frequency >= command.start - 1e-9)
    is_excited &= frequency <= command.stop + 1e-9
    periods = slice(command.periods * samples)
    return periodic_response(x[periods], y[periods], rate, command.period, orders[is_excited])


def _band(command: Signal, rate: float, segment: float) -> tuple[float, float]:
    """Lines that an excitation drives and segments resolve [Hz]."""
    low, high = command.band or (0.0, rate / 4.0)
    return max(low, 2.0 / segment), high


def rounds_response(
    records: Sequence[Record], dof: str | None = None, *, estimator: Estimator = "h1"
) -> FrequencyResponse:
    """One response from several records of single sines, such as the facility's five rounds.

    `h1`: where a record carries its dwells, each is fitted by least squares over whole cycles.
    Records without dwells are put end to end and estimated by Welch's method, at the lines that the
    demand drives. `report`: as Appendix A does it, all records end to end in their order, without
    a straight line, and its estimator over the whole, all lines up to 10.5 Hz, also between the
    sines. `dof` is a degree of freedom or a leg, default the one the first command moved. Raises
    `InputError` for no records, no demand, one record given twice, and records that differ in rate,
    axis, law or machine.
    """
    check_name("estimator", estimator, get_args(Estimator))
    if not records:
        raise InputError("records: none given; at least one is needed")
    rates = sorted({record.rate for record in records})
    if len(rates) > 1:
        raise InputError(f"records: rates are {', '.join(map(str, rates))} Hz; must be one")
    check_one_session(records)
    axis, rate = dof if dof is not None else records[0].signal.axis, rates[0]
    demands = [dof_history(record, "leg_reference", axis) for record in records]
    motions = [dof_history(record, "leg_position", axis) for record in records]
    if max(map(np.ptp, demands)) < max(least_demand(record, axis) for record in records):
        raise InputError(f"dof: the records hold no demand in {axis}")
    if estimator == "report":
        x, y = np.concatenate(demands), np.concatenate(motions)
        return _as_response(report_response(x, y, rate, band=_ROUNDS_BAND))
    if all(record.signal.dwells for record in records):
        rounds = zip(records, demands, motions, strict=True)
        fits = [fit for record, x, y in rounds for fit in _dwell_fits(record, x, y)]
        return _as_response(stitch(fits))
    x = np.concatenate([demand - demand[0] for demand in demands])
    y = np.concatenate([motion - motion[0] for motion in motions])
    estimate = welch_response(x, y, rate, band=_ROUNDS_BAND, pad=True)
    is_driven = demand_share(x, rate, estimate.frequency) > DRIVEN_SHARE
    return _as_response(estimate).at(is_driven)


def _dwell_fits(record: Record, x: Real, y: Real) -> Iterator[Estimate]:
    """Response at each dwell of a record with input and output (N,)."""
    samples_per_frame = record.rate / record.signal.rate
    for dwell in record.signal.dwells:
        # Inwards to whole samples; the fit takes the whole cycles that lie between.
        first = int(np.ceil(dwell.start * samples_per_frame))
        last = int((dwell.start + dwell.frames) * samples_per_frame) + 1
        yield sine_response(x[first:last], y[first:last], record.rate, dwell.frequency)


def matrix_frequency_response(record: Record) -> control.FrequencyResponseData:
    """The full 6 by 6 response from pose demand to pose feedback, of one run.

    The record is of `signals.orthogonal_multisines`. Each column is measured at its lines and
    interpolated to the lines of all, NaN outside them; in m and rad, outputs in rows.
    """
    command = record.signal_as(OrthogonalMultisines)
    record.excitation  # noqa: B018 - refused here if the record is too slow
    periods = slice(round(command.period * record.rate) * command.periods)
    machine = recorded_machine(record.metadata)
    demand = legs_to_pose(record["leg_reference"][periods], machine)
    feedback = legs_to_pose(record["leg_position"][periods], machine)
    rate, period = record.rate, command.period
    frequency, response = matrix_response(demand, feedback, rate, period, band=command.band)
    names = {"inputs": [f"{dof}_demand" for dof in DOFS], "outputs": list(DOFS)}
    matrix, omega = np.moveaxis(response, 0, -1), 2.0 * np.pi * frequency
    return control.FrequencyResponseData(matrix, omega, name="response", **names)


def crosstalk(response: Complex, unit: ArrayLike) -> Real:
    """Largest gains from the demand of one axis to the motion of another, (n, n), diagonal NaN.

    `response` is (n, n, K), outputs in rows; lines that are NaN are passed over. Motions count in
    `unit` of each axis, such as 0.33 in and 0.2 deg, (n,): 1 is as much as was demanded.
    """
    size = np.asarray(unit, dtype=float)
    gains = np.nanmax(np.abs(response), axis=-1) * size[None, :] / size[:, None]
    np.fill_diagonal(gains, np.nan)
    return np.asarray(gains)


def _as_response(estimate: Estimate) -> FrequencyResponse:
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


def line_bandwidths(frequency: ArrayLike, response: Complex) -> Bandwidths:
    """`bandwidths` of a complex response (K,) at lines [Hz], (K,), ascending."""
    lines = np.asarray(frequency, dtype=np.float64)
    if lines.size == 0:
        raise InputError("response: has no lines; allowed: at least 1")
    gain = 20.0 * np.log10(np.abs(response))
    phase = np.degrees(np.unwrap(np.angle(response))) + 90.0
    phase_falls = find_falls(lines, phase, 0.0)
    returns = lines[(phase > _PHASE_NOISE) & (lines > phase_falls[0])]
    falls_again = returns.size and phase_falls[-1] > returns[-1]
    graze_from, graze_to = _graze(lines, phase)
    return Bandwidths(
        phase_hz=float(phase_falls[0]),
        gain_hz=float(find_falls(lines, gain, -3.0)[0]),
        peak_db=float(gain.max()),
        later_phase_hz=float(phase_falls[-1]) if falls_again else float("nan"),
        graze_from_hz=graze_from,
        graze_to_hz=graze_to,
    )


def find_falls(frequency: Real, values: Real, level: float) -> Real:
    """Frequencies at which values fall through a level, NaN alone where they do not."""
    rows = np.flatnonzero((values[1:] < level) & (values[:-1] >= level))
    if rows.size == 0:
        return np.array([np.nan])
    share = (level - values[rows]) / (values[rows + 1] - values[rows])
    return np.asarray(frequency[rows] + share * (frequency[rows + 1] - frequency[rows]))


def _graze(frequency: Real, phase: Real) -> tuple[float, float]:
    """Both ends of the band in which the phase over -90 deg grazes 0; NaN where it does not."""
    far_above, above, below = (find_falls(frequency, phase, n * _GRAZE) for n in (2, 1, -1))
    first, last = above[0], below[-1]
    comes_back = max(above.size, below.size) > 1
    lingers = np.log(last / first) > _LINGER * np.log(first / far_above[0])
    return (float(first), float(last)) if comes_back or lingers else (np.nan, np.nan)
