"""Black boxes identified from records of the plants, against the plants' own measured loops."""

from collections.abc import Mapping
from dataclasses import replace

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
from cmf_mj.analysis.frequency_response import Bandwidths
from cmf_mj.analysis.identification import (
    BlackBox,
    arx,
    experiment,
    fit_percentage,
    plant_response,
    simulated,
    to_continuous,
)
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.signals.signal import Command

LAW = "velocity"
INCHES = 0.33 * 0.0254


def run(plant: SingleLegs | Hexapod, command: Command) -> Record:
    return simulate(plant, LAW, command, record_every=16)


def closed(box: BlackBox) -> Measures:
    """A box closed with the law that drove the records."""
    return measure_loop(closed_loop(LAW, to_continuous(box).velocity))


def fit(box: BlackBox, record: Record) -> float:
    series = experiment(record, "heave")
    return fit_percentage(series.output, simulated(box, series))


@pytest.fixture(scope="module")
def legs() -> SingleLegs:
    return SingleLegs()


@pytest.fixture(scope="module")
def measured(legs: SingleLegs) -> Bandwidths:
    return bandwidths(frequency_response(run(legs, signals.chirp("heave", INCHES))))


@pytest.fixture(scope="module")
def records(legs: SingleLegs) -> Mapping[str, Record]:
    return {
        "multisine": run(
            legs,
            signals.multisine("heave", INCHES, stop=16.0, spectrum="acceleration", fade=1.0),
        ),
        "chirp": run(legs, signals.chirp("heave", INCHES, duration=60.0)),
        "noise": run(legs, signals.noise("heave", INCHES, duration=40.0)),
        "pulse": run(legs, signals.pulse("heave", 0.0254)),
        "sine": run(legs, signals.sine("heave", 0.0254, 1.0)),
    }


@pytest.fixture(scope="module")
def pitching() -> Record:
    command = signals.multisine(
        "pitch", np.radians(0.2), start=0.5, stop=15.0, period=4.0, periods=2, fade=1.0
    )
    return simulate(SingleLegs(), LAW, command)


def test_input_is_the_held_command_at_the_valves(pitching: Record) -> None:
    """Against the recorded command held sample by sample and delayed a frame, filtered alike.

    The held command is drawn 16 times a frame; its mean over a frame about each sample is what
    band-limited data see of it.
    """
    command = pitching["valve_command"][:, 0]
    fine = np.repeat(np.concatenate([[command[0]], command[:-1]]), 16)
    about = np.array([fine[max(k - 8, 0) : k + 8].mean() for k in range(0, fine.size, 16)])
    off = experiment(pitching, "leg_1", rate=2048.0).input - about
    assert np.abs(off - off.mean())[16:].max() < 2e-3 * np.ptp(command)


def test_degrees_of_freedom_are_the_legs_behind_the_jacobian(pitching: Record) -> None:
    """Against J^-1 at the pose zero: excursions of 0.2 deg change J by less than a per cent.

    The reference is the pose demand within the anti-alias filters' ripple, 0.2 dB.
    """
    legs = [experiment(pitching, f"leg_{i + 1}") for i in range(6)]
    pitch, row = experiment(pitching, "pitch"), np.linalg.inv(pose_jacobian(np.zeros(6)))[4]
    for kind in ("input", "output"):
        expected = row @ [getattr(leg, kind) for leg in legs]
        np.testing.assert_allclose(getattr(pitch, kind), expected, atol=0.01 * np.ptp(expected))
    demand = pitching["demand_pose"][::32, 4]
    assert pitch.reference is not None
    np.testing.assert_allclose(
        pitch.reference[64:-64],
        (demand - demand.mean())[64:-64],
        atol=0.025 * np.ptp(demand),
    )
    assert pitch.names == ("pitch_command", "pitch_velocity")
    assert pitch.step == pytest.approx(1.0 / 64.0)


