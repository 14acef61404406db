"""Frequency responses recovered from records of known linear systems."""

from functools import cache

import control
import numpy as np
import pytest
from followed_commands import answer, record_of, second_order
from numpy.typing import NDArray
from scipy import optimize

from cmf_mj import FrequencyResponse, bandwidths, frequency_response, signals
from cmf_mj.analysis.frequency_response import _LINGER, line_bandwidths
from cmf_mj.machine.geometry import DOFS

RATE = 2048
AMPLITUDE = 0.33 * 0.0254  #: The report's 0.33 in [m].

KINDS = ("chirp", "multisine")


def response(command: signals.Command, system: control.TransferFunction) -> NDArray[np.float64]:
    """Pose history (N, 6) of `system`, inputs joined by lines: below 10 Hz the sampled system is
    the continuous one within (2 pi 10 / 2048)^2 / 12 = 1e-4 of gain, without delay."""
    return answer(command, system, "foh")


def excitation(kind: str, dof: str = "heave", amplitude: float = AMPLITUDE) -> signals.Command:
    """The report's chirp of 100 s, or a multisine of three periods of 10 s."""
    if kind == "chirp":
        return signals.chirp(dof, amplitude)
    return signals.multisine(dof, amplitude, period=10.0)


@cache
def measured(
    kind: str,
    zeta: float = 0.7,
    hertz: float = 3.0,
    gain: float = 1.0,
    dof: str = "heave",
    amplitude: float = AMPLITUDE,
) -> FrequencyResponse:
    """The response estimated from a second-order system's record at 256 Hz."""
    command = excitation(kind, dof, amplitude)
    feedback = response(command, second_order(zeta, hertz, gain))
    return frequency_response(record_of(command, feedback, 8))


