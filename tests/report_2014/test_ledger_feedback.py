"""The ledger's entries on feedback gains, acceleration and force (section 3.4), in numbers."""

import control
import numpy as np
import pytest
from scipy.optimize import brentq
from shared import SINGLE, WORKING_STROKE, axial_gravity, chirp_bandwidths, printed, report_leg

from cmf_mj import SingleLegs, signals, simulate
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import leg_model
from cmf_mj.analysis.linear.poles import least_damped_mode
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.machine import kinematics
from cmf_mj.plant import cylinder
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.report_2014.ledger import LedgerEntry
from cmf_mj.report_2014.models import (
    hardware_velocity,
    report_entry,
    report_model,
)
from cmf_mj.report_2014.posterior.evidence import oscillation_g

INCH = units.INCH


def with_gains(name: str, **gains: float) -> Law:
    """A shipped law with other gains."""
    law = load_law(name)
    return law.model_copy(update={"direct_gain": law.direct_gain.model_copy(update=gains)})


def on_leg(law: Law) -> Measures:
    """A law around one leg of the `report` set."""
    return measure_loop(closed_loop(law, report_leg()))


def test_pressure_gains_act_in_pascal_only(entry: LedgerEntry) -> None:
    """Both chambers answer alike: A_cap + A_rod times dp is what moves the mass."""
    parameters = load_hydraulics("report")
    difference = 7200 * units.POUND_MASS * INCH / (parameters.cap_area + parameters.rod_area)
    gains = load_law("position_error_rate").direct_gain
    assert isinstance(gains.cap_pressure, float) and isinstance(gains.rod_pressure, float)
    both = gains.rod_pressure - gains.cap_pressure
    for unit, size in (("Pa", 1.0), ("psi", units.PSI)):
        name = f"gain on the acceleration, % per {unit}"
        assert -both * difference / size == pytest.approx(entry.figure(name), rel=5e-3)
    assert 0.09 < both * difference / 0.01 < 0.11  # a tenth of Table 3-3's gain
    for law in ("original", "velocity", "position_error_rate", "combined_rate", "acceleration"):
        direct = load_law(law).direct_gain
        loop = closed_loop(
            with_gains(
                law,
                cap_pressure=float(direct.cap_pressure) / units.PSI,
                rod_pressure=float(direct.rod_pressure) / units.PSI,
            ),
            report_leg(),
        )
        in_psi = measure_loop(loop)
        for field, name in (("phase_bandwidth_hz", "-90 deg"), ("gain_bandwidth_hz", "-3 dB")):
            before, after = getattr(SINGLE[law], field), getattr(in_psi, field)
            if (law, name) == ("acceleration", "-3 dB"):  # where the gain is almost flat
                flat = np.linspace(6.5, 7.4, 10)
                assert flat[0] < before < flat[-1] < after
                for system in (closed_loop(law, report_leg()), loop):
                    gain = 20.0 * np.log10(loop_response(system, flat).magnitude)
                    assert gain == pytest.approx(-3.0, abs=0.11)
                continue
            assert 1.0 < after / before < 1.03
            if law == "position_error_rate":
                figure = entry.figure(f"{name}, % per psi")
                assert after - before == pytest.approx(figure, abs=5e-4)


def test_combination_fits_with_1_8(entry: LedgerEntry) -> None:
    """Of the printed and the derived gain the second alone meets both numbers within 4 %."""
    print_ = printed("3-2", "combined_rate")
    for law, gain in (("combined_rate", "2.2"), ("combined_rate_1_8", "1.8")):
        ours = SINGLE[law]
        phase, width = ours.phase_bandwidth_hz, ours.gain_bandwidth_hz
        assert phase == pytest.approx(entry.figure(f"-90 deg, {gain}"), abs=0.005)
        assert width == pytest.approx(entry.figure(f"-3 dB, {gain}"), abs=0.01)
        near = [
            abs(phase / print_.phase_bandwidth_hz - 1.0) < 0.04,
            abs(width / print_.gain_bandwidth_hz - 1.0) < 0.04,
        ]
        assert near == [gain == "1.8"] * 2
    other = on_leg(with_gains("combined_rate", velocity=0.5))
    assert other.phase_bandwidth_hz == pytest.approx(print_.phase_bandwidth_hz, rel=0.02)
    assert other.gain_bandwidth_hz == pytest.approx(entry.figure("-3 dB, 2.2 and +0.5"), abs=0.01)


