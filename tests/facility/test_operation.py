"""The facility in operation on the real plant: cycle, faults, delay, bad hosts, replay."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from shared import WORKING_STROKE

from cmf_mj import Hexapod, Record, load_law, signals, simulate
from cmf_mj.control import limiter
from cmf_mj.control.dcu.play import Arrivals, upsample
from cmf_mj.control.dcu.state import load_dcu, make_dcu, resting
from cmf_mj.control.protection import load_protection
from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.host.handover import make_ring, put
from cmf_mj.facility.host.stream import HostStream, from_command
from cmf_mj.facility.host.stream import arrivals as arrivals_of
from cmf_mj.facility.operation import Operation, operate, serve
from cmf_mj.facility.replay import replay
from cmf_mj.machine import kinematics
from cmf_mj.plant.events import Event

RATE, INCH, GRAVITY = 2048, 0.0254, 9.80665
LEGS = limiter.make_leg_limiter()


def sine(seconds: float, amplitude: float = 0.05) -> HostStream:
    command = signals.sine("heave", amplitude, 0.5, cycles=0.5 * seconds)
    return from_command(command, rate=80.0)


def lag(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Lag of the largest cross-correlation [s], parabola through the peak.

    Both begin and end at rest at nought, so that the plain sum has no edges.
    """
    apart = signal.correlate(second - second[0], first - first[0], method="fft")
    at = int(apart.argmax())
    before, top, after = apart[at - 1 : at + 2]
    shift = 0.5 * (before - after) / (before - 2.0 * top + after)
    return float((at + shift - (first.size - 1)) / RATE)


def entered(record: Record) -> list[tuple[str, float]]:
    """Operating states in order, with the time of the change."""
    code = record["operating_state"]
    changes = np.flatnonzero(np.diff(code)) + 1
    rows = [0, *changes.tolist()]
    return [(State(int(code[row])).name, float(record.time[row])) for row in rows]


def check_reference(record: Record) -> None:
    reference = record["leg_reference"]
    slack = 8 * np.finfo(float).eps * RATE
    velocity = np.diff(reference, axis=0) * RATE
    acceleration = np.diff(velocity, axis=0) * RATE
    assert np.abs(reference).max() <= WORKING_STROKE
    assert np.abs(velocity).max() <= LEGS.velocity[0] * (1 + 1e-12) + slack
    assert np.abs(acceleration).max() <= LEGS.acceleration[0] * (1 + 1e-12) + slack * RATE


@pytest.fixture(scope="module")
def cycle() -> Operation:
    """Off, raised, engaged, returned, off; noisy sensors, converters, servo electronics."""
    asked = [(0.5, Request.ENGAGE), (19.0, Request.OFF)]
    how: dict[str, Any] = {"begin": State.OFF, "requests": asked, "seconds": 34.0}
    return operate(Hexapod(), "velocity_integral", sine(36.0), **how)


def test_a_full_cycle_goes_through_all_states_without_a_fault(cycle: Operation) -> None:
    record = cycle.record
    names, times = zip(*entered(record), strict=True)
    assert names == ("OFF", "SETTLED", "RAISE", "ENGAGED", "RETURN", "SETTLED", "OFF")
    np.testing.assert_allclose(times[1:5], (0.5, 1.5, 13.5, 19.0), atol=2 / RATE)
    assert record.metadata["fault"] is None
    assert cycle.counts["missing"] == sum(cycle.rejections.values()) == 0
    ends = record["leg_extension"][[0, -1]]
    assert (ends < -37.0 * INCH).all()


def test_all_fades_of_a_cycle_are_continuous(cycle: Operation) -> None:
    """The third difference is bounded: no jump of acceleration, which of 0.01 m/s^2 were 20.

    A stop of the velocity v and acceleration a, as before the return at 19 s, begins with the jerk
    k^2 v + 2 k a, k = 4 / 0.25 s.
    """
    record = cycle.record
    check_reference(record)
    reference, asked = record["leg_reference"], 19 * RATE
    jerk = np.abs(np.diff(reference, n=3, axis=0)) * RATE**3
    speed, change = (np.diff(reference, n=n, axis=0)[asked - n] * RATE**n for n in (1, 2))
    stop = slice(asked - 3, asked + RATE)
    assert (jerk[stop] < np.abs(16.0**2 * speed + 2.0 * 16.0 * change) + 5.0).all()
    jerk[stop] = 0.0
    assert jerk.max() < 5.0
    steps = np.abs(np.diff(record["valve_gain"]))
    assert steps.max() <= 1.875 / RATE * (1 + 1e-9)
    assert record["valve_gain"][0] == record["valve_gain"][-1] == 0.0
    assert not record["valve_command"][-1].any()


def test_engaged_the_legs_follow_the_host(cycle: Operation) -> None:
    record = cycle.record
    settled = (record.time > 16.6) & (record.time < 19.0)
    wanted = kinematics.pose_to_legs(record["demand_pose"][settled])
    assert np.ptp(wanted) > 0.05
    np.testing.assert_allclose(record["leg_reference"][settled], wanted, rtol=0, atol=1e-12)
    moved = record["leg_extension"][settled]
    assert np.abs(moved - wanted).max() < 0.25 * np.ptp(wanted)


