"""Fault detection: frames of detection against closed forms, no alarm in nominal runs."""

from pathlib import Path

import numpy as np
import pytest
from protected_records import fault_of

from cmf_mj import Hexapod, Record, law_names, signals, simulate
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.protection import (
    CHECKS,
    Fault,
    ProtectionSettings,
    check_frame,
    latched_fault,
    load_protection,
    make_protection,
    protection_state,
    reset,
)
from cmf_mj.electronics.sensors import load_sensors, make_sensors, sense_history
from cmf_mj.facility.replay import FEEDBACK
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant.parameters import fitting

FRAME = 1.0 / 2048.0
INCH, PSI, GRAVITY = 0.0254, 6894.757293168361, 9.80665
SUPPLY = 1500.0 * PSI
LEGS = 6
SETTINGS = load_protection()


class Machine:
    """A machine at rest whose signals a test moves."""

    def __init__(self, settings: ProtectionSettings = SETTINGS) -> None:
        self.protection = make_protection(settings)
        self.state = protection_state(np.zeros(LEGS))
        self.reference = np.zeros(LEGS)
        self.feedback = LegFeedback(*(np.zeros(LEGS) for _ in range(5)))
        self.supply = SUPPLY
        self.age = 0.0
        self.frame = 0

    def step(self) -> int:
        code = check_frame(
            self.protection,
            self.state,
            self.frame,
            self.reference,
            self.feedback,
            self.supply,
            self.age,
        )
        self.frame += 1
        return code

    def found(self, frames: int) -> Fault | None:
        for _ in range(frames):
            self.step()
        return latched_fault(self.state)


def last(name: str, first: int) -> int:
    """Frame of detection of a condition that holds from the frame `first` on."""
    return first + getattr(SETTINGS, name).persistence - 1


def test_rest_is_no_fault() -> None:
    assert Machine().found(5000) is None


def test_a_growing_tracking_error() -> None:
    machine, speed = Machine(), 0.5
    for frame in range(2000):
        machine.reference[3] = -speed * frame * FRAME
        machine.step()
    first = int(np.floor(6.0 * INCH / (speed * FRAME))) + 1
    assert latched_fault(machine.state) == ("tracking_error", 4, last("tracking_error", first))


def test_a_velocity_sensor_with_an_offset() -> None:
    """b/r (1 - (1 - r T)^k) = threshold, r = 2 1/s: just below 0.5 in/s is never found."""
    rate, threshold = 2.0, 0.25 * INCH
    for offset in (0.6 * INCH, 2.0 * INCH, -1.0 * INCH):
        machine = Machine()
        machine.feedback.velocity[1] = offset
        share = 1.0 - rate * threshold / abs(offset)
        first = int(np.floor(np.log(share) / np.log(1.0 - rate * FRAME))) + 1
        expected = ("sensor_disagreement", 2, last("sensor_disagreement", first))
        assert machine.found(10000) == expected
    quiet = Machine()
    quiet.feedback.velocity[1] = 0.499 * INCH
    assert quiet.found(40000) is None


@pytest.mark.parametrize(
    ("name", "field", "below", "above"),
    [
        ("over_pressure", "cap_pressure", 2499.0 * PSI, 2501.0 * PSI),
        ("over_pressure", "rod_pressure", 2499.0 * PSI, 2501.0 * PSI),
        ("over_acceleration", "acceleration", -7.99 * GRAVITY, -8.01 * GRAVITY),
    ],
)
def test_steps_are_found_after_the_persistence(
    name: str, field: str, below: float, above: float
) -> None:
    machine = Machine()
    getattr(machine.feedback, field)[4] = below
    assert machine.found(300) is None
    getattr(machine.feedback, field)[4] = above
    assert machine.found(300) == (name, 5, last(name, 300))


def test_over_speed_of_both_sensors_in_agreement() -> None:
    machine, speed = Machine(), -40.5 * INCH
    for frame in range(100):
        machine.feedback.velocity[:] = speed
        machine.feedback.position[:] = speed * frame * FRAME
        machine.reference[:] = machine.feedback.position
        machine.step()
    assert latched_fault(machine.state) == ("over_speed", 1, last("over_speed", 0))