def test_eq_3_2_lacks_its_gain(entry: LedgerEntry) -> None:
    w, zeta, kp = 5.0, 0.2, 5.0
    g = control.tf([w**2], [1.0, 2.0 * w * zeta, w**2])
    for variant, side, gain in (("printed", "left", 1.0), ("corrected", "right", kp)):
        formula = report_entry("3.2", variant).formula  # type: ignore[arg-type]
        assert ("K_p G)" in formula) == (variant == "corrected")
        expected = entry.figure(f"static gain for K_p = 5, {side} side")
        assert control.dcgain(control.feedback(g, gain)) == pytest.approx(expected, abs=5e-4)


def test_eq_3_4_lowers_frequency_and_damping(entry: LedgerEntry) -> None:
    """The nested loops of Figure 3-12, one around the other, are Eq 3.4."""
    w, zeta, kp, kr, s = 5.0, 0.2, 1.5, 0.1, control.tf("s")
    loops = []
    for ka in (0.0, 1.0 / w**2):
        below = [1.0 + ka * w**2, 2.0 * zeta * w + kr * w**2, (1.0 + kp) * w**2]
        loops.append(control.tf([w**2], below))
        nested = control.tf([w**2], [1.0, 2.0 * zeta * w, w**2])
        for gain in (kp, kr * s, ka * s**2):
            nested = nested / (1.0 + gain * nested)
        assert nested(2.0j) == pytest.approx(loops[-1](2.0j))
    before, after = (loop.damp() for loop in loops)
    frequency, damping = (float(after[i][0] / before[i][0]) for i in (0, 1))
    assert frequency == pytest.approx(entry.figure("frequency for K_a w^2 = 1"), abs=5e-4)
    assert damping == pytest.approx(entry.figure("damping for K_a w^2 = 1"), abs=5e-4)


def test_signs_of_acceleration_feedback_differ(entry: LedgerEntry) -> None:
    """The pair of surge and pitch, which decides on the hexapod: tests/across/test_findings.py."""
    plain = SINGLE["position_error_rate"]
    plus, minus = SINGLE["acceleration_eq_3_6"], SINGLE["acceleration_opposing"]
    wider = plus.gain_bandwidth_hz - plain.gain_bandwidth_hz
    assert wider == pytest.approx(entry.figure("-3 dB with + over position error rate"), abs=0.005)
    wider = minus.gain_bandwidth_hz - plain.gain_bandwidth_hz
    assert wider == pytest.approx(entry.figure("-3 dB with - over position error rate"), abs=0.005)
    hertz = np.linspace(0.1, 8.0, 800)  # below the leg mode
    peaks = {
        law: np.abs(loop_response(closed_loop(law, report_leg()), hertz).frdata).max()
        for law in ("acceleration_eq_3_6", "position_error_rate", "acceleration_opposing")
    }
    assert sorted(peaks, key=peaks.__getitem__, reverse=True) == list(peaks)
    moved = plus.phase_bandwidth_hz - plain.phase_bandwidth_hz
    assert moved == pytest.approx(entry.figure("-90 deg with + over position error rate"), abs=2e-3)
    for sign in ("+", "-"):
        fast = on_leg(with_gains("acceleration", acceleration=float(f"{sign}0.01")))
        moved = fast.phase_bandwidth_hz - plain.phase_bandwidth_hz
        figure = entry.figure(f"-90 deg with {sign} behind 10 ms")
        assert moved == pytest.approx(figure, abs=2e-3)


def test_eqs_3_5_and_3_6_disagree(entry: LedgerEntry) -> None:
    runs = report_model("3.6").poles()[0].real
    for variant, name in (("printed", "pole from the print"), ("corrected", "pole from 0.02 s")):
        kept = control.sample_system(report_model("3.5", variant), 1.0 / 2048.0, "zoh")  # type: ignore[arg-type]
        pole = kept.poles()[0].real
        assert pole == pytest.approx(entry.figure(name), abs=5e-6)
        assert (abs(pole - runs) < 5e-5) == (variant == "corrected")


def test_accelerometer_filter_delays_six_times_as_long(entry: LedgerEntry) -> None:
    filtered = report_model("3.6")
    assert filtered.poles().size == 1
    omega = 2.0 * np.pi * 1.2
    response = filtered(np.exp(1j * omega / 2048.0))
    delay = -np.angle(response) / omega
    assert delay == pytest.approx(entry.figure("delay at 1.2 Hz"), abs=5e-5)
    assert delay / 0.01 == pytest.approx(6.0, abs=0.05)
    assert abs(response) == pytest.approx(entry.figure("gain at 1.2 Hz"), abs=5e-4)


