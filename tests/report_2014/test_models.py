"""The report's transfer functions: misprints, what holds between them, section 3.4."""

from collections.abc import Callable

import control
import numpy as np
import pytest

from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.core import units
from cmf_mj.report_2014.models import (
    hardware_velocity,
    report_entry,
    report_model,
    report_models,
)

NUMBERS = [entry.number for entry in report_models()]
AREAS = (np.pi / 4.0 * 5.5**2, np.pi / 4.0 * (5.5**2 - 3.875**2))
MASS = 7200.0 / 386.0886


def test_the_list_has_every_transfer_function_of_sections_3_4_and_4() -> None:
    assert NUMBERS == [f"3.{i}" for i in range(1, 7)] + [
        f"4.{i}" for i in (*range(1, 8), *range(11, 20))
    ]
    misprinted = {entry.number for entry in report_models() if "corrected" in entry.variants}
    assert misprinted == {"3.2", "3.5", "4.7", "4.17"}


@pytest.mark.parametrize("number", NUMBERS[4:])
def test_every_model_has_labels_and_units_and_converts(number: str) -> None:
    entry = report_entry(number)
    system = report_model(number)
    assert isinstance(system, control.TransferFunction)
    assert system.input_labels == [entry.input]
    assert system.output_labels == [entry.output]
    assert (system.input_unit, system.output_unit) == (entry.input_unit, entry.output_unit)
    point = 0.9 + 0.3j
    size = units.factor(entry.output_unit) / units.factor(entry.input_unit)
    si = system.to_si()
    assert si(point) == pytest.approx(size * system(point), rel=1e-12)
    assert (si.input_labels, si.output_labels, si.dt) == (
        system.input_labels,
        system.output_labels,
        system.dt,
    )


def test_si_size_of_a_velocity_model() -> None:
    """0.29976 in/s per % is 0.7614 m/s at full command."""
    assert hardware_velocity(1).to_si().dcgain() == pytest.approx(2.482e11 / 8.28e11 * 2.54)


def test_original_model_has_the_lags_and_the_leg_mode() -> None:
    """Poles of Eq 4.1: lags of 3 and 75 Hz, the pair -0.807 +- 70.999j."""
    poles = report_model("4.1").poles()
    for expected in (-18.85, -471.24, -0.807 + 70.999j, -0.807 - 70.999j):
        assert np.abs(poles - expected).min() < 5e-3
    pair = poles[np.argmax(poles.imag)]
    assert abs(pair) == pytest.approx(71.0035, abs=1e-4)
    assert -pair.real / abs(pair) == pytest.approx(0.0114, abs=5e-5)


def test_original_model_obeys_newtons_law_in_inches_psi_and_pounds() -> None:
    """m s^2 x = A_cap p_cap - A_rod p_rod with 7200 lbm about the leg mode: fixes the units."""
    x, cap, rod = (report_model(number) for number in ("4.1", "4.2", "4.3"))
    s = 1j * np.geomspace(10.0, 1000.0, 20)
    force = AREAS[0] * cap(s) - AREAS[1] * rod(s)
    np.testing.assert_allclose(force / (MASS * s**2 * x(s)), 1.0, atol=5e-3)


def test_original_model_has_viscous_friction() -> None:
    """What Newton's law leaves is b s x, b = 0.44 lbf s/in: 1.5 % of the leg mode's damping."""
    x, cap, rod = (report_model(number).num_array[0, 0] for number in ("4.1", "4.2", "4.3"))
    friction = AREAS[0] * cap[1] - AREAS[1] * rod[1] - MASS * x[1]
    assert friction / x[0] == pytest.approx(0.44, abs=0.01)
    assert friction / x[0] / MASS / (2.0 * 0.807) == pytest.approx(1.0 / 68.0, rel=0.05)


def test_original_model_has_the_stiffness_of_the_machine() -> None:
    """Modulus of the pair from bore, rod, 38 in and 100 000 psi, over 7200 lbm."""
    stiffness = 1e5 * sum(AREAS) / 38.0
    poles = report_model("4.1").poles()
    assert abs(poles[np.argmax(poles.imag)]) == pytest.approx(np.sqrt(stiffness / MASS), rel=2e-4)


@pytest.mark.parametrize(
    ("position", "velocity", "highest", "within"),
    [("4.11", "4.12", 4.0, 0.06), ("4.14", "4.15", 2.0, 0.07), ("4.17", "4.18", 4.0, 0.08)],
)
def test_fitted_position_is_in_inches(
    position: str, velocity: str, highest: float, within: float
) -> None:
    s = 2j * np.pi * np.linspace(0.5, highest, 30)
    ratio = np.abs(s * report_model(position)(s) / report_model(velocity)(s))
    np.testing.assert_allclose(ratio, 1.0, atol=within)


@pytest.mark.parametrize(
    ("acceleration", "velocity", "lowest", "within"),
    [("4.13", "4.12", 1.0, 0.25), ("4.16", "4.15", 0.5, 0.11)],
)
def test_fitted_acceleration_is_in_g(
    acceleration: str, velocity: str, lowest: float, within: float
) -> None:
    s = 2j * np.pi * np.linspace(lowest, 8.0, 40)
    ratio = np.abs(report_model(acceleration).to_si()(s) / (s * report_model(velocity).to_si()(s)))
    np.testing.assert_allclose(ratio, 1.0, atol=within)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (lambda: report_model("4.8"), "number: '4.8' is not one of 3.1, "),
        (lambda: report_model("4.7", "guessed"), "variant: 'guessed' is not one of printed, "),  # type: ignore[arg-type]
        (lambda: report_model("3.4"), "number: Eq 3.4 has no coefficients: w"),
        (lambda: hardware_velocity(4), "number: 4 is not one of 1, 2, 3"),
        (
            lambda: UnitTransferFunction([1.0], [1.0], input_unit="%", output_unit="furlong"),
            "unit: 'furlong' is not known",
        ),
    ],
)
def test_bad_requests_are_named(request_: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        request_()
