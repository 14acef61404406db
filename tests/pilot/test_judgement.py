"""Measures in closed form, and the search over the washouts of each family."""

import numpy as np
import pytest
from cab_motions import pushed

from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.perception import CueingError
from cmf_mj.pilot.washout_settings import load_washout
from scripts.flights import with_gains
from scripts.judgement import (
    FREE,
    _stretches,
    changed,
    cost,
    judge,
    search,
)


def felt(cued, aircraft, simulator):
    """The same cue with other forces sensed along y, in thresholds."""
    error, sizes = cued.error, np.zeros((2, cued.aircraft.time.size, 3))
    sizes[0, :, 1], sizes[1, :, 1] = aircraft, simulator
    sizes *= error.threshold[:3]
    pair = [
        motion._replace(specific_force=values)
        for motion, values in zip((error.aircraft, error.simulator), sizes, strict=True)
    ]
    return cued._replace(error=CueingError(*pair, error.error, error.threshold))


def test_false_cues_are_counted_by_hand():
    """Against the aircraft, beyond nothing, and short; half a cue is none."""
    cued = cue(pushed(1, np.zeros(800)))
    aircraft, simulator = np.zeros(800), np.zeros(800)
    aircraft[100:200], simulator[100:200] = 3.0, 2.0  # right way
    aircraft[300:400], simulator[300:400] = 3.0, -2.0  # against: 1.25 s, size 2
    simulator[500:504] = 1.5  # 0.05 s
    simulator[600:608], simulator[610:640] = 1.2, 1.4  # two, 0.025 s apart
    simulator[700:750] = 0.9  # not noticed
    found = judge(felt(cued, aircraft, simulator))
    assert found.false_cues == 4
    assert found.lasting == 2
    square = 100 * 4.0 + 4 * 2.25 + 8 * 1.44 + 30 * 1.96
    assert found.false_rms == pytest.approx(np.sqrt(square / 800))
    power = 200 * 9.0
    assert found.force_scale == pytest.approx((100 * 6.0 - 100 * 6.0) / power)


def test_stretches_close_gaps():
    row = np.array([0, 1, 1, 0, 1, 0, 0, 0, 1, 1], dtype=bool)
    assert _stretches(row).tolist() == [[1, 3], [4, 5], [8, 10]]
    assert _stretches(row, 2).tolist() == [[1, 5], [8, 10]]
    assert _stretches(np.zeros(5, dtype=bool)).tolist() == []


def test_a_simulator_that_does_nothing_misses_all():
    """Gains of 0: the error is the aircraft's force, its scale and shape are 0."""
    flown = pushed(1, np.sin(np.arange(1600) / 80.0))
    cued = cue(flown, with_gains(load_washout("simona"), np.zeros(6)))
    found = judge(cued)
    aircraft = cued.error.aircraft.specific_force
    size = np.sqrt(np.mean(np.sum((aircraft - [0.0, 0.0, aircraft[0, 2]]) ** 2, axis=1)))
    assert found.force_error == pytest.approx(size, rel=1e-9)
    assert (found.force_shape, found.force_scale, found.workspace, found.false_cues) == (0, 0, 0, 0)
    mean = np.abs(np.sin(np.arange(1600) / 80.0)).mean()
    assert found.mismatch == pytest.approx(0.66 * mean)


@pytest.mark.parametrize("name", ["simona", "optimal", "predictive"])
def test_factors_change_what_is_tuned_and_say_so(name):
    base = load_washout(name)
    entries = FREE[base.kind]
    twice = changed(base, np.full(len(entries), 2.0), "a test")
    for table, key in (pair for pairs in entries for pair in pairs):
        old, new = getattr(getattr(base, table), key), getattr(getattr(twice, table), key)
        assert new.value == pytest.approx(2.0 * old.value, rel=1e-3)
        assert (new.status, new.source) == ("derived", "a test")


def test_cost_is_the_error_over_its_thresholds_and_more_beyond_the_workspace():
    cued = cue(pushed(1, np.sin(np.arange(800) / 80.0)))
    plain = np.sqrt(np.mean(np.sum((cued.error.error / cued.error.threshold) ** 2, axis=1)))
    assert cost([cued]) == pytest.approx(plain)
    half = 0.5 * judge(cued).workspace
    assert cost([cued], half) == pytest.approx(6.0 * plain)


def test_a_search_finds_what_is_better_and_repeats():
    found = [search(load_washout("simona"), ("lane_change",), evaluations=21) for _ in range(2)]
    assert found[0] == found[1]
    assert found[0].cost < found[0].start and found[0].tried == 21
    flown = [cue(load_flight("lane_change").motion, found[0].settings, rate=40.0)]
    assert cost(flown) == pytest.approx(found[0].cost)
    with pytest.raises(ValueError, match="evaluations: 0"):
        search(load_washout("simona"), evaluations=0)
