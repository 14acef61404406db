"""From aircraft to cab: what is asked, what is felt, how late, and within which limits."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cab_motions import pushed
from shared import WORKING_STROKE, cmf

from cmf_mj import signals
from cmf_mj.analysis.metrics import transient_delay
from cmf_mj.control.dcu.state import load_dcu
from cmf_mj.core.units import RATE
from cmf_mj.facility.host.stream import HostStream, from_command, make_stream
from cmf_mj.facility.operation import operate
from cmf_mj.machine import kinematics
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.flight import Flight, load_flight
from cmf_mj.pilot.fly import (
    RECORD_EVERY,
    FlightResult,
    crew_motion,
    flight_result,
    fly,
    law_delay,
)
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception import cueing_error
from cmf_mj.pilot.washout_settings import PredictiveSettings, load_washout
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.show import flight as flight_report
from cmf_mj.show.cueing import motion_panels
from scripts.flights import with_gains

IDEAL: dict[str, Any] = {"electronics": None}


def cut(motion: PilotMotion, start: float, stop: float) -> PilotMotion:
    rows = (motion.time >= start) & (motion.time < stop)
    columns = (motion.specific_force, motion.angular_rate, motion.attitude)
    return PilotMotion(motion.time[rows] - start, *(values[rows] for values in columns))


@pytest.fixture(scope="module")
def failing() -> PilotMotion:
    """12 s around the engine failure."""
    return cut(load_flight("engine_failure").motion, 26.0, 38.0)


@pytest.fixture(scope="module")
def ride(failing: PilotMotion) -> FlightResult:
    return fly(failing, "velocity")


def test_the_envelope_is_kept_and_nothing_fails(ride: FlightResult) -> None:
    assert ride.fault is None
    assert 0.1 < ride.use.travel < 1.0
    assert not ride.limited.any()
    assert all(np.isfinite(values).all() for values in ride.operation.record.channels.values())


def test_delays_are_the_dcus_and_the_loops(ride: FlightResult) -> None:
    assert ride.host_delay == pytest.approx(load_dcu().delay.total, abs=1.0 / RATE)
    assert 0.02 < ride.loop_delay < 0.15


def test_the_delay_of_a_slow_transient_is_found_whatever_its_gain() -> None:
    """A bump of 5 s delayed by 37 ms, exact but for the optimiser's tolerance."""
    time = np.arange(0.0, 12.0, 1.0 / 256.0)

    def bump(at: np.ndarray) -> np.ndarray:
        return np.exp(-((at - 6.0) ** 2))

    computed = transient_delay(bump(time), 0.8 * bump(time - 0.037) + 0.1, 256.0)
    assert computed == pytest.approx(0.037, abs=1e-4)


def test_the_machines_error_is_that_of_the_flight_less_that_of_the_washout(
    ride: FlightResult,
) -> None:
    """Senses are linear: aircraft - cab = (aircraft - asked) + (asked - cab)."""
    baseline = ride.washout_error
    np.testing.assert_allclose(
        ride.cueing.error, baseline.error + ride.machine.error, rtol=0, atol=1e-12
    )
    assert (ride.machine.rms[:3] > 1e-4).all()


def test_a_washout_without_gain_leaves_the_pilot_at_rest(failing: PilotMotion) -> None:
    still = with_gains(load_washout("simona"), np.zeros(6))
    ride = fly(cut(failing, 0.0, 2.0), "velocity", washout=still, **IDEAL)
    assert not ride.stream.pose.any()
    rest = np.tile([0.0, 0.0, -9.80665], (ride.asked.time.size, 1))
    np.testing.assert_allclose(ride.asked.specific_force, rest, atol=1e-12)
    # The law's output begins at its offset, which shakes the cab for half a second.
    settled = ride.asked.time > 1.0
    np.testing.assert_allclose(ride.simulator.specific_force[settled], rest[settled], atol=5e-3)
    assert np.isnan(ride.host_delay)
    assert ride.use.share[0].max() < 1e-3


def platform_flown(stream: HostStream, law: str = "velocity") -> FlightResult:
    """A ride whose aircraft does what the frames ask of the platform, with ideal electronics."""
    plant, aircraft = Hexapod(), PilotMotion.from_platform(stream, load_cab().station)
    operation = operate(plant, law, stream, record_every=RECORD_EVERY, **IDEAL)
    return flight_result(plant, aircraft, stream, operation, load_motion_limits())


@pytest.fixture(scope="module")
def direct() -> FlightResult:
    """A slow sine of the platform in surge."""
    command = signals.sine("surge", 0.1, 0.4, cycles=3.0, fade=2.0)
    return platform_flown(from_command(command, 80.0))


def test_an_aircraft_that_moves_as_the_frames_ask_has_no_error_of_the_washout(
    direct: FlightResult,
) -> None:
    assert not direct.washout_error.error.any()
    np.testing.assert_array_equal(direct.cueing.error, direct.machine.error)
    assert direct.use.travel < 1.0 and not direct.limited.any()


def test_a_plan_leads_by_the_loops_delay(direct: FlightResult) -> None:
    """That of the linear loop is what a slow sine's legs have; a linear washout does not lead."""
    delay = law_delay(Hexapod(), "velocity", "predictive")
    assert delay == pytest.approx(direct.loop_delay, rel=0.3)
    assert law_delay(Hexapod(), "velocity", "simona") == 0.0