def demand_again(operation: Operation) -> NDArray[np.float64]:
    """What a DCU makes of the frames as they arrived, at the times of the record."""
    unit, told = make_dcu(), operation.record["demand_pose"]
    every = round(RATE / operation.record.rate)
    state = resting(unit, told[0])
    return upsample(unit, state, operation.arrivals, told.shape[0] * every)[::every, 0]


def test_the_frames_give_the_same_demand_again(cycle: Operation) -> None:
    np.testing.assert_array_equal(demand_again(cycle), cycle.record["demand_pose"])


def test_the_compensator_of_a_cycle_comes_back_bit_for_bit(cycle: Operation) -> None:
    """Noise, converters and valve fade between: the output is taken before the fade."""
    replayed = replay(cycle.record, "velocity_integral")
    assert replayed.identical
    fading = (cycle.record["valve_gain"] > 0.1) & (cycle.record["valve_gain"] < 0.9)
    scaled = cycle.record["compensator_output"][fading] - cycle.record["valve_command"][fading]
    assert np.abs(scaled).max() > 0.01


def test_the_silence_of_the_host_brings_the_machine_down() -> None:
    """The watchdog trips the states; the valves stay open and lower the legs at a fade's speed."""
    operation = operate(Hexapod(), "velocity_integral", sine(2.0), seconds=12.0)
    record, fault = operation.record, operation.record.metadata["fault"]
    last = operation.arrivals.frame[-1] / RATE
    limit = load_protection().host_watchdog.threshold.si
    assert fault["name"] == "host_watchdog"
    assert fault["time"] == pytest.approx(last + limit, abs=3 / RATE)
    assert entered(record)[-1] == ("FAULT", pytest.approx(fault["time"], abs=2 / RATE))
    assert record["isolation"].max() == 0.0
    check_reference(record)
    down = record.time > fault["time"]
    speed = np.diff(record["leg_reference"][down], axis=0) * RATE
    assert np.abs(speed).max() <= 8.0 * INCH * (1 + 1e-6) + 0.05 * np.pi * 1.0
    assert (record["leg_extension"][-1] < -36.5 * INCH).all()
    assert operation.counts["silent"] == 1


def test_a_reset_leaves_the_fault_and_the_machine_rises_again() -> None:
    """A sensor that jumps shuts the valves off; the legs settle, and RESET gives the supply back.

    The offset stays, but the detection starts anew at what it reads; integral law, so that the
    legs arrive at neutral by their sensors.
    """
    how: dict[str, Any] = {"begin": State.ENGAGED, "seconds": 46.0, "record_every": 16}
    how["events"] = [Event(at=1.0, kind="sensor_offset", leg=2, size=(0.4, "in"))]
    how["requests"] = [(20.0, Request.RESET), (27.0, Request.ENGAGE)]
    operation = operate(Hexapod(), "velocity_integral", sine(50.0), **how)
    record = operation.record
    names = [name for name, _ in entered(record)]
    assert names == ["ENGAGED", "FAULT", "OFF", "SETTLED", "RAISE", "ENGAGED"]
    assert record.metadata["fault"]["name"] == "sensor_disagreement"
    assert record.metadata["fault"]["time"] == pytest.approx(1.0, abs=0.01)
    isolated = record["isolation"] > 0.5
    assert isolated[(record.time > 1.2) & (record.time < 19.0)].all()
    assert not isolated[record.time > 27.5].any()
    assert (record["leg_extension"][record.time < 19.5][-1] < -37.0 * INCH).all()
    assert np.abs(record["leg_position"][-1]).max() < 3.0 * INCH


@pytest.mark.parametrize("other", [Request.RESET, Request.ENGAGE])
@pytest.mark.parametrize("first", [True, False])
def test_a_trip_is_lost_to_no_other_request_of_its_instant(other: Request, first: bool) -> None:
    """The reset of the same control frame took its place, and the machine stayed engaged."""
    requests = [(0.5, Request.TRIP), (0.5, other)]
    asked = requests if first else requests[::-1]
    operation = operate(Hexapod(), "velocity", sine(1.0), requests=asked, seconds=0.6)
    assert [name for name, _ in entered(operation.record)] == ["ENGAGED", "FAULT"]


def test_no_watchdog_before_the_first_frame_or_below_engaged() -> None:
    late = arrivals_of(sine(2.0), delay=2048)
    waiting = operate(Hexapod(), "velocity", late)
    assert waiting.record.metadata["fault"] is None
    held = operate(Hexapod(), "velocity", sine(1.0), seconds=3.0, begin=State.HOLD)
    assert held.record.metadata["fault"] is None
    assert entered(held.record) == [("HOLD", 0.0)]