def test_no_rest_reads_0_86_g(entry: LedgerEntry) -> None:
    reads = axial_gravity(np.zeros(6)) / units.STANDARD_GRAVITY
    np.testing.assert_allclose(reads, entry.figure("at neutral"), atol=5e-4)
    bottom = kinematics.legs_to_pose(np.full(6, -WORKING_STROKE))
    reads = axial_gravity(bottom) / units.STANDARD_GRAVITY
    np.testing.assert_allclose(reads, entry.figure("at the bottom"), atol=5e-3)
    out = kinematics.legs_to_pose(np.full(6, 13.8 * INCH))
    np.testing.assert_allclose(axial_gravity(out) / units.STANDARD_GRAVITY, 0.86, atol=5e-4)


def test_eq_3_7_sees_no_static_load(entry: LedgerEntry) -> None:
    parameters = load_hydraulics("report")
    legs = cylinder.make_cylinders(parameters, ["leg"])
    load = 7200.0 * units.POUND_FORCE
    cap, rod = cylinder.holding_pressures(legs, load, parameters.supply_pressure.si, 0.0)[0]
    whole = cylinder.force(legs[0], cap, rod) / units.POUND_FORCE
    assert whole == pytest.approx(entry.figure("cylinder force"), rel=1e-9)
    seen = parameters.rod_area * (cap - rod) / units.POUND_FORCE
    assert seen == pytest.approx(entry.figure("Eq 3.7"), abs=1e-6)


def test_delay_takes_half_a_hertz(entry: LedgerEntry) -> None:
    hertz = np.linspace(0.02, 10.0, 4000)
    response = loop_response(closed_loop("velocity", hardware_velocity(1)), hertz).frdata[0, 0]
    for delay, name in ((0.0, "-90 deg, model #1"), (0.03, "-90 deg with 0.03 s, model #1")):
        phase = np.degrees(np.unwrap(np.angle(response))) - 360.0 * hertz * delay
        width = hertz[np.argmax(phase < -90.0)]
        assert width == pytest.approx(entry.figure(name), abs=0.01)
    assert 360.0 * 2.5 * 0.03 == pytest.approx(27.0)


def test_acceleration_is_not_best_in_phase(entry: LedgerEntry) -> None:
    force, actual = printed("3-5", "force"), printed("3-5", "acceleration")
    below = force.phase_bandwidth_hz - actual.phase_bandwidth_hz
    assert below == pytest.approx(entry.figure("below force feedback"))


def test_acceleration_gains_no_hertz(entry: LedgerEntry) -> None:
    without, actual = printed("3-5", "position_error_rate"), printed("3-5", "acceleration")
    more = actual.phase_bandwidth_hz - without.phase_bandwidth_hz
    assert more == pytest.approx(entry.figure("gain in heave, printed"))
    damping = actual.damping_ratio - without.damping_ratio
    assert damping == pytest.approx(entry.figure("damping gained, printed"))
    for law, name in (("acceleration", "ours"), ("acceleration_eq_3_6", "Eq 3.6")):
        ours = SINGLE[law].phase_bandwidth_hz - SINGLE["position_error_rate"].phase_bandwidth_hz
        assert ours == pytest.approx(entry.figure(f"gain in heave, {name}"), abs=2e-3)
    others = [row.phase_bandwidth_hz or 0.0 for row in published_results() if row.table == "D-2"]
    assert min(others) - actual.phase_bandwidth_hz > 0.6


def test_force_feedback_is_not_damped_best(entry: LedgerEntry) -> None:
    better = printed("3-5", "original").damping_ratio - printed("3-5", "force").damping_ratio
    name = "damping below the original law, printed"
    assert better == pytest.approx(entry.figure(name))
    peak = SINGLE["original"].peak_gain_db
    assert peak == pytest.approx(entry.figure("peak of the original law, ours"), abs=0.05)
    assert peak < 1.0


def test_closed_loop_gain_at_minus_180_is_no_criterion(entry: LedgerEntry) -> None:
    """K / (s (s + 1)^2) crosses -180 deg at 1 rad/s with the gain K / 2, stable below K = 2."""
    plant = control.tf([1.6], [1.0, 2.0, 1.0, 0.0])
    loop = control.feedback(plant, 1)
    assert np.all(loop.poles().real < 0.0)
    name = "closed-loop gain at -180 deg of a stable loop"
    assert loop(1j).real == pytest.approx(-entry.figure(name))
    assert abs(loop(1j).imag) < 1e-9
    assert plant(1j).real == pytest.approx(-entry.figure("its open-loop gain"))