@pytest.mark.parametrize("kind", ["multisine", "chirp", "noise", "pulse"])
def test_closed_loop_of_the_identified_single_leg_has_its_bandwidth(
    records: Mapping[str, Record], measured: Bandwidths, kind: str
) -> None:
    """-90 deg within 3 % (the report's best: 6.5 %), -3 dB within 3 %, by the report's path."""
    box = arx([experiment(records[kind], "leg_1")], (4, 3, 1))
    assert box.stable
    found = closed(box)
    assert found.phase_bandwidth_hz == pytest.approx(measured.phase_hz, rel=0.03)
    assert found.gain_bandwidth_hz == pytest.approx(measured.gain_hz, rel=0.03)


def test_one_sine_does_not_tell_the_orders_that_a_broad_signal_does(
    records: Mapping[str, Record],
) -> None:
    """A model of a 1 Hz sine fits it better than anything and the noise run worst."""
    sine, broad = (
        arx([experiment(records[kind], "heave")], (6, 6, 1)) for kind in ("sine", "multisine")
    )
    assert fit(sine, records["sine"]) > 97.0
    assert fit(sine, records["noise"]) < 80.0
    assert fit(broad, records["noise"]) > 94.0


def test_step_of_the_identified_loop_is_that_of_the_plant(
    legs: SingleLegs, records: Mapping[str, Record]
) -> None:
    """Damping ratio within 0.03 of the measured 1 in step's, as Table 4-1 compares them."""
    step = step_metrics(simulate(legs, LAW, signals.step("heave", 0.0254)))
    found = closed(arx([experiment(records["multisine"], "heave")], (4, 3, 1)))
    assert found.damping_ratio == pytest.approx(step.damping_ratio, abs=0.03)
    assert found.rise_time == pytest.approx(step.rise_time, rel=0.1)


@pytest.mark.parametrize("kind", ["multisine", "chirp"])
def test_plant_response_by_the_reference_is_that_of_the_fitted_model(
    records: Mapping[str, Record], kind: str
) -> None:
    """Two ways from the same leg, 0.5 to 10 Hz: lines and a model of the series, 5 % rms.

    Poles of the model: 3 Hz drive lag within 5 %, oil mode 71.0 rad/s within 5 %.
    """
    response = plant_response(records[kind], "heave")
    box = arx([experiment(records[kind], "heave")], (4, 3, 1))
    inside = (response.frequency > 0.5) & (response.frequency < 10.0)
    lines = box.response(response.frequency[inside]).response
    off = np.abs(lines / response.response[inside] - 1.0)
    assert np.sqrt(np.mean(off**2)) < 0.05
    (lag,) = (r for r in box.poles() if r.value.imag == 0.0 and 1.0 < r.hertz < 5.0)
    (mode,) = (r for r in box.poles() if r.value.imag > 0.0 and 5.0 < r.hertz < 20.0)
    assert lag.hertz == pytest.approx(3.0, rel=0.05)
    assert 2.0 * np.pi * mode.hertz == pytest.approx(71.0, rel=0.05)


@pytest.mark.parametrize("dof", DOFS)
def test_closed_loop_of_the_identified_hexapod_has_its_bandwidth(dof: str) -> None:
    """-90 deg of each degree of freedom within 3 % of the chirp it was identified from."""
    size = INCHES if dof in DOFS[:3] else np.radians(0.2)
    record = run(Hexapod("gfd"), signals.chirp(dof, size, duration=30.0))
    box = arx([experiment(record, dof)], (6, 5, 1))
    assert box.stable
    hertz = bandwidths(frequency_response(record)).phase_hz
    assert closed(box).phase_bandwidth_hz == pytest.approx(hertz, rel=0.03)


def test_records_that_cannot_be_used_are_named(pitching: Record) -> None:
    with pytest.raises(ValueError, match="axis: 'leg_9' is not one of surge"):
        experiment(pitching, "leg_9")
    with pytest.raises(ValueError, match="axis: the record holds no demand in yaw"):
        plant_response(pitching, "yaw")
    cut = {name: values[:1000] for name, values in pitching.channels.items()}
    short = replace(pitching, time=pitching.time[:1000], channels=cut)
    with pytest.raises(ValueError, match="record: 1000 samples; allowed: 1024 or more"):
        experiment(short, "heave")
