"""Pulses, noise, shaped and orthogonal multisines, dwells, combinations.

Oracles: Table 2-3 of the report and the record lengths in its Appendix A, Fourier
lines.
"""

import json
import math

import numpy as np
import pytest

from cmf_mj import signals
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.machine.geometry import DOFS
from cmf_mj.signals import composite

INCH = 0.0254
DEGREE = math.pi / 180.0
AMPLITUDE = 0.33 * INCH
SIX = (0.01, 0.008, -0.006, 0.01, 0.02, 0.015)

AT_REST = {
    "pulse": lambda seed=0: signals.pulse("heave", AMPLITUDE, duration=4.0),
    "sine": lambda seed=0: signals.sine("heave", AMPLITUDE, 2.0, fade=0.5),
    "chirp": lambda seed=0: signals.chirp("heave", AMPLITUDE, duration=10.0, fade=0.5),
    "noise": lambda seed=0: signals.noise("heave", AMPLITUDE, duration=10.0, seed=seed),
    "multisine": lambda seed=0: signals.multisine(
        "heave", AMPLITUDE, period=4.0, spectrum="acceleration", corner=0.8, fade=1.0, seed=seed
    ),
    "seven_sines": lambda seed=0: composite.seven_sines("heave", AMPLITUDE, 3),
    "stepped_sines": lambda seed=0: composite.stepped_sines(
        "heave", (1.0, 3.0), (0.5 * AMPLITUDE, AMPLITUDE), cycles=4
    ),
    "orthogonal_multisines": lambda seed=0: composite.orthogonal_multisines(
        SIX, period=8.0, fade=1.0, seed=seed
    ),
}
SEEDED = ("noise", "multisine", "orthogonal_multisines")


def heave(command):
    return command.pose[:, 2]


def lines(history, samples):
    return np.fft.rfft(history[:samples]) * 2.0 / samples


# All of them


@pytest.mark.parametrize("kind", AT_REST)
def test_begins_and_ends_at_the_pose_zero_without_speed(kind):
    """Against the fastest sample; a raised cosine leaves the last frame some 1e-6 of the peak."""
    command = AT_REST[kind]()
    assert not command.pose[0].any()
    largest = np.abs(command.pose).max(axis=0) + 1e-30
    assert (np.abs(command.pose[-1]) < 1e-5 * largest).all()
    speed = np.abs(np.diff(command.pose, axis=0))
    assert (speed[[0, -1]] < 2e-3 * speed.max(axis=0) + 1e-30).all()


@pytest.mark.parametrize("kind", AT_REST)
def test_peak_is_the_amplitude(kind):
    """To the sample, and to what the fades take off the crest of a multisine: none here."""
    result = np.abs(AT_REST[kind]().pose).max(axis=0)
    expected = np.abs(SIX) if kind == "orthogonal_multisines" else [0, 0, AMPLITUDE, 0, 0, 0]
    np.testing.assert_allclose(result, expected, rtol=1.2e-4, atol=0.0)


@pytest.mark.parametrize("kind", (*AT_REST, "step"))
def test_description_is_json_and_repeats_signal_and_command(kind):
    command = AT_REST[kind](seed=3) if kind in AT_REST else signals.step("heave", AMPLITUDE)
    described = json.loads(json.dumps(dict(command.description)))
    signal, again = command.signal, signals.signal_of(described)
    assert type(again) is type(signal)
    assert again.command(3).pose.tobytes() == signal.command(3).pose.tobytes()
    assert (again.axis, again.band, again.lead) == (signal.axis, signal.band, signal.lead)
    assert described.pop("kind") == kind
    described |= {} if command.seed is None else {"seed": command.seed}
    assert np.array_equal(getattr(signals, kind)(**described).pose, command.pose)


def test_description_of_another_kind_keeps_what_it_says():
    other = signals.signal_of({"kind": "chirp", "dof": "heave", "settle": 0.5})
    assert (other.kind, other.axis, other.lead, other.band) == ("chirp", "heave", 0.5, None)
    assert signals.signal_of({"signal": "leg extensions"}).described()["signal"]
    assert signals.signal_of({"kind": "new", "size": 3}).described() == {"kind": "new", "size": 3}
    for wrong in ({"kind": "x", "rate": "fast"}, {"kind": "step", "rate": "fast"}, {"kind": {}}):
        with pytest.raises(InputError, match="command: (rate|kind): .* is refused"):
            signals.signal_of(wrong)
    with pytest.raises(ValueError, match="signal: 'chirp' cannot be made again"):
        other.command()


