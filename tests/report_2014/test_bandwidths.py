"""The plants against the report's result tables, measured as the report measures."""

import numpy as np
import pytest
from shared import chirp_bandwidths

from cmf_mj import Hexapod, signals, simulate
from cmf_mj.analysis.measures import measure_loop
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.models import CABS
from cmf_mj.show.comparison import AGREEMENT
from cmf_mj.studies.case import make_case, small_motion_loop


@pytest.mark.slow
@pytest.mark.parametrize("cab", CABS)
@pytest.mark.parametrize("dof", DOFS)
def test_velocity_law_is_stable_as_flown(cab: str, dof: str) -> None:
    """The facility flew the velocity law in six degrees of freedom with its three cabs."""
    size = 0.0254 if DOFS.index(dof) < 3 else np.radians(0.6)
    for sign in (1.0, -1.0):
        record = simulate(Hexapod(cab), "velocity", signals.step(dof, sign * size), record_every=8)
        metrics = step_metrics(record)
        assert metrics.stable
        assert metrics.residual < 0.01
        assert record["gimbal_error"].max() < 10e-6


@pytest.mark.slow
@pytest.mark.parametrize("law", ["original", "velocity", "position_error_rate", "acceleration"])
def test_heave_of_hexapod_and_single_legs_agree_at_29920_lbm(law: str) -> None:
    """The GFD's payload is the one whose heave effective mass is 7200 lbm: within 5 %."""
    hexapod = chirp_bandwidths("hexapod", law, "heave")
    single = chirp_bandwidths("single_legs", law, "heave")
    assert hexapod.phase_hz == pytest.approx(single.phase_hz, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("dof", ["surge", "sway"])
def test_surge_and_sway_of_the_hexapod_do_not_follow_the_single_legs(dof: str) -> None:
    """The reflected mass of the pair at 4.8 Hz: less phase bandwidth and a far higher peak."""
    for law, peak in (("velocity", 5.0), ("position_error_rate", 5.0)):
        hexapod = chirp_bandwidths("hexapod", law, dof)
        single = chirp_bandwidths("single_legs", law, dof)
        assert hexapod.phase_hz < 0.95 * single.phase_hz
        assert hexapod.peak_db > single.peak_db + peak


def agree(law: str, dof: str, cab: str = "gfd") -> None:
    """Chirp at a fiftieth of the report's amplitude and linearised machine: 0.1 Hz in -90 deg."""
    small = measure_loop(small_motion_loop(make_case(law, dof, cab=cab)))
    swept = chirp_bandwidths("hexapod", law, dof, cab, share=0.02)
    assert small.stable
    assert swept.phase_hz == pytest.approx(small.phase_bandwidth_hz, abs=AGREEMENT)
    assert np.isnan(swept.later_phase_hz) and np.isnan(small.later_phase_hz)


def test_linear_and_chirp_agree_where_the_phase_grazes() -> None:
    """Roll under position error rate feedback, whose pair has a damping ratio of 0.003: the phase
    falls through -90 deg at the pair, comes back to it and falls again. At 0.2 deg the pair is
    damped so much that the phase only grazes there, and crosses 0.2 Hz later."""
    agree("position_error_rate", "roll")
    small = measure_loop(small_motion_loop(make_case("position_error_rate", "roll")))
    large = chirp_bandwidths("hexapod", "position_error_rate", "roll")
    assert large.phase_hz - small.phase_bandwidth_hz > 2.0 * AGREEMENT
    for one in (small, large):
        assert one.graze_from_hz < small.phase_bandwidth_hz
        assert one.graze_to_hz > large.phase_hz


@pytest.mark.slow
@pytest.mark.parametrize("law", ["velocity", "position_error_rate", "acceleration_compensated"])
@pytest.mark.parametrize("dof", DOFS)
def test_linear_and_chirp_agree_in_small_motion(law: str, dof: str) -> None:
    agree(law, dof)


@pytest.mark.slow
@pytest.mark.parametrize("cab", ["rfd", "ifd"])
@pytest.mark.parametrize("dof", ["surge", "pitch"])
def test_so_they_do_with_the_heavier_cabs(cab: str, dof: str) -> None:
    agree("velocity_integral", dof, cab)


@pytest.mark.slow
@pytest.mark.parametrize("dof", ["heave", "surge", "roll"])
def test_halving_the_step_moves_no_bandwidth_by_more_than_1_percent(dof: str) -> None:
    coarse = chirp_bandwidths("hexapod", "velocity", dof)
    fine = chirp_bandwidths("hexapod", "velocity", dof, cuts=2)
    assert coarse.phase_hz == pytest.approx(fine.phase_hz, rel=0.01)
    assert coarse.gain_hz == pytest.approx(fine.gain_hz, rel=0.01)
