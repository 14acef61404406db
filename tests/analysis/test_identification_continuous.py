"""Frequency-domain fits and conversions against rational functions and SciPy."""

from dataclasses import replace

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, lag, noisy, pair, series

from cmf_mj.analysis.identification.continuous import fit_response, in_field_units, to_continuous
from cmf_mj.analysis.identification.estimation import arx, output_error

FREQUENCY = np.linspace(0.1, 16.0, 160)
LEG = lag(3.0) * pair(11.0, 0.11) * control.tf([1.0 / 1.2, 1.0], [1.0 / 1.1, 1.0])
"""A lag, the oil mode and the leakage's zero and pole."""


def true(system: control.TransferFunction) -> np.ndarray:
    return control.frequency_response(system, 2.0 * np.pi * FREQUENCY).frdata[0, 0]


def by_size(values: np.ndarray) -> np.ndarray:
    return values[np.lexsort((values.imag, np.abs(values).round(6)))]


def test_poles_are_found_without_a_guess() -> None:
    fit = fit_response(FREQUENCY, true(SIXTH), 6, 0)
    np.testing.assert_allclose(by_size(fit.rational.poles()), by_size(SIXTH.poles()), rtol=1e-6)


def test_rational_function_is_recovered_exactly() -> None:
    fit = fit_response(FREQUENCY, true(LEG), 4, 1)
    np.testing.assert_allclose(by_size(fit.rational.poles()), by_size(LEG.poles()), rtol=1e-7)
    np.testing.assert_allclose(fit.rational.zeros(), [-1.2], rtol=1e-6)
    assert fit.misfit < 1e-9
    np.testing.assert_allclose(
        control.frequency_response(fit.rational, 2.0 * np.pi * FREQUENCY).frdata[0, 0],
        true(LEG),
        rtol=1e-9,
    )


def test_band_limited_model_becomes_the_continuous_one() -> None:
    """Sampled from the response itself, so that samples know nothing of a hold: 0.1 % in band."""
    samples = 4096
    line = np.fft.rfftfreq(samples, 1.0 / RATE)
    rng = np.random.default_rng(5)
    band = (line > 0.05) & (line < 16.0)
    u = np.zeros(line.size, dtype=complex)
    u[band] = np.exp(2j * np.pi * rng.uniform(size=int(band.sum())))
    y = u * control.frequency_response(SIXTH, 2.0 * np.pi * line).frdata[0, 0]
    run = series(np.fft.irfft(u), np.fft.irfft(y))
    model = output_error(run, (6, 7, 0))
    inside = (FREQUENCY > 0.2) & (FREQUENCY < 10.0)
    expected = true(SIXTH)[inside]
    fitted = to_continuous(model).rational
    result = control.frequency_response(fitted, 2.0 * np.pi * FREQUENCY[inside]).frdata[0, 0]
    assert np.abs(result - expected).max() < 1e-3 * np.abs(expected).max()


def test_field_units_are_inches_a_second_per_per_cent() -> None:
    """0.0254 m/s at full command is 1 in/s at 100 %."""
    gain = in_field_units(control.tf([0.0254], [1.0, 1.0]))
    assert gain.num[0][0][0] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"poles": 2, "zeros": 3}, "zeros: 3; allowed with 2 poles: 0 to 2"),
        ({"poles": 400, "zeros": 1}, "lines are too few"),
        ({"poles": 0, "zeros": 0}, "poles: 0; allowed with 160 lines: 1 to 159"),
    ],
)
def test_bad_fits_are_refused_by_name(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_response(FREQUENCY, true(SIXTH), **arguments)


def test_bad_lines_are_named() -> None:
    with pytest.raises(ValueError, match="frequency: must be finite, above 0 and rising"):
        fit_response([1.0, 1.0], [1.0, 1.0], 1, 0)
    with pytest.raises(ValueError, match="response: is not finite at 2.0 Hz"):
        fit_response([1.0, 2.0], [1.0, np.nan], 1, 0)
    slow = replace(arx(noisy(SIXTH, 0), (2, 2, 1)), step=0.1)
    with pytest.raises(ValueError, match="step: 0.1 s; allowed: below 0.05 s"):
        to_continuous(slow)