def test_a_supply_that_fails() -> None:
    """An accumulator that empties exponentially: 1500 to 1000 psi in tau ln 1.5."""
    machine, decay = Machine(), 0.4
    for frame in range(1000):
        machine.supply = SUPPLY * np.exp(-frame * FRAME / decay)
        machine.step()
    first = int(np.floor(decay * np.log(1.5) / FRAME)) + 1
    assert latched_fault(machine.state) == ("under_pressure", None, last("under_pressure", first))


def test_a_host_that_falls_silent() -> None:
    machine = Machine()
    for frame in range(500):
        machine.age = max(0, frame - 100) * FRAME
        machine.step()
    first = 100 + int(np.floor(0.1 / FRAME)) + 1
    assert latched_fault(machine.state) == ("host_watchdog", None, first)


def test_missed_control_frames() -> None:
    machine = Machine()
    assert machine.found(10) is None
    machine.frame += 2  # forgiven
    assert machine.found(10) is None
    machine.frame += 3
    assert machine.found(1) == ("frame_watchdog", None, 25)


def test_a_shorter_disturbance_is_forgiven_and_the_count_starts_again() -> None:
    machine = Machine()
    for _ in range(10):
        machine.feedback.acceleration[2] = 9.0 * GRAVITY
        assert machine.found(3) is None
        machine.feedback.acceleration[2] = 0.0
        assert machine.found(1) is None
    machine.feedback.acceleration[2] = 9.0 * GRAVITY
    assert machine.found(4) == ("over_acceleration", 3, 43)


def test_the_first_fault_stays_until_reset() -> None:
    machine = Machine()
    machine.feedback.acceleration[2] = 9.0 * GRAVITY
    first = machine.found(4)
    machine.feedback.acceleration[2] = 0.0
    machine.supply = 0.0
    assert machine.found(200) == first
    machine.supply = SUPPLY
    reset(machine.state, machine.feedback.position)
    assert latched_fault(machine.state) is None
    assert machine.found(200) is None


@pytest.mark.parametrize("watchdog", ["host_watchdog", "frame_watchdog"])
def test_a_watchdog_gives_way_to_a_fault_of_the_machine(watchdog: str) -> None:
    """It only lowers the machine; what fails on the way down must still close the valves."""
    machine = Machine()
    machine.found(10)
    if watchdog == "host_watchdog":
        machine.age = 0.2
    else:
        machine.frame += 3
    assert machine.found(5).name == watchdog
    assert machine.found(5) == (watchdog, None, 10 if watchdog == "host_watchdog" else 13)
    machine.feedback.velocity[2] = 2.0
    frame = machine.frame
    fault = machine.found(SETTINGS.over_speed.persistence)
    assert fault == ("over_speed", 3, frame + SETTINGS.over_speed.persistence - 1)
    machine.age = 0.3
    machine.feedback.acceleration[:] = np.nan
    assert machine.found(20) == fault


def test_of_several_in_one_frame_the_first_name_and_leg_win() -> None:
    changed = {
        name: getattr(SETTINGS, name).model_copy(update={"persistence": 1}) for name in CHECKS
    }
    machine = Machine(SETTINGS.model_copy(update=changed))
    machine.feedback.velocity[0] = 50.0 * INCH
    machine.feedback.cap_pressure[3:5] = 2600.0 * PSI
    machine.supply = 0.0
    assert machine.found(1) == ("over_pressure", 4, 0)


@pytest.mark.parametrize("field", LegFeedback._fields)
def test_nan_is_a_fault(field: str) -> None:
    machine = Machine()
    getattr(machine.feedback, field)[5] = np.nan
    found = machine.found(30)
    assert found is not None
    assert found.leg == 6


def test_a_supply_sensor_that_reads_nan_is_a_fault() -> None:
    machine = Machine()
    machine.supply = np.nan
    assert machine.found(30) == ("under_pressure", None, last("under_pressure", 0))