def exact(system: control.TransferFunction, hertz: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.ravel(system(2j * np.pi * hertz))


def compare(result: FrequencyResponse, system: control.TransferFunction) -> None:
    """Gain within 0.05 dB and phase within 0.5 deg from 0.3 to 8 Hz."""
    band = (result.frequency >= 0.3 - 1e-9) & (result.frequency <= 8.0)
    assert band.sum() >= 39
    ratio = result.response[band] / exact(system, result.frequency[band])
    np.testing.assert_allclose(20 * np.log10(np.abs(ratio)), 0.0, rtol=0, atol=0.05)
    np.testing.assert_allclose(np.degrees(np.angle(ratio)), 0.0, rtol=0, atol=0.5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("zeta", "hertz"), [(0.7, 3.0), (0.5, 1.8)])
def test_a_well_damped_system_is_recovered(kind: str, zeta: float, hertz: float) -> None:
    """0.05 dB, 0.5 deg from 0.3 to 8 Hz against the transfer function."""
    compare(measured(kind, zeta, hertz, 0.93), second_order(zeta, hertz, 0.93))


@pytest.mark.parametrize("dof", DOFS)
def test_every_degree_of_freedom_is_recovered(dof: str) -> None:
    """0.33 in or 0.2 deg (Appendix D); the six legs carry each motion in their own way."""
    amplitude = np.radians(0.2) if dof in DOFS[3:] else AMPLITUDE
    result = measured("multisine", 0.6, 2.5, dof=dof, amplitude=amplitude)
    compare(result, second_order(0.6, 2.5))


def test_every_frame_of_a_record_serves_as_well() -> None:
    """2048 Hz instead of one frame in eight, two periods of 10 s."""
    system = second_order(0.7, 3.0)
    command = signals.multisine("heave", AMPLITUDE, period=10.0, periods=2)
    compare(frequency_response(record_of(command, response(command, system))), system)


@pytest.mark.parametrize(("kind", "least"), [("chirp", 0.999), ("multisine", 1 - 1e-9)])
def test_coherence_of_a_linear_system_is_one(kind: str, least: float) -> None:
    """Linear, no noise. The multisine is periodic, its coherence exact; Welch's segments of the
    chirp leak a little into each other."""
    result = measured(kind)
    assert result.coherence.shape == result.frequency.shape
    assert result.coherence.max() <= 1.0 + 1e-12
    inner = (result.frequency >= 0.3) & (result.frequency <= 8.0)
    assert result.coherence[inner].min() > least


def test_coherence_falls_with_noise() -> None:
    """As much noise as signal on the output of gain 1: coherence c = S_xx / (S_xx + S_nn) = 0.5,
    estimated with the bias (1 - c)^2 / M of M = 24 averages (Bendat and Piersol). 0.1: the mean of
    10 lines whose deviation is (1 - c) sqrt(2 c / M) = 0.1 each, three times that over sqrt(10).
    """
    command = signals.multisine("heave", AMPLITUDE, period=2.0, periods=25, start=0.5)
    samples = 2 * RATE // 8
    once = command.pose[::8, DOFS.index("heave")][:samples]
    lines = np.abs(np.fft.rfft(once)[1:21:2]) ** 2
    sigma = np.sqrt(lines.mean() / samples)
    feedback = command.pose.copy()
    feedback[:, DOFS.index("heave")] += np.random.default_rng(7).normal(0, sigma, len(feedback))
    result = frequency_response(record_of(command, feedback, 8))
    assert result.coherence.size == 10
    assert result.coherence.mean() == pytest.approx(0.5 + 0.25 / 24, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_standing_offset_does_not_count(kind: str) -> None:
    """A constant distance between demand and feedback, as a law with static error has at rest.
    1e-6: the poses of the legs are exact to 1e-9 m of 8 mm."""
    command = excitation(kind)
    feedback = response(command, second_order(0.7, 3.0))
    feedback[:, DOFS.index("heave")] += 0.002
    result = frequency_response(record_of(command, feedback, 8))
    np.testing.assert_allclose(result.response, measured(kind).response, rtol=1e-6)


def test_the_response_is_a_control_frequency_response() -> None:
    """It goes into python-control as it is."""
    result = measured("multisine")
    assert isinstance(result, FrequencyResponse)
    assert isinstance(result, control.FrequencyResponseData)
    assert result.ninputs == result.noutputs == 1
    np.testing.assert_allclose(result.omega, 2 * np.pi * result.frequency, rtol=1e-15)
    np.testing.assert_array_equal(np.ravel(result.frdata), result.response)
    np.testing.assert_allclose(
        np.ravel(result.feedback().frdata), result.response / (1 + result.response), rtol=1e-12
    )


def test_a_single_leg_serves_as_well() -> None:
    """Leg 3 in leg space, as heave moves all legs alike: the heave response within 1 %."""
    command = excitation("multisine")
    record = record_of(command, response(command, second_order(0.7, 3.0)), 8)
    leg = frequency_response(record, "leg_3")
    np.testing.assert_allclose(leg.response, measured("multisine").response, rtol=0, atol=0.01)
    with pytest.raises(ValueError, match="dof: 'leg_7' is not one of leg_1, leg_2"):
        frequency_response(record, "leg_7")


@pytest.mark.parametrize("kind", KINDS)
def test_the_reports_estimator_recovers_a_system_without_noise(kind: str) -> None:
    """3 % of gain 1 from 0.5 to 8 Hz; the report's segments cut the sweep at their ends."""
    command = excitation(kind)
    system = second_order(0.7, 3.0)
    result = frequency_response(
        record_of(command, response(command, system), 8), estimator="report"
    )
    inner = (result.frequency >= 0.5) & (result.frequency <= 8.0)
    off = result.response - exact(system, result.frequency)
    np.testing.assert_allclose(np.abs(off[inner]), 0.0, rtol=0, atol=0.03)


def test_lines_lie_within_the_excited_band() -> None:
    """Odd multiples of 1/period for the multisine, every 1/segment for the chirp."""
    periodic = measured("multisine").frequency
    np.testing.assert_allclose(periodic, np.arange(1, 101, 2) / 10.0, rtol=1e-12)
    swept = measured("chirp").frequency
    np.testing.assert_allclose(np.diff(swept), 0.05, rtol=1e-9)
    assert 0.01 <= swept[0] <= 0.1 + 1e-9
    assert 9.9 < swept[-1] <= 10.0 + 1e-9


def test_phase_is_unwrapped() -> None:
    """Four lags in series run through -180 deg without a jump: -4 atan(w / a)."""
    omega = 2 * np.pi * np.linspace(0.05, 10.0, 400)
    lag = 2 * np.pi * 2.0
    values = (1 / (1 + 1j * omega / lag)) ** 4
    result = FrequencyResponse(values, omega, np.ones(omega.size))
    assert result.phase_deg[-1] < -300.0
    np.testing.assert_allclose(result.phase_deg, -4 * np.degrees(np.arctan(omega / lag)), atol=1e-9)
    np.testing.assert_allclose(result.gain_db, -40 * np.log10(1 + (omega / lag) ** 2), atol=1e-12)


# -- bandwidths ---------------------------------------------------------------------------------


def analytic(system: control.TransferFunction, stop: float = 10.0) -> FrequencyResponse:
    hertz = np.arange(1, round(stop / 0.05) + 1) * 0.05
    return FrequencyResponse(exact(system, hertz), 2 * np.pi * hertz, np.ones(hertz.size))


def minus_three_db(system: control.TransferFunction, low: float = 0.5, high: float = 10.0) -> float:
    """Frequency between two others at which the gain is -3 dB, from absolute 0 dB [Hz]."""

    def excess(hertz: float) -> float:
        return float(20 * np.log10(abs(system(2j * np.pi * hertz)))) + 3.0

    return optimize.brentq(excess, low, high)


@pytest.mark.parametrize("gain", [0.931, 1.0])
@pytest.mark.parametrize(("zeta", "hertz"), [(0.3, 2.03), (0.5, 3.47), (0.9, 4.0)])
def test_bandwidths_of_a_second_order_system(zeta: float, hertz: float, gain: float) -> None:
    """-90 deg at the natural frequency, -3 dB where the formula has it, peak gain
    1 / (2 zeta sqrt(1 - zeta^2)). 1e-3 Hz and 0.01 dB: linear interpolation between lines of
    0.05 Hz; 0.931 is the velocity law's DC gain."""
    system = second_order(zeta, hertz, gain)
    result = bandwidths(analytic(system))
    assert result.phase_hz == pytest.approx(hertz, abs=1e-3)
    assert result.gain_hz == pytest.approx(minus_three_db(system), abs=1e-3)
    if zeta < np.sqrt(0.5):
        peak = gain / (2 * zeta * np.sqrt(1 - zeta**2))
        assert result.peak_db == pytest.approx(20 * np.log10(peak), abs=1e-2)
    else:
        assert result.peak_db == pytest.approx(20 * np.log10(gain), abs=1e-2)


def test_minus_three_db_counts_from_absolute_zero() -> None:
    """A gain of 0.5 is below -3 dB from the first line: no crossing within the lines."""
    result = bandwidths(analytic(second_order(0.7, 3.0, gain=0.5)))
    assert np.isnan(result.gain_hz)
    assert result.phase_hz == pytest.approx(3.0, abs=1e-3)


def test_no_crossing_is_nan() -> None:
    """A system faster than the lines measured, and one that does nothing."""
    fast = bandwidths(analytic(second_order(0.7, 40.0)))
    assert np.isnan(fast.phase_hz)
    assert np.isnan(fast.gain_hz)
    still = bandwidths(analytic(control.tf([1.0], [1.0])))
    assert np.isnan(still.phase_hz)
    assert np.isnan(still.gain_hz)
    assert still.peak_db == pytest.approx(0.0, abs=1e-12)


def test_the_first_crossing_counts() -> None:
    """A notch at 2 Hz leaves -3 dB, comes back and leaves again: the notch is the bandwidth."""
    notch = control.tf([1.0, 0.1 * np.pi, (4 * np.pi) ** 2], [1.0, 2 * np.pi, (4 * np.pi) ** 2])
    system = notch * second_order(0.7, 8.0)
    first, last = minus_three_db(system, 0.1, 2.0), minus_three_db(system, 5.0, 20.0)
    result = bandwidths(analytic(system, 20.0))
    assert result.gain_hz == pytest.approx(first, abs=1e-3)
    assert first < 2.0 < last


# -- refused records ----------------------------------------------------------------------------


@pytest.mark.parametrize("dof", ["surge", "yaw"])
def test_a_degree_of_freedom_without_demand_is_refused(dof: str) -> None:
    """Six legs in heave make no surge but round-off; the message names both."""
    for command in (
        signals.chirp("heave", AMPLITUDE, duration=25.0),
        signals.multisine("heave", AMPLITUDE, period=5.0, start=0.2),
    ):
        record = record_of(command, response(command, second_order(0.7, 3.0)), 8)
        with pytest.raises(ValueError, match=f"holds no demand in {dof}; it moved heave"):
            frequency_response(record, dof)


def test_a_segment_longer_than_the_record_is_refused() -> None:
    command = signals.chirp("heave", AMPLITUDE, duration=10.0, settle=1.0)
    with pytest.raises(ValueError, match=r"segment: 20\.0 s exceeds the record's"):
        frequency_response(record_of(command, command.pose, 8))


def test_a_period_that_is_no_whole_number_of_samples_is_refused() -> None:
    """One frame in three: 1 s are 682.67 samples."""
    command = signals.multisine("heave", AMPLITUDE, period=1.0, start=1.0)
    with pytest.raises(ValueError, match="record_every: a period is not a whole number"):
        frequency_response(record_of(command, command.pose, 3))


def test_python_control_plots_a_response() -> None:
    """It has the name that python-control's plots need."""
    omega = np.geomspace(0.1, 10.0, 30)
    response = FrequencyResponse(1.0 / (1.0 + 1j * omega), omega, np.ones(30))
    for plot in (control.bode_plot(response), response.plot()):
        assert len(plot.axes.ravel()) == 2


# -- a phase that comes back to -90 deg ------------------------------------------------------------


def with_pair(pole: float, zero: float, damping: float) -> control.TransferFunction:
    """A loop of 3.6 Hz and damping 0.5 with a lightly damped pair of poles and of zeros [Hz]."""
    a, b = 2 * np.pi * pole, 2 * np.pi * zero
    numerator = np.array([1.0, 2 * damping * b, b**2]) * (a / b) ** 2
    pair = control.tf(numerator, [1.0, 2 * damping * a, a**2])
    return second_order(0.5, 3.6) * pair


def at_phase(system: control.TransferFunction, degrees: float) -> NDArray[np.float64]:
    """All frequencies [Hz] at which a rational system has a phase, as roots of a polynomial:
    N(jw) conj(D(jw)) e^(-j phase) is real and positive there."""
    numerator, denominator = (
        part[0][0] * 1j ** np.arange(part[0][0].size)[::-1] for part in (system.num, system.den)
    )
    product = np.polymul(numerator, np.conj(denominator)) * np.exp(-1j * np.radians(degrees))
    roots = np.roots(product.imag)
    real = roots[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)].real
    return np.sort(real[np.polyval(product.real, real) > 0.0]) / (2 * np.pi)


def test_a_phase_that_falls_through_90_deg_twice_has_two_bandwidths() -> None:
    """A pair of 3.0 Hz, damping 0.03: down at 2.93, up at 3.26, down again at 3.52 Hz. 0.01 Hz:
    lines of 0.05 Hz against a phase that turns by 100 deg in 0.2 Hz."""
    system = with_pair(3.0, 3.1, 0.03)
    first, up, last = at_phase(system, -90.0)
    assert up - first > 0.3
    assert last - up > 0.2
    result = bandwidths(analytic(system))
    assert result.phase_hz == pytest.approx(first, abs=0.01)
    assert result.later_phase_hz == pytest.approx(last, abs=0.01)
    assert result.graze_from_hz == pytest.approx(at_phase(system, -80.0)[0], abs=0.01)
    assert result.graze_to_hz == pytest.approx(at_phase(system, -100.0)[-1], abs=0.01)


def test_both_crossings_are_measured_from_a_chirp() -> None:
    """Segments of 20 s smear the pair by 0.1 Hz; 0.05 Hz."""
    system = with_pair(3.0, 3.1, 0.03)
    first, _, last = at_phase(system, -90.0)
    command = signals.chirp("heave", AMPLITUDE)
    result = bandwidths(frequency_response(record_of(command, response(command, system), 8)))
    assert result.phase_hz == pytest.approx(first, abs=0.05)
    assert result.later_phase_hz == pytest.approx(last, abs=0.05)


@pytest.mark.parametrize(
    ("pole", "zero", "damping"),
    [(3.0, 3.1, 0.05), (3.3, 3.4, 0.04), (2.7, 2.75, 0.04)],
    ids=["back to -91 deg", "back to -99 deg", "below -83 deg before it crosses"],
)
def test_a_phase_that_comes_near_without_crossing_grazes(
    pole: float, zero: float, damping: float
) -> None:
    system = with_pair(pole, zero, damping)
    (only,) = at_phase(system, -90.0)
    result = bandwidths(analytic(system))
    assert result.phase_hz == pytest.approx(only, abs=0.01)
    assert np.isnan(result.later_phase_hz)
    assert result.graze_from_hz == pytest.approx(at_phase(system, -80.0)[0], abs=0.01)
    assert result.graze_to_hz == pytest.approx(at_phase(system, -100.0)[-1], abs=0.01)


def test_a_phase_that_lingers_grazes() -> None:
    """A pair damped by 0.1: the phase crosses each level but once, and takes seven times as far
    from -80 to -100 deg as from -70 to -80 deg."""
    pair = with_pair(2.9, 3.05, 0.1)
    ends = [at_phase(pair, degrees) for degrees in (-70.0, -80.0, -90.0, -100.0)]
    assert [end.size for end in ends] == [1] * 4
    before, first, through, last = np.ravel(ends)
    result = bandwidths(analytic(pair))
    assert np.log(last / first) > _LINGER * np.log(first / before)
    np.testing.assert_allclose(
        [result.phase_hz, *result[-2:]], [through, first, last], rtol=0, atol=0.01
    )


@pytest.mark.parametrize("zeta", [0.05, 0.3, 0.7, 1.0, 3.0])
def test_no_second_order_system_grazes(zeta: float) -> None:
    """-90 +- x deg at w / w0 = sqrt(1 + z^2 t^2) -+ z t, t = tan x: 1.9 to 2.3 times as far."""
    turn = zeta * np.tan(np.radians([20.0, 10.0, -10.0]))
    before, first, last = np.log(np.hypot(1.0, turn) - turn)
    assert 1.8 < (last - first) / (first - before) < 2.4
    result = bandwidths(analytic(second_order(zeta, 3.0), 40.0))
    assert np.isnan(result[-3:]).all()


@pytest.mark.parametrize(("ripple", "again"), [(0.9, False), (4.0, True)])
def test_noise_of_less_than_2_deg_is_no_crossing(ripple: float, again: bool) -> None:
    """A phase of -90 - 5 (f - 3) deg with a ripple of period 0.2 Hz falls through -90 deg often."""
    hertz = np.arange(0.05, 6.0, 0.01)
    phase = -90.0 - 5.0 * (hertz - 3.0) + ripple * np.sin(10.0 * np.pi * hertz)
    result = line_bandwidths(hertz, np.exp(1j * np.radians(phase)))
    assert np.isnan(result.later_phase_hz) != again
