"""Models identified from records of the plants, against the plants' own measured loops."""

from collections.abc import Mapping
from dataclasses import replace

import control
import numpy as np
import pytest

from cmf_mj import (
    Hexapod,
    Record,
    SingleLegs,
    bandwidths,
    frequency_response,
    signals,
    simulate,
    step_metrics,
)
from cmf_mj.analysis.frequency_response import (
    FrequencyResponse,
    line_bandwidths,
    matrix_frequency_response,
)
from cmf_mj.analysis.identification.continuous import (
    fit_response,
    in_field_units,
    loop_errors,
    to_continuous,
)
from cmf_mj.analysis.identification.data import experiment, plant_response
from cmf_mj.analysis.identification.estimation import arx, output_error
from cmf_mj.analysis.identification.model import simulation_fit
from cmf_mj.analysis.linear.loop import closed_loop, closed_loop_response
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.models import hardware_velocity
from cmf_mj.signals.composite import orthogonal_multisines
from cmf_mj.signals.signal import Command

LAW = "velocity"
INCHES = 0.33 * 0.0254
SIZES = [INCHES] * 3 + [np.radians(0.2)] * 3


def run(plant: SingleLegs | Hexapod, command: Command) -> Record:
    return simulate(plant, LAW, command, record_every=16)


def broad(dof: str = "heave", seed: int = 0) -> Command:
    """To 16 Hz, beyond the oil modes."""
    size = SIZES[DOFS.index(dof)]
    return signals.multisine(
        dof, size, start=0.1, stop=16.0, spectrum="acceleration", fade=1.0, seed=seed
    )


@pytest.fixture(scope="module")
def legs() -> SingleLegs:
    return SingleLegs()


@pytest.fixture(scope="module")
def measured(legs: SingleLegs) -> FrequencyResponse:
    return frequency_response(run(legs, signals.chirp("heave", INCHES)))


@pytest.fixture(scope="module")
def records(legs: SingleLegs) -> Mapping[str, Record]:
    return {
        "multisine": run(legs, broad()),
        "chirp": run(legs, signals.chirp("heave", INCHES, duration=60.0)),
        "noise": run(legs, signals.noise("heave", INCHES, duration=40.0)),
        "pulse": run(legs, signals.pulse("heave", 0.0254)),
    }


@pytest.mark.parametrize("method", [arx, output_error])
@pytest.mark.parametrize("kind", ["multisine", "chirp", "noise", "pulse"])
def test_closed_loop_of_the_identified_single_leg_has_its_bandwidth(
    records: Mapping[str, Record], measured: FrequencyResponse, kind: str, method
) -> None:
    """-90 deg within 3 % (the report's best: 6.5 %), -3 dB within 3 %, by the report's path."""
    model = method(experiment(records[kind], "leg_1"), (4, 3, 1))
    assert model.unstable_poles == ()
    result = loop_errors(in_field_units(to_continuous(model).rational), LAW, measured)
    assert abs(result.phase_error) < 0.03
    assert abs(result.gain_error) < 0.03


def test_one_sine_does_not_tell_the_orders_that_a_broad_signal_does(
    legs: SingleLegs, records: Mapping[str, Record]
) -> None:
    """A model of a 1 Hz sine fits it better than anything and the noise run worst."""
    sine = experiment(run(legs, signals.sine("heave", 0.0254, 1.0)), "heave")
    other = experiment(records["noise"], "heave")
    model = arx(sine, (6, 6, 1))
    assert simulation_fit(model, sine)[0] > 97.0
    assert simulation_fit(model, other)[0] < 80.0
    assert simulation_fit(arx(experiment(records["multisine"], "heave"), (6, 6, 1)), other)[0] > 94


def test_step_of_the_identified_loop_is_that_of_the_plant(
    legs: SingleLegs, records: Mapping[str, Record], measured: FrequencyResponse
) -> None:
    """Damping ratio within 0.03 of the measured 1 in step's, as Table 4-1 compares them."""
    step = step_metrics(simulate(legs, LAW, signals.step("heave", 0.0254)))
    model = arx(experiment(records["multisine"], "heave"), (4, 3, 1))
    result = loop_errors(in_field_units(to_continuous(model).rational), LAW, measured, step)
    assert result.measured.damping_ratio == step.damping_ratio
    assert result.model.damping_ratio == pytest.approx(step.damping_ratio, abs=0.03)
    assert result.model.rise_time == pytest.approx(step.rise_time, rel=0.1)


@pytest.mark.parametrize("kind", ["multisine", "noise"])
def test_velocity_integrated_closes_better_than_a_position_model(
    records: Mapping[str, Record], measured: FrequencyResponse, kind: str
) -> None:
    """Chapter 4's choice. The position drifts; output error spends its poles on the drift, the
    largest is within 0.5 % of the circle, and the loop's -3 dB is more than 3 % off.
    """
    both = experiment(records[kind], "heave", outputs=["leg_velocity", "leg_position"])
    model = output_error(both, (4, 3, 1))
    assert np.abs([root.value for root in model.poles(1)]).max() > 0.995
    frequency = np.arange(0.1, 8.0, 0.02)
    response = model.response(frequency)[:, :, 0]
    velocities = (response[:, 0], 2j * np.pi * frequency * response[:, 1])
    true = bandwidths(measured).gain_hz
    integrated, direct = (
        line_bandwidths(frequency, closed_loop_response(LAW, v, frequency)[:, 0, 0]).gain_hz / true
        - 1.0
        for v in velocities
    )
    assert abs(integrated) < 0.01
    assert abs(direct) > 0.03


