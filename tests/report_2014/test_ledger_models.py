"""The ledger's entries of section 4 and the appendices, shown in numbers."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from shared import axial_gravity, projected_gravity

from cmf_mj import Hexapod
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import published_results
from cmf_mj.analysis.spectra import mean_of_h1_and_h2, report_response, welch_response
from cmf_mj.core import units
from cmf_mj.machine import kinematics
from cmf_mj.machine.machine import load_machine
from cmf_mj.report_2014.ledger import LedgerEntry
from cmf_mj.report_2014.models import hardware_velocity, report_entry, report_model

INCH = units.INCH
AREAS = (np.pi / 4.0 * 5.5**2, np.pi / 4.0 * (5.5**2 - 3.875**2))
MASS = 7200.0 / 386.0886
TABLE_4_1 = {row.of: row for row in published_results() if row.table == "4-1"}
Real = NDArray[np.float64]


@pytest.fixture(scope="module")
def loops() -> dict[int, Measures]:
    """The velocity law around linear models 1 to 3."""
    return {n: measure_loop(closed_loop("velocity", hardware_velocity(n))) for n in (1, 2, 3)}


# -- section 4 -----------------------------------------------------------------------------------


def test_gain_of_eq_4_1_is_unusable(entry: LedgerEntry) -> None:
    ratio = abs(report_model("4.1")(2.0j) / report_model("4.4")(2.0j))
    assert ratio == pytest.approx(entry.figure("over Eq 4.4"), abs=50.0)


def test_eq_4_4_has_no_leg_mode(entry: LedgerEntry) -> None:
    for number in ("4.4", "4.1"):
        poles = report_model(number).poles()
        hertz = np.abs(poles[poles.imag > 0.0]) / (2.0 * np.pi)
        assert hertz == pytest.approx([entry.figure(f"pair of Eq {number}")], rel=2e-3)
    poles = report_model("4.4").poles()
    assert np.abs(poles[poles.imag > 0.0]) / (2.0 * np.pi) == pytest.approx(568.4, abs=0.1)
    for lag in (-18.85, -471.24):
        assert np.abs(poles / lag - 1.0).min() < 6e-4
    assert np.abs(np.abs(poles) - 71.0).min() > 50.0


def test_eq_4_4_is_faster_than_the_non_linear_rows(entry: LedgerEntry) -> None:
    speed = abs(report_model("4.4")(1.0j) * 1.0j)
    assert speed == pytest.approx(entry.figure("leg speed of Eq 4.4"), abs=0.002)
    width = measure_loop(closed_loop("velocity", report_model("4.4"))).phase_bandwidth_hz
    assert width == pytest.approx(entry.figure("-90 deg of the velocity law"), abs=0.005)
    rows = [row for row in published_results() if (row.law, row.of) == ("velocity", "nonlinear")]
    assert {row.phase_bandwidth_hz for row in rows} == {2.5}


def test_pressures_of_model_a_break_newtons_law(entry: LedgerEntry) -> None:
    x, cap, rod = (report_model(number) for number in ("4.4", "4.5", "4.6"))
    s = 1e6j
    ratio = abs(MASS * s**2 * x(s) / (AREAS[0] * cap(s) - AREAS[1] * rod(s)))
    assert ratio == pytest.approx(entry.figure("mass times acceleration over force"), rel=0.01)
    s = 1e-3j  # where the leg runs evenly, the force should vanish
    force = AREAS[0] * cap(s) - AREAS[1] * rod(s)
    assert abs(force) > 1e4 * abs(MASS * s**2 * x(s))


def test_eq_4_7_is_not_s_times_eq_4_4(entry: LedgerEntry) -> None:
    s = 1j * np.geomspace(0.01, 1000.0, 30)
    ratio = s * report_model("4.4")(s) / report_model("4.7", "printed")(s)
    np.testing.assert_allclose(ratio, entry.figure("s times Eq 4.4 over Eq 4.7"), rtol=1e-10)
    corrected = report_model("4.7")(s)
    np.testing.assert_allclose(corrected, s * report_model("4.4")(s), rtol=1e-10)


def test_fitted_positions_are_unstable(entry: LedgerEntry) -> None:
    for number in ("4.11", "4.14", "4.17"):
        poles = report_model(number).poles()
        assert np.count_nonzero(poles.real > 0.0) == 1
        assert poles.real.max() == pytest.approx(entry.figure(f"pole of Eq {number}"), abs=5e-4)


def test_acceleration_of_model_3_is_not_the_derivative(entry: LedgerEntry) -> None:
    s = 2j * np.pi
    ratio = report_model("4.19").to_si()(s) / (s * report_model("4.18").to_si()(s))
    name = "Eq 4.19 over s times Eq 4.18 at 1 Hz"
    assert abs(ratio) == pytest.approx(entry.figure(name), abs=0.1)


def test_rise_takes_less_than_two_tenths(entry: LedgerEntry, loops: dict[int, Measures]) -> None:
    rise = loops[1].rise_time
    assert rise == pytest.approx(entry.figure("rise time, model #1"), abs=5e-4)
    assert rise < 0.2


def test_model_3_is_farthest_in_damping(entry: LedgerEntry, loops: dict[int, Measures]) -> None:
    hardware = TABLE_4_1["hardware"].damping_ratio or 0.0
    overshoot = np.exp(-np.pi * hardware / np.sqrt(1.0 - hardware**2))
    assert overshoot == pytest.approx(entry.figure("overshoot for 0.4"), abs=5e-4)
    for number, result in loops.items():
        name = f"overshoot, model #{number}"
        assert result.overshoot == pytest.approx(entry.figure(name), abs=5e-4)
    off = {n: abs((TABLE_4_1[f"linear_{n}"].damping_ratio or 0.0) - hardware) for n in loops}
    assert max(off, key=off.__getitem__) == 3
    assert max(loops, key=lambda n: overshoot - loops[n].overshoot) == 3


def test_conclusion_names_the_wrong_equation(
    entry: LedgerEntry, loops: dict[int, Measures]
) -> None:
    assert report_entry("4.17", "printed").model == report_entry("4.12").model == "linear model #1"
    assert report_entry("4.17").model == report_entry("4.18").model == "linear model #3"
    hardware = TABLE_4_1["hardware"].phase_bandwidth_hz or 0.0
    for number, name in (
        (1, "phase bandwidth of Eq 4.12 short of the hardware"),
        (3, "of Eq 4.18"),
    ):
        short = 100.0 * (1.0 - loops[number].phase_bandwidth_hz / hardware)
        assert short == pytest.approx(entry.figure(name), abs=0.05)
    first = TABLE_4_1["linear_1"].phase_bandwidth_hz or 0.0
    assert 100.0 * (1.0 - first / hardware) == pytest.approx(6.5, abs=0.05)


# -- appendix A ----------------------------------------------------------------------------------


def test_113_5_is_not_the_neutral_length(entry: LedgerEntry) -> None:
    geometry = load_machine().geometry
    length = np.linalg.norm(geometry.upper - geometry.lower, axis=1) / INCH
    name = "distance of the gimbals"
    np.testing.assert_allclose(length, entry.figure(name), atol=3e-3)
    result = kinematics.legs_to_pose(np.full(6, 113.5 - entry.figure(name)) * INCH, geometry)
    np.testing.assert_allclose(result[[0, 1, 3, 4, 5]], 0.0, atol=1e-4)
    height = result[2] / INCH
    assert height == pytest.approx(entry.figure("height of the pose below neutral"), abs=0.1)
    heave = [np.linalg.inv(kinematics.pose_jacobian(p))[2].sum() for p in (result, np.zeros(6))]
    name = "heave per leg motion over that at neutral"
    assert heave[0] / heave[1] == pytest.approx(entry.figure(name), abs=0.005)


def pitch_column(pose: Real, *, printed: bool = False, exchanged: bool = False) -> Real:
    """df(i, 5) of invXform, half of it, in inches: half the derivative of the squared length."""
    geometry = load_machine().geometry
    a, b = geometry.upper.T / INCH, geometry.lower.T / INCH
    x, y, z = pose[:3] / INCH
    roll, pitch, yaw = pose[3:]
    if exchanged:
        roll, yaw = yaw, roll
    sin, cos = np.sin, np.cos
    spread = -a[0] * sin(pitch) + (a[1] * sin(roll) + a[2] * cos(roll)) * cos(pitch)
    along, across = spread * cos(yaw), spread * sin(yaw)
    if printed:
        within = a[0] * sin(pitch) * cos(yaw) + a[1] * sin(roll) * cos(pitch) * cos(yaw) + a[2]
        along = within * cos(roll) * cos(pitch) * cos(yaw)
    down = a[0] * cos(pitch) + a[1] * sin(roll) * sin(pitch) + a[2] * cos(roll) * sin(pitch)
    return np.asarray((x - b[0]) * along + (y - b[1]) * across - (z - b[2]) * down)


def true_pitch_column(pose: Real) -> Real:
    """Length times derivative of the length with pitch, in^2/rad."""
    geometry = load_machine().geometry
    length = kinematics.pose_to_legs(pose) + geometry.neutral
    return np.asarray(length * kinematics.pose_jacobian(pose)[:, 4] / INCH**2)


def column_error(result: Real, pose: Real) -> float:
    true = true_pitch_column(pose)
    return float(np.abs(result - true).max() / np.abs(true).max())


def test_printed_pitch_column_is_not_the_derivative(entry: LedgerEntry) -> None:
    pose = np.concatenate([np.zeros(3), np.radians([10.0, 10.0, 10.0])])
    assert column_error(pitch_column(pose), pose) < 1e-7
    off = column_error(pitch_column(pose, printed=True), pose)
    assert off == pytest.approx(
        entry.figure("largest error of the column at a pose of 10 deg each"), rel=0.02
    )


def test_exchanged_angles_spoil_the_pitch_column(entry: LedgerEntry) -> None:
    pose = np.concatenate([np.zeros(5), np.radians([25.0])])
    assert column_error(pitch_column(pose), pose) < 1e-7
    off = column_error(pitch_column(pose, exchanged=True), pose)
    name = "largest error of the column at 25 deg of yaw"
    assert off == pytest.approx(entry.figure(name), rel=0.02)


def test_mean_of_h1_and_h2_is_biased(entry: LedgerEntry) -> None:
    """A gain of one with white noise on the output, 400 s at 128 Hz, whole mean over the lines."""
    random = np.random.default_rng(4)
    x, noise = random.normal(size=(2, 51200))
    for coherence in (0.95, 0.9, 0.8):
        y = x + np.sqrt(1.0 / coherence - 1.0) * noise
        found = welch_response(x, y, 128.0, segment=2.0)
        h1, report = (
            20.0 * np.log10(one.response.real.mean()) for one in (found, mean_of_h1_and_h2(found))
        )
        stated = entry.figure(f"bias at a coherence of {coherence:g}")
        assert report - h1 == pytest.approx(stated, abs=0.02)
        assert h1 == pytest.approx(0.0, abs=0.02)
        assert 20.0 * np.log10(0.5 * (1.0 + 1.0 / coherence)) == pytest.approx(stated, abs=0.005)


def test_minus_sign_is_taken_back_once_too_often(entry: LedgerEntry) -> None:
    lag = 1.0 / (1.0 + 1j * np.linspace(0.01, 1.0, 100))
    routine = np.degrees(np.unwrap(np.angle(-lag)))
    once, twice = routine - 180.0, routine - 180.0 - 180.0
    np.testing.assert_allclose(once, np.degrees(np.angle(lag)), atol=1e-9)
    name = "phase of a lag at its corner, one correction"
    assert once[-1] == pytest.approx(entry.figure(name))
    assert twice[-1] == pytest.approx(entry.figure("both corrections"))


def test_padding_does_not_resolve(entry: LedgerEntry) -> None:
    """Two sines 0.08 Hz apart, in phase amid the first segment of 12.5 s of a record of 50 s."""
    time = np.arange(6400) / 128.0
    wave = np.sin(2.0 * np.pi * 3.0 * time) + np.sin(2.0 * np.pi * 3.08 * time + np.pi)
    band = slice(round(2.6 * 50.0), round(3.5 * 50.0))
    for size, name in ((1600, "peaks, padded segment"), (6400, "peaks, whole record")):
        spectrum = np.abs(np.fft.rfft(wave[:size] * signal.windows.hann(size), 6400))[band]
        peaks, _ = signal.find_peaks(spectrum, height=0.3 * spectrum.max())
        assert peaks.size == entry.figure(name)


def test_segments_follow_the_options(entry: LedgerEntry) -> None:
    """FRFunction: floor((N - 1) / ((7 - 1) (1 - 0.5) + 1)) steps, for rows 2 to 36 739."""
    samples = 36739 - 1
    assert (samples - 1) // 4 / 128.0 == pytest.approx(entry.figure("segment, options"), abs=0.05)
    assert 4096 / 128.0 == entry.figure("segment, variables")
    random = np.random.default_rng(1)
    x = random.normal(size=samples)
    result = report_response(x, x + random.normal(size=samples), 128.0)
    assert result.averages.max() < 8.0


def test_ceil_of_the_rate_can_be_one_too_many(entry: LedgerEntry) -> None:
    for rate in (128, 120):
        time = np.arange(200) * (1.0 / rate)
        result = np.ceil(1.0 / (time[49] - time[48]))
        assert result == entry.figure(f"rate at {rate} Hz")


# -- appendices C and D --------------------------------------------------------------------------


def test_eq_c_3_is_no_component(entry: LedgerEntry) -> None:
    neutral = np.zeros(6)
    length = float(load_machine().geometry.neutral[0])
    half = projected_gravity(neutral, 0.5 * length) / units.STANDARD_GRAVITY
    np.testing.assert_allclose(
        half, entry.figure("Eq C.3 with r half the leg, at neutral"), atol=5e-4
    )
    actual = axial_gravity(neutral) / units.STANDARD_GRAVITY
    np.testing.assert_allclose(actual, entry.figure("component at neutral"), atol=5e-4)
    np.testing.assert_allclose(projected_gravity(neutral, 0.0), units.STANDARD_GRAVITY, rtol=1e-12)


def test_surge_is_not_heave(entry: LedgerEntry) -> None:
    """Heave is the mode in which all legs move alike."""
    result = Hexapod("gfd").hydraulic_modes()
    hertz = result.frequency / (2.0 * np.pi)
    assert hertz.min() == pytest.approx(entry.figure("surge mode"), rel=0.01)
    shapes = result.leg_shape
    alike = np.abs(shapes.sum(axis=0)) / np.linalg.norm(shapes, axis=0)
    heave = hertz[np.argmax(alike)]
    assert heave == pytest.approx(entry.figure("heave mode"), rel=0.01)
    assert hertz.min() < 0.5 * heave