def test_amplitude_with_a_unit_is_that_in_si():
    one, same = signals.step("roll", (0.5, "deg")), signals.step("roll", 0.5 * DEGREE)
    assert np.array_equal(one.pose, same.pose)
    assert one.description == same.description
    with pytest.raises(ValueError, match="amplitude: unit 'in' is refused for roll; allowed: deg"):
        signals.step("roll", (1.0, "in"))


def test_numbers_of_numpy_become_plain_ones():
    command = signals.sine("heave", np.float64(0.1), np.float32(2.0), cycles=np.int64(4))
    assert {type(command.description[name]) for name in ("amplitude", "cycles")} == {float}


@pytest.mark.parametrize("kind", SEEDED)
def test_seed_alone_decides_the_history(kind):
    one, same, other = (AT_REST[kind](seed=seed) for seed in (1, 1, 2))
    assert one.seed == 1 and np.array_equal(one.pose, same.pose)
    assert np.abs(one.pose - other.pose).max() > 0.1 * np.abs(one.pose).max()


# Pulse


@pytest.mark.parametrize(("at", "width"), [(1.0, 0.5), (0.3, 0.1), (0.25, 2.0 / RATE)])
def test_pulse_goes_there_and_back(at, width):
    command = signals.pulse("heave", -AMPLITUDE, at=at, width=width, duration=2.0)
    assert command.duration == 2.0
    up = np.flatnonzero(heave(command))
    assert (heave(command)[up] == -AMPLITUDE).all()
    assert up[0] == round(at * RATE) and up[-1] - up[0] + 1 == up.size == round(width * RATE)


def test_chirp_fade_leaves_the_middle_alone():
    bare, faded = (signals.chirp("heave", AMPLITUDE, duration=20.0, fade=f) for f in (0.0, 1.0))
    middle = slice(3 * RATE, 21 * RATE)
    assert np.array_equal(heave(bare)[middle], heave(faded)[middle])


# Noise


def test_noise_lies_in_its_band():
    """White: ten bands of 0.7 Hz hold equal power; 700 lines each, 140 of each of five seeds,
    spread it by 1/sqrt(700)."""
    power = 0.0
    for seed in range(5):
        command = signals.noise("heave", AMPLITUDE, start=1.0, stop=8.0, duration=200.0, seed=seed)
        power = power + np.abs(np.fft.rfft(heave(command))) ** 2
    frequency = np.fft.rfftfreq(heave(command).size, 1.0 / RATE)
    inside = (frequency > 0.5) & (frequency < 8.5)
    assert power[~inside].sum() < 1e-6 * power.sum()
    shares = [
        power[(frequency >= f) & (frequency < f + 0.7)].sum() for f in 1.0 + 0.7 * np.arange(10)
    ]
    np.testing.assert_allclose(shares, np.mean(shares), rtol=4.0 / math.sqrt(700.0), atol=0.0)


def test_noise_scaled_by_its_rms():
    command = signals.noise("heave", AMPLITUDE, duration=20.0, settle=1.0, scale="rms")
    assert command.duration == 22.0
    rms = np.sqrt(np.mean(heave(command)[RATE:-RATE] ** 2))
    assert rms == pytest.approx(AMPLITUDE, rel=1e-12)


# Multisines


def test_acceleration_spectrum_has_flat_acceleration_above_its_corner():
    """Displacement (corner/f)^2: A f^2 equal above 1 Hz, A equal below."""
    period = 10.0
    command = signals.multisine(
        "heave", AMPLITUDE, period=period, spectrum="acceleration", corner=1.0, start=0.1
    )
    orders = np.arange(1, 101, 2)
    size = np.abs(lines(heave(command), round(period * RATE)))[orders]
    below, above = orders <= 10, orders >= 10
    np.testing.assert_allclose(size[below], size[0], rtol=1e-9, atol=0.0)
    np.testing.assert_allclose(size[above] * (orders[above] / period) ** 2, size[0], rtol=1e-6)


def test_multisine_fade_leaves_the_measured_periods_alone():
    """In within the first period, out in a tail after the last."""
    bare, faded = (signals.multisine("heave", AMPLITUDE, period=4.0, fade=f) for f in (0.0, 1.5))
    assert faded.duration == bare.duration + 1.5
    kept = slice(round(1.5 * RATE), 12 * RATE)
    assert np.array_equal(heave(faded)[kept], heave(bare)[kept])


def test_orthogonal_multisines_share_no_line():
    """Line by line, exactly one of the six moves, and it is the one the description names."""
    period = 8.0
    command = composite.orthogonal_multisines(SIX, period=period, start=0.2, stop=6.0)
    samples = round(period * RATE)
    for index, dof in enumerate(DOFS):
        spectrum = np.abs(lines(command.pose[:, index], samples))
        present = np.flatnonzero(spectrum[1:] > 1e-9 * spectrum[1:].max()) + 1
        np.testing.assert_array_equal(present, command.signal.lines[dof])
        assert (present % 2 == 1).all()
    every = np.sort(np.concatenate(list(command.signal.lines.values())))
    np.testing.assert_array_equal(every, np.arange(3, 49, 2))