def test_pole_pair_and_lag_of_the_leg_come_out(records: Mapping[str, Record]) -> None:
    """3 Hz drive lag within 3 %, oil mode 71.0 rad/s within 1 %, from the measured response."""
    response = plant_response(records["multisine"], "leg_1")
    fit = fit_response(response.frequency, response.response, 3, 1)
    poles = fit.rational.poles()
    lag = poles[poles.imag == 0.0].real
    assert lag[0] == pytest.approx(-2.0 * np.pi * 3.0, rel=0.03)
    assert np.abs(poles).max() == pytest.approx(71.0, rel=0.01)


def test_plant_response_by_the_reference_is_that_of_the_fitted_model(
    records: Mapping[str, Record],
) -> None:
    """Two ways from the same leg, 0.5 to 10 Hz: lines and a model of the series, 5 % rms."""
    for kind in ("multisine", "chirp"):
        response = plant_response(records[kind], "heave")
        model = output_error(experiment(records[kind], "heave"), (4, 3, 1))
        inside = (response.frequency > 0.5) & (response.frequency < 10.0)
        lines = model.response(response.frequency[inside])[:, 0, 0]
        off = np.abs(lines / response.response[inside] - 1.0)
        assert np.sqrt(np.mean(off**2)) < 0.05
        assert response.input_labels == ["heave_command"]


def test_line_by_line_loop_is_that_of_the_state_space() -> None:
    """The report's model 1 closed both ways: held plant against its response, to 5 Hz 1e-3."""
    frequency = np.linspace(0.2, 5.0, 60)
    model = hardware_velocity(1)
    whole = control.frequency_response(closed_loop(LAW, model), 2.0 * np.pi * frequency)
    velocity = control.frequency_response(model, 2.0 * np.pi * frequency).frdata[0, 0]
    lines = closed_loop_response(LAW, velocity * 0.0254 / 0.01, frequency)
    np.testing.assert_allclose(lines[:, 0, 0], whole.frdata[0, 0], rtol=1e-3)


def test_bad_loops_are_refused() -> None:
    with pytest.raises(ValueError, match="frequency: must be greater than 0"):
        closed_loop_response(LAW, [1.0], [0.0])
    with pytest.raises(ValueError, match=r"velocity: shape is \(2, 2, 3\)"):
        closed_loop_response(LAW, np.ones((2, 2, 3)), [1.0, 2.0])


CHANNELS = ("leg_velocity", "cap_pressure", "rod_pressure")


@pytest.fixture(scope="module")
def hexapod() -> tuple[Record, Record]:
    plant = Hexapod("gfd")
    commands = [
        orthogonal_multisines(
            SIZES, start=0.1, stop=16.0, spectrum="acceleration", periods=2, period=40.0, seed=seed
        )
        for seed in (1, 2)
    ]
    first, second = (run(plant, command) for command in commands)
    return first, second


@pytest.mark.parametrize("dof", DOFS)
def test_closed_loop_of_the_identified_hexapod_has_its_bandwidth(dof: str) -> None:
    """-90 deg of each degree of freedom within 3 % of the chirp it was identified from."""
    command = signals.chirp(dof, SIZES[DOFS.index(dof)], duration=30.0)
    record = run(Hexapod("gfd"), command)
    model = output_error(experiment(record, dof), (6, 5, 1))
    assert model.unstable_poles == ()
    velocity = in_field_units(to_continuous(model).rational)
    assert abs(loop_errors(velocity, LAW, frequency_response(record)).phase_error) < 0.03


def test_closed_loop_of_the_matrix_model_is_the_measured_matrix(
    hexapod: tuple[Record, Record],
) -> None:
    """-90 deg of all six within 3 % of another run with all six moving; pressures identified.

    With the pressures zero, as in the report, surge and sway come out more than 1.5 % faster.
    """
    model = arx(experiment(hexapod[0], DOFS, outputs=CHANNELS), (6, 5, 1))
    assert model.unstable_poles == ()
    frequency = np.arange(0.1, 6.0, 0.05)
    response = model.response(frequency)
    pressures = (response[:, 6:12], response[:, 12:])
    whole = closed_loop_response(LAW, response[:, :6], frequency, pressures=pressures)
    short = closed_loop_response(LAW, response[:, :6], frequency)
    measured = matrix_frequency_response(hexapod[1])
    known = np.isfinite(measured.frdata).all(axis=(0, 1))
    omega = np.asarray(measured.omega)[known]
    for i, dof in enumerate(DOFS):
        diagonal = control.FrequencyResponseData(measured.frdata[i, i, known], omega)
        result = line_bandwidths(frequency, whole[:, i, i]).phase_hz
        assert result == pytest.approx(bandwidths(diagonal).phase_hz, rel=0.03)
        if dof in ("surge", "sway"):
            assert line_bandwidths(frequency, short[:, i, i]).phase_hz > 1.015 * result


def test_one_model_for_every_degree_of_freedom_fails_off_heave(
    hexapod: tuple[Record, Record],
) -> None:
    """The report's assumption scored on another run: right in heave, not in surge and sway."""
    orders, (first, second) = (6, 5, 1), hexapod
    heave = arx(experiment(first, "heave"), orders)
    matrix = simulation_fit(arx(experiment(first, DOFS), orders), experiment(second, DOFS))
    for dof, whole in zip(DOFS, matrix, strict=True):
        other = experiment(second, dof)
        labels = {name: getattr(other, name) for name in ("input_names", "output_names")}
        shared = simulation_fit(replace(heave, **labels), other)[0]
        single = simulation_fit(arx(experiment(first, dof), orders), other)[0]
        assert whole > 92.0
        assert whole >= single - 0.5
        assert single >= shared
        if dof == "heave":
            assert shared == single > 93.0
        if dof in ("surge", "sway"):
            assert shared < 70.0
            assert single > 85.0
