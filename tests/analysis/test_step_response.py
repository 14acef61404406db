"""Step measures recovered from records of known second-order systems."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from followed_commands import answer, record_of, second_order
from numpy.typing import NDArray
from scipy import optimize

from cmf_mj import Record, signals, step_metrics
from cmf_mj.analysis.measures import resonant_damping
from cmf_mj.analysis.step_response import damping_from_overshoot
from cmf_mj.machine.geometry import DOFS

RATE = 2048
STEP = -0.0254  #: The report's 1 in heave step [m], upwards.


@cache
def stepped(
    zeta: float,
    hertz: float,
    gain: float = 1.0,
    *,
    dof: str = "heave",
    amplitude: float = STEP,
    every: int = 8,
) -> Record:
    """The response to a step at 1 s of 8 s, at 256 Hz by default."""
    command = signals.step(dof, amplitude, at=1.0, duration=8.0)
    return record_of(command, answer(command, second_order(zeta, hertz, gain)), every)


def unit_step(time: NDArray[np.float64] | float, zeta: float, hertz: float) -> Any:
    """Textbook step response of an underdamped second-order system (Ogata, Eq 5-12)."""
    omega = 2 * np.pi * hertz
    damped = omega * np.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * time)
    wave = np.cos(damped * time) + zeta / np.sqrt(1 - zeta**2) * np.sin(damped * time)
    return 1 - decay * wave


@pytest.mark.parametrize("dof", DOFS)
@pytest.mark.parametrize(("zeta", "hertz"), [(0.2, 1.6), (0.4, 2.5), (0.8, 4.0)])
def test_overshoot_and_damping_are_recovered(dof: str, zeta: float, hertz: float) -> None:
    """Overshoot exp(-pi zeta / sqrt(1 - zeta^2)) in every degree of freedom, both signs.

    1e-4: sampling of the peak, (pi 4 Hz / 1024)^2 / 2.
    """
    amplitude = 0.01 if dof in DOFS[3:] else 0.02
    metrics = step_metrics(stepped(zeta, hertz, dof=dof, amplitude=amplitude, every=2))
    expected = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert metrics.overshoot == pytest.approx(expected, abs=1e-4)
    assert metrics.damping_ratio == pytest.approx(zeta, abs=2e-3)
    assert metrics.stable


@pytest.mark.parametrize("overshoot", [1e-6, 0.1, 0.5, 0.999])
def test_damping_inverts_the_overshoot_formula(overshoot: float) -> None:
    zeta = damping_from_overshoot(overshoot)
    assert np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)) == pytest.approx(overshoot, rel=1e-9)


def test_damping_at_the_ends_of_its_range() -> None:
    """No overshoot tells nothing about the damping; a full one means none."""
    assert np.isnan(damping_from_overshoot(0.0))
    assert np.isnan(damping_from_overshoot(-0.1))
    assert np.isnan(damping_from_overshoot(float("nan")))
    assert damping_from_overshoot(1.0) == 0.0
    assert damping_from_overshoot(1.5) == 0.0


@pytest.mark.parametrize("zeta", [0.1, 0.4, 0.7])
def test_damping_from_the_peak_of_the_gain(zeta: float) -> None:
    gain = np.abs(second_order(zeta, 1.0)(2j * np.pi * np.linspace(0.0, 1.0, 20001)))
    assert resonant_damping(float(gain.max())) == pytest.approx(zeta, abs=1e-4)
    assert np.isnan(resonant_damping(1.0))
    assert np.isnan(resonant_damping(0.9))


@pytest.mark.parametrize("hertz", [1.0, 2.0, 4.0])
def test_no_overshoot_gives_no_damping_ratio(hertz: float) -> None:
    """An overdamped response never exceeds its final value: no overshoot and NaN, as documented,
    also where it is still creeping up by less than 1e-6 at the end."""
    metrics = step_metrics(stepped(1.5, hertz))
    assert metrics.overshoot == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(metrics.damping_ratio)
    assert metrics.stable


@pytest.mark.parametrize("gain", [0.924, 1.0, 1.05])
def test_steady_state_error_is_demanded_minus_reached(gain: float) -> None:
    """0.924 is where the report's velocity law settles. Shape measures are
    relative to the value reached and do not see it. 1e-6: what rings on after 6 s."""
    metrics, unit = step_metrics(stepped(0.5, 3.0, gain)), step_metrics(stepped(0.5, 3.0))
    assert metrics.steady_state_error == pytest.approx(1 - gain, abs=1e-6)
    assert metrics.overshoot == pytest.approx(unit.overshoot, abs=1e-6)
    assert (metrics.rise_time, metrics.settling_time) == (unit.rise_time, unit.settling_time)


@pytest.mark.parametrize(("zeta", "hertz"), [(0.2, 1.6), (0.4, 2.5), (0.7, 4.0)])
def test_rise_and_settling_times_are_those_of_the_formula(zeta: float, hertz: float) -> None:
    """Crossings of the textbook response; two samples, since each end is rounded up to one."""
    metrics = step_metrics(stepped(zeta, hertz, every=2))
    peak = 0.5 / hertz / np.sqrt(1 - zeta**2)
    ten, ninety = (
        optimize.brentq(lambda t, level=level: unit_step(t, zeta, hertz) - level, 0.0, peak)
        for level in (0.1, 0.9)
    )
    assert metrics.rise_time == pytest.approx(ninety - ten, abs=2 / 1024)
    fine = np.linspace(0.0, 6.0, 600001)
    outside = np.flatnonzero(np.abs(unit_step(fine, zeta, hertz) - 1.0) > 0.02)
    assert metrics.settling_time == pytest.approx(fine[outside[-1]], abs=2 / 1024)


def test_a_sparser_record_gives_the_same_measures() -> None:
    """One frame in eight: times to 1/256 s, peak to (pi 2.5 Hz / 256)^2 / 2 of the ringing."""
    command = signals.step("heave", STEP, at=1.0, duration=8.0)
    feedback = answer(command, second_order(0.4, 2.5))
    full = step_metrics(record_of(command, feedback))
    sparse = step_metrics(record_of(command, feedback, every=8))
    assert sparse.overshoot == pytest.approx(full.overshoot, abs=1e-3)
    assert sparse.rise_time == pytest.approx(full.rise_time, abs=2 / 256)
    assert sparse.settling_time == pytest.approx(full.settling_time, abs=2 / 256)
    assert sparse.steady_state_error == pytest.approx(full.steady_state_error, abs=1e-6)
    assert sparse.stable


def test_a_standing_offset_before_the_step_does_not_count() -> None:
    """Measures start from the rest before the step, wherever that is. 1e-9: Newton's tolerance."""
    command = signals.step("heave", STEP, at=1.0, duration=8.0)
    feedback = answer(command, second_order(0.4, 2.5))
    plain = step_metrics(record_of(command, feedback, 8))
    offset = np.zeros(6)
    offset[DOFS.index("heave")] = 0.003
    moved = step_metrics(record_of(command, feedback + offset, 8))
    np.testing.assert_allclose(moved[:5], plain[:5], rtol=0, atol=1e-9)