def test_a_limit_switch_trips_the_states(tmp_path) -> None:
    """Switches moved into the way of an admissible motion."""
    path = tmp_path / "tight.toml"
    path.write_text(
        "switch_position = { value = 1.5, unit = 'in', status = 'assumed', source = 'test' }"
    )
    clamped = ElectronicsSettings(servo=path)
    operation = operate(Hexapod(), "velocity", sine(4.0, 0.07), electronics=clamped, seconds=3.0)
    record = operation.record
    over = np.flatnonzero(np.abs(record["leg_extension"]).max(axis=1) > 1.5 * INCH)[0]
    (_, start), (name, time) = entered(record)
    assert (start, name) == (0.0, "FAULT")
    assert time == pytest.approx(record.time[over], abs=2 / RATE)
    after = record["valve_command"][over + 1 :]
    change = 20.0 / RATE  # the rate limiter brings the command to nothing
    assert (np.abs(np.diff(after, axis=0)) <= change * (1 + 1e-9)).all()
    assert not after[int(0.05 * RATE) + 2 :].any()


def test_host_to_legs_takes_the_configured_delay_and_the_loops_own() -> None:
    """By cross-correlation: to the reference the breakdown, to the motion that and the loop."""
    noise = signals.noise("heave", 0.003, stop=3.0, duration=8.0)
    record = operate(Hexapod(), "velocity", from_command(noise, rate=80.0)).record
    sent = kinematics.pose_to_legs(noise.pose)
    frames = min(sent.shape[0], record.time.size)
    total = load_dcu().delay.total
    for leg in range(6):
        start, reference, moved = (
            values[:frames, leg]
            for values in (sent, record["leg_reference"], record["leg_extension"])
        )
        to_reference = lag(start, reference)
        assert to_reference == pytest.approx(total, abs=1 / RATE)
        loop = lag(reference, moved)
        assert loop > 0.03
        assert lag(start, moved) == pytest.approx(total + loop, abs=1 / RATE)


def test_the_frame_the_dcl_computes_is_behind_the_reference() -> None:
    """It is no part of the delay from host to reference: a step of the reference is in the command
    of its own frame, which is at the valve over the next and seen in the spool at the end of it."""
    stepped, still = (
        simulate(Hexapod(), "velocity", signals.step("heave", size, at=0.1, duration=0.2))
        for size in (0.01, 0.0)
    )
    first = {
        name: int(np.flatnonzero((stepped[name] != still[name]).any(axis=1))[0])
        for name in ("leg_reference", "compensator_output", "valve_command", "valve_opening")
    }
    at = first["leg_reference"]
    assert list(first.values()) == [at, at, at, at + 2]


def test_in_real_time_every_frame_is_accounted_for() -> None:
    """Times are those of whatever machine this is; counts are not."""
    ring = make_ring()
    stream = sine(4.0, 0.005)
    for index in range(3):
        put(ring, stream.row(index))
    seen: list[float] = []

    def progress(done: float) -> None:
        seen.append(done)
        if done > 0.0:
            for index in range(40):
                put(ring, stream.row(len(seen) * 40 + index))

    operation = serve(Hexapod(), "velocity", ring, 2.5, progress=progress)
    timing, record = operation.timing, operation.record
    assert seen == [0.0, 1.0, 2.0, 2.5]
    assert timing is not None
    assert timing.busy.shape == timing.late.shape == (5120,)
    assert (timing.busy > 0.0).all() and (timing.late >= 0.0).all()
    assert timing.overrun_frames == int((timing.busy > 1 / RATE).sum())
    assert operation.unused == {"early": 3, "lost": 0, "thinned": 0}
    frames = operation.arrivals.frame
    assert frames.size == 80
    assert set(frames) == {2048, 4096}
    told = operation.counts["accepted"] + sum(operation.rejections.values())
    assert 79 <= told <= 80
    np.testing.assert_array_equal(demand_again(operation), record["demand_pose"])


def test_refusals() -> None:
    plant, law = Hexapod(), load_law("velocity")
    empty = Arrivals(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 3, 6)))
    with pytest.raises(ValueError, match="frames: the host sends none"):
        operate(plant, law, empty)
    pairs = ((1e300, Request.HOLD), (1.0, State.RETURN), (1.0, 99), (Request.TRIP, 1.0), (1.0,))
    refused: list[tuple[dict[str, Any], str]] = [
        ({"seconds": float("nan")}, "seconds: nan is refused; allowed: above 0, up to 1.04858e"),
        ({"seconds": 1e17}, "seconds: 1e.17 is refused"),
        *(({"requests": [pair]}, r"operation\.requests\.0") for pair in pairs),
        ({"begin": "ENGAGED"}, "begin: 'ENGAGED' is refused: input should be 'off'"),
        ({"begin": State.RAISE}, "begin: .* is refused: input should be 'off'"),
        ({"seconds": 10_240.0}, "record_every: a record of 2097152"),
        ({"record_every": 0}, "record_every: 0 is refused: input should be greater"),
        ({"electronic": None}, "electronic: is not a known field; allowed: "),
    ]
    for options, said in refused:
        with pytest.raises(InputError, match=said):
            operate(plant, law, sine(1.0), **options)


def test_a_first_frame_beyond_the_limits_begins_at_neutral() -> None:
    arrivals = arrivals_of(sine(1.0))
    arrivals.values[0, 0] = np.nan
    record = operate(Hexapod(), "velocity", arrivals, seconds=0.2).record
    assert not record["demand_pose"][0].any()
