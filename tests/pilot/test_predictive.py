"""The predictive washout: linear-quadratic limits, a dense solution, limits kept, plans bridged."""

import numpy as np
import pytest
from cab_motions import G, level, pushed, sustained, turn_entry
from scipy.optimize import nnls

from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.machine import load_machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import cue, excursion, within_limits
from cmf_mj.pilot.drives import drive
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import load_washout
from scripts.judgement import judge

SETTINGS = load_washout("predictive")
LIMITS = load_motion_limits()
BOUNDS = ("blower", "bupper")


def changed(mode=(), sizes=1.0, **prediction):
    """The shipped set with some sizes multiplied and entries of the horizon changed."""
    tables = SETTINGS.model_dump()
    for table, key in mode:
        tables[table][key]["value"] *= sizes
    for key, value in prediction.items():
        if isinstance(tables["prediction"][key], dict):
            tables["prediction"][key]["value"] = value
        else:
            tables["prediction"][key] = value
    return type(SETTINGS)(**tables)


def test_one_axis_is_the_dense_solution_of_the_same_programme():
    """Least distance by Lawson and Hanson's NNLS: z = -f + A^T y, y >= 0 of active rows."""
    washout = Washout(changed(false_price=0.0))
    own, seen = washout.predictive, []
    solve = own.solver.solve

    def solving(programme):
        z, count = solve(programme)
        seen.append((programme, z))
        return z, count

    own.solver.solve = solving
    washout.run(pushed(2, sustained(12.0, seconds=2.0, at=0.2)))
    active = 0
    for programme, z in seen[::7]:
        f = programme["f"]
        a, low, high = (programme[key][: -len(own.times) * 3 + 3] for key in ("A", *BOUNDS))
        rows = np.vstack([a, -a])
        bound = np.concatenate([low, -high])
        # With z = y - f: min |y|^2 subject to rows y >= bound + rows f.
        least = bound + rows @ f
        stacked = np.vstack([rows.T, least])
        target = np.zeros(len(stacked))
        target[-1] = 1.0
        y, _ = nnls(stacked, target, maxiter=20000)
        left = stacked @ y - target
        dense = -left[:-1] / left[-1] - f
        np.testing.assert_allclose(z, dense, atol=1e-8 * max(1.0, np.abs(z).max()))
        active += int((y > 0.0).any())
    assert active > 3


@pytest.mark.parametrize(("axis", "most"), [(0, 0.05), (1, 0.05), (2, 0.15)])
def test_with_travel_for_nothing_it_follows_a_known_aircraft(axis, most):
    """A push forth and back within all limits: the head feels what the aircraft's pilot does."""
    free = [
        (mode, key)
        for mode in ("pitch_surge", "roll_sway", "heave")
        for key in ("position", "position_integral", "velocity", "acceleration")
    ]
    time = np.arange(320) / 80.0
    history = 0.5 * np.where(time < 2.0, np.sin(np.pi * time), 0.0)
    missed = []
    for settings in (SETTINGS, changed(free, 300.0, reference="known")):
        washout = Washout(settings)
        motion = PilotMotion.from_platform(washout.run(pushed(axis, history)), washout.station)
        felt = motion.specific_force[:, axis] + G * (axis == 2)
        error = felt - settings.gains[axis] * history
        missed.append(np.sqrt(np.mean(error**2) / np.mean((settings.gains[axis] * history) ** 2)))
    assert missed[1] < most < missed[0]


def test_without_senses_it_stays_where_it_is():
    errors = [
        *(
            (mode, key)
            for mode in ("pitch_surge", "roll_sway")
            for key in ("force_error", "rate_error")
        ),
        *(("heave", "force_error"), ("yaw", "rate_error")),
    ]
    stream = Washout(changed(errors, 1e4)).run(pushed(0, sustained(2.0, seconds=5.0)))
    assert np.abs(stream.pose).max() < 1e-6