# -- the verdict ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("zeta", "hertz", "stable"),
    [
        (0.4, 2.5, True),  # settled
        (0.006, 3.0, True),  # still rings at the end, but is less by exp(-0.34) = 0.71 in 3 s
        (0.0, 4.0, False),  # rings on
        (0.004, 3.0, False),  # exp(-0.23) = 0.80 in 3 s: too slow
        (-0.002, 4.0, False),  # grows
        (-0.02, 4.0, False),
    ],
)
def test_verdict_on_a_ringing_leg(zeta: float, hertz: float, stable: bool) -> None:
    """Documented: swing of the last second below 2 % of the step, or below 0.75 of that three
    seconds earlier; at 3 Hz the border is a damping ratio of -ln 0.75 / (3 * 2 pi * 3) = 0.0051.
    """
    metrics = step_metrics(stepped(zeta, hertz))
    assert metrics.stable is stable


def ringing(swing: float, leg: int | None = None, decay: float = 0.0) -> Record:
    """A settled step with a ring of 8 Hz of `swing` of the step at the end, on one leg or all,
    decaying at `decay` [1/s]."""
    record = stepped(0.6, 3.0)
    size = np.abs(record["leg_reference"][-1]).max()
    legs = record["leg_position"].copy()
    wave = 0.5 * swing * size * np.sin(2 * np.pi * 8.0 * record.time)
    wave *= np.exp(decay * (record.time[-1] - record.time))
    chosen = slice(None) if leg is None else slice(leg, leg + 1)
    legs[:, chosen] += wave[:, None]
    channels = {**record.channels, "leg_position": legs}
    return Record(record.time.copy(), channels, record.units, record.metadata)