def test_a_known_push_is_felt_sooner_with_the_lead() -> None:
    """Error sensed in the cab along x, a plan that leads next to one that does not: 6 % less."""
    time = np.arange(640) / 80.0
    flown = pushed(0, np.clip(time - 2.0, 0.0, 1.0))
    settings = load_washout("predictive").model_copy()
    assert isinstance(settings, PredictiveSettings)
    known = settings.prediction.model_copy(update={"reference": "known"})
    settings = settings.model_copy(update={"prediction": known})
    led = fly(flown, "velocity", washout=settings, **IDEAL)
    late = cue(flown, settings).stream
    followed = platform_flown(late)
    assert led.plans is not None
    error = cueing_error(led.aircraft, followed.simulator)
    assert led.cueing.rms[0] == pytest.approx(0.938 * error.rms[0], rel=0.01)


def test_the_cab_feels_what_was_asked_when_delay_and_gain_are_taken_out(
    direct: FlightResult,
) -> None:
    """Fundamental of the specific force along x: gain within 10 %, phase that of the delays."""
    asked, cab = direct.asked.specific_force[:, 0], direct.simulator.specific_force[:, 0]
    best = np.fft.rfft(asked * np.hanning(asked.size)), np.fft.rfft(cab * np.hanning(cab.size))
    line = int(np.abs(best[0]).argmax())
    ratio = best[1][line] / best[0][line]
    frequency = line * direct.asked.rate / asked.size
    assert abs(ratio) == pytest.approx(1.0, abs=0.1)
    late = -np.angle(ratio) / (2.0 * np.pi * frequency)
    assert late == pytest.approx(direct.host_delay + direct.loop_delay, abs=0.01)


def test_taking_80_hz_samples_leaves_slow_motion_as_it_is(direct: FlightResult) -> None:
    record = direct.operation.record
    time = direct.asked.time[80:-80]
    raw = PilotMotion.from_record(record)
    # `crew_motion` counts from its first time.
    shifted = crew_motion(record, direct.asked.time).specific_force[80:-80, 0]
    at = np.interp(time, raw.time, raw.specific_force[:, 0])
    assert np.sqrt(np.mean((shifted - at) ** 2)) < 0.02 * np.std(at)


def test_the_use_of_the_envelope_is_that_of_a_pose_held() -> None:
    pose = np.array([0.3, -0.2, 0.1, 0.05, -0.06, 0.1])
    stream = make_stream(np.arange(80) / 80.0, np.tile(pose, (80, 1)))
    ride = platform_flown(stream, "velocity_integral")
    low, high = load_motion_limits().operational.T
    use = ride.use
    # The law's own offset moves the platform by an inch or so.
    np.testing.assert_allclose(use.share[0], np.maximum(pose / low, pose / high), atol=0.06)
    legs = np.abs(kinematics.pose_to_legs(pose)).max() / WORKING_STROKE
    assert use.share[3].max() == pytest.approx(legs, abs=0.06)


@pytest.mark.slow
def test_cmf_flight_records_and_cmf_fly_compares(
    failing: PilotMotion, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    flight = load_flight("engine_failure")
    short = Flight(cut(failing, 2.0, 5.0), flight.origin).save(tmp_path / "short.csv")
    out = tmp_path / "out"
    laws = "velocity,position_error_rate"
    text = cmf("fly", short, "--laws", laws, "--washout", "optimal", "--out", out)
    assert text.count("kept within the envelope") == 2
    with (out / "comparison.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert [row[0] for row in rows[1:]] == ["machine that follows at once", *laws.split(",")]
    names = {"motion.png", "perceived.png", "record.parquet", "host.parquet"}
    for law in laws.split(","):
        assert names <= {path.name for path in (out / law).iterdir()}
    assert set(drawn) == {"motion.png", "perceived.png", "operation.png", "comparison.png"}


def test_traces_of_a_ride_are_what_the_pilots_are_subjected_to(ride: FlightResult) -> None:
    panels = motion_panels(*flight_report.drawn_motions(ride))
    assert [panel.y_title for panel in panels][::3] == ["f_x [m/s²]", "p [deg/s]"]
    force, rate = panels[1].curves, panels[5].curves
    assert force[0].x[0] == 0.0 and force[0].x[-1] == pytest.approx(12.0, abs=0.02)
    assert [curve.name for curve in force] == ["aircraft", "asked of the platform", "cab"]
    np.testing.assert_array_equal(force[0].y, ride.aircraft.specific_force[:, 1])
    yaw = np.degrees(ride.simulator.angular_rate[:, 2])
    np.testing.assert_allclose(rate[2].y, yaw, rtol=1e-14)


def test_traces_beside_records_are_those_that_move(ride: FlightResult, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("one", "two")]
    level = replace(ride.asked, angular_rate=0.0 * ride.asked.angular_rate)
    still = ride._replace(aircraft=level, asked=level, simulator=level)
    for folder, each in zip(folders, (ride, still), strict=True):
        flight_report.save_flight(each, folder)
    files = [folder / "record.parquet" for folder in folders]
    every = [panel.y_title for panel in motion_panels(*flight_report.drawn_motions(ride))]
    both, alone = flight_report.saved_traces(files), flight_report.saved_traces(files[1:])
    assert [[panel.y_title for panel in panels] for panels in both] == [every, every]
    assert [panel.y_title for panel in alone[0]] == every[:3]
    assert flight_report.saved_traces([*files, tmp_path / "other" / "record.parquet"]) == []


def test_cmf_flight_flies_a_script(tmp_path: Path) -> None:
    path = tmp_path / "gusts.parquet"
    assert "13.48 m forward" in cmf("flight", "gusts", "--file", str(path))
    shipped = load_flight("gusts").motion
    np.testing.assert_allclose(
        load_flight(path).motion.specific_force, shipped.specific_force, atol=2e-6
    )
