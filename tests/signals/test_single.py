"""Excitations: amplitude, rest at both ends, frequencies, seeds and refusals.

Oracles: section 2.5 of the report for the chirp (0.01 to 10 Hz in 100 s, linear), Fourier lines
for the multisine.
"""

import numpy as np
import pytest

from cmf_mj import signals
from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.machine.geometry import DOFS
from cmf_mj.signals.signal import Command

AMPLITUDE = 0.33 * 0.0254

EXCITATIONS = {
    "step": lambda dof="heave": signals.step(dof, AMPLITUDE),
    "sine": lambda dof="heave": signals.sine(dof, AMPLITUDE, 2.0),
    "chirp": lambda dof="heave": signals.chirp(dof, AMPLITUDE, duration=20.0),
    "multisine": lambda dof="heave": signals.multisine(dof, AMPLITUDE, period=4.0),
}


def heave(command):
    return command.pose[:, 2]


# All of them


@pytest.mark.parametrize("kind", EXCITATIONS)
@pytest.mark.parametrize("dof", DOFS)
def test_only_the_named_degree_of_freedom_moves(kind, dof):
    command = EXCITATIONS[kind](dof)
    assert [name for name, moves in zip(DOFS, command.pose.any(axis=0), strict=True) if moves] == [
        dof
    ]


def test_multisine_starts_nearest_to_zero():
    """It is periodic: the start is the sample closest to a zero crossing."""
    once = heave(EXCITATIONS["multisine"]())
    assert abs(once[0]) == np.abs(once).min()
    assert abs(once[0]) < np.abs(np.diff(once)).max()


# Step and sine


