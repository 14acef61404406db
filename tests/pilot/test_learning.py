"""A demand that is learnt: closed forms, limits, bits, refusals, other machines."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from shared import cmf

from cmf_mj import Hexapod, load_cab, load_hydraulics, load_law, signals
from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import HostStream, from_command, read_stream
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.learning import (
    SLOWEST,
    Learner,
    Learning,
    draw_machine,
    filter_frequencies,
    filtered,
    learn,
    make_learner,
    measure_errors,
    rms,
)

ROWS, RATE, SHARE = 1600, 80.0, 0.5
POLE = np.exp(-2.0 * np.pi * 2.0 / RATE)  #: Of a first-order lag of 2 Hz at 80 Hz.


def lag(demand: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(signal.lfilter([1.0 - POLE], [1.0, -POLE], demand, axis=0))


@pytest.fixture(scope="module")
def scalar() -> Learner:
    """A learner that knows the lag exactly."""
    lines = filter_frequencies(ROWS)
    response = (1.0 - POLE) / (1.0 - POLE * np.exp(-2j * np.pi * lines / RATE))
    return make_learner([response[:, None, None]], lines, SHARE)


def spectrum(history: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.asarray(np.fft.rfft(history[:, 0]))


def test_each_trial_leaves_what_the_closed_form_says(scalar: Learner) -> None:
    time = np.arange(ROWS) / RATE - 10.0
    asked = (np.exp(-((time / 0.08) ** 2)) * np.cos(2.0 * np.pi * 2.5 * time))[:, None]
    lines = np.fft.rfftfreq(ROWS, 1.0 / RATE)
    smoothing = 1.0 / (1.0 + (lines / 6.0) ** 8)
    kept = smoothing * (1.0 - SHARE)
    correction, first = np.zeros((ROWS, 1)), spectrum(asked - lag(asked))
    band = (lines > 0.2) & (lines < 8.0)
    for trial in range(9):
        error = asked - lag(asked + correction)
        left = 1.0 - SHARE * smoothing * (1.0 - kept**trial) / (1.0 - kept)
        assert np.allclose(
            np.abs(spectrum(error) / first)[band], left[band], atol=5e-4
        )  # Q is cut at 10 Hz
        correction = scalar.improved(correction, error)


def test_the_ratio_of_two_trials_is_the_singular_value(scalar: Learner) -> None:
    smoothing = scalar.smoothing[:, 0, 0].real
    assert np.allclose(scalar.ratio()[0], smoothing * (1.0 - SHARE), rtol=1e-12)


def test_noise_is_learnt_as_far_as_the_closed_form_says(scalar: Learner) -> None:
    generator, lines = np.random.default_rng(3), np.fft.rfftfreq(ROWS, 1.0 / RATE)
    band = (lines > 1.0) & (lines < 7.0)
    correction, density = np.zeros((ROWS, 1)), []
    for trial in range(260):
        if trial >= 10:
            density.append(np.abs(spectrum(lag(correction))[band]) ** 2)
        noise = generator.normal(size=(ROWS, 1))
        correction = scalar.improved(correction, -lag(correction) - noise)
    smoothing = 1.0 / (1.0 + (lines[band] / 6.0) ** 8)
    kept = smoothing * (1.0 - SHARE)
    floor = ROWS * (SHARE * smoothing) ** 2 / (1.0 - kept**2)
    assert np.mean(density) == pytest.approx(np.mean(floor), rel=0.03)


def test_the_filter_is_least_squares_and_no_machine_diverges() -> None:
    lines = np.array([1.0])
    gains = [np.full((1, 1, 1), gain + 0.0j) for gain in (1.0, 3.0, -1.0, 2.8)]
    two = make_learner(gains[:2], lines, 0.6)
    assert two.learning.item() == pytest.approx(0.6 * 2.0 / 5.0)  # mean over mean square
    opposed = make_learner([gains[0], gains[2]], lines, 0.6)
    assert opposed.learning.item() == 0.0
    wild = make_learner([gains[2], gains[3], gains[3]], lines, 1.0)  # learning any part diverges
    assert wild.learning.item() == 0.0 and wild.ratio().max() == pytest.approx(SLOWEST)


def test_ends_in_motion_pass_a_filter_of_one() -> None:
    ramp = np.linspace(0.0, 1.0, ROWS)[:, None] * np.ones(2)
    unit = np.broadcast_to(np.eye(2) + 0j, (len(filter_frequencies(ROWS)), 2, 2))
    assert np.abs(filtered(unit, ramp) - ramp)[40:-40].max() < 2e-3


def wave(size: float, frequency: float = 0.6, cycles: float = 3.0) -> HostStream:
    return from_command(signals.sine("heave", size, frequency=frequency, cycles=cycles), 80.0)


@pytest.fixture(scope="module")
def learnt() -> Learning:
    return learn(wave(0.05), "velocity", [Hexapod("gfd")], trials=3, seed=5)


def test_the_simulated_machine_learns_as_the_linear_one(learnt: Learning) -> None:
    """One trial leaves 40 % and each the same share, but for noise."""
    first = learnt.trials[0]
    for one in learnt.trials[1:]:
        assert one.legs / first.legs == pytest.approx(one.predicted / first.predicted, abs=0.02)
    assert learnt.trials[3].legs < 0.1 * first.legs and learnt.best == 3
    assert first.pose[2] > 10.0 * np.delete(first.pose, 2).max()


def test_the_same_seed_gives_the_same_bits(learnt: Learning) -> None:
    again, other = (
        learn(wave(0.05), "velocity", [Hexapod("gfd")], trials=1, seed=seed) for seed in (5, 6)
    )
    assert again.trials[1].legs == learnt.trials[1].legs
    assert other.trials[1].legs != learnt.trials[1].legs


def test_limits_hold_the_demand_back_and_the_best_trial_stays() -> None:
    """A heave that uses the limits leaves no room for the demand that would lead it."""
    limits = load_motion_limits()
    high = limits.operational[2, 1]
    done = learn(wave(0.999 * high, 0.2, 1.0), "velocity", [Hexapod("gfd")], trials=2)
    legs = pose_to_legs(done.demand.pose)
    speed = np.abs(np.diff(legs, axis=0)).max() * RATE
    assert done.trials[1].held_frames > 0
    assert np.abs(legs).max() <= limits.leg.position.si
    assert speed <= limits.leg.velocity.si * (1.0 + 1e-9)
    assert done.demand.pose[:, 2].max() <= high * (1.0 + 1e-9)
    assert done.trials[done.best].sensed == min(one.sensed for one in done.trials)


def test_a_run_that_a_fault_ends_is_refused() -> None:
    """Three of these waves empty the accumulators."""
    with pytest.raises(InputError, match=r"law: velocity ends a run: under_pressure at \d+"):
        learn(wave(1.04, 0.15), "velocity", [Hexapod("gfd")], trials=1)


def test_a_motion_of_less_than_a_period_of_what_counts_is_refused() -> None:
    """Two rows of a flight had an error of 40 % left."""
    with pytest.raises(InputError, match=r"stream: lasts 0\.025 s; allowed: at least 0\.25 s"):
        learn(HostStream(*(part[:3] for part in wave(0.05))), "velocity", [Hexapod("gfd")])


def test_other_machines_differ_and_come_again() -> None:
    cab, hydraulics = load_cab("gfd"), load_hydraulics("hardware")
    one, again, other = (draw_machine(cab, hydraulics, 0, draw) for draw in (1, 1, 2))
    assert one.parameters == again.parameters and one.cab_parameters == again.cab_parameters
    assert one.parameters != other.parameters
    drawn = other.cab_parameters
    assert drawn is not None and drawn.assumed == cab
    assert 0.9 < drawn.mass.si / cab.mass.si < 1.1


@pytest.mark.slow
def test_a_flight_is_learnt_to_a_tenth_and_helps_twelve_other_machines() -> None:
    """Eight trials leave a tenth, sixteen the same; no drawn machine is worse off with it."""
    cab, hydraulics = load_cab("gfd"), load_hydraulics("hardware")
    machine = partial(draw_machine, cab, hydraulics, 0)
    plants = [Hexapod(cab, hydraulics), *map(machine, range(6))]
    asked = cue(load_flight("gusts").motion).stream
    done = learn(asked, "velocity", plants, trials=16)
    law, demands = load_law("velocity"), (done.reference, done.demand)
    left = np.array([one.legs for one in done.trials]) / done.trials[0].legs
    assert left[8] < 0.1
    assert left[8:].max() - left[8] < 5e-4
    assert done.learner.ratio().max() < SLOWEST + 1e-9
    for plant in map(machine, range(6, 18)):
        flown = (measure_errors(done.reference, sent, law, plant, 99) for sent in demands)
        plain, learnt = (rms(one.legs) for one in flown)
        assert learnt < plain


@pytest.mark.slow
def test_cmf_learn_writes_a_demand_that_cmf_operate_replays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    cmf("learn", "gusts", "--trials", "1", "--out", out)
    assert {path.name for path in out.iterdir()} == {"demand.csv", "trials.csv", "learning.png"}
    assert read_stream(out / "demand.csv").time[-1] == pytest.approx(36.0, abs=0.1)
    assert "no fault" in cmf("operate", out / "demand.csv", "--out", tmp_path / "again")
