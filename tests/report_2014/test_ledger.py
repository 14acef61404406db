"""The ledger's entries of sections 2 and 3 of the report, shown in numbers."""

import numpy as np
import pytest
from shared import SINGLE, WORKING_STROKE, printed, report_leg

from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.measures import FREQUENCIES, measure_loop
from cmf_mj.analysis.periodic import sine_response
from cmf_mj.control.error import integrate, make_error_calculations
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.machine import kinematics
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import load_machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.report_2014.ledger import LedgerEntry
from cmf_mj.report_2014.models import hardware_velocity

INCH = units.INCH
COSINE = 133.03 / 159.845
"""Of a leg at neutral to the vertical, from the coordinates of Appendix A."""


# -- section 2 -----------------------------------------------------------------------------------


def test_legs_reach_beyond_two_mechanical_limits(entry: LedgerEntry) -> None:
    reach = kinematics.excursion_envelope()
    limits = load_motion_limits()
    down, nose = reach[2, 1] / INCH, -np.degrees(reach[4, 0])
    assert down == pytest.approx(entry.figure("heave down"), abs=0.1)
    assert nose == pytest.approx(entry.figure("nose down"), abs=0.1)
    beyond = []
    for dof, (low, high) in zip(DOFS, reach, strict=True):
        stated = getattr(limits, dof).mechanical
        near = 1.2 if stated.unit == "in" else 0.8
        for leg, table in ((low, stated.low), (high, stated.high)):
            actual = units.from_si(stated.unit, leg)
            if abs(actual - table) > near:
                beyond.append((dof, bool(leg > 0.0), bool(abs(actual) > abs(table))))
    assert beyond == [("heave", True, True), ("pitch", False, True)]


def test_yaw_limit_fits_in_degrees_only(entry: LedgerEntry) -> None:
    limits = load_motion_limits()
    shares = {}
    for dof in DOFS:
        axis = getattr(limits, dof)
        shares[dof] = axis.operational.high / axis.mechanical.high
    yaw = shares.pop("yaw")
    assert yaw == pytest.approx(entry.figure("yaw, degrees over degrees"), abs=0.005)
    assert min(shares.values()) == pytest.approx(0.93, abs=0.005)
    assert max(shares.values()) == pytest.approx(0.96, abs=0.005)
    radius = np.linalg.norm(load_machine().geometry.upper[0, :2]) / INCH
    arc = np.degrees(38.0 / radius) / limits.yaw.mechanical.high
    assert arc == pytest.approx(entry.figure("yaw, inches as an arc"), abs=0.01)
    assert arc < 0.9 * min(shares.values())


def test_printed_b_does_not_track(entry: LedgerEntry) -> None:
    result = {
        law: [measure_loop(closed_loop(law, hardware_velocity(n))) for n in (1, 2, 3)]
        for law in ("original", "original_as_printed")
    }
    for law, name in (("original_as_printed", "printed"), ("original", "0.1079")):
        for row in result[law]:
            gain = entry.figure(f"static gain, {name}")
            assert row.static_gain == pytest.approx(gain, abs=5e-4)
    widths = [row.phase_bandwidth_hz for row in result["original"]]
    assert min(widths) == pytest.approx(entry.figure("lowest -90 deg, 0.1079"), abs=0.005)
    assert max(widths) == pytest.approx(entry.figure("highest -90 deg, 0.1079"), abs=0.005)


def test_load_and_mass_give_two_payloads(entry: LedgerEntry) -> None:
    load, mass = 6 * 7200 * COSINE, 6 * 7200 * COSINE**2
    assert load == pytest.approx(entry.figure("payload from the load"), abs=5.0)
    assert mass == pytest.approx(entry.figure("payload from the mass"), abs=5.0)
    assert load / mass == pytest.approx(1.20, abs=0.005)