def test_tilt_keeps_its_rate_where_the_aircraft_does_not_turn():
    stream = Washout(SETTINGS).run(pushed(0, sustained(3.0, seconds=10.0)))
    assert np.degrees(np.abs(stream.velocity[:, 4]).max()) == pytest.approx(3.0, rel=1e-3)
    assert np.abs(stream.pose[-1, 4]) > np.radians(5.0)


@pytest.mark.parametrize("machine", ["cmf", "simona", "lab"])
def test_ten_times_what_the_machine_can_do_touches_no_limit(machine):
    """Random pulses of force and rate, by each machine's legs."""
    draw = np.random.default_rng(11)
    flown = level(12.0)
    steps = np.repeat(draw.normal(size=(24, 6)), 40, axis=0)
    force = flown.specific_force + 30.0 * steps[:, :3]
    flown = PilotMotion(flown.time, force, 2.0 * steps[:, 3:], flown.attitude)
    base = load_machine(machine)
    washout = Washout(SETTINGS, cab=load_cab(None, base))
    stream = washout.run(flown)
    assert np.isfinite(stream.pose).all()
    assert 0.9 < excursion(stream, None, base).largest <= 1.0
    assert not within_limits(stream, None, base)[1].any()  # nor between two frames
    assert not any(washout.predictive.solves.bridged)


def test_a_plan_goes_on_when_the_solver_does_not_end_and_then_fades_to_a_washout():
    washout = Washout(SETTINGS)
    own = washout.predictive
    for _ in range(80):
        washout.frame([2.0, 0.0, -G], np.zeros(3))
    own.solver.solve = lambda programme: (None, 0)
    frames = [washout.frame([0.0, 0.0, -G], np.zeros(3)) for _ in range(4000)]
    pose, speed = (
        np.array([getattr(frame, name) for frame in frames]) for name in ("pose", "velocity")
    )
    assert np.isfinite(pose).all()
    change = np.diff(speed[:, :3], axis=0) * 80.0
    assert np.abs(change).max() < 4.0
    # The slowest pole of the shipped sizes, 0.03 rad/s, is left after 50 s.
    assert (np.abs(pose[-1, [0, 4]]) < 0.05 * np.abs(pose[:, [0, 4]]).max(axis=0)).all()
    assert np.abs(pose[:, 0]).max() > 0.3
    assert sum(own.solves.bridged) == 4000


def test_what_is_known_ahead_is_felt_in_time():
    """What lasts suits `constant`, what swings suits a guess that fades, and known beats both."""
    time = np.arange(1200) / 80.0 - 4.0
    lasting = np.clip(2.0 * time, 0.0, 2.5)
    swinging = 2.5 * np.sin(np.pi * time) * ((time > 0.0) & (time < 6.0))
    missed = np.array(
        [
            [
                cue(pushed(0, history), changed(reference=name)).error.rms[0]
                for name in ("constant", "guess", "known")
            ]
            for history in (lasting, swinging)
        ]
    )
    assert missed[0, 0] < missed[0, 1] and missed[1, 1] < missed[1, 0]
    assert (missed[:, 2] < 0.8 * missed[:, :2].min(axis=1)).all()


def test_a_live_frame_is_that_of_the_whole_flight_to_the_bit():
    flown = turn_entry()
    whole, live = Washout(SETTINGS).run(flown), Washout(SETTINGS)
    live.solving = 0.0  # a busy machine may not bridge a frame
    for row in range(0, 600):
        frame = live.frame(flown.specific_force[row], flown.angular_rate[row])
        np.testing.assert_array_equal(frame.pose, whole.pose[row])