def test_table_3_5_wants_a_fast_filter(entry: LedgerEntry) -> None:
    """On one leg of ours, and around the report's own fit of its hardware."""
    plain = SINGLE["position_error_rate"]
    for law, name in (("acceleration_eq_3_6", "Eq 3.6"), ("acceleration", "10 ms")):
        ours = SINGLE[law]
        for field, what in (("phase_bandwidth_hz", "-90 deg"), ("gain_bandwidth_hz", "-3 dB")):
            gained = getattr(ours, field) - getattr(plain, field)
            assert gained == pytest.approx(entry.figure(f"{what} gained, {name}"), abs=5e-3)
    fitted = measure_loop(closed_loop("acceleration", hardware_velocity(1)))
    row = printed("3-5", "acceleration")
    for field, what in (("phase_bandwidth_hz", "-90 deg"), ("gain_bandwidth_hz", "-3 dB")):
        value = getattr(fitted, field)
        assert value == pytest.approx(entry.figure(f"{what} around Eq 4.12, 10 ms"), abs=5e-3)
        assert value == pytest.approx(getattr(row, field), rel=0.03)


def test_three_g_ask_for_2700_psi(entry: LedgerEntry) -> None:
    """Largest acceleration of the step; below what full pressure on the piston gives a leg."""
    shipped = load_hydraulics("report")
    command = signals.step("heave", INCH, duration=12.0)
    found = []
    for psi in (1500.0, 2000.0, 2500.0, 2700.0, 3000.0):
        pressure = shipped.supply_pressure.model_copy(update={"value": psi})
        parameters = shipped.model_copy(update={"supply_pressure": pressure})
        step = simulate(SingleLegs(parameters), "force", command)
        found.append(float(np.abs(step["leg_acceleration"]).max()) / units.STANDARD_GRAVITY)
        assert found[-1] == pytest.approx(entry.figure(f"{psi:g} psi"), abs=0.01)
        full = parameters.cap_area * pressure.si / (7200 * units.POUND_FORCE) - 1.0
        assert found[-1] < full
    assert sorted(found) == found
    assert found[2] < 3.0 < found[3]


def test_tables_3_5_and_d_2_are_two_laws(entry: LedgerEntry) -> None:
    """The report's chirp on single legs: one axis is like another, one gain not like the other."""
    for law, gain in (("acceleration", "0.01"), ("acceleration_d2", "0.06")):
        widths = {
            dof: chirp_bandwidths("single_legs", law, dof, hydraulics="report")
            for dof in ("heave", "surge")
        }
        for dof, width in widths.items():
            name = f"-90 deg, {gain}, {dof}"
            assert width.phase_hz == pytest.approx(entry.figure(name), abs=0.005)
        assert widths["surge"].phase_hz == pytest.approx(widths["heave"].phase_hz, rel=0.04)
        if gain == "0.01":
            width = widths["surge"].gain_hz
            assert width == pytest.approx(entry.figure("-3 dB, 0.01, surge"), abs=0.005)
        else:
            assert np.isnan(widths["surge"].gain_hz) and np.isnan(widths["heave"].gain_hz)
            print_ = printed("D-2", "acceleration", dof="surge").phase_bandwidth_hz
            assert widths["surge"].phase_hz == pytest.approx(print_, rel=0.01)


def test_the_leg_mode_is_damped_more_than_eq_4_1_says(entry: LedgerEntry) -> None:
    """Leak rates at which the leg mode of each loop stands still, over twice its frequency."""
    shipped = load_hydraulics("report")
    frequency = np.abs(report_model("4.1").poles()[np.argmax(report_model("4.1").poles().imag)])

    def least(law: str, leak: float) -> float:
        rate = shipped.leak_rate.model_copy(update={"value": leak})
        leg = SingleLegs(shipped.model_copy(update={"leak_rate": rate}))
        loop = closed_loop(law, leg_model(linearize(leg), 1))
        return least_damped_mode(loop.poles())[0]

    still = {}
    for law in ("velocity_error", "force"):
        leak = brentq(lambda value, law=law: least(law, value), shipped.leak_rate.value, 8.0)
        still[law] = leak / (2.0 * frequency)
        name = f"{law.replace('_', ' ')} feedback stable from"
        assert still[law] == pytest.approx(entry.figure(name), abs=2e-4)
    assert shipped.leak_rate.value / (2.0 * frequency) == pytest.approx(0.0114, abs=1e-4)
    assert 0.0114 < still["velocity_error"] < still["force"]
    middle = 2.0 * frequency * float(np.sqrt(still["velocity_error"] * still["force"]))
    rate = shipped.leak_rate.model_copy(update={"value": round(middle, 1)})
    swing = oscillation_g(3000.0, shipped.model_copy(update={"leak_rate": rate}))
    assert swing == pytest.approx(
        entry.figure("swing of force feedback in between, 3000 psi"), abs=0.02
    )