def test_amplitude_is_not_one_per_cent_of_a_leg(entry: LedgerEntry) -> None:
    pose = np.zeros(6)
    pose[2] = -0.33 * INCH
    legs = kinematics.pose_to_legs(pose)
    np.testing.assert_allclose(legs / INCH, entry.figure("leg motion"), atol=5e-4)
    share = 100.0 * legs / WORKING_STROKE
    np.testing.assert_allclose(share, entry.figure("share of the leg's travel"), atol=5e-3)


def test_original_law_has_two_published_results(entry: LedgerEntry) -> None:
    one, two, ours = printed("2-4", "original"), printed("3-5", "original"), SINGLE["original"]
    assert one.phase_bandwidth_hz != two.phase_bandwidth_hz
    assert one.damping_ratio != two.damping_ratio
    assert ours.phase_bandwidth_hz == pytest.approx(entry.figure("-90 deg, ours"), abs=0.005)
    assert ours.damping_ratio == pytest.approx(entry.figure("damping, ours"), abs=0.005)
    for name in ("phase_bandwidth_hz", "damping_ratio"):
        mine = getattr(ours, name)
        assert abs(mine - getattr(one, name)) < abs(mine - getattr(two, name))


def test_velocity_law_has_two_published_results(entry: LedgerEntry) -> None:
    ours = SINGLE["velocity"].gain_bandwidth_hz
    assert ours == pytest.approx(entry.figure("-3 dB, ours"), abs=0.005)
    low, high = (printed(t, "velocity").gain_bandwidth_hz for t in ("2-6", "3-5"))
    assert low < ours < high


def test_shortfall_is_not_three_quarters_of_a_hertz(entry: LedgerEntry) -> None:
    machine, model = (printed("2-6", "velocity", of) for of in ("hardware", "nonlinear"))
    phase = machine.phase_bandwidth_hz - model.phase_bandwidth_hz
    gain = machine.gain_bandwidth_hz - model.gain_bandwidth_hz
    assert phase == pytest.approx(entry.figure("-90 deg"))
    assert gain == pytest.approx(entry.figure("-3 dB"))
    assert min(abs(phase - 0.75), abs(gain - 0.75)) > 0.14


def test_damping_differs_as_much_as_before(entry: LedgerEntry) -> None:
    for table, law in (("2-4", "original"), ("2-6", "velocity")):
        machine, model = (printed(table, law, of) for of in ("hardware", "nonlinear"))
        apart = model.damping_ratio - machine.damping_ratio
        assert apart == pytest.approx(entry.figure(law))


def test_velocity_law_stops_short(entry: LedgerEntry) -> None:
    for number in (1, 2, 3):
        result = measure_loop(closed_loop("velocity", hardware_velocity(number)))
        assert 100.0 * (1.0 - result.static_gain) == pytest.approx(entry.figure("offset"), abs=0.05)


def test_128_hz_is_ample_for_10_hz(entry: LedgerEntry) -> None:
    """A lag answers a 10 Hz sine; sampled at 128 Hz for a second its response is exact."""
    time = np.arange(128) / 128.0
    gain = 1.0 / (1.0 + 10.0j / 3.0)
    turning = np.exp(20j * np.pi * time)
    result = sine_response(turning.imag, (gain * turning).imag, 128.0, 10.0)
    assert abs(result.response[0] - gain) < entry.figure("largest error of a 10 Hz response")


def test_rounds_of_two_laws_leave_a_step(entry: LedgerEntry) -> None:
    """Between the last line of round 3, 5.4 Hz, and the first of round 4, 5.6 Hz."""
    line = np.array([5.5])
    gains = [
        abs(loop_response(closed_loop(law, hardware_velocity(1)), line).frdata[0, 0, 0])
        for law in ("original", "velocity")
    ]
    step = 20.0 * np.log10(gains[1] / gains[0])
    assert step == pytest.approx(entry.figure("original against velocity law at 5.5 Hz"), abs=0.05)


# -- section 3 -----------------------------------------------------------------------------------


def test_integrator_limit_never_acts(entry: LedgerEntry) -> None:
    law = load_law("velocity_integral")
    command = law.direct_gain.error_integral * law.integrator_limit
    assert command == pytest.approx(entry.figure("command at the limit"))
    assert command > 100.0