def test_orthogonal_multisines_by_name_leave_the_others_at_rest():
    command = composite.orthogonal_multisines({"yaw": 0.01, "surge": 0.02}, period=4.0)
    assert list(command.signal.lines) == ["surge", "yaw"]
    np.testing.assert_allclose(
        np.abs(command.pose).max(axis=0), [0.02, 0, 0, 0, 0, 0.01], rtol=1e-12, atol=0.0
    )


# Dwells


def test_rounds_are_table_2_3():
    """Thirty-five frequencies, rising; ends, channel 4 and the sum of each round as printed."""
    every = [f for row in composite.ROUNDS for f in row]
    assert len(every) == 35 and every == sorted(every)
    assert [row[0] for row in composite.ROUNDS] == [0.1, 1.4, 3.4, 5.6, 8.0]
    assert [row[3] for row in composite.ROUNDS] == [0.6, 2.0, 4.4, 6.6, 9.0]
    assert [row[6] for row in composite.ROUNDS] == [1.2, 3.0, 5.4, 7.6, 10.0]
    np.testing.assert_allclose(
        [sum(row) for row in composite.ROUNDS], [4.3, 14.8, 30.4, 46.6, 63.0], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("number", "rows"), [(1, 22705), (2, 9664), (3, 8450), (4, 8028), (5, 8011)]
)
def test_round_is_as_long_as_the_facility_s(number, rows):
    """Appendix A's heave files end in these rows; row 1 is the heading, 128 rows a second."""
    duration = composite.seven_sines("heave", AMPLITUDE, number).duration
    assert duration == pytest.approx((rows - 1) / 128.0, rel=0.05)


@pytest.mark.parametrize("kind", ["seven_sines", "stepped_sines"])
def test_dwells_are_whole_cycles_at_full_amplitude(kind):
    """The listed stretch is A sin(2 pi f t) from phase zero; cycles / f to half a frame."""
    command = AT_REST[kind]()
    for dwell in command.signal.dwells:
        assert abs(dwell.frames - dwell.cycles / dwell.frequency * RATE) <= 0.5
        time = np.arange(dwell.frames) / RATE
        expected = dwell.amplitude * np.sin(2.0 * np.pi * dwell.frequency * time)
        result = heave(command)[dwell.start : dwell.start + dwell.frames]
        np.testing.assert_allclose(result, expected, rtol=0.0, atol=1e-15)


def test_seven_sines_run_the_frequencies_of_the_round_in_sequence():
    dwells = composite.seven_sines("pitch", 0.2 * DEGREE, 2).signal.dwells
    assert tuple(d.frequency for d in dwells) == composite.ROUNDS[1]
    ends = [d.start + d.frames for d in dwells]
    rests = np.array([d.start for d in dwells[1:]]) - ends[:-1]
    assert (rests == round(7.5 * RATE)).all()  # fade out, 5.5 s of rest, fade in


def test_stepped_sines_take_each_frequency_at_each_amplitude():
    command = composite.stepped_sines("sway", (2.0, 0.5), (0.1, 0.2), transient=3.0)
    result = [(d.frequency, d.amplitude) for d in command.signal.dwells]
    assert result == [(2.0, 0.1), (2.0, 0.2), (0.5, 0.1), (0.5, 0.2)]


def test_stepped_sines_keep_their_amplitude_through_the_transient():
    command = composite.stepped_sines("sway", (2.0,), (0.1,), transient=3.0)
    start = command.signal.dwells[0].start
    assert start == 5 * RATE  # 1 s of rest, 1 s of fade, 3 s of transient
    time = np.arange(-3 * RATE, 0) / RATE
    result = command.pose[start - 3 * RATE : start, 1]
    np.testing.assert_allclose(result, 0.1 * np.sin(4.0 * np.pi * time), rtol=0.0, atol=1e-13)


# Acceleration steps and faded sines


@pytest.mark.parametrize("hold", [0.3, 0.5, 0.5002])
def test_an_acceleration_step_keeps_its_acceleration_whatever_its_hold(hold):
    """To the size asked for, also where the hold is no whole number of frames."""
    history = heave(signals.acceleration_step("heave", 1.0, hold=hold))
    assert np.abs(np.diff(history, 2)).max() * RATE**2 == pytest.approx(1.0, rel=1e-6)
    assert history[-1] == history[-2] == pytest.approx((round(hold * RATE) / RATE) ** 2, rel=1e-12)
    with pytest.raises(ValueError, match="acceleration: 0 is refused; allowed: any other number"):
        signals.acceleration_step("surge", 0.0, hold=hold)
    with pytest.raises(ValueError, match=r"hold: 0.0005 s must be two frames or more, 0.00097"):
        signals.acceleration_step("surge", 0.2, hold=0.0005)