def test_step_is_a_step():
    command = signals.step("heave", AMPLITUDE, at=0.5, duration=2.0)
    assert command.duration == 2.0
    assert not heave(command)[: RATE // 2].any()
    assert (heave(command)[RATE // 2 :] == AMPLITUDE).all()


def test_sine_between_its_fades():
    command = signals.sine("heave", AMPLITUDE, 2.0, cycles=8.0, fade=1.0)
    time = np.arange(4 * RATE) / RATE
    assert command.pose.shape[0] == time.size
    plateau = (time >= 1.0) & (time <= 3.0)
    expected = AMPLITUDE * np.sin(2.0 * np.pi * 2.0 * time[plateau])
    np.testing.assert_allclose(heave(command)[plateau], expected, rtol=0.0, atol=1e-15)


def test_fade_longer_than_the_sine_is_cut_to_half_of_it():
    command = signals.sine("heave", AMPLITUDE, 2.0, cycles=2.0, fade=100.0)
    edges = np.abs(heave(command)[[0, 1, -1]]) / AMPLITUDE
    assert (edges < 1e-6).all()


# Chirp


@pytest.mark.parametrize(("start", "stop", "duration"), [(0.01, 10.0, 100.0), (0.5, 4.0, 16.0)])
def test_chirp_frequency_rises_linearly(start, stop, duration):
    """Zero crossing n comes when start t + (stop - start) t^2 / (2 duration) cycles are n / 2."""
    command = signals.chirp("heave", AMPLITUDE, start=start, stop=stop, duration=duration)
    sweep = heave(command)[2 * RATE : -2 * RATE]
    before = np.flatnonzero(sweep[1:-1] * sweep[2:] < 0.0) + 1
    crossing = (before + sweep[before] / (sweep[before] - sweep[before + 1])) / RATE
    cycles = start * crossing + (stop - start) * crossing**2 / (2.0 * duration)
    # Straight lines between samples: below 1e-4 of a cycle at 10 Hz.
    np.testing.assert_allclose(2.0 * cycles, np.round(2.0 * cycles), rtol=0.0, atol=2e-4)
    np.testing.assert_array_equal(np.diff(np.round(2.0 * cycles)), 1.0)
    assert crossing.size >= np.floor((start + stop) * duration) - 1


def test_chirp_defaults_are_the_report_s():
    """Section 2.5: 0.01 to 10 Hz in 100 s; two seconds of rest before and after."""
    command = signals.chirp("heave", AMPLITUDE)
    assert command.duration == 104.0
    assert not heave(command)[: 2 * RATE].any() and not heave(command)[-2 * RATE :].any()


# Multisine


def lines(command, period):
    samples = round(period * RATE)
    return np.abs(np.fft.rfft(heave(command)[:samples])) / samples


def test_multisine_has_only_odd_lines():
    """Between 0.5 and 8 Hz, all equal; the constant aside, which starts the history at zero."""
    period = 4.0
    spectrum = lines(signals.multisine("heave", AMPLITUDE, period=period, start=0.5, stop=8.0), 4.0)
    present = np.flatnonzero(spectrum[1:] > 1e-9 * spectrum[1:].max()) + 1
    np.testing.assert_array_equal(present, np.arange(3, 33, 2))
    heights = spectrum[present]
    np.testing.assert_allclose(heights, heights[0], rtol=1e-9, atol=0.0)


def test_multisine_repeats_whole_periods():
    command = signals.multisine("heave", AMPLITUDE, period=2.0, periods=4)
    assert command.duration == 8.0
    periods = heave(command).reshape(4, -1)
    assert (periods == periods[0]).all()


# Command


def test_command_from_an_array_is_a_copy():
    poses = np.zeros((8, 6))
    command = Command.from_pose(poses)
    poses[0, 0] = 1.0
    assert not command.pose.any()
    assert command == Command([[0.0] * 6] * 8) != Command(poses)
    step, same, other = (signals.step("heave", size) for size in (0.1, 0.1, 0.2))
    assert step == same != other and len({step, same, other}) == 2


@pytest.mark.parametrize("shape", [(6,), (4, 5), (0, 6), (2, 4, 6)])
def test_command_of_a_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"command: shape is .*; allowed: \(N, 6\) with N >= 1"):
        Command.from_pose(np.zeros(shape))


# Refusals


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        ("step", {"at": 14.0}, "at: 14.0 s must be less than the duration of 13.0 s"),
        ("step", {"at": 12.9999}, "at: 12.9999 s must be less than the duration of 13.0 s"),
        ("sine", {"frequency": 2000.0}, "frequency: 2000 Hz must be at most half the control rate"),
        ("chirp", {"stop": 2000.0}, "stop: 2000 Hz must be at most half the control rate"),
        ("chirp", {"start": 11.0}, "stop: 10.0 Hz must be above start, 11.0 Hz"),
        ("pulse", {"width": 1e-4}, "width: 0.0001 s must be two frames or more"),
        ("pulse", {"width": 12.5}, "width: 12.5 s after 1.0 s must be within the 13.0 s"),
        ("noise", {"fade": 60.0}, "fade: 60.0 s must be at most half the duration of 100.0 s"),
        ("noise", {"start": 2.0, "stop": 1.0}, "stop: no multiple of 0.01 Hz lies in 2.0 to 1.0"),
        ("multisine", {"period": 0.3001}, "period: 0.3001 s must be a whole number of frames"),
        ("multisine", {"start": 0.11, "stop": 0.14}, "stop: no odd multiple of 0.05 Hz lies in"),
        ("multisine", {"fade": 30.0}, "fade: 30.0 s must be at most the period of 20.0 s"),
    ],
)
def test_argument_out_of_range_is_named(kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        getattr(signals, kind)("heave", AMPLITUDE, **arguments)


@pytest.mark.parametrize("rate", [200, 1000, 5000, 10_000])
def test_a_signal_at_another_control_rate_is_the_same_in_time(rate):
    """Each sample is the sine of its time; at common times both rates agree to round-off."""
    usual = signals.sine("heave", 0.1, frequency=0.5, cycles=4)
    other = usual.at_rate(rate)
    assert (other.rate, other.duration) == (rate, usual.duration)
    time = np.arange(other.pose.shape[0]) / rate
    middle = (time >= 1.0) & (time <= 7.0)
    np.testing.assert_allclose(
        other.pose[middle, 2], 0.1 * np.sin(np.pi * time[middle]), rtol=0, atol=1e-12
    )
    common = np.gcd(rate, 2048)
    np.testing.assert_allclose(
        other.pose[:: rate // common], usual.pose[:: 2048 // common], rtol=0, atol=1e-12
    )
    assert other.description["rate"] == rate and usual.at_rate(2048) is usual
    assert other.at_rate(2048).description == usual.description


def test_an_array_of_poses_has_its_own_rate_alone():
    command = signals.Command.from_pose(np.zeros((1000, 6)), rate=500)
    assert command.duration == 2.0
    with pytest.raises(InputError, match="500 a second; the machine takes 2048 a second"):
        command.at_rate(2048)