@pytest.mark.parametrize("name", CHECKS)
def test_conditions_can_be_switched_off(name: str) -> None:
    every = {n: getattr(SETTINGS, n).model_copy(update={"enabled": n == name}) for n in CHECKS}
    none = {n: check.model_copy(update={"enabled": False}) for n, check in every.items()}
    for changes, expected in ((every, name), (none, None)):
        machine = Machine(SETTINGS.model_copy(update=changes))
        machine.found(1)
        machine.frame += 50
        machine.reference[:] = 1.0
        machine.feedback.velocity[:] = 3.0
        machine.feedback.acceleration[:] = 100.0
        machine.feedback.rod_pressure[:] = 1e8
        machine.supply, machine.age = 0.0, 5.0
        found = machine.found(200)
        assert (found.name if found else None) == expected


def noisy(record: Record) -> Record:
    """The record with readings of noisy sensors, gravity and all, for the feedback."""
    truth = LegFeedback(*(record[channel] for channel in FEEDBACK.values()))
    reading = sense_history(make_sensors(load_sensors("noisy"), 2048.0, 6), truth)
    channels = dict(record.channels) | dict(zip(FEEDBACK.values(), reading, strict=True))
    return Record(record.time, channels, record.units, record.metadata)


@pytest.fixture(scope="module")
def hexapod() -> Hexapod:
    return Hexapod()


@pytest.mark.parametrize("law", [law for law in law_names() if law != "original_as_printed"])
def test_no_alarm_in_nominal_sweeps(law: str, hexapod: Hexapod) -> None:
    """0.33 in in heave, 0.01 to 10 Hz, hardware set, an eighth as long as the report's chirp."""
    command = signals.chirp("heave", 0.33 * INCH, duration=12.0)
    record = simulate(hexapod, law, command)
    assert np.abs(record["leg_velocity"]).max() > 2.0 * INCH
    assert fault_of(record, make_protection(SETTINGS), SUPPLY) is None
    assert fault_of(noisy(record), make_protection(SETTINGS), SUPPLY) is None


def test_the_misprinted_law_is_stopped(hexapod: Hexapod) -> None:
    """It runs away within two seconds; the alarm is no false one."""
    record = simulate(
        hexapod, "original_as_printed", signals.chirp("heave", 0.33 * INCH, duration=6.0)
    )
    fault = fault_of(record, make_protection(SETTINGS), SUPPLY)
    assert fault is not None
    assert fault.name == "over_speed"
    speed = np.abs(record["leg_velocity"][: fault.frame + 1, fault.leg - 1])
    assert speed[-4:].min() > 40.0 * INCH
    assert (speed[:-4] > 40.0 * INCH).sum() == 0


def test_the_documented_table_is_the_default() -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "sensors.md").read_text(
        encoding="utf-8"
    )
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| `")]
    told = {name.strip(" `"): (size.strip(), int(frames)) for name, _, size, frames in rows}
    assert list(told) == list(CHECKS)
    for name, (size, frames) in told.items():
        check = getattr(SETTINGS, name)
        unit = "" if check.threshold.unit == "1" else f" {check.threshold.unit}"
        assert size == f"{check.threshold.value:g}{unit}"
        assert frames == check.persistence


@pytest.mark.parametrize("rate", [512.0, 2048.0, 4096.0])
def test_a_fault_takes_as_long_at_any_control_rate(rate: float) -> None:
    """Persistence counts frames of 1/2048 s: 20 of them are 9.8 ms, 5 frames at 512 Hz."""
    protection, state = make_protection(SETTINGS, 1.0 / rate), protection_state(np.zeros(LEGS))
    feedback = LegFeedback(*(np.zeros(LEGS) for _ in range(5)))
    for frame in range(100):
        check_frame(protection, state, frame, np.full(LEGS, 6.1 * INCH), feedback, SUPPLY)
    found = latched_fault(state)
    assert found == ("tracking_error", 1, round(20 * rate / 2048.0) - 1)


@pytest.mark.parametrize("name", ["cmf", "simona", "lab"])
def test_the_tracking_error_is_the_same_share_of_every_stroke(name: str) -> None:
    """6 in of 38 in."""
    machine = load_machine(name)
    check = load_protection("default", fitting(machine)).tracking_error
    assert check.threshold.si == pytest.approx(6.0 / 38.0 * machine.half_stroke, rel=1e-12)
