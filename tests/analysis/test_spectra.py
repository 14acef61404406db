"""Estimators of frequency responses on known linear systems, with and without output noise.

The oracle is python-control: outputs come from its sampled systems, responses from the same
systems evaluated on the unit circle, so that no discretisation lies between the two.
"""

from collections.abc import Callable
from functools import cache

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal, stats

from cmf_mj.analysis import spectra
from cmf_mj.analysis.periodic import (
    matrix_response,
    periodic_response,
    sine_response,
    stitch,
)
from cmf_mj.analysis.spectra import Estimate, mean_of_h1_and_h2, report_response, welch_response

RATE = 64.0
SEEDS = 100
ROUNDS = (
    (0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2),
    (1.4, 1.6, 1.8, 2.0, 2.4, 2.6, 3.0),
    (3.4, 3.6, 4.0, 4.4, 4.6, 5.0, 5.4),
    (5.6, 6.0, 6.4, 6.6, 7.0, 7.4, 7.6),
    (8.0, 8.4, 8.6, 9.0, 9.4, 9.6, 10.0),
)
"""Table 2-3 of the report [Hz]."""


@cache
def plant(hertz: float = 3.0, zeta: float = 0.7, gain: float = 1.0) -> control.TransferFunction:
    """A second-order system sampled at 64 Hz, inputs joined by lines."""
    omega = 2 * np.pi * hertz
    system = control.tf([gain * omega**2], [1.0, 2 * zeta * omega, omega**2])
    return control.sample_system(system, 1 / RATE, method="foh")


def through(system: control.TransferFunction, x: NDArray[np.float64]) -> NDArray[np.float64]:
    return signal.lfilter(system.num[0][0], system.den[0][0], x)