def test_trigger_at_the_stop_winds_up(entry: LedgerEntry) -> None:
    law = load_law("velocity_integral")
    for trigger in (-37.5, -37.0):
        error = make_error_calculations(
            law.model_copy(update={"integrator_trigger": trigger}), WORKING_STROKE
        )
        seen = integrate(error, 0.0, -37.5 * INCH, -37.2 * INCH) * 2048.0 / INCH
        name = f"error seen at -37.2 in, trigger {trigger:g} in"
        assert seen == pytest.approx(entry.figure(name), abs=1e-9)


def test_0_1_g_is_above_published_thresholds(entry: LedgerEntry) -> None:
    swing = 0.1 * units.STANDARD_GRAVITY
    assert swing / 0.28 == pytest.approx(entry.figure("over the cueing threshold"), rel=0.01)
    assert swing / 0.015 == pytest.approx(entry.figure("over ISO 2631-1"), rel=0.01)


def test_combination_is_last_of_three(entry: LedgerEntry) -> None:
    rate, error, both = (
        printed("3-2", law) for law in ("position_error_rate", "velocity_error", "combined_rate")
    )
    for name, figure in (
        ("phase_bandwidth_hz", "-90 deg below position error rate"),
        ("gain_bandwidth_hz", "-3 dB below position error rate"),
    ):
        assert getattr(rate, name) - getattr(both, name) == pytest.approx(entry.figure(figure))
        assert getattr(both, name) < min(getattr(rate, name), getattr(error, name))
    assert error.phase_bandwidth_hz > rate.phase_bandwidth_hz


def test_gains_of_the_combination_add(entry: LedgerEntry) -> None:
    gains = load_law("combined_rate").direct_gain
    total = gains.velocity - gains.position_error_rate
    assert total == pytest.approx(entry.figure("gain on the velocity"))
    alone, both = SINGLE["position_error_rate"], SINGLE["combined_rate"]
    rise = both.phase_bandwidth_hz - alone.phase_bandwidth_hz
    assert rise == pytest.approx(entry.figure("-90 deg, ours, rise"), abs=0.005)
    one, two = printed("3-2", "position_error_rate"), printed("3-2", "combined_rate")
    fall = two.phase_bandwidth_hz - one.phase_bandwidth_hz
    assert fall == pytest.approx(entry.figure("-90 deg, printed, rise"))


def test_velocity_error_has_more_phase_bandwidth(entry: LedgerEntry) -> None:
    rate, error = printed("3-2", "position_error_rate"), printed("3-2", "velocity_error")
    more = error.phase_bandwidth_hz - rate.phase_bandwidth_hz
    assert more == pytest.approx(entry.figure("printed"))
    assert rate.damping_ratio == error.damping_ratio
    ours, other = SINGLE["velocity_error"], SINGLE["position_error_rate"]
    assert other.stable
    assert not ours.stable
    assert np.isnan(ours.phase_bandwidth_hz)
    swept = bandwidths(loop_response(closed_loop("velocity_error", report_leg()), FREQUENCIES))
    more = swept.phase_hz - other.phase_bandwidth_hz
    assert more == pytest.approx(entry.figure("ours, of the response alone"), abs=0.01)


def test_position_error_rate_has_two_published_results(entry: LedgerEntry) -> None:
    ours = SINGLE["position_error_rate"]
    low, high = (
        printed(table, "position_error_rate").gain_bandwidth_hz for table in ("3-2", "3-5")
    )
    assert ours.gain_bandwidth_hz == pytest.approx(entry.figure("-3 dB, ours"), abs=0.005)
    assert abs(ours.gain_bandwidth_hz - low) < abs(ours.gain_bandwidth_hz - high)
    lost = SINGLE["velocity"].damping_ratio - ours.damping_ratio
    assert lost == pytest.approx(entry.figure("damping below the velocity law, ours"), abs=0.005)