def test_fades_leave_the_amplitude_its_time():
    """Between them a sine reaches its amplitude; fades of more than half the time never would."""
    sines = ([0.5, 1.0], [0.1, 0.2], ["heave", "roll"])
    pose = signals.faded_sines(*sines, duration=4.0, fade=1.5).pose
    assert np.abs(pose).max(axis=0)[[2, 3]] == pytest.approx([0.2, 0.7 * 0.2], rel=1e-6)
    for made in (
        lambda: signals.faded_sines(*sines, duration=4.0, fade=6.0),
        lambda: signals.chirp("heave", 0.1, duration=4.0, fade=6.0),
    ):
        with pytest.raises(InputError, match="fade: 6.0 s must be at most half the duration"):
            made()


# Refusals


@pytest.mark.parametrize(
    ("frequencies", "amplitudes", "options", "message"),
    [
        ((), (0.1,), {}, r"frequencies: \(\) is refused"),
        ((1.0,), (), {}, r"amplitudes: \(\) is refused"),
        ((1.0, -2.0), (0.1,), {}, "frequencies.1: -2.0 is refused"),
        ((1100.0,), (0.1,), {}, "frequencies: 1100 Hz must be at most half the control rate"),
        ((1.0,), (np.nan,), {}, "amplitudes.0: nan is refused: must be a number in m or rad"),
        ((1.0,), (0.1,), {"cycles": 2.5}, "cycles: 2.5 is refused: input should"),
    ],
)
def test_stepped_sines_out_of_range_are_named(frequencies, amplitudes, options, message):
    with pytest.raises(ValueError, match=message):
        composite.stepped_sines("heave", frequencies, amplitudes, **options)


SIX_VALUES = "amplitudes: .* is refused: must be six values or a mapping by name"


@pytest.mark.parametrize(
    ("amplitudes", "options", "message"),
    [
        *((wrong, {}, SIX_VALUES) for wrong in ((0.1, 0.2), 0.1, None)),
        ({"up": 0.1}, {}, "dof: 'up' is not one of surge, sway, heave, roll, pitch, yaw"),
        ((0.0,) * 6, {}, "amplitudes: all are 0"),
        ((0.1,) * 6, {"period": 1.0, "stop": 8.0}, "period: 1.0 s gives 4 odd lines in .* 6 deg"),
    ],
)
def test_orthogonal_multisines_out_of_range_are_named(amplitudes, options, message):
    with pytest.raises(InputError, match=message):
        composite.orthogonal_multisines(amplitudes, **options)


# Waypoints


def test_a_path_of_least_jerk_rests_at_its_points_and_peaks_at_1875_times_the_mean():
    times, values = [0.0, 2.0, 5.0], np.array([[0.0, 1.0], [0.6, 1.0], [-0.3, 0.4]])
    path = composite.waypoints(times, values)
    assert path.shape == (5 * 2048 + 1, 2)
    for time, value in zip(times, values, strict=True):
        assert path[round(time * 2048)] == pytest.approx(value, abs=1e-15)
    speed = np.gradient(path, 1 / 2048, axis=0)
    assert np.abs(speed[[0, 2 * 2048, -1]]).max() < 1e-5
    assert np.abs(speed[: 2 * 2048]).max(axis=0) == pytest.approx([1.875 * 0.3, 0.0], rel=1e-6)
    assert np.abs(speed[2 * 2048 :]).max(axis=0) == pytest.approx([1.875 * 0.3, 1.875 * 0.2])
    sixth = np.diff(path[: 2 * 2048 : 64, 0], 6)
    assert np.abs(sixth).max() < 1e-12  # the jerk-optimal path is a quintic


def test_waypoints_need_times_that_rise_from_zero_and_a_finite_row_each():
    for times in ([0.0], [0.5, 1.0], [0.0, 1.0, 1.0], [[0.0, 1.0]]):
        with pytest.raises(ValueError, match="times: .* at least two numbers that rise from 0 s"):
            composite.waypoints(times, np.zeros((len(times), 1)))
    for values in ([[0.0]], [[0.0], [np.nan]], [[0.0], [1.0], [2.0]]):
        with pytest.raises(ValueError, match="values"):
            composite.waypoints([0.0, 1.0], values)
    with pytest.raises(ValueError, match="rate: 0 must be a finite number greater than 0"):
        composite.waypoints([0.0, 1.0], [[0.0], [1.0]], rate=0)
