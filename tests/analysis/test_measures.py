"""What a law achieves: records of a known loop beside the loop itself, and cross-talk."""

import control
import numpy as np
import pytest
from followed_commands import answer, record_of, second_order

from cmf_mj import frequency_response, signals
from cmf_mj.analysis.frequency_response import crosstalk
from cmf_mj.analysis.linear.poles import least_damped_mode
from cmf_mj.analysis.measures import Measures, measure_loop, measure_records
from cmf_mj.core.units import FRAME


def test_records_and_loop_agree_in_every_measure() -> None:
    """A second-order loop with a static gain of 0.9: the sweep, the step and the poles."""
    damping = 0.4
    system = second_order(damping, 2.0, 0.9)
    loop = control.sample_system(control.ss(system), FRAME, method="zoh")
    sweep, step = (
        record_of(command, answer(command, system), 8)
        for command in (signals.chirp("heave", 0.01), signals.step("heave", 0.0254))
    )
    measured, computed = measure_records(sweep, step), measure_loop(loop)
    assert measured.stable and computed.stable
    for name in ("phase_bandwidth_hz", "gain_bandwidth_hz", "overshoot", "damping_ratio"):
        assert getattr(measured, name) == pytest.approx(getattr(computed, name), rel=0.01), name
    assert measured.peak_gain_db == pytest.approx(computed.peak_gain_db, abs=0.05)
    assert measured.static_gain == pytest.approx(0.9, abs=1e-4)
    assert computed.static_gain == pytest.approx(0.9)
    assert np.isnan(measured.mode_damping_ratio)
    assert computed.mode_damping_ratio == pytest.approx(damping)
    assert least_damped_mode(loop.poles()) == pytest.approx((damping, 2.0))


def test_a_step_that_rings_on_leaves_the_verdict_alone() -> None:
    """The same feedback with a swing of 3 Hz under it, a fifth of the step and undiminished; and a
    loop whose pair grows."""
    records = []
    for command in (signals.chirp("heave", 0.01), signals.step("heave", 0.0254)):
        time = np.arange(command.pose.shape[0])[:, None] * FRAME
        swing = 0.005 * np.sin(6.0 * np.pi * time) * (np.arange(6) == 2)
        records.append(record_of(command, command.pose + swing, 8))
    measured = measure_records(*records)
    assert frequency_response(records[0]).gain_db.max() > 0.0  # there is something to read
    growing = control.ss(control.tf([160.0], [1.0, -0.5, 160.0]))
    computed = measure_loop(control.sample_system(growing, FRAME, method="zoh"))
    assert computed.mode_damping_ratio == pytest.approx(-0.25 / np.sqrt(160.0))
    for measures in (
        measured,
        computed._replace(mode_damping_ratio=np.nan, mode_frequency_hz=np.nan),
    ):
        assert not measures.stable
        assert np.isnan([value for value in measures if value is not False]).all()


def test_measures_of_nothing_are_nan() -> None:
    nothing = Measures()
    assert not nothing.stable
    assert np.isnan([nothing.overshoot, nothing.static_gain, nothing.peak_damping_ratio]).all()


def test_crosstalk_counts_in_units_of_each_axis() -> None:
    """0.2 from the second to the first axis is 0.1 where the first counts twice as much."""
    response = np.array([[[1.0, 1.0], [0.1, 0.2]], [[np.nan, 0.4], [1.0, 1.0]]])
    gains = crosstalk(response.astype(complex), [2.0, 1.0])
    assert gains[0, 1] == pytest.approx(0.1)
    assert gains[1, 0] == pytest.approx(0.8)
    assert np.isnan(np.diag(gains)).all()