def exact(system: control.TransferFunction, hertz: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.ravel(system(np.exp(2j * np.pi * hertz / RATE)))


def error(estimate: Estimate, system: control.TransferFunction) -> NDArray[np.complex128]:
    return estimate.response - exact(system, estimate.frequency)


def white(seconds: float, seed: int, sigma: float = 1.0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(0.0, sigma, round(seconds * RATE))


def sweep(seconds: float = 100.0) -> NDArray[np.float64]:
    """0.01 to 10 Hz, at rest for 2 s before and after."""
    time = np.arange(round(seconds * RATE)) / RATE
    return np.pad(signal.chirp(time, 0.01, seconds, 10.0, phi=-90.0), round(2 * RATE))


def multisine(
    orders: NDArray[np.int64], seed: int, period: float = 10.0, periods: int = 3
) -> NDArray[np.float64]:
    """Equal lines of amplitude 1 and random phases, whole periods."""
    size = round(period * RATE)
    spectrum = np.zeros(size // 2 + 1, dtype=complex)
    turn = np.random.default_rng(seed).uniform(0, 2 * np.pi, orders.size)
    spectrum[orders] = 0.5 * size * np.exp(1j * turn)
    return np.tile(np.fft.irfft(spectrum, size), periods)


def sines(frequencies: tuple[float, ...], seconds: float) -> NDArray[np.float64]:
    """Unit sines, phases spread so that the sum stays low."""
    time = np.arange(round(seconds * RATE)) / RATE
    phases = np.pi * np.arange(len(frequencies)) ** 2 / len(frequencies)
    waves = np.sin(2 * np.pi * np.outer(time, frequencies) + phases)
    return waves.sum(axis=1)


def settled(
    x: NDArray[np.float64], y: NDArray[np.float64], frequency: object, time: float
) -> Estimate:
    """The response at sines from a time [s] on."""
    begin = round(time * RATE)
    return sine_response(x[begin:], y[begin:], RATE, frequency)  # type: ignore[arg-type]


ODD = np.arange(1, 101, 2)


# -- the analytic response ----------------------------------------------------------------------


def test_welch_finds_the_analytic_response() -> None:
    """A sweep without noise: 0.5 % of gain 1, leakage of segments of 20 s; so does both's mean."""
    x = sweep()
    h1 = welch_response(x, through(plant(), x), RATE, band=(0.3, 8.0), pad=True)
    for estimate in (h1, mean_of_h1_and_h2(h1)):
        np.testing.assert_allclose(np.abs(error(estimate, plant())), 0.0, rtol=0, atol=5e-3)
        assert estimate.coherence.min() > 0.999


def test_report_estimator_finds_the_analytic_response() -> None:
    """A sweep without noise, 0.5 to 8 Hz: 3 %, as the ends of segments of 26 s cut the sweep."""
    x = sweep()
    estimate = report_response(x, through(plant(), x), RATE, band=(0.5, 8.0))
    np.testing.assert_allclose(np.abs(error(estimate, plant())), 0.0, rtol=0, atol=0.03)


def test_periods_give_the_response_exactly() -> None:
    """Whole periods in steady state do not leak: 1e-9, what is left of the transient."""
    x = multisine(ODD, 1)
    estimate = periodic_response(x, through(plant(), x), RATE, 10.0, ODD)
    np.testing.assert_allclose(estimate.frequency, ODD / 10.0, rtol=1e-12)
    np.testing.assert_allclose(np.abs(error(estimate, plant())), 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(estimate.coherence, 1.0, rtol=0, atol=1e-9)
    assert estimate.radius.max() < 1e-9


@pytest.mark.parametrize("kind", ["welch", "report", "periodic", "sine"])
def test_noise_on_the_output_averages_out(kind: str) -> None:
    """Root-mean-square error over 20 seeds within 20 % of radius / sqrt(F), the stated deviation;
    the report's estimator divided by its bias, (1 + 1/c) / 2."""
    squares, stated = [], []
    for seed in range(20):
        estimate = noisy(kind, seed)
        factor = 0.5 * (1.0 + 1.0 / estimate.coherence) if kind == "report" else 1.0
        inner = (estimate.frequency >= 0.5) & (estimate.frequency <= 9.0)
        n = estimate.averages - 1.0
        fisher = n * np.expm1(-np.log(0.05) / n)
        off = estimate.response / factor - exact(plant(), estimate.frequency)
        squares.append(np.mean(np.abs(off[inner]) ** 2))
        stated.append(np.mean(((estimate.radius / factor) ** 2 / fisher)[inner]))
    assert np.sqrt(np.mean(squares) / np.mean(stated)) == pytest.approx(1.0, abs=0.2)


def noisy(kind: str, seed: int, sigma: float = 0.5) -> Estimate:
    """One noisy measurement of `plant`."""
    if kind in ("welch", "report", "sweep"):
        x = sweep() if kind == "sweep" else white(80.0, 1000 + seed)
        y = through(plant(), x) + white(x.size / RATE, seed, sigma)
        if kind == "report":
            return report_response(x, y, RATE)
        if kind == "sweep":
            return welch_response(x, y, RATE, band=(0.3, 9.0), pad=True)
        return welch_response(x, y, RATE, segment=4.0, band=(0.5, 20.0))
    x = multisine(ODD, seed, periods=5) if kind == "periodic" else sines(ROUNDS[1], 40.0)
    y = through(plant(), x) + white(x.size / RATE, seed, sigma)
    if kind == "periodic":
        return periodic_response(x, y, RATE, 10.0, ODD)
    return settled(x, y, ROUNDS[1], 5.0)


# -- bounds -------------------------------------------------------------------------------------


def cover(measure: Callable[[int], Estimate], every: int = 1) -> tuple[float, int]:
    """Share of lines whose 95 % circle holds the analytic response over 100 seeds, of how many."""
    found = [measure(seed) for seed in range(SEEDS)]
    inside = [(np.abs(error(one, plant())) < one.radius)[::every] for one in found]
    return float(np.mean(inside)), np.size(inside)


def binomial(count: int) -> float:
    """Three deviations of a share of 0.95 of `count` independent trials."""
    return 3.0 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize("overlap", [0.0, 0.5, 0.75])
def test_h1_lies_within_its_bounds_on_95_percent_of_lines(overlap: float) -> None:
    """White input, white noise, 100 seeds, every third line (a Hann window makes neighbours
    alike); 0.95 within three binomial deviations, 0.013 of 2600 lines. Segments of 4 s are 40
    times the system's memory."""

    def measure(seed: int) -> Estimate:
        x = white(64.0, 5000 + seed)
        y = through(plant(), x) + white(64.0, seed, 0.7)
        return welch_response(x, y, RATE, segment=4.0, overlap=overlap, band=(0.5, 20.0))

    share, count = cover(measure, 3)
    assert share == pytest.approx(0.95, abs=binomial(count))


@pytest.mark.parametrize(("kind", "every"), [("sweep", 3), ("periodic", 1), ("sine", 1)])
def test_other_bounds_hold_on_95_percent_of_lines(kind: str, every: int) -> None:
    """As above for a sweep, which lights a line in few segments only, periods and sines."""
    share, count = cover(lambda seed: noisy(kind, seed), every)
    assert share == pytest.approx(0.95, abs=binomial(count))


def test_without_overlap_the_bound_is_bendat_and_piersols() -> None:
    """r^2 = F(2, 2 S - 2) / (S - 1) (1 - c) S_yy / S_xx with S = 16 and scipy's F."""
    x = white(64.0, 1)
    y = through(plant(), x) + white(64.0, 2)
    estimate = welch_response(x, y, RATE, segment=4.0, overlap=0.0)
    np.testing.assert_allclose(estimate.averages, 16.0, rtol=1e-12)
    h1 = np.abs(estimate.response) ** 2
    ratio = (1 - estimate.coherence) * h1 / estimate.coherence
    expected = np.sqrt(stats.f.ppf(0.95, 2, 30) / 15 * ratio)
    np.testing.assert_allclose(estimate.radius, expected, rtol=1e-9)


@pytest.mark.parametrize(("overlap", "worth"), [(0.0, 1.0), (0.5, 0.947), (0.75, 0.520)])
def test_overlapping_segments_count_less(overlap: float, worth: float) -> None:
    """Hann windows: 1 / (1 + 2 sum rho^2), rho = 0.167 at 50 %, 0.659 and 0.0075 more at 75 %
    (Harris 1978, Table 1). 0.002 for the ends of 1000 segments."""
    window = signal.get_window("hann", 256)
    hop, segments = round(256 * (1 - overlap)), 1000
    measured = np.ones(256 + (segments - 1) * hop, dtype=bool)
    correlation = spectra.segment_correlation(window, hop, measured)
    estimate = np.trace(correlation) ** 2 / np.sum(correlation**2) / segments
    assert estimate == pytest.approx(worth, abs=2e-3)


def test_one_average_states_no_bound() -> None:
    """One period measured: nothing is known about its scatter."""
    x = multisine(ODD, 1, periods=2)
    estimate = periodic_response(x, through(plant(), x), RATE, 10.0, ODD)
    assert np.isinf(estimate.radius).all()


# -- the estimators against each other ----------------------------------------------------------


def test_estimators_differ_by_the_coherence() -> None:
    """report / H1 = (1 + 1/c) / 2; phases are the same."""
    x = white(64.0, 3)
    y = through(plant(), x) + white(64.0, 4)
    h1 = welch_response(x, y, RATE, segment=4.0)
    report, c = mean_of_h1_and_h2(h1), h1.coherence
    np.testing.assert_allclose(report.response / h1.response, 0.5 * (1 + 1 / c), rtol=1e-12)
    np.testing.assert_allclose(report.radius / h1.radius, 0.5 * (1 + 1 / c), rtol=1e-12)


def test_welch_agrees_with_scipy() -> None:
    """csd / welch and coherence of scipy.signal with the same segments: 1e-12."""
    x = white(64.0, 3)
    y = through(plant(), x) + white(64.0, 4)
    options = {"fs": RATE, "window": "hann", "nperseg": 250, "noverlap": 187, "detrend": False}
    expected = signal.csd(x, y, **options)[1] / signal.welch(x, **options)[1]
    coherence = signal.coherence(x, y, **options)[1]
    estimate = welch_response(x, y, RATE, segment=250 / RATE)
    np.testing.assert_allclose(estimate.response, expected[2:], rtol=1e-12)
    np.testing.assert_allclose(estimate.coherence, coherence[2:], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("size", "segments"), [(4096, 7), (4097, 7), (4098, 8)])
def test_report_segments_use_the_record_up(size: int, segments: int) -> None:
    """FRFunction goes on until a segment reaches the last sample: of 4098 samples the seven
    segments of 1025 reach 4097, and an eighth is filled up with zeros. Lines are 1/N apart. 1e-8:
    the same sums in another order, divided by small numbers where the coherence is low."""
    x = white(size / RATE, 1)
    assert x.size == size
    estimate = report_response(x, x + white(size / RATE, 2), RATE)
    np.testing.assert_allclose(estimate.frequency, np.arange(1, size // 2 + 1) * RATE / size)
    length = int((size - 1) / 4)
    hop = length - length // 2
    taper = signal.get_window("hann", length + 1, fftbins=False)
    both = np.pad(signal.detrend(np.stack([x, x + white(size / RATE, 2)])), ((0, 0), (0, 2000)))
    cut = [both[:, k * hop : k * hop + length + 1] * taper for k in range(segments)]
    a, b = np.swapaxes(np.fft.rfft(cut, size), 0, 1)
    cross = np.mean(np.conj(a) * b, axis=0)
    h1 = cross / np.mean(np.abs(a) ** 2, axis=0)
    h2 = np.mean(np.abs(b) ** 2, axis=0) / np.conj(cross)
    np.testing.assert_allclose(estimate.response, 0.5 * (h1 + h2)[1:], rtol=1e-8)


# -- sines and rounds ---------------------------------------------------------------------------


def test_harmonics_do_not_reach_a_sine_response() -> None:
    """Third and second harmonic of 30 % in input and output, offset 5: the fundamental's 0.8 at
    -40 deg comes back within 1e-9 from 4.4 cycles cut to four."""
    time = np.arange(256) / RATE
    angle = 2 * np.pi * 1.1 * time
    third = 0.3 * np.sin(3 * angle + 1.0) + 0.3 * np.cos(2 * angle)
    y = 0.8 * np.sin(angle - np.radians(40)) + third + 5.0
    estimate = sine_response(np.sin(angle) + third, y, RATE, 1.1)
    assert estimate.response[0] == pytest.approx(0.8 * np.exp(-1j * np.radians(40)), abs=1e-9)


def test_five_rounds_stitched_are_the_analytic_response() -> None:
    """Table 2-3: seven sines at a time, 40 s each, 35 lines in order; 1e-9 after 20 s settling."""
    rounds = []
    for frequencies in ROUNDS[::-1]:
        x = sines(frequencies, 40.0)
        rounds.append(settled(x, through(plant(), x), frequencies, 20.0))
    estimate = stitch(rounds)
    assert estimate.frequency.size == 35
    np.testing.assert_allclose(estimate.frequency, np.ravel(ROUNDS), rtol=1e-12)
    np.testing.assert_allclose(np.abs(error(estimate, plant())), 0.0, rtol=0, atol=1e-9)


def test_the_better_of_two_rounds_stays() -> None:
    """1 Hz was measured twice: the line of higher coherence is kept, whatever the order."""

    def lines(frequency: list[float], value: float, coherence: float) -> Estimate:
        one = np.ones(len(frequency))
        return Estimate(np.array(frequency), value * (1 + 0j) * one, coherence * one, one, one)

    good, bad = lines([1.0, 2.0], 1.0, 0.99), lines([0.5, 1.0], 3.0, 0.5)
    for order in ((good, bad), (bad, good)):
        estimate = stitch(order)
        np.testing.assert_array_equal(estimate.frequency, [0.5, 1.0, 2.0])
        np.testing.assert_array_equal(estimate.response, [3.0, 1.0, 1.0])


# -- the matrix ---------------------------------------------------------------------------------


def test_interleaved_lines_of_one_run_give_the_matrix() -> None:
    """Column i at every sixth line, 1e-9; straight lines between lines 0.6 Hz apart: within
    0.6^2 / 8 max |H''|, by differences of the analytic response. Static coupling of six channels,
    each behind its own second-order system."""
    coupling = np.eye(6) + 0.2 * np.random.default_rng(3).normal(size=(6, 6))
    dynamics = [plant(2.0 + 0.5 * i, 0.5 + 0.05 * i) for i in range(6)]
    x = np.column_stack([multisine(np.arange(i + 1, 97, 6), i) for i in range(6)])
    y = np.column_stack([through(g, x[:, i]) for i, g in enumerate(dynamics)]) @ coupling.T
    frequency, response = matrix_response(x, y, RATE, 10.0)
    assert response.shape == (96, 6, 6)
    expected = coupling * np.stack([exact(g, frequency) for g in dynamics], axis=1)[:, None, :]
    for i in range(6):
        own = np.arange(96) % 6 == i
        np.testing.assert_allclose(response[own, :, i], expected[own, :, i], rtol=0, atol=1e-9)
    second = np.abs(np.diff(expected, 2, axis=0)).max() / 0.1**2
    inner = slice(5, 91)
    off = np.abs(response - expected)[inner]
    assert np.nanmax(off) < 0.6**2 / 8 * second * 1.05
    assert not np.isnan(off).any()


# -- refused ------------------------------------------------------------------------------------

FLAT = np.zeros(640)
WAVE = sines((1.0,), 10.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: welch_response(FLAT, FLAT[1:], RATE), r"y: shape is \(639,\); allowed: \(640,\)"),
        (lambda: welch_response(WAVE, WAVE, RATE), "segment: 20.0 s exceeds"),
        (
            lambda: welch_response(WAVE, WAVE, RATE, segment=0.01),
            "segment: 0.01 s is less than 4 samples, 0.0625 s",
        ),
        (
            lambda: welch_response(np.full(640, np.nan), WAVE, RATE, segment=2.0),
            r"x\[0\]: nan is not a finite number",
        ),
        (
            lambda: report_response(WAVE, np.full(640, np.nan), RATE),
            r"y\[0\]: nan is not a finite number",
        ),
        (lambda: welch_response(FLAT, FLAT, RATE, segment=2.0), "x: is zero at"),
        (lambda: report_response(WAVE[:9], WAVE[:9], RATE), "segments: 9 samples are too few"),
        (lambda: periodic_response(WAVE, WAVE, RATE, 0.99, ODD), "not a whole number"),
        (
            lambda: periodic_response(WAVE, WAVE, RATE, 10.0, ODD),
            "period: the record has 1 of 10.0 s",
        ),
        (lambda: periodic_response(FLAT, WAVE, RATE, 1.0, ODD[:9]), "lines: 1 holds no input"),
        (lambda: sine_response(WAVE, WAVE, RATE, 32.0), "below 32.0 Hz"),
        (lambda: sine_response(WAVE, WAVE, RATE, 0.05), "no whole cycle of 0.05 Hz"),
        (lambda: sine_response(WAVE, WAVE, RATE, [1.0, 1.01]), "are closer than"),
        (lambda: sine_response(FLAT, WAVE, RATE, 1.0), "x: holds no sine at 1.0 Hz"),
    ],
)
def test_bad_input_is_named(call: Callable[[], Estimate], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
