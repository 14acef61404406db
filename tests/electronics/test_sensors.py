"""Instruments: noise against NumPy's Philox, errors one by one, gravity against MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from scipy import signal, stats

from cmf_mj import Hexapod, load_law, signals, simulate
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.electronics.noise import four_normals, key_schedule, philox, stream_key
from cmf_mj.electronics.sensors import (
    ChannelSettings,
    SensorSettings,
    load_sensors,
    make_sensors,
    sense_history,
)

RATE = 2048.0
GRAVITY = 9.80665
PSI = 6894.757293168361


def number(value: float, unit: str) -> dict[str, object]:
    return {"value": value, "unit": unit, "status": "assumed", "source": "test"}


def only(channel: str, **numbers: dict[str, object]) -> SensorSettings:
    """A set that is ideal but for one channel."""
    table = {"name": "own", "gravity": False, channel: numbers}
    return SensorSettings.model_validate(table)


def still(frames: int, legs: int = 6, **values: float) -> LegFeedback:
    zero = {field: 0.0 for field in LegFeedback._fields} | values
    return LegFeedback(*(np.full((frames, legs), zero[field]) for field in LegFeedback._fields))


def test_blocks_are_numpys_philox() -> None:
    """NumPy counts up before it makes a block."""
    for seed, name, first, second in ((7, "leg_position", 123, 3), (2**63 + 5, "x", 0, 1)):
        key = stream_key(seed, name)
        counter = first + (second << 64) - 1
        words = [(counter >> (64 * i)) % 2**64 for i in range(4)]
        oracle = np.random.Philox(
            counter=np.array(words, dtype=np.uint64), key=np.array(key, dtype=np.uint64)
        ).random_raw(4)
        mine = philox(key_schedule(key), np.uint64(first), np.uint64(second))
        assert [int(word) for word in mine] == [int(word) for word in oracle]


def test_normals_are_standard_white_and_independent_between_channels() -> None:
    def drawn(name: str) -> np.ndarray:
        keys = key_schedule(stream_key(3, name))
        return np.array([four_normals(keys, frame, 0) for frame in range(20000)])

    one, two = drawn("leg_position"), drawn("leg_velocity")
    count = one.size
    assert stats.kstest(one.ravel(), "norm").pvalue > 1e-3
    assert abs(one.mean()) < 4 / np.sqrt(count)
    assert abs(one.var() - 1.0) < 4 * np.sqrt(2 / count)
    bound = 4 / np.sqrt(one.shape[0])
    for a, b in ((one[1:, 0], one[:-1, 0]), (one[:, 0], one[:, 1]), (one[:, 0], two[:, 0])):
        assert abs(np.mean(a * b)) < bound
    assert abs(np.mean(one[:, 0] ** 2 * two[:, 0] ** 2) - 1.0) < 3 * bound  # not only uncorrelated


def test_ideal_readings_are_the_truth_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    truth = LegFeedback(*(rng.normal(size=(50, 4)) for _ in LegFeedback._fields))
    truth.position[3, 0] = -0.0
    reading = sense_history(make_sensors(load_sensors("ideal"), RATE, 9), truth)
    for mine, true in zip(reading, truth, strict=True):
        assert mine.tobytes() == true.tobytes()


def test_same_seed_same_bits_and_channels_do_not_touch_one_another() -> None:
    truth = still(64)
    noisy = load_sensors("noisy")

    def readings(settings: SensorSettings, seed: int) -> LegFeedback:
        return sense_history(make_sensors(settings, RATE, seed), truth)

    first, again, other = readings(noisy, 4), readings(noisy, 4), readings(noisy, 5)
    quiet = noisy.model_copy(update={"leg_position": ChannelSettings()})
    without = readings(quiet, 4)
    for field in LegFeedback._fields:
        same, new = getattr(again, field), getattr(other, field)
        assert getattr(first, field).tobytes() == same.tobytes()
        if field.endswith("pressure"):
            continue  # clipped at zero here
        assert not np.array_equal(getattr(first, field), new)
    assert np.all(without.position == 0.0)
    assert without.velocity.tobytes() == first.velocity.tobytes()
    assert without.acceleration.tobytes() == first.acceleration.tobytes()


def test_more_legs_leave_the_noise_of_the_others() -> None:
    sensors = make_sensors(only("leg_velocity", noise_density=number(1.0, "m/s/rtHz")), RATE, 2)
    three, six = (sense_history(sensors, still(20, legs)).velocity for legs in (3, 6))
    assert np.array_equal(three, six[:, :3])


def test_noise_has_the_stated_density() -> None:
    density = 0.02
    sensors = make_sensors(only("leg_position", noise_density=number(density, "m/rtHz")), RATE, 1)
    noise = sense_history(sensors, still(65536)).position
    count = noise.size
    expected = density * np.sqrt(RATE / 2)
    assert noise.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * count))
    _, power = signal.welch(noise, RATE, nperseg=256, axis=0, detrend=False)
    inner = power[1:-1].mean(axis=1)
    np.testing.assert_allclose(inner, density**2, rtol=5 * np.sqrt(2 / (2 * count / 256)))


def test_bias_resolution_and_range() -> None:
    sizes = {"bias": 0.013, "resolution": 0.01, "lowest": -0.5, "highest": 0.4}
    numbers = {name: number(value, "m") for name, value in sizes.items()}
    sensors = make_sensors(only("leg_position", **numbers), RATE)
    truth = still(5)
    truth.position[:, 0] = [0.0, 0.1, 0.104, 3.0, -3.0]
    reading = sense_history(sensors, truth).position[:, 0]
    np.testing.assert_allclose(reading, [0.01, 0.11, 0.12, 0.4, -0.5], rtol=1e-12)


def test_the_bandwidth_is_a_first_order_lag() -> None:
    corner = 80.0
    sensors = make_sensors(only("leg_velocity", bandwidth=number(corner, "Hz")), RATE)
    time = np.arange(4096) / RATE
    truth = still(4096)
    truth.velocity[:] = np.cos(2 * np.pi * corner * time)[:, None]
    reading = sense_history(sensors, truth).velocity[2048:, 2]
    turn = np.exp(-2j * np.pi * corner * time[2048:])
    found = 2.0 * np.mean(reading * turn)
    assert found == pytest.approx(1.0 / (1.0 + 1.0j), abs=1e-6)


def test_leg_accelerometers_read_what_mujocos_sensors_on_the_rods_read() -> None:
    """Surge of 0.1 m at 1 Hz: 4.8 m/s^2 of leg acceleration, gravity changing by a twentieth."""
    command = signals.sine("surge", 0.1, 1.0, cycles=2.0)
    record = simulate(Hexapod(), "velocity", command)
    names = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
    truth = LegFeedback(*(record[name] for name in names))
    feeling = load_sensors("ideal").model_copy(update={"gravity": True})
    reading = sense_history(make_sensors(feeling, RATE), truth).acceleration
    rods = record["rod_accelerometer"]
    assert np.ptp(rods, axis=0).min() > 2.0
    later = slice(8, None)  # MuJoCo's first frames close the gimbals
    np.testing.assert_allclose(reading[later], rods[later], rtol=0.0, atol=2e-3)
    without = np.abs(truth.acceleration[later] - rods[later]).max()
    assert without > 0.83 * GRAVITY


def test_noisy_legs_at_rest_read_what_the_hardware_read() -> None:
    sensors = make_sensors(load_sensors("noisy"), RATE, 3)
    reading = sense_history(sensors, still(20000, cap_pressure=600 * PSI)).acceleration
    assert reading.mean() / GRAVITY == pytest.approx(0.86, abs=1e-3)
    assert reading.std(axis=0).mean() / GRAVITY == pytest.approx(0.04, rel=0.02)
    # Eq 3.6 leaves of white noise b / sqrt(1 - a^2).
    law = load_law("acceleration_opposing")
    a, b = law.accelerometer_pole, law.accelerometer_gain
    behind = signal.lfilter([0.0, b], [1.0, -a], reading - reading.mean(axis=0), axis=0)[2048:]
    left = behind.std(axis=0).mean() / reading.std(axis=0).mean()
    assert left == pytest.approx(b / np.sqrt(1.0 - a**2), rel=0.05)


def own(base: str, channel: str, field: str, value: float, unit: str) -> str:
    """A file that changes one number."""
    quantity = f'value = {value}, unit = "{unit}", status = "assumed", source = "mine"'
    return f'base = "{base}"\n[quiet.{channel}]\n{field} = {{ {quantity} }}\n'


def test_a_range_from_above_its_end_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(own("noisy", "leg_position", "lowest", 39.0, "in"))
    with pytest.raises(ValueError, match="lowest: 39 in must be less than highest, 38 in"):
        load_sensors(file)


def test_other_refusals() -> None:
    with pytest.raises(ValueError, match="seed: -1"):
        make_sensors(load_sensors("noisy"), RATE, -1)
    with pytest.raises(ValueError, match="corner: 500 Hz must be"):
        make_sensors(load_sensors("noisy"), 800.0)
    with pytest.raises(ValueError, match="gravity along the legs needs"):
        sense_history(make_sensors(load_sensors("noisy"), RATE), still(4, 3))
