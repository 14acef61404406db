"""What is measured of one record against what is known of the plant without it."""

import numpy as np
import pytest

from cmf_mj import SingleLegs, frequency_response, signals, simulate
from cmf_mj.core.errors import InputError
from cmf_mj.record.record import Record
from cmf_mj.signals.composite import acceleration_step, stepped_sines
from cmf_mj.studies.case import AMPLITUDE
from cmf_mj.studies.measurement import MEASURES, accelerations, signature, signature_lines


def run(command: signals.Command, every: int = 16) -> Record:
    return simulate(SingleLegs(), "velocity", command, record_every=every)


@pytest.fixture(scope="module")
def dwells() -> Record:
    return run(stepped_sines("heave", [0.5, 2.0], [AMPLITUDE], cycles=4))


def test_describing_function_at_the_sweep_s_amplitude_is_its_response(dwells: Record) -> None:
    """Single sines and a multisine measure the same thing: 0.1 dB and 1 deg."""
    response = frequency_response(run(signals.multisine("heave", AMPLITUDE)))
    found = MEASURES["describing_function"](dwells)
    for hertz in (0.5, 2.0):
        gain = np.interp(hertz, response.frequency, response.gain_db)
        phase = np.interp(hertz, response.frequency, response.phase_deg)
        assert found[f"heave {hertz:g} Hz gain [dB]"] == pytest.approx(gain, abs=0.1)
        assert found[f"heave {hertz:g} Hz phase [deg]"] == pytest.approx(phase, abs=1.0)


def test_six_equal_legs_move_a_heave_alike_and_make_little_noise(dwells: Record) -> None:
    balance = MEASURES["leg_balance"](dwells)
    assert all(abs(value) < 1e-5 for value in balance.values())
    noise = MEASURES["acceleration_noise"](dwells)
    assert noise["heave 0.5 Hz stochastic [%]"] < 1.0
    assert MEASURES["bump"](dwells)["heave 0.5 Hz bump [g]"] < 1e-3


def test_hysteresis_is_the_lag_of_the_loop(dwells: Record) -> None:
    """No friction is modelled: what opens the loop is the low-frequency delay, from the phase of
    the describing function at 0.5 Hz: sin(2 pi 0.01 d), within a tenth."""
    phase = MEASURES["describing_function"](dwells)["heave 0.5 Hz phase [deg]"]
    delay = -np.radians(phase) / (2.0 * np.pi * 0.5)
    slow = run(stepped_sines("heave", [0.01], [AMPLITUDE], cycles=1), every=64)
    width = MEASURES["hysteresis"](slow)["heave 0.01 Hz hysteresis [%]"]
    gain = 47.0 / 50.48
    assert width == pytest.approx(100.0 * gain * np.sin(2e-2 * np.pi * delay), rel=0.1)


def test_delay_of_a_slow_step_is_that_of_the_phase(dwells: Record) -> None:
    """An acceleration step of 0.5 s is slow against the loop: its delay is -phase / (360 f) at
    0.5 Hz within a tenth; 63 % of it are reached within 0.3 s."""
    record = run(acceleration_step("heave", 0.2, hold=0.5))
    phase = MEASURES["describing_function"](dwells)["heave 0.5 Hz phase [deg]"]
    delay = MEASURES["delay"](record)["heave delay [s]"]
    assert delay == pytest.approx(-phase / 180.0, rel=0.1)
    assert 0.0 < MEASURES["dynamic_threshold"](record)["heave 0.2 threshold [s]"] < 0.3


def test_accelerations_of_a_sine_are_its_second_derivative() -> None:
    """Of the recorded motion: w^2 times its amplitude within 0.5 %."""
    record = run(signals.sine("surge", 0.01, 1.0, cycles=8.0))
    inside = slice(3 * 128, 6 * 128)
    moved = accelerations(record)[inside, 0]
    _, pose = (record[name][inside] for name in ("leg_reference", "leg_position"))
    leg = np.ptp(pose[:, 0] - pose[:, 0].mean())
    demanded = np.ptp(record["leg_reference"][inside, 0])
    expected = 0.01 * leg / demanded * (2.0 * np.pi) ** 2
    assert 0.5 * np.ptp(moved) == pytest.approx(expected, rel=0.02)


def test_a_signature_holds_mean_and_amplitudes_of_a_sum_of_sines() -> None:
    """2 + 0.3 cos(w t) - 0.1 sin(5 w t), of whole periods."""
    time = np.arange(1000) / 100.0
    wave = 2.0 + 0.3 * np.cos(2.0 * np.pi * 0.2 * time) - 0.1 * np.sin(2.0 * np.pi * time)
    channels = {"leg_position": np.repeat(wave[:, None], 6, axis=1)}
    record = Record(time, channels, {"leg_position": "m"}, {"sample_rate": 100.0})
    lines = signature_lines(channels["leg_position"], 100.0)
    assert {2, 4, 6, 10} <= set(lines.tolist())
    found = signature(record, lines, ["leg_position"])[0, :, 0]
    at = {int(line): i for i, line in enumerate(lines)}
    real, imaginary = found[1 : 1 + lines.size], found[1 + lines.size :]
    assert found[0] == pytest.approx(2.0)
    assert real[at[2]] == pytest.approx(0.3)
    assert imaginary[at[10]] == pytest.approx(0.1)
    assert abs(real[at[4]]) < 1e-12


def test_legs_about_half_a_turn_differ_by_little_and_a_cut_dwell_is_refused(
    dwells: Record,
) -> None:
    legs, demand = dwells["leg_position"], dwells["leg_reference"]
    middle = demand.mean(axis=0)
    late = 2.0 * middle - np.where(np.arange(6) < 3, legs, np.roll(legs, 1, axis=0))
    units = {"leg_reference": "m", "leg_position": "m"}

    def legs_of(samples: int) -> Record:
        both = {"leg_reference": demand[:samples], "leg_position": late[:samples]}
        return Record(dwells.time[:samples], both, units, dwells.metadata)

    found = MEASURES["leg_balance"](legs_of(len(late)))["heave 2 Hz phase between legs [deg]"]
    assert found == pytest.approx(360.0 * 2.0 / dwells.rate, rel=0.1)
    with pytest.raises(InputError, match="within the sine of 2 Hz"):
        MEASURES["leg_balance"](legs_of(len(late) - 400))


def test_a_demand_at_rest_has_no_lines() -> None:
    assert signature_lines(np.ones((1000, 6)), 100.0).size == 0