@pytest.mark.parametrize(("leg", "swing"), [(None, 0.05), (0, 0.05), (5, 0.025), (None, 0.015)])
def test_residual_is_the_largest_leg_swing_over_the_largest_leg_step(
    leg: int | None, swing: float
) -> None:
    """A ring of so much of the leg step, on all legs or on one; below 2 % it has settled. 1e-3:
    the ring's sampled peaks and what the step leaves."""
    metrics = step_metrics(ringing(swing, leg))
    assert metrics.residual == pytest.approx(swing, abs=1e-3)
    assert metrics.stable == (swing < 0.02)


def test_a_decaying_ring_of_one_leg_is_ending() -> None:
    """Windows are compared by the leg that swings most, whatever the others do: exp(-0.6)."""
    metrics = step_metrics(ringing(0.05, leg=3, decay=0.2))
    assert metrics.residual > 0.04
    assert metrics.stable


def test_a_ring_that_no_platform_motion_has_is_seen() -> None:
    """The verdict is on the legs: a ring in surge spoils the verdict of a heave step, whose own
    measures stay clean."""
    command = signals.step("heave", STEP, at=1.0, duration=8.0)
    feedback = answer(command, second_order(0.5, 3.0))
    clean = step_metrics(record_of(command, feedback, 8))
    time = np.arange(command.pose.shape[0]) / RATE
    feedback[:, DOFS.index("surge")] += 0.005 * np.sin(2 * np.pi * 5.0 * time)
    metrics = step_metrics(record_of(command, feedback, 8))
    assert clean.stable
    assert not metrics.stable
    assert metrics.overshoot == pytest.approx(clean.overshoot, abs=1e-9)


def test_legs_that_no_pose_has_make_an_unstable_run_without_measures() -> None:
    """Legs pressed 49 mm into their stops, four in and two out, reach no common platform."""
    record = stepped(0.5, 3.0)
    legs = record["leg_position"].copy()
    legs[-100:] = [-1.014, -1.014, 1.014, -1.014, -1.014, 1.014]
    channels = {**record.channels, "leg_position": legs}
    broken = Record(record.time.copy(), channels, record.units, record.metadata)
    metrics = step_metrics(broken)
    assert not metrics.stable
    assert np.isnan(metrics[:5]).all()
    assert metrics.residual > 1.0


@pytest.mark.parametrize(
    ("gain", "stable"), [(1.9, True), (2.1, False), (0.1, True), (-0.1, False)]
)
def test_a_leg_farther_from_its_demand_than_one_that_stands_still_is_not_stable(
    gain: float, stable: bool
) -> None:
    """At rest |gain - 1| of the step is left: more than 1 above 2 and below 0."""
    metrics = step_metrics(stepped(0.5, 3.0, gain))
    assert metrics.residual < 1e-3
    assert metrics.stable == stable


def test_a_limit_cycle_is_seen_in_the_shortest_record_accepted() -> None:
    """The transient of the step itself must not pass for a ring that has decayed: a leg that goes
    on swinging by 20 % of the step is unstable in any record long enough to be measured."""
    for seconds in np.arange(2.0, 8.0, 0.25):
        command = signals.step("heave", STEP, at=1.0, duration=1.0 + float(seconds))
        feedback = answer(command, second_order(0.6, 3.0))
        time = np.arange(command.pose.shape[0]) / RATE
        feedback[:, DOFS.index("heave")] += 0.1 * STEP * np.sin(2 * np.pi * 5.0 * time)
        try:
            metrics = step_metrics(record_of(command, feedback, 8))
        except ValueError as refusal:
            assert "after the step" in str(refusal)
            continue
        assert not metrics.stable, f"{seconds} s after the step"
        return
    raise AssertionError("no record of up to 8 s was accepted")


# -- refused records --------------------------------------------------------------------------


def test_a_record_of_another_command_is_refused() -> None:
    command = signals.sine("heave", 0.01, 1.0, cycles=4)
    with pytest.raises(ValueError, match="its command is a sine; a step is needed"):
        step_metrics(record_of(command, command.pose))


@pytest.mark.parametrize("dof", ["surge", "yaw"])
def test_a_degree_of_freedom_without_a_step_is_refused(dof: str) -> None:
    """Six legs in heave make no surge; the message names both."""
    with pytest.raises(ValueError, match=f"holds no step in {dof}; it moved heave"):
        step_metrics(stepped(0.5, 3.0), dof)