def test_a_live_solver_ends_with_its_share_of_the_frame_and_the_operator_sees_each_frame():
    """No time at all: every frame is bridged, at rest since the last plan rests."""
    washout = Washout(SETTINGS)
    washout.solving = 1e-9
    for _ in range(40):
        frame = washout.frame([8.0, 0.0, -G], [0.0, 0.5, 0.0])
    solves = washout.predictive.solves
    assert sum(solves.bridged) > 0
    said = washout.plans
    assert f"{sum(solves.bridged)} of 39 bridged by the last plan, first at " in said
    assert np.isfinite(frame.pose).all()
    assert Washout("simona").plans is None


def test_the_first_frame_takes_no_longer_than_the_others():
    """What it compiles and allocates is done when the washout is made."""
    firsts, others = [], []
    for _ in range(5):
        washout = Washout(SETTINGS)
        for _ in range(60):
            washout.frame([0.5, 0.0, -G], np.zeros(3))
        firsts.append(washout.predictive.solves.seconds[0])
        others.append(np.median(washout.predictive.solves.seconds))
    assert min(firsts) < 5.0 * min(others)


def test_a_price_on_false_cues_makes_them_fewer():
    """Braking to rest: what is sensed against the car's force, with the price and without."""
    flown = drive("braking")
    judged = [
        judge(cue(flown, changed(false_price=price, reference="known"), rate=40.0))
        for price in (0.0, 100.0)
    ]
    assert judged[1].false_rms < 0.9 * judged[0].false_rms


def test_near_its_limits_no_plan_rings():
    """Second differences of the acceleration, next to what the car's own force has."""
    stream = Washout(SETTINGS).run(drive("braking"))
    rough = np.abs(np.diff(stream.acceleration[:, :3], 2, axis=0)).mean()
    assert excursion(stream).largest > 0.8
    assert rough < 0.02
    assert np.abs(stream.pose[:, [1, 3, 5]]).max() < 1e-3


@pytest.mark.parametrize("frames", [1, 8])
def test_a_known_aircraft_is_led_by_the_delay_of_the_law(frames):
    """A delay of n frames sends what is sent for the flight n frames earlier."""
    time = np.arange(480) / 80.0
    flown = pushed(0, np.clip(time - 2.0, 0.0, 1.0))
    rows = slice(frames, None)
    earlier = PilotMotion(
        flown.time[rows] - flown.time[frames],
        flown.specific_force[rows],
        flown.angular_rate[rows],
        flown.attitude[rows],
    )
    led = Washout(changed(reference="known"), lead=frames / 80.0).run(flown)
    sent = Washout(changed(reference="known")).run(earlier)
    count = len(sent.pose) - 260  # beyond the end of either flight both know nothing
    np.testing.assert_allclose(led.pose[:count], sent.pose[:count], atol=1e-9)


def test_a_guess_leads_by_its_slope_and_constant_cannot():
    """A steady ramp: v + m T (1 - exp(-lead / T)); with `constant` a delay changes nothing."""
    flown = pushed(0, np.clip(np.arange(400) / 80.0 - 1.0, 0.0, None))
    runs = {
        (name, lead): Washout(changed(reference=name), lead=lead)
        for name in ("constant", "guess")
        for lead in (0.0, 0.1)
    }
    poses = {key: washout.run(flown).pose for key, washout in runs.items()}
    np.testing.assert_array_equal(poses["constant", 0.0], poses["constant", 0.1])
    own = SETTINGS.prediction.guess_time.si
    expected = own * (1.0 - np.exp(-0.1 / own))
    ahead = [runs["guess", lead].predictive.forecast.first[3] for lead in (0.1, 0.0)]
    slope = SETTINGS.gains[0] * (1.0 - np.exp(-3.99 / SETTINGS.prediction.guess_lag.si))
    assert ahead[0] - ahead[1] == pytest.approx(expected * slope, rel=0.02)


def test_a_live_aircraft_is_not_known_ahead():
    with pytest.raises(ValueError, match="reference: 'known' needs a flight"):
        Washout(changed(reference="known")).frame([0.0, 0.0, -G], np.zeros(3))
