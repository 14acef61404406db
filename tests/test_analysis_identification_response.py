"""Frequency-domain fits and conversions against rational functions and SciPy."""

import control
import numpy as np
import pytest
from identified_systems import RATE, SIXTH, lag, noisy, pair, series

from cmf_mj.analysis.identification.arx import arx
from cmf_mj.analysis.identification.continuous import in_field_units, to_continuous
from cmf_mj.analysis.identification.refinement import output_error
from cmf_mj.analysis.identification.response_fit import fit_response

FREQUENCY = np.linspace(0.1, 16.0, 160)
LEG = lag(3.0) * pair(11.0, 0.11) * control.tf([1.0 / 1.2, 1.0], [1.0 / 1.1, 1.0])
"""A lag, the oil mode and the leakage's zero and pole."""


def true(system: control.TransferFunction) -> np.ndarray:
    return control.frequency_response(system, 2.0 * np.pi * FREQUENCY).frdata[0, 0]


def by_size(values: np.ndarray) -> np.ndarray:
    return values[np.lexsort((values.imag, np.abs(values).round(6)))]


def test_poles_are_found_without_a_guess() -> None:
    fit = fit_response(FREQUENCY, true(SIXTH), 6, 0)
    np.testing.assert_allclose(by_size(fit.poles), by_size(SIXTH.poles()), rtol=1e-6)
    assert fit.reflected == 0


def test_rational_function_with_delay_is_recovered_exactly() -> None:
    late = true(LEG) * np.exp(-2j * np.pi * FREQUENCY * 0.004)
    fit = fit_response(FREQUENCY, late, 4, 1, fit_delay=True)
    assert fit.delay == pytest.approx(0.004, rel=1e-8)
    np.testing.assert_allclose(by_size(fit.poles), by_size(LEG.poles()), rtol=1e-7)
    np.testing.assert_allclose(fit.zeros, [-1.2], rtol=1e-6)
    assert fit.misfit < 1e-9
    np.testing.assert_allclose(fit.response(FREQUENCY), late, rtol=1e-9)
    np.testing.assert_allclose(
        control.frequency_response(fit.rational, 2.0 * np.pi * FREQUENCY).frdata[0, 0],
        true(LEG),
        rtol=1e-9,
    )


def test_weights_let_a_bad_line_pass_by() -> None:
    """A band spoilt by a tenfold gain hardly counts where its deviation says so."""
    spoilt = true(SIXTH).copy()
    spoilt[50:60] *= 10.0
    sigma = np.abs(true(SIXTH)) * 1e-3
    sigma[50:60] = np.abs(spoilt[50:60]) * 1e3
    trusted = fit_response(FREQUENCY, spoilt, 6, 0, deviation=sigma)
    np.testing.assert_allclose(by_size(trusted.poles), by_size(SIXTH.poles()), rtol=1e-3)
    believed = fit_response(FREQUENCY, spoilt, 6, 0)
    assert believed.misfit > 0.05


def test_orders_are_found_by_bic() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, FREQUENCY.size)) * 0.005
    measured = true(lag(3.0) * pair(11.0, 0.11)) * (1.0 + noise[0] + 1j * noise[1])
    orders = [(n, m) for n in range(1, 6) for m in range(3) if m <= n]
    best = min(orders, key=lambda order: fit_response(FREQUENCY, measured, *order).bic)
    assert best == (3, 0)


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
    model = output_error(run, (6, 7, 0), start="arx")
    fit = to_continuous(model, poles=6, zeros=2)
    inside = (FREQUENCY > 0.2) & (FREQUENCY < 10.0)
    expected = true(SIXTH)[inside]
    result = fit.response(FREQUENCY[inside])
    assert np.abs(result - expected).max() < 1e-3 * np.abs(expected).max()


def test_field_units_are_inches_a_second_per_per_cent() -> None:
    """0.0254 m/s at full command is 1 in/s at 100 %."""
    gain = in_field_units(control.tf([0.0254], [1.0, 1.0]))
    assert gain.num[0][0][0] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"poles": 2, "zeros": 3}, "zeros: 3; allowed with 2 poles: 0 to 2"),
        ({"poles": 2, "zeros": 1, "delay": -1.0}, "delay: -1.0 s must be a finite number"),
        ({"poles": 400, "zeros": 1}, "lines are too few"),
        ({"poles": 0, "zeros": 0}, "poles: 0; allowed with 160 lines: 1 to 159"),
        ({"poles": 2, "zeros": 0, "deviation": np.zeros(160)}, "deviation: must be finite"),
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
    with pytest.raises(ValueError, match="band: 1.0 to 40.0 Hz"):
        to_continuous(arx(noisy(SIXTH, 0), (2, 2, 1)), band=(1.0, 40.0))
